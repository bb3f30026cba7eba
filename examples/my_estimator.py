"""A template for your own attitude estimator: a complementary filter with one parameter.

    quadsim bench --scenario hover --estimator examples/my_estimator.py:MyEstimator --estimator eskf
    quadsim tune --estimator examples/my_estimator.py:MyEstimator --data data/train.zarr --out mine.toml

`estimators.check_estimator("examples/my_estimator.py:MyEstimator")` checks the estimator.
"""

import numpy as np

from estimators import Parameter


class MyEstimator:
    """A complementary filter, which follows the gyroscope for short times and gravity for long ones.

    Args:
        rate_hz: Samples per second.
        time_constant: Time constant of the correction by gravity [s].
    """

    parameters = {"time_constant": Parameter(default=2.0, low=0.1, high=20.0)}  # noqa: RUF012
    """Parameters that `quadsim tune` searches, by keyword; omit this if there is nothing to tune."""

    def __init__(self, rate_hz, time_constant=2.0):
        self.rate_hz = rate_hz
        self.weight = 1.0 / (1.0 + time_constant * rate_hz)

    def reset(self, n=1, roll_pitch=None):
        """Start n vehicles, at roll_pitch (n, 2) [rad] if the initial attitude is known."""
        self.angles = np.zeros((n, 2)) if roll_pitch is None else np.array(roll_pitch, float)

    def update(self, gyro, accel):
        """Return roll and pitch (n, 2) [rad] from gyro [rad/s] and accel [m/s²], (n, 3) each.

        A missing sample is NaN.
        """
        gyro = np.nan_to_num(gyro)
        roll, pitch = self.angles.T
        roll_rate = gyro[:, 0] + np.tan(pitch) * (np.sin(roll) * gyro[:, 1] + np.cos(roll) * gyro[:, 2])
        pitch_rate = np.cos(roll) * gyro[:, 1] - np.sin(roll) * gyro[:, 2]
        self.angles = self.angles + np.column_stack([roll_rate, pitch_rate]) / self.rate_hz
        x, y, z = accel.T
        tilt = np.column_stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))])
        here = np.isfinite(tilt).all(axis=1)
        self.angles[here] += self.weight * (tilt[here] - self.angles[here])
        return self.angles.copy()
