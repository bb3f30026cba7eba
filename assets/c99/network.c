#include "${n}.h"

#ifdef __ARM_FEATURE_SIMD32
#include <arm_acle.h>
#endif

enum {
    INPUTS = ${N}_INPUTS,
    ENCODING = ${N}_ENCODING,
    HIDDEN = ${N}_HIDDEN,
    OUTPUTS = ${N}_OUTPUTS,
    BLOCK = 16,           /* hidden neurons whose sums are in registers together */
    WORDS = BLOCK / 4,    /* of their weights from one source */
    ROUND = 256,          /* spikes that sums of 16 bits have room for */
    PAIRS = (INPUTS + 1) / 2,
    INPUT_MAX = $input_max,
    BIAS_STEP_BITS = 4,
    BIAS_MANT_MAX = 4095,
    THRESHOLD = 128 * 64,
    OUTPUT_THRESHOLD = 131071 * 64,
    STATE_MAX = 8388607,
    STEPS_PER_SAMPLE = $steps
};

/* Weights are halves of the chip's mantissas, which are even. Onto the hidden layer they stand by block of neurons,
 * then by source; each has 128 added, and four are a word: neurons 0, 2, 1, 3 from its lowest byte on. Sources that
 * send nothing to a block, at the start and the end of the layer, are left out. */
typedef struct {
    uint16_t first, end; /* sources */
    uint32_t row;        /* that of the first source */
} sources;

static const uint32_t W_FF[][WORDS] = $w_ff;
static const sources FROM_FF[] = $from_ff;
static const uint32_t W_REC[][WORDS] = $w_rec;
static const sources FROM_REC[] = $from_rec;
/* Of the weights into each hidden neuron: a half of a mantissa is so many units of state. Whole blocks. */
static const uint8_t UNIT_FF[] = $unit_ff;
static const uint8_t UNIT_REC[] = $unit_rec;
static const int8_t W_OUT[HIDDEN][OUTPUTS] = $w_out;
/* Two to a word, of the even input in its lower half. */
static const uint32_t W_IN[ENCODING][PAIRS] = $w_in;

/* What a step leaves of currents and potentials, of 2^31. */
static const int32_t KEEP_U_ENCODING[ENCODING] = $syn0;
static const int32_t KEEP_V_ENCODING[ENCODING] = $mem0;
static const int32_t KEEP_U_HIDDEN[HIDDEN] = $syn1;
static const int32_t KEEP_V_HIDDEN[HIDDEN] = $mem1;
static const int32_t KEEP_U_OUTPUT = $syn2;
static const int32_t KEEP_V_OUTPUT = $mem2;
#if AFTER_SPIKE
/* Of each hidden neuron's after-spike current, and what its own spike adds [units of state]. */
static const int32_t KEEP_A_HIDDEN[HIDDEN] = $syn_after;
static const int16_t W_AFTER[HIDDEN] = $w_after;
#endif

static const double OFFSET[6] = $offset;
static const double GAIN[6] = $gain;
/* Beyond these a reading is not one of an IMU [rad/s, m/s^2]. */
static const double RATE_MAX = $rate_max;
static const double FORCE_MAX = $force_max;
static const double SCALE = $scale; /* $unit for a potential of 1 */
#if CONTROLS
/* Limits of roll, pitch and yaw rate, and what scales them. */
static const double SET_POINT_MAX[3] = $set_point_max;
static const double SET_POINT_GAIN[3] = $set_point_gain;
static const double THRUST_MAX = $thrust_max;
static const double HOVER = $gravity;
static const double BOUND = $bound;
#endif

/* Negative numbers are shifted right with their sign, as every compiler of note does. */
typedef char shift_keeps_the_sign[(-1 >> 1) == -1 ? 1 : -1];

/* The part of x that a decay leaves, rounded toward zero: x is of 24 bits, `keep` of 2^31. */
static inline int32_t decay(int32_t x, int32_t keep)
{
    return (int32_t)(((int64_t)(x * 2) * keep + (uint32_t)(x >> 31)) >> 32);
}

/* Two's complement of 1 + `bits` bits. */
static inline int32_t wrap(int32_t x, int bits) { return (int32_t)((uint32_t)x << (31 - bits)) >> (31 - bits); }

/* x / 2^bits, rounded toward zero. */
static inline int32_t shift(int32_t x, int bits) { return (x + (int32_t)((uint32_t)(x >> 31) >> (32 - bits))) >> bits; }

/* Add bytes 0 and 2 of a word, or 1 and 3, to two sums of 16 bits. */
static inline uint32_t add_even(uint32_t sums, uint32_t word)
{
#ifdef __ARM_FEATURE_SIMD32
    return __uxtab16(sums, word);
#else
    return sums + (word & 0x00ff00ff);
#endif
}

