"""Model probabilities of `imm` along a recording, and the coverage of its confidence interval."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from quadsim.estimator import AttitudeEstimator, OtherSensors, Readings, accepted_sensors

from ..filters.drag.imm import InteractingModels
from ..metrics import absolute_error

Array = NDArray[np.float64]

EVERY_S = 0.1
"""Time between the samples at which probabilities and standard deviations are read [s]."""
NORMAL_95 = 1.96
"""Half the width of the 95 % interval of a normal distribution, in standard deviations."""
WIDE = 2.0
"""An interval is called too wide if its standard deviation is more than this many times the error."""


@dataclass(frozen=True)
class Beliefs:
    """Estimates of n recordings at k samples."""

    models: tuple[str, ...]
    """Names of the m models."""
    samples: NDArray[np.int64]
    """Indices of the samples, (k,)."""
    roll_pitch: Array
    """Roll and pitch (n, k, 2) [rad]."""
    sigma: Array
    """Standard deviation of roll and pitch (n, k, 2) [rad]."""
    probability: Array
    """Probability of each model, (n, k, m)."""

    def share(self) -> dict[str, float]:
        """Mean probability of each model over all samples of all recordings."""
        return dict(zip(self.models, self.probability.mean(axis=(0, 1)).tolist(), strict=True))

    @property
    def sigma_deg(self) -> float:
        """Median of the standard deviation of roll and pitch [deg]."""
        return float(np.degrees(np.median(self.sigma)))

    def interval(self, truth: Array, counted: NDArray[np.bool_] | None = None) -> "Coverage":
        """Return the coverage of the 95 % interval over known angles; NaN if no angle is known.

        Args:
            truth: Roll and pitch of all samples (n, T, 2) [rad]; NaN where they are not known.
            counted: Samples to use (n, T); None for all.
        """
        error = np.radians(absolute_error(self.roll_pitch, truth[:, self.samples]))
        known = np.isfinite(error)
        if counted is not None:
            known &= counted[:, self.samples, None]
        if not known.any():
            return Coverage(float("nan"), float("nan"), float("nan"))
        inside = (error <= NORMAL_95 * self.sigma)[known].mean()
        rmse, sigma = np.degrees([np.sqrt(np.mean(error[known] ** 2)), np.median(self.sigma[known])])
        return Coverage(float(inside), float(sigma), float(rmse))


class Coverage(NamedTuple):
    """Coverage of a 95 % interval."""

    inside: float
    """Share of true rolls and pitches inside the interval."""
    sigma_deg: float
    """Median of the standard deviation [deg]."""
    rmse_deg: float
    """Root mean square error of roll and pitch [deg]."""

    @property
    def text(self) -> str:
        """Describe the coverage, the median standard deviation and the error."""
        wide = ", so the interval is too wide" if self.sigma_deg > WIDE * self.rmse_deg else ""
        return (
            f"{100 * self.inside:.0f} % of the true angles are inside its 95 % interval; its median σ is "
            f"{self.sigma_deg:.1f}° at an error of {self.rmse_deg:.1f}° RMS{wide}"
        )


def run_in_steps(est: AttitudeEstimator, readings: Readings) -> Iterator[tuple[int, Array]]:
    """Run an estimator with a `sequence` from an unknown start, and yield every tenth of a second.

    Args:
        est: The estimator, whose state can be read at each yield.
        readings: Readings of n recordings (n, T, ·).

    Yields:
        Index of the last processed sample, and roll and pitch (n, 2) [rad].
    """
    est.reset(len(readings.gyro))
    sequence = est.sequence  # pyright: ignore[reportAttributeAccessIssue]
    every = max(round(EVERY_S * est.rate_hz), 1)
    for end in range(every, readings.gyro.shape[1] + 1, every):
        part = readings.map(lambda each, end=end: each[:, end - every : end])
        yield end - 1, part.give(sequence, accepted_sensors(sequence))[:, -1]


def beliefs(
    est: AttitudeEstimator, gyro: Array, accel: Array, **sensors: Unpack[OtherSensors]
) -> Beliefs | None:
    """Run an estimator and record model probabilities at regular times; None if it has no models.

    Args:
        est: The estimator.
        gyro: Body rate (n, T, 3) [rad/s].
        accel: Specific force in body axes (n, T, 3) [m/s²].
        sensors: Further readings (n, T, ·), as in `estimators.run`.
    """
    if not isinstance(est, InteractingModels):
        return None
    stops = run_in_steps(est, Readings(gyro, accel, **sensors))
    parts = [(last, estimate, est.roll_pitch_sigma, est.model_probability) for last, estimate in stops]
    samples, *states = zip(*parts, strict=True)
    return Beliefs(est.models, np.array(samples), *(np.stack(each, axis=1) for each in states))
