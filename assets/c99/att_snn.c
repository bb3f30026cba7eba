#include "att_snn.h"

#include <math.h>

/* Weights by source; half the chip's mantissas, which are even. */
static const int8_t W_IN[ATT_SNN_INPUTS][ATT_SNN_ENCODING] = $w_in;
static const int8_t W_FF[ATT_SNN_ENCODING][ATT_SNN_HIDDEN] = $w_ff;
static const int8_t W_REC[ATT_SNN_HIDDEN][ATT_SNN_HIDDEN] = $w_rec;
static const int8_t W_OUT[ATT_SNN_HIDDEN][ATT_SNN_OUTPUTS] = $w_out;
static const int16_t W_SKIP[ATT_SNN_INPUTS][ATT_SNN_OUTPUTS] = $w_skip; /* of 4096: not the chip's, the host's */

/* What a step leaves of currents (du) and potentials (dv), of 4096. */
static const uint16_t KEEP_U_ENCODING[ATT_SNN_ENCODING] = $syn0;
static const uint16_t KEEP_V_ENCODING[ATT_SNN_ENCODING] = $mem0;
static const uint16_t KEEP_U_HIDDEN[ATT_SNN_HIDDEN] = $syn1;
static const uint16_t KEEP_V_HIDDEN[ATT_SNN_HIDDEN] = $mem1;
static const uint16_t KEEP_U_OUTPUT = $syn2;
static const uint16_t KEEP_V_OUTPUT = $mem2;
static const uint16_t KEEP_V_DIRECT = $mem_skip;

static const double OFFSET[ATT_SNN_INPUTS] = $offset;
static const double GAIN[ATT_SNN_INPUTS] = $gain;
static const double LEAD = $lead; /* times that the change of a lateral force is added to it */
static const double SCALE = 1.0 / ATT_SNN_UNITS_PER_RADIAN;
static const double STEP = $step; /* seconds between samples */
static const double BIAS_SAMPLES = $bias_samples; /* memory of the gyroscope's bias that is taken off; 0: none */
static const double BIAS_SD = $bias_sd;
static const double ALIGN_S = $align_s; /* time for which an unknown attitude is looked for at the start; 0: it is not */
static const double DRAG = $align_drag; /* what drag takes from a lateral speed then [1/s] */
static const double NOISE = $align_noise; /* of a lateral force's reading then [m/s^2] */

enum {
    YAW_FREE = $yaw_free, /* whether lateral readings are turned into axes that do not yaw; the outputs are a tilt */
    INPUT_MAX = $input_max,
    BIAS_STEP = 16,
    SKIP_STEP = 32,
    BIAS_MANT_MAX = 4095,
    THRESHOLD = 128 * 64,
    OUTPUT_THRESHOLD = 131071 * 64,
    STATE_MAX = 8388607,
    STEPS_PER_SAMPLE = $steps
};

