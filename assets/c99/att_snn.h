/* Att-SNN, a spiking network that estimates roll and pitch from an IMU, as on Loihi: $encoding + $hidden
 * neurons, $parameters parameters. Written by quadsim; integers only between att_snn_encode and att_snn_attitude, no
 * heap, no library but that of <math.h>. */
#ifndef ATT_SNN_H
#define ATT_SNN_H

#include <stdint.h>

#define ATT_SNN_RATE_HZ $rate
#define ATT_SNN_INPUTS 6
#define ATT_SNN_ENCODING $encoding
#define ATT_SNN_HIDDEN $hidden
#define ATT_SNN_OUTPUTS 2
/* The sum of both potentials of an output divided by this is radians, of roll and pitch or of a tilt that att_snn_attitude reads. */
#define ATT_SNN_UNITS_PER_RADIAN $units

typedef struct {
    int32_t input[ATT_SNN_INPUTS];      /* last good readings, scaled: 1024 is 1.0 */
    int32_t u_encoding[ATT_SNN_ENCODING];
    int32_t v_encoding[ATT_SNN_ENCODING];
    int32_t u_hidden[ATT_SNN_HIDDEN];
    int32_t v_hidden[ATT_SNN_HIDDEN];
    int32_t u_output[ATT_SNN_OUTPUTS];
    int32_t v_output[ATT_SNN_OUTPUTS];
    int32_t v_direct[ATT_SNN_OUTPUTS];   /* of the integrators that take the inputs past the spikes */
    uint8_t s_encoding[ATT_SNN_ENCODING]; /* spikes of the last step, 0 or 1 */
    uint8_t s_hidden[ATT_SNN_HIDDEN];
    double forces;  /* samples in the low-passes of the lateral forces */
    double fast[2];
    double slow[2];
    double heading[2]; /* cosine and sine of the angle by which the body has yawed since the reset */
    double fed[4]; /* the tilt that the rates that were fed sum up to, and the last read of the body, less the bias */
    double alignment[$kept]; /* time since the start, and the filter of the tilt then and of both biases */
} att_snn_state;

/* Start at rest, with an unknown attitude. */
void att_snn_reset(att_snn_state *state);

/* Start at a roll and pitch [rad] that are known, to half a degree: the accelerometer's bias is found by them. Takes as
 * long as $warming samples. Where one is not finite, the attitude is unknown. */
void att_snn_reset_at(att_snn_state *state, const double roll_pitch[2]);

/* Scale one reading, body rate [rad/s] and specific force [m/s^2], body x forward, y left, z up. A reading that
 * is not finite, or a force of exactly zero, is missing and leaves the last good one. */
void att_snn_encode(att_snn_state *state, const double gyro[3], const double accel[3]);

/* Run the network for one sample. */
void att_snn_step(att_snn_state *state);

/* Roll and pitch [rad] now. */
void att_snn_attitude(const att_snn_state *state, double roll_pitch[2]);

#endif
