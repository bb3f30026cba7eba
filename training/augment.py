"""Augmentation: fresh sensor errors and the symmetries of a quadrotor, on the fly and in batch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadsim.config import Strict

Array = NDArray[np.floating]


class Augmentation(Strict):
    """Errors that are added to the true signals, one draw for each stream; defaults: RotorS' ADIS16448."""

    gyro_noise: float = 3.394e-4
    """Noise density of the gyroscope [rad/s/√Hz]."""
    accel_noise: float = 0.004
    """Noise density of the accelerometer [m/s²/√Hz]."""
    gyro_bias: float = 0.0
    """Standard deviation of the gyroscope's constant bias [rad/s]."""
    accel_bias: float = 0.196
    """Standard deviation of the accelerometer's turn-on bias [m/s²]."""
    yaw_symmetry: bool = False
    """Turn the body axes about z by any angle and mirror half of the streams: neither changes the physics."""
    mounting_deg: float = 0.0
    """Standard deviation of each angle of a small rotation of the IMU against the body [deg]."""


def augment(
    ang_vel: Array,
    specific_force: Array,
    up: Array,
    augmentation: Augmentation,
    rate_hz: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """Measurements as another IMU on another flight would have given them.

    Args:
        ang_vel: True body rate, shape (n, T, 3) [rad/s].
        specific_force: True specific force, shape (n, T, 3) [m/s²].
        up: World's up in body axes, shape (n, T, 3).
        augmentation: What to add.
        rate_hz: Samples per second.
        rng: Source of all draws.

    Returns:
        Gyroscope and accelerometer readings and `up` in the new body axes, in the type of the input.
    """
    n = len(ang_vel)
    dtype = ang_vel.dtype
    if augmentation.yaw_symmetry:
        turn = _turns(n, rng).astype(dtype)
        mirror = np.where(rng.random(n) < 0.5, -1.0, 1.0).astype(dtype)[:, None, None]
        # A mirror image of y flips y of a vector, and x and z of a rate (a pseudovector).
        reflect = np.concatenate([np.ones_like(mirror), mirror, np.ones_like(mirror)], 2)
        ang_vel = _rotate(turn, ang_vel) * reflect * mirror
        specific_force = _rotate(turn, specific_force) * reflect
        up = _rotate(turn, up) * reflect
    if augmentation.mounting_deg > 0:
        tilt = _small_rotations(rng.normal(0, np.radians(augmentation.mounting_deg), (n, 3))).astype(dtype)
        ang_vel, specific_force = _rotate(tilt, ang_vel), _rotate(tilt, specific_force)
    measured = []
    for signal, bias, density in (
        (ang_vel, augmentation.gyro_bias, augmentation.gyro_noise),
        (specific_force, augmentation.accel_bias, augmentation.accel_noise),
    ):
        offset = rng.normal(0, bias, (n, 1, 3)).astype(dtype)
        noise = rng.standard_normal(signal.shape, dtype=np.float32).astype(dtype, copy=False)
        measured.append(signal + offset + noise * dtype.type(density * np.sqrt(rate_hz)))
    return measured[0], measured[1], up


def roll_pitch_of_up(up: Array) -> Array:
    """Roll and pitch at which the world's up has these body coordinates, (..., 3) -> (..., 2)."""
    roll = np.arctan2(up[..., 1], up[..., 2])
    return np.stack([roll, np.arctan2(-up[..., 0], np.hypot(up[..., 1], up[..., 2]))], -1)


def _rotate(matrices: Array, vectors: Array) -> Array:
    return vectors @ matrices.transpose(0, 2, 1)


def _turns(n: int, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi, n)
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(n), np.ones(n)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(n, 3, 3)


def _small_rotations(angles: Array) -> Array:
    """First-order rotations, made orthonormal."""
    x, y, z = angles.T
    one = np.ones_like(x)
    first = np.stack([one, -z, y, z, one, -x, -y, x, one], -1).reshape(-1, 3, 3)
    u, _, vt = np.linalg.svd(first)
    return u @ vt
