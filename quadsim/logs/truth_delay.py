"""How late the truth of a log is, and whether it turns as the gyroscope does: their body rates compared."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..rotation import xyzw_from_wxyz
from .recording import Array

SEARCH_S = 0.5
"""Delays of more than this are not looked for."""
SPAN_S, LONG_S = 0.1, 0.5
"""Turns over these times are compared: white noise of the truth's attitude falls as one over the time, and
counts over the shorter in gentle motion; over the longer, fast motion turns back."""
MOVING, SURELY_MOVING = 0.05, 0.25
"""Least standard deviations of the rates, of both and of one alone, that say something [rad/s]."""
TURNING = 0.1
"""The same of the truth about an axis, for a correlation of that axis alone [rad/s]."""
COMMON = 0.3
"""Correlation under the best rotation or mirroring of the gyroscope's axes below which the truth's noise is
not corrected for: chance reaches 0.2 in half a minute."""


class Agreement(NamedTuple):
    """How the truth turns beside the gyroscope, over the time in which both have most in common."""

    agreement: float
    """Correlation over all three axes, corrected for the truth's noise: 1 where both turn alike."""
    axes: tuple[float, float, float]
    """The same of each axis; 1 where the truth hardly turns about it."""
    rotated: float
    """The same under the rotation of the gyroscope's axes at which it is largest,"""
    rotation_deg: float
    """and the angle of that rotation [deg]."""
    gain: float
    """What that rotation adds to the correlation as it is, not corrected."""
    common: float
    """Correlation under the best rotation or mirroring: what the truth's noise leaves."""


class Alignment(NamedTuple):
    """How the turns of the truth and of the gyroscope belong together."""

    delay_s: float
    """How late the truth is [s] (negative: early), to a fraction of a sample."""
    agreement: float
    """Correlation of the rates over `SPAN_S` at that delay, all three axes together."""
    rotated_agreement: float
    """The same under the rotation of the gyroscope's axes at which it is largest."""
    slope: float
    """Readings over the truth's rates, 1 where units agree: the true slope is between r and 1/r times this,
    with r the correlation under that rotation."""
    turned: Agreement
    """Whether both turn alike."""


class Turns(NamedTuple):
    """Mean body rates over a time, NaN where one of them is not known."""

    measured: Array
    """By the gyroscope (m, 3) [rad/s]."""
    true: Array
    """By the attitude (m, 3) [rad/s]."""
    span: int
    """Samples of a mean."""


def align(gyro: Array, quat: Array, rate_hz: float) -> Alignment | None:
    """Find the delay at which the truth turns most as the gyroscope says, and compare both there.

    Args:
        gyro: Body rates (T, 3) [rad/s], NaN where missing.
        quat: quat_WB (T, 4), NaN where not known.
        rate_hz: Samples per second.

    Returns:
        The result; None where there is too little motion.
    """
    rates, long = (turns(gyro, quat, rate_hz, span_s) for span_s in (SPAN_S, LONG_S))
    if rates is None or long is None:
        return None
    most, crosses = _at_all_delays(rates, rate_hz)
    fit = np.array([each.agreement for each in crosses])
    peak = int(np.clip(np.argmax(fit), 1, fit.size - 2))
    left, top, right = fit[peak - 1 : peak + 2]
    bend = left - 2 * top + right
    beside = 0.5 * (left - right) / bend if bend < 0 else 0.0
    rotated = int(np.argmax([each.rotated_agreement for each in crosses]))
    both = [_agreement(each, peak - most, rotated - most) for each in (rates, long)]
    return Alignment(
        delay_s=float((peak - most + beside) / rate_hz),
        agreement=float(top),
        rotated_agreement=crosses[rotated].rotated_agreement,
        slope=crosses[rotated].slope,
        turned=max(both, key=lambda each: each.common),
    )


