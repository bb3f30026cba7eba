"""Compiled equations of the IMU: one record of coefficients and state per vehicle, one function per error."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.special import ndtri

from ..rotation import matrix_from_quat, quat_from_euler
from ..runs.compiled import njit
from ..vehicle import MAX_ROTORS
from .spec import ImuSpec

Array = NDArray[np.float64]

GYRO, ACCEL = range(2)
SENSORS = 2
"""Number of sensors; their order is that of `ImuSpec.sensors`."""
WHITE, WALK, DROP, NOISES = (0, 1), (2, 3), 4, 5
"""Streams of random numbers, for noise and bias walk of each sensor and for dropped samples, and their
number."""

IMU = np.dtype(
    [
        # the same for all flights of a vehicle
        ("dt", "f8"),
        ("lever_arm_on", "i8"),
        ("lever_arm", "f8", 3),
        ("low_pass_on", "i8", SENSORS),
        ("transition", "f8", (SENSORS, 2, 2)),
        ("from_last", "f8", (SENSORS, 2)),
        ("from_new", "f8", (SENSORS, 2)),
        ("vibration_on", "i8"),
        ("amplitude", "f8", (SENSORS, 3)),  # over the square of the rotor speed
        ("corner", "f8", SENSORS),  # of the low-pass [rad/s]
        ("white", "f8", SENSORS),
        ("decay", "f8", SENSORS),
        ("diffusion", "f8", SENSORS),
        ("resolution", "f8", SENSORS),
        ("limit", "f8", SENSORS),
        ("drop_below", "f8"),
        # drawn once for each flight
        ("matrix", "f8", (SENSORS, 3, 3)),  # body axes to sensor axes, scale factor and misalignment
        ("force_matrix", "f8", (3, 3)),  # specific force in body axes to gyro error
        ("turn_on", "f8", (SENSORS, 3)),
        ("phase_offset", "f8", (MAX_ROTORS, SENSORS, 3)),
        # changes with every sample
        ("started", "i8"),
        ("walk", "f8", (SENSORS, 3)),
        ("filter", "f8", (SENSORS, 3, 2)),
        ("last_input", "f8", (SENSORS, 3)),
        ("phase", "f8", MAX_ROTORS),
        ("bias", "f8", (SENSORS, 3)),  # in the reading, turn-on and walk
        ("reading", "f8", (SENSORS, 3)),
    ],
    align=True,
)


@cache
def motion_dtype(rotors: int) -> np.dtype:
    """Return the record type of the motion that an IMU measures.

    Records with more fields are also accepted.
    """
    return np.dtype(
        [
            ("ang_vel", "f8", 3),  # body rate, body axes [rad/s]
            ("specific_force", "f8", 3),  # at the centre of mass, body axes [m/s²]
            ("ang_acc", "f8", 3),  # [rad/s²]; used only with a lever arm
            ("rotor_vel", "f8", rotors),  # [rad/s]; used only with vibration
        ]
    )


def white_noise_sd(density: float, dt: float) -> float:
    """Return the standard deviation of a sample of white noise, N/√dt, with N in unit/√Hz and dt in s."""
    return density / math.sqrt(dt)


@cache
def low_pass_coefficients(corner: float, dt: float) -> tuple[Array, Array, Array]:
    """Compute the exact step of a second-order Butterworth filter whose input is linear between samples.

    The state is z = (y, ẏ/ω_c), and a step from input u₀ to u₁ is
    z ← transition z + from_last u₀ + from_new u₁ (triangle hold: Franklin, Powell, Workman 1998, 6.3.2).
    The delay of the filter at low frequency is √2/ω_c, at any sample rate.

    Args:
        corner: Angular frequency of the −3 dB point ω_c [rad/s].
        dt: Sample time [s].
    """
    A, B = np.array([[0.0, 1.0], [-1.0, -math.sqrt(2.0)]]), np.array([0.0, 1.0])
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2], block[2, 3] = A * corner * dt, B * corner * dt, 1.0
    step = np.asarray(expm(block), dtype=np.float64)
    return step[:2, :2], step[:2, 2] - step[:2, 3], step[:2, 3]


def constants(spec: ImuSpec, dt: float) -> NDArray[np.void]:
    """Return a record of an IMU with the coefficients that do not vary between flights, shape (1,)."""
    records = np.zeros(1, IMU)
    p = records[0]
    p["dt"] = dt
    p["lever_arm"], p["lever_arm_on"] = spec.lever_arm, any(spec.lever_arm)
    p["drop_below"] = ndtri(spec.dropped)
    if spec.vibration is not None:
        p["vibration_on"] = 1
        p["amplitude"] = np.array([spec.vibration.gyro, spec.vibration.accel]) / spec.vibration.rotor_vel**2
    for index, sensor in enumerate(spec.sensors.values()):
        corner, tau = 2.0 * math.pi * sensor.low_pass_hz, sensor.time_constant
        p["low_pass_on"][index], p["corner"][index] = corner > 0.0, corner or np.inf
        step = low_pass_coefficients(corner, dt)
        p["transition"][index], p["from_last"][index], p["from_new"][index] = step
        p["white"][index] = white_noise_sd(sensor.noise, dt)
        p["decay"][index] = math.exp(-dt / (tau or math.inf))
        p["diffusion"][index] = sensor.walk_sd * math.sqrt(-math.expm1(-2.0 * dt / (tau or math.inf)))
        p["resolution"][index], p["limit"][index] = sensor.resolution, sensor.limit
    return records


def draw_flight(p: np.void, spec: ImuSpec, random: np.random.Generator) -> None:
    """Draw the constant errors of a flight into its record.

    New draws must come last, because the order of the draws determines the numbers.
    """
    turn_on, walk, scale = random.standard_normal((3, 2, 3))
    misalignment, g_sensitivity = random.standard_normal((2, 3, 3)), random.standard_normal((3, 3))
    sensor_from_body = matrix_from_quat(quat_from_euler(*np.radians(spec.mounting_deg))).T
    p["phase_offset"] = random.uniform(0.0, 2.0 * np.pi, (MAX_ROTORS, 2, 3))
    p["force_matrix"] = spec.g_sensitivity * g_sensitivity @ sensor_from_body
    for index, sensor in enumerate(spec.sensors.values()):
        p["turn_on"][index] = sensor.turn_on * turn_on[index]
        p["walk"][index] = sensor.walk_sd * walk[index]
        error = sensor.misalignment * misalignment[index]
        np.fill_diagonal(error, 1.0 + sensor.scale_factor * scale[index])
        p["matrix"][index] = error @ sensor_from_body
    p["bias"], p["started"] = p["turn_on"] + p["walk"], 0


def noise_streams(spec: ImuSpec) -> list[int]:
    """Return the streams of random numbers that an IMU uses."""
    sizes = (spec.gyro.noise, spec.accel.noise, spec.gyro.random_walk, spec.accel.random_walk, spec.dropped)
    return [index for index, size in enumerate(sizes) if size > 0.0]


@njit(cache=True)
def _feel(s, x):
    """Return the readings without errors, in body axes at the centre of mass."""
    for axis in range(3):
        x[GYRO, axis], x[ACCEL, axis] = s.ang_vel[axis], s.specific_force[axis]


@njit(cache=True)
def _move_to_lever_arm(p, x, ang_acc):
    """Return the specific force at position r, f + α × r + ω × (ω × r), in body axes."""
    wx, wy, wz = x[GYRO, 0], x[GYRO, 1], x[GYRO, 2]
    rx, ry, rz = p.lever_arm[0], p.lever_arm[1], p.lever_arm[2]
    vx, vy, vz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    ax, ay, az = ang_acc[0], ang_acc[1], ang_acc[2]
    x[ACCEL, 0] += ay * rz - az * ry + wy * vz - wz * vy
    x[ACCEL, 1] += az * rx - ax * rz + wz * vx - wx * vz
    x[ACCEL, 2] += ax * ry - ay * rx + wx * vy - wy * vx


@njit(cache=True)
def _low_pass(p, x):
    """Replace x by the output of the low-pass filters, which start in steady state."""
    for sensor in range(SENSORS):
        if not p.low_pass_on[sensor]:
            continue
        phi, g0, g1 = p.transition[sensor], p.from_last[sensor], p.from_new[sensor]
        for axis in range(3):
            z, new, last = p.filter[sensor, axis], x[sensor, axis], p.last_input[sensor, axis]
            if p.started:
                z0 = phi[0, 0] * z[0] + phi[0, 1] * z[1] + g0[0] * last + g1[0] * new
                z[1] = phi[1, 0] * z[0] + phi[1, 1] * z[1] + g0[1] * last + g1[1] * new
                z[0] = z0
            else:
                z[0], z[1] = new, 0.0
            p.last_input[sensor, axis] = new
            x[sensor, axis] = z[0]


@njit(cache=True)
def _vibrate(p, x, rotor_vel):
    """Add the vibration of each rotor's imbalance, with an amplitude ∝ ω², after the low-pass."""
    for rotor in range(rotor_vel.shape[0]):
        speed = rotor_vel[rotor]
        phase = p.phase[rotor] + speed * p.dt
        p.phase[rotor] = phase - 2.0 * math.pi * math.floor(phase / (2.0 * math.pi))
        for sensor in range(SENSORS):
            ratio = (speed / p.corner[sensor]) ** 2
            gain = speed * speed / math.sqrt(1.0 + ratio * ratio)
            for axis in range(3):
                wave = math.sin(p.phase[rotor] + p.phase_offset[rotor, sensor, axis])
                x[sensor, axis] += p.amplitude[sensor, axis] * gain * wave


