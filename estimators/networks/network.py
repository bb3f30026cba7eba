"""Trained networks of layers as estimators: Att-SNN, in Loihi's integers or in floats, and Att-RNN.

The only inputs of a network are scaled readings (`estimators.networks.encoder`): there is no filter before
the network, and inputs reach outputs only through neurons. As in the paper, a network is never given the
initial attitude. Inference is compiled and does not need PyTorch.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import OtherSensors, rows_of
from quadsim.rotation import roll_pitch_of_up, roll_pitch_rows

from .forward import OnLoihi, Spiking
from .gru import Recurrent
from .weights_file import SET_POINTS, NetworkConfig, Tensors, attitude_network

Array = NDArray[np.float64]
NO_SET_POINTS = np.zeros((0, 0))
LEVEL_UP = np.array([0.0, 0.0, 1.0])
"""Direction of the world's z axis in body axes at a level attitude."""


def create_network(name: str, rate_hz: float = 200.0, *, weights: str | Path) -> NetworkEstimator:
    """Make an estimator that runs a network of layers.

    Args:
        name: "att-snn", "att-snn-loihi" (which must fit the chip) or "att-rnn".
        rate_hz: Samples per second, which must be the rate of the training.
        weights: Weights file, or a shipped name.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The name is unknown, or the file has another kind of network or another sample rate.
    """
    if name not in CORES:
        raise ValueError(f"no network {name!r}, there are att-snn, att-snn-loihi and att-rnn")
    model = name.removesuffix("-loihi")
    config, tensors = attitude_network(weights)
    if config.model != model:
        raise ValueError(f"{weights}: weights of {config.model}, {name} needs {model}")
    if not np.isclose(rate_hz, config.rate_hz):
        raise ValueError(f"{name}: the weights are for {config.rate_hz:g} Hz, not for {rate_hz:g} Hz")
    return NetworkEstimator(CORES[name](config, tensors), rate_hz)


class NetworkCore(Protocol):
    """A network without its own state: the kernel reads and changes states, and writes outputs."""

    state: np.dtype
    """Record type of a vehicle's state. All numbers have the same type; `encoder_fields` come first."""
    outputs: int
    """Number of outputs. 2: roll and pitch [rad]. 3: the world's z axis in body axes minus `LEVEL_UP`, or
    angular acceleration."""
    arrays: tuple[Any, ...]
    """Parameters for the kernel."""
    kernel: Callable[..., None]
    """Compiled function for T samples of n vehicles. Its arguments are body rate [rad/s] and specific force
    [m/s²], sample after sample, (n, 3 T); integer set-points of a controller (n, 3 T); the arrays; the states
    (n, words), which it changes; and the outputs (n, outputs T), which it writes."""


CORES: dict[str, Callable[[NetworkConfig, Tensors], NetworkCore]] = {
    "att-snn": Spiking,
    "att-snn-loihi": OnLoihi,
    "att-rnn": Recurrent,
}


