"""Augmentation: new sensor errors and the symmetries of a quadrotor for each batch of streams.

White noise has the simulator's equation. The others differ from it, since streams have no rotor speeds:
vibration is two tones at random frequencies, the low-pass a first-order recursion, the mounting a small
random rotation.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from quadsim.config.ranges import Between, Delay, Force, Frequency, Rising, Share
from quadsim.config.toml import Strict
from quadsim.imu.kernel import white_noise_sd
from quadsim.runs.compiled import njit

Array = NDArray[np.floating]

VIBRATION_HZ = (60.0, 250.0)
"""Range of the frequency of a rotor, which the sampling folds."""
BURST = 60.0
"""Largest of a gyroscope's false rates [rad/s]."""
RANGES = (1.0, 35.0), (12.0, 160.0)
"""Least and largest range of a gyroscope [rad/s] and of an accelerometer [m/s²] that saturate."""
WANDER_HZ = 3.0
"""Standard deviation of that frequency within a stream."""

RateError = Annotated[float, Between(0.0, 10.0, "rad/s")]
ForceError = Annotated[float, Between(0.0, 50.0, "m/s²")]
Mounting = Annotated[float, Between(0.0, 45.0, "°")]


class Augmentation(Strict):
    """Errors that are added to the true signals, one draw for each stream; defaults: RotorS' ADIS16448."""

    gyro_noise: RateError = 3.394e-4
    """Noise density of the gyroscope [rad/s/√Hz]."""
    accel_noise: ForceError = 0.004
    """Noise density of the accelerometer [m/s²/√Hz]."""
    gyro_bias: RateError = 0.0
    """Standard deviation of the gyroscope's constant bias [rad/s]."""
    accel_bias: ForceError = 0.196
    """Standard deviation of the accelerometer's turn-on bias [m/s²]."""
    yaw_symmetry: bool = False
    """Turn the body axes about z by any angle and mirror half of the streams: neither changes the physics."""

    # For uncalibrated sensors. Each *_max bounds a draw: a size for the stream, uniform in its square root
    # (of a gyro bias: uniform), then each axis uniform within ± that size: small errors are frequent.
    gyro_bias_max: RateError = 0.0
    """Further bias of the gyroscope [rad/s]."""
    accel_bias_max: ForceError = 0.0
    """Further bias of the accelerometer [m/s²]."""
    scale_max: Annotated[float, Between(0.0, 0.9)] = 0.0
    """Relative error of scale of each axis of both sensors."""
    mounting_max_deg: Mounting = 0.0
    """Largest angle about each axis of a small rotation of the IMU against the body [deg]."""
    noise_factor_max: Annotated[float, Between(1.0, 1000.0)] = 1.0
    """Largest factor of the white noise of a stream, log-uniform from 1."""
    vibration: Annotated[tuple[Force, Force], Rising] = (0.0, 0.0)
    """Amplitude of the rotors' vibration in the accelerometer, least and largest [m/s²]."""
    vibration_share: Share = 0.0
    """Share of the streams that vibrate."""
    low_pass_hz: Annotated[tuple[Frequency, Frequency], Rising] | None = None
    """Corner of a first-order low-pass over both sensors, least and largest [Hz]."""
    delay_max_s: Delay = 0.0
    """Largest delay of the readings, in whole samples [s]."""
    lever_arm_max: Annotated[float, Between(0.0, 1.0, "m")] = 0.0
    """Largest distance of the IMU from the point of the true force along each axis, in half of the streams
    [m]."""
    drop_share: Share = 0.0
    """Share of the streams that lose samples."""
    drop_max: Share = 0.0
    """Largest share of a stream's samples that it loses, each by itself."""
    gap_max_s: Annotated[float, Between(0.0, 10.0, "s")] = 0.0
    """Longest time without samples in such a stream, once [s]."""
    burst_share: Share = 0.0
    """Share of the streams with one to ten false rates in a row, of up to `BURST` about one axis."""
    saturated_share: Share = 0.0
    """Share of the streams whose sensors end at ranges that are drawn log-uniform from `RANGES`."""


