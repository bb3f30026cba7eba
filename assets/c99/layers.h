/* A chain of layers of spiking neurons in the integers of Loihi, written by quadsim. No heap, no library, no variable
 * outside the state. A step takes arrays of NETWORK_NEURONS words on the stack. */
#ifndef NETWORK_H
#define NETWORK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define NETWORK_INPUTS $inputs
#define NETWORK_ENCODED $encoded /* neurons that inputs drive without spikes; 0: inputs are spikes, 0 or 1 */
#define NETWORK_NEURONS $neurons
#define NETWORK_OUTPUTS $outputs /* the last of them */
#define NETWORK_SPIKES $spiking /* 1: the outputs are spikes, 0: they are potentials */
#define NETWORK_INPUT_ONE $input_one /* an encoded input of 1.0; the largest is 32767 */
#define NETWORK_ONE $one /* an output potential of 1.0 */

typedef struct {
    int32_t u[NETWORK_NEURONS], v[NETWORK_NEURONS]; /* currents and potentials */
#if NETWORK_ENCODED
    int32_t current[NETWORK_ENCODED]; /* of the encoded inputs */
    uint8_t spikes[NETWORK_NEURONS];
#else
    uint8_t spikes[NETWORK_INPUTS + NETWORK_NEURONS]; /* of the inputs first */
#endif
} network_state;

/* Start at rest. */
void network_reset(network_state *state);

/* One step: each layer reads the spikes of the step before. */
void network_step(network_state *state, const int32_t input[NETWORK_INPUTS]);

/* The outputs after a step: spikes or potentials. */
void network_outputs(const network_state *state, int32_t output[NETWORK_OUTPUTS]);

#ifdef __cplusplus
}
#endif

#endif
