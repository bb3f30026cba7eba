/* Att-SNN, a spiking network that estimates $task from an IMU, as on Loihi: $encoding + $hidden
 * neurons, $parameters parameters. Written by quadsim; integers only between att_snn_encode and att_snn_attitude, no
 * heap, no library. */
#ifndef ATT_SNN_H
#define ATT_SNN_H

#include <stdint.h>

#define ATT_SNN_RATE_HZ $rate
#define ATT_SNN_INPUTS 6
#define ATT_SNN_ENCODING $encoding
#define ATT_SNN_HIDDEN $hidden
#define ATT_SNN_OUTPUTS $outputs
/* The potential of an output divided by this is $quantity. */
#define ATT_SNN_UNITS_PER_$UNIT $units

typedef struct {
    int32_t input[ATT_SNN_INPUTS];      /* last good readings, scaled: 1024 is 1.0 */
    int32_t u_encoding[ATT_SNN_ENCODING];
    int32_t v_encoding[ATT_SNN_ENCODING];
    int32_t u_hidden[ATT_SNN_HIDDEN];
    int32_t v_hidden[ATT_SNN_HIDDEN];
#if AFTER_SPIKE
    int32_t a_hidden[ATT_SNN_HIDDEN]; /* after-spike currents */
#endif
    int32_t u_output[ATT_SNN_OUTPUTS];
    int32_t v_output[ATT_SNN_OUTPUTS];
    uint8_t s_encoding[ATT_SNN_ENCODING]; /* spikes of the last step, 0 or 1 */
    uint8_t s_hidden[ATT_SNN_HIDDEN];
    uint32_t skipped; /* samples with a reading that was not used */
} att_snn_state;

/* Start at rest. */
void att_snn_reset(att_snn_state *state);

/* Scale one reading, body rate [rad/s] and specific force [m/s^2], body x forward, y left, z up. A reading that
 * is not finite or beyond 4000 deg/s or 32 g, or a force of exactly zero, leaves the last good one and is counted
 * in `skipped`. */
void att_snn_encode(att_snn_state *state, const double gyro[3], const double accel[3]);

/* Run the network for one sample. */
void att_snn_step(att_snn_state *state);

/* $what now. */
void att_snn_attitude(const att_snn_state *state, double $name[ATT_SNN_OUTPUTS]);

#endif
