"""Estimators on a log without a true attitude: how far they differ, and which of them the forces favour."""

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
"""Means of the horizontal force are over this time [s]: the acceleration of a vehicle that changes its speed
by 2 m/s in it leaves 0.2 m/s², an attitude that is wrong by 1.2° as much."""
LEVEL = "level"
"""The row of a guess that never looks at the sensor: how far the log is from level."""
FEWEST = 4
"""Means that do not overlap, at least, for the evidence to favour an estimator."""


@dataclass(frozen=True)
class Comparison:
    """Estimators on one log without a true attitude."""

    apart: Mapping[tuple[str, str], tuple[float, float]]
    """Two estimators to the median and the 95th percentile of their inclination difference [deg]."""
    force: Mapping[str, float]
    """Root mean square of the horizontal specific force in the world by each estimate, low-passed [m/s²]:
    near zero for a right one."""
    level_force: float
    """The same of a level guess [m/s²]."""
    favoured: tuple[str, ...]
    """Estimators whose force is not significantly larger than the smallest; empty where that is no choice."""
    undecided: str
    """Why there is none; "" if there is."""
    flaws: Mapping[str, str]
    """Estimators that are left out, and why."""


def compare(
    estimates: Mapping[str, Array], gyro: Array, accel: Array, rate_hz: float, flaws: Mapping[str, str]
) -> Comparison:
    """Compare estimates of a log with each other and with its forces.

    Args:
        estimates: Name to roll and pitch (T, 2) [rad], finite.
        gyro: (T, 3) [rad/s]; NaN where missing.
        accel: Specific force (T, 3) [m/s²]; NaN where missing.
        rate_hz: Samples per second.
        flaws: Estimators that have no such estimate, and why.
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


def motion(gyro: Array, rate_hz: float) -> Array:
    """How far the gyroscope says that its x and y axes turned, without its mean rate, (T, 2) [rad]."""
    rate = np.nan_to_num(gyro[:, :2])
    return np.cumsum(rate - rate.mean(axis=0), axis=0) / rate_hz


def horizontal_force(estimate: Array, gyro: Array, accel: Array, rate_hz: float) -> Array:
    """Horizontal specific force in a world whose heading the gyroscope keeps, (T, 2) [m/s²].

    Roll and pitch are the estimate's. The heading turns by the twist about the vertical that is left of the
    gyroscope's turn, so that the force of a vehicle in a turn does not add up. Missing samples count as zero.

    Args:
        estimate: Roll and pitch (T, 2) [rad].
        gyro: (T, 3) [rad/s].
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
    """Whether the mean of values is significantly larger than that of others (paired, 95 %)."""
    more = values - others
    return bool(more.mean() > student.ppf(0.95, len(more) - 1) * more.std(ddof=1) / np.sqrt(len(more)))


def _favoured(blocks: Mapping[str, Array], force: Mapping[str, float]) -> tuple[tuple[str, ...], str]:
    """The estimator of the smallest force and all that do not differ significantly from it, or none and why.

    Paired, 95 %, from the squares of its mean forces by estimator [m²/s⁴], `LEVEL` among them.
    """
    best = min(force, key=lambda name: force[name])
    if len(blocks[best]) < FEWEST:
        return (), f"the log is shorter than {FEWEST * LOW_PASS_S:g} s"
    chosen = []
    for name, block in blocks.items():
        if name == best or not is_larger(block, blocks[best]):
            chosen.append(name)
    if LEVEL in chosen:
        return (), "a level guess has no larger force"
    if len(blocks) == 2:
        return (), "no other estimator ran"
    if len(chosen) == len(blocks) - 1:  # all but the guess
        return (), "the estimators do not differ significantly"
    return tuple(chosen), ""
