"""Trained networks as estimators: Att-SNN in float64 and on emulated Loihi, and its non-spiking twin Att-RNN.

A network gets scaled readings and nothing else (`estimators.networks.encoder`): there is no filter in front
of it and no connection from its inputs to its outputs beside the neurons. As in the paper, it never
gets the initial attitude. Nothing here imports torch: inference is compiled.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, Protocol, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import OtherSensors
from quadsim.rotation import roll_pitch_of_up
from quadsim.runs.block import Words, block_type, fields, matrix, packed, vector, zero_blocks
from quadsim.runs.compiled import njit

from ..loihi.chip import partition
from ..loihi.neurons import (
    BIAS_MANT_MAX,
    STATE_ONE,
    VTH_MAX,
    Chip,
    LoihiLayer,
    LoihiNetwork,
    decay,
    shift,
    wrap,
)
from ..loihi.neurons import step as step_chip
from . import gru
from .encoder import ENCODER, encode_sample, input_scaling
from .forward import (
    BIAS_EXP,
    MATRICES,
    TIME_CONSTANTS,
    Settings,
    Weights,
    network_block,
    run_floats,
    run_quantised,
    state_type,
)
from .weights_file import LEVEL_UP, NetworkConfig, Tensors, attitude_network, exponents, shipped_network

Array = NDArray[np.float64]
NO_SET_POINTS = np.zeros((0, 0))


def create_network(name: str, rate_hz: float = 200.0, weights: str | Path | None = None) -> NetworkEstimator:
    """Make a network estimator.

    Args:
        name: "att-snn" (float64), "att-snn-loihi" (the same network in integers) or "att-rnn".
        rate_hz: Samples per second; the one that the weights were trained for.
        weights: Weights file; None: the ones that ship.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Unknown name, a file of another kind of network, or another sample rate.
    """
    if name not in ("att-snn", "att-snn-loihi", "att-rnn"):
        raise ValueError(f"no network {name!r}, there are att-snn, att-snn-loihi and att-rnn")
    model = name.removesuffix("-loihi")
    config, tensors = shipped_network(model) if weights is None else attitude_network(weights)
    if config.model != model:
        raise ValueError(f"{weights}: weights of {config.model}, {name} needs {model}")
    if not np.isclose(rate_hz, config.rate_hz):
        raise ValueError(f"{name}: the weights are for {config.rate_hz:g} Hz, not for {rate_hz:g} Hz")
    if name == "att-rnn":
        return NetworkEstimator(Recurrent(config, tensors), rate_hz)
    if name == "att-snn":
        return NetworkEstimator(Spiking(config, tensors), rate_hz)
    return NetworkEstimator(OnLoihi(config, tensors), rate_hz)


class NetworkCore(Protocol):
    """A network without memory of its own: states go in, are changed, and outputs come back."""

    state: np.dtype
    """Record type of a vehicle's state, a block; its field `encoder` is the encoder's."""
    outputs: int
    """2: roll and pitch [rad]; 3: the world's up in body axes, less `LEVEL_UP`."""

    def run(self, states: Words, gyro: Array, accel: Array, out: Array) -> None:
        """Take T samples of n vehicles.

        Args:
            states: One block for each vehicle, (n, words); changed.
            gyro: Body rate, sample after sample, (n, 3 T) [rad/s].
            accel: Specific force, (n, 3 T) [m/s²].
            out: Outputs, sample after sample, (n, outputs T); written.
        """
        ...


