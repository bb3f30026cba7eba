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
    ONE_ROUND = ENCODING <= ROUND && HIDDEN <= ROUND,
    PAIRS = (INPUTS + 1) / 2,
    INPUT_MAX = $input_max,
    BIAS_STEP_BITS = 4,
    BIAS_MANT_MAX = 4095,
    THRESHOLD = 128 * 64,
    OUTPUT_THRESHOLD = 131071 * 64,
    STATE_MAX = 8388607
};

/* Weights are halves of the chip's mantissas, which are even. Onto the hidden layer they stand by block of neurons,
 * then by source; each has 128 added, and four are a word: neurons 0, 2, 1, 3 from its lowest byte on. Sources that
 * send nothing to a block, at the start and the end of the layer, are left out. */
typedef struct {
    uint16_t first, end; /* sources */
    uint32_t row;        /* that of source 0, were it not left out */
} sources;

static const uint32_t W_FF[][WORDS] = $w_ff;
static const sources FROM_FF[] = $from_ff;
static const uint32_t W_REC[][WORDS] = $w_rec;
static const sources FROM_REC[] = $from_rec;
static const int8_t W_OUT[HIDDEN][OUTPUTS] = $w_out;

/* A step leaves keep / 2^31 of a current u and of a potential v. */
static const struct {
    int32_t keep_u, keep_v;
    uint32_t w[PAIRS]; /* of the inputs, two to a word, the even one in its lower half */
} ENCODER[ENCODING] = $encoders;
static const struct {
    int32_t keep_u, keep_v;
    uint8_t unit_ff, unit_rec; /* how many units of state its weights are in steps of */
} NEURON[HIDDEN] = $neurons;
static const int32_t OUTPUT_KEEP_U = $du;
static const int32_t OUTPUT_KEEP_V = $dv;

static const double OFFSET[6] = $offset;
static const double GAIN[6] = $gain;
/* Beyond these a reading is not one of an IMU [rad/s, m/s^2]. */
static const double RATE_MAX = $rate_max;
static const double FORCE_MAX = $force_max;
/* A rate that jumps by more than this [rad/s] is missing; the last good one replaces it for HOLD samples, then 0. */
static const double RATE_STEP = $rate_step;
enum { HOLD = $hold };
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

/* Whether a potential is above the threshold or below what the chip can hold, in one comparison. */
static inline int beyond(int32_t v) { return (uint32_t)v + STATE_MAX > (uint32_t)(THRESHOLD + STATE_MAX); }

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

/* Write two sums of 16 bits, less what was added to their weights, or add them to those of earlier rounds. */
static inline void take_sums(int32_t sum[2], uint32_t sums, int32_t bias)
{
    sum[0] = (ONE_ROUND ? 0 : sum[0]) + (int32_t)(sums & 0xffff) - bias;
    sum[1] = (ONE_ROUND ? 0 : sum[1]) + (int32_t)(sums >> 16) - bias;
}

/* Sum up the weights with which the sources that spiked reach a block. */
static void gather(int32_t sum[BLOCK], const uint32_t (*weights)[WORDS], const sources *from, const uint16_t *spikes,
                   int count)
{
    const uint16_t *last = spikes + count;
    while (spikes != last && *spikes < from->first)
        ++spikes;
    while (spikes != last && last[-1] >= from->end)
        --last;
    if (!ONE_ROUND || spikes == last)
        for (int i = 0; i < BLOCK; ++i)
            sum[i] = 0;
    while (spikes != last) {
        const uint16_t *const end = ONE_ROUND || last - spikes <= ROUND ? last : spikes + ROUND;
        const int32_t bias = 128 * (int32_t)(end - spikes);
        uint32_t even0 = 0, even1 = 0, even2 = 0, even3 = 0, odd0 = 0, odd1 = 0, odd2 = 0, odd3 = 0;
        do {
            const uint32_t *const row = weights[*spikes++];
            const uint32_t word0 = row[0], word1 = row[1], word2 = row[2], word3 = row[3];
            even0 = add_even(even0, word0);
            odd0 = add_odd(odd0, word0);
            even1 = add_even(even1, word1);
            odd1 = add_odd(odd1, word1);
            even2 = add_even(even2, word2);
            odd2 = add_odd(odd2, word2);
            even3 = add_even(even3, word3);
            odd3 = add_odd(odd3, word3);
        } while (spikes != end);
        take_sums(sum, even0, bias);
        take_sums(sum + 2, odd0, bias);
        take_sums(sum + 4, even1, bias);
        take_sums(sum + 6, odd1, bias);
        take_sums(sum + 8, even2, bias);
        take_sums(sum + 10, odd2, bias);
        take_sums(sum + 12, even3, bias);
        take_sums(sum + 14, odd3, bias);
    }
}

