"""A spiking network as attitude controller, from set-points and readings to angular accelerations.

The controller replaces the attitude and body-rate loops of the cascade (see
`quadsim.control.attitude_controller`). Its inputs are set-point, body rate, and roll and pitch from any
estimator. As for an attitude network, the host only scales inputs and outputs, and stores only the last valid
inputs.

Inputs and outputs are bounded. A set-point is clipped to the limits of the file's `SetPointScaling`. A
set-point that is NaN and a missing reading keep their last values. An angular acceleration is clipped to
`bound`. The only integrators are the potentials of the neurons, which the chip limits to 1024 thresholds.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.config.toml import nearest
from quadsim.control.attitude_controller import MakeController
from quadsim.own import is_own, load_own
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY, Vehicle

from ..networks.encoder import INPUT_MAX, INPUT_ONE
from ..networks.forward import OnLoihi
from ..networks.network import BatchedNetwork, Spiking
from ..networks.weights_file import (
    END,
    SET_POINTS,
    NetworkConfig,
    SetPointScaling,
    Tensors,
    load_network,
    shipped_controllers,
)

Array = NDArray[np.float64]

CASCADED = "cascaded"
BUILT_IN: dict[str, tuple[str, MakeController | None]] = {
    CASCADED: ("Attitude and body rate in cascade; gains designed for phase margins.", None),
}
"""Controllers without weights: description and factory of each; the factory None means the cascade."""
GROUP = "quadsim.controllers"
"""Group of entry points for controllers of installed packages."""
LOIHI = "-loihi"
"""Suffix of the names of controllers that run in the chip's integers."""
THRUST_MAX = 100.0
"""Largest collective thrust per mass [m/s²]."""
LEVEL = np.array([0.0, 0.0, 0.0, GRAVITY])
"""Initial set-point."""


def create_controller(
    path_or_name: str | Path, rate_hz: float = 200.0, vehicle: Vehicle | None = None
) -> SpikingController:
    """Make a spiking attitude controller.

    Args:
        path_or_name: A weights file, or the name of a shipped controller. With the suffix "-loihi", the
            controller runs in the emulated chip's integers.
        rate_hz: Samples per second, which must be the rate of the training.
        vehicle: Not used, because the controller commands angular accelerations.

    Raises:
        FileNotFoundError: No such file.
        ValueError: The weights are those of an attitude estimator or of another sample rate.
    """
    name = str(path_or_name)
    path = name.removesuffix(LOIHI)
    config, tensors = load_network(path)
    if not config.controls:
        ships = ", ".join(shipped_controllers())
        raise ValueError(f"{path}: an attitude estimator, not a controller; controllers that ship: {ships}")
    if not np.isclose(rate_hz, config.rate_hz):
        raise ValueError(f"{path}: the weights are for {config.rate_hz:g} Hz, not for {rate_hz:g} Hz")
    return SpikingController(config, tensors, name.endswith(LOIHI))


def is_controller(name: str) -> bool:
    """Return whether a name is a path or a shipped name of a controller's weights."""
    path = name.removesuffix(LOIHI)
    return path.endswith(END) or path in shipped_controllers()


def make_controller(name: str | Path) -> MakeController | None:
    """Return the factory of a controller; None for the cascade.

    Args:
        name: "cascaded"; weights of a spiking controller, by path or shipped name; or your own factory,
            called as make(rate_hz, vehicle): "module:make", "path/file.py:make" or an entry point of the
            group "quadsim.controllers".

    Raises:
        ValueError: The controller does not exist.
    """
    name = str(name)
    if name in BUILT_IN:
        return BUILT_IN[name][1]
    if is_controller(name):
        return partial(create_controller, name)
    if not is_own(name, GROUP):
        known = nearest(name, [*BUILT_IN, *shipped_controllers()])
        raise ValueError(f'unknown controller "{name}"; {known}, or your own file.py:make')
    return load_own(name, GROUP)


