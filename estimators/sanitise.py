"""Validity of IMU readings, checked for every sample before an estimator processes it.

A reading counts as missing if it is not finite or beyond the range of every IMU for flying robots. A specific
force of exactly zero also counts as missing, because a working sensor on a flying vehicle never gives it. A
rate of exactly zero is valid. All filters and networks use these functions; `assets/c99/network.c` implements
the same checks in C.
"""

from quadsim.config.ranges import FORCE_MAX, RATE_MAX, ROTOR_SPEED_MAX
from quadsim.runs.compiled import njit

RATE_STEP = 10.0
"""Largest change of a rate from the last valid sample at 200 Hz [rad/s], for an angular acceleration of 2000
rad/s²."""


@njit(inline="always")
def within(x, y, z, most):
    """Return whether three numbers are within ± a limit; false for NaN."""
    return abs(x) <= most and abs(y) <= most and abs(z) <= most


@njit(inline="always")
def rate_usable(x, y, z):
    """Return whether a gyroscope can have measured this rate [rad/s]."""
    return within(x, y, z, RATE_MAX)


@njit(inline="always")
def force_usable(x, y, z):
    """Return whether an accelerometer can have measured this specific force [m/s²]."""
    return within(x, y, z, FORCE_MAX) and (x != 0.0 or y != 0.0 or z != 0.0)


@njit(inline="always")
def speed_usable(omega):
    """Return whether a rotor can have this speed [rad/s]; false for NaN."""
    return abs(omega) <= ROTOR_SPEED_MAX
