"""Source of a user's own estimator: a complementary filter with a declared gain."""

MINE = """
import numpy as np
from estimators import Parameter

class Mine:
    parameters = {"gain": Parameter(0.02, 0.001, 0.5)}

    def __init__(self, rate_hz, gain=0.02):
        self.rate_hz, self.gain = rate_hz, gain

    def reset(self, n=1, roll_pitch=None):
        self.angle = np.zeros((n, 2)) if roll_pitch is None else np.array(roll_pitch, float)

    def update(self, gyro, accel):
        x, y, z = accel.T
        tilt = np.column_stack([np.arctan2(y, z), np.arctan2(-x, z)])
        self.angle = (1 - self.gain) * (self.angle + gyro[:, :2] / self.rate_hz) + self.gain * tilt
        return self.spoiled(self.angle)

    def spoiled(self, angle):
        return angle

    class Inner:
        pass
"""
