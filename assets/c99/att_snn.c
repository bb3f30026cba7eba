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
static const double BIAS_SD = $bias_sd; /* spread of the gyroscope's bias, which is found and taken off; 0: it is not */
static const double ALIGN_S = $align_s; /* time for which an unknown attitude is looked for at the start; 0: it is not */
static const double DRAG = $align_drag; /* what drag takes from a lateral speed, for both [1/s] */
static const double NOISE = $align_noise; /* noise density of a lateral force's reading, for both [m/s^2 s^0.5] */

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
    const att_snn_state rest = {{0}, {0}, {0}, {0}, {0}, {0}, {0}, {0}, {0}, {0}, 0, {0}, {0}, {1.0, 0.0}, {0}};
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

/* x + iy of two lateral axes. */
typedef struct {
    double x, y;
} pair;

static pair plus(pair a, pair b) { return (pair){a.x + b.x, a.y + b.y}; }
static pair minus(pair a, pair b) { return (pair){a.x - b.x, a.y - b.y}; }
static pair of(double factor, pair a) { return (pair){factor * a.x, factor * a.y}; }
static pair times(pair a, pair b) { return (pair){a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x}; }
static pair conjugate(pair a) { return (pair){a.x, -a.y}; }
static double square(pair a) { return a.x * a.x + a.y * a.y; }
static pair both_between(pair a, double limit) { return (pair){between(a.x, limit), between(a.y, limit)}; }

/* What drag does to a lateral force, and gravity to it by a lean, which a gyroscope follows but for its bias: a Kalman
 * filter. The variances are of one axis; the covariances of force and lean, force and bias, lean and bias. */
typedef struct {
    pair force, lean, bias;
    double force_var, lean_var, bias_var;
    pair force_lean, force_bias, lean_bias;
} filter;

static void predict(filter *f, pair rate, pair heading, double elapsed, double gust)
{
    const double walk = BIAS_SD > 0.0 ? $bias_walk : 0.0; /* a bias that is known to be none stays none */
    const double left = 1.0 - DRAG * elapsed, fall = DRAG * $gravity * elapsed;
    const pair turn = {-heading.y * elapsed, heading.x * elapsed};
    const pair force_bias = minus(of(left, f->force_bias), of(fall, f->lean_bias));
    const double by_turn = turn.x * f->lean_bias.x + turn.y * f->lean_bias.y;
    f->force = minus(of(left, f->force), of(fall, f->lean));
    f->lean = plus(f->lean, times(turn, minus(f->bias, rate)));
    f->force_var = left * left * f->force_var - 2.0 * left * fall * f->force_lean.x + fall * fall * f->lean_var
        + gust * elapsed;
    f->force_lean.x = left * f->force_lean.x - fall * f->lean_var;
    f->force_lean.y = left * f->force_lean.y;
    f->force_lean = plus(f->force_lean, times(force_bias, conjugate(turn)));
    f->force_bias = force_bias;
    f->lean_var = f->lean_var + 2.0 * by_turn + elapsed * elapsed * f->bias_var + $turn_noise * $turn_noise * elapsed;
    f->lean_bias = plus(f->lean_bias, of(f->bias_var, turn));
    f->bias_var = f->bias_var + walk * walk * elapsed;
}

/* One measurement: its column of the covariance, and its innovation with its variance. */
static void correct(filter *f, pair force, pair lean, pair bias, pair innovation, double variance)
{
    const double scale = 1.0 / variance;
    const pair gain = {innovation.x * scale, innovation.y * scale};
    f->force = plus(f->force, times(force, gain));
    f->lean = plus(f->lean, times(lean, gain));
    f->bias = plus(f->bias, times(bias, gain));
    f->force_var = f->force_var - scale * square(force);
    f->lean_var = f->lean_var - scale * square(lean);
    f->bias_var = f->bias_var - scale * square(bias);
    f->force_lean = minus(f->force_lean, of(scale, times(force, conjugate(lean))));
    f->force_bias = minus(f->force_bias, of(scale, times(force, conjugate(bias))));
    f->lean_bias = minus(f->lean_bias, of(scale, times(lean, conjugate(bias))));
}

static filter unpacked(const double kept[$kept])
{
    return (filter){{kept[3], kept[4]}, {kept[5], kept[6]}, {kept[7], kept[8]}, kept[9], kept[10], kept[11],
        {kept[12], kept[13]}, {kept[14], kept[15]}, {kept[16], kept[17]}};
}

static void pack(const filter *f, double kept[$kept])
{
    const pair pairs[6] = {both_between(f->force, $reading_max), both_between(f->lean, $lean_max),
        both_between(f->bias, $bias_max), f->force_lean, f->force_bias, f->lean_bias};
    for (int k = 0; k < 3; ++k) {
        kept[3 + 2 * k] = pairs[k].x;
        kept[4 + 2 * k] = pairs[k].y;
        kept[12 + 2 * k] = pairs[3 + k].x;
        kept[13 + 2 * k] = pairs[3 + k].y;
    }
    kept[9] = f->force_var;
    kept[10] = f->lean_var;
    kept[11] = f->bias_var;
}

/* Take a correction of the force into what is known of its random walk: their sum scatters as far. */
static void gauge(pair correction, double kept[$kept])
{
    double *sum = kept + $corrections, *drift = kept + $drift, *gust = kept + $gust;
    sum[0] += correction.x - sum[0] * STEP / $corrected_s;
    sum[1] += correction.y - sum[1] * STEP / $corrected_s;
    const pair off = {sum[0] - drift[0], sum[1] - drift[1]};
    drift[0] += off.x * STEP / $drift_s;
    drift[1] += off.y * STEP / $drift_s;
    const double walked = $gauge * square(off) / $corrected_s, least = $calm * $calm;
    const double memory = smaller($breeze_s + kept[$samples] * STEP, $gusts_s);
    *gust += ((walked > least ? walked : least) - *gust) * STEP / memory;
}

