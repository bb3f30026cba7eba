"""Comparison of a log's true attitude with its gyroscope: delay, agreement, and gyroscope bias.

Signals are evenly sampled: `gyro` is the body rate (T, 3) [rad/s], NaN where missing, and `quat` the true
quat_WB (T, 4), NaN where not known.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from ..rotation import matrix_from_quat, quat_conjugate, quat_from_rotvec, quat_multiply, xyzw_from_wxyz
from .recording import Array
from .thresholds import TURN

SEARCH_S = 0.5
"""Largest delay that is searched for [s]."""
SPAN_S, LONG_S = 0.1, 0.5
"""Durations of the rotations that are compared [s]. The effect of white noise in the true attitude is
proportional to one over the duration, so gentle motion needs the longer one. In fast motion, rotations over
the longer one cancel."""
BLOCKS = 16
"""Number of parts of the log whose scatter gives the interval of the bias; errors within a part may be
correlated."""


class Agreement(NamedTuple):
    """Agreement of the rotations of truth and gyroscope, over the duration at which they agree best."""

    agreement: float
    """Correlation over all three axes, corrected for the noise of the truth; 1 if both rotate equally."""
    axes: Array
    """Correlation of each axis (3,); 1 if the truth hardly rotates about the axis."""
    rotated: float
    """Largest correlation under a rotation of the gyroscope's axes."""
    rotation_deg: float
    """Angle of the rotation at which the correlation is largest [deg]."""
    gain: float
    """Increase of the uncorrected correlation by this rotation."""
    common: float
    """Correlation under the best rotation or reflection, which only the noise of the truth limits."""


class Alignment(NamedTuple):
    """Relation between the rotations of the truth and of the gyroscope."""

    delay_s: float
    """Delay of the truth [s], to a fraction of a sample; negative if the truth is early."""
    agreement: float
    """Correlation of the rates over `SPAN_S` at this delay, all three axes together."""
    rotated_agreement: float
    """Largest correlation under a rotation of the gyroscope's axes."""
    slope: float
    """Ratio of the readings to the rates of the truth; 1 if the units agree. The true ratio is between r and
    1/r times this value, where r is `rotated_agreement`."""
    turned: Agreement
    """Whether both rotate equally."""


def align(gyro: Array, quat: Array, rate_hz: float) -> Alignment | None:
    """Find the delay at which truth and gyroscope agree best, and compare them at this delay.

    Returns:
        The result; None if there is too little motion.
    """
    found = _turns(gyro, quat, rate_hz)
    if found is None:
        return None
    matches = found[0].at_all_delays()
    fit, most = matches.agreement, found[0].most
    peak = int(np.clip(np.argmax(fit), 1, fit.size - 2))
    left, top, right = fit[peak - 1 : peak + 2]
    bend = left - 2 * top + right
    beside = 0.5 * (left - right) / bend if bend < 0 else 0.0
    rotated = int(np.argmax(matches.rotated_agreement))
    return Alignment(
        delay_s=float((peak - most + beside) / rate_hz),
        agreement=float(top),
        rotated_agreement=float(matches.rotated_agreement[rotated]),
        slope=float(matches.slope[rotated]),
        turned=max(
            (_agreement(each, peak - most, rotated - most) for each in found), key=lambda each: each.common
        ),
    )


def turns_at_delay(gyro: Array, quat: Array, rate_hz: float) -> tuple[Array, Array, int] | None:
    """Return rates of gyroscope and truth over overlapping spans, (m, 3) each, and the samples of a span.

    The means of the rates, the delay of the truth and the scale of the gyroscope are removed. The delay is
    the one at which the rates agree best under any rotation of the gyroscope's axes. Of the two spans, the
    one with better agreement is used. The result is None if there is too little motion.
    """
    found = []
    for turns in _turns(gyro, quat, rate_hz) or ():
        matches = turns.at_all_delays()
        best = int(np.argmax(matches.rotated_agreement))
        measured, true = turns.at(best - turns.most)
        found.append((matches.common[best], measured / matches.slope[best], true, turns.span))
    return max(found, key=lambda each: each[0])[1:] if found else None


