"""How wrong an attitude estimate is. One set of functions for every table and figure.

An estimate that is not a finite number, or beyond ±`RANGE`, where the truth is known is 180° wrong. Where the
truth is not known, NaN, there is no error, and nothing is counted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

RANGE = 100.0
"""Largest roll or pitch that counts as an angle [rad]: filters that do not wrap may count several turns, but
differences of much larger numbers modulo 2π are rounding errors."""
LEVEL, RESAMPLES = 0.95, 10_000
"""Of the bootstrapped intervals."""
MOTION = 1e-6
"""Largest change of the truth at which a flight counts as motionless [rad]."""
CONSTANT = 0.01
"""Share of the truth's change up to which a change of the estimate counts as none."""


@dataclass(frozen=True)
class Summary:
    """One number per sequence, and how it spreads over the sequences."""

    sequences: Array
    """(n,), the number of each sequence."""

    @property
    def median(self) -> float:
        """Median over sequences."""
        return float(np.median(self.sequences))

    @property
    def mean(self) -> float:
        """Mean over sequences."""
        return float(np.mean(self.sequences))

    @property
    def sd(self) -> float:
        """Standard deviation over sequences (of the sample, n − 1); 0 for a single one."""
        return float(np.std(self.sequences, ddof=1)) if self.sequences.size > 1 else 0.0

    def mean_interval(self, seed: int = 0) -> tuple[float, float]:
        """Bootstrap confidence interval of the mean over sequences (percentile method)."""
        n = self.sequences.size
        draws = np.random.default_rng(seed).integers(0, n, (RESAMPLES, n))
        low, high = np.quantile(self.sequences[draws].mean(axis=1), [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
        return float(low), float(high)


def absolute_error(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Absolute error of roll and of pitch [deg], shape (..., 2), from angles in radians; at most 180."""
    estimate, truth = _pair(estimate, truth)
    difference = np.where(_angles(estimate)[..., None], estimate, truth + np.pi) - truth
    return np.degrees(np.abs(difference - 2.0 * np.pi * np.round(difference / (2.0 * np.pi))))


def attitude_error(estimate: ArrayLike, truth: ArrayLike) -> Summary:
    """Mean absolute error of roll and pitch, pooled, of each sequence [deg].

    Args:
        estimate: Roll and pitch (n, T, 2) [rad].
        truth: The same, true; NaN where it is not known, and such samples are not counted.
    """
    return Summary(np.nanmean(absolute_error(estimate, truth), axis=(-2, -1)).reshape(-1))


def inclination_error(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Angle between the estimated and the true direction of gravity in body axes [deg], shape (...).

    The inclination part of the BROAD benchmark's error (Laidig et al. 2021), 2 arccos √(w² + z²) of the error
    quaternion in world axes, which no yaw changes.

    Args:
        estimate: Roll and pitch (..., 2) [rad].
        truth: The same, true; NaN gives NaN.
    """
    estimate, truth = _pair(estimate, truth)
    sound = _angles(estimate)[..., None]
    b = up_in_body(truth)
    a = np.where(sound, up_in_body(np.where(sound, estimate, 0.0)), -b)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def inclination_rmse(estimate: ArrayLike, truth: ArrayLike) -> Summary:
    """RMS over time of the inclination error of each sequence [deg], from roll and pitch (n, T, 2) [rad]."""
    return Summary(np.sqrt(np.nanmean(inclination_error(estimate, truth) ** 2, axis=-1)).reshape(-1))


def share_without_number(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Share of the samples with a known truth that count as 180° wrong, 0…1; 0 without any.

    Args:
        estimate: Roll and pitch (..., 2) [rad].
        truth: The same, true; NaN where it is not known.
    """
    estimate, truth = _pair(estimate, truth)
    known = _angles(truth)
    return float(np.mean(~_angles(estimate)[known])) if known.any() else 0.0


def flaw_of(estimate: ArrayLike, truth: ArrayLike) -> str:
    """Why an estimator must not be ranked by its estimates, to follow its name in a sentence; "" if it may.

    It may not if a roll or pitch is not a finite number or is beyond ±`RANGE`, or if the estimates are
    constant (up to `CONSTANT`) in every flight in which the truth moves.

    Args:
        estimate: Roll and pitch (n, T, 2) or (T, 2) [rad].
        truth: The same, true; samples of NaN are not counted.
    """
    estimate, truth = (each.reshape(-1, *each.shape[-2:]) for each in _pair(estimate, truth))
    known = _angles(truth)
    counted = estimate[known]
    finite, within = np.asarray(np.isfinite(counted).all(axis=-1)), _angles(counted)
    if not finite.all():
        return f"returned roll or pitch that is not a finite number in {_percent(~finite)} of the samples"
    if not within.all():
        return f"returned angles beyond ±{RANGE:g} rad in {_percent(~within)} of the samples"
    spans = [(_span(estimate[k, there]), _span(truth[k, there])) for k, there in enumerate(known)]
    moving = [(own, true) for own, true in spans if true > MOTION]
    if moving and all(own <= CONSTANT * true for own, true in moving):
        return "returned the same roll and pitch at every sample"
    return ""


def up_in_body(roll_pitch: ArrayLike) -> Array:
    """Direction of the world's z axis in body axes, (..., 3), of roll and pitch (..., 2) [rad]."""
    angles = np.asarray(roll_pitch, dtype=np.float64)
    roll, pitch = angles[..., 0], angles[..., 1]
    return np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=-1)


def _angles(values: Array) -> NDArray[np.bool_]:
    """Samples whose roll and pitch are both finite and within ±`RANGE`, (...)."""
    return np.asarray((np.abs(values) <= RANGE).all(axis=-1))


def _percent(which: NDArray[np.bool_]) -> str:
    share = 100.0 * float(np.mean(which))
    return "less than 0.1 %" if share < 0.1 else f"{share:.1f} %"


def _span(angles: Array) -> float:
    """Largest change of roll or pitch over samples (k, 2) [rad]; 0 without any."""
    return float(np.ptp(angles, axis=0).max()) if len(angles) else 0.0


def _pair(estimate: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    estimate, truth = np.asarray(estimate, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if estimate.shape != truth.shape or estimate.shape[-1:] != (2,):
        raise ValueError(
            f"estimate {estimate.shape} and truth {truth.shape} must both have one shape (n, T, 2)"
        )
    return estimate, truth