/* Take a reading into the fast and the slow low-pass of both sensors; whether these agree. */
static int unchanged(const double gyro[3], const double accel[3], double kept[$kept])
{
    const double fast = 1.0 / smaller(kept[$samples], $fast_s / STEP), slow = 1.0 / smaller(kept[$samples], $rest_s / STEP);
    double *quick = kept + $fast, *late = kept + $slow;
    int still = 1;
    for (int k = 0; k < 6; ++k) {
        const double value = between(k < 3 ? gyro[k] : accel[k - 3], $reading_max);
        quick[k] += fast * (value - quick[k]);
        late[k] += slow * (value - late[k]);
        if (fabs(quick[k] - late[k]) > (k < 3 ? $rest_rate : $rest_force) || (k < 3 && fabs(late[k]) > $bias_max))
            still = 0;
    }
    return still;
}

/* Take one sample into what is kept. Returns how far the attitude is to turn about x and y of the body beyond what the
 * gyroscope says, less its bias. */
static pair follow(const double gyro[3], const double accel[3], pair heading, double kept[$kept])
{
    const pair rate = both_between((pair){gyro[0], gyro[1]}, $rate_max);
    filter f = unpacked(kept);
    kept[$samples] += 1.0;
    const pair force = times(heading, both_between((pair){accel[0], accel[1]}, $reading_max));
    if (kept[$samples] == 1.0) {
        f.force = force;
        f.force_var = NOISE * NOISE / STEP;
        f.lean_var = $lean_sd * $lean_sd;
        f.bias_var = BIAS_SD * BIAS_SD;
        kept[$gust] = $breeze * $breeze;
    }
    const pair bias_before = f.bias;
    const int aligning = kept[0] < ALIGN_S;
    predict(&f, rate, heading, smaller(kept[1] + STEP, $gap_max), aligning ? $steady * $steady : kept[$gust]);
    const pair lean_before = f.lean, force_before = f.force;

    const pair off = both_between(minus(force, f.force), $force_max);
    correct(&f, (pair){f.force_var, 0.0}, conjugate(f.force_lean), conjugate(f.force_bias), off,
        f.force_var + NOISE * NOISE / STEP);
    if (kept[$samples] * STEP > $gauge_from_s) /* the first corrections are those of the start */
        gauge(minus(f.force, force_before), kept);

    double *mean = kept + $mean;
    if (!aligning)
        correct(&f, f.force_lean, (pair){f.lean_var, 0.0}, conjugate(f.lean_bias), minus((pair){mean[0], mean[1]}, f.lean),
            f.lean_var + $lean_sd * $lean_sd * $upright_s / STEP);
    const double seen = STEP / smaller($upright_s + kept[$samples] * STEP, $mean_s);
    mean[0] += (f.lean.x - mean[0]) * seen;
    mean[1] += (f.lean.y - mean[1]) * seen;

    kept[2] = unchanged(gyro, accel, kept) ? kept[2] + STEP : 0.0;
    if (kept[2] >= $rest_s)
        correct(&f, f.force_bias, f.lean_bias, (pair){f.bias_var, 0.0}, minus(rate, f.bias),
            f.bias_var + $rest_noise * $rest_noise / STEP);

    pack(&f, kept);
    f = unpacked(kept);
    double *effect = kept + $effect;
    const pair lean_found = minus(f.lean, lean_before);
    const pair further = aligning ? (pair){-lean_found.y, lean_found.x} : times(minus(bias_before, f.bias), (pair){effect[0], effect[1]});
    effect[0] += STEP * (heading.x - effect[0] / $remembered_s);
    effect[1] += STEP * (heading.y - effect[1] / $remembered_s);
    kept[1] = 0.0;
    return times(conjugate(heading), further);
}

void att_snn_encode(att_snn_state *state, const double gyro[3], const double accel[3])
{
    const double size = accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2];
    const int rate_found = finite(gyro[0] + gyro[1] + gyro[2]), force_found = finite(size) && size > 0.0;
    const int aligned = ALIGN_S > 0.0 || BIAS_SD > 0.0;
    if (rate_found && (YAW_FREE || aligned))
        yaw(state->heading, gyro[2]);
    const pair heading = {state->heading[0], state->heading[1]}, axes = YAW_FREE ? heading : (pair){1.0, 0.0};
    pair turn = {0.0, 0.0};
    if (aligned) {
        if (rate_found && force_found) {
            const double forces[3] = {accel[0] - OFFSET[3], accel[1] - OFFSET[4], accel[2]};
            turn = follow(gyro, forces, heading, state->alignment);
        } else
            state->alignment[1] += STEP;
        state->alignment[0] += STEP;
    }
    if (rate_found) {
        const double *bias_found = state->alignment + $bias;
        const pair rate = times(axes, (pair){gyro[0] - OFFSET[0] - bias_found[0] + turn.x / STEP,
                                          gyro[1] - OFFSET[1] - bias_found[1] + turn.y / STEP});
        state->input[0] = nearest(rate.x * GAIN[0]);
        state->input[1] = nearest(rate.y * GAIN[1]);
        state->input[2] = nearest((gyro[2] - OFFSET[2]) * GAIN[2]);
    }
    if (force_found) {
        const pair force = times(axes, (pair){accel[0] - OFFSET[3], accel[1] - OFFSET[4]});
        state->input[3] = nearest(led(state, 0, force.x) * GAIN[3]);
        state->input[4] = nearest(led(state, 1, force.y) * GAIN[4]);
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
