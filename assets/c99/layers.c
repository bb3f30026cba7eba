#include "network.h"

enum { SOURCES = sizeof ((network_state *)0)->spikes, FIRST = SOURCES - NETWORK_NEURONS, STATE_MAX = 8388607 };

/* Connections from some sources to some neurons. Weights are halves of the chip's mantissas, by source; a half of a
 * neuron's mantissa is `unit` units of state. */
typedef struct {
    int from, sources, to, targets;
    const int8_t *weight;
    const uint8_t *unit;
} synapses;

$tables
static const synapses SYNAPSES[] = {
$synapses{0, 0, 0, 0, 0, 0}};

/* Of each neuron: decays in units of 1/4096, threshold and bias. */
static const int16_t DU[NETWORK_NEURONS] = $du;
static const int16_t DV[NETWORK_NEURONS] = $dv;
static const int32_t THRESHOLD[NETWORK_NEURONS] = $vth;
static const int32_t BIAS[NETWORK_NEURONS] = $bias;
#if NETWORK_ENCODED
static const int16_t ENCODER[NETWORK_ENCODED][NETWORK_INPUTS + 1] = $encoders; /* the last is of a constant 1.0 */
#endif

/* Negative numbers are shifted right with their sign, as every compiler of note does. */
typedef char shift_keeps_the_sign[(-1 >> 1) == -1 ? 1 : -1];

/* The part of x that a decay leaves, rounded toward zero. */
static int32_t decay(int32_t x, int32_t d)
{
    const int32_t left = (int32_t)(((int64_t)(x < 0 ? -x : x) * (4096 - d)) >> 12);
    return x < 0 ? -left : left;
}

/* Two's complement of 1 + `bits` bits. */
static int32_t wrap(int32_t x, int bits) { return (int32_t)((uint32_t)x << (31 - bits)) >> (31 - bits); }

static void deliver(const synapses *each, const uint8_t *spikes, int32_t *arriving)
{
    int32_t sum[NETWORK_NEURONS] = {0};
    const int8_t *weight = each->weight;
    for (int k = 0; k < each->sources; ++k, weight += each->targets)
        if (spikes[each->from + k])
            for (int j = 0; j < each->targets; ++j)
                sum[j] += weight[j];
    for (int j = 0; j < each->targets; ++j)
        arriving[each->to + j] += sum[j] * each->unit[j];
}

#if NETWORK_ENCODED
/* What the inputs add to the potential of neuron i: a bias in steps of 16. */
static int32_t drive(network_state *state, int i, const int32_t *input)
{
    uint32_t total = (uint32_t)(ENCODER[i][NETWORK_INPUTS] * NETWORK_INPUT_ONE); /* sums wrap until the last */
    for (int k = 0; k < NETWORK_INPUTS; ++k)
        total += (uint32_t)(ENCODER[i][k] * input[k]);
    state->current[i] = wrap(decay(state->current[i], DU[i]) + (int32_t)total / 16, 23);
    const int32_t bias = state->current[i] / 16;
    return (bias > 4095 ? 4095 : bias < -4095 ? -4095 : bias) * 16;
}
#endif

void network_reset(network_state *state) { *state = (network_state){.spikes = {0}}; }

void network_step(network_state *state, const int32_t input[NETWORK_INPUTS])
{
    int32_t arriving[NETWORK_NEURONS] = {0};
    for (const synapses *each = SYNAPSES; each->targets; ++each)
        deliver(each, state->spikes, arriving);
    for (int i = 0; i < NETWORK_NEURONS; ++i) {
        const int32_t u = wrap(decay(state->u[i], DU[i]) + wrap(arriving[i], 21), 23);
        int32_t v = decay(state->v[i], DV[i]) + u + BIAS[i];
#if NETWORK_ENCODED
        if (i < NETWORK_ENCODED)
            v += drive(state, i, input);
#endif
        v = v > STATE_MAX ? STATE_MAX : v < -STATE_MAX ? -STATE_MAX : v;
        state->u[i] = u;
        state->spikes[FIRST + i] = v > THRESHOLD[i];
        state->v[i] = v > THRESHOLD[i] ? 0 : v;
    }
#if !NETWORK_ENCODED
    for (int k = 0; k < NETWORK_INPUTS; ++k)
        state->spikes[k] = input[k] != 0;
#endif
}

void network_outputs(const network_state *state, int32_t output[NETWORK_OUTPUTS])
{
    for (int k = 0, i = NETWORK_NEURONS - NETWORK_OUTPUTS; k < NETWORK_OUTPUTS; ++k, ++i)
        output[k] = NETWORK_SPIKES ? state->spikes[FIRST + i] : state->v[i];
}