/* Size of a number as its bits, which are in the same order; a NaN has the largest. */
static inline uint64_t size(double x)
{
    const union {
        double value;
        uint64_t bits;
    } number = {x};
    return number.bits & 0x7fffffffffffffff;
}

/* Nearest integer, ties to even, within the input's range. */
static int32_t nearest(double x)
{
    const uint64_t bits = size(x);
    const int exponent = (int)(bits >> 52) - 1023;
    uint32_t whole = INPUT_MAX;
    if (exponent < -1)
        return 0;
    if (exponent < 15) {
        const uint32_t mantissa = ((uint32_t)(bits >> 32) & 0xfffff) | 0x100000, half = 0x80000000;
        const uint32_t rest = mantissa << (12 + exponent);
        whole = mantissa >> (20 - exponent);
        if (rest > half || (rest == half && ((uint32_t)bits != 0 || (whole & 1))))
            ++whole;
        if (whole > INPUT_MAX)
            whole = INPUT_MAX;
    }
    return x < 0.0 ? -(int32_t)whole : (int32_t)whole;
}

/* Whether a reading is one that an IMU can have measured; a NaN is not. */
static int within(const double reading[3], double most)
{
    return size(reading[0]) <= size(most) && size(reading[1]) <= size(most) && size(reading[2]) <= size(most);
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
    int rate = within(gyro, RATE_MAX);
    const int force = within(accel, FORCE_MAX) && (size(accel[0]) | size(accel[1]) | size(accel[2]));
    if (rate && state->age < state->good)
        for (int k = 0; k < 3; ++k) {
            const double change = nearest((gyro[k] - OFFSET[k]) * GAIN[k]) - state->input[k];
            rate &= change <= RATE_STEP * GAIN[k] && change >= -RATE_STEP * GAIN[k];
        }
    if (rate) {
        state->age = 0;
        state->good += state->good < HOLD;
        for (int k = 0; k < 3; ++k)
            state->input[k] = nearest((gyro[k] - OFFSET[k]) * GAIN[k]);
    } else if (state->age < HOLD) {
        ++state->age;
    } else {
        state->good = 0;
        for (int k = 0; k < 3; ++k)
            state->input[k] = nearest(-OFFSET[k] * GAIN[k]);
    }
    if (force)
        for (int k = 0; k < 3; ++k)
            state->input[3 + k] = nearest((accel[k] - OFFSET[3 + k]) * GAIN[3 + k]);
    if (!(rate && force))
        ++state->skipped;
}

static void step_outputs(${n}_state *state)
{
    int32_t arriving[OUTPUTS] = {0};
    for (int k = 0; k < state->hidden_spikes; ++k)
        for (int i = 0; i < OUTPUTS; ++i)
            arriving[i] += W_OUT[state->hidden_fired[k]][i];
    for (int i = 0; i < OUTPUTS; ++i) {
        const int32_t u = wrap(decay(state->output[i].u, OUTPUT_KEEP_U) + wrap(arriving[i] * 128, 21), 23);
        const int32_t v = decay(state->output[i].v, OUTPUT_KEEP_V) + u;
        state->output[i].u = u;
        state->output[i].v = v > OUTPUT_THRESHOLD ? 0 : v < -STATE_MAX ? -STATE_MAX : v;
    }
}