class NetworkEstimator:
    """A network that estimates the attitude of n vehicles: the estimator protocol around a `NetworkCore`.

    A network never gets the initial attitude, as in the paper: `reset` and `restart` accept one, as those of
    every estimator do, and ignore it.

    Args:
        core: The network.
        rate_hz: Samples per second.
    """

    up: Array | None
    """The world's up in body axes as estimated last, shape (n, 3), not scaled to length 1; that of a level
    attitude before the first sample. None for a network whose outputs are roll and pitch."""

    def __init__(self, core: NetworkCore, rate_hz: float) -> None:
        """Start with one vehicle of unknown attitude."""
        self.core, self.rate_hz = core, rate_hz
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Forget everything and start n vehicles.

        Args:
            n: How many.
            roll_pitch: Initial attitude, shape (n, 2) [rad]; ignored.

        Raises:
            ValueError: An initial attitude of another shape, or not finite.
        """
        _check_attitude(roll_pitch, n)
        self._states, self._sample = zero_blocks(n, self.core.state), (n, 3)
        self.up = np.tile(LEVEL_UP, (n, 1)) if self.core.outputs == 3 else None

    def restart(self, ids: ArrayLike, roll_pitch: ArrayLike | None = None) -> None:
        """Start some of the vehicles again, (k,) of them; an initial attitude (k, 2) is ignored."""
        rows = np.arange(len(self._states))[np.asarray(ids, dtype=np.intp)]
        _check_attitude(roll_pitch, rows.size)
        self._states[rows] = zero_blocks(rows.size, self.core.state)
        if self.up is not None:
            self.up[rows] = LEVEL_UP

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample, (n, 3) [rad/s] and (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        if gyro.shape != self._sample or accel.shape != self._sample:
            raise ValueError(f"sample: gyro {gyro.shape} and accel {accel.shape}, should be {self._sample}")
        out = np.empty((self._sample[0], self.core.outputs))
        self.core.run(self._states, gyro, accel, out)
        if self.up is None:
            return out
        self.up = out + LEVEL_UP
        return roll_pitch_of_up(self.up)

    def sequence(self, gyro: ArrayLike, accel: ArrayLike, **sensors: Unpack[OtherSensors]) -> Array:
        """Take T samples, (n, T, 3) twice; the same numbers as T calls of `update`, (n, T, 2)."""
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        n = len(self._states)
        if gyro.ndim != 3 or gyro.shape != accel.shape or gyro.shape[0] != n or gyro.shape[2] != 3:
            raise ValueError(f"sequence: gyro {gyro.shape} and accel {accel.shape}, should be ({n}, T, 3)")
        steps = gyro.shape[1]
        flat = np.empty((n, self.core.outputs * steps))
        self.core.run(self._states, gyro.reshape(n, 3 * steps), accel.reshape(n, 3 * steps), flat)
        out = flat.reshape(n, steps, self.core.outputs)
        if self.up is not None and steps:
            self.up = out[:, -1] + LEVEL_UP
        return roll_pitch_of_outputs(out)

    @property
    def states(self) -> NDArray[np.void]:
        """What the network keeps from sample to sample: records (n,), of the core's `state`."""
        return fields(self._states, self.core.state)

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since the start that were missing in part or whole, shape (n,)."""
        return self.states["encoder"]["missing"].copy()


class Spiking:
    """Att-SNN in float64; the quantised one with the numbers of the chip."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel."""
        one = float(STATE_ONE) if config.quantised else 1.0
        weights = real_weights(config, tensors)
        by_source = (np.ascontiguousarray(w.T) * one for w in weights[: len(MATRICES)])
        settings = Settings(config.steps_per_sample, config.recurrent_delay, config.output_scale / one)
        in_states = Weights(*by_source, *weights[len(MATRICES) :])
        self._network = network_block(input_scaling(config.inputs), in_states, settings)
        self.outputs = config.n_outputs
        self.state = state_type(config.encoding, config.hidden, self.outputs)
        self._run = run_quantised if config.quantised else run_floats

    def run(
        self, states: Words, gyro: Array, accel: Array, out: Array, set_points: Array = NO_SET_POINTS
    ) -> None:
        """Take samples (n, 3 T) twice, of a controller also set-points, write the outputs (n, outputs T)."""
        self._run(gyro, accel, set_points, self._network, states, out)


class Host(NamedTuple):
    """What the host of a chip encodes with."""

    offset: Array
    """Of the readings, shape (6,) [rad/s, m/s²]."""
    gain: Array
    """Of the readings, shape (6,)."""
    w_in: NDArray[np.int32]
    """Mantissas of the encoding weights by source, shape (inputs, h0)."""
    decay: NDArray[np.int32]
    """Decays of the encoding layer's currents, shape (h0,)."""


