"""The protocol of attitude estimators, and the sensor readings that they are given.

To add a sensor, add a field to `Readings` and a key to `OtherSensors`; every estimator then accepts the
sensor.
"""

import inspect
from collections.abc import Callable, Iterable
from typing import NamedTuple, Protocol, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Readings(NamedTuple):
    """Sensor readings of n vehicles: one sample (n, ·), or sequences (n, T, ·). Missing readings are NaN."""

    gyro: Array
    """Body rate, (n, 3) [rad/s]."""
    accel: Array
    """Specific force in body axes, (n, 3) [m/s²]."""
    rotor_vel: Array | None = None
    """Rotor speeds, (n, rotors) [rad/s]; None if they are not measured."""
    mag: Array | None = None
    """Magnetic field in body axes, (n, 3) [T]; None without a magnetometer."""

    def map(self, change: Callable[[Array], Array]) -> "Readings":
        """Apply a function to each array of readings."""
        return Readings(*(None if each is None else change(each) for each in self))  # pyright: ignore[reportArgumentType]

    @property
    def others(self) -> dict[str, Array]:
        """Return the available readings of sensors other than the IMU."""
        return {name: getattr(self, name) for name in OTHERS if getattr(self, name) is not None}

    def give(self, update: Callable[..., Array], accepted: Iterable[str]) -> Array:
        """Call an `update` or a `sequence` with the IMU and those other sensors that it accepts."""
        return update(self.gyro, self.accel, **{name: getattr(self, name) for name in accepted})


OTHERS = Readings._fields[2:]
"""Names of the sensors other than the IMU."""


class OtherSensors(TypedDict, total=False):
    """Readings of sensors other than the IMU, as keyword arguments."""

    rotor_vel: Array | None
    mag: Array | None


def accepted_sensors(update: Callable[..., object]) -> tuple[str, ...]:
    """Return the names of other sensors that an `update` or a `sequence` accepts as keyword arguments."""
    try:
        parameters = inspect.signature(update).parameters.values()
    except ValueError:  # compiled without a signature
        return ()
    if any(each.kind is inspect.Parameter.VAR_KEYWORD for each in parameters):
        return OTHERS
    names = {each.name for each in parameters}
    return tuple(name for name in OTHERS if name in names)


def roll_pitch_of(returned: object, shape: tuple[int, ...], name: str, call: str = "update") -> Array:
    """Convert the return value of an estimator to roll and pitch in double precision [rad].

    See `numbers_of`.
    """
    return numbers_of(returned, shape, f"{name}: {call}", "roll and pitch [rad]")


def numbers_of(returned: object, shape: tuple[int, ...], call: str, what: str) -> Array:
    """Convert the return value of a user's code to an array in double precision.

    Args:
        returned: The return value, an array or convertible to one.
        shape: Required shape.
        call: Name of the call, for the error message.
        what: Description of the required value, for the error message.

    Raises:
        ValueError: The value has the wrong shape, is masked, or does not hold real numbers.
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
    """Convert to a finite array in double precision, broadcast to a shape.

    Raises:
        ValueError: The array has an incompatible shape or a number that is not finite.
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
    """Return the indices (m,) of some of n vehicles, given as indices or as a mask (n,).

    Raises:
        ValueError: An index or the mask does not fit n vehicles.
    """
    given = np.atleast_1d(np.asarray(ids))
    try:
        return np.arange(n)[given if given.size else given.astype(np.intp)]
    except IndexError as error:
        raise ValueError(f"ids of {n} vehicles: {error}") from None


def receives_truth(estimator: object) -> bool:
    """Return whether an estimator is given the true attitude.

    Such an estimator is a reference and is not ranked.
    """
    return callable(getattr(estimator, "observe", None))


class AttitudeEstimator(Protocol):
    """Roll and pitch from a 6-axis IMU, for n vehicles at once, one sample at a time.

    An estimator can have these optional members:

    - `observe(quat)`: receives the true quat_WB (n, 4) just before each `update`. An estimator with this
      member is a reference and is not ranked.
    - `sequence(gyro, accel, **sensors)`: processes T samples, (n, T, 3) each, and returns (n, T, 2). The
      numbers must equal those of T calls of `update`.
    - `restart(ids, roll_pitch=None)`: resets some of the vehicles, while the others continue.
    - `quat` (n, 4) and `reset(quat=...)`: the estimated quaternion quat_WB, and the initial one.
    - `gyro_bias` (n, 3) [rad/s]: the estimated bias of the gyroscope.
    - `roll_pitch_sigma` (n, 2) [rad]: the standard deviation of roll and pitch, from the filter's own
      covariance.
    - `close()`: is called at the end of the flights.
    - `skipped` (n,): the number of samples since `reset` that were incomplete and were bridged by prediction.

    `update` and `sequence` are only called with those keyword arguments of `OtherSensors` that they accept.
    """

    rate_hz: float

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None) -> None:
        """Initialise n vehicles.

        Args:
            n: Number of vehicles.
            roll_pitch: Attitude one sample before the first update, (n, 2) [rad]; None if it is not known.
        """
        ...

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Process one sample.

        Args:
            gyro: Body rate, (n, 3) [rad/s].
            accel: Specific force in body axes, (n, 3) [m/s²].
            sensors: Further readings, as in `Readings`.

        Returns:
            Roll and pitch at the time of this sample, (n, 2) [rad].
        """
        ...
