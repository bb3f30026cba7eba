/* $title:
 * $encoding + $hidden neurons, $parameters parameters, as on Loihi. Written by quadsim; no heap, no library, no variable outside the state. All that a step
 * computes is integers: floats are read by ${n}_encode$and_set_point and written by ${n}_$read. */
#ifndef ${N}_H
#define ${N}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${N}_RATE_HZ $rate
#define ${N}_INPUTS $inputs
#define ${N}_ENCODING $encoding
#define ${N}_HIDDEN $hidden
#define ${N}_OUTPUTS $outputs
/* The potential of an output divided by this is $quantity. */
#define ${N}_UNITS_PER_$UNIT $units

typedef struct {
    int32_t input[${N}_INPUTS]; /* last good readings$and_set_points, scaled: 1024 is 1.0 */
    struct {
        int32_t u, v; /* current and potential */
    } encoding[${N}_ENCODING];
    struct {
        int32_t u, v;
    } hidden[${N}_HIDDEN];
    struct {
        int32_t u, v;
    } output[${N}_OUTPUTS];
    uint16_t encoding_spikes; /* how many neurons spiked in the last step, */
    uint16_t hidden_spikes;
    uint16_t encoding_fired[${N}_ENCODING]; /* and which, in ascending order */
    uint16_t hidden_fired[${N}_HIDDEN];
    uint32_t skipped; /* samples with a reading that was not used */
    int32_t age, good; /* samples since the last good rate, and good ones since the start or a gap, each up to 20 */
#if CONTROLS
    double thrust; /* collective thrust per mass that is passed through [m/s^2] */
#endif
} ${n}_state;

/* Start at rest$with_set_point. */
void ${n}_reset(${n}_state *state);

#if CONTROLS
/* Take a set-point: roll, pitch [rad], yaw rate [rad/s], collective thrust per mass [m/s^2]. Each is clipped to its
 * limits, $tilt_limit rad, $yaw_rate_limit rad/s and 0...$thrust_max m/s^2; one that is NaN keeps its last value. */
void ${n}_set_point(${n}_state *state, const double set_point[4]);

#endif
/* Scale one reading, body rate [rad/s] and specific force [m/s^2], body x forward, y left, z up. A reading that
 * is not finite or beyond 4000 deg/s or 32 g, or a force of exactly zero, leaves the last good one and is counted
 * in `skipped`; so does a rate that jumps by more than $rate_step rad/s. After $hold such samples the rate is 0.
#if CONTROLS
 * This network reads an attitude: for accel give it $gravity m/s^2 times the world's up in body axes,
 * (-sin(pitch), sin(roll) cos(pitch), cos(roll) cos(pitch)), of any estimate.
#endif
 */
void ${n}_encode(${n}_state *state, const double gyro[3], const double accel[3]);

/* Run the network for one sample. */
void ${n}_step(${n}_state *state);

#if ESTIMATES
/* Roll and pitch [rad] now. */
void ${n}_attitude(const ${n}_state *state, double roll_pitch[${N}_OUTPUTS]);
#endif
#if CONTROLS
/* Angular acceleration, body axes, within +-$bound rad/s^2, and the thrust that was asked for. */
void ${n}_action(const ${n}_state *state, double action[4]);
#endif

#ifdef __cplusplus
}
#endif

#endif
