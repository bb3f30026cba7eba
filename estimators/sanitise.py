"""Which readings of an IMU can be used: asked of every sample before any estimator takes it.

A reading is refused, as a missing one is, where it is not finite or is beyond what any IMU of a flying robot
can measure; an accelerometer's also where it is exactly zero, which no working sensor on a vehicle under
thrust gives. A rate of exactly zero is a good measurement. Filters and networks share these functions, in
streaming and in whole sequences; `assets/c99/network.c` says the same in C.
"""

from quadsim.config.ranges import FORCE_MAX, RATE_MAX, ROTOR_SPEED_MAX
from quadsim.runs.compiled import njit

RATE_STEP = 10.0
"""Largest change of a rate from the last good sample at 200 Hz [rad/s]: a vehicle does not turn faster than
with 2000 rad/s²."""


@njit(inline="always")
def within(x, y, z, most):
    """Whether three numbers are within ± a limit; a NaN is not."""
    return abs(x) <= most and abs(y) <= most and abs(z) <= most


@njit(inline="always")
def rate_usable(x, y, z):
    """Whether a gyroscope can have measured this rate [rad/s]."""
    return within(x, y, z, RATE_MAX)


@njit(inline="always")
def force_usable(x, y, z):
    """Whether an accelerometer can have measured this specific force [m/s²]."""
    return within(x, y, z, FORCE_MAX) and (x != 0.0 or y != 0.0 or z != 0.0)


@njit(inline="always")
def speed_usable(omega):
    """Whether a rotor can have this speed [rad/s]; a NaN it cannot."""
    return abs(omega) <= ROTOR_SPEED_MAX
