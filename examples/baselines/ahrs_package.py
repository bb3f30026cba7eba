"""Madgwick's filter (2011) of the package `ahrs`, with the package's default gain."""

import numpy as np
from ahrs.filters import Madgwick

from quadsim.rotation import quat_from_roll_pitch, roll_pitch_from_quat


class AhrsMadgwick:
    """Madgwick's filter of the package ahrs, which starts at level."""

    parameter_count = 1  # beta

    def __init__(self, rate_hz):
        self.rate_hz, self.filter = rate_hz, Madgwick(frequency=rate_hz)

    def reset(self, n=1, roll_pitch=None):
        """Start n vehicles."""
        self.quat = quat_from_roll_pitch(np.zeros((n, 2)) if roll_pitch is None else np.asarray(roll_pitch))
        self.last = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 9.81], (n, 1))

    def update(self, gyro, accel):
        """Roll and pitch (n, 2) [rad]; the last good number stands in for a missing one."""
        readings = np.hstack([gyro, accel])
        self.last = np.where(np.isfinite(readings), readings, self.last)
        rate, force = self.last[:, :3] + 1e-12, self.last[:, 3:]  # the package ignores a rate of exactly zero
        self.quat = np.array([*map(self.filter.updateIMU, self.quat, rate, force)])
        return roll_pitch_from_quat(self.quat)
