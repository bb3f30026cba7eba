"""The filter of x-io Technologies' Fusion (Madgwick's revised AHRS), from the package `imufusion`."""

import numpy as np
from imufusion import Ahrs

from quadsim.rotation import roll_pitch_from_quat

G = 9.80665


class Fusion:
    """Fusion's AHRS without magnetometer, with the default settings of the package."""

    parameter_count = 1  # the gain

    def __init__(self, rate_hz):
        self.rate_hz = rate_hz

    def reset(self, n=1, roll_pitch=None):
        """Start n vehicles."""
        self.filters = [Ahrs() for _ in range(n)]
        for each in self.filters:
            each.set_sample_period(1.0 / self.rate_hz)
        self.last = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, G], (n, 1))

    def update(self, gyro, accel):
        """Roll and pitch (n, 2) [rad]; the last good number stands in for a missing one."""
        readings = np.hstack([gyro, accel])
        self.last = np.where(np.isfinite(readings), readings, self.last)
        for each, row in zip(self.filters, self.last, strict=True):
            each.update_no_magnetometer(np.degrees(row[:3]), row[3:] / G)
        return roll_pitch_from_quat(np.array([each.get_quaternion() for each in self.filters], float))
