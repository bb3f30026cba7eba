"""Common parts of filters for n vehicles: start, restart, processing of readings, standard deviations.

A compiled filter is a subclass of `CompiledFilter` in its own file, with its parameters in
`assets/estimators.toml`. It has a record as state, and a compiled step for one vehicle:

    step(s, p, sample) -> roll, pitch
        Process one `samples.Sample`, update the record s, and use the record p of parameters. A filter that
        has diverged returns NaN and restarts at level.

With `samples.run_all`, the file defines a compiled and cached function:

    run(states, samples, params, dt, gyro, accel, rotor_vel, out)
        Process sequences; `update` is a sequence of length 1, so both give the same numbers. The records
        states and samples (n,) are updated. The other arguments are params (1,), gyro and accel (n, T, 3),
        and rotor_vel (n, T, rotors), without columns if not measured. Roll and pitch are written to out (n,
        T, 2).
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
    """A filter for n vehicles, a `quadsim.estimator.AttitudeEstimator`.

    Subclasses implement the start and the run.
    """

    def __init__(self, name: str, rate_hz: float, values: Mapping[str, float]) -> None:
        """Make the filter for one vehicle; `reset` changes their number.

        Args:
            name: Name of the estimator.
            rate_hz: Samples per second.
            values: Values of all parameters.
        """
        self.name, self.rate_hz, self.values = name, rate_hz, dict(values)
        self._dt = 1.0 / rate_hz
        self.reset()

    def reset(self, n: int = 1, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None) -> None:
        """Initialise n vehicles at level or at a known attitude.

        Args:
            n: Number of vehicles.
            roll_pitch: (n, 2) [rad] one sample before the first update, or one pair for all.
            quat: The same attitude as quat_WB (n, 4), which also sets the initial yaw.

        Raises:
            ValueError: A shape does not fit, or both attitudes are given.
        """
        self.state = self._started(*initial_quat(n, roll_pitch, quat))
        self._samples, self._shape, self._sample = initial_samples(n), (n, 3), (n, 1, 3)
        self._no_rotors = np.empty((n, 1, 0))

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Restart some vehicles while the others continue; attitudes (len(ids), ·) are as in `reset`."""
        rows = rows_of(ids, len(self.state))
        if rows.size > 0:
            self.state[rows] = self._started(*initial_quat(rows.size, roll_pitch, quat))
            self._samples[rows] = initial_samples(rows.size)

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Process one sample (n, 3) [rad/s], (n, 3) [m/s²]; return roll and pitch (n, 2) [rad]."""
        gyro = np.ascontiguousarray(gyro, dtype=np.float64)
        accel = np.ascontiguousarray(accel, dtype=np.float64)
        if gyro.shape != self._shape or accel.shape != self._shape:
            raise ValueError(
                f"gyro {gyro.shape} and accel {accel.shape} must both be {self._shape}, as in reset"
            )
        rotors = rotor_speeds(self._shape[:1], sensors)[:, None] if sensors else self._no_rotors
        return self._run(gyro.reshape(self._sample), accel.reshape(self._sample), rotors)[:, 0]

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Process T further samples, (n, T, 3) each; return roll and pitch (n, T, 2) [rad]."""
        gyro, accel = paired(gyro, accel)
        if len(gyro) != len(self.state):
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {len(self.state)}")
        return self._run(gyro, accel, rotor_speeds(gyro.shape[:2], sensors))

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Number of incomplete samples since `reset`, (n,)."""
        return self._samples["skipped"].astype(np.int64)

    def _started(self, quat: Array, known: bool) -> NDArray[Any]:
        """Return states (n,) at quat_WB (n, 4), level if the attitude is not known."""
        raise NotImplementedError

    def _run(self, gyro: Array, accel: Array, rotors: Array) -> Array:
        """Process samples (n, T, ·); return roll and pitch (n, T, 2) [rad]."""
        raise NotImplementedError


def public_field(field: str, about: str) -> property:
    """Return a property for a field of the state; it raises AttributeError if the filter lacks the field."""

    def get(self: "CompiledFilter") -> Array:
        if field not in (self.record.names or ()):
            raise AttributeError(f"{self.name} does not estimate {field}")
        return self.state[field].copy()

    return property(get, doc=about)


class CompiledFilter(BatchedFilter):
    """A filter with compiled equations."""

    record: ClassVar[np.dtype]
    """Record type of the state. The fields quat, gyro_bias and velocity are public."""
    run: ClassVar[Callable[..., None]]
    """Compiled function, as in the module's docstring; a static method."""

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
        """Return the covariance (n, 2, 2) of the tilt error about world x and y, the first errors [rad²]."""
        if "covariance" not in (self.record.names or ()):
            raise AttributeError(f"{self.name} has no covariance")
        return self.state["covariance"][:, :2, :2]

    quat = public_field("quat", "Estimated quat_WB (n, 4).")
    gyro_bias = public_field("gyro_bias", "Estimated gyroscope bias (n, 3) [rad/s].")
    velocity = public_field("velocity", "Estimated velocity in the world axes of `quat`, (n, 3) [m/s].")

    @property
    def roll_pitch_sigma(self) -> Array:
        """Standard deviation of roll and pitch, from the filter's own covariance (n, 2) [rad]."""
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
    """Return the types of parameters and state, one object per filter, so that Numba compares none."""
    return np.dtype([*((name, "f8") for name in names), ("level", record)])


def initial_quat(n: int, roll_pitch: ArrayLike | None, quat: ArrayLike | None) -> tuple[Array, bool]:
    """Return the initial attitude quat_WB (n, 4), level by default, and whether one was given."""
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
    """Convert to two contiguous float64 sequences of the same shape (n, T, 3); otherwise raise ValueError."""
    gyro = np.ascontiguousarray(gyro, dtype=np.float64)
    accel = np.ascontiguousarray(accel, dtype=np.float64)
    if gyro.ndim != 3 or gyro.shape[-1] != 3 or gyro.shape != accel.shape:
        raise ValueError(f"gyro {gyro.shape} and accel {accel.shape} must both have one shape (n, T, 3)")
    return gyro, accel


def rotor_speeds(shape: tuple[int, ...], given: OtherSensors) -> Array:
    """Return the rotor speeds among readings (*shape, ·), without columns if there are none.

    Invalid shapes raise ValueError.
    """
    values = given.get("rotor_vel")
    speeds = np.empty((*shape, 0)) if values is None else np.ascontiguousarray(values, np.float64)
    if speeds.shape[:-1] != shape:
        expected = ", ".join(map(str, shape))
        raise ValueError(f"rotor_vel has shape {speeds.shape}; it must be ({expected}, ·), as gyro")
    return speeds
