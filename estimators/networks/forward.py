"""Att-SNN, compiled: 6 inputs -> LIF -> recurrent LIF -> 2 leaky integrators (LI).

A controller is the same network with 9 inputs (readings, then set-points) and 3 outputs.

The step of all neurons is `estimators.loihi.neurons.step_network`. A quantised network runs in the integers
of the chip; other networks run in floats. The host computes the current of the encoding layer from the input
of the same step:

    u[t] = D(u[t-1], τ_syn) + W x[t]

On the chip, this current arrives as a bias, rounded toward zero to steps of 16 state units. The outputs never
spike.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.compiled import njit

from ..loihi.chip import partition
from ..loihi.layers import LoihiLayer
from ..loihi.neurons import (
    BIAS_MANT_MAX,
    STATE_ONE,
    VTH_EXP,
    VTH_MAX,
    NeuronState,
    decay,
    either,
    list_spikes,
    neurons_of,
    shift,
    step_network,
    wrap,
)
from .encoder import ENCODED, INPUT_ONE, Scaling, encode_sample, encoder_fields, input_scaling
from .layer_parameters import DECAY, EXPONENTS, PARAMETERS, THRESHOLDS, Weights, complete, of_layer
from .weights_file import READINGS, NetworkConfig, Tensors

Array = NDArray[np.float64]
BIAS_EXP = 4
"""Exponent of the bias with which the host drives the encoding layer, in steps of 2^4 state units."""


class PackedWeights(NamedTuple):
    """Weights in the layout of the kernels; the neurons are in the order encoding, hidden, outputs."""

    encoders: NDArray[np.int32] | Array
    """Weights for integer inputs by source, with the decays in the last row, (inputs + 1, h0)."""
    table: NDArray[np.int32] | Array  #: rows of `neurons_of`
    weights: NDArray[np.int16] | NDArray[np.floating]  #: see `Neurons`


def real_weights(config: NetworkConfig, tensors: Tensors) -> Weights[Array]:
    """Return weights and time constants of a spiking network in units of 1.0."""
    tensors = complete(tensors, config.quantised)
    values = {name: value.astype(np.float64) for name, value in tensors.items()}
    if config.quantised:
        values = {name: PARAMETERS[name].kind.real(whole) for name, whole in values.items()}
        for name, exponents in EXPONENTS.items():
            values[name] *= np.exp2(values[exponents])[:, None]
    return Weights(**{name: values[name] for name in Weights._fields})


def packed(w: Weights[Any], quantised: bool, recurrent_delay: int = 1) -> PackedWeights:
    """Convert weights to the layout of the kernels; floats keep the type of the weights between neurons."""
    (h1, h0), outputs = w.w_ff.shape, len(w.w_out)
    weights = np.zeros((recurrent_delay, h0 + h1, h1 + outputs), w.w_ff.dtype)
    weights[0, :h0, :h1], weights[0, h0:, h1:], weights[-1, h0:, :h1] = w.w_ff.T, w.w_out.T, w.w_rec.T
    table, start = np.zeros((4, h0 + h1 + outputs)), 0
    for layer, size in {"encoding": h0, "hidden": h1, "outputs": outputs}.items():
        constants = {"vth": THRESHOLDS[layer]} | of_layer(w._asdict(), layer)
        for row, role in enumerate(("du", "dv", "vth")):
            table[row, start : start + size] = constants[role]
        start += size
    encoders = np.vstack([w.w_in.T.astype(np.float64) / INPUT_ONE, w.syn0])
    if quantised:  # the chip has no higher threshold; an output that gets there all the same is reset
        table[:2] = DECAY.whole(table[:2])
        table[2] = np.minimum(table[2] * STATE_ONE, VTH_MAX << VTH_EXP)
        encoders = np.vstack([w.w_in.T * (STATE_ONE >> VTH_EXP), table[0, :h0]])
        weights = np.rint(weights * STATE_ONE).astype(np.int16)
        return PackedWeights(np.rint(encoders).astype(np.int32), np.rint(table).astype(np.int32), weights)
    return PackedWeights(encoders, table, weights)


class Spiking:
    """Att-SNN as a `NetworkCore`; a quantised network computes in the integers of the chip."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        one = float(STATE_ONE) if config.quantised else 1.0
        self.outputs = config.n_outputs
        weights = packed(real_weights(config, tensors), config.quantised, config.recurrent_delay)
        number = weights.table.dtype
        self.sizes = config.encoding, config.hidden, self.outputs
        n = sum(self.sizes)
        targets = config.hidden + self.outputs
        kept = [("current", config.encoding), ("v", n), ("u", targets)]
        kept += [("before", n)] * (config.recurrent_delay == 2)
        self.state = np.dtype([*encoder_fields(number), *((name, number, size) for name, size in kept)])
        self.scaling, self.weights = input_scaling(config.inputs), weights
        settings = np.array([*np.ravel(self.scaling), config.output_scale / one])
        self.arrays, self.kernel = (settings, *weights), run_spiking

    def spikes(self, states: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return which neurons spiked in the last step, from records (n,), shape (n, neurons)."""
        return states["v"] > self.weights.table[2]

    def active(self, states: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return which neurons had a current, a potential or a bias in the last step, (n, neurons)."""
        used, first = states["v"] != 0, self.sizes[0]
        used[:, :first] |= np.abs(states["current"]) >= 1 << BIAS_EXP
        used[:, first:] |= states["u"] != 0
        return used


@njit(cache=True, nogil=True)
def run_spiking(gyro, accel, set_points, settings, encoders, table, weights, states, out):
    """Run n copies over sequences of T samples, and update their states.

    Args:
        gyro: Body rate, sample after sample, shape (n, 3 T) [rad/s].
        accel: Specific force, same shape [m/s²].
        set_points: For a controller, integer set-points, shape (n, 3 T); otherwise not read.
        settings: The scaling of the readings, (12,), and the unit of the outputs.
        encoders: Part of `PackedWeights`.
        table: Table of the neurons, part of `PackedWeights`.
        weights: Weights between neurons, part of `PackedWeights`.
        states: Numbers of records of `Spiking.state`, shape (n, words); changed.
        out: Outputs after each sample, shape (n, outputs T); written.
    """
    scaling, scale = Scaling(settings[:READINGS], settings[READINGS:12]), settings[12]
    inputs, h0 = encoders.shape[0] - 1, encoders.shape[1]
    neurons, number = neurons_of(weights, h0, table), table.dtype
    more, (_, sources, targets), hidden = inputs - READINGS, weights.shape, weights.shape[1] - h0
    x, total, sums = np.empty(inputs, number), np.zeros(h0, number), np.zeros(targets, number)
    bias, spikes, earlier = (
        np.zeros(h0, number),
        np.empty(sources + 2, np.int32),
        np.empty(sources + 2, np.int32),
    )
    for c in range(states.shape[0]):
        kept = states[c]
        current, rest = kept[ENCODED : ENCODED + h0], kept[ENCODED + h0 :]
        potentials, before = rest[: h0 + targets], rest[h0 + 2 * targets :]
        state = NeuronState(potentials[:h0], rest[h0 + targets : h0 + 2 * targets], potentials[h0:])
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[c, 3 * t : 3 * t + 3], accel[c, 3 * t : 3 * t + 3], scaling, kept)
            for k in range(READINGS):
                x[k] = kept[k]
            for k in range(more):
                x[READINGS + k] = set_points[c, more * t + k]
            list_spikes(neurons, state.first_v, state.v, spikes)
            if before.size:
                list_spikes(neurons, before[:h0], before[h0:], earlier)
                before[:] = potentials
            advance_encoders(x, encoders, current, bias, total)
            step_network(neurons, bias, state, spikes, earlier, sums)
            for o in range(targets - hidden):
                v = state.v[hidden + o]
                out[c, (targets - hidden) * t + o] = 0.0 if v > neurons.vth[hidden + o] else v * scale


