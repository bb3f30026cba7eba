"""The attitude as a network tells it that is to know nothing of yaw: a tilt, in axes that do not yaw.

Seen in body axes, gravity turns with the yaw rate r: roll and pitch obey φ̇ = p + tan θ (q sin φ + r cos φ),
whose products a network has to learn. In axes that begin as the body's and do not turn about its z axis, r is
gone and the tilt is all but the integral of the two lateral rates. The host turns the readings into those
axes and the answer back. It needs the integral of r, whose drift turns both alike and does no harm.

The tilt is a rotation vector (axis times angle): its two components are roll and pitch while these are small,
and turn as any vector does, which roll and pitch do not (Shuster 1993, "A survey of attitude
representations").
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE_MAX = 40.0
"""Rate beyond which a reading counts no further [rad/s]."""


@njit(cache=True)
def yawed(cosine, sine, rate, step):
    """Cosine and sine of the heading after a yaw rate [rad/s] over `step` [s]: 2 atan(rate step / 2) more."""
    half = 0.5 * step * min(max(rate, -RATE_MAX), RATE_MAX)
    for _ in range(2):
        cosine, sine = cosine - half * sine, sine + half * cosine
    size = math.sqrt(cosine * cosine + sine * sine)
    return cosine / size, sine / size


@njit(cache=True)
def turned_by(x, y):
    """Components of a tilt [rad] whose sine has these, below a right angle."""
    sine = math.sqrt(x * x + y * y)
    factor = math.asin(min(sine, 1.0)) / sine if sine > 0.0 else 1.0
    return factor * x, factor * y


def tilt_of(roll_pitch: NDArray[np.floating], heading: Array) -> Array:
    """Tilt [rad] in the axes that do not yaw.

    Args:
        roll_pitch: Shape (..., 2) [rad].
        heading: Cosine and sine of the angle by which the body has yawed from them, shape (..., 2).
    """
    roll, pitch = np.moveaxis(np.asarray(roll_pitch, np.float64), -1, 0)
    x, y, z = -np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)  # the world's up
    sine = np.hypot(x, y)
    factor = np.where(sine > 0, np.arctan2(sine, z) / np.where(sine > 0, sine, 1.0), 1.0)
    cosine, sine = heading[..., 0], heading[..., 1]
    return np.stack([cosine * y + sine * x, sine * y - cosine * x], -1) * factor[..., None]


@njit(cache=True)
def to_roll_pitch(tilt, heading):
    """Turn tilts (n, T, 2) [rad] into roll and pitch, in place: the inverse of `tilt_of`."""
    for n in range(tilt.shape[0]):
        for t in range(tilt.shape[1]):
            cosine, sine = heading[n, t, 0], heading[n, t, 1]
            first = cosine * tilt[n, t, 0] + sine * tilt[n, t, 1]
            second = cosine * tilt[n, t, 1] - sine * tilt[n, t, 0]
            angle = math.sqrt(first * first + second * second)
            factor = math.sin(angle) / angle if angle > 0.0 else 1.0
            x, y, z = -second * factor, first * factor, math.cos(angle)  # the world's up in body axes
            tilt[n, t, 0] = math.atan2(y, z)
            tilt[n, t, 1] = math.atan2(-x, math.sqrt(y * y + z * z))
