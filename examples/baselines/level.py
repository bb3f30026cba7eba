"""The level guess: zero roll and pitch. Its error shows how far the flights are from level."""

import numpy as np


class Level:
    """An estimator that is always level, as a reference."""

    operations = 0

    def __init__(self, rate_hz):
        self.rate_hz = rate_hz

    def reset(self, n=1, roll_pitch=None):
        """Start n vehicles."""

    def update(self, gyro, accel):
        """Roll and pitch (n, 2) [rad]."""
        return np.zeros((len(gyro), 2))