class SpikingController(BatchedNetwork):
    """A network that controls the attitude of n vehicles; an `AttitudeController`.

    Args:
        config: Configuration of the network.
        tensors: Weights.
        on_loihi: Whether to run in the emulated chip's integers, with the same outputs.

    Raises:
        ValueError: The network is not a controller, or does not run on the chip.
    """

    def __init__(self, config: NetworkConfig, tensors: Tensors, on_loihi: bool = False) -> None:
        if config.set_point is None:
            raise ValueError("these weights are an attitude estimator's, a controller needs a controller's")
        self.scaling = config.set_point
        self.core: Spiking
        super().__init__((OnLoihi if on_loihi else Spiking)(config, tensors), config.rate_hz)
        self.reset(1)

    def reset(self, n: int) -> None:
        """Start n vehicles at rest with level set-points."""
        self.begin(n)
        self._set_point = np.tile(LEVEL, (n, 1))

    def restart(self, ids: ArrayLike) -> None:
        """Restart some vehicles."""
        self._set_point[self._begin_again(ids)] = LEVEL

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """Compute the command for the rotors.

        Args:
            set_point: (n, 4) roll, pitch [rad], yaw rate [rad/s] and collective thrust per mass [m/s²].
            gyro: (n, 3) measured body rate [rad/s].
            accel: (n, 3) measured specific force [m/s²]; not used.
            roll_pitch: (n, 2) estimated roll and pitch [rad].

        Returns:
            (n, 4) angular acceleration, body axes [rad/s²], and collective thrust per mass [m/s²].
        """
        known, n = np.asarray(roll_pitch, np.float64), len(self._states)
        if known.shape != (n, 2):
            raise ValueError(f"roll_pitch: shape {known.shape}, should be ({n}, 2)")
        signals = set_point, gyro, gravity_of(known)
        wanted, rate, gravity = (np.asarray(each, np.float64)[:, None] for each in signals)
        return self.sequence(wanted, rate, gravity)[:, 0]

    def sequence(self, set_point: ArrayLike, gyro: ArrayLike, gravity: ArrayLike) -> Array:
        """Process T set-points (n, T, 4), body rates (n, T, 3), and `gravity_of` attitudes (n, T, 3).

        Returns:
            The commands of T calls of `update`, (n, T, 4).
        """
        wanted, rate = np.asarray(set_point, np.float64), np.asarray(gyro, np.float64)
        shape = len(self._states), rate.shape[1] if rate.ndim == 3 else 0, 4
        if wanted.shape != shape:
            raise ValueError(f"set_point: shape {wanted.shape}, should be {shape}")
        found = follow(self.scaling, wanted, self._set_point)
        out = self.outputs(rate, gravity, found.inputs)
        bound = self.scaling.bound
        return np.concatenate([out.clip(-bound, bound), found.followed[..., SET_POINTS:]], -1)


def gravity_of(roll_pitch: ArrayLike) -> Array:
    """Return the specific force at rest (..., 3) [m/s²] for roll and pitch (..., 2) [rad]."""
    angles = np.asarray(roll_pitch, np.float64)
    if angles.shape[-1:] != (2,):
        raise ValueError(f"roll_pitch: shape {angles.shape}, should be (..., 2)")
    roll, pitch = np.moveaxis(angles, -1, 0)
    up = [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
    return GRAVITY * np.stack(up, -1)


class SetPoints(NamedTuple):
    """Set-points as inputs of a network."""

    followed: Array
    """Set-points within their limits and without NaN, (n, T, 4), in the units of
    `SpikingController.update`."""
    inputs: Array
    """Roll, pitch and yaw rate as integers in steps of 1/1024, (n, T, 3)."""


def follow(scaling: SetPointScaling, set_point: Array, last: Array | None = None) -> SetPoints:
    """Clip set-points (n, T, 4) to their limits; NaN keeps the previous value.

    Args:
        scaling: Limits and ranges.
        set_point: Set-points in the units of `SpikingController.update`.
        last: (n, 4) previous set-points, updated to the last ones; None: level.
    """
    n, steps = set_point.shape[:2]
    last = np.tile(LEVEL, (n, 1)) if last is None else last
    limits = np.array([scaling.tilt_limit, scaling.tilt_limit, scaling.yaw_rate_limit])
    found = SetPoints(np.empty((n, steps, 4)), np.empty((n, steps, SET_POINTS)))
    _follow(set_point, limits, set_point_gain(scaling), last, found.followed, found.inputs)
    return found


def set_point_gain(scaling: SetPointScaling) -> Array:
    """Return the integer inputs per rad of roll and pitch and per rad/s of yaw rate, (3,)."""
    return INPUT_ONE / np.array([scaling.tilt, scaling.tilt, scaling.yaw_rate])


@njit(cache=True)
def _follow(set_points, limits, gain, last, followed, inputs):
    for n in range(set_points.shape[0]):
        for t in range(set_points.shape[1]):
            for k in range(4):
                value = set_points[n, t, k]
                low, high = (-limits[k], limits[k]) if k < SET_POINTS else (0.0, THRUST_MAX)
                if not np.isnan(value):
                    last[n, k] = min(max(value, low), high)
                followed[n, t, k] = last[n, k]
            for k in range(SET_POINTS):
                inputs[n, t, k] = min(max(np.rint(last[n, k] * gain[k]), -INPUT_MAX), INPUT_MAX)
