"""The arithmetic of the IMU: a record of coefficients and state per vehicle, and a compiled pass over it."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from ..runs.compiled import njit

Array = NDArray[np.float64]

GYRO, ACCEL = 0, 1
ROTORS = 4
NOISES = 5
"""Streams of random numbers: gyro noise, accel noise, gyro walk, accel walk, dropped samples."""

VEHICLE = np.dtype(
    [
        # the same for all flights of a vehicle
        ("dt", "f8"),
        ("lever_arm_on", "i8"),
        ("lever_arm", "f8", 3),
        ("low_pass_on", "i8", 2),
        ("transition", "f8", (2, 2, 2)),
        ("from_last", "f8", (2, 2)),
        ("from_new", "f8", (2, 2)),
        ("vibration_on", "i8"),
        ("amplitude", "f8", (2, 3)),  # over the square of the rotor speed
        ("corner", "f8", 2),  # of the low-pass [rad/s]
        ("order", "i8", 2),
        ("white", "f8", 2),
        ("decay", "f8", 2),
        ("diffusion", "f8", 2),
        ("resolution", "f8", 2),
        ("limit", "f8", 2),
        ("drop_below", "f8"),
        # drawn once for each flight
        ("matrix", "f8", (2, 3, 3)),  # body axes to sensor axes, scale factor and misalignment
        ("force_matrix", "f8", (3, 3)),  # specific force in body axes to gyro error
        ("turn_on", "f8", (2, 3)),
        ("phase_offset", "f8", (ROTORS, 2, 3)),
        # changes with every sample
        ("started", "i8"),
        ("walk", "f8", (2, 3)),
        ("filter", "f8", (2, 3, 2)),
        ("last_input", "f8", (2, 3)),
        ("phase", "f8", ROTORS),
        ("last_output", "f8", (2, 3)),
    ],
    align=True,
)


def white_noise_sd(density: float, dt: float) -> float:
    """Standard deviation of a sample of white noise, N/√dt, with N in unit/√Hz and dt in s."""
    return density / math.sqrt(dt)


def low_pass_coefficients(corner: float, order: int, dt: float) -> tuple[Array, Array, Array]:
    """Exact step of a continuous Butterworth filter whose input is a straight line between samples.

    The state is z = (y, ẏ/ω_c) for order 2 and (y, 0) for order 1, and a step from input u₀ to u₁ is
    z ← transition z + from_last u₀ + from_new u₁ (triangle hold: Franklin, Powell, Workman 1998, 6.3.2).
    Its delay at low frequency is 1/ω_c for order 1 and √2/ω_c for order 2, at any sample rate.

    Args:
        corner: Angular frequency of the −3 dB point ω_c [rad/s].
        order: 1 or 2.
        dt: Sample time [s].
    """
    A = np.array([[0.0, 1.0], [-1.0, -math.sqrt(2.0)]]) if order == 2 else np.diag([-1.0, -1.0])
    B = np.array([0.0, 1.0]) if order == 2 else np.array([1.0, 0.0])
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2], block[2, 3] = A * corner * dt, B * corner * dt, 1.0
    step = np.asarray(expm(block), dtype=np.float64)
    return step[:2, :2], step[:2, 2] - step[:2, 3], step[:2, 3]


@njit(cache=True)
def _move_to_lever_arm(p, x, ang_acc):
    """Specific force at r from that at the centre of mass: f + α × r + ω × (ω × r), all in body axes."""
    wx, wy, wz = x[0, 0], x[0, 1], x[0, 2]
    rx, ry, rz = p.lever_arm[0], p.lever_arm[1], p.lever_arm[2]
    vx, vy, vz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    ax, ay, az = ang_acc[0], ang_acc[1], ang_acc[2]
    x[1, 0] += ay * rz - az * ry + wy * vz - wz * vy
    x[1, 1] += az * rx - ax * rz + wz * vx - wx * vz
    x[1, 2] += ax * ry - ay * rx + wx * vy - wy * vx


@njit(cache=True)
def _low_pass(p, sensor, x):
    """Replace the input x (3,) by the filter's output; at the first sample the filter has settled on it."""
    phi, g0, g1 = p.transition[sensor], p.from_last[sensor], p.from_new[sensor]
    for axis in range(3):
        z, new, last = p.filter[sensor, axis], x[axis], p.last_input[sensor, axis]
        if p.started:
            z0 = phi[0, 0] * z[0] + phi[0, 1] * z[1] + g0[0] * last + g1[0] * new
            z[1] = phi[1, 0] * z[0] + phi[1, 1] * z[1] + g0[1] * last + g1[1] * new
            z[0] = z0
        else:
            z[0], z[1] = new, 0.0
        p.last_input[sensor, axis] = new
        x[axis] = z[0]