def zero_states(core: NetworkCore, n: int) -> NDArray[Any]:
    """Return initial states of n vehicles, as rows of numbers."""
    number = core.state["missing"]
    return np.zeros((n, core.state.itemsize // number.itemsize), number)


class BatchedNetwork:
    """A network for n vehicles, each with its own state; the common part of estimators and controllers.

    Args:
        core: The network.
        rate_hz: Samples per second.
    """

    def __init__(self, core: NetworkCore, rate_hz: float = 200.0) -> None:
        self.core, self.rate_hz = core, rate_hz

    def begin(self, n: int) -> None:
        """Start n vehicles."""
        self._states = zero_states(self.core, n)

    def _begin_again(self, ids: ArrayLike) -> NDArray[np.intp]:
        """Restart some vehicles, and return their indices."""
        rows = rows_of(ids, len(self._states))
        self._states[rows] = 0
        return rows

    def outputs(self, gyro: ArrayLike, accel: ArrayLike, set_points: Array = NO_SET_POINTS) -> Array:
        """Process T samples.

        Args:
            gyro: Body rate (n, T, 3) [rad/s].
            accel: Specific force (n, T, 3) [m/s²].
            set_points: For a controller, integer set-points (n, T, 3).

        Returns:
            Outputs after each sample, (n, T, outputs).
        """
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        n = len(self._states)
        if gyro.ndim != 3 or gyro.shape != accel.shape or gyro.shape[0] != n or gyro.shape[2] != 3:
            raise ValueError(f"sequence: gyro {gyro.shape} and accel {accel.shape}, should be ({n}, T, 3)")
        steps = gyro.shape[1]
        flat = np.empty((n, self.core.outputs * steps))
        rate, force = gyro.reshape(n, 3 * steps), accel.reshape(n, 3 * steps)
        more = set_points.reshape(len(set_points), SET_POINTS * steps)
        self.core.kernel(rate, force, more, *self.core.arrays, self._states, flat)
        return flat.reshape(n, steps, self.core.outputs)

    @property
    def states(self) -> NDArray[np.void]:
        """State of the network, records (n,) of the core's `state`."""
        return self._states.view(self.core.state)[:, 0]

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Number of incomplete samples since the start, shape (n,)."""
        return self.states["missing"].astype(np.int64)


class NetworkEstimator(BatchedNetwork):
    """A network that estimates the attitude of n vehicles.

    As in the paper, a network is never given the initial attitude: `reset` and `restart` accept one, but
    ignore it.
    """

    up: Array | None
    """Last estimate of the world's z axis in body axes, shape (n, 3), not normalised; before the first
    sample, that of a level attitude. None for a network of layers, whose outputs are roll and pitch."""

    def __init__(self, core: NetworkCore, rate_hz: float) -> None:
        super().__init__(core, rate_hz)
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Start n vehicles with initial states.

        Args:
            n: Number of vehicles.
            roll_pitch: Initial attitude, shape (n, 2) [rad], which is ignored.

        Raises:
            ValueError: The initial attitude has the wrong shape or is not finite.
        """
        _check_attitude(roll_pitch, n)
        self.begin(n)
        self._sample = (n, 3)
        self.up = np.tile(LEVEL_UP, (n, 1)) if self.core.outputs == 3 else None

    def restart(self, ids: ArrayLike, roll_pitch: ArrayLike | None = None) -> None:
        """Restart vehicles (k,); an initial attitude (k, 2) is ignored."""
        rows = rows_of(ids, len(self._states))
        _check_attitude(roll_pitch, rows.size)
        self._begin_again(rows)
        if self.up is not None:
            self.up[rows] = LEVEL_UP

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Process one sample, (n, 3) [rad/s] and (n, 3) [m/s²]; return roll and pitch (n, 2) [rad]."""
        gyro, accel = np.ascontiguousarray(gyro, np.float64), np.ascontiguousarray(accel, np.float64)
        if gyro.shape != self._sample or accel.shape != self._sample:
            raise ValueError(f"sample: gyro {gyro.shape} and accel {accel.shape}, should be {self._sample}")
        out = np.empty((self._sample[0], self.core.outputs))
        self.core.kernel(gyro, accel, NO_SET_POINTS, *self.core.arrays, self._states, out)
        if self.up is None:
            return out
        self.up = out + LEVEL_UP
        roll_pitch_rows(self.up, roll_pitch := np.empty((len(out), 2)))
        return roll_pitch

    def sequence(self, gyro: ArrayLike, accel: ArrayLike, **sensors: Unpack[OtherSensors]) -> Array:
        """Process T samples, (n, T, 3) each; return the results of T calls of `update`, (n, T, 2)."""
        out = self.outputs(gyro, accel)
        if self.up is not None and out.shape[1]:
            self.up = out[:, -1] + LEVEL_UP
        return roll_pitch_of_outputs(out)


def roll_pitch_of_outputs(outputs: Array) -> Array:
    """Return roll and pitch (..., 2) [rad] of outputs, (..., 2) or (..., 3) as in `NetworkCore`."""
    return outputs if outputs.shape[-1] == 2 else roll_pitch_of_up(outputs + LEVEL_UP)


def silenced(config: NetworkConfig, tensors: Tensors) -> Tensors:
    """Return the weights of the silenced network, whose output weights are zero: its estimate is level.

    Tables of a network's error also give this *silenced error*. Only the difference is the contribution of
    the neurons.
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
