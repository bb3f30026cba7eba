"""Running of estimators on sequences, also with many parameter sets at once."""

import logging
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import (
    AttitudeEstimator,
    OtherSensors,
    Readings,
    accepted_sensors,
    receives_truth,
    roll_pitch_of,
)
from quadsim.own import named_errors

from .filters.driver import paired
from .registry import VehicleLike, create, parameter_sets

Array = NDArray[np.float64]
SAME = 1e-4
"""Largest allowed difference between `update` and `sequence` [rad]: less than 0.01°, and more than rounding
errors in single precision."""

logger = logging.getLogger(__name__)


def run(
    est: AttitudeEstimator,
    gyro: ArrayLike,
    accel: ArrayLike,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
    **sensors: Unpack[OtherSensors],
) -> Array:
    """Reset an estimator and run it on n sequences. The results equal those of `update` in a loop.

    The estimator receives copies of the arguments.

    Args:
        est: The estimator.
        gyro: Body rate (n, T, 3) [rad/s]; NaN for missing samples.
        accel: Specific force in body axes (n, T, 3) [m/s²]; NaN for missing samples.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None if it is not known.
        quat: True quat_WB (n, T, 4), for an estimator that is given the true attitude.
        sensors: Further readings: rotor_vel (n, T, rotors) [rad/s] and mag (n, T, 3) [T].

    Returns:
        Roll and pitch (n, T, 2) [rad].

    Raises:
        ValueError: A shape does not fit, or the estimator needs `quat`, or a user's estimator fails, returns
            something other than real numbers (n, 2), or has a `sequence` whose results differ from `update`.
    """
    out, _ = run_checked(est, _sequences(gyro, accel, **sensors), roll_pitch, quat)
    skipped = missing_samples(est)
    if skipped > 0:
        logger.warning(
            "%d of %d samples were missing or beyond any sensor's range; the estimator went on from its "
            "prediction",
            skipped,
            out[..., 0].size,
        )
    return out


def run_checked(
    est: AttitudeEstimator,
    readings: Readings,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
) -> tuple[Array, float]:
    """Run an estimator as `run` does; return roll and pitch (n, T, 2) [rad] and the elapsed time [s].

    If a user's estimator has a `sequence`, its `update` is also run on the first sequence, and the results
    must agree.

    Raises:
        ValueError: As in `run`, which has the same arguments.
    """
    streamed = None
    if not (_ships(est) or receives_truth(est)) and getattr(est, "sequence", None) is not None:
        start = None if roll_pitch is None else np.asarray(roll_pitch)[:1]
        with _named(est):
            streamed = stream(est, readings.map(lambda each: each[:1]), start)
    begin = time.perf_counter()
    out = run_quietly(est, readings, roll_pitch, quat)
    taken = time.perf_counter() - begin
    if streamed is not None and (difference := differ(out[:1], streamed, SAME)):
        raise ValueError(
            f"{type(est).__name__}: sequence does not give the estimates of update, which flies: {difference}"
        )
    return out, taken


def run_quietly(
    est: AttitudeEstimator,
    readings: Readings,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
) -> Array:
    """Run an estimator as `run` does, without warnings or the check of a user's `sequence`."""
    sequence = None if receives_truth(est) else getattr(est, "sequence", None)
    with _named(est):
        if sequence is None:
            return stream(est, readings, roll_pitch, quat)
        _reset(est, len(readings.gyro), roll_pitch)
        given = readings if _ships(est) else readings.map(np.copy)
        returned = given.give(sequence, accepted_sensors(sequence))
        return roll_pitch_of(returned, (*readings.gyro.shape[:2], 2), type(est).__name__, "sequence")


def differ(a: Array, b: Array, most: float) -> str:
    """Describe the difference between two estimates [rad]; empty if it is nowhere larger than `most`."""
    difference = np.abs(a - b)
    largest = np.degrees(np.max(difference, initial=0.0, where=np.isfinite(difference)))
    alike = np.array_equal(np.isfinite(a), np.isfinite(b))
    return "" if largest <= np.degrees(most) and alike else f"they differ by up to {largest:.3g}°"


def stream(
    est: AttitudeEstimator, readings: Readings, roll_pitch: ArrayLike | None, quat: ArrayLike | None = None
) -> Array:
    """Run an estimator as `run` does, but only with `update`."""
    n, steps = readings.gyro.shape[:2]
    truth = _truth(quat, (n, steps, 4)) if receives_truth(est) else None
    _reset(est, n, roll_pitch)
    out, accepted, name = np.empty((n, steps, 2)), accepted_sensors(est.update), type(est).__name__
    for t in range(steps):
        if truth is not None:
            est.observe(truth[:, t].copy())  # pyright: ignore[reportAttributeAccessIssue]
        returned = readings.map(lambda each, t=t: each[:, t].copy()).give(est.update, accepted)
        out[:, t] = roll_pitch_of(returned, (n, 2), name)
    return out


def _reset(est: AttitudeEstimator, n: int, roll_pitch: ArrayLike | None) -> None:
    est.reset(n, roll_pitch=None if roll_pitch is None else np.array(roll_pitch, np.float64))


def _ships(est: AttitudeEstimator) -> bool:
    """Return whether an estimator belongs to this package."""
    return type(est).__module__.startswith("estimators.")


def _named(est: AttitudeEstimator) -> AbstractContextManager[None]:
    """Add the name of a user's estimator to the errors that it raises."""
    return nullcontext() if _ships(est) else named_errors(type(est).__name__)


def missing_samples(est: AttitudeEstimator) -> int:
    """Return the number of incomplete samples of all vehicles since `reset`."""
    return int(np.sum(getattr(est, "skipped", 0)))


def run_batch(
    name: str,
    params: Mapping[str, ArrayLike],
    gyro: ArrayLike,
    accel: ArrayLike,
    rate_hz: float = 200.0,
    roll_pitch: ArrayLike | None = None,
    vehicle: VehicleLike = None,
    **sensors: Unpack[OtherSensors],
) -> Array:
    """Run one estimator with p parameter sets on n sequences.

    Args:
        name: One of `names()`.
        params: Values (p,) by parameter name; other parameters have their defaults.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force in body axes (n, T, 3) [m/s²].
        rate_hz: Samples per second.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None if it is not known.
        vehicle: The airframe, as in `create`.
        sensors: Further readings, as in `run`.

    Returns:
        Roll and pitch (p, n, T, 2) [rad].
    """
    sets = parameter_sets(params)
    made = [create(name, rate_hz, tuning=None, vehicle=vehicle, imu=None, **each) for each in sets]
    return np.stack([run(est, gyro, accel, roll_pitch, **sensors) for est in made])


def _sequences(gyro: ArrayLike, accel: ArrayLike, **sensors: Unpack[OtherSensors]) -> Readings:
    readings = Readings(*paired(gyro, accel), **sensors)
    for name, values in readings.others.items():
        if np.ndim(values) != 3 or np.shape(values)[:2] != readings.gyro.shape[:2]:
            raise ValueError(f"{name} has shape {np.shape(values)}; gyro has {readings.gyro.shape}")
    return readings.map(lambda each: np.ascontiguousarray(each, np.float64))


def _truth(quat: ArrayLike | None, shape: tuple[int, ...]) -> Array:
    if quat is None:
        raise ValueError("this estimator observes the truth: give run(..., quat=) of shape (n, T, 4)")
    truth = np.asarray(quat, dtype=np.float64)
    if truth.shape != shape:
        raise ValueError(f"quat has shape {truth.shape}; it must be {shape}")
    return truth
