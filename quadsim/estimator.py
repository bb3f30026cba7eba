"""What the simulator asks of an attitude estimator, and the sensor readings that it gives it.

A further sensor is a field of `Readings` and a key of `OtherSensors`; every estimator then accepts it.
"""

import inspect
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Readings(NamedTuple):
    """Sensor readings of n vehicles: one sample (n, ·), or sequences (n, T, ·); NaN where missing."""

    gyro: Array
    """Body rate, (n, 3) [rad/s]."""
    accel: Array
    """Specific force in body axes, (n, 3) [m/s²]."""
    rotor_vel: Array | None = None
    """Rotor speeds, (n, rotors) [rad/s]; None where they are not measured."""
    mag: Array | None = None
    """Magnetic field in body axes, (n, 3) [T]; None where there is no magnetometer."""

    def map(self, change: Callable[[Array], Array]) -> "Readings":
        """The readings with each array changed alike."""
        return Readings(*(None if each is None else change(each) for each in self))  # pyright: ignore[reportArgumentType]

    @property
    def others(self) -> dict[str, Array]:
        """The readings of the sensors beside the IMU, where present."""
        return {name: getattr(self, name) for name in OTHERS if getattr(self, name) is not None}

    def give(self, update: Callable[..., Array], accepted: Iterable[str]) -> Array:
        """Call an `update` or a `sequence` with the sensors beside the IMU that it accepts."""
        return update(self.gyro, self.accel, **{name: getattr(self, name) for name in accepted})


OTHERS = Readings._fields[2:]
"""Sensors beside the IMU."""


class OtherSensors(TypedDict, total=False):
    """Readings beside the IMU's, as keyword arguments."""

    rotor_vel: Array | None
    mag: Array | None


def accepted_sensors(update: Callable[..., object]) -> tuple[str, ...]:
    """Names of the sensors beside the IMU that an `update` or a `sequence` accepts as keywords."""
    try:
        parameters = inspect.signature(update).parameters.values()
    except ValueError:  # compiled without a signature
        return ()
    if any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters):
        return OTHERS
    names = {each.name for each in parameters}
    return tuple(name for name in OTHERS if name in names)


def roll_pitch_of(returned: object, shape: tuple[int, ...], name: str, call: str = "update") -> Array:
    """What an estimator returned, as roll and pitch [rad] in double precision, see `numbers_of`."""
    return numbers_of(returned, shape, f"{name}: {call}", "roll and pitch [rad]")


def numbers_of(returned: object, shape: tuple[int, ...], call: str, what: str) -> Array:
    """What a user's code returned, in double precision.

    Args:
        returned: An array, or what makes one.
        shape: The shape that it must have.
        call: What returned it, for the message.
        what: What it must be, for the message.

    Raises:
        ValueError: It has another shape, is masked, or does not hold real numbers.
    """
    if type(returned) is np.ndarray and returned.shape == shape and returned.dtype == np.float64:
        return returned
    array = np.asarray(returned)
    kind = "masked" if isinstance(returned, np.ma.MaskedArray) else str(array.dtype)
    if kind == "masked" or array.dtype.kind not in "fiu" or array.shape != shape:
        raise ValueError(
            f"{call} returns a {kind} array of shape {array.shape}; {what}, real numbers of shape {shape}, "
            "are required"
        )
    return array.astype(np.float64)


def broadcast(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """A finite array in double precision, broadcast to a shape.

    Raises:
        ValueError: It has another shape, or a number that is not finite.
    """
    array = np.asarray(value, dtype=np.float64)
    try:
        full = np.broadcast_to(array, shape).copy()
    except ValueError:
        raise ValueError(f"{name} has shape {array.shape}; it must be {shape}") from None
    if not np.isfinite(full).all():
        raise ValueError(
            f"{name} must be finite; it has {np.count_nonzero(~np.isfinite(full))} values that are not"
        )
    return full


def rows_of(ids: ArrayLike, n: int) -> NDArray[np.intp]:
    """Indices (m,) of some of n vehicles, given by their indices or by a mask (n,).

    Raises:
        ValueError: There are no such vehicles.
    """
    given = np.atleast_1d(np.asarray(ids))
    try:
        return np.arange(n)[given if given.size else given.astype(np.intp)]
    except IndexError as error:
        raise ValueError(f"ids of {n} vehicles: {error}") from None


def receives_truth(estimator: object) -> bool:
    """Whether an estimator is fed the true attitude: a reference, which no table ranks."""
    return callable(getattr(estimator, "observe", None))


class AttitudeEstimator(Protocol):
    """Roll and pitch from a 6-axis IMU, for n vehicles at once, one sample at a time.

    Optional members, looked up by name where they are used:

    - `observe(quat)`: an estimator that is fed the truth; called with quat_WB (n, 4) just before `update`.
      It is a reference: tables mark it and do not rank it.
    - `sequence(gyro, accel, **sensors)`: (n, T, 3) twice -> (n, T, 2), the same numbers as T calls of
      `update`, faster.
    - `restart(ids, roll_pitch=None)`: `reset` for some of the vehicles, the others continue.
    - `quat` (n, 4), and `reset(quat=...)`: the filter estimates a quaternion quat_WB.
    - `gyro_bias` (n, 3) [rad/s]: the filter estimates the bias of its gyroscope.
    - `roll_pitch_sigma` (n, 2) [rad]: standard deviation of roll and pitch, by the filter's own covariance.
    - `close()`: called at the end of the flights.
    - `skipped` (n,): samples since `reset` that were missing in part or whole and were bridged by prediction.

    An `update` or a `sequence` without the keywords of `OtherSensors` is called without them.
    """

    rate_hz: float

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Initialise n vehicles.

        Args:
            n: Number of vehicles.
            roll_pitch: Attitude one sample before the first update, (n, 2) [rad]; None where it is not known.
        """
        ...

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample.

        Args:
            gyro: Body rate, (n, 3) [rad/s].
            accel: Specific force in body axes, (n, 3) [m/s²].
            sensors: Further readings, as in `Readings`.

        Returns:
            Roll and pitch at the time of this sample, (n, 2) [rad].
        """
        ...