static inline uint32_t add_odd(uint32_t sums, uint32_t word)
{
#ifdef __ARM_FEATURE_SIMD32
    return __uxtab16(sums, word >> 8 | word << 24);
#else
    return sums + (word >> 8 & 0x00ff00ff);
#endif
}

/* sum + the products of the halves of two words. */
static inline int32_t add_products(int32_t sum, uint32_t x, uint32_t y)
{
#ifdef __ARM_FEATURE_SIMD32
    return __smlad((int16x2_t)x, (int16x2_t)y, sum);
#else
    return sum + (int16_t)(x & 0xffff) * (int16_t)(y & 0xffff) + (int16_t)(x >> 16) * (int16_t)(y >> 16);
#endif
}

/* Add to the sums of a block what the sources that spiked send it [units of state]. */
static void gather(int32_t sum[BLOCK], const uint32_t (*weights)[WORDS], const sources *from, const uint16_t *spikes,
                   int count, const uint8_t *unit)
{
    const uint16_t *last = spikes + count;
    while (spikes != last && *spikes < from->first)
        ++spikes;
    while (spikes != last && last[-1] >= from->end)
        --last;
    weights += from->row;
    while (spikes != last) {
        const uint16_t *const end = last - spikes > ROUND ? spikes + ROUND : last;
        const int32_t bias = 128 * (int32_t)(end - spikes);
        uint32_t even0 = 0, even1 = 0, even2 = 0, even3 = 0, odd0 = 0, odd1 = 0, odd2 = 0, odd3 = 0;
        for (; spikes != end; ++spikes) {
            const uint32_t *const row = weights[*spikes - from->first];
            even0 = add_even(even0, row[0]);
            odd0 = add_odd(odd0, row[0]);
            even1 = add_even(even1, row[1]);
            odd1 = add_odd(odd1, row[1]);
            even2 = add_even(even2, row[2]);
            odd2 = add_odd(odd2, row[2]);
            even3 = add_even(even3, row[3]);
            odd3 = add_odd(odd3, row[3]);
        }
        const uint32_t sums[BLOCK / 2] = {even0, odd0, even1, odd1, even2, odd2, even3, odd3};
        for (int i = 0; i < BLOCK / 2; ++i) {
            sum[2 * i] += ((int32_t)(sums[i] & 0xffff) - bias) * unit[2 * i];
            sum[2 * i + 1] += ((int32_t)(sums[i] >> 16) - bias) * unit[2 * i + 1];
        }
    }
}

/* Nearest integer, ties to even, within the input's range. */
static int32_t nearest(double x)
{
    if (x >= INPUT_MAX)
        return INPUT_MAX;
    if (x <= -INPUT_MAX)
        return -INPUT_MAX;
    int32_t down = (int32_t)x;
    if ((double)down > x)
        --down;
    const double rest = x - (double)down;
    return rest > 0.5 || (rest == 0.5 && (down & 1)) ? down + 1 : down;
}

/* Whether a reading is one that an IMU can have measured; a NaN is not. */
static int within(const double reading[3], double most)
{
    for (int k = 0; k < 3; ++k)
        if (!(reading[k] >= -most && reading[k] <= most))
            return 0;
    return 1;
}

void ${n}_reset(${n}_state *state)
{
    *state = (${n}_state){0};
#if CONTROLS
    state->thrust = HOVER;
#endif
}

#if CONTROLS
static double clipped(double x, double least, double most) { return x < least ? least : x > most ? most : x; }

void ${n}_set_point(${n}_state *state, const double set_point[4])
{
    for (int k = 0; k < 3; ++k)
        if (set_point[k] == set_point[k])
            state->input[6 + k] = nearest(clipped(set_point[k], -SET_POINT_MAX[k], SET_POINT_MAX[k]) * SET_POINT_GAIN[k]);
    if (set_point[3] == set_point[3])
        state->thrust = clipped(set_point[3], 0.0, THRUST_MAX);
}

#endif
void ${n}_encode(${n}_state *state, const double gyro[3], const double accel[3])
{
    const int rate = within(gyro, RATE_MAX);
    const int force = within(accel, FORCE_MAX) && (accel[0] != 0.0 || accel[1] != 0.0 || accel[2] != 0.0);
    if (rate)
        for (int k = 0; k < 3; ++k)
            state->input[k] = nearest((gyro[k] - OFFSET[k]) * GAIN[k]);
    if (force)
        for (int k = 0; k < 3; ++k)
            state->input[3 + k] = nearest((accel[k] - OFFSET[3 + k]) * GAIN[3 + k]);
    if (!(rate && force))
        ++state->skipped;
}

