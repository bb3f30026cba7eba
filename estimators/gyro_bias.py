"""The gyroscope's bias, from the rates alone: a vehicle that stays upright does not turn for ever.

In axes that do not yaw (`estimators.tilt`) the tilt is all but the integral of the lateral rates. With a bias
b in body axes, and the heading as a complex number r of length 1, that of the readings ω is

    I(t) = ∫ r ω dt = tilt(t) + b S(t) + const,    S(t) = ∫ r dt,

a straight line in S about which the tilt scatters. Its slope, by least squares with a bias of known spread as
the prior, is the estimate; older samples count less and less. The slope tells far more than the mean rate,
which knows the first and the last tilt only.
"""

from __future__ import annotations

from numba import njit

KEPT = 15
"""What is kept: samples, S, I, the means of both, the variance of S, its covariance with I, the variance of
I, the bias."""
RATE_MAX = 40.0
"""Rate beyond which a reading counts no further [rad/s]."""
BIAS_MAX = 0.1
"""Largest bias that is believed, of each axis [rad/s]."""
CORRELATED_S = 1.0
"""Seconds for which a tilt is taken to last: samples that are nearer tell nothing of their own."""
TILT_VARIANCE = 0.06
"""Variance of a component of the tilt that is expected at the start [rad²]."""
EXPECTED_S = 1.0
"""Seconds for which that expectation counts as much as what has been seen."""


@njit(cache=True)
def follow_bias(rates, cosine, sine, step, memory, spread, kept):
    """Take one reading of a gyroscope into what is `kept`; the bias is its last two entries.

    Args:
        rates: The reading, of which x and y count [rad/s].
        cosine: Of the heading.
        sine: Of the heading.
        step: Time since the last reading [s].
        memory: Samples for which a reading counts.
        spread: Standard deviation of the bias of an axis [rad/s].
        kept: Shape (KEPT,), all 0 at the start; changed.
    """
    x = min(max(rates[0], -RATE_MAX), RATE_MAX)
    y = min(max(rates[1], -RATE_MAX), RATE_MAX)
    kept[0] = min(kept[0] + 1.0, memory)
    kept[1] += step * cosine
    kept[2] += step * sine
    kept[3] += step * (cosine * x - sine * y)
    kept[4] += step * (cosine * y + sine * x)
    new = 1.0 / kept[0]
    sx, sy, ix, iy = kept[1] - kept[5], kept[2] - kept[6], kept[3] - kept[7], kept[4] - kept[8]
    kept[5] += new * sx
    kept[6] += new * sy
    kept[7] += new * ix
    kept[8] += new * iy
    old = 1.0 - new
    kept[9] = old * (kept[9] + new * (sx * sx + sy * sy))
    kept[10] = old * (kept[10] + new * (sx * ix + sy * iy))
    kept[11] = old * (kept[11] + new * (sx * iy - sy * ix))
    kept[12] = old * (kept[12] + new * (ix * ix + iy * iy))
    explained = (kept[10] * kept[10] + kept[11] * kept[11]) / max(kept[9], 1e-12)
    scatter = 0.5 * max(kept[12] - explained, 0.0)
    expected = EXPECTED_S / step
    variance = (kept[0] * scatter + expected * TILT_VARIANCE) / (kept[0] + expected)
    weight = kept[0] / (kept[0] * kept[9] + CORRELATED_S / step * variance / (spread * spread))
    kept[13] = min(max(weight * kept[10], -BIAS_MAX), BIAS_MAX)
    kept[14] = min(max(weight * kept[11], -BIAS_MAX), BIAS_MAX)