@njit(inline="always")
def advance_encoders(x, encoders, current, bias, total):
    """Advance the host's currents of the encoding layer by one step, and write the resulting bias.

    Args:
        x: Integer inputs, shape (inputs,), a multiple of 3.
        encoders: Part of `PackedWeights`.
        current: Currents [state units], shape (h0,); changed.
        bias: Addition to the potentials, shape (h0,); written.
        total: Zeros (h0,), as temporary storage; zeros again afterwards.
    """
    for k in range(0, x.size, 3):
        x0, x1, x2 = x[k], x[k + 1], x[k + 2]
        for i in range(total.size):
            total[i] += _products(x0, encoders[k, i], x1, encoders[k + 1, i], x2, encoders[k + 2, i])
    last = x.size
    for i in range(total.size):
        current[i] = _driven(current[i], encoders[last, i], total[i])
        bias[i] = _bias(current[i])
        total[i] = 0


_products = either(
    lambda a, w, b, y, c, z: w * a + y * b + z * c,
    lambda a, w, b, y, c, z: np.int32(np.int32(np.int32(a * w) + np.int32(b * y)) + np.int32(c * z)),
)
"""Returns the sum of three products."""
# Mantissas of 1/256 times inputs of 1/1024 are 2^-18; a state unit is 2^-14.
_driven = either(
    lambda current, d, total: current * d + total,
    lambda current, d, total: wrap(np.int32(decay(current, d) + shift(total, 4)), 23),
)
"""Returns the current of an encoding neuron after a step."""
_bias = either(
    lambda current: current,
    lambda current: np.int32(min(max(shift(current, BIAS_EXP), -_LARGEST), _LARGEST) << BIAS_EXP),
)
"""Returns the addition of a current to the potential."""
_LARGEST = np.int32(BIAS_MANT_MAX)


class OnLoihi(Spiking):
    """Att-SNN in integers: the encoding currents on the host, all neurons on the chip.

    Raises:
        ValueError: The network is not quantised, does not have the chip's time convention, or does not fit
            the chip.
    """

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        if config.model != "att-snn" or not config.quantised or config.recurrent_delay != 1:
            raise ValueError("the chip needs quantised weights of att-snn with a recurrent delay of 1")
        super().__init__(config, tensors)
        self.layers = chip_layers(config, tensors)
        self.cores = partition(self.layers)


def chip_layers(config: NetworkConfig, tensors: Tensors) -> list[LoihiLayer]:
    """Return the layers of a quantised network: encoding, hidden, outputs."""
    w = {name: value.astype(np.int64) for name, value in tensors.items()}
    encoding, hidden, outputs = (of_layer(w, layer) for layer in ("encoding", "hidden", "outputs"))
    encoding["w_in"] = np.zeros((config.encoding, 0), np.int64)  # its inputs stay on the host
    return [LoihiLayer(**encoding), LoihiLayer(**hidden), LoihiLayer(**outputs, vth=VTH_MAX)]
