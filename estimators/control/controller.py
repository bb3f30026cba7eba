"""A spiking network as attitude controller: set-points and readings to angular accelerations.

It takes the place of the cascade's levels of attitude and body rate, see `quadsim.control.own`. As of an
attitude network, the host scales inputs and outputs and no more; its memory is the last valid inputs.

Inputs are bounded and so are outputs. A set-point is clipped to the limits of the file's `SetPointScaling`;
one that is NaN keeps its last value, and so does a missing reading. An angular acceleration is clipped to
`bound`. There is no integral beside the potentials of the neurons, which the chip limits to 1024 thresholds.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.runs.block import fields, zero_blocks
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY, Vehicle

from ..networks.encoder import INPUT_MAX, INPUT_ONE
from ..networks.network import OnLoihi, Spiking
from ..networks.weights_file import (
    END,
    SET_POINTS,
    NetworkConfig,
    SetPointScaling,
    Tensors,
    shipped_controllers,
)
from .weights import Reads, load_controller

Array = NDArray[np.float64]

LOIHI = "-loihi"
"""End of the name of a controller that runs in the chip's integers."""
THRUST_MAX = 100.0
"""Largest collective thrust per mass that passes through [m/s²]."""
LEVEL = np.array([0.0, 0.0, 0.0, GRAVITY])
"""Set-point before the first."""


def create_controller(
    path_or_name: str | Path, rate_hz: float = 200.0, vehicle: Vehicle | None = None
) -> SpikingController:
    """Make a spiking attitude controller.

    Args:
        path_or_name: A weights file, or the name of a controller that ships; with "-loihi" at its end it runs
            in the emulated chip's integers.
        rate_hz: Samples per second; the one that it was trained for.
        vehicle: Not used: angular accelerations are asked for, and the allocation knows the vehicle.

    Raises:
        FileNotFoundError: No such file.
        ValueError: An attitude estimator's weights, or another sample rate.
    """
    name = str(path_or_name)
    path = name.removesuffix(LOIHI)
    config, tensors, reads = load_controller(path)
    if not np.isclose(rate_hz, config.rate_hz):
        raise ValueError(f"{path}: the weights are for {config.rate_hz:g} Hz, not for {rate_hz:g} Hz")
    return SpikingController(config, tensors, name.endswith(LOIHI), reads)


def is_controller(name: str) -> bool:
    """Whether a name is that of a controller's weights: a path, or a name under which some ship."""
    path = name.removesuffix(LOIHI)
    return path.endswith(END) or path in shipped_controllers()


