"""The protocol of attitude controllers, which replace the attitude and body-rate loops of the cascade.

The position and velocity loops of the cascade compute the set-point of an attitude controller. The cascade's
allocation converts its command to rotor speeds within their limits.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..estimator import numbers_of
from ..own import named_errors
from ..runs.compiled import njit
from ..vehicle import Vehicle
from .cascade import apply_action, attitude_set_point
from .records import ATTITUDE, ROTOR

Array = NDArray[np.float64]


class AttitudeController(Protocol):
    """Controls the attitude of n vehicles, one sample at a time.

    If a controller has an attribute `rotor_speeds` that is true, `update` returns rotor speeds, (n, rotors)
    [rad/s].
    """

    def reset(self, n: int) -> None:
        """Start n vehicles. A controller that also has `restart(ids)` can restart single vehicles."""
        ...

    def update(self, set_point: Array, gyro: Array, accel: Array, roll_pitch: Array) -> Array:
        """Compute the command for the rotors.

        Args:
            set_point: (n, 4) roll, pitch [rad], yaw rate [rad/s] and collective thrust per mass [m/s²].
            gyro: (n, 3) measured body rate [rad/s]. A missing sample is replaced by the last valid one.
            accel: (n, 3) measured specific force [m/s²]. A missing sample is replaced by the last valid one.
            roll_pitch: (n, 2) estimated roll and pitch [rad].

        Returns:
            Angular acceleration in body axes [rad/s²] and collective thrust per mass [m/s²], shape (n, 4).
        """
        ...


MakeController = Callable[[float, Vehicle], AttitudeController]
"""Factory of controllers, called as make(rate_hz, vehicle)."""


def made_controller(make: MakeController, rate_hz: float, vehicle: Vehicle) -> AttitudeController:
    """Return the controller that a factory makes.

    Raises:
        ValueError: The factory fails, or returns an object that is not a controller.
    """
    name = getattr(make, "__name__", type(make).__name__)
    with named_errors(f"controller {name} is made with (rate_hz, vehicle), and"):
        controller = make(rate_hz, vehicle)
    if missing := [each for each in ("reset", "update") if not callable(getattr(controller, each, None))]:
        raise ValueError(f"{name} makes no attitude controller: it has no {' and no '.join(missing)}")
    return controller


def start_own(part: Any, name: str, ids: NDArray[np.int64], n: int, **start: Any) -> None:
    """Start some of the n vehicles of a user's controller or estimator: all by `reset`, a part by `restart`.

    Raises:
        ValueError: The user's code fails or cannot restart single vehicles.
    """
    if len(ids) == n:
        with named_errors(f"{name}: reset"):
            part.reset(n, **start)
    elif not hasattr(part, "restart"):
        raise ValueError(f"{name} has no restart(ids): it starts all vehicles or none")
    else:
        with named_errors(f"{name}: restart"):
            part.restart(ids.copy(), **start)


class InnerLoop:
    """Connects an attitude controller to the records of a loop.

    Args:
        controller: The attitude controller.
        records: (n,) records with the fields `set_point`, `measured` and `controller`.
    """

    def __init__(self, controller: AttitudeController, records: NDArray[np.void]) -> None:
        self.controller, self.records = controller, records
        self.name = type(controller).__name__
        self.set_point = np.zeros((len(records), 4))
        """Set-points of the last sample, (n, 4)."""
        self._accel = np.zeros((len(records), 3))

    def reset(self, ids: NDArray[np.int64]) -> None:
        """Start some vehicles; see `start_own`."""
        self._accel[ids] = 0.0
        start_own(self.controller, f"controller {self.name}", ids, len(self.records))

    def steer(self, level: int, accel: Array) -> int:
        """Write rotor speeds for the commands in the records.

        Return the number of the level of the written command.

        Args:
            level: Number of the level of the commands, 0 (position) to 4 (rotor). Commands at levels 3 and 4
                bypass the controller.
            accel: (n, 3) measured specific force [m/s²].

        Raises:
            ValueError: The controller fails, or returns numbers that are not finite or an array of the wrong
                shape.
        """
        if level > ATTITUDE:
            return level
        guide_all(level, self.records, self.set_point)
        measured = self.records["measured"]
        self._accel = np.where(np.isfinite(accel), accel, self._accel)
        given = self.set_point, measured["gyro"], self._accel, measured["roll_pitch"]
        call = f"controller {self.name}: update"
        with named_errors(call, passing=()):
            returned = self.controller.update(*map(np.array, given))
        what, shape = "angular acceleration [rad/s²] and thrust per mass [m/s²]", self.set_point.shape
        speeds = self.records["controller"]["rotor_vel_cmd"]
        if direct := getattr(self.controller, "rotor_speeds", False):
            what, shape = "speeds of rotors [rad/s]", speeds.shape
        action = numbers_of(returned, shape, call, what)
        if not np.isfinite(action).all():
            raise ValueError(f"{call} returns numbers that are not finite")
        if direct:
            speeds[:] = action
        else:
            apply_actions(self.records, action)
        return ROTOR


@njit(cache=True)
def guide_all(level, loops, out):
    """Run `attitude_set_point` for records (n,), and write to `out` (n, 4)."""
    for i in range(loops.shape[0]):
        attitude_set_point(level, loops[i].set_point, loops[i].measured, loops[i].controller, out[i])


@njit(cache=True)
def apply_actions(loops, actions):
    """Run `actuate` for records (n,) and actions (n, 4)."""
    for i in range(loops.shape[0]):
        apply_action(loops[i].measured, loops[i].controller, actions[i])
