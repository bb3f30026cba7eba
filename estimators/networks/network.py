"""Trained networks as estimators: Att-SNN in float64 and on emulated Loihi, and its non-spiking twin Att-RNN.

A network gets scaled readings and nothing else (`estimators.networks.encoder`): there is no filter in front
of it and no connection from its inputs to its outputs beside the neurons. As in the paper, it never
gets the initial attitude. Nothing here imports torch: inference is compiled.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Protocol, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import OtherSensors
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
from .encoder import ENCODER, encode, encoded, input_scaling
from .forward import BIAS_EXP, MATRICES, TIME_CONSTANTS, Weights, rest
from .forward import run as run_floats
from .gru import run_gru
from .weights_file import NetworkConfig, Tensors, load_network, shipped_network

Array = NDArray[np.float64]
Encoder = NDArray[np.void]
States = tuple[Encoder, tuple[NDArray, ...]]
"""State of the encoder (n,), and arrays of the network's state, each with one row per vehicle."""


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
    config, tensors = shipped_network(model) if weights is None else load_network(weights)
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

    def zero(self, n: int) -> States:
        """States of `n` vehicles at the start."""
        ...

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        ...


class NetworkEstimator:
    """A network that estimates the attitude of n vehicles: the estimator protocol around a `NetworkCore`.

    A network never gets the initial attitude, as in the paper: `reset` and `restart` accept one, as those of
    every estimator do, and ignore it.

    Args:
        core: The network.
        rate_hz: Samples per second.
    """

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
        self._states = self.core.zero(n)

    def restart(self, ids: ArrayLike, roll_pitch: ArrayLike | None = None) -> None:
        """Start some of the vehicles again, (k,) of them; an initial attitude (k, 2) is ignored."""
        rows = np.arange(len(self._states[0]))[np.asarray(ids)]
        _check_attitude(roll_pitch, rows.size)
        (encoder, state), (encoder_0, state_0) = self._states, self.core.zero(rows.size)
        encoder[rows] = encoder_0
        for mine, initial in zip(state, state_0, strict=True):
            mine[rows] = initial

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample, (n, 3) [rad/s] and (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        n = len(self._states[0])
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        if gyro.shape != (n, 3) or accel.shape != (n, 3):
            raise ValueError(f"sample: gyro {gyro.shape} and accel {accel.shape}, should be ({n}, 3)")
        out = np.empty((n, 1, 2))
        self.core.run(self._states, gyro.reshape(n, 1, 3), accel.reshape(n, 1, 3), out)
        return out[:, 0]

    def sequence(self, gyro: ArrayLike, accel: ArrayLike, **sensors: Unpack[OtherSensors]) -> Array:
        """Take T samples, (n, T, 3) twice; the same numbers as T calls of `update`, (n, T, 2)."""
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        n = len(self._states[0])
        if gyro.ndim != 3 or gyro.shape != accel.shape or gyro.shape[0] != n or gyro.shape[2] != 3:
            raise ValueError(f"sequence: gyro {gyro.shape} and accel {accel.shape}, should be ({n}, T, 3)")
        out = np.empty((*gyro.shape[:2], 2))
        self.core.run(self._states, gyro, accel, out)
        return out

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since the start that were missing in part or whole, shape (n,)."""
        return self._states[0]["missing"].copy()


class Spiking:
    """Att-SNN in float64; the quantised one with the numbers of the chip."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel."""
        one = float(STATE_ONE) if config.quantised else 1.0
        weights = real_weights(config, tensors)
        by_source = (np.ascontiguousarray(w.T) * one for w in weights[: len(MATRICES)])
        self._network = tuple(input_scaling(config.inputs)), (*by_source, *weights[len(MATRICES) :])
        self._sizes = config.encoding, config.hidden, len(weights.w_out), config.recurrent_delay
        self._quantised, self._settings = (
            config.quantised,
            (config.steps_per_sample, config.output_scale / one),
        )

    def zero(self, n: int) -> States:
        """Everything at rest."""
        return np.zeros(n, ENCODER), rest(n, *self._sizes)

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        encoder, state = states
        run_floats((gyro, accel), *self._network, encoder, tuple(state), self._settings, self._quantised, out)


class Host(NamedTuple):
    """What the host of a chip encodes with."""

    offset: Array
    """Of the readings, shape (6,) [rad/s, m/s²]."""
    gain: Array
    """Of the readings, shape (6,)."""
    w_in: NDArray[np.int32]
    """Mantissas of the encoding weights by source, shape (6, h0)."""
    du: NDArray[np.int64]
    """Decays of the encoding layer's currents, shape (h0,)."""


class LoihiState(NamedTuple):
    """The host's currents and, as in `ChipState`, what the chip's neurons hold."""

    current: NDArray[np.int64]
    """Currents of the encoding layer [state units], shape (n, h0)."""
    spikes: NDArray[np.int8]
    u: NDArray[np.int64]
    v: NDArray[np.int64]
    bias: NDArray[np.int64]


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
        self.chip = LoihiNetwork(
            [
                LoihiLayer(w_in=None, dv=w["mem0"], bias_exp=BIAS_EXP),
                LoihiLayer(w_in=w["w_ff"], w_rec=w["w_rec"], du=w["syn1"], dv=w["mem1"]),
                LoihiLayer(w_in=w["w_out"], du=w["syn2"], dv=w["mem2"], vth=VTH_MAX),
            ]
        )
        self.cores = partition(self.chip.layers)
        w_in = np.ascontiguousarray(w["w_in"].T, np.int32)
        self.host = Host(*input_scaling(config.inputs), w_in, w["syn0"])
        self.steps, self.scale = config.steps_per_sample, config.output_scale / STATE_ONE
        self._network, self._settings = (
            (tuple(self.host), tuple(self.chip.parameters)),
            (self.steps, self.scale),
        )

    def zero(self, n: int) -> tuple[Encoder, LoihiState]:
        """Everything at rest."""
        current = np.zeros((n, self.chip.sizes[0]), np.int64)
        return np.zeros(n, ENCODER), LoihiState(current, *self.chip.rest(n))

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        encoder, state = states
        _run_on_loihi((gyro, accel), *self._network, encoder, tuple(state), self._settings, out)


class Recurrent:
    """Att-RNN: two GRU layers and a linear output, in float32."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel."""
        self._weights = tuple(
            np.ascontiguousarray(tensors[f"gru.{kind}_l{layer}"].T, np.float32)
            for layer in (0, 1)
            for kind in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
        )
        self._out = (
            np.ascontiguousarray(tensors["out.weight"], np.float32),
            tensors["out.bias"].astype(np.float32),
        )
        self._sizes, self._scale = (config.encoding, config.hidden), config.output_scale
        self._scaling = input_scaling(config.inputs)

    def zero(self, n: int) -> States:
        """Everything at rest."""
        return np.zeros(n, ENCODER), tuple(np.zeros((n, units), np.float32) for units in self._sizes)

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        encoder, (h0, h1) = states
        x = encoded(self._scaling, gyro, accel, encoder)
        run_gru(x.astype(np.float32), self._weights, self._out, h0, h1, out)
        out *= self._scale


def real_weights(config: NetworkConfig, tensors: Tensors) -> Weights[Array]:
    """Weights and time constants of a spiking network in units of 1.0."""
    values = {name: tensors[name].astype(np.float64) for name in Weights._fields}
    if config.quantised:
        values |= {name: values[name] / 256 for name in MATRICES}
        values |= {name: 1 - values[name] / 4096 for name in TIME_CONSTANTS}
    return Weights(**values)


def silenced(config: NetworkConfig, tensors: Tensors) -> Tensors:
    """The same weights with output weights of zero.

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
def _run_on_loihi(readings, host, chip, encoder, state, settings, out):
    host, chip, state = Host(*host), Chip(*chip), LoihiState(*state)
    gyro, accel = readings
    steps, scale = settings
    outputs = state.v[:, state.v.shape[1] - out.shape[2] :]
    for t in range(gyro.shape[1]):
        encode(gyro[:, t], accel[:, t], host, encoder)
        for _ in range(steps):
            step_on_loihi(host, chip, encoder, state)
        for n in range(gyro.shape[0]):
            for k in range(out.shape[2]):
                out[n, t, k] = outputs[n, k] * scale


@njit(cache=True)
def step_on_loihi(host, chip, encoder, state):
    """One step of all copies on the host and on the chip, whose state changes in place."""
    for n in range(encoder.shape[0]):
        drive(encoder[n].inputs, host, state.current[n], state.bias[n])
    step_chip(chip, state)


@njit(cache=True)
def drive(x, host, current, bias):
    """Advance the host's currents of the encoding layer by one step; write them as bias mantissas.

    Args:
        x: Integer inputs, shape (6,).
        host: What the host encodes with.
        current: Currents [state units], shape (h0,); changed.
        bias: Bias mantissas of the chip's neurons, whose first h0 are the encoding layer; changed.
    """
    total = np.zeros(current.size, np.int32)
    for k in range(host.w_in.shape[0]):
        value, weights = np.int32(x[k]), host.w_in[k]
        for i in range(total.size):
            total[i] += value * weights[i]
    for i in range(current.size):
        # Mantissas of 1/256 times inputs of 1/1024 are 2^-18; a state unit is 2^-14.
        current[i] = wrap(decay(current[i], host.du[i]) + shift(int(total[i]), 4), 23)
        bias[i] = min(max(shift(current[i], BIAS_EXP), -BIAS_MANT_MAX), BIAS_MANT_MAX)
