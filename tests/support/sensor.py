"""An ideal IMU that turns about one place: what it reads, and recordings of it."""

from dataclasses import replace

import numpy as np

from quadsim.logs import read_log
from quadsim.logs.recording import Recording
from quadsim.logs.resample import resample
from quadsim.rotation import (
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
)

GRAVITY = np.array([0.0, 0.0, 9.81])
RATE = 200.0


def body_rate(roll, pitch, d_roll, d_pitch, d_yaw):
    """Body rate of intrinsic z-y'-x'' angles and their rates of change."""
    return np.stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.cos(pitch) * np.sin(roll),
            -d_pitch * np.sin(roll) + d_yaw * np.cos(pitch) * np.cos(roll),
        ],
        axis=-1,
    )


def readings(time, roll, pitch, yaw):
    """Body rate, specific force and attitude of a body with these Euler angles over time."""
    angles = [each + np.zeros(time.size) for each in (roll, pitch, yaw)]
    gyro = body_rate(*angles[:2], *(np.gradient(each, time, edge_order=2) for each in angles))
    quat = quat_from_euler(*angles)
    return gyro, quat_rotate_inverse(quat, GRAVITY), quat


def turning(rate_hz=RATE, seconds=4.0):
    """A sensor that rolls, pitches and yaws by different amounts: time, gyro, accel, quat."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    return time, *readings(
        time, 0.3 + 0.2 * np.sin(2 * time), -0.1 + 0.3 * np.sin(3 * time), 0.5 + 0.4 * time
    )


def turned(seconds=20.0, **changed) -> Recording:
    """A recording of that sensor with a truth, and what is changed of it."""
    time, gyro, accel, quat = turning(seconds=seconds)
    return replace(Recording("x", "test", time, gyro, accel, "truth", time, quat), **changed)


def blind(log: Recording) -> Recording:
    return replace(log, truth="none", truth_time=None, quat=None)


def write_csv(folder, log: Recording, head="") -> str:
    """Write a CSV of a recording and its column map, which begins as given; the path of that."""
    rows = np.column_stack([log.time, log.gyro, log.accel, log.quat])
    np.savetxt(folder / "x.csv", rows, "%.12g", delimiter=",", header="t,p,q,r,x,y,z,a,b,c,d", comments="")
    (folder / "x.toml").write_text(f"""file = "x.csv"
{head}
time = {{column = "t"}}
gyro = {{columns = ["p", "q", "r"]}}
accel = {{columns = ["x", "y", "z"]}}
quat = {{columns = ["a", "b", "c", "d"]}}
""")
    return str(folder / "x.toml")


def report_of(log: Recording):
    return resample(log)[1]


def reported(path, **choices):
    """The dataset of a log, and what reading it found."""
    log = read_log(path, **choices)
    return log, log.attrs["log"]


def consistent(log) -> None:
    """The gyro turns the attitude, and the attitude turns the specific force upright: all frames are ours."""
    gyro, accel, quat = (log[name].to_numpy()[0] for name in ("gyro", "accel", "quat"))
    np.testing.assert_allclose(quat_rotate(quat, accel), np.broadcast_to(GRAVITY, accel.shape), atol=2e-3)
    up = quat_rotate_inverse(quat, GRAVITY / 9.81)
    turn = np.gradient(up, 1 / log.attrs["rate_hz"], axis=0)
    np.testing.assert_allclose(turn[2:-2], np.cross(up, gyro)[2:-2], atol=5e-3)


def noisy(bias, noise=0.025, seconds=60.0, seed=0):
    """A sensor that turns gently at 200 Hz, with a bias [rad/s] and a truth with white noise [rad]."""
    time, rng = np.arange(round(seconds * 200)) / 200.0, np.random.default_rng(seed)
    gyro, accel, quat = readings(time, 0.2 * np.sin(2 * time), 0.2 * np.sin(3 * time), 0.3 * time)
    gyro = gyro + rng.normal(0.0, 0.003, gyro.shape) + bias
    accel = accel + rng.normal(0.0, 0.05, gyro.shape)
    seen = quat_multiply(quat, quat_from_rotvec(rng.normal(0.0, noise, gyro.shape)))
    return resample(Recording("noisy", "x", time, gyro, accel, "mocap", time, seen))[0]
