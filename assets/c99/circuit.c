#include "${n}.h"

enum {
    VECTORS = ${N}_VECTORS,
    GATES = ${N}_GATES,
    OUTPUT = $output, /* the vector that is read */
    STEPS_PER_SAMPLE = $steps,
    INPUT_MAX = $input_max,
    STATE_MAX = 8388607,
    ONE_BITS = $one_bits, /* of a vector's soma */
    BIAS_BITS = $bias_bits, /* of the bias's soma */
    INNOVATION_BITS = $innovation_bits,
    FELT_BITS = $felt_bits,
    ANGLE_BITS = $angle_bits, /* of a quantum of angle, in units of `input` */
    FORCE_BITS = $force_bits, /* of a quantum of force */
    ANGLE_MAX = $angle_max, /* most quanta in a step */
    FORCE_QUANTA = $force_quanta,
    LATER = $later, /* most that may wait for the next step */
    BIAS_UNITS = $bias_units, /* that a spike of the bias takes from an angle */
    TURN = (1 << (ONE_BITS - $turn_bits)) / STEPS_PER_SAMPLE, /* of a vector's spike by a quantum of angle */
    LEAD = $lead, /* half steps by which spikes run ahead of their vector */
    RING = $ring_size,
    PAIRS = $pairs,
    KINDS = 5 /* of what gates hear */
};

/* Weights that spikes add, without those of 0. A word is 256 times the weight, plus the number of the target.
 * First come the words for x and y, by source, then those for z; FROM is each source's first word. */
static const int32_t MIX[] = $mix;
static const uint16_t FROM_MIX[2][VECTORS + 1] = $from_mix;
static const int32_t GIVE[] = $give;
static const uint16_t FROM_GIVE[2][GATES + 1] = $from_give;
static const int32_t TAKE[] = $take;
static const uint16_t FROM_TAKE[2][VECTORS + 1] = $from_take;

/* What a quantum of force adds to vectors and to innovations, x and y, then z. */
static const int32_t PULL[2][VECTORS] = $pull;
static const int32_t READ[2][GATES] = $read;

/* A step leaves keep / 2^31 of a gate. */
static const struct {
    int32_t level, keep, w[KINDS];
} GATE[GATES] = $gate;
static const struct {
    uint16_t vector, gate;
    int32_t weight;
} LEARN[PAIRS] = $learn;
static const int32_t THRESHOLD[RING] = $ring;
static const int32_t START[VECTORS] = $start;
static const int32_t ONSET[GATES] = $onset;
static const int32_t RESUME[GATES] = $resume;

static const int32_t FELT_KEEP = $felt_keep;
static const int32_t DRIVE_KEEP = $drive_keep;
static const int32_t FELT_FORCE = $felt_force, FELT_TURN = $felt_turn, FELT_VECTOR = $felt_vector;
static const int32_t FELT_STILL = $felt_still;

static const double OFFSET[6] = $offset;
static const double GAIN[6] = $gain;
/* Beyond these a reading is not one of an IMU [rad/s, m/s^2]. */
static const double RATE_MAX = $rate_max;
static const double FORCE_MAX = $force_max;
/* A rate that jumps by more than this [rad/s] is missing; the last good one replaces it for HOLD samples, then 0. */
static const double RATE_STEP = $rate_step;
enum { HOLD = $hold };
static const double SCALE = $scale; /* parts of a unit vector for a vector's unit */

#part decay
#part readings
/* Whether v is beyond +-most. */
static inline int beyond(int32_t v, int32_t most)
{
    return (uint32_t)v + (uint32_t)most > 2 * (uint32_t)most;
}

/* The nearest number within +-most. */
static inline int32_t clip(int32_t v, int32_t most) { return beyond(v, most) ? (v < 0 ? -most : most) : v; }

/* Add a current to a soma, which a spike resets by 2^bits; the spike. */
static inline int32_t fires(int32_t *soma, int32_t current, int bits)
{
    int32_t v = clip(*soma + current, STATE_MAX), spike = 0;
    if (beyond(v, 1 << (bits - 1))) {
        spike = v < 0 ? -1 : 1;
        v -= spike * (1 << bits);
    }
    *soma = v;
    return spike;
}