def augment(
    ang_vel: Array,
    specific_force: Array,
    up: Array,
    augmentation: Augmentation,
    rate_hz: float,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """Measurements of another IMU on another flight.

    Args:
        ang_vel: True body rate, shape (n, T, 3) [rad/s].
        specific_force: True specific force, shape (n, T, 3) [m/s²].
        up: World's up in body axes, shape (n, T, 3).
        augmentation: What to add.
        rate_hz: Samples per second.
        rng: Source of all draws.

    Returns:
        Gyroscope and accelerometer readings, NaN where a sample was lost, and `up` in the new body axes, in
        the type of the input.
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
    if augmentation.lever_arm_max > 0:
        specific_force = specific_force + _lever_arm(ang_vel, augmentation.lever_arm_max, rate_hz, rng)
    both = np.stack([ang_vel, specific_force])  # (2, n, T, 3)
    if augmentation.mounting_max_deg > 0:
        mounting = _small_rotations(_within(np.radians(augmentation.mounting_max_deg), n, rng)).astype(dtype)
        both = _rotate(mounting, both)
    if augmentation.vibration_share > 0:
        both = both + _vibration(n, both.shape[2], augmentation, rate_hz, rng).astype(dtype)
    if augmentation.low_pass_hz is not None or augmentation.delay_max_s > 0:
        both = _filter_and_delay(both, augmentation, rate_hz, rng)
    measured = []
    for signal, bias, largest, power, density in (
        (both[0], augmentation.gyro_bias, augmentation.gyro_bias_max, 1, augmentation.gyro_noise),
        (both[1], augmentation.accel_bias, augmentation.accel_bias_max, 2, augmentation.accel_noise),
    ):
        offset = rng.normal(0, bias, (n, 1, 3)).astype(dtype)
        if largest > 0:
            offset += _within(largest, n, rng, power)[:, None].astype(dtype)
        if augmentation.scale_max > 0:
            signal = signal * (1 + _within(augmentation.scale_max, n, rng))[:, None].astype(dtype)
        noise = rng.standard_normal(signal.shape, dtype=np.float32).astype(dtype, copy=False)
        if augmentation.noise_factor_max > 1:
            noise *= np.exp(rng.uniform(0, np.log(augmentation.noise_factor_max), (n, 1, 1))).astype(dtype)
        measured.append(signal + offset + noise * dtype.type(white_noise_sd(density, 1 / rate_hz)))
    if augmentation.saturated_share > 0:
        saturated = rng.random((n, 1, 1)) < augmentation.saturated_share
        for readings, ends in zip(measured, RANGES, strict=True):
            least, most = np.log(ends)
            end = np.exp(rng.uniform(least, most, (n, 1, 1)))
            np.clip(readings, -end, end, out=readings, where=saturated)
    if augmentation.burst_share > 0:
        for row in np.flatnonzero(rng.random(n) < augmentation.burst_share):
            first, axis = rng.integers(up.shape[1]), rng.integers(3)
            measured[0][row, first : first + rng.integers(1, 11), axis] = rng.uniform(-BURST, BURST)
    if augmentation.drop_share > 0:
        share = augmentation.drop_max * rng.random((n, 1)) * (rng.random((n, 1)) < augmentation.drop_share)
        lost = rng.random(up.shape[:2]) < share
        if augmentation.gap_max_s > 0:
            first, length = rng.random((2, n, 1))
            since = np.arange(up.shape[1]) - first * up.shape[1]
            lost |= (share > 0) & (since >= 0) & (since < length * augmentation.gap_max_s * rate_hz)
        for readings in measured:
            readings[lost] = np.nan
    return measured[0], measured[1], up


def _within(largest: float, n: int, rng: np.random.Generator, power: int = 2) -> Array:
    """Errors of three axes, (n, 3), of a size that is drawn for each stream."""
    return largest * rng.uniform(0, 1, (n, 1)) ** power * rng.uniform(-1, 1, (n, 3))


def _lever_arm(ang_vel: Array, largest: float, rate_hz: float, rng: np.random.Generator) -> Array:
    """Accelerations of an IMU off the point of the true force in half of the streams, ω̇ × r + ω × (ω × r)."""
    n = len(ang_vel)
    arm = rng.uniform(-largest, largest, (n, 1, 3)) * (rng.random((n, 1, 1)) < 0.5)
    arm = arm.astype(ang_vel.dtype)
    change = np.diff(ang_vel, axis=1, prepend=ang_vel[:, :1]) * ang_vel.dtype.type(rate_hz)
    return np.cross(change, arm) + np.cross(ang_vel, np.cross(ang_vel, arm))


def _vibration(
    n: int, steps: int, augmentation: Augmentation, rate_hz: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Tones of two rotors, folded by the sampling, (2, n, T, 3); the gyroscope has a hundredth of them."""
    size = rng.uniform(*augmentation.vibration, (n, 1)) * (rng.random((n, 1)) < augmentation.vibration_share)
    tones = np.zeros((2, n, steps, 3), np.float32)
    for _ in range(2):
        wander = rng.standard_normal((n, -(-steps // 20)), dtype=np.float32).cumsum(axis=1)
        wander = np.repeat(wander / np.sqrt(np.float32(wander.shape[1])), 20, axis=1)[:, :steps]
        frequency = rng.uniform(*VIBRATION_HZ, (n, 1)).astype(np.float32) + np.float32(WANDER_HZ) * wander
        phase = (np.cumsum(frequency / np.float32(rate_hz), axis=1) % 1.0) * np.float32(2 * np.pi)
        sine, cosine = np.sin(phase)[..., None], np.cos(phase)[..., None]
        for sensor, scale in enumerate((0.01, 1.0)):
            a, b = (rng.uniform(-1, 1, (2, n, 1, 3)) * (scale * size)[None, ..., None] / 2).astype(np.float32)
            tones[sensor] += a * sine + b * cosine
    return tones


def _filter_and_delay(
    both: Array, augmentation: Augmentation, rate_hz: float, rng: np.random.Generator
) -> Array:
    """Low-pass and delay both sensors, (2, n, T, 3); the first samples repeat."""
    _, n, steps, _ = both.shape
    if augmentation.low_pass_hz is not None:
        low, high = np.log(augmentation.low_pass_hz)
        corner = np.exp(rng.uniform(low, high, n))
        for signal in both:
            _low_pass(signal, -np.expm1(-2 * np.pi * corner / rate_hz))
    delay = rng.integers(0, round(augmentation.delay_max_s * rate_hz) + 1, n)
    return both[:, np.arange(n)[:, None], np.maximum(np.arange(steps) - delay[:, None], 0)]


@njit(cache=True)
def _low_pass(signal, step):
    """First-order low-pass in place over (n, T, k), of the share `step` (n,) of each new sample."""
    for i in range(signal.shape[0]):
        for t in range(1, signal.shape[1]):
            for k in range(signal.shape[2]):
                signal[i, t, k] = signal[i, t - 1, k] + step[i] * (signal[i, t, k] - signal[i, t - 1, k])


def _rotate(matrices: Array, vectors: Array) -> Array:
    return vectors @ matrices.transpose(0, 2, 1)


def _turns(n: int, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi, n)
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(n), np.ones(n)
    return np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(n, 3, 3)


def _small_rotations(angles: Array) -> Array:
    """First-order rotations, made orthonormal."""
    (x, y, z), one = angles.T, np.ones(len(angles))
    u, _, vt = np.linalg.svd(np.stack([one, -z, y, z, one, -x, -y, x, one], -1).reshape(-1, 3, 3))
    return u @ vt
