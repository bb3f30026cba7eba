"""Flights of a rigid body that drag slows, in axes of its own, and the encoder's filter led along them."""

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.alignment import EFFECT, FRAME, KEPT, LEAN, SPREAD, follow
from quadsim.vehicle import GRAVITY

STEP, DRAG, BIAS_SPREAD, ACCEL_SPREAD = 0.005, 0.25, 0.05, 0.2


def found(
    gyro, accel, heading=None, noise=0.01, drag=DRAG, accel_spread=ACCEL_SPREAD, told_tilt=None, align_s=0.0
):
    """What is kept (T, KEPT) after each of the readings (T, 3) twice, and the turns that are told (T, 2)."""
    kept, out, told = np.zeros(KEPT), np.empty((len(gyro), KEPT)), np.empty((len(gyro), 2))
    if told_tilt is not None:
        kept[0], kept[LEAN : LEAN + 2] = np.inf, (told_tilt[1], -told_tilt[0])
    alignment = align_s, drag, noise, BIAS_SPREAD, accel_spread
    heading = np.zeros(len(gyro)) if heading is None else heading
    for t, (rates, forces, angle) in enumerate(zip(gyro, accel, heading, strict=True)):
        told[t] = follow(rates, forces, np.cos(angle), np.sin(angle), STEP, alignment, kept)
        kept[0] += STEP
        out[t] = kept
    return out, told


def tilt_of(kept):
    """Sine of the tilt about x and y."""
    return np.stack([-kept[..., LEAN + 1], kept[..., LEAN]], -1)


def variances(kept):
    """Of force, lean, both biases and speed, of each axis."""
    return kept[..., SPREAD:EFFECT:12]


def leaning(tilt):
    """Rotation from body to level axes: the shortest, to a body whose tilt has this sine (2,)."""
    sine = np.linalg.norm(tilt)
    axis = np.array([*tilt, 0.0]) / max(sine, 1e-12)
    return Rotation.from_rotvec(np.arcsin(min(sine, 1.0)) * axis)


def flight(
    steps,
    seed=0,
    start=(0.0, 0.0),
    bias=(0.0, 0.0),
    wind=(0.0, 0.0),
    yaw=0.0,
    gust=0.0,
    accel_bias=(0.0, 0.0),
    climb=0.0,
    roll=0.3,
):
    """A rigid body whose tilt wanders, that drag slows: readings (T, 3) twice, heading (T,), sine (T, 2)."""
    rng = np.random.default_rng(seed)
    hz, phase = rng.uniform(0.2, 1.0, (2, 2, 3)), rng.uniform(0, 2 * np.pi, (2, 3))
    time = STEP * np.arange(steps)
    turning = roll * np.cos(2 * np.pi * hz[0] * time[:, None, None] + phase).sum(-1)
    turning[0] = 0.0
    heading = yaw * time
    lateral = np.exp(-1j * heading) * (turning[:, 0] + 1j * turning[:, 1])
    rates = np.stack([lateral.real, lateral.imag, np.full(steps, yaw)], -1)
    turns = Rotation.from_rotvec(STEP * (rates[1:] + rates[:-1]) / 2)
    attitude, velocity = leaning(np.asarray(start)), np.zeros(3)
    air = np.array([*wind, 0.0]) + gust / DRAG * np.sqrt(STEP) * np.cumsum(
        rng.standard_normal((steps, 3)) * (1, 1, 0), 0
    )
    rises = climb * np.cos(0.9 * time)
    tilt, accel = np.empty((steps, 2)), np.empty((steps, 3))
    for t in range(steps):
        if t > 0:
            attitude = attitude * turns[t - 1]
        axes = attitude.as_matrix()
        flow = axes.T @ (velocity - air[t])
        thrust = GRAVITY
        for _ in range(5):  # drag takes part in what carries the vehicle, and goes with thrust
            slowed = DRAG * np.sqrt(thrust / GRAVITY) + FRAME * np.linalg.norm(flow)
            thrust = (GRAVITY + rises[t] + slowed * axes[2, :2] @ flow[:2]) / axes[2, 2]
        accel[t] = [*(-slowed * flow[:2]), thrust]
        velocity = velocity + STEP * (axes @ accel[t] - [0, 0, GRAVITY])
        tilt[t] = -axes[1, 2], axes[0, 2]
    rates[:, :2] += bias
    accel[:, :2] += accel_bias
    return rates, accel, heading, tilt
