"""Comparison of estimators on a log without a true attitude, with each other and the specific force."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.stats import t as student

from quadsim.rotation import (
    quat_conjugate,
    quat_from_roll_pitch,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
)

from ..metrics import inclination_error

Array = NDArray[np.float64]

LOW_PASS_S = 10.0
"""Averaging time of the horizontal force [s]. A change of speed by 2 m/s within this time gives 0.2 m/s², the
same as an attitude error of 1.2°."""
LEVEL = "level"
"""Name of the level guess, which shows how far the log is from level."""
FEWEST = 4
"""Smallest number of non-overlapping means for which an estimator can be favoured."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of estimators on one log without a true attitude."""

    apart: Mapping[tuple[str, str], tuple[float, float]]
    """Median and 95th percentile of the inclination difference of two estimators, by their names [deg]."""
    force: Mapping[str, float]
    """RMS of the low-passed horizontal specific force in world axes, by estimator [m/s²]; near zero for a
    correct attitude."""
    level_force: float
    """The RMS horizontal force of a level guess [m/s²]."""
    favoured: tuple[str, ...]
    """Estimators whose force is not significantly larger than the smallest; empty if the log does not
    decide."""
    undecided: str
    """Why no estimator is favoured; empty if one is."""
    flaws: Mapping[str, str]
    """Estimators that are left out, with the reason."""


def compare(
    estimates: Mapping[str, Array], gyro: Array, accel: Array, rate_hz: float, flaws: Mapping[str, str]
) -> Comparison:
    """Compare estimates of a log with each other and with the specific force.

    Args:
        estimates: Finite roll and pitch (T, 2) [rad] by estimator.
        gyro: Body rate (T, 3) [rad/s]; NaN where missing.
        accel: Specific force (T, 3) [m/s²]; NaN where missing.
        rate_hz: Samples per second.
        flaws: Estimators without valid estimates, with the reason.
    """
    apart = {}
    for first, second in combinations(estimates, 2):
        median, most = np.quantile(inclination_error(estimates[first], estimates[second]), (0.5, 0.95))
        apart[first, second] = (float(median), float(most))
    span = round(LOW_PASS_S * rate_hz)
    edge = span // 2 if len(accel) > span else 0  # where the mean would be of less than that time
    squares = {}
    for name, estimate in {**estimates, LEVEL: np.zeros((len(accel), 2))}.items():
        horizontal = horizontal_force(estimate, gyro, accel, rate_hz)
        mean = uniform_filter1d(horizontal, min(span, len(accel)), axis=0)
        squares[name] = (mean[edge : len(mean) - edge] ** 2).sum(axis=1)
    force = {name: float(np.sqrt(square.mean())) for name, square in squares.items()}
    favoured, undecided = _favoured({name: square[::span] for name, square in squares.items()}, force)
    level_force = force.pop(LEVEL)
    return Comparison(apart, force, level_force, favoured, undecided, flaws)


def gyro_angle(gyro: Array, rate_hz: float) -> Array:
    """Integrate the gyroscope about its x and y axes, without its mean rate, (T, 2) [rad]."""
    rate = np.nan_to_num(gyro[:, :2])
    return np.cumsum(rate - rate.mean(axis=0), axis=0) / rate_hz


def horizontal_force(estimate: Array, gyro: Array, accel: Array, rate_hz: float) -> Array:
    """Return the horizontal specific force in world axes with a heading from the gyroscope, (T, 2) [m/s²].

    Roll and pitch are those of the estimate. The heading follows the gyroscope's rotation about the vertical,
    so that the force in a turn averages out. Missing samples count as zero.

    Args:
        estimate: Roll and pitch (T, 2) [rad].
        gyro: Body rate (T, 3) [rad/s].
        accel: Specific force (T, 3) [m/s²].
        rate_hz: Samples per second.
    """
    tilt = quat_from_roll_pitch(estimate)
    step = quat_from_rotvec(np.nan_to_num(0.5 * (gyro[:-1] + gyro[1:])) / rate_hz)
    left = quat_multiply(quat_multiply(tilt[:-1], step), quat_conjugate(tilt[1:]))
    twist = 2.0 * np.arctan2(left[:, 3], left[:, 0])
    heading = np.concatenate([[0.0], np.cumsum((twist + np.pi) % (2.0 * np.pi) - np.pi)])
    return quat_rotate(quat_from_roll_pitch(estimate, heading), np.nan_to_num(accel))[:, :2]


def is_larger(values: Array, others: Array) -> bool:
    """Return whether the mean of values is significantly larger than that of others (paired, 95 %)."""
    more = values - others
    return bool(more.mean() > student.ppf(0.95, len(more) - 1) * more.std(ddof=1) / np.sqrt(len(more)))


def _favoured(blocks: Mapping[str, Array], force: Mapping[str, float]) -> tuple[tuple[str, ...], str]:
    """Return the estimators that are tied for the smallest force, or none and the reason.

    The test is paired, at 95 %, on the squared mean forces by estimator [m²/s⁴], including `LEVEL`.
    """
    best = min(force, key=lambda name: force[name])
    if len(blocks[best]) < FEWEST:
        return (), f"the log is shorter than {FEWEST * LOW_PASS_S:g} s"
    chosen = []
    for name, block in blocks.items():
        if name == best or not is_larger(block, blocks[best]):
            chosen.append(name)
    if LEVEL in chosen:
        return (), "the force of a level guess is not significantly larger"
    if len(blocks) == 2:
        return (), "no other estimator ran"
    if len(chosen) == len(blocks) - 1:  # all but the guess
        return (), "the estimators do not differ significantly"
    return tuple(chosen), ""