@njit(cache=True)
def _vibrate(p, x, rotor_vel):
    """Add what each rotor's imbalance shakes, amplitude ∝ ω², behind the low-pass, at this instant."""
    for rotor in range(ROTORS):
        speed = rotor_vel[rotor]
        phase = p.phase[rotor] + speed * p.dt
        p.phase[rotor] = phase - 2.0 * math.pi * math.floor(phase / (2.0 * math.pi))
        for sensor in range(2):
            ratio = (speed / p.corner[sensor]) ** 2
            gain = speed * speed / math.sqrt(1.0 + (ratio * ratio if p.order[sensor] == 2 else ratio))
            for axis in range(3):
                wave = math.sin(p.phase[rotor] + p.phase_offset[rotor, sensor, axis])
                x[sensor, axis] += p.amplitude[sensor, axis] * gain * wave


@njit(cache=True)
def _quantise(value, resolution, limit):
    """Nearest multiple of the resolution (0: as it is) within ± limit; NaN stays NaN."""
    if resolution > 0.0:
        value = resolution * np.rint(value / resolution)
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value


@njit(cache=True, inline="always")
def measure(vehicles, noise, first, start, count, ang_vel, specific_force, ang_acc, rotor_vel, out, bias):
    """Samples start … start + count of n vehicles.

    Args:
        vehicles: Records of dtype VEHICLE, shape (n,); their state moves on.
        noise: Standard normal numbers, shape (n, NOISES, block, 3).
        first: Place in the block of the first sample.
        start: First sample.
        count: Number of samples.
        ang_vel: Body rate, shape (n, T, 3) [rad/s].
        specific_force: At the centre of mass, body axes, shape (n, T, 3) [m/s²].
        ang_acc: Angular acceleration, shape (n, T, 3) [rad/s²]; used only with a lever arm.
        rotor_vel: Rotor speeds, shape (n, T, 4) [rad/s]; used only with vibration.
        out: Readings of gyro and accel, shape (2, n, T, 3) [rad/s, m/s²].
        bias: Their true biases, same shape.
    """
    x = np.empty((2, 3))
    for vehicle in range(vehicles.shape[0]):
        p = vehicles[vehicle]
        for t in range(start, start + count):
            k = first + t - start
            for axis in range(3):
                x[0, axis] = ang_vel[vehicle, t, axis]
                x[1, axis] = specific_force[vehicle, t, axis]
            if p.lever_arm_on:
                _move_to_lever_arm(p, x, ang_acc[vehicle, t])
            for sensor in range(2):
                if p.low_pass_on[sensor]:
                    _low_pass(p, sensor, x[sensor])
            if p.vibration_on:
                _vibrate(p, x, rotor_vel[vehicle, t])
            dropped = p.started and noise[vehicle, 4, k, 0] < p.drop_below
            for sensor in range(2):
                for axis in range(3):
                    M = p.matrix[sensor, axis]
                    value = M[0] * x[sensor, 0] + M[1] * x[sensor, 1] + M[2] * x[sensor, 2]
                    if sensor == 0:
                        G = p.force_matrix[axis]
                        value += G[0] * x[1, 0] + G[1] * x[1, 1] + G[2] * x[1, 2]
                    walk = p.walk[sensor, axis]
                    bias[sensor, vehicle, t, axis] = p.turn_on[sensor, axis] + walk
                    value += (
                        bias[sensor, vehicle, t, axis] + p.white[sensor] * noise[vehicle, sensor, k, axis]
                    )
                    p.walk[sensor, axis] = (
                        p.decay[sensor] * walk + p.diffusion[sensor] * noise[vehicle, 2 + sensor, k, axis]
                    )
                    if not dropped:
                        p.last_output[sensor, axis] = _quantise(value, p.resolution[sensor], p.limit[sensor])
                    out[sensor, vehicle, t, axis] = p.last_output[sensor, axis]
            p.started = 1
