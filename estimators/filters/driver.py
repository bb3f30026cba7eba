"""The filters of n vehicles: how one starts, restarts, takes readings, and says how sure it is.

A compiled filter is a child of `CompiledFilter` in a file of its own, with its parameters in
`assets/estimators.toml`. It has its state, a record, and one compiled step for one vehicle:

    step(s, p, sample) -> roll, pitch
        Takes one `samples.Sample` into the record s, with the parameters p, a record as well. A filter that
        has diverged returns NaN, and starts again, level.

Its file makes of it, with `samples.run_all`, a function that is compiled once and cached:

    run(states, samples, params, dt, gyro, accel, rotor_vel, out)
        Whole sequences; a streaming `update` is one of length 1, so both give the same numbers. Records
        states and samples (n,) are updated; params (1,); gyro, accel (n, T, 3); rotor_vel (n, T, rotors),
        without columns where it is not measured; out, roll and pitch (n, T, 2), is written.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, ClassVar, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import OtherSensors, broadcast, rows_of
from quadsim.rotation import euler_from_quat, quat_from_roll_pitch, quat_normalize

from .samples import initial_samples

Array = NDArray[np.float64]
Records = NDArray[np.void]


class BatchedFilter:
    """A filter of n vehicles, a `quadsim.estimator.AttitudeEstimator`; a child starts them and runs them."""

    def __init__(self, name: str, rate_hz: float, values: Mapping[str, float]) -> None:
        """Make the filter for one vehicle; `reset` changes their number.

        Args:
            name: Of the estimator.
            rate_hz: Samples per second.
            values: All its parameters.
        """
        self.name, self.rate_hz, self.values = name, rate_hz, dict(values)
        self._dt = 1.0 / rate_hz
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None) -> None:
        """Initialise n vehicles: level, or at a known attitude.

        Args:
            n: Number of vehicles.
            roll_pitch: (n, 2) [rad] one sample before the first update, or one pair for all.
            quat: The same as quat_WB (n, 4); yaw then counts from it.

        Raises:
            ValueError: For shapes that do not fit, or both attitudes at once.
        """
        self.state = self._started(*initial_quat(n, roll_pitch, quat))
        self._samples, self._shape, self._sample = initial_samples(n), (n, 3), (n, 1, 3)
        self._no_rotors = np.empty((n, 1, 0))

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Initialise some vehicles again, the others continue; attitudes (len(ids), ·) as in `reset`."""
        rows = rows_of(ids, len(self.state))
        if rows.size > 0:
            self.state[rows] = self._started(*initial_quat(rows.size, roll_pitch, quat))
            self._samples[rows] = initial_samples(rows.size)

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample (n, 3) [rad/s], (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        gyro = np.ascontiguousarray(gyro, dtype=np.float64)
        accel = np.ascontiguousarray(accel, dtype=np.float64)
        if gyro.shape != self._shape or accel.shape != self._shape:
            raise ValueError(
                f"gyro {gyro.shape} and accel {accel.shape} must both be {self._shape}, as in reset"
            )
        rotors = rotor_speeds(self._shape[:1], sensors)[:, None] if sensors else self._no_rotors
        return self._run(gyro.reshape(self._sample), accel.reshape(self._sample), rotors)[:, 0]

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        gyro, accel = paired(gyro, accel)
        if len(gyro) != len(self.state):
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {len(self.state)}")
        return self._run(gyro, accel, rotor_speeds(gyro.shape[:2], sensors))

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since reset that were missing in part or whole, (n,)."""
        return self._samples["skipped"].astype(np.int64)

    def _started(self, quat: Array, known: bool) -> NDArray[Any]:
        """States (n,) at quat_WB (n, 4), level if it is not known."""
        raise NotImplementedError

    def _run(self, gyro: Array, accel: Array, rotors: Array) -> Array:
        """Take samples (n, T, ·); roll and pitch (n, T, 2) [rad]."""
        raise NotImplementedError


def public_field(field: str, about: str) -> property:
    """A public field of the state; AttributeError for a filter that does not estimate it."""

    def get(self: "CompiledFilter") -> Array:
        if field not in (self.record.names or ()):
            raise AttributeError(f"{self.name} does not estimate {field}")
        return self.state[field].copy()

    return property(get, doc=about)


class CompiledFilter(BatchedFilter):
    """A filter of this package."""

    record: ClassVar[np.dtype]
    """Its state. Fields named quat, gyro_bias and velocity are public."""
    run: ClassVar[Callable[..., None]]
    """As above, a static method."""

    def __init__(self, name: str, rate_hz: float, values: Mapping[str, float]) -> None:
        self.values, self.state = dict(values), np.zeros(0, self.record)
        level = np.zeros(1, self.record)
        self.begin(level, np.array([[1.0, 0.0, 0.0, 0.0]]), False)
        self._params = np.zeros(1, _params_type(self.record, tuple(self.values)))
        self._params[0] = (*self.values.values(), level[0])
        super().__init__(name, rate_hz, values)

    def begin(self, states: Records, quat: Array, known: bool) -> None:
        """Initialise states (n,) of zeros at quat_WB (n, 4)."""
        states["quat"] = quat

    def tilt_covariance(self) -> Array:
        """Covariance (n, 2, 2) [rad²] of the tilt's error about world x and y, by which errors begin."""
        if "covariance" not in (self.record.names or ()):
            raise AttributeError(f"{self.name} has no covariance")
        return self.state["covariance"][:, :2, :2]

    quat = public_field("quat", "Estimated quat_WB (n, 4).")
    gyro_bias = public_field("gyro_bias", "Estimated gyroscope bias (n, 3) [rad/s].")
    velocity = public_field("velocity", "Estimated velocity in the world axes of `quat`, (n, 3) [m/s].")

    @property
    def roll_pitch_sigma(self) -> Array:
        """Standard deviation of roll and pitch, by the filter's own covariance (n, 2) [rad]."""
        tilt = self.tilt_covariance()
        _, pitch, yaw = np.moveaxis(euler_from_quat(self.quat), -1, 0)
        turn = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], axis=-1).reshape(-1, 2, 2)
        variance = np.diagonal(turn @ tilt @ np.swapaxes(turn, 1, 2), axis1=1, axis2=2)
        sigma = np.sqrt(np.maximum(variance, 0.0))
        sigma[:, 0] /= np.maximum(np.cos(pitch), 1e-3)
        return np.minimum(sigma, math.pi)

    def _started(self, quat: Array, known: bool) -> Records:
        states = np.zeros(len(quat), self.record)
        self.begin(states, quat, known)
        return states

    def _run(self, gyro: Array, accel: Array, rotors: Array) -> Array:
        out = np.empty((len(gyro), gyro.shape[1], 2))
        self.run(self.state, self._samples, self._params, self._dt, gyro, accel, rotors, out)
        return out