class _Turns(NamedTuple):
    """Mean body rates (m, 3) [rad/s] by gyroscope and attitude over `span` samples, NaN where not known.

    Delays up to `most` samples are looked for.
    """

    measured: Array
    true: Array
    span: int
    most: int

    def at(self, lag: int) -> tuple[Array, Array]:
        """Both where the truth is `lag` samples late, less their means, where both are known."""
        a, b = self.measured, self.true
        a, b = (a[: a.shape[0] - lag], b[lag:]) if lag >= 0 else (a[-lag:], b[:lag])
        both = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
        return a[both] - a[both].mean(axis=0), b[both] - b[both].mean(axis=0)

    def at_all_delays(self) -> "_Match":
        """Match both at every delay, from the largest negative one on.

        The result holds arrays over delays.
        """
        known = np.isfinite(self.measured[:, 0]).astype(np.float64)
        a, b = (np.nan_to_num(each).T for each in (self.measured, self.true))

        def summed(x: Array, y: Array) -> Array:
            return correlate(y, x, method="fft")[known.size - 1 - self.most : known.size + self.most]

        count = summed(known, known)
        sums_a, sums_b = np.array([[summed(x, known) for x in a], [summed(known, y) for y in b]])
        products = np.array([[summed(x, y) for y in b] for x in a])
        moments = products - np.einsum("il,jl->ijl", sums_a, sums_b) / count
        p = summed((a**2).sum(axis=0), known) - (sums_a**2).sum(axis=0) / count
        q = summed(known, (b**2).sum(axis=0)) - (sums_b**2).sum(axis=0) / count
        return _match(np.moveaxis(moments, -1, 0), p, q)


def _turns(gyro: Array, quat: Array, rate_hz: float) -> list[_Turns] | None:
    """Turns over `SPAN_S` and over `LONG_S`, or None where one of them has too little motion."""
    known, found = np.asarray(np.isfinite(quat).all(axis=1)), []
    xyzw = xyzw_from_wxyz(np.where(known[:, None], quat, (1.0, 0.0, 0.0, 0.0)))
    between = 0.5 * (gyro[:-1] + gyro[1:]).clip(-1e9, 1e9)  # the squares of any number are finite
    for span_s in (SPAN_S, LONG_S):
        span = max(round(span_s * rate_hz), 1)
        if known.size < 4 * span + 2 * SEARCH_S * rate_hz:
            return None
        before, after = Rotation.from_quat(xyzw[:-span]), Rotation.from_quat(xyzw[span:])
        turn = (before.inv() * after).as_rotvec() * rate_hz / span
        measured = np.stack(
            [np.convolve(axis, np.full(span, 1 / span), "valid") for axis in between.T], axis=1
        )
        both = known[:-span] & known[span:] & np.isfinite(measured).all(axis=1)
        if both.sum() < 4 * SEARCH_S * rate_hz:
            return None
        a, b = (np.where(both[:, None], x, np.nan) for x in (measured, turn))
        spreads = [np.nanstd(x, axis=0).max() for x in (a, b)]
        if min(spreads) < TURN.moving and max(spreads) < TURN.surely_moving:
            return None
        found.append(_Turns(a, b, span, round(SEARCH_S * rate_hz)))
    return found


def _agreement(turns: _Turns, lag: int, rotated_lag: int) -> Agreement:
    """How turns agree at two delays in samples, with the gyroscope's axes as they are and rotated.

    The correlation under the best rotation or mirroring, c = (s₁ + s₂ + s₃)/√(pq), is less than 1 by the
    truth's noise, which has the share 1 − c² of its variance q. Correlations are corrected for it
    (Spearman 1904); it is taken to be the same about every axis.
    """
    a, b = turns.at(lag)
    plain, best = (_match(x.T @ y, (x**2).sum(), (y**2).sum()) for x, y in ((a, b), turns.at(rotated_lag)))
    common = max(float(plain.common), float(best.common))
    explained = common if common > TURN.common else 1.0
    noise = (1 - explained**2) * float((b**2).sum()) / 3
    signal = (b**2).sum(axis=0) - noise
    turning = signal > TURN.turning**2 * len(b)
    scale = np.sqrt(np.maximum((a**2).sum(axis=0), 1e-30) * np.where(turning, signal, 1.0))
    return Agreement(
        agreement=float(plain.agreement) / explained,
        axes=np.where(turning, (a * b).sum(axis=0) / scale, 1.0),
        rotated=float(best.rotated_agreement) / explained,
        rotation_deg=float(best.rotation_deg),
        gain=float(best.rotated_agreement - plain.agreement),
        common=common,
    )


class _Match(NamedTuple):
    """Correlations as they are, rotated, and rotated or mirrored; the rotation's angle; the slope: (...)."""

    agreement: Array
    rotated_agreement: Array
    common: Array
    rotation_deg: Array
    slope: Array


