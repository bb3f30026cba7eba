/* Att-SNN, a spiking circuit that estimates the world's up from an IMU:
 * $vectors vectors that turn with the body, $gates gated innovations, $parameters parameters, as on Loihi.
 * Written by quadsim; no heap, no library, no variable outside the state. All that a step computes is
 * integers: floats are read by ${n}_encode and written by ${n}_attitude. */
#ifndef ${N}_H
#define ${N}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ${N}_RATE_HZ $rate
#define ${N}_INPUTS 6
#define ${N}_VECTORS $vectors
#define ${N}_GATES $gates
#define ${N}_OUTPUTS 3
/* A component of vector $output divided by this is a component of up. */
#define ${N}_UNITS_PER_ONE $units

/* Axes come first: x, y and z of the body. */
typedef struct {
    int32_t input[${N}_INPUTS]; /* last good readings, scaled */
    int32_t angle[3], force[3]; /* of the readings, what no spike has represented yet */
    int32_t x[3][${N}_VECTORS]; /* vectors, */
    int32_t y[3][${N}_VECTORS]; /* their somas, */
    int32_t turned[3][${N}_VECTORS]; /* and what the next step takes from them for the turn */
    int32_t drive[3][${N}_GATES]; /* currents of the innovations, */
    int32_t z[3][${N}_GATES]; /* and their somas */
    int32_t felt[3][3]; /* force, rate and surprise */
    int32_t gate[${N}_GATES];
    int32_t bias[3], bias_soma[3], bias_spike[3], bias_due[3]; /* of the gyroscope */
    int32_t ring; /* steps, counted around the ring of thresholds from 1 */
    uint32_t skipped; /* samples with a reading that was not used */
    int32_t age, good; /* samples since the last good rate, and good ones since the start or a gap, each up to 20 */
    int8_t passed[3][${N}_GATES]; /* spikes of the innovations */
} ${n}_state;

/* Start at rest. */
void ${n}_reset(${n}_state *state);

/* Scale one reading, body rate [rad/s] and specific force [m/s^2], body x forward, y left, z up. A reading
 * that is not finite or beyond 4000 deg/s or 32 g, or a force of exactly zero, leaves the last good one and
 * is counted in `skipped`; so does a rate that jumps by more than $rate_step rad/s. After $hold such samples the rate is 0. */
void ${n}_encode(${n}_state *state, const double gyro[3], const double accel[3]);

/* Run the circuit for one sample. */
void ${n}_step(${n}_state *state);

/* The world's up in body axes, not of length 1: roll is atan2(up[1], up[2]),
 * pitch atan2(-up[0], sqrt(up[1] * up[1] + up[2] * up[2])), now. */
void ${n}_attitude(const ${n}_state *state, double up[${N}_OUTPUTS]);

#ifdef __cplusplus
}
#endif

#endif