/* Whole quanta of 2^bits nearest to what waits, at most so many; the rest goes on waiting. */
static inline int32_t quanta(int32_t *waiting, int bits, int32_t most)
{
    const int32_t n = clip((*waiting + (1 << (bits - 1))) >> bits, most);
    *waiting = clip(*waiting - n * (1 << bits), LATER);
    return n;
}

/* Add a source's weights to its targets, or take them away. */
static inline void deliver(int32_t *targets, const int32_t *words, const uint16_t *from, int32_t spike)
{
    const int32_t *const end = words + from[1];
    words += from[0];
    if (spike > 0)
        for (; words != end; ++words)
            targets[*words & 255] += *words >> 8;
    else
        for (; words != end; ++words)
            targets[*words & 255] -= *words >> 8;
}

void ${n}_reset(${n}_state *state)
{
    *state = (${n}_state){0};
    for (int m = 0; m < VECTORS; ++m)
        state->x[2][m] = START[m];
    for (int q = 0; q < GATES; ++q)
        state->gate[q] = ONSET[q];
}

#part encode
/* Spikes of the encoders, of the vectors, and of the bias. */
static void fire(${n}_state *state, int32_t angle[3], int32_t force[3], int32_t spike[3][VECTORS])
{
    for (int i = 0; i < 3; ++i) {
        state->angle[i] += state->input[i] - BIAS_UNITS * state->bias_spike[i];
        state->force[i] += state->input[3 + i];
        angle[i] = quanta(&state->angle[i], ANGLE_BITS, ANGLE_MAX);
        force[i] = quanta(&state->force[i], FORCE_BITS, FORCE_QUANTA);
        for (int m = 0; m < VECTORS; ++m)
            spike[i][m] = fires(&state->y[i][m], state->x[i][m], ONE_BITS);
        state->bias_spike[i] = fires(&state->bias_soma[i], state->bias[i], BIAS_BITS);
        state->bias[i] = clip(state->bias[i] + state->bias_due[i], STATE_MAX);
    }
}

/* What feels force, rate and surprise spikes, and takes what they are now. */
static void feel(${n}_state *state, int32_t threshold, const int32_t angle[3], const int32_t force[3],
                 int32_t spike[3][VECTORS], int32_t heard[KINDS])
{
    static const int8_t kind[3][3] = {{0, 0, 1}, {2, 2, 3}, {4, 4, 4}};
    for (int i = 0; i < 3; ++i) {
        const int32_t push = FELT_FORCE * force[i];
        const int32_t current[3] = {i == 2 ? push - FELT_STILL : push, FELT_TURN * angle[i],
                                    push - FELT_VECTOR * spike[i][0]};
        for (int k = 0; k < 3; ++k) {
            const int32_t felt = state->felt[k][i];
            heard[kind[k][i]] += (felt < 0 ? -felt : felt) * (1 << (ONE_BITS - FELT_BITS)) > threshold;
            state->felt[k][i] = clip(decay(felt, FELT_KEEP) + current[k], STATE_MAX);
        }
    }
}

/* Gates open, all bits of their word set, or close, and hear what is felt. */
static void open_gates(${n}_state *state, int32_t threshold, const int32_t heard[KINDS],
                       int32_t opened[GATES])
{
    for (int q = 0; q < GATES; ++q) {
        int32_t sum = decay(state->gate[q], GATE[q].keep);
        opened[q] = -(state->gate[q] + GATE[q].level > threshold);
        for (int k = 0; k < KINDS; ++k)
            sum += GATE[q].w[k] * heard[k];
        state->gate[q] = clip(sum, STATE_MAX);
    }
}