@cache
def _params_type(record: np.dtype, names: tuple[str, ...]) -> np.dtype:
    """Parameters and a state at level; one object for each filter: Numba compares others in every call."""
    return np.dtype([*((name, "f8") for name in names), ("level", record)])


def initial_quat(n: int, roll_pitch: ArrayLike | None, quat: ArrayLike | None) -> tuple[Array, bool]:
    """Attitude to start from, quat_WB (n, 4), level if none is given, and whether one was given."""
    if n < 1:
        raise ValueError(f"n = {n}: an estimator needs at least one vehicle")
    if roll_pitch is not None and quat is not None:
        raise ValueError("give roll_pitch or quat, not both")
    if quat is not None:
        return quat_normalize(broadcast("quat", quat, (n, 4))), True
    if roll_pitch is not None:
        return quat_from_roll_pitch(broadcast("roll_pitch", roll_pitch, (n, 2))), True
    return np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), False


def paired(gyro: ArrayLike, accel: ArrayLike) -> tuple[Array, Array]:
    """Two contiguous float64 sequences of the same shape (n, T, 3), or ValueError."""
    gyro = np.ascontiguousarray(gyro, dtype=np.float64)
    accel = np.ascontiguousarray(accel, dtype=np.float64)
    if gyro.ndim != 3 or gyro.shape[-1] != 3 or gyro.shape != accel.shape:
        raise ValueError(f"gyro {gyro.shape} and accel {accel.shape} must both have one shape (n, T, 3)")
    return gyro, accel


def rotor_speeds(shape: tuple[int, ...], given: OtherSensors) -> Array:
    """Rotor speeds among readings (*shape, ·), without columns where there are none, or ValueError."""
    values = given.get("rotor_vel")
    speeds = np.empty((*shape, 0)) if values is None else np.ascontiguousarray(values, np.float64)
    if speeds.shape[:-1] != shape:
        expected = ", ".join(map(str, shape))
        raise ValueError(f"rotor_vel has shape {speeds.shape}; it must be ({expected}, ·), as gyro")
    return speeds