@njit(cache=True)
def _turn_to_sensor_axes(p, x):
    """Apply mounting, scale factor, misalignment, and the gyroscope's sensitivity to specific force."""
    fx, fy, fz = x[ACCEL, 0], x[ACCEL, 1], x[ACCEL, 2]
    for sensor in range(SENSORS):
        a, b, c = x[sensor, 0], x[sensor, 1], x[sensor, 2]
        for axis in range(3):
            M = p.matrix[sensor, axis]
            x[sensor, axis] = M[0] * a + M[1] * b + M[2] * c
    for axis in range(3):
        G = p.force_matrix[axis]
        x[GYRO, axis] += G[0] * fx + G[1] * fy + G[2] * fz


@njit(cache=True)
def _add_bias_and_noise(p, x, noise):
    """Add turn-on bias, bias random walk and white noise, and advance the random walk."""
    for sensor in range(SENSORS):
        for axis in range(3):
            walk = p.walk[sensor, axis]
            p.bias[sensor, axis] = p.turn_on[sensor, axis] + walk
            x[sensor, axis] += p.bias[sensor, axis] + p.white[sensor] * noise[WHITE[sensor], axis]
            p.walk[sensor, axis] = p.decay[sensor] * walk + p.diffusion[sensor] * noise[WALK[sensor], axis]