class SpikingController:
    """A network that controls the attitude of n vehicles; an `AttitudeController`.

    Args:
        config: How the network is run.
        tensors: Its weights.
        on_loihi: Whether it runs in the emulated chip's integers, with the same outputs.
        reads: The accelerometer, or an estimate of roll and pitch in its place.

    Raises:
        ValueError: The network is no controller, or not for the chip.
    """

    def __init__(
        self, config: NetworkConfig, tensors: Tensors, on_loihi: bool = False, reads: Reads = "imu"
    ) -> None:
        if config.set_point is None:
            raise ValueError("these weights are an attitude estimator's, a controller needs a controller's")
        self.core = OnLoihi(config, tensors) if on_loihi else Spiking(config, tensors)
        self.scaling, self.rate_hz, self.reads = config.set_point, config.rate_hz, reads
        self.reset(1)

    def reset(self, n: int) -> None:
        """Start n vehicles: at rest, with level set-points."""
        self._states = zero_blocks(n, self.core.state)
        self._set_point = np.tile(LEVEL, (n, 1))

    def restart(self, ids: ArrayLike) -> None:
        """Start some of the vehicles again."""
        rows = np.arange(len(self._states))[np.asarray(ids, dtype=np.intp)]
        self._states[rows] = zero_blocks(rows.size, self.core.state)
        self._set_point[rows] = LEVEL

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array | None = None) -> Array:
        """What to ask of the rotors now.

        Args:
            set_point: (n, 4) roll, pitch [rad], yaw rate [rad/s] and collective thrust per mass [m/s²].
            gyro: (n, 3) measured body rate [rad/s].
            accel: (n, 3) measured specific force [m/s²].
            roll_pitch: (n, 2) estimated roll and pitch [rad], for a network that reads an attitude; others
                estimate it themselves.

        Returns:
            (n, 4) angular acceleration, body axes [rad/s²], and collective thrust per mass [m/s²].
        """
        if self.reads == "attitude":
            if roll_pitch is None:
                raise ValueError("this controller reads an attitude: roll_pitch is required")
            known = np.asarray(roll_pitch, np.float64)
            if known.shape != (len(self._states), 2):
                raise ValueError(f"roll_pitch: shape {known.shape}, should be ({len(self._states)}, 2)")
            accel = gravity_of(known)
        wanted, rate, force = (np.asarray(each, np.float64)[:, None] for each in (set_point, gyro, accel))
        return self.sequence(wanted, rate, force)[:, 0]

    def sequence(self, set_point: ArrayLike, gyro: ArrayLike, accel: ArrayLike) -> Array:
        """T samples, (n, T, 4), (n, T, 3) and (n, T, 3): as T calls of `update`, (n, T, 4).

        A controller that reads an attitude has `gravity_of` it for `accel`.
        """
        wanted, rate, force = (np.asarray(each, np.float64) for each in (set_point, gyro, accel))
        n, steps = len(self._states), rate.shape[1] if rate.ndim == 3 else 0
        if (wanted.shape, rate.shape, force.shape) != ((n, steps, 4), (n, steps, 3), (n, steps, 3)):
            raise ValueError(
                f"set-point {wanted.shape}, gyro {rate.shape} and accel {force.shape}, should be "
                f"({n}, T, 4), ({n}, T, 3) and ({n}, T, 3)"
            )
        found = follow(self.scaling, wanted, self._set_point)
        out = np.empty((n, SET_POINTS * steps))
        rate, force = (np.ascontiguousarray(each).reshape(n, 3 * steps) for each in (rate, force))
        self.core.run(self._states, rate, force, out, found.inputs.reshape(n, 3 * steps))
        action = found.followed
        _answer(out, self.scaling.bound, action)
        return action

    @property
    def states(self) -> NDArray[np.void]:
        """What the network keeps from sample to sample: records (n,), of the core's `state`."""
        return fields(self._states, self.core.state)

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Readings since the start that were missing in part or whole, shape (n,)."""
        return self.states["encoder"]["missing"].copy()


def gravity_of(roll_pitch: ArrayLike) -> Array:
    """Specific force at rest at an attitude: roll and pitch (..., 2) [rad], (..., 3) [m/s²]."""
    angles = np.asarray(roll_pitch, np.float64)
    if angles.shape[-1:] != (2,):
        raise ValueError(f"roll_pitch: shape {angles.shape}, should be (..., 2)")
    out = np.empty((*angles.shape[:-1], 3))
    _gravity(np.ascontiguousarray(angles).reshape(-1, 2), out.reshape(-1, 3))
    return out


class SetPoints(NamedTuple):
    """Set-points as a network has them."""

    followed: Array
    """(n, T, 4), within their limits and without NaN, units as in `SpikingController.update`."""
    inputs: Array
    """(n, T, 3): roll, pitch and yaw rate as integers, in steps of 1/1024."""


def follow(scaling: SetPointScaling, set_point: Array, last: Array | None = None) -> SetPoints:
    """Clip set-points (n, T, 4) to their limits; one that is NaN keeps its value before.

    Args:
        scaling: Limits and ranges.
        set_point: Units as in `SpikingController.update`.
        last: (n, 4) what they were before, changed to what they are at the end; None: level.
    """
    n, steps = set_point.shape[:2]
    last = np.tile(LEVEL, (n, 1)) if last is None else last
    found = SetPoints(np.empty((n, steps, 4)), np.empty((n, steps, SET_POINTS)))
    _follow(set_point, limits_of(scaling), last, found.followed, found.inputs)
    return found


def limits_of(scaling: SetPointScaling) -> Array:
    """Limits, and integers for each radian or rad/s, of roll, pitch and yaw rate, (2, 3)."""
    ranges = np.array([scaling.tilt, scaling.tilt, scaling.yaw_rate])
    return np.array([[scaling.tilt_limit, scaling.tilt_limit, scaling.yaw_rate_limit], INPUT_ONE / ranges])


@njit(cache=True)
def _follow(set_points, limits, last, followed, inputs):
    for n in range(set_points.shape[0]):
        for t in range(set_points.shape[1]):
            for k in range(4):
                value = set_points[n, t, k]
                low, high = (-limits[0, k], limits[0, k]) if k < SET_POINTS else (0.0, THRUST_MAX)
                if not np.isnan(value):
                    last[n, k] = min(max(value, low), high)
                followed[n, t, k] = last[n, k]
            for k in range(SET_POINTS):
                value = np.rint(last[n, k] * limits[1, k])
                inputs[n, t, k] = min(max(value, -INPUT_MAX), INPUT_MAX)


@njit(cache=True)
def _answer(out, bound, followed):
    """Write outputs (n, 3 T), within the bound, in place of what is followed but the thrust, (n, T, 4)."""
    for n in range(followed.shape[0]):
        for t in range(followed.shape[1]):
            for k in range(3):
                followed[n, t, k] = min(max(out[n, 3 * t + k], -bound), bound)


@njit(cache=True)
def _gravity(roll_pitch, out):
    for n in range(out.shape[0]):
        roll, pitch = roll_pitch[n, 0], roll_pitch[n, 1]
        out[n, 0] = -GRAVITY * np.sin(pitch)
        out[n, 1] = GRAVITY * np.sin(roll) * np.cos(pitch)
        out[n, 2] = GRAVITY * np.cos(roll) * np.cos(pitch)