def _match(moments: Array, p: Array, q: Array) -> _Match:
    """How two series without their means belong together, all axes together.

    From the second moments Σ a bᵀ (..., 3, 3), p = Σ |a|² and q = Σ |b|² (...). The rotation R is that which
    maximises c = Σ b·R a = tr(R Σ a bᵀ) = s₁ + s₂ ± s₃, the singular values (Kabsch 1976). The correlation is
    r = c/√(pq) and the slope of a over b √(p/q), midway between the two regressions c/q, which noise of b
    biases low, and p/c, which noise of a biases high. They are r and 1/r times it, and the true slope is
    between them (Frisch 1934).
    """
    p, q = np.maximum(p, 1e-30), np.maximum(q, 1e-30)
    u, s, vt = np.linalg.svd(moments)
    proper = np.ones_like(s)
    proper[..., -1] = np.linalg.det(u @ vt)
    rotation = (np.swapaxes(vt, -1, -2) * proper[..., None, :]) @ np.swapaxes(u, -1, -2)
    cosine = (np.trace(rotation, axis1=-2, axis2=-1) - 1.0) / 2.0
    scale = np.sqrt(p * q)
    return _Match(
        np.trace(moments, axis1=-2, axis2=-1) / scale,
        (s * proper).sum(axis=-1) / scale,
        s.sum(axis=-1) / scale,
        np.degrees(np.arccos(np.clip(cosine, -1, 1))),
        np.sqrt(p / q),
    )


class GyroBias(NamedTuple):
    """Mean bias of a gyroscope over a log, with its confidence interval."""

    mean: Array
    """Mean bias (3,) [rad/s]."""
    half_width: Array
    """Half the width of the 95 % interval of the mean bias (3,) [rad/s]."""

    @property
    def significant(self) -> Array:
        """Mean bias on axes where it differs significantly from zero, and 0 elsewhere (3,) [rad/s].

        The bias is NaN if it is unknown.
        """
        return np.where(np.abs(self.mean) <= self.half_width, 0.0, self.mean)


def bias_by_truth(gyro: Array, quat: Array, rate_hz: float) -> GyroBias:
    """Estimate the bias b at which the integrated gyroscope matches the true rotations, with a 95 % interval.

    For a rotation from s to e, log(R_truthᵀ R_gyro) = R_eᵀ ∫ R dt b to first order. The bias is the iterated
    least-squares solution over rotations of duration `LONG_S`. White noise of the true attitude cancels
    between successive rotations. The interval follows from the scatter of blocks of rotations
    (cluster-robust, Student's t).

    Returns:
        The bias; NaN if less than a second of slow rotations is known.
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


def bias_over_time(gyro: Array, quat: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Return bias and mean rate (n, 3), and RMS rate (n,), over each rotation of duration `LONG_S` [rad/s].

    The bias is linearised about that of the log. All results are NaN where a rotation is fast or not known.
    """
    known, rates, truth = _slow_turns(gyro, quat, rate_hz)
    bias, means, rms = (np.full((len(known), *shape), np.nan) for shape in ((3,), (3,), ()))
    rms[known] = np.sqrt((rates**2).sum(axis=2).mean(axis=1))
    slow = rms[known] < TURN.rate_max  # not to and fro with a small mean
    mean = bias_by_truth(gyro, quat, rate_hz).mean
    if np.isfinite(mean).all():
        beyond, lever = _beyond(rates[slow] - mean, truth[slow], 1.0 / rate_hz)
        known[known] = slow
        bias[known] = mean + np.linalg.solve(lever, beyond[:, :, None])[:, :, 0]
        means[known] = rates[slow].mean(axis=1)
    return bias, means, rms


def _slow_turns(gyro: Array, quat: Array, rate_hz: float) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return which rotations are slow and known (n,), their rates (m, k, 3) and true rotations (m, 4)."""
    span = max(round(LONG_S * rate_hz), 1)
    count = (len(gyro) - 1) // span
    rates = (0.5 * (gyro[:-1] + gyro[1:]))[: count * span].reshape(count, span, 3)
    before, after = quat[: count * span : span], quat[span : count * span + 1 : span]
    slow = np.linalg.norm(rates.mean(axis=1), axis=1) < TURN.rate_max  # not where it is NaN
    known = slow & np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    return known, rates[known], quat_multiply(quat_conjugate(before[known]), after[known])


def _beyond(rates: Array, truth: Array, dt: float) -> tuple[Array, Array]:
    """Return by how much rates (n, k, 3) exceed rotations (n, 4), (n, 3) [rad], and R_endᵀ ∫ R dt [s]."""
    turned, lever = np.tile([1.0, 0.0, 0.0, 0.0], (len(rates), 1)), np.zeros((len(rates), 3, 3))
    for k in range(rates.shape[1]):
        half = quat_from_rotvec(0.5 * dt * rates[:, k])
        turned = quat_multiply(turned, half)
        lever += dt * matrix_from_quat(turned)
        turned = quat_multiply(turned, half)
    relative = Rotation.from_quat(xyzw_from_wxyz(quat_multiply(quat_conjugate(truth), turned)))
    return relative.as_rotvec(), np.swapaxes(matrix_from_quat(turned), 1, 2) @ lever
