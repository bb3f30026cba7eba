"""Att-SNN on the emulated chip: the host drives the encoding layer, the rest is the chip's integers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from quadsim.runs.block import block_type, matrix, packed, vector
from quadsim.runs.compiled import njit

from ..loihi.chip import partition
from ..loihi.neurons import (
    BIAS_MANT_MAX,
    DECAY_ONE,
    STATE_ONE,
    VTH_MAX,
    Chip,
    ChipState,
    LoihiLayer,
    LoihiNetwork,
    decay,
    shift,
    step,
    wrap,
)
from .encoder import ENCODER, encode_sample, input_scaling
from .forward import BIAS_EXP
from .weights_file import NetworkConfig, Tensors, exponents

Array = NDArray[np.float64]


class Host(NamedTuple):
    """What the host of a chip encodes with."""

    offset: Array  #: of the readings, shape (6,) [rad/s, m/s²]
    gain: Array  #: of the readings, shape (6,)
    w_in: NDArray[np.int32]  #: mantissas of the encoding weights by source, shape (inputs, h0)
    decay: NDArray[np.int32]  #: decays of the encoding layer's currents, shape (h0,)


class OnLoihi:
    """Att-SNN in integers: the encoding current on the host, all that spikes and the outputs on the chip.

    Raises:
        ValueError: The network is not quantised, not in the chip's time convention, or does not fit.
    """

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Place the network on the chip."""
        if config.model != "att-snn" or not config.quantised or config.recurrent_delay != 1:
            raise ValueError("the chip needs quantised weights of att-snn with a recurrent delay of 1")
        none = {"w_after": np.zeros((config.hidden, 1)), "syn_after": np.full(config.hidden, DECAY_ONE)}
        w = {name: value.astype(np.int64) for name, value in (none | tensors).items()}
        hidden = LoihiLayer(
            w_in=w["w_ff"],
            w_rec=w["w_rec"],
            du=w["syn1"],
            dv=w["mem1"],
            exp_in=exponents(w, "w_ff"),
            exp_rec=exponents(w, "w_rec"),
            w_after=w["w_after"][:, 0],
            d_after=w["syn_after"],
            exp_after=exponents(w, "w_after"),
        )
        outputs = LoihiLayer(w_in=w["w_out"], du=w["syn2"], dv=w["mem2"], vth=VTH_MAX)
        self.chip = LoihiNetwork([LoihiLayer(w_in=None, dv=w["mem0"], bias_exp=BIAS_EXP), hidden, outputs])
        self.cores = partition(self.chip.layers)
        w_in = np.ascontiguousarray(w["w_in"].T, np.int32)
        self.host = Host(*input_scaling(config.inputs), w_in, w["syn0"].astype(np.int32))
        self.steps, self.scale = config.steps_per_sample, config.output_scale / STATE_ONE
        self.outputs, self.kernel = config.n_outputs, _run_on_loihi
        parts = self.host._asdict() | self.chip.parameters._asdict()
        self.network, self.one_step = (
            packed(parts | {"settings": np.array([steps, self.scale, self.outputs])})
            for steps in (self.steps, 1)
        )
        first, neurons = self.chip.sizes[0], sum(self.chip.sizes)
        layout = {"encoder": (ENCODER, ()), "current": (np.int32, (first,)), "spikes": (np.int8, (neurons,))}
        self.state = block_type(layout | {name: (np.int32, (neurons,)) for name in ("u", "v", "a", "bias")})


@njit(cache=True)
def host_and_chip(block):
    """`Host` and `Chip` in the block of `OnLoihi.network`, in compiled code."""
    w_in, du = matrix(block, 2, np.int32), vector(block, 3, np.int32)
    host = Host(vector(block, 0, np.float64), vector(block, 1, np.float64), w_in, du)
    weights, first, end = matrix(block, 4, np.int16), vector(block, 5, np.int32), vector(block, 6, np.int32)
    bias_exp, du = vector(block, 7, np.int32), vector(block, 8, np.int32)
    dv, vth = vector(block, 9, np.int32), vector(block, 10, np.int32)
    after, d_after = vector(block, 11, np.int32), vector(block, 12, np.int32)
    return host, Chip(weights, first, end, bias_exp, du, dv, vth, after, d_after)


@njit(cache=True)
def loihi_state(block):
    """Currents of the encoding layer, (h0,), and `ChipState` in the block of a copy's state."""
    current, spikes = vector(block, 1, np.int32), vector(block, 2, np.int8)
    u, v = vector(block, 3, np.int32), vector(block, 4, np.int32)
    a, bias = vector(block, 5, np.int32), vector(block, 6, np.int32)
    return current, ChipState(spikes, u, v, a, bias)


@njit(cache=True, nogil=True)
def _run_on_loihi(gyro, accel, set_points, network, states, out):
    host, chip = host_and_chip(network)
    x = np.empty(host.w_in.shape[0])
    more = x.size - 6
    steps, scale, count = vector(network, 13, np.float64)
    sources, sums = np.empty(chip.weights.shape[0], np.int32), np.zeros(chip.weights.shape[1], np.int32)
    for n in range(states.shape[0]):
        encoder = vector(states[n], 0, ENCODER)[0]
        current, state = loihi_state(states[n])
        outputs = state.v[state.v.size - int(count) :]
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[n, 3 * t : 3 * t + 3], accel[n, 3 * t : 3 * t + 3], host, encoder)
            x[:6] = encoder.inputs
            for k in range(more):
                x[6 + k] = set_points[n, more * t + k]
            for _ in range(int(steps)):
                drive(x, host, current, state.bias, sums)
                step(chip, state, sources, sums)
            for o in range(outputs.size):
                out[n, outputs.size * t + o] = outputs[o] * scale


@njit(cache=True, inline="always")
def drive(x, host, current, bias, sums):
    """Advance the host's currents of the encoding layer by one step; write them as bias mantissas.

    Args:
        x: Integer inputs, shape (inputs,), a multiple of 3.
        host: What the host encodes with.
        current: Currents [state units], shape (h0,); changed.
        bias: Bias mantissas of the chip's neurons, whose first h0 are the encoding layer; changed.
        sums: Zeros, int32, at least (h0,), to add in; zeros again afterwards.
    """
    total = sums[: current.size]
    for k in range(0, host.w_in.shape[0], 3):
        a, b, c = np.int32(x[k]), np.int32(x[k + 1]), np.int32(x[k + 2])
        w_a, w_b, w_c = host.w_in[k], host.w_in[k + 1], host.w_in[k + 2]
        for i in range(total.size):
            total[i] += np.int32(np.int32(a * w_a[i]) + np.int32(b * w_b[i])) + np.int32(c * w_c[i])
    for i in range(current.size):
        # Mantissas of 1/256 times inputs of 1/1024 are 2^-18; a state unit is 2^-14.
        u = wrap(np.int32(decay(current[i], host.decay[i]) + shift(total[i], 4)), 23)
        current[i], total[i] = u, 0
        bias[i] = min(max(shift(u, BIAS_EXP), np.int32(-BIAS_MANT_MAX)), np.int32(BIAS_MANT_MAX))
