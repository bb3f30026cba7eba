"""Bias of a gyroscope: what it turns further than a true attitude, over half a second and more."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from ..rotation import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_rotvec,
    quat_multiply,
    xyzw_from_wxyz,
)
from .recording import Array
from .truth_delay import LONG_S

RATE_MAX = 2.0
"""Turns with a mean rate above this are left out [rad/s]: they hold the truth's delay."""
BLOCKS = 16
"""Parts of the log whose scatter gives the interval: errors within one may be correlated."""


class GyroBias(NamedTuple):
    """Mean bias of a gyroscope over a log."""

    mean: Array
    """(3,) [rad/s]."""
    half_width: Array
    """Half the width of its 95 % interval (3,) [rad/s]."""

    @property
    def significant(self) -> Array:
        """The mean on axes where it differs significantly from zero, else 0 (3,) [rad/s]; NaN if unknown."""
        return np.where(np.abs(self.mean) <= self.half_width, 0.0, self.mean)


def bias_by_truth(gyro: Array, quat: Array, rate_hz: float) -> GyroBias:
    """The bias b at which the integrated gyroscope turns as the truth does, with its 95 % interval.

    Over a turn from s to e, log(R_truthᵀ R_gyro) = R_eᵀ ∫ R dt b to first order: least squares over turns of
    `LONG_S`, iterated. White noise of the truth's attitude cancels from one turn to the next; the interval is
    by the scatter of blocks of turns (cluster-robust, Student's t).

    Args:
        gyro: (T, 3) [rad/s]; NaN where missing.
        quat: quat_WB (T, 4); NaN where not known.
        rate_hz: Samples per second.

    Returns:
        The bias; NaN if fewer than a second of slow turns is known.
    """
    known, rates, truth = _slow_turns(gyro, quat, rate_hz)
    if known.sum() * LONG_S < 1.0:
        return GyroBias(np.full(3, np.nan), np.full(3, np.nan))
    mean, scores, inverse = np.zeros(3), np.zeros_like(rates[:, 0]), np.eye(3)
    for _ in range(4):
        beyond, lever = _beyond(rates - mean, truth, 1.0 / rate_hz)
        inverse = np.linalg.inv(np.einsum("nki,nkj->ij", lever, lever))
        scores = np.einsum("nki,nk->ni", lever, beyond)
        mean += inverse @ scores.sum(axis=0)
    blocks = min(BLOCKS, len(scores))
    sums = np.stack([part.sum(axis=0) for part in np.array_split(scores, blocks)]) @ inverse
    sd = np.sqrt((sums**2).sum(axis=0) * blocks / (blocks - 1))
    return GyroBias(mean, float(student.ppf(0.975, blocks - 1)) * sd)


class BiasOverTime(NamedTuple):
    """A gyroscope's bias over each of n turns of `LONG_S`; NaN where the turn is fast or not known."""

    bias: Array
    """(n, 3) [rad/s]."""
    rate: Array
    """Mean rate (n, 3) [rad/s]."""
    rms: Array
    """Root mean square of the rate (n,) [rad/s]."""


def bias_over_time(gyro: Array, quat: Array, rate_hz: float) -> BiasOverTime:
    """The bias of each turn of `LONG_S`, linear about that of the log.

    Args:
        gyro: (T, 3) [rad/s]; NaN where missing.
        quat: quat_WB (T, 4); NaN where not known.
        rate_hz: Samples per second.
    """
    known, rates, truth = _slow_turns(gyro, quat, rate_hz)
    bias, means = np.full((2, len(known), 3), np.nan)
    rms = np.full(len(known), np.nan)
    mean = bias_by_truth(gyro, quat, rate_hz).mean
    if np.isfinite(mean).all():
        beyond, lever = _beyond(rates - mean, truth, 1.0 / rate_hz)
        bias[known] = mean + np.linalg.solve(lever, beyond[:, :, None])[:, :, 0]
        means[known] = rates.mean(axis=1)
        rms[known] = np.sqrt((rates**2).sum(axis=2).mean(axis=1))
        fast = ~(rms < RATE_MAX)  # to and fro, with a small mean
        bias[fast], means[fast], rms[fast] = np.nan, np.nan, np.nan
    return BiasOverTime(bias, means, rms)


def _slow_turns(gyro: Array, quat: Array, rate_hz: float) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which turns of `LONG_S` are slow and known (n,); of those the rates (m, k, 3) and true turns (m, 4)."""
    span = max(round(LONG_S * rate_hz), 1)
    count = (len(gyro) - 1) // span
    rates = (0.5 * (gyro[:-1] + gyro[1:]))[: count * span].reshape(count, span, 3)
    before, after = quat[: count * span : span], quat[span : count * span + 1 : span]
    slow = np.linalg.norm(rates.mean(axis=1), axis=1) < RATE_MAX  # not where it is NaN
    known = slow & np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    return known, rates[known], quat_multiply(quat_conjugate(before[known]), after[known])


def _beyond(rates: Array, truth: Array, dt: float) -> tuple[Array, Array]:
    """What body rates (n, k, 3) turn further than true turns (n, 4): (n, 3) [rad], and R_endᵀ ∫ R dt."""
    turned, lever = _integrated(rates, dt)
    relative = quat_multiply(quat_conjugate(truth), turned)
    return Rotation.from_quat(xyzw_from_wxyz(relative)).as_rotvec(), lever


def _integrated(rates: Array, dt: float) -> tuple[Array, Array]:
    """Turns by body rates (n, k, 3): quaternions (n, 4), and R_endᵀ ∫ R dt (n, 3, 3) [s]."""
    turned, lever = np.tile([1.0, 0.0, 0.0, 0.0], (len(rates), 1)), np.zeros((len(rates), 3, 3))
    for k in range(rates.shape[1]):
        half = quat_from_rotvec(0.5 * dt * rates[:, k])
        turned = quat_multiply(turned, half)
        lever += dt * matrix_from_quat(turned)
        turned = quat_multiply(turned, half)
    return turned, np.swapaxes(matrix_from_quat(turned), 1, 2) @ lever