def _agreement(rates: Turns, lag: int, rotated_lag: int) -> Agreement:
    """How turns agree at two delays in samples, with the gyroscope's axes as they are and rotated.

    The correlation under the best rotation or mirroring, c = (s₁ + s₂ + s₃)/√(pq), is less than 1 by the
    truth's noise, which has the share 1 − c² of its variance q. Correlations are corrected for it
    (Spearman 1904); it is taken to be the same about every axis.
    """
    a, b = _shifted(rates.measured, rates.true, lag)
    plain, best = _cross(a, b), _cross(*_shifted(rates.measured, rates.true, rotated_lag))
    common = max(plain.common, best.common)
    explained = common if common > COMMON else 1.0
    noise = (1 - explained**2) * float((b**2).sum()) / 3
    signal = (b**2).sum(axis=0) - noise
    x, y, z = (
        float(a[:, k] @ b[:, k] / np.sqrt(max(float(a[:, k] @ a[:, k]), 1e-30) * signal[k]))
        if signal[k] > TURNING**2 * len(b)
        else 1.0
        for k in range(3)
    )
    return Agreement(
        plain.agreement / explained, (x, y, z), best.rotated_agreement / explained, best.rotation_deg,
        best.rotated_agreement - plain.agreement, common,
    )  # fmt: skip


def turns(gyro: Array, quat: Array, rate_hz: float, span_s: float = SPAN_S) -> Turns | None:
    """Mean body rates of the gyroscope and of the truth, or None where there is too little motion."""
    known = np.asarray(np.isfinite(quat).all(axis=1))
    span = max(round(span_s * rate_hz), 1)
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
    return Turns(a, b, span)


def turns_at_delay(gyro: Array, quat: Array, rate_hz: float) -> tuple[Array, Array, int] | None:
    """Rates of gyroscope and truth over spans that overlap, less their means, (m, 3) each; samples of a span.

    The truth's delay, at which they agree best under any rotation of the gyroscope's axes, is taken out, and
    so is the gyroscope's scale. Of both spans the one over which they have most in common is used. None where
    there is too little motion.
    """
    found = []
    for span_s in (SPAN_S, LONG_S):
        if (rates := turns(gyro, quat, rate_hz, span_s)) is None:
            return None
        most, crosses = _at_all_delays(rates, rate_hz)
        best = int(np.argmax([each.rotated_agreement for each in crosses]))
        a, b = _shifted(rates.measured, rates.true, best - most)
        found.append((crosses[best].common, a / crosses[best].slope, b, rates.span))
    return max(found, key=lambda each: each[0])[1:]


class _Cross(NamedTuple):
    """Second moments of two series of vectors, Σ a bᵀ, Σ |a|² and Σ |b|², as what is read from them."""

    agreement: float
    rotated_agreement: float
    common: float
    rotation_deg: float
    slope: float


def _at_all_delays(rates: Turns, rate_hz: float) -> tuple[int, list[_Cross]]:
    """The largest delay in samples, and how the rates belong together at every one from its negative on."""
    most = round(SEARCH_S * rate_hz)
    return most, [_cross(*_shifted(rates.measured, rates.true, lag)) for lag in range(-most, most + 1)]


def _shifted(a: Array, b: Array, lag: int) -> tuple[Array, Array]:
    """a[k] and b[k + lag] where both are known, less their means."""
    a, b = (a[: a.shape[0] - lag], b[lag:]) if lag >= 0 else (a[-lag:], b[:lag])
    both = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    a, b = (x[both] - x[both].mean(axis=0) for x in (a, b))
    return a, b


def _cross(a: Array, b: Array) -> _Cross:
    """How two series without their means belong together, all axes together.

    The rotation R is that which maximises c = Σ b·R a = tr(R Σ a bᵀ) = s₁ + s₂ ± s₃, the singular values
    (Kabsch 1976). With p = Σ|a|² and q = Σ|b|² the correlation is r = c/√(pq) and the slope of a over b
    √(p/q), midway between the two regressions c/q, which noise of b biases low, and p/c, which noise of a
    biases high. They are r and 1/r times it, and the true slope is between them (Frisch 1934).
    """
    p, q = max(float((a**2).sum()), 1e-30), max(float((b**2).sum()), 1e-30)
    moments = a.T @ b
    u, s, vt = np.linalg.svd(moments)
    proper = np.ones(s.size)
    proper[-1] = np.linalg.det(u @ vt)
    c = float((s * proper).sum())
    cosine = (float(np.trace((vt.T * proper) @ u.T)) - 1.0) / 2.0
    scale = np.sqrt(p * q)
    return _Cross(
        float(np.trace(moments)) / scale,
        c / scale,
        float(s.sum()) / scale,
        float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))),
        float(np.sqrt(p / q)),
    )