/* The bias that stands for a current: the chip has mantissas of 12 bits, and a step. */
static int32_t bias(int64_t current, int32_t step)
{
    const int64_t mantissa = current / step;
    return (int32_t)(mantissa > BIAS_MANT_MAX ? BIAS_MANT_MAX : mantissa < -BIAS_MANT_MAX ? -BIAS_MANT_MAX : mantissa) * step;
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

static int32_t synapse(int32_t u, uint16_t keep, int32_t half_sum)
{
    return wrap(decay(u, keep) + wrap(half_sum * 128, 21), 23);
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

static int finite(double x) { return x - x == 0.0; }

void att_snn_reset(att_snn_state *state)
{
    const att_snn_state rest = {{0}, {0}, {0}, {0}, {0}, {0}, {0}, {0}, {0}, {0}, 0, {0}, {0}, {1.0, 0.0}, {0}, {0}};
    *state = rest;
}

static double between(double value, double limit)
{
    return value < -limit ? -limit : value > limit ? limit : value;
}

/* Turn the heading by the yaw rate over one sample. */
static void yaw(double heading[2], double rate)
{
    const double half = 0.5 * STEP * between(rate, $rate_max);
    double cosine = heading[0], sine = heading[1];
    for (int k = 0; k < 2; ++k) {
        const double before = cosine;
        cosine = before - half * sine;
        sine = sine + half * before;
    }
    const double size = sqrt(cosine * cosine + sine * sine);
    heading[0] = cosine / size;
    heading[1] = sine / size;
}

/* The integral of the rates is a line in that of the heading, about which the tilt scatters; its slope is the bias. */
static void follow_bias(att_snn_state *state, const double gyro[3])
{
    const double x = between(gyro[0], $rate_max), y = between(gyro[1], $rate_max);
    const double cosine = state->heading[0], sine = state->heading[1], expected = $expected_s / STEP;
    double *kept = state->bias;
    kept[0] = kept[0] + 1.0 < BIAS_SAMPLES ? kept[0] + 1.0 : BIAS_SAMPLES;
    kept[1] += STEP * cosine;
    kept[2] += STEP * sine;
    kept[3] += STEP * (cosine * x - sine * y);
    kept[4] += STEP * (cosine * y + sine * x);
    const double new = 1.0 / kept[0], old = 1.0 - new;
    const double sx = kept[1] - kept[5], sy = kept[2] - kept[6], ix = kept[3] - kept[7], iy = kept[4] - kept[8];
    kept[5] += new * sx;
    kept[6] += new * sy;
    kept[7] += new * ix;
    kept[8] += new * iy;
    kept[9] = old * (kept[9] + new * (sx * sx + sy * sy));
    kept[10] = old * (kept[10] + new * (sx * ix + sy * iy));
    kept[11] = old * (kept[11] + new * (sx * iy - sy * ix));
    kept[12] = old * (kept[12] + new * (ix * ix + iy * iy));
    const double spread = kept[9] > 1e-12 ? kept[9] : 1e-12;
    const double rest = kept[12] - (kept[10] * kept[10] + kept[11] * kept[11]) / spread;
    const double scatter = 0.5 * (rest > 0.0 ? rest : 0.0);
    const double variance = (kept[0] * scatter + expected * $tilt_variance) / (kept[0] + expected);
    const double prior = $correlated_s / STEP * variance / (BIAS_SD * BIAS_SD);
    const double weight = kept[0] / (kept[0] * kept[9] + prior);
    kept[13] = between(weight * kept[10], $bias_max);
    kept[14] = between(weight * kept[11], $bias_max);
}

static double smaller(double a, double b) { return a < b ? a : b; }

/* A lateral force with its change brought out, in the band between two low-passes that begin as means. */
static double led(att_snn_state *state, int k, double force)
{
    if (!(LEAD > 0.0))
        return force;
    if (!(state->forces > 0.0))
        state->fast[k] = state->slow[k] = force;
    const double seen = state->forces + 1.0;
    state->fast[k] += between(force - state->fast[k], $lead_clip) / smaller(seen, $lead_fast);
    state->slow[k] += (state->fast[k] - state->slow[k]) / smaller(seen, $lead_slow);
    return force + LEAD * (state->fast[k] - state->slow[k]);
}

/* Turn rates and lateral forces of one reading, in axes that do not yaw: the turn, the changes of the forces that it and
 * drag explain, and a straight line in time through what is left, whose slope is the tilt at the start. What that is
 * further than at the last reading is added to the rates. */
static void align(double kept[$align_kept], double rate[2], const double force[2])
{
    const double fall = DRAG * $gravity;
    kept[1] += STEP * between(rate[0], $rate_max);
    kept[2] += STEP * between(rate[1], $rate_max);
    const double x = between(force[0] + kept[3] - kept[7], $force_max);
    const double y = between(force[1] + kept[4] - kept[8], $force_max);
    kept[3] += STEP * DRAG * (x + kept[7] - kept[3] + $gravity * kept[2]);
    kept[4] += STEP * DRAG * (y + kept[8] - kept[4] - $gravity * kept[1]);
    kept[5] += 1.0;
    const double new = 1.0 / kept[5], old = 1.0 - new, time = kept[0] - kept[6];
    kept[6] += new * time;
    kept[7] += new * x;
    kept[8] += new * y;
    kept[9] = old * (kept[9] + new * time * time);
    kept[10] = old * (kept[10] + new * time * x);
    kept[11] = old * (kept[11] + new * time * y);
    const double prior = NOISE * NOISE / (fall * fall * $tilt_variance);
    const double weight = kept[5] / (kept[5] * kept[9] + prior) / fall;
    double about_x = weight * kept[11], about_y = -weight * kept[10];
    const double size = sqrt(about_x * about_x + about_y * about_y);
    if (size > $tilt_max) {
        about_x = about_x * $tilt_max / size;
        about_y = about_y * $tilt_max / size;
    }
    rate[0] += (about_x - kept[12]) / STEP;
    rate[1] += (about_y - kept[13]) / STEP;
    kept[12] = about_x;
    kept[13] = about_y;
}

void att_snn_encode(att_snn_state *state, const double gyro[3], const double accel[3])
{
    const double size = accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2];
    const int rate_found = finite(gyro[0] + gyro[1] + gyro[2]), force_found = finite(size) && size > 0.0;
    if (rate_found && (YAW_FREE || BIAS_SAMPLES > 0.0))
        yaw(state->heading, gyro[2]);
    const double cosine = YAW_FREE ? state->heading[0] : 1.0, sine = YAW_FREE ? state->heading[1] : 0.0;
    double rate[2] = {0.0, 0.0}, force[2] = {0.0, 0.0};
    if (rate_found) {
        if (BIAS_SAMPLES > 0.0)
            follow_bias(state, gyro);
        const double x = gyro[0] - state->bias[13] - OFFSET[0], y = gyro[1] - state->bias[14] - OFFSET[1];
        rate[0] = cosine * x - sine * y;
        rate[1] = cosine * y + sine * x;
    }
    if (force_found) {
        const double x = accel[0] - OFFSET[3], y = accel[1] - OFFSET[4];
        force[0] = cosine * x - sine * y;
        force[1] = cosine * y + sine * x;
    }
    if (state->alignment[0] < ALIGN_S) {
        if (rate_found && force_found)
            align(state->alignment, rate, force);
        state->alignment[0] += STEP;
    }
    if (rate_found) {
        state->input[0] = nearest(rate[0] * GAIN[0]);
        state->input[1] = nearest(rate[1] * GAIN[1]);
        state->input[2] = nearest((gyro[2] - OFFSET[2]) * GAIN[2]);
    }
    if (force_found) {
        state->input[3] = nearest(led(state, 0, force[0]) * GAIN[3]);
        state->input[4] = nearest(led(state, 1, force[1]) * GAIN[4]);
        state->input[5] = nearest((accel[2] - OFFSET[5]) * GAIN[5]);
        state->forces += 1.0;
    }
}

/* One step: every layer reads the spikes of the step before, so the last layer goes first. */
static void step(att_snn_state *state)
{
    int32_t output[ATT_SNN_OUTPUTS] = {0};
    int32_t hidden[ATT_SNN_HIDDEN] = {0};
    gather(output, ATT_SNN_OUTPUTS, &W_OUT[0][0], state->s_hidden, ATT_SNN_HIDDEN);
    gather(hidden, ATT_SNN_HIDDEN, &W_FF[0][0], state->s_encoding, ATT_SNN_ENCODING);
    gather(hidden, ATT_SNN_HIDDEN, &W_REC[0][0], state->s_hidden, ATT_SNN_HIDDEN);
    for (int i = 0; i < ATT_SNN_OUTPUTS; ++i) {
        int64_t direct = 0;
        for (int k = 0; k < ATT_SNN_INPUTS; ++k)
            direct += (int64_t)W_SKIP[k][i] * state->input[k];
        state->u_output[i] = synapse(state->u_output[i], KEEP_U_OUTPUT, output[i]);
        membrane(&state->v_output[i], KEEP_V_OUTPUT, state->u_output[i], OUTPUT_THRESHOLD);
        membrane(&state->v_direct[i], KEEP_V_DIRECT, bias(direct / 256, SKIP_STEP), OUTPUT_THRESHOLD);
    }
    for (int i = 0; i < ATT_SNN_HIDDEN; ++i) {
        state->u_hidden[i] = synapse(state->u_hidden[i], KEEP_U_HIDDEN[i], hidden[i]);
        state->s_hidden[i] = membrane(&state->v_hidden[i], KEEP_V_HIDDEN[i], state->u_hidden[i], THRESHOLD);
    }
    for (int i = 0; i < ATT_SNN_ENCODING; ++i) {
        int32_t drive = 0;
        for (int k = 0; k < ATT_SNN_INPUTS; ++k)
            drive += W_IN[k][i] * state->input[k];
        const int32_t u = wrap(decay(state->u_encoding[i], KEEP_U_ENCODING[i]) + drive / 8, 23);
        state->u_encoding[i] = u;
        state->s_encoding[i] = membrane(&state->v_encoding[i], KEEP_V_ENCODING[i], bias(u, BIAS_STEP), THRESHOLD);
    }
}

void att_snn_step(att_snn_state *state)
{
    for (int k = 0; k < STEPS_PER_SAMPLE; ++k)
        step(state);
}

void att_snn_attitude(const att_snn_state *state, double roll_pitch[2])
{
    const double *heading = state->heading;
    const double a = (state->v_output[0] + state->v_direct[0]) * SCALE;
    const double b = (state->v_output[1] + state->v_direct[1]) * SCALE;
    roll_pitch[0] = a;
    roll_pitch[1] = b;
    if (YAW_FREE) { /* a tilt, in axes that do not yaw: turned into those of the body, and up from it */
        const double first = heading[0] * a + heading[1] * b, second = heading[0] * b - heading[1] * a;
        const double angle = sqrt(first * first + second * second);
        const double factor = angle > 0.0 ? sin(angle) / angle : 1.0;
        const double x = -second * factor, y = first * factor, z = cos(angle);
        roll_pitch[0] = atan2(y, z);
        roll_pitch[1] = atan2(-x, sqrt(y * y + z * z));
    }
}