static void step_hidden(${n}_state *state)
{
    uint16_t fired[HIDDEN];
    int count = 0;
    for (int start = 0; start < HIDDEN; start += BLOCK) {
        const int end = start + BLOCK < HIDDEN ? start + BLOCK : HIDDEN;
        const sources *const from_ff = &FROM_FF[start / BLOCK], *const from_rec = &FROM_REC[start / BLOCK];
        int32_t sum[2 * BLOCK];
        gather(sum, W_FF + from_ff->row, from_ff, state->encoding_fired, state->encoding_spikes);
        gather(sum + BLOCK, W_REC + from_rec->row, from_rec, state->hidden_fired, state->hidden_spikes);
        for (int i = start; i < end; ++i) {
            const int32_t forward = sum[i - start] * NEURON[i].unit_ff;
            const int32_t arriving = wrap(forward + sum[i - start + BLOCK] * NEURON[i].unit_rec, 21);
            const int32_t u = wrap(decay(state->hidden[i].u, NEURON[i].keep_u) + arriving, 23);
            int32_t v = decay(state->hidden[i].v, NEURON[i].keep_v) + u;
            state->hidden[i].u = u;
            if (beyond(v)) {
                const int fires = v > THRESHOLD;
                v = fires ? 0 : -STATE_MAX;
                if (fires)
                    fired[count++] = (uint16_t)i;
            }
            state->hidden[i].v = v;
        }
    }
    state->hidden_spikes = (uint16_t)count;
    for (int k = 0; k < count; ++k)
        state->hidden_fired[k] = fired[k];
}

static void step_encoding(${n}_state *state)
{
    uint32_t input[PAIRS] = {0};
    int count = 0;
    for (int k = 0; k < INPUTS; ++k)
        input[k / 2] |= (uint32_t)(uint16_t)state->input[k] << 16 * (k % 2);
    for (int i = 0; i < ENCODING; ++i) {
        const uint32_t *const w = ENCODER[i].w;
        int32_t drive = add_products(add_products(add_products(0, w[0], input[0]), w[1], input[1]), w[2], input[2]);
#if CONTROLS
        drive = add_products(add_products(drive, w[3], input[3]), w[4], input[4]);
#endif
        const int32_t u = wrap(decay(state->encoding[i].u, ENCODER[i].keep_u) + shift(drive, 3), 23);
        int32_t bias = shift(u, BIAS_STEP_BITS);
        if ((uint32_t)bias + BIAS_MANT_MAX > 2 * BIAS_MANT_MAX)
            bias = bias < 0 ? -BIAS_MANT_MAX : BIAS_MANT_MAX;
        int32_t v = decay(state->encoding[i].v, ENCODER[i].keep_v) + bias * (1 << BIAS_STEP_BITS);
        state->encoding[i].u = u;
        if (beyond(v)) {
            const int fires = v > THRESHOLD;
            v = fires ? 0 : -STATE_MAX;
            if (fires)
                state->encoding_fired[count++] = (uint16_t)i;
        }
        state->encoding[i].v = v;
    }
    state->encoding_spikes = (uint16_t)count;
}

/* In a step every layer reads the spikes of the step before, so the last layer goes first. */
void ${n}_step(${n}_state *state)
{
    step_outputs(state);
    step_hidden(state);
    step_encoding(state);
}

#if ESTIMATES
void ${n}_attitude(const ${n}_state *state, double roll_pitch[OUTPUTS])
{
    for (int k = 0; k < OUTPUTS; ++k)
        roll_pitch[k] = state->output[k].v * SCALE;
}
#endif
#if CONTROLS
void ${n}_action(const ${n}_state *state, double action[4])
{
    for (int k = 0; k < OUTPUTS; ++k)
        action[k] = clipped(state->output[k].v * SCALE, -BOUND, BOUND);
    action[3] = state->thrust;
}
#endif
