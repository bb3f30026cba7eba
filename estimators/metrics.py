"""Errors of attitude estimates, used for every table and figure.

An estimate that is not finite or beyond ±`RANGE` counts as an error of 180°. Samples with unknown truth (NaN)
are not counted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

RANGE = 100.0
"""Largest roll or pitch that counts as an angle [rad]. Filters that do not wrap may exceed ±π, but for much
larger numbers, differences modulo 2π are dominated by rounding."""
LEVEL, RESAMPLES = 0.95, 10_000
"""Resamples and confidence level of the bootstrap."""
MOTION = 1e-6
"""Change of the truth up to which a flight counts as motionless [rad]."""
CONSTANT = 0.01
"""Share of the change of the truth up to which an estimate counts as constant."""


@dataclass(frozen=True)
class Summary:
    """Statistics over sequences of one number per sequence."""

    sequences: Array
    """Number of each sequence, (n,)."""

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
        """Sample standard deviation over sequences (n − 1); 0 for a single one."""
        return float(np.std(self.sequences, ddof=1)) if self.sequences.size > 1 else 0.0

    def mean_interval(self, seed: int = 0) -> tuple[float, float]:
        """Return the bootstrap confidence interval of the mean over sequences (percentile method)."""
        n = self.sequences.size
        draws = np.random.default_rng(seed).integers(0, n, (RESAMPLES, n))
        low, high = np.quantile(self.sequences[draws].mean(axis=1), [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
        return float(low), float(high)


def absolute_error(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Return the absolute error of roll and of pitch [deg], shape (..., 2), from angles [rad].

    At most 180°.
    """
    estimate, truth = _pair(estimate, truth)
    difference = np.where(_angles(estimate)[..., None], estimate, truth + np.pi) - truth
    return np.degrees(np.abs(difference - 2.0 * np.pi * np.round(difference / (2.0 * np.pi))))


def attitude_error(estimate: ArrayLike, truth: ArrayLike) -> Summary:
    """Return the mean absolute error of each sequence, with roll and pitch pooled [deg].

    Args:
        estimate: Roll and pitch (n, T, 2) [rad].
        truth: True roll and pitch, same shape. Samples with NaN are not counted.
    """
    return Summary(np.nanmean(absolute_error(estimate, truth), axis=(-2, -1)).reshape(-1))


def inclination_error(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Return the angle between estimated and true direction of gravity in body axes [deg], shape (...).

    This is the inclination error of the BROAD benchmark (Laidig et al. 2021), 2 arccos √(w² + z²) of the
    error quaternion in world axes, which does not depend on yaw.

    Args:
        estimate: Roll and pitch (..., 2) [rad].
        truth: True roll and pitch, same shape; NaN gives NaN.
    """
    estimate, truth = _pair(estimate, truth)
    sound = _angles(estimate)[..., None]
    b = up_in_body(truth)
    a = np.where(sound, up_in_body(np.where(sound, estimate, 0.0)), -b)
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def inclination_rmse(estimate: ArrayLike, truth: ArrayLike) -> Summary:
    """Return the RMS inclination error of each sequence [deg], from roll and pitch (n, T, 2) [rad]."""
    return Summary(np.sqrt(np.nanmean(inclination_error(estimate, truth) ** 2, axis=-1)).reshape(-1))


def share_without_number(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Return the share of samples with known truth that count as an error of 180°, 0…1.

    Args:
        estimate: Roll and pitch (..., 2) [rad].
        truth: True roll and pitch, same shape; NaN if unknown.
    """
    estimate, truth = _pair(estimate, truth)
    known = _angles(truth)
    return float(np.mean(~_angles(estimate)[known])) if known.any() else 0.0


def flaw_of(estimate: ArrayLike, truth: ArrayLike) -> str:
    """Return why an estimator must not be ranked, as the end of a sentence after its name; "" if it may be.

    An estimator must not be ranked if a roll or pitch is not finite or is beyond ±`RANGE`, or if its
    estimates are constant (up to `CONSTANT`) in every flight with motion.

    Args:
        estimate: Roll and pitch (n, T, 2) or (T, 2) [rad].
        truth: True roll and pitch, same shape; samples with NaN are not counted.
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
    """Return the world's z axis in body axes, (..., 3), from roll and pitch (..., 2) [rad]."""
    angles = np.asarray(roll_pitch, dtype=np.float64)
    roll, pitch = angles[..., 0], angles[..., 1]
    return np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=-1)


def _angles(values: Array) -> NDArray[np.bool_]:
    """Return which samples have finite roll and pitch within ±`RANGE`, (...)."""
    return np.asarray((np.abs(values) <= RANGE).all(axis=-1))


def _percent(which: NDArray[np.bool_]) -> str:
    share = 100.0 * float(np.mean(which))
    return "less than 0.1 %" if share < 0.1 else f"{share:.1f} %"


def _span(angles: Array) -> float:
    """Return the largest change of roll or pitch over samples (k, 2) [rad]; 0 without samples."""
    return float(np.ptp(angles, axis=0).max()) if len(angles) else 0.0


def _pair(estimate: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    estimate, truth = np.asarray(estimate, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if estimate.shape != truth.shape or estimate.shape[-1:] != (2,):
        raise ValueError(
            f"estimate {estimate.shape} and truth {truth.shape} must both have one shape (n, T, 2)"
        )
    return estimate, truth
