"""An estimator of a user's, which says level."""

import numpy as np


class Level:
    """Keeps the number of vehicles and the attitude that it was reset to."""

    def __init__(self, rate_hz=200.0):
        self.rate_hz = rate_hz

    def reset(self, n=1, roll_pitch=None):
        self.n, self.start = n, roll_pitch

    def update(self, gyro, accel):
        return np.zeros((self.n, 2))
