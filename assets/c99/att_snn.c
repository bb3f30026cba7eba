#include "att_snn.h"

/* Weights by source; half the chip's mantissas, which are even. */
static const int8_t W_IN[ATT_SNN_INPUTS][ATT_SNN_ENCODING] = $w_in;
static const int8_t W_FF[ATT_SNN_ENCODING][ATT_SNN_HIDDEN] = $w_ff;
static const int8_t W_REC[ATT_SNN_HIDDEN][ATT_SNN_HIDDEN] = $w_rec;
static const int8_t W_OUT[ATT_SNN_HIDDEN][ATT_SNN_OUTPUTS] = $w_out;

#if AFTER_SPIKE
/* Of each hidden neuron on its own after-spike current. */
static const int8_t W_AFTER[ATT_SNN_HIDDEN] = $w_after;
static const uint8_t SHIFT_AFTER[ATT_SNN_HIDDEN] = $exp_after;
static const uint16_t KEEP_A_HIDDEN[ATT_SNN_HIDDEN] = $syn_after;

#endif
/* Of the weights into each hidden neuron: a half of a mantissa is 2^shift units of state. */
static const uint8_t SHIFT_FF[ATT_SNN_HIDDEN] = $exp_ff;
static const uint8_t SHIFT_REC[ATT_SNN_HIDDEN] = $exp_rec;

/* What a step leaves of currents (du) and potentials (dv), of 4096. */
static const uint16_t KEEP_U_ENCODING[ATT_SNN_ENCODING] = $syn0;
static const uint16_t KEEP_V_ENCODING[ATT_SNN_ENCODING] = $mem0;
static const uint16_t KEEP_U_HIDDEN[ATT_SNN_HIDDEN] = $syn1;
static const uint16_t KEEP_V_HIDDEN[ATT_SNN_HIDDEN] = $mem1;
static const uint16_t KEEP_U_OUTPUT = $syn2;
static const uint16_t KEEP_V_OUTPUT = $mem2;

static const double OFFSET[ATT_SNN_INPUTS] = $offset;
static const double GAIN[ATT_SNN_INPUTS] = $gain;
/* Beyond these a reading is not one of an IMU [rad/s, m/s^2]. */
static const double RATE_MAX = $rate_max;
static const double FORCE_MAX = $force_max;
static const double SCALE = $scale; /* $unit for a potential of 1 */

enum {
    INPUT_MAX = $input_max,
    BIAS_STEP = 16,
    BIAS_MANT_MAX = 4095,
    THRESHOLD = 128 * 64,
    OUTPUT_THRESHOLD = 131071 * 64,
    STATE_MAX = 8388607,
    STEPS_PER_SAMPLE = $steps
};

/* The bias that stands for a current: the chip has mantissas of 12 bits, and a step. */
static int32_t bias(int32_t current)
{
    const int32_t mantissa = current / BIAS_STEP;
    return (mantissa > BIAS_MANT_MAX ? BIAS_MANT_MAX : mantissa < -BIAS_MANT_MAX ? -BIAS_MANT_MAX : mantissa) * BIAS_STEP;
}

/* The part of x that a decay leaves, rounded toward zero as C99 divides. */
static int32_t decay(int32_t x, uint16_t keep) { return (int32_t)((int64_t)x * keep / 4096); }

/* Two's complement with `bits` bits and sign. */
static int32_t wrap(int32_t x, int bits)
{
    const uint32_t half = (uint32_t)1 << bits;
    return (int32_t)(((uint32_t)x + half) & (2 * half - 1)) - (int32_t)half;
}

static int32_t clip(int32_t x, int32_t limit)
{
    return x > limit ? limit : x < -limit ? -limit : x;
}

/* Advance a membrane; returns whether it spikes. */
static uint8_t membrane(int32_t *v, uint16_t keep, int32_t drive, int32_t threshold)
{
    const int32_t potential = clip(decay(*v, keep) + drive, STATE_MAX);
    const uint8_t fires = potential > threshold;
    *v = fires ? 0 : potential;
    return fires;
}

/* Add the weights of every source that spiked. */
static void gather(int32_t *sum, int n, const int8_t *weights, const uint8_t *spikes, int sources)
{
    for (int source = 0; source < sources; ++source)
        if (spikes[source])
            for (int i = 0; i < n; ++i)
                sum[i] += weights[source * n + i];
}

/* Advance a current by what arrives, in units of state. */
static int32_t synapse(int32_t u, uint16_t keep, int32_t arriving)
{
    return wrap(decay(u, keep) + wrap(arriving, 21), 23);
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

void att_snn_reset(att_snn_state *state)
{
    static const att_snn_state rest;
    *state = rest;
}

void att_snn_encode(att_snn_state *state, const double gyro[3], const double accel[3])
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

/* One step: every layer reads the spikes of the step before, so the last layer goes first. */
static void step(att_snn_state *state)
{
    int32_t output[ATT_SNN_OUTPUTS] = {0};
    int32_t forward[ATT_SNN_HIDDEN] = {0};
    int32_t recurrent[ATT_SNN_HIDDEN] = {0};
    gather(output, ATT_SNN_OUTPUTS, &W_OUT[0][0], state->s_hidden, ATT_SNN_HIDDEN);
    gather(forward, ATT_SNN_HIDDEN, &W_FF[0][0], state->s_encoding, ATT_SNN_ENCODING);
    gather(recurrent, ATT_SNN_HIDDEN, &W_REC[0][0], state->s_hidden, ATT_SNN_HIDDEN);
    for (int i = 0; i < ATT_SNN_OUTPUTS; ++i) {
        state->u_output[i] = synapse(state->u_output[i], KEEP_U_OUTPUT, output[i] * 128);
        membrane(&state->v_output[i], KEEP_V_OUTPUT, state->u_output[i], OUTPUT_THRESHOLD);
    }
    for (int i = 0; i < ATT_SNN_HIDDEN; ++i) {
        const int32_t arriving = forward[i] * (1 << SHIFT_FF[i]) + recurrent[i] * (1 << SHIFT_REC[i]);
        state->u_hidden[i] = synapse(state->u_hidden[i], KEEP_U_HIDDEN[i], arriving);
        int32_t drive = state->u_hidden[i];
#if AFTER_SPIKE
        state->a_hidden[i] = synapse(state->a_hidden[i], KEEP_A_HIDDEN[i], state->s_hidden[i] * W_AFTER[i] * (1 << SHIFT_AFTER[i]));
        drive += state->a_hidden[i];
#endif
        state->s_hidden[i] = membrane(&state->v_hidden[i], KEEP_V_HIDDEN[i], drive, THRESHOLD);
    }
    for (int i = 0; i < ATT_SNN_ENCODING; ++i) {
        int32_t drive = 0;
        for (int k = 0; k < ATT_SNN_INPUTS; ++k)
            drive += W_IN[k][i] * state->input[k];
        const int32_t u = wrap(decay(state->u_encoding[i], KEEP_U_ENCODING[i]) + drive / 8, 23);
        state->u_encoding[i] = u;
        state->s_encoding[i] = membrane(&state->v_encoding[i], KEEP_V_ENCODING[i], bias(u), THRESHOLD);
    }
}

void att_snn_step(att_snn_state *state)
{
    for (int k = 0; k < STEPS_PER_SAMPLE; ++k)
        step(state);
}

void att_snn_attitude(const att_snn_state *state, double $name[ATT_SNN_OUTPUTS])
{
    for (int k = 0; k < ATT_SNN_OUTPUTS; ++k)
        $name[k] = state->v_output[k] * SCALE$level;
}
