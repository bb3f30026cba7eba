"""Run an estimator over sequences, or many parameter sets of it at once."""

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import AttitudeEstimator, OtherSensors, Readings, accepted_sensors
from quadsim.vehicle import Vehicle

from .filters.algorithm import paired, start
from .registry import COMPILED, airframe_constants, create, parameter_matrix, parameter_sets

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)


def run(
    est: AttitudeEstimator,
    gyro: ArrayLike,
    accel: ArrayLike,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
    **sensors: Unpack[OtherSensors],
) -> Array:
    """Reset an estimator and run it over n sequences; the same numbers as `update` in a loop.

    Args:
        est: The estimator.
        gyro: Body rate (n, T, 3) [rad/s]; NaN where a sample is missing.
        accel: Specific force in body axes (n, T, 3) [m/s²]; NaN where a sample is missing.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None where it is not known.
        quat: True quat_WB (n, T, 4), for an estimator that observes the truth.
        sensors: Further readings, rotor_vel (n, T, rotors) [rad/s] and mag (n, T, 3) [T].

    Returns:
        Roll and pitch (n, T, 2) [rad].

    Raises:
        ValueError: For shapes that do not fit, or an estimator that observes the truth and is given none.
    """
    out = run_quietly(est, gyro, accel, roll_pitch, quat, **sensors)
    skipped = missing_samples(est)
    if skipped > 0:
        logger.warning(
            "%d of %d samples were missing or beyond any sensor's range; the estimator went on from its "
            "prediction",
            skipped,
            out[..., 0].size,
        )
    return out


def run_quietly(
    est: AttitudeEstimator,
    gyro: ArrayLike,
    accel: ArrayLike,
    roll_pitch: ArrayLike | None = None,
    quat: ArrayLike | None = None,
    **sensors: Unpack[OtherSensors],
) -> Array:
    """`run`, for a caller that reports `missing_samples` itself."""
    readings = _sequences(gyro, accel, **sensors)
    try:
        return _run(est, readings, roll_pitch, quat)
    except Exception as error:  # whatever a user's class does
        if isinstance(error, ValueError) or type(est).__module__.startswith("estimators."):
            raise
        raise ValueError(f"{type(est).__name__} ends with {type(error).__name__}: {error}") from error


def _run(
    est: AttitudeEstimator, readings: Readings, roll_pitch: ArrayLike | None, quat: ArrayLike | None
) -> Array:
    n, steps = readings.gyro.shape[:2]
    est.reset(n, roll_pitch=roll_pitch)
    observe, sequence = getattr(est, "observe", None), getattr(est, "sequence", None)
    truth = None if observe is None else _truth(quat, (n, steps, 4))
    if sequence is not None and truth is None:
        return readings.give(sequence, accepted_sensors(sequence))
    out, accepted = np.empty((n, steps, 2)), accepted_sensors(est.update)
    for t in range(steps):
        if observe is not None and truth is not None:
            observe(truth[:, t])
        out[:, t] = readings.map(lambda each, t=t: each[:, t].copy()).give(est.update, accepted)
    return out


def missing_samples(est: AttitudeEstimator) -> int:
    """Samples of all vehicles since `reset` that were missing in part or whole."""
    return int(np.sum(getattr(est, "skipped", 0)))


def run_batch(
    name: str,
    params: Mapping[str, ArrayLike],
    gyro: ArrayLike,
    accel: ArrayLike,
    rate_hz: float = 200.0,
    roll_pitch: ArrayLike | None = None,
    vehicle: str | Path | Vehicle | None = None,
    **sensors: Unpack[OtherSensors],
) -> Array:
    """Run p parameter sets of one estimator over n sequences.

    Args:
        name: One of `names()`.
        params: Parameter name to values (p,); the others keep their default.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force in body axes (n, T, 3) [m/s²].
        rate_hz: Samples per second.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None where it is not known.
        vehicle: As in `create`.
        sensors: As in `run`.

    Returns:
        Roll and pitch (p, n, T, 2) [rad].
    """
    gyro, accel = paired(gyro, accel)
    if name not in COMPILED:
        estimators = [
            create(name, rate_hz, tuning=None, vehicle=None, imu=None, **each)
            for each in parameter_sets(params)
        ]
        return np.stack([run(est, gyro, accel, roll_pitch, **sensors) for est in estimators])
    algorithm = COMPILED[name]
    sets = algorithm.records(parameter_matrix(name, params, rate_hz, airframe_constants(name, vehicle)))
    states = start(algorithm, sets, len(gyro), roll_pitch)
    out = np.empty((len(states), gyro.shape[1], 2))
    others = algorithm.others(gyro.shape[:2], sensors)
    algorithm.sequence(states, sets, 1.0 / rate_hz, gyro, accel, *others, out)
    return out.reshape(len(sets), *gyro.shape[:2], 2)


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
