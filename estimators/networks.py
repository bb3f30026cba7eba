"""Trained networks as estimators: Att-SNN in float64 and on emulated Loihi, and its non-spiking twin Att-RNN.

Nothing here imports torch: inference is compiled. Missing samples (NaN, or a specific force of exactly zero)
are bridged by the last good one and counted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from quadsim.vehicle import GRAVITY

from .chip import partition
from .dynamics import BIAS_EXP, SKIP_EXP, SKIP_ONE, run_network, zero_state
from .encoder import HELD, checked_start, encode_sample, encoded, encoder_of, known_to, outputs_at
from .gru import run_gru
from .loihi import BIAS_MANT_MAX, VTH_MAX, LoihiLayer, LoihiNetwork, decay, shift, step_arrays, wrap
from .tilt import to_roll_pitch
from .weights_file import NetworkConfig, Tensors, load_network, shipped_network

Array = NDArray[np.float64]
States = tuple[NDArray[np.generic], ...]

SETTLE_S, TURN_S = 3.0, 0.15
"""A network that is told its attitude first sees a level hover for this long, and then a turn into it [s]."""


def create_network(name: str, rate_hz: float = 200.0, weights: str | Path | None = None) -> NetworkEstimator:
    """Make a network estimator.

    Args:
        name: "att-snn" (float64), "att-snn-loihi" (the same network in integers), "att-snn-robust" (in
            integers, trained for sensors that nobody has calibrated) or "att-rnn".
        rate_hz: Samples per second; the one that the weights were trained for.
        weights: Weights file; None: the ones that ship.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Unknown name, a file of another kind of network, or another sample rate.
    """
    if name not in ("att-snn", "att-snn-loihi", "att-snn-robust", "att-rnn"):
        raise ValueError(f"no network {name!r}, there are att-snn, att-snn-loihi, att-snn-robust and att-rnn")
    model = name.removesuffix("-loihi").removesuffix("-robust")
    shipped = name.removesuffix("-loihi")
    config, tensors = shipped_network(shipped) if weights is None else load_network(weights)
    if config.model != model:
        raise ValueError(f"{weights}: weights of {config.model}, {name} needs {model}")
    if not np.isclose(rate_hz, config.rate_hz):
        raise ValueError(f"{name}: the weights are for {config.rate_hz:g} Hz, not for {rate_hz:g} Hz")
    if name == "att-rnn":
        return NetworkEstimator(Recurrent(config, tensors), rate_hz)
    if name == "att-snn":
        return NetworkEstimator(Spiking(config, tensors), rate_hz)
    return NetworkEstimator(OnLoihi(config, tensors), rate_hz)


class Core(Protocol):
    """A network without memory of its own: states go in, are changed, and outputs come back."""

    def zero(self, n: int) -> States:
        """States of `n` vehicles at the start, each array with one row per vehicle."""
        ...

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        ...

    def place(self, states: States, roll_pitch: Array) -> None:
        """Let the output read roll and pitch (n, 2) [rad] now, where the output has a state of its own."""
        ...


class NetworkEstimator:
    """A network that follows n vehicles: the estimator protocol around a `Core`.

    Args:
        core: The network.
        rate_hz: Samples per second.
    """

    def __init__(self, core: Core, rate_hz: float) -> None:
        """Start with one vehicle of unknown attitude."""
        self.core, self.rate_hz = core, rate_hz
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Forget everything and start n vehicles.

        Args:
            n: How many.
            roll_pitch: Shape (n, 2) [rad], where the attitude is known, to a quarter of a degree: the
                accelerometer's bias is found by it.

        Raises:
            ValueError: Of another shape, or not finite.
        """
        self._states = self._started(n, roll_pitch)

    def restart(self, ids: ArrayLike, roll_pitch: ArrayLike | None = None) -> None:
        """Start some of the vehicles again, (k,) of them, with their attitude (k, 2) where it is known."""
        rows = np.arange(len(self._states[0]))[np.asarray(ids)]
        for mine, fresh in zip(self._states, self._started(rows.size, roll_pitch), strict=True):
            mine[rows] = fresh

    def update(self, gyro: Array, accel: Array) -> Array:
        """Take one sample, (n, 3) [rad/s] and (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        n = len(self._states[0])
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        if gyro.shape != (n, 3) or accel.shape != (n, 3):
            raise ValueError(f"sample: gyro {gyro.shape} and accel {accel.shape}, should be ({n}, 3)")
        out = np.empty((n, 1, 2))
        self.core.run(self._states, gyro.reshape(n, 1, 3), accel.reshape(n, 1, 3), out)
        return out[:, 0]

    def sequence(self, gyro: ArrayLike, accel: ArrayLike) -> Array:
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
        return self._states[0][:, 6].astype(np.int64)

    def _started(self, n: int, roll_pitch: ArrayLike | None) -> States:
        states = self.core.zero(n)
        if roll_pitch is not None:
            known = checked_start(roll_pitch, n)
            gyro, accel = _turn_into(known, self.rate_hz)
            self.core.run(states, gyro, accel, np.empty((*gyro.shape[:2], 2)))
            states[0][:, 7:] = known_to(known)[:, 7:]  # that turn is no flight: nothing of it is kept
            self.core.place(states, known)
        return states


class Spiking:
    """Att-SNN in float64; the quantised one with the numbers of the chip."""

    def __init__(self, config: NetworkConfig, tensors: Tensors) -> None:
        """Lay the weights out for the kernel."""
        one = 2.0**14 if config.quantised else 1.0
        weights, taus = real_weights(config, tensors)
        self._weights = np.concatenate([w.T.ravel() for w in weights]) * one
        self._taus = np.concatenate(taus)
        self._sizes = (config.encoding, config.hidden, config.recurrent_delay, config.steps_per_sample)
        self._quantised, self._scale = config.quantised, config.output_scale / one
        self._inputs, self._encoding = config.inputs, encoder_of(config.inputs, config.rate_hz)

    def zero(self, n: int) -> States:
        """Everything at rest."""
        return (np.zeros((n, HELD)), *zero_state(n, *self._sizes[:2]))

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        held, state, spikes = states
        x, heading = encoded(self._encoding, gyro, accel, held)
        run_network(x, self._weights, self._taus, self._sizes, self._quantised, state, spikes, out)
        out *= self._scale
        if self._inputs.yaw_free:
            to_roll_pitch(out, heading)

    def place(self, states: States, roll_pitch: Array) -> None:
        """Set the potentials of the outputs, which forget within a second or so."""
        direct = np.asarray(states[1][:, -2:], np.float64)
        potential = outputs_at(self._inputs, roll_pitch) / self._scale - direct
        states[1][:, -4:-2] = np.rint(potential) if self._quantised else potential


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
        w_skip = w["w_skip"] if w["w_skip"].any() else w["w_skip"][:0]
        behind = len(w_skip)
        self.chip = LoihiNetwork(
            [
                LoihiLayer(w_in=None, dv=w["mem0"], bias_exp=BIAS_EXP),
                LoihiLayer(w_in=w["w_ff"], w_rec=w["w_rec"], du=w["syn1"], dv=w["mem1"]),
                LoihiLayer(
                    w_in=np.vstack([w["w_out"], np.zeros_like(w["w_out"])[:behind]]),
                    du=w["syn2"],
                    dv=np.repeat([w["mem2"], w["mem_skip"]], [2, behind]),
                    vth=VTH_MAX,
                    bias_exp=SKIP_EXP,
                ),
            ]
        )
        self.cores = partition(self.chip.layers)
        self.fan_out = np.ascontiguousarray(w["w_in"].T, np.int32), w["syn0"], w_skip
        self.steps, self.scale = config.steps_per_sample, config.output_scale / 2**14
        self.inputs = config.inputs
        self.encoding = encoder_of(config.inputs, config.rate_hz)

    def zero(self, n: int) -> States:
        """Everything at rest."""
        return (
            np.zeros((n, HELD)),
            np.zeros((n, self.fan_out[0].shape[1]), np.int64),
            *self.chip.zero_state(n),
        )

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        heading = np.empty_like(out)
        _run_on_loihi(
            gyro, accel, self.encoding, *self.fan_out, self.steps, self.scale,
            states, self.chip.parameters, heading, out,
        )  # fmt: skip
        if self.inputs.yaw_free:
            to_roll_pitch(out, heading)

    def place(self, states: States, roll_pitch: Array) -> None:
        """Set the potentials of the outputs, which forget within a second or so."""
        v = states[5][:, -self.chip.sizes[-1] :]
        behind = v[:, 2:].reshape(len(v), -1, 2).sum(1)
        v[:, :2] = np.rint(outputs_at(self.inputs, roll_pitch) / self.scale) - behind


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
        self._sizes, self._steps, self._scale = (config.encoding, config.hidden), 1, config.output_scale
        self._inputs, self._encoding = config.inputs, encoder_of(config.inputs, config.rate_hz)

    def zero(self, n: int) -> States:
        """Everything at rest."""
        return (np.zeros((n, HELD)), *(np.zeros((n, units), np.float32) for units in self._sizes))

    def run(self, states: States, gyro: Array, accel: Array, out: Array) -> None:
        """Take samples (n, T, 3) twice, write roll and pitch (n, T, 2) [rad]."""
        held, h0, h1 = states
        x, heading = encoded(self._encoding, gyro, accel, held)
        run_gru(x.astype(np.float32), self._weights, self._out, h0, h1, out)
        out *= self._scale
        if self._inputs.yaw_free:
            to_roll_pitch(out, heading)

    def place(self, states: States, roll_pitch: Array) -> None:
        """Nothing to do: the output is a function of the units alone."""


def real_weights(config: NetworkConfig, tensors: Tensors) -> tuple[list[Array], list[Array]]:
    """Weights and time constants of a spiking network in units of 1.0, in the order of the layers."""
    names = ("w_in", "w_ff", "w_rec", "w_out", "w_skip")
    ones = (256, 256, 256, 256, SKIP_ONE) if config.quantised else (1,) * 5
    weights = [tensors[name].astype(np.float64) / one for name, one in zip(names, ones, strict=True)]
    taus = [
        tensors[name].astype(np.float64)
        for name in ("syn0", "mem0", "syn1", "mem1", "syn2", "mem2", "mem_skip")
    ]
    return weights, [1 - tau / 4096 for tau in taus] if config.quantised else taus


def _turn_into(roll_pitch: Array, rate_hz: float) -> tuple[Array, Array]:
    """Readings of a quadrotor that hovers and then turns about a horizontal axis into an attitude (n, 2)."""
    roll, pitch = roll_pitch.T
    turning = round(TURN_S * rate_hz)
    axis = np.stack([np.sin(roll) * np.cos(pitch), np.sin(pitch)], -1)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (np.cos(roll) * np.cos(pitch))[:, None])
    rate = axis / np.maximum(sine, 1e-12) * angle * rate_hz / turning
    gyro = np.zeros((len(roll_pitch), round(SETTLE_S * rate_hz) + turning, 3))
    gyro[:, -turning:, :2] = rate[:, None]
    accel = np.zeros_like(gyro)
    accel[..., 2] = GRAVITY  # a rotor's thrust is along the body's z, whatever the tilt
    return gyro, accel


@njit(cache=True)
def _run_on_loihi(
    gyro, accel, encoding, w_in, du, w_skip, steps, scale, states, parameters, heading, out
):  # fmt: skip
    held, current, before, after, u, v, bias = states
    n_outputs = out.shape[2]
    first_output = v.shape[1] - n_outputs - w_skip.shape[0]
    for t in range(gyro.shape[1]):
        for n in range(gyro.shape[0]):
            heading[n, t] = encode_sample(gyro[n, t], accel[n, t], encoding, held[n])
        for _ in range(steps):
            for n in range(gyro.shape[0]):
                _drive(held[n], w_in, du, w_skip, current[n], bias[n])
            step_arrays(before, after, u, v, bias, *parameters)
        for n in range(gyro.shape[0]):
            read_out(v[n, first_output:], scale, out[n, t])


@njit(cache=True)
def _drive(x, w_in, du, w_skip, current, bias):
    """Advance the host's currents of the encoding layer; write them and what drives the outputs as biases."""
    drive = np.zeros(current.size, np.int32)
    for k in range(w_in.shape[0]):
        value, row = np.int32(x[k]), w_in[k]
        for i in range(drive.size):
            drive[i] += value * row[i]
    for i in range(current.size):
        # Mantissas of 1/256 times inputs of 1/1024 are 2^-18; a state unit is 2^-14.
        current[i] = wrap(decay(current[i], du[i]) + shift(int(drive[i]), 4), 23)
        bias[i] = _mantissa(current[i], BIAS_EXP)
    first = bias.size - w_skip.shape[0]
    for o in range(w_skip.shape[0]):
        direct = 0
        for k in range(w_skip.shape[1]):
            direct += int(x[k]) * w_skip[o, k]
        # Mantissas of 1/4096 times inputs of 1/1024 are 2^-22.
        bias[first + o] = _mantissa(direct, 8 + SKIP_EXP)


@njit(cache=True)
def read_out(potentials, scale, out):
    """Outputs from their potentials; behind a skip connection there is a second row of them."""
    size = out.shape[0]
    for k in range(size):
        direct = potentials[size + k] if potentials.shape[0] > size else 0
        out[k] = (potentials[k] + direct) * scale


@njit(cache=True, inline="always")
def _mantissa(current, bits):
    return min(max(shift(current, bits), -BIAS_MANT_MAX), BIAS_MANT_MAX)
