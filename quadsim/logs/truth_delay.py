"""How late the truth of a log is: its body rates beside those of the gyroscope."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..rotation import xyzw_from_wxyz
from .recording import Array

SEARCH_S = 0.5
"""Delays of more than this are not looked for."""
SPAN_S = 0.1
"""Turns over this time are compared, so that the truth's noise does not count."""
MOVING, SURELY_MOVING = 0.05, 0.25
"""Least standard deviations of the rates, of both and of one alone, that say something [rad/s]."""
TURNING = 0.1
"""The same of the truth about an axis, for a correlation of that axis alone [rad/s]."""


class Alignment(NamedTuple):
    """How the turns of the truth and of the gyroscope belong together."""

    delay_s: float
    """How late the truth is [s] (negative: early), to a fraction of a sample."""
    agreement: float
    """Correlation over all three axes at that delay: 1 where both turn alike."""
    axes: tuple[float, float, float]
    """The same of each axis; 1 where the truth hardly turns about it."""
    slope: float
    """Readings over the truth's rates, the line of best fit at that delay: 1 where units agree."""


def align(gyro: Array, quat: Array, rate_hz: float) -> Alignment | None:
    """Find the delay at which the truth turns most as the gyroscope says, and compare both there.

    Args:
        gyro: Body rates (T, 3) [rad/s], NaN where missing.
        quat: quat_WB (T, 4), NaN where not known.
        rate_hz: Samples per second.

    Returns:
        The result; None where there is too little motion.
    """
    known = np.asarray(np.isfinite(quat).all(axis=1))
    span = max(round(SPAN_S * rate_hz), 1)
    if known.size < 4 * span + 2 * SEARCH_S * rate_hz:
        return None
    xyzw = xyzw_from_wxyz(np.where(known[:, None], quat, (1.0, 0.0, 0.0, 0.0)))
    before, after = Rotation.from_quat(xyzw[:-span]), Rotation.from_quat(xyzw[span:])
    turn = (before.inv() * after).as_rotvec() * rate_hz / span
    between = 0.5 * (gyro[:-1] + gyro[1:])
    measured = np.stack([np.convolve(axis, np.full(span, 1 / span), "valid") for axis in between.T], axis=1)
    both = known[:-span] & known[span:] & np.isfinite(measured).all(axis=1)
    if both.sum() < 4 * SEARCH_S * rate_hz:
        return None
    a, b = (np.where(both[:, None], x, np.nan) for x in (measured, turn))
    spreads = [np.nanstd(x, axis=0).max() for x in (a, b)]
    if min(spreads) < MOVING and max(spreads) < SURELY_MOVING:
        return None
    most = round(SEARCH_S * rate_hz)
    fit = np.array([_fit(a, b, lag)[0] for lag in range(-most, most + 1)])
    peak = int(np.clip(np.argmax(fit), 1, fit.size - 2))
    left, top, right = fit[peak - 1 : peak + 2]
    bend = left - 2 * top + right
    beside = 0.5 * (left - right) / bend if bend < 0 else 0.0
    lag = peak - most
    x, y, z = (
        _fit(a[:, k : k + 1], b[:, k : k + 1], lag)[0] if np.nanstd(b[:, k]) > TURNING else 1.0
        for k in range(3)
    )
    return Alignment(float((lag + beside) / rate_hz), float(top), (x, y, z), _fit(a, b, lag)[1])


def _fit(a: Array, b: Array, lag: int) -> tuple[float, float]:
    """Correlation of a[k] with b[k + lag], all axes together, where both are known, and the slope a over b.

    The slope is the ratio of the standard deviations, which noise in either one alone hardly biases.
    """
    a, b = (a[: a.shape[0] - lag], b[lag:]) if lag >= 0 else (a[-lag:], b[:lag])
    both = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    a, b = (x[both] - x[both].mean(axis=0) for x in (a, b))
    power_a, power_b = max(float((a**2).sum()), 1e-30), max(float((b**2).sum()), 1e-30)
    return float((a * b).sum()) / np.sqrt(power_a * power_b), float(np.sqrt(power_a / power_b))
