"""Compiled filters: what an algorithm is, and the estimator that runs one on n vehicles.

A filter is its parameters, its state and one compiled step:

    step(s, p, sample) -> roll, pitch
        Takes one `samples.Sample` for one vehicle, whose record s is updated, with the parameters p, a record
        as well. A filter that has diverged returns NaN, and starts again, level.

Its file makes of it, with `samples.run_all`, a function that is compiled once and cached:

    run(states, params, dt, gyro, accel, rotor_vel, out)
        Whole sequences; a streaming `update` is one of length 1, so both give the same numbers. Records
        states (p·n,) and params (p,): parameter set i estimates flight j in state i·n + j. gyro, accel
        (n, T, 3); rotor_vel (n, T, rotors), without columns where it is not measured; out (p·n, T, 2).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.config.toml import nearest
from quadsim.estimator import OtherSensors
from quadsim.rotation import euler_from_quat, quat_from_roll_pitch, quat_normalize

from .samples import SAMPLES, initial_states

Array = NDArray[np.float64]
Records = NDArray[np.void]
Scale = Literal["linear", "log", "one-minus-log"]
FROM_VEHICLE = math.nan
"""Default of a parameter that only the vehicle's file gives."""


@dataclass(frozen=True)
class Parameter:
    """One number of a filter: its default, what is allowed, and where a search looks for it."""

    default: float
    low: float
    """Lower end of the search."""
    high: float
    """Upper end of the search."""
    scale: Scale = "log"
    """How the search's [0, 1] maps to low…high: evenly, by factors, or by factors of the distance from 1."""
    minimum: float = 0.0
    maximum: float = math.inf
    searched: bool = True
    """False for a known constant that tuning leaves alone."""
    per_sample: Literal["", "weight", "memory"] = ""
    """What a number that acts once a sample does, so that it can be converted to another sample rate."""

    def at(self, unit: ArrayLike) -> Array:
        """Value at a position of the search, 0…1 -> low…high."""
        x = np.asarray(unit, dtype=np.float64)
        match self.scale:
            case "linear":
                return self.low + (self.high - self.low) * x
            case "log":
                return self.low * (self.high / self.low) ** x
            case "one-minus-log":
                return 1.0 - (1.0 - self.low) * ((1.0 - self.high) / (1.0 - self.low)) ** x

    def position(self, value: float) -> float:
        """Where a value lies in the search, the inverse of `at`, within 0…1."""
        low, high = self.low, self.high
        match self.scale:
            case "linear":
                x = (value - low) / (high - low)
            case "log":
                x = math.log(max(value, low) / low) / math.log(high / low)
            case "one-minus-log":
                x = math.log(max(1.0 - value, 1.0 - high) / (1.0 - low)) / math.log(
                    (1.0 - high) / (1.0 - low)
                )
        return min(max(x, 0.0), 1.0)

    def carried(self, value: float, rate_ratio: float) -> float:
        """The value that acts alike at another sample rate, old rate / new rate given."""
        match self.per_sample:
            case "memory":
                return value**rate_ratio
            case "weight":
                return value * rate_ratio
            case _:
                return value


def start_at(states: Records, quat: Array, known: bool, params: Records) -> None:
    """Start filters whose state is all zero but for the attitude."""
    states["quat"] = quat