class LoihiState(NamedTuple):
    """The host's currents and, as in `ChipState`, what the chip's neurons hold, of one copy."""

    current: NDArray[np.int32]
    """Currents of the encoding layer [state units], shape (h0,)."""
    spikes: NDArray[np.int8]
    u: NDArray[np.int32]
    v: NDArray[np.int32]
    a: NDArray[np.int32]
    bias: NDArray[np.int32]


class OnLoihi:
    """Att-SNN in integers: the encoding current on the host, all that spikes and the outputs on the chip.

    Raises:
        ValueError: The network is not quantised, not in the chip's time convention, or does not fit.
    """

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Place the network on the chip."""
        if not config.quantised or config.recurrent_delay != 1:
            raise ValueError("att-snn-loihi needs quantised weights and a recurrent delay of 1")
        w = {name: value.astype(np.int64) for name, value in tensors.items()}
        after: dict[str, NDArray[Any]] = {}
        if config.after_spike:
            after = {"w_after": w["w_after"][:, 0], "d_after": w["syn_after"]}
            after["exp_after"] = exponents(w, "w_after")
        self.chip = LoihiNetwork(
            [
                LoihiLayer(w_in=None, dv=w["mem0"], bias_exp=BIAS_EXP),
                LoihiLayer(
                    w_in=w["w_ff"],
                    w_rec=w["w_rec"],
                    du=w["syn1"],
                    dv=w["mem1"],
                    exp_in=exponents(w, "w_ff"),
                    exp_rec=exponents(w, "w_rec"),
                    **after,
                ),
                LoihiLayer(w_in=w["w_out"], du=w["syn2"], dv=w["mem2"], vth=VTH_MAX),
            ]
        )
        self.cores = partition(self.chip.layers)
        w_in = np.ascontiguousarray(w["w_in"].T, np.int32)
        self.host = Host(*input_scaling(config.inputs), w_in, w["syn0"].astype(np.int32))
        self.steps, self.scale = config.steps_per_sample, config.output_scale / STATE_ONE
        self.outputs = config.n_outputs
        settings = {"settings": np.array([self.steps, self.scale, self.outputs])}
        self.network = packed(self.host._asdict() | self.chip.parameters._asdict() | settings)
        first, neurons = self.chip.sizes[0], sum(self.chip.sizes)
        layout = {"encoder": (ENCODER, ()), "current": (np.int32, (first,)), "spikes": (np.int8, (neurons,))}
        self.state = block_type(layout | {name: (np.int32, (neurons,)) for name in ("u", "v", "a", "bias")})

    def run(
        self, states: Words, gyro: Array, accel: Array, out: Array, set_points: Array = NO_SET_POINTS
    ) -> None:
        """Take samples (n, 3 T) twice, of a controller also set-points, write the outputs (n, outputs T)."""
        _run_on_loihi(gyro, accel, set_points, self.network, states, out)


class Recurrent:
    """Att-RNN: two GRU layers and a linear output, in float32."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel."""
        first, second = (
            gru.Layer(
                *(
                    np.ascontiguousarray(tensors[f"gru.{kind}_l{layer}"].T, np.float32)
                    for kind in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
                )
            )
            for layer in (0, 1)
        )
        w_out, b_out = tensors["out.weight"].astype(np.float32), tensors["out.bias"].astype(np.float32)
        readout = gru.Readout(np.ascontiguousarray(w_out.T), b_out)
        scaling = input_scaling(config.inputs)
        self._network = gru.network_block(scaling, first, second, readout, config.output_scale)
        self.outputs, self.state = config.n_outputs, gru.state_type(config.encoding, config.hidden)

    def run(self, states: Words, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, 3 T) twice, write the outputs (n, outputs T)."""
        gru.run_gru(gyro, accel, self._network, states, out)


def roll_pitch_of_outputs(outputs: Array) -> Array:
    """Roll and pitch (..., 2) [rad] of a network's outputs: these are the two, or up less level (..., 3)."""
    return outputs if outputs.shape[-1] == 2 else roll_pitch_of_up(outputs + LEVEL_UP)


