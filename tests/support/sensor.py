"""An ideal IMU that turns about one place: what it reads, and recordings of it."""

import numpy as np

from quadsim.logs.recording import Recording
from quadsim.logs.resample import resample
from quadsim.rotation import quat_from_euler, quat_rotate_inverse

GRAVITY = np.array([0.0, 0.0, 9.81])
RATE = 200.0


def readings(time, roll, pitch, yaw):
    """Body rate, specific force and attitude of a body with these Euler angles over time."""
    roll, pitch, yaw = (each + np.zeros(time.size) for each in (roll, pitch, yaw))
    d_roll, d_pitch, d_yaw = (np.gradient(each, time, edge_order=2) for each in (roll, pitch, yaw))
    gyro = np.stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.cos(pitch) * np.sin(roll),
            -d_pitch * np.sin(roll) + d_yaw * np.cos(pitch) * np.cos(roll),
        ],
        axis=1,
    )
    quat = quat_from_euler(roll, pitch, yaw)
    return gyro, quat_rotate_inverse(quat, GRAVITY), quat


def turning(rate_hz=RATE, seconds=4.0):
    """A sensor that rolls, pitches and yaws by different amounts: time, gyro, accel, quat."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    return time, *readings(
        time, 0.3 + 0.2 * np.sin(2 * time), -0.1 + 0.3 * np.sin(3 * time), 0.5 + 0.4 * time
    )


def report_of(log: Recording):
    """What is found in a recording."""
    return resample(log)[1]