@dataclass(frozen=True)
class Algorithm:
    """A compiled filter without data."""

    name: str
    parameters: Mapping[str, Parameter]
    state: np.dtype
    """The filter's own fields. Those named quat (quat_WB), gyro_bias and velocity (in world axes at the
    filter's own heading) are public."""
    run: Callable[..., None]
    start: Callable[[Records, Array, bool, Records], None] = start_at
    """start(states, quat, known, params): initialise records (rows,) from quat (rows, 4), params (rows,)."""
    tilt_covariance: Callable[[Records], Array] | None = None
    """tilt_covariance(states): covariance (n, 2, 2) [rad²] of the tilt's error about world x and y; None
    where the filter has no covariance."""

    @cached_property
    def record(self) -> np.dtype:
        """The whole state; one object for each filter: Numba compares others field by field in every call."""
        return np.dtype([*self.state.descr, *SAMPLES.descr])

    @cached_property
    def _params(self) -> np.dtype:
        numbers = self.state.itemsize // 8
        return np.dtype([*((name, "f8") for name in self.parameters), ("start", "f8", numbers)])

    def records(self, matrix: Array) -> Records:
        """Parameter sets (p, k), in the order of `parameters`, as records (p,) with a level start."""
        records = np.zeros(len(matrix), self._params)
        for name, column in zip(self.parameters, matrix.T, strict=True):
            records[name] = column
        level = start(self, records, 1).view(np.float64).reshape(len(matrix), -1)
        records["start"] = level[:, : self.state.itemsize // 8]
        return records


class Filter:
    """A compiled filter of n vehicles, a `quadsim.estimator.AttitudeEstimator`."""

    def __init__(self, algorithm: Algorithm, rate_hz: float, values: Mapping[str, float]) -> None:
        """Make the filter for one vehicle; `reset` changes their number.

        Args:
            algorithm: What to run.
            rate_hz: Samples per second.
            values: All its parameters.
        """
        self.algorithm, self.rate_hz, self.values = algorithm, rate_hz, dict(values)
        self._params = algorithm.records(np.array([[values[name] for name in algorithm.parameters]]))
        self._run, self._dt = algorithm.run, 1.0 / rate_hz
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
        self._states = start(self.algorithm, self._params, n, roll_pitch, quat)
        self._shape, self._sample = (n, 3), (n, 1, 3)
        self._no_rotors = np.empty((n, 1, 0))

    def restart(
        self, ids: ArrayLike, roll_pitch: ArrayLike | None = None, quat: ArrayLike | None = None
    ) -> None:
        """Initialise some vehicles again, the others continue; attitudes (len(ids), ·) as in `reset`."""
        rows = np.atleast_1d(np.asarray(ids, dtype=np.intp))
        if rows.size > 0:
            self._states[rows] = start(self.algorithm, self._params, rows.size, roll_pitch, quat)

    def update(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take one sample (n, 3) [rad/s], (n, 3) [m/s²]; roll and pitch (n, 2) [rad]."""
        gyro = np.ascontiguousarray(gyro, dtype=np.float64)
        accel = np.ascontiguousarray(accel, dtype=np.float64)
        if gyro.shape != self._shape or accel.shape != self._shape:
            raise ValueError(
                f"gyro {gyro.shape} and accel {accel.shape} must both be {self._shape}, as in reset"
            )
        out = np.empty((self._shape[0], 1, 2))
        gyro, accel, rotors = gyro.reshape(self._sample), accel.reshape(self._sample), self._no_rotors
        if sensors:
            rotors = rotor_speeds(self._shape[:1], sensors)[:, None]
        self._run(self._states, self._params, self._dt, gyro, accel, rotors, out)
        return out[:, 0]

    def sequence(self, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]) -> Array:
        """Take (n, T, 3) samples, carrying on from the last; roll and pitch (n, T, 2) [rad]."""
        gyro, accel = paired(gyro, accel)
        if len(gyro) != self._shape[0]:
            raise ValueError(f"gyro holds {len(gyro)} vehicles; reset was for {self._shape[0]}")
        rotors, out = rotor_speeds(gyro.shape[:2], sensors), np.empty((*gyro.shape[:2], 2))
        self._run(self._states, self._params, self._dt, gyro, accel, rotors, out)
        return out

    @property
    def skipped(self) -> NDArray[np.int64]:
        """Samples since reset that were missing in part or whole, (n,)."""
        return self._states["skipped"].astype(np.int64)

    @property
    def quat(self) -> Array:
        """Estimated quat_WB (n, 4)."""
        return self._field("quat", "a quaternion")

    @property
    def gyro_bias(self) -> Array:
        """Estimated gyroscope bias (n, 3) [rad/s]."""
        return self._field("gyro_bias", "a gyroscope bias")

    @property
    def velocity(self) -> Array:
        """Estimated velocity in the world axes of `quat`, (n, 3) [m/s]."""
        return self._field("velocity", "a velocity")

    @property
    def roll_pitch_sigma(self) -> Array:
        """Standard deviation of roll and pitch, by the filter's own covariance (n, 2) [rad]."""
        if self.algorithm.tilt_covariance is None:
            raise AttributeError(f"{self.algorithm.name} has no covariance")
        tilt = self.algorithm.tilt_covariance(self._states)
        _, pitch, yaw = np.moveaxis(euler_from_quat(self.quat), -1, 0)
        turn = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], axis=-1).reshape(-1, 2, 2)
        variance = np.diagonal(turn @ tilt @ np.swapaxes(turn, 1, 2), axis1=1, axis2=2)
        sigma = np.sqrt(np.maximum(variance, 0.0))
        sigma[:, 0] /= np.maximum(np.cos(pitch), 1e-3)
        return np.minimum(sigma, math.pi)

    def _field(self, name: str, what: str) -> Array:
        if name not in (self.algorithm.state.names or ()):
            raise AttributeError(f"{self.algorithm.name} does not estimate {what}")
        return self._states[name].reshape(self._shape[0], -1).copy()