def real_weights(config: NetworkConfig, tensors: Tensors) -> Weights[Array]:
    """Weights and time constants of a spiking network in units of 1.0."""
    none = {"w_after": np.zeros((config.hidden, 0)), "syn_after": np.zeros(0)}
    tensors = none | tensors
    values = {name: tensors[name].astype(np.float64) for name in Weights._fields}
    if config.quantised:
        for name in MATRICES:
            values[name] *= np.exp2(exponents(tensors, name).astype(np.float64) - 8)[:, None]
        values |= {name: 1 - values[name] / 4096 for name in TIME_CONSTANTS}
    return Weights(**values)


def silenced(config: NetworkConfig, tensors: Tensors) -> Tensors:
    """The same weights with output weights of zero: the estimate is always level.

    The error of that network, the *silenced error*, stands beside every error of a network: what the two have
    in common is not the work of its neurons.
    """
    names = ("w_out",) if config.model == "att-snn" else ("out.weight", "out.bias")
    return tensors | {name: np.zeros_like(tensors[name]) for name in names}


def _check_attitude(roll_pitch: ArrayLike | None, n: int) -> None:
    if roll_pitch is None:
        return
    known = np.asarray(roll_pitch, dtype=np.float64)
    if known.shape != (n, 2):
        raise ValueError(f"roll_pitch: shape {known.shape}, should be ({n}, 2)")
    if not np.isfinite(known).all():
        raise ValueError("roll_pitch: not finite; leave it out where the attitude is unknown")


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
    """`LoihiState` in the block of a copy's state, in compiled code."""
    current, spikes = vector(block, 1, np.int32), vector(block, 2, np.int8)
    u, v = vector(block, 3, np.int32), vector(block, 4, np.int32)
    a, bias = vector(block, 5, np.int32), vector(block, 6, np.int32)
    return LoihiState(current, spikes, u, v, a, bias)


@njit(cache=True, nogil=True)
def _run_on_loihi(gyro, accel, set_points, network, states, out):
    host, chip = host_and_chip(network)
    x = np.empty(host.w_in.shape[0])
    more = x.size - 6
    steps, scale, count = vector(network, 13, np.float64)
    sources, sums = np.empty(chip.weights.shape[0], np.int32), np.zeros(chip.weights.shape[1], np.int32)
    for n in range(states.shape[0]):
        encoder, state = vector(states[n], 0, ENCODER)[0], loihi_state(states[n])
        outputs = state.v[state.v.size - int(count) :]
        for t in range(gyro.shape[1] // 3):
            encode_sample(gyro[n, 3 * t : 3 * t + 3], accel[n, 3 * t : 3 * t + 3], host, encoder)
            x[:6] = encoder.inputs
            for k in range(more):
                x[6 + k] = set_points[n, more * t + k]
            for _ in range(int(steps)):
                drive(x, host, state.current, state.bias, sums)
                step_chip(chip, state, sources, sums)
            for o in range(outputs.size):
                out[n, outputs.size * t + o] = outputs[o] * scale


@njit(cache=True)
def step_on_loihi(network, states, set_points):
    """One step of all copies on the host and on the chip.

    Args:
        network: `OnLoihi.network`.
        states: Blocks of `OnLoihi.state`, shape (n, words); changed.
        set_points: A controller's further inputs, integers, shape (n, inputs); of others not read.
    """
    host, chip = host_and_chip(network)
    x = np.empty(host.w_in.shape[0])
    sources, sums = np.empty(chip.weights.shape[0], np.int32), np.zeros(chip.weights.shape[1], np.int32)
    for n in range(states.shape[0]):
        state = loihi_state(states[n])
        x[:6] = vector(states[n], 0, ENCODER)[0].inputs
        for k in range(6, x.size):
            x[k] = set_points[n, k - 6]
        drive(x, host, state.current, state.bias, sums)
        step_chip(chip, state, sources, sums)


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