@njit(cache=True)
def _read_out(p, x, noise):
    """Write the reading, rounded to the resolution (0: not rounded) and clipped to ± limit; NaN remains NaN.

    A dropped sample repeats the previous reading.
    """
    if p.started and noise[DROP, 0] < p.drop_below:
        return
    for sensor in range(SENSORS):
        resolution, limit = p.resolution[sensor], p.limit[sensor]
        for axis in range(3):
            value = x[sensor, axis]
            if resolution > 0.0:
                value = resolution * np.rint(value / resolution)
            if value > limit:
                value = limit
            elif value < -limit:
                value = -limit
            p.reading[sensor, axis] = value


@njit(cache=True)
def measure(p, noise, s, x):
    """Take one sample of one IMU; write `reading` and `bias` of its record.

    Args:
        p: Record of dtype IMU; its state is updated.
        noise: Standard normal numbers for this sample, shape (NOISES, 3).
        s: True motion, a record with the fields of `motion_dtype`.
        x: (SENSORS, 3) memory.
    """
    _feel(s, x)
    if p.lever_arm_on:
        _move_to_lever_arm(p, x, s.ang_acc)
    _low_pass(p, x)
    if p.vibration_on:
        _vibrate(p, x, s.rotor_vel)
    _turn_to_sensor_axes(p, x)
    _add_bias_and_noise(p, x, noise)
    _read_out(p, x, noise)
    p.started = 1


@njit(cache=True)
def measure_series(imus, noise, place, samples, motion, out, bias):
    """Take samples of n IMUs.

    Args:
        imus: Records of dtype IMU, shape (n,); their state is updated.
        noise: Standard normal numbers, shape (n, NOISES, block, 3).
        place: Index of the first sample in the block.
        samples: Range of samples: the first, and the one after the last.
        motion: (n, T) records with the fields of `motion_dtype`.
        out: Readings of the sensors, shape (SENSORS, n, T, 3).
        bias: True biases of the sensors, same shape.
    """
    x = np.empty((SENSORS, 3))
    first, end = samples
    for i in range(imus.shape[0]):
        p = imus[i]
        for t in range(first, end):
            measure(p, noise[i, :, place + t - first], motion[i, t], x)
            for sensor in range(SENSORS):
                for j in range(3):
                    out[sensor, i, t, j], bias[sensor, i, t, j] = p.reading[sensor, j], p.bias[sensor, j]
