"""A template for your own attitude controller: PD on roll and pitch, and a slow integral.

    quadsim bench --controller examples/my_controller.py:make --controller cascaded --scenario step

The position and velocity loops of the cascade compute the set-point; the allocation converts the command to
rotor speeds.
"""

import numpy as np


class MyController:
    """An attitude controller with the gains of a critically damped second-order system.

    Args:
        rate_hz: Samples per second.
        bandwidth: Bandwidth of roll and pitch [rad/s].
    """

    def __init__(self, rate_hz: float, bandwidth: float = 12.0) -> None:
        self.dt, self.bandwidth = 1.0 / rate_hz, bandwidth
        self.reset(1)

    def reset(self, n: int) -> None:
        """Start n vehicles."""
        self.trim = np.zeros((n, 2))

    def update(self, set_point, gyro, accel, roll_pitch):
        """Return angular acceleration [rad/s²] and thrust per mass [m/s²], (n, 4).

        See `AttitudeController`.
        """
        error = set_point[:, :2] - roll_pitch
        self.trim = np.clip(self.trim + 10.0 * self.dt * error, -5.0, 5.0)
        action = np.empty((len(gyro), 4))
        action[:, :2] = self.bandwidth**2 * error - 2.0 * self.bandwidth * gyro[:, :2] + self.trim
        action[:, 2] = 5.0 * (set_point[:, 2] - gyro[:, 2])
        action[:, 3] = set_point[:, 3]
        return action


def make(rate_hz, vehicle):
    """Make the controller for a vehicle; called once per mission."""
    return MyController(rate_hz)
