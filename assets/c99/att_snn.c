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
static const double ACCEL_BIAS_SD = $accel_bias_sd; /* and that of the accelerometer's, likewise */
static const double ALIGN_S = $align_s; /* time for which an unknown attitude is looked for at the start; 0: it is not */
static const double DRAG = $align_drag; /* what drag takes from a lateral speed, for both [1/s] */
static const double NOISE = $align_noise; /* noise density of a lateral force's reading, for both [m/s^2 s^0.5] */

enum {
    LEAN_FED = $lean_fed, /* whether lateral forces are -g times the lean that is found out */
    YAW_FREE = $yaw_free, /* whether lateral readings are turned into axes that do not yaw; the outputs are a tilt */
    INPUT_MAX = $input_max,
    BIAS_STEP = 16,
    SKIP_STEP = 32,
    BIAS_MANT_MAX = 4095,
    THRESHOLD = 128 * 64,
    OUTPUT_THRESHOLD = 131071 * 64,
    STATE_MAX = 8388607,
    STEPS_PER_SAMPLE = $steps,
    SETTLING = $settling, /* samples of level hover that a network sees before a turn into a known attitude */
    TURNING = $turning
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

static double larger(double a, double b) { return a > b ? a : b; }

/* The state of a Kalman filter: the lateral force, the lean that gravity moves it by, the bias of the gyroscope that
 * follows the lean, that of the accelerometer that reads the force, and the speed over ground. */
enum { F, L, B, A, V, STATES };

static pair pair_at(const double *kept) { return (pair){kept[0], kept[1]}; }

static void keep(double *kept, pair value)
{
    kept[0] = value.x;
    kept[1] = value.y;
}

static pair shorter(pair a, double limit) { return of(smaller(1.0, limit / larger(sqrt(square(a)), 1e-9)), a); }

/* Cosine of a tilt. */
static double cosine_of(pair lean) { return larger(sqrt(larger(1.0 - square(lean), 0.0)), $upright_min); }

/* Lateral part, in body axes, of a level vector; in level axes, of a lateral one of the body. */
static pair lateral(pair x, pair lean, double upright)
{
    return minus(x, of(times(x, conjugate(lean)).x / (1.0 + upright), lean));
}

/* Advance a small change of the state, whose elements are `stride` apart. */
static void advance(pair *x, int stride, pair turn, double elapsed, double slope, double of_force, double thrust)
{
    const pair faster = of(elapsed, plus(of(of_force, x[F * stride]), of(thrust, x[L * stride])));
    x[V * stride] = plus(x[V * stride], faster);
    x[F * stride] = minus(x[F * stride], of(slope, faster));
    x[L * stride] = plus(x[L * stride], times(turn, x[B * stride]));
}

/* Advance state, covariance and level axes to a sample. Returns what the force of drag is to be multiplied by for a
 * reading, and leaves the cosine of the tilt. */
static double move(
    pair state[STATES], pair spread[STATES][STATES], pair rate, pair level, double thrust, double elapsed, int aligning,
    double *upright, double kept[$kept])
{
    const pair mean_rate = of(0.5, plus(rate, pair_at(kept + $before)));
    keep(kept + $before, rate);
    const pair turning = times(times((pair){0.0, -elapsed}, level), minus(mean_rate, state[B]));
    const pair half = of(0.5, lateral(turning, state[L], cosine_of(state[L])));
    const pair lean = shorter(plus(state[L], half), $lean_max);
    *upright = cosine_of(lean); /* both half-way */
    const pair leant = lateral(turning, lean, *upright);
    const pair twist = times(pair_at(kept + $twist), (pair){1.0, times(conjugate(lean), leant).y / (1.0 + *upright)});
    keep(kept + $twist, of(1.5 - 0.5 * square(twist), twist));

    const double now = between(thrust, $thrust_max * $gravity);
    thrust = 0.5 * (kept[$before + 2] + now);
    kept[$before + 2] = now;
    kept[$thrust] += (thrust - kept[$thrust]) * smaller(STEP / $thrust_s, 1.0);
    const double size = sqrt(square(state[F]));
    const double along = sqrt(1.0 + 4.0 * $frame * size / (DRAG * DRAG)); /* a speed's, along the force */
    const double across = 0.5 * (1.0 + along);                            /* across it, and the whole over rotors' */
    const double slowed = 1.0 + (sqrt(larger(kept[$thrust] / $gravity, $thrust_min)) - 1.0) / across;
    double *climb = kept + $climb;
    const pair force = of(slowed, plus(lateral(state[F], lean, *upright), of(DRAG * climb[0], lean)));
    const double rise = larger(thrust, 0.0) * *upright - times(force, conjugate(lean)).x - $gravity;
    if (!aligning) {
        climb[1] += (rise - climb[1]) * STEP / smaller($climb_from_s + kept[$samples] * STEP, $climbs_s);
        climb[1] = between(climb[1], $rise_max);
        climb[0] = between(climb[0] + STEP * (rise - climb[1] - climb[0] / $climb_s), $climb_max);
    }
    thrust = larger(thrust, 0.0) - climb[1] / *upright;
    const pair faster = of(elapsed, plus(lateral(force, lean, *upright), of(thrust, lean)));
    double *pushes = kept + $pushes;
    const double memory = smaller($expected_s + kept[$samples] * STEP, $turns_s);
    *pushes += (square(of(1.0 / elapsed, faster)) - *pushes) * STEP / memory;
    const pair unit = of(1.0 / larger(size, 1e-9), state[F]);
    const double further = (along - across) * times(conjugate(unit), faster).x;
    state[V] = plus(state[V], faster);
    state[F] = plus(state[F], of(-DRAG, plus(of(across, faster), of(further, unit))));
    state[L] = plus(state[L], leant);

    const double share = 0.5 * (1.0 + *upright); /* what is left of a lateral part in the mean of all directions */
    const double slope = 0.5 * DRAG * (along + across), of_force = slowed * share * share;
    const pair turn = times((pair){0.0, elapsed * share}, level);
    for (int k = 0; k < STATES; ++k)
        advance(&spread[0][k], STATES, turn, elapsed, slope, of_force, thrust);
    for (int k = 0; k < STATES; ++k) {
        for (int m = 0; m < STATES; ++m)
            spread[k][m] = conjugate(spread[k][m]);
        advance(spread[k], 1, turn, elapsed, slope, of_force, thrust);
    }
    for (int k = 0; k < STATES; ++k) {
        spread[k][k].y = 0.0;
        for (int m = 0; m < k; ++m) {
            spread[k][m] = spread[m][k];
            spread[m][k] = conjugate(spread[m][k]);
        }
    }
    return slowed;
}

/* Correct by one measurement, of so much of one of the state and so much of the accelerometer's bias. */
static void correct(
    pair state[STATES], pair spread[STATES][STATES], int measured, double of_it, pair of_accel_bias, pair innovation,
    double variance)
{
    pair column[STATES];
    for (int k = 0; k < STATES; ++k)
        column[k] = plus(of(of_it, spread[k][measured]), times(conjugate(of_accel_bias), spread[k][A]));
    const double scale = 1.0 / (plus(of(of_it, column[measured]), times(of_accel_bias, column[A])).x + variance);
    for (int k = 0; k < STATES; ++k) {
        state[k] = plus(state[k], times(column[k], of(scale, innovation)));
        for (int m = k; m < STATES; ++m) {
            spread[k][m] = minus(spread[k][m], of(scale, times(column[k], conjugate(column[m]))));
            spread[m][k] = conjugate(spread[k][m]);
        }
    }
    spread[F][F].x = larger(spread[F][F].x, $force_variance_min);
}

/* Correct by the expectation that one of the state is nothing. */
static void lasts(
    pair state[STATES], pair spread[STATES][STATES], int which, double expected, double least, double seconds,
    double memory, double *mean_square, double samples)
{
    const double long_s = seconds * (1.0 + $lasts_more * *mean_square / (expected * expected));
    const double variance = larger(*mean_square, least * least) * long_s / STEP;
    correct(state, spread, which, 1.0, (pair){0.0, 0.0}, of(-1.0, state[which]), variance);
    *mean_square += (0.5 * square(state[which]) - *mean_square) * STEP / smaller($expected_s + samples * STEP, memory);
}

/* Take a yaw rate into what is known of the gyroscope's bias about z: in the mean, no vehicle yaws. */
static void follow_yaw(double rate, double kept[$kept])
{
    rate = between(rate, $rate_max);
    double *bias = kept + $yaw_bias, *variance = bias + 1, *mean_square = bias + 2;
    if (kept[$samples] == 1.0) {
        *variance = BIAS_SD * BIAS_SD;
        *mean_square = $yaw_rate * $yaw_rate + rate * rate;
    }
    const double off = rate - *bias;
    if (BIAS_SD > 0.0)
        *variance += $bias_walk * $bias_walk * STEP;
    const double lasts = $yaw_s * (1.0 + *mean_square / ($yaw_rate * $yaw_rate));
    const double scale = 1.0 / (*variance + larger(*mean_square, $yaw_rate_min * $yaw_rate_min) * lasts / STEP);
    const double left = 1.0 - scale * *variance;
    double *back = kept + $yaw_back;
    back[1] += *variance * STEP;
    *bias = between(*bias + scale * *variance * off, $bias_max);
    *variance *= left;
    back[0] = scale * back[1] * off;
    back[1] *= left;
    *mean_square += (off * off - *mean_square) * STEP / smaller($expected_s + kept[$samples] * STEP, $airs_s);
}

/* Square of late corrections' sum, of each axis; last in `sums`, what its mean should be, with what they lowered. */
static double summed(pair moved, double lowered, double memory, double sums[3])
{
    sums[0] += moved.x - sums[0] * STEP / memory;
    sums[1] += moved.y - sums[1] * STEP / memory;
    sums[2] += larger(lowered, 0.0) - 2.0 * sums[2] * STEP / memory;
    return 0.5 * square(pair_at(sums));
}

/* Take a correction of the force, and by how much it lowered the variance, into the square of its walk. */
static void gauge(pair moved, double lowered, double kept[$kept])
{
    const double scatter = summed(moved, lowered, $corrected_s, kept + $corrections);
    const double beyond = $gauge * 2.0 * (scatter - $enough * kept[$corrections + 2]) / $corrected_s;
    double memory = smaller($breeze_s + kept[$samples] * STEP, $gusts_s);
    if (beyond < 0.0)
        memory = larger(memory, $fall_s);
    kept[$gust] = larger(kept[$gust] + beyond * STEP / memory, $calm * $calm);
}

/* Variance of a reading of the force, of each axis: a quarter of that of the change of how far it is off. */
static double noise(pair off, double kept[$kept])
{
    double *variance = kept + $noise;
    const pair change = kept[$samples] > 1.0 ? minus(off, pair_at(variance + 1)) : (pair){0.0, 0.0};
    variance[0] += (0.25 * square(change) - variance[0]) * STEP / $noise_s;
    variance[1] = off.x;
    variance[2] = off.y;
    return larger(variance[0], NOISE * NOISE / STEP);
}

/* Square of the random walk that takes the force to where it has lately been off by more than noise. */
static double sudden(const double kept[$kept])
{
    const double off = square(pair_at(kept + $missed));
    return larger(off - $sudden * larger(kept[$noise] * STEP, NOISE * NOISE) / $sudden_s, 0.0) / $sudden_s;
}

/* By how much a bias's variance is too small: corrections sum up to what they lower it by, or it jumped. */
static double jumped(pair moved, double lowered, double kept[$kept])
{
    const double scatter = summed(moved, lowered, $jump_s, kept + $moved);
    return larger(scatter - $jump * kept[$moved + 2], 0.0) * $jump_gain * STEP / $jump_s;
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

/* What is known with the first readings; a lean that is told is in the state. */
static void begin(pair state[STATES], pair spread[STATES][STATES], pair heading, pair rate, pair force,
                  double kept[$kept])
{
    double lean_variance = $lean_sd * $lean_sd, speed_variance = $speed_sd * $speed_sd;
    double bias_variance = BIAS_SD * BIAS_SD;
    if (kept[0] == INFINITY) {
        const double leant = square(state[L]) / ($leant_s * $leant_s), driven = $leant_s * $leant_s * $gravity;
        lean_variance = $told_sd * $told_sd;
        speed_variance = $told_speed * $told_speed + driven * driven * leant;
        const double turning = $told_turn * $told_turn + leant + $turn_noise * $turn_noise / STEP;
        const double share = bias_variance / (bias_variance + turning);
        state[B] = of(share, rate);
        bias_variance = (1.0 - share) * bias_variance;
    }
    const double offset_variance = ACCEL_BIAS_SD * ACCEL_BIAS_SD;
    for (int k = 0; k < STATES; ++k)
        for (int m = 0; m < STATES; ++m)
            spread[k][m] = (pair){0.0, 0.0};
    state[F] = times(heading, force);
    state[V] = (pair){0.0, 0.0};
    spread[F][F].x = NOISE * NOISE / STEP + offset_variance;
    spread[F][A] = of(-offset_variance, heading);
    spread[A][F] = of(-offset_variance, conjugate(heading));
    spread[L][L].x = lean_variance;
    spread[B][B].x = bias_variance;
    spread[A][A].x = offset_variance;
    spread[V][V].x = speed_variance;
    kept[$gust] = $breeze * $breeze;
    kept[$speed] = $speed_sd * $speed_sd;
    kept[$air] = $breath * $breath + 0.5 * square(force);
}

/* Take one sample into what is kept. Returns how far the attitude is to turn about x and y of the body beyond what the
 * gyroscope says, less its bias. */
static pair follow(const double gyro[3], const double accel[3], pair heading, double kept[$kept])
{
    const pair rate = both_between((pair){gyro[0], gyro[1]}, $rate_max);
    const pair reading = both_between((pair){accel[0], accel[1]}, $reading_max);
    pair *state = (pair *)(kept + $state);
    pair(*spread)[STATES] = (pair(*)[STATES])(kept + $spread);
    double *samples = kept + $samples;
    *samples += 1.0;
    const int first = *samples == 1.0;
    if (first) {
        kept[$thrust] = between(accel[2], $thrust_max * $gravity);
        kept[$twist] = 1.0;
        keep(kept + $before, rate);
        kept[$before + 2] = kept[$thrust];
    }
    const double elapsed = smaller(kept[1] + STEP, $gap_max);
    const int aligning = kept[0] < ALIGN_S;
    const pair level = times(heading, pair_at(kept + $twist));
    double upright;
    const double slowed = move(state, spread, rate, level, accel[2], elapsed, aligning, &upright, kept);
    if (first)
        begin(state, spread, heading, rate, of(1.0 / slowed, reading), kept);
    const pair bias_before = state[B];
    const double gust = larger(aligning ? $steady * $steady : kept[$gust], sudden(kept));
    spread[F][F].x += (gust + $drag_error * $drag_error * DRAG * DRAG * kept[$pushes]) * elapsed;
    double *turns = kept + $turns;
    *turns += (square(minus(rate, state[B])) - *turns) * STEP / smaller($expected_s + *samples * STEP, $turns_s);
    spread[L][L].x += ($turn_noise * $turn_noise + $turn_error * $turn_error * *turns) * elapsed;
    if (BIAS_SD > 0.0) /* one that is known to be none stays none */
        spread[B][B].x += $bias_walk * $bias_walk * elapsed;
    if (ACCEL_BIAS_SD > 0.0)
        spread[A][A].x += $accel_bias_walk * $accel_bias_walk * elapsed;
    const pair force_before = state[F], lean_before = state[L];
    const double force_variance = spread[F][F].x, bias_variance = spread[B][B].x;

    const pair climbing = of(DRAG * kept[$climb], state[L]);
    const pair expected = of(slowed, plus(lateral(state[F], state[L], upright), climbing));
    const pair off = both_between(minus(times(level, minus(reading, state[A])), expected), $force_max);
    const double white = noise(off, kept) + $model * $model * kept[$pushes] / STEP;
    double *missed = kept + $missed;
    missed[0] += (off.x - missed[0]) * STEP / $sudden_s;
    missed[1] += (off.y - missed[1]) * STEP / $sudden_s;
    correct(state, spread, F, 0.5 * slowed * (1.0 + upright), level, off, white);
    if (*samples * STEP > $gauge_from_s) /* the first corrections are those of the start */
        gauge(minus(state[F], force_before), force_variance - spread[F][F].x, kept);
    if (!aligning) {
        lasts(state, spread, V, $speed_sd, $speed_min, $speed_s, $speeds_s, kept + $speed, *samples);
        lasts(state, spread, F, $breath, $breath_min, $breath_s, $airs_s, kept + $air, *samples);
        if (BIAS_SD > 0.0)
            spread[B][B].x += jumped(minus(state[B], bias_before), bias_variance - spread[B][B].x, kept);
    }

    follow_yaw(gyro[2], kept);
    kept[2] = unchanged(gyro, accel, kept) ? kept[2] + STEP : 0.0;
    if (kept[2] >= $rest_s)
        correct(state, spread, B, 1.0, (pair){0.0, 0.0}, minus(rate, state[B]), $rest_noise * $rest_noise / STEP);

    const double limits[STATES] = {$reading_max, $lean_max, $bias_max, $accel_bias_max, $speed_max};
    for (int k = 0; k < STATES; ++k)
        state[k] = shorter(state[k], limits[k]);
    double *effect = kept + $effect;
    const pair found = times((pair){0.0, 1.0 / upright}, conjugate(level));
    const pair further = aligning ? times(found, minus(state[L], lean_before))
                                  : times(times(conjugate(heading), minus(bias_before, state[B])), pair_at(effect));
    effect[0] += STEP * (heading.x - effect[0] / $remembered_s);
    effect[1] += STEP * (heading.y - effect[1] / $remembered_s);
    kept[1] = 0.0;
    keep(kept + $leaning, times(conjugate(level), state[L]));
    return further;
}

/* Components of a tilt [rad] whose sine has these, below a right angle. */
static pair turned_by(pair lateral)
{
    const double sine = sqrt(square(lateral));
    return of(sine > 0.0 ? asin(smaller(sine, 1.0)) / sine : 1.0, lateral);
}

void att_snn_encode(att_snn_state *state, const double gyro[3], const double accel[3])
{
    const double size = accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2];
    const int rate_found = finite(gyro[0] + gyro[1] + gyro[2]), force_found = finite(size) && size > 0.0;
    const int aligned = ALIGN_S > 0.0 || BIAS_SD > 0.0 || ACCEL_BIAS_SD > 0.0 || LEAN_FED;
    if (rate_found && (YAW_FREE || aligned)) {
        yaw(state->heading, gyro[2] - state->alignment[$yaw_bias] - state->alignment[$yaw_back] / STEP);
        state->alignment[$yaw_back] = 0.0;
    }
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
    const pair lean = LEAN_FED ? turned_by(pair_at(state->alignment + $leaning)) : (pair){0.0, 0.0};
    if (rate_found) {
        const double *bias_found = state->alignment + $bias;
        pair rate = times(axes, (pair){gyro[0] - OFFSET[0] - bias_found[0] + turn.x / STEP,
                                    gyro[1] - OFFSET[1] - bias_found[1] + turn.y / STEP});
        keep(state->fed + 2, rate);
        if (LEAN_FED && force_found) {
            const pair tilt = times(axes, (pair){-lean.y, lean.x});
            rate = (pair){(tilt.x - state->fed[0]) / STEP, (tilt.y - state->fed[1]) / STEP};
        }
        state->input[0] = nearest(rate.x * GAIN[0]);
        state->input[1] = nearest(rate.y * GAIN[1]);
        state->input[2] = nearest((gyro[2] - OFFSET[2] - state->alignment[$yaw_bias]) * GAIN[2]);
    } else if (LEAN_FED) /* what made up for rounding and gaps before does not go on */
        for (int k = 0; k < 2; ++k)
            state->input[k] = nearest(state->fed[2 + k] * GAIN[k]);
    if (force_found) {
        const double *offset_found = state->alignment + $accel_bias;
        const pair read = {accel[0] - OFFSET[3] - offset_found[0], accel[1] - OFFSET[4] - offset_found[1]};
        const pair force = times(axes, LEAN_FED ? of(-$gravity, lean) : read);
        state->input[3] = nearest(led(state, 0, force.x) * GAIN[3]);
        state->input[4] = nearest(led(state, 1, force.y) * GAIN[4]);
        state->input[5] = nearest((accel[2] - OFFSET[5]) * GAIN[5]);
        state->forces += 1.0;
    }
    if (LEAN_FED)
        for (int k = 0; k < 2; ++k)
            state->fed[k] += state->input[k] / GAIN[k] * STEP;
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

void att_snn_reset_at(att_snn_state *state, const double roll_pitch[2])
{
    const double hover[3] = {0.0, 0.0, 0.0}, thrust[3] = {0.0, 0.0, $gravity};
    const double roll = roll_pitch[0], pitch = roll_pitch[1], x = sin(roll) * cos(pitch), y = sin(pitch);
    const double sine = sqrt(x * x + y * y), angle = atan2(sine, cos(roll) * cos(pitch)), size = larger(sine, 1e-12);
    const double turn[3] = {x / size * angle * ATT_SNN_RATE_HZ / TURNING, y / size * angle * ATT_SNN_RATE_HZ / TURNING, 0.0};
    att_snn_reset(state);
    if (!finite(roll) || !finite(pitch))
        return;
    for (int k = 0; k < SETTLING + TURNING; ++k) { /* a hover, and a turn into the attitude */
        att_snn_encode(state, k < SETTLING ? hover : turn, thrust);
        att_snn_step(state);
    }
    att_snn_state fresh; /* that was no flight: nothing of it is kept but the network's states */
    att_snn_reset(&fresh);
    state->forces = 0.0;
    for (int k = 0; k < 2; ++k) {
        state->fast[k] = state->slow[k] = 0.0;
        state->heading[k] = fresh.heading[k];
    }
    for (int k = 0; k < $kept; ++k)
        state->alignment[k] = fresh.alignment[k];
    state->alignment[0] = INFINITY; /* the start is over */
    state->alignment[$lean] = sin(pitch);
    state->alignment[$lean + 1] = -x;
    const pair told = turned_by((pair){sin(pitch), -x});
    state->fed[0] = -told.y;
    state->fed[1] = told.x;
    state->fed[2] = state->fed[3] = 0.0;
    const double factor = YAW_FREE ? (sine > 0.0 ? angle / sine : 1.0) : 1.0;
    const double at[2] = {YAW_FREE ? x * factor : roll, YAW_FREE ? y * factor : pitch};
    for (int k = 0; k < ATT_SNN_OUTPUTS; ++k)
        state->v_output[k] = (int32_t)rint(at[k] / SCALE) - state->v_direct[k];
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
