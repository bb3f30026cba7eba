"""A spiking network as attitude controller: set-points and readings to angular accelerations.

It takes the place of the cascade's levels of attitude and body rate, see `quadsim.control.own`. As of an
attitude network, the host scales inputs and outputs and no more; its memory is the last valid inputs.

Inputs are bounded and so are outputs. A set-point is clipped to the limits of the file's `SetPointScaling`;
one that is NaN keeps its last value, and so does a missing reading. An angular acceleration is clipped to
`bound`. There is no integral beside the potentials of the neurons, which the chip limits to 1024 thresholds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.runs.block import fields, zero_blocks
from quadsim.vehicle import GRAVITY, Vehicle

from ..networks.encoder import INPUT_MAX, INPUT_ONE
from ..networks.network import OnLoihi, Spiking
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

LOIHI = "-loihi"
"""End of the name of a controller that runs in the chip's integers."""
THRUST_MAX = 100.0
"""Largest collective thrust per mass that passes through [m/s²]."""


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
    config, tensors = load_network(path)
    if not config.controls:
        ships = ", ".join(shipped_controllers()) or "none"
        raise ValueError(f"{path}: an attitude estimator, not a controller; controllers that ship: {ships}")
    if not np.isclose(rate_hz, config.rate_hz):
        raise ValueError(f"{path}: the weights are for {config.rate_hz:g} Hz, not for {rate_hz:g} Hz")
    return SpikingController(config, tensors, on_loihi=name.endswith(LOIHI))


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

    Raises:
        ValueError: The network is no controller, or not for the chip.
    """

    def __init__(self, config: NetworkConfig, tensors: Tensors, on_loihi: bool = False) -> None:
        if config.set_point is None:
            raise ValueError("these weights are an attitude estimator's, a controller needs a controller's")
        self.core = OnLoihi(config, tensors) if on_loihi else Spiking(config, tensors)
        self.scaling, self.rate_hz = config.set_point, config.rate_hz
        self.reset(1)

    def reset(self, n: int) -> None:
        """Start n vehicles: at rest, with level set-points."""
        self._states = zero_blocks(n, self.core.state)
        self._set_point = np.zeros((n, 1 + SET_POINTS))
        self._set_point[:, SET_POINTS] = GRAVITY

    def restart(self, ids: ArrayLike) -> None:
        """Start some of the vehicles again."""
        rows = np.arange(len(self._states))[np.asarray(ids, dtype=np.intp)]
        self._states[rows] = zero_blocks(rows.size, self.core.state)
        self._set_point[rows] = (0.0, 0.0, 0.0, GRAVITY)

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array | None = None) -> Array:
        """What to ask of the rotors now.

        Args:
            set_point: (n, 4) roll, pitch [rad], yaw rate [rad/s] and collective thrust per mass [m/s²].
            gyro: (n, 3) measured body rate [rad/s].
            accel: (n, 3) measured specific force [m/s²].
            roll_pitch: Not used: the network estimates the attitude itself, or its first part does.

        Returns:
            (n, 4) angular acceleration, body axes [rad/s²], and collective thrust per mass [m/s²].
        """
        wanted, rate, force = (np.asarray(each, np.float64)[:, None] for each in (set_point, gyro, accel))
        return self.sequence(wanted, rate, force)[:, 0]

    def sequence(self, set_point: ArrayLike, gyro: ArrayLike, accel: ArrayLike) -> Array:
        """T samples, (n, T, 4), (n, T, 3) and (n, T, 3): as T calls of `update`, (n, T, 4)."""
        wanted, rate, force = (np.asarray(each, np.float64) for each in (set_point, gyro, accel))
        n, steps = len(self._states), rate.shape[1] if rate.ndim == 3 else 0
        if (wanted.shape, rate.shape, force.shape) != ((n, steps, 4), (n, steps, 3), (n, steps, 3)):
            raise ValueError(
                f"set-point {wanted.shape}, gyro {rate.shape} and accel {force.shape}, should be "
                f"({n}, T, 4), ({n}, T, 3) and ({n}, T, 3)"
            )
        wanted = held(np.concatenate([self._set_point[:, None], bounded(self.scaling, wanted)], 1))
        self._set_point = wanted[:, -1]
        wanted = wanted[:, 1:]
        gyro, accel = (np.ascontiguousarray(each).reshape(n, -1) for each in (rate, force))
        out = np.empty((n, SET_POINTS * steps))
        inputs = set_point_inputs(self.scaling, wanted).reshape(n, -1)
        self.core.run(self._states, gyro, accel, out, inputs)
        action = np.empty((n, steps, 4))
        bound = self.scaling.bound
        action[:, :, :3] = np.clip(out.reshape(n, steps, 3), -bound, bound)
        action[:, :, 3] = wanted[:, :, 3]
        return action

    @property
    def states(self) -> NDArray[np.void]:
        """What the network keeps from sample to sample: records (n,), of the core's `state`."""
        return fields(self._states, self.core.state)

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Readings since the start that were missing in part or whole, shape (n,)."""
        return self.states["encoder"]["missing"].copy()


def bounded(scaling: SetPointScaling, set_point: Array) -> Array:
    """Set-points (..., 4) within their limits; what is not a number stays so."""
    tilt, yaw_rate = scaling.tilt_limit, scaling.yaw_rate_limit
    return np.clip(set_point, (-tilt, -tilt, -yaw_rate, 0.0), (tilt, tilt, yaw_rate, THRUST_MAX))


def held(values: Array) -> Array:
    """Values (n, T, k) where each NaN has the value before it; the first row has none."""
    if np.isfinite(values).all():
        return values
    found = np.where(np.isnan(values), 0, np.arange(values.shape[1])[:, None])
    return np.take_along_axis(values, np.maximum.accumulate(found, axis=1), axis=1)


def set_point_inputs(scaling: SetPointScaling, set_point: Array) -> Array:
    """Set-points (..., 4), bounded and without NaN, as integer inputs (..., 3) in steps of 1/1024."""
    per_unit = INPUT_ONE / np.array([scaling.tilt, scaling.tilt, scaling.yaw_rate])
    return np.clip(np.rint(set_point[..., :SET_POINTS] * per_unit), -INPUT_MAX, INPUT_MAX)