static void step_outputs(${n}_state *state)
{
    int32_t arriving[OUTPUTS] = {0};
    for (int k = 0; k < state->spikes_hidden; ++k)
        for (int i = 0; i < OUTPUTS; ++i)
            arriving[i] += W_OUT[state->s_hidden[k]][i];
    for (int i = 0; i < OUTPUTS; ++i) {
        const int32_t u = wrap(decay(state->u_output[i], KEEP_U_OUTPUT) + wrap(arriving[i] * 128, 21), 23);
        const int32_t v = decay(state->v_output[i], KEEP_V_OUTPUT) + u;
        state->u_output[i] = u;
        state->v_output[i] = v > OUTPUT_THRESHOLD ? 0 : v < -STATE_MAX ? -STATE_MAX : v;
    }
}

static void step_hidden(${n}_state *state)
{
    uint16_t fired[HIDDEN];
    int count = 0;
    for (int start = 0; start < HIDDEN; start += BLOCK) {
        const int end = start + BLOCK < HIDDEN ? start + BLOCK : HIDDEN;
        int32_t sum[BLOCK] = {0};
        gather(sum, W_FF, &FROM_FF[start / BLOCK], state->s_encoding, state->spikes_encoding, &UNIT_FF[start]);
        gather(sum, W_REC, &FROM_REC[start / BLOCK], state->s_hidden, state->spikes_hidden, &UNIT_REC[start]);
        for (int i = start; i < end; ++i) {
            const int32_t u = wrap(decay(state->u_hidden[i], KEEP_U_HIDDEN[i]) + wrap(sum[i - start], 21), 23);
            int32_t v = decay(state->v_hidden[i], KEEP_V_HIDDEN[i]) + u;
            state->u_hidden[i] = u;
#if AFTER_SPIKE
            int32_t a = state->a_hidden[i];
            v += a;
            a = decay(a, KEEP_A_HIDDEN[i]);
#endif
            if (v > THRESHOLD) {
                fired[count++] = (uint16_t)i;
                v = 0;
#if AFTER_SPIKE
                a = wrap(a + W_AFTER[i], 23);
#endif
            }
            state->v_hidden[i] = v < -STATE_MAX ? -STATE_MAX : v;
#if AFTER_SPIKE
            state->a_hidden[i] = a;
#endif
        }
    }
    state->spikes_hidden = (uint16_t)count;
    for (int k = 0; k < count; ++k)
        state->s_hidden[k] = fired[k];
}

static void step_encoding(${n}_state *state)
{
    uint32_t input[PAIRS] = {0};
    int count = 0;
    for (int k = 0; k < INPUTS; ++k)
        input[k / 2] |= (uint32_t)(uint16_t)state->input[k] << 16 * (k % 2);
    for (int i = 0; i < ENCODING; ++i) {
        int32_t drive = 0;
        for (int k = 0; k < PAIRS; ++k)
            drive = add_products(drive, W_IN[i][k], input[k]);
        const int32_t u = wrap(decay(state->u_encoding[i], KEEP_U_ENCODING[i]) + shift(drive, 3), 23);
        const int32_t mantissa = shift(u, BIAS_STEP_BITS);
        const int32_t bias = mantissa > BIAS_MANT_MAX ? BIAS_MANT_MAX : mantissa < -BIAS_MANT_MAX ? -BIAS_MANT_MAX : mantissa;
        int32_t v = decay(state->v_encoding[i], KEEP_V_ENCODING[i]) + bias * (1 << BIAS_STEP_BITS);
        state->u_encoding[i] = u;
        if (v > THRESHOLD) {
            state->s_encoding[count++] = (uint16_t)i;
            v = 0;
        }
        state->v_encoding[i] = v < -STATE_MAX ? -STATE_MAX : v;
    }
    state->spikes_encoding = (uint16_t)count;
}

/* In a step every layer reads the spikes of the step before, so the last layer goes first. */
void ${n}_step(${n}_state *state)
{
    for (int k = 0; k < STEPS_PER_SAMPLE; ++k) {
        step_outputs(state);
        step_hidden(state);
        step_encoding(state);
    }
}

#if ESTIMATES
void ${n}_attitude(const ${n}_state *state, double $name[OUTPUTS])
{
    for (int k = 0; k < OUTPUTS; ++k)
        $name[k] = state->v_output[k] * SCALE$level;
}
#endif
#if CONTROLS
void ${n}_action(const ${n}_state *state, double action[4])
{
    for (int k = 0; k < OUTPUTS; ++k)
        action[k] = clipped(state->v_output[k] * SCALE, -BOUND, BOUND);
    action[3] = state->thrust;
}
#endif
