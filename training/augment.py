"""Augmentation by the symmetries of a quadrotor and by readings of other IMUs for the same motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from quadsim.imu.stream import Imus, simulate_imu

Array = NDArray[np.floating]

ROTORS_HZ = (60.0, 250.0)
"""Range of the frequency of a rotor [Hz]."""
WANDER_HZ = 3.0
"""Standard deviation of the frequency of a rotor within a stream [Hz]."""


def turned_and_mirrored(
    ang_vel: Array, specific_force: Array, up: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Rotate the motion about body z by a random angle, and mirror half of the streams in y.

    Neither operation changes the physics of a quadrotor.

    Args:
        ang_vel: Body rate, shape (n, T, 3) [rad/s].
        specific_force: Specific force, shape (n, T, 3) [m/s²].
        up: World's z axis in body axes, shape (n, T, 3).
        rng: Random generator.
    """
    n, dtype = len(ang_vel), ang_vel.dtype
    angle = rng.uniform(0, 2 * np.pi, n)
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(n), np.ones(n)
    turn = np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(n, 3, 3).astype(dtype)
    mirror = np.where(rng.random(n) < 0.5, -1.0, 1.0).astype(dtype)[:, None, None]
    # A mirror image of y flips y of a vector, and x and z of a rate (a pseudovector).
    reflect = np.concatenate([np.ones_like(mirror), mirror, np.ones_like(mirror)], 2)
    return ang_vel @ turn * reflect * mirror, specific_force @ turn * reflect, up @ turn * reflect


def measured(
    imus: Imus, ang_vel: Array, specific_force: Array, rate_hz: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Simulate readings of other IMUs for the same motion.

    Streams have no rotor speeds, so vibration is that of two rotors with random speeds.

    Args:
        imus: The IMU, or one per stream.
        ang_vel: True body rate, shape (n, T, 3) [rad/s].
        specific_force: True specific force, shape (n, T, 3) [m/s²].
        rate_hz: Samples per second.
        rng: Random generator.

    Returns:
        Gyroscope and accelerometer readings, (n, T, 3) each, in the type of the input.
    """
    n, steps, _ = ang_vel.shape
    seed = int(rng.integers(2**63))
    ang_acc = np.gradient(ang_vel, axis=1) * rate_hz if steps > 1 else 0 * ang_vel
    rotors = _rotor_speeds(n, steps, rng)
    gyro, accel = simulate_imu(imus, ang_vel, specific_force, rate_hz, seed, ang_acc, rotors)
    return gyro.astype(ang_vel.dtype), accel.astype(ang_vel.dtype)


def _rotor_speeds(n: int, steps: int, rng: np.random.Generator) -> Array:
    """Return the slowly varying speeds of two rotors, (n, T, 2) [rad/s]."""
    wander = rng.standard_normal((n, -(-steps // 20), 2)).cumsum(axis=1)
    wander = np.repeat(wander / np.sqrt(wander.shape[1]), 20, axis=1)[:, :steps]
    return 2 * np.pi * (rng.uniform(*ROTORS_HZ, (n, 1, 2)) + WANDER_HZ * wander)