def tilt_block(states: Records) -> Array:
    """Covariance (n, 2, 2) of an error state that begins with the tilt about world x and y."""
    return states["covariance"][:, :2, :2]


def start(
    algorithm: Algorithm,
    params: Records,
    n: int,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
) -> Records:
    """States of parameter sets (p,) on n flights, (p·n,), from one attitude a flight."""
    attitude, known = initial_quat(n, roll_pitch, quat)
    states = initial_states(len(params) * n, algorithm.record)
    algorithm.start(states, np.tile(attitude, (len(params), 1)), known, np.repeat(params, n))
    return states


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


def broadcast(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Finite float64 array of a shape, or ValueError."""
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


def paired(gyro: ArrayLike, accel: ArrayLike) -> tuple[Array, Array]:
    """Two contiguous float64 sequences of the same shape (n, T, 3), or ValueError."""
    gyro = np.ascontiguousarray(gyro, dtype=np.float64)
    accel = np.ascontiguousarray(accel, dtype=np.float64)
    if gyro.ndim != 3 or gyro.shape[-1] != 3 or gyro.shape != accel.shape:
        raise ValueError(f"gyro {gyro.shape} and accel {accel.shape} must both have one shape (n, T, 3)")
    return gyro, accel


def rotor_speeds(shape: tuple[int, ...], given: OtherSensors) -> Array:
    """Rotor speeds (*shape, rotors) among the given readings, without columns where there are none.

    Args:
        shape: Of the other readings without their last axis: (n,) or (n, T).
        given: Readings (*shape, ·).

    Raises:
        ValueError: For speeds of another shape.
    """
    values = given.get("rotor_vel")
    speeds = np.empty((*shape, 0)) if values is None else np.ascontiguousarray(values, np.float64)
    if speeds.shape[:-1] != shape:
        expected = ", ".join(map(str, shape))
        raise ValueError(f"rotor_vel has shape {speeds.shape}; it must be ({expected}, ·), as gyro")
    return speeds


def checked(owner: str, parameters: Mapping[str, Parameter], given: Mapping[str, object]) -> dict[str, float]:
    """The given parameters as floats; ValueError for an unknown name or a value out of range."""
    values = {}
    for name, value in given.items():
        if name not in parameters:
            raise ValueError(f'{owner} has no parameter "{name}"; {nearest(name, parameters)}')
        parameter = parameters[name]
        if not (isinstance(value, int | float | np.number) and math.isfinite(value)):
            raise ValueError(f"{owner}: {name} = {value!r} is not a finite number")
        if not parameter.minimum <= value <= parameter.maximum:
            allowed = f"{parameter.minimum:g} to {parameter.maximum:g}"
            raise ValueError(f"{owner}: {name} = {value:g} is outside {allowed}")
        values[name] = float(value)
    return values