/* Vectors turn, mix, and are pulled and corrected. */
static void advance(${n}_state *state, const int32_t angle[3], const int32_t force[3],
                    int32_t spike[3][VECTORS])
{
    for (int i = 0; i < 3; ++i) {
        const int j = i < 2 ? i + 1 : 0, k = i > 0 ? i - 1 : 2, vertical = i == 2;
        const int32_t about_j = angle[j] * TURN, about_k = angle[k] * TURN;
        int32_t *const x = state->x[i];
        for (int m = 0; m < VECTORS; ++m) {
            const int32_t turned = state->turned[i][m];
            x[m] += PULL[vertical][m] * force[i] - turned;
            state->y[i][m] = clip(state->y[i][m] - turned / 2 * LEAD, STATE_MAX);
            state->turned[i][m] = about_j * spike[k][m] - about_k * spike[j][m];
        }
        for (int n = 0; n < VECTORS; ++n)
            if (spike[i][n])
                deliver(x, MIX, &FROM_MIX[vertical][n], spike[i][n]);
        for (int q = 0; q < GATES; ++q)
            if (state->passed[i][q])
                deliver(x, GIVE, &FROM_GIVE[vertical][q], state->passed[i][q]);
        for (int m = 0; m < VECTORS; ++m)
            x[m] = clip(x[m], STATE_MAX);
    }
}

/* The bias gets the products of vectors and innovations. */
static void learn(${n}_state *state, int32_t spike[3][VECTORS])
{
    for (int i = 0; i < 3; ++i) {
        const int j = i < 2 ? i + 1 : 0, k = i > 0 ? i - 1 : 2;
        state->bias_due[i] = 0;
        for (int p = 0; p < PAIRS; ++p) {
            const int m = LEARN[p].vector, q = LEARN[p].gate;
            const int32_t products = spike[j][m] * state->passed[k][q] - spike[k][m] * state->passed[j][q];
            state->bias_due[i] += LEARN[p].weight * products;
        }
    }
}

/* Spikes of the innovations, and their currents. */
static void innovate(${n}_state *state, const int32_t force[3], int32_t spike[3][VECTORS],
                     const int32_t opened[GATES])
{
    for (int i = 0; i < 3; ++i) {
        const int vertical = i == 2;
        int32_t *const drive = state->drive[i];
        for (int q = 0; q < GATES; ++q) {
            state->passed[i][q] = (int8_t)fires(&state->z[i][q], drive[q] & opened[q], INNOVATION_BITS);
            drive[q] = decay(drive[q], DRIVE_KEEP) + READ[vertical][q] * force[i];
        }
        for (int m = 0; m < VECTORS; ++m)
            if (spike[i][m])
                deliver(drive, TAKE, &FROM_TAKE[vertical][m], spike[i][m]);
        for (int q = 0; q < GATES; ++q)
            drive[q] = clip(drive[q], STATE_MAX);
    }
}

/* Vectors and the bias read which innovations passed in the step before, so the innovations go last. */
void ${n}_step(${n}_state *state)
{
    /* The first good rate after a gap opens gates. */
    if (state->ring && state->age == 0 && state->good == 1)
        for (int q = 0; q < GATES; ++q)
            state->gate[q] = clip(state->gate[q] + RESUME[q], STATE_MAX);
    for (int k = 0; k < STEPS_PER_SAMPLE; ++k) {
        int32_t angle[3], force[3], spike[3][VECTORS], heard[KINDS] = {0}, opened[GATES];
        const int32_t threshold = THRESHOLD[state->ring < RING ? state->ring : 0];
        state->ring = state->ring < RING ? state->ring + 1 : 1;
        fire(state, angle, force, spike);
        feel(state, threshold, angle, force, spike, heard);
        open_gates(state, threshold, heard, opened);
        advance(state, angle, force, spike);
        learn(state, spike);
        innovate(state, force, spike, opened);
    }
}

/* As the emulator rounds it, whose output is up less that of a level attitude. */
void ${n}_attitude(const ${n}_state *state, double up[${N}_OUTPUTS])
{
    for (int k = 0; k < 3; ++k)
        up[k] = state->x[k][OUTPUT] * SCALE - (k == 2) + (k == 2);
}
