"""Run an estimator over sequences, or many parameter sets of it at once."""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadsim.estimator import AttitudeEstimator
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
) -> Array:
    """Reset an estimator and run it over n sequences; the same numbers as `update` in a loop.

    Args:
        est: The estimator.
        gyro: Body rate (n, T, 3) [rad/s]; NaN where a sample is missing.
        accel: Specific force in body axes (n, T, 3) [m/s²]; NaN where a sample is missing.
        roll_pitch: Attitude one sample before the first, (n, 2) [rad]; None where it is not known.
        quat: True quat_WB (n, T, 4), for an estimator that observes the truth.

    Returns:
        Roll and pitch (n, T, 2) [rad].

    Raises:
        ValueError: For shapes that do not fit, or an estimator that observes the truth and is given none.
    """
    out = run_quietly(est, gyro, accel, roll_pitch, quat)
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
) -> Array:
    """`run`, for a caller that reports `missing_samples` itself."""
    gyro, accel = paired(gyro, accel)
    est.reset(len(gyro), roll_pitch=roll_pitch)
    observe = getattr(est, "observe", None)
    sequence = getattr(est, "sequence", None)
    if observe is not None:
        return _run_observing(est, observe, gyro, accel, quat)
    if sequence is not None:
        return sequence(gyro, accel)
    steps = zip(np.moveaxis(gyro, 1, 0), np.moveaxis(accel, 1, 0), strict=True)
    return np.stack(
        [est.update(rate.copy(), force.copy()) for rate, force in steps], axis=1
    )  # its own to change


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

    Returns:
        Roll and pitch (p, n, T, 2) [rad].
    """
    gyro, accel = paired(gyro, accel)
    if name not in COMPILED:
        estimators = [
            create(name, rate_hz, tuning=None, vehicle=None, imu=None, **each)
            for each in parameter_sets(params)
        ]
        return np.stack([run(est, gyro, accel, roll_pitch) for est in estimators])
    algorithm = COMPILED[name]
    sets = algorithm.records(parameter_matrix(name, params, rate_hz, airframe_constants(name, vehicle)))
    states = start(algorithm, sets, len(gyro), roll_pitch)
    out = np.empty((len(states), gyro.shape[1], 2))
    algorithm.sequence(states, sets, 1.0 / rate_hz, gyro, accel, out)
    return out.reshape(len(sets), *gyro.shape[:2], 2)


def _run_observing(
    est: AttitudeEstimator, observe, gyro: Array, accel: Array, quat: ArrayLike | None
) -> Array:
    if quat is None:
        raise ValueError("this estimator observes the truth: give run(..., quat=) of shape (n, T, 4)")
    truth = np.asarray(quat, dtype=np.float64)
    if truth.shape != (*gyro.shape[:2], 4):
        raise ValueError(f"quat has shape {truth.shape}; it must be {(*gyro.shape[:2], 4)}")
    out = np.empty((*gyro.shape[:2], 2))
    for t in range(gyro.shape[1]):
        observe(truth[:, t])
        out[:, t] = est.update(gyro[:, t], accel[:, t])
    return out
