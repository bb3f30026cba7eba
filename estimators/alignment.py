"""The attitude at an unknown start, from how the drag changes: a tilted vehicle gathers speed, and is slowed.

Drag takes k v from a lateral speed v [m/s²] and all but it is the lateral specific force: f = −k v. A tilt θ
speeds the vehicle up by g θ less what drag takes, f' = −k (f + g θ) in the axes of `estimators.tilt`, θ about
the other lateral axis. With the turn since the start, that of the gyroscope, θ = θ0 + ∫ω dt, and

    f + k ∫ (f + g ∫ω dt) dt = f(0) − k g θ0 t,

a straight line in the time t. Its slope, by least squares with a tilt of known spread as the prior, tells θ0;
wind drops out while it is steady, and at rest the slope is gravity's. Inertial navigation calls this the
initial alignment.

The network is told as by a turn: what θ0 is found to be is added to the turn rates as it is found.
"""

from __future__ import annotations

import math

from numba import njit

from .gyro_bias import RATE_MAX, TILT_VARIANCE

KEPT = 14
"""What is kept: the time, the turn since the start, the changes of both forces that it and drag explain,
samples, the means of the time and of the forces less those changes, the variance of the time, its covariance
with both, the tilt at the start."""
GRAVITY = 9.81
FORCE_MAX = 5.0
"""How far a force counts as away from the mean of those before: a bad reading does no lasting harm [m/s²]."""
TILT_MAX = 0.45
"""Largest tilt that is believed [rad]."""


@njit(cache=True)
def align(rate_x, rate_y, force_x, force_y, step, drag, noise, kept):
    """Take one reading into what is `kept`; what the tilt at the start is now found to be is its end.

    Args:
        rate_x: Turn rate about x, in axes that do not yaw [rad/s].
        rate_y: About y.
        force_x: Specific force along x [m/s²].
        force_y: Along y.
        step: Time since the last reading [s].
        drag: What drag takes from a lateral speed, k [1/s].
        noise: Standard deviation of a force's reading [m/s²].
        kept: Shape (KEPT,), all 0 at the start; changed.

    Returns:
        How much further the tilt at the start is, about x and y [rad].
    """
    kept[1] += step * min(max(rate_x, -RATE_MAX), RATE_MAX)
    kept[2] += step * min(max(rate_y, -RATE_MAX), RATE_MAX)
    x = min(max(force_x + kept[3] - kept[7], -FORCE_MAX), FORCE_MAX)
    y = min(max(force_y + kept[4] - kept[8], -FORCE_MAX), FORCE_MAX)
    kept[3] += step * drag * (x + kept[7] - kept[3] + GRAVITY * kept[2])
    kept[4] += step * drag * (y + kept[8] - kept[4] - GRAVITY * kept[1])
    kept[5] += 1.0
    new = 1.0 / kept[5]
    old = 1.0 - new
    time = kept[0] - kept[6]
    kept[6] += new * time
    kept[7] += new * x
    kept[8] += new * y
    kept[9] = old * (kept[9] + new * time * time)
    kept[10] = old * (kept[10] + new * time * x)
    kept[11] = old * (kept[11] + new * time * y)
    fall = drag * GRAVITY
    weight = kept[5] / (kept[5] * kept[9] + noise * noise / (fall * fall * TILT_VARIANCE)) / fall
    about_x, about_y = weight * kept[11], -weight * kept[10]
    size = math.sqrt(about_x * about_x + about_y * about_y)
    if size > TILT_MAX:
        about_x, about_y = about_x * TILT_MAX / size, about_y * TILT_MAX / size
    further = about_x - kept[12], about_y - kept[13]
    kept[12], kept[13] = about_x, about_y
    return further
