"""One model of `imm`: a Kalman filter of attitude, motion and sensor errors for one kind of carrier.

State: attitude R, velocity v (world axes), gyroscope bias b, accelerometer bias c across body z, and of a
multirotor the horizontal wind w, the direction of thrust o, as a tilt from body z, and the height l of the
IMU over the centre of mass:

    Ṙ = R [ω − b]×,    v̇ = R (a − c) + g,    ẇ, ḃ, ċ, ȯ, l̇ random walks,
    a_xy = −D (Rᵀ (v − w))_xy + c + g o + l (α_y, −α_x) + noise,    D = k √(a_z / g) + f |v − w|

The drag measurement, of multirotors alone, and the right-invariant error are those of `ekf_drag`; α is the
angular acceleration. The second measurement says that the velocity is zero within the model's standard
deviation, and a third, at rest, that the gyroscope reads its bias. The climb v_z is no error state; it is
integrated and forgotten within `climb_time`.

Error state: θ_x, θ_y, δv, δb (3), δc (9), and of a multirotor δw, δo, δl (14).

A gyroscope's bias may step. The corrections of θ that a filter expects have together the variance by which
they reduce that of θ. Where they sum up to more, within T = `step_time`, the bias has stepped some time ago
(after Willsky & Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in
linear systems", IEEE Trans. Autom. Control 21(1), 1976), and P is that of a filter which does not know the
step:

    P ← P + `step_sigma`² G Gᵀ,    G = (−T R, ½ T² g × R, I) of θ, v and b
"""

import math

import numpy as np

from quadsim.rotation import from_rotvec_core, matrix_core, multiply_core, rotate_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from .ekf_drag import GAP_SPEED, INNOVATION_MAX, adapt_vibration, gust_noise, mean_square
from .eskf import turned
from .inline_math import exp_core

MODELS = ("multirotor", "free", "hand")
MULTIROTOR, FREE, HAND = range(len(MODELS))
COUNT = len(MODELS)

ERRORS = 14
TILT, VELOCITY, GYRO_BIAS, ACCEL_BIAS, WIND, OFFSET, LEVER = 0, 2, 4, 7, 9, 11, 13
"""Where the parts of the error state begin: horizontal axes, three of the gyroscope's bias, one lever arm."""
SHARED = WIND
"""Errors that all models have; the others are of multirotors alone."""

MODEL = np.dtype(
    [
        ("quat", "f8", 4),
        ("velocity", "f8", 3),
        ("wind", "f8", 2),
        ("gyro_bias", "f8", 3),
        ("accel_bias", "f8", 2),
        ("offset", "f8", 2),  # of the direction of thrust from body z [rad]
        ("lever", "f8"),  # height of the IMU over the centre of mass [m]
        ("covariance", "f8", (ERRORS, ERRORS)),
        ("tilt", "f8", 2),  # from the combined attitude, world axes [rad]
        ("accel_square", "f8"),  # mean square of the horizontal acceleration, per axis [m²/s⁴]
        ("time", "f8"),  # since the start [s]
        ("innovation", "f8", 2),  # of the drag measurement at the last update, world axes [m/s²]
        ("innovation_mean", "f8", 2),  # low-passed [m/s²]
        ("vibration", "f8"),  # variance of the white part of it [m²/s⁴]
        ("wind_noise", "f8"),  # process noise of the wind [m²/s³]
        ("airspeed_sum", "f8", 2),  # recent corrections of v - w [m/s]
        ("airspeed_square", "f8"),  # sum of their squares, both axes [m²/s²]
        ("tilt_sum", "f8", 2),  # recent corrections of the tilt, world axes [rad]
        ("tilt_due", "f8"),  # variance that they removed, both axes [rad²]
    ]
)
"""State of one model."""

WIND_NOISE_MOST = 10.0
"""Largest noise density of the wind [m/s/√s]: it turns by as much as a hurricane's gusts."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t."""


@njit
def size_of(k):
    """Errors in the state of model k."""
    return ERRORS if k == MULTIROTOR else SHARED


@njit
def transition(P, size, matrix, v, w, dt):
    """P ← F P of `size` errors, with θ̇ = −R̂ δb, δv̇ = −θ × g − R̂ δc − v̂ × R̂ δb, δẇ = −ŵ × R̂ δb."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix
    vx, vy, vz, wx, wy = v[0], v[1], v[2], w[0], w[1]
    for j in range(size):
        x, y = P[TILT, j], P[TILT + 1, j]
        b0, b1, b2 = P[GYRO_BIAS, j], P[GYRO_BIAS + 1, j], P[GYRO_BIAS + 2, j]
        c0, c1 = P[ACCEL_BIAS, j], P[ACCEL_BIAS + 1, j]
        bx = r00 * b0 + r01 * b1 + r02 * b2  # R̂ δb
        by = r10 * b0 + r11 * b1 + r12 * b2
        bz = r20 * b0 + r21 * b1 + r22 * b2
        P[TILT, j] = x - dt * bx
        P[TILT + 1, j] = y - dt * by
        P[VELOCITY, j] += dt * (GRAVITY * y - r00 * c0 - r01 * c1 - (vy * bz - vz * by))
        P[VELOCITY + 1, j] += dt * (-GRAVITY * x - r10 * c0 - r11 * c1 - (vz * bx - vx * bz))
        if size > SHARED:
            P[WIND, j] -= dt * wy * bz
            P[WIND + 1, j] += dt * wx * bz


@njit
def propagate(P, size, T, matrix, v, w, dt, walks):
    """P ← F P Fᵀ + Q = F (F P)ᵀ + Q for a symmetric P; T is scratch."""
    transition(P, size, matrix, v, w, dt)
    for i in range(size):
        for j in range(size):
            T[i, j] = P[j, i]
    transition(T, size, matrix, v, w, dt)
    for i in range(size):
        for j in range(size):
            P[i, j] = T[i, j]
        P[i, i] += walks[i]


@njit
def correct(P, size, dx, column, total, residual):
    """One scalar measurement with row h: adds to the error dx, reduces P.

    Args:
        P: Covariance.
        size: Errors in the state.
        dx: Error estimated so far.
        column: P hᵀ.
        total: h P hᵀ and the measurement's variance.
        residual: Measured less expected, less h dx.
    """
    for a in range(size):
        gain = column[a] / total
        dx[a] += gain * residual
        for b in range(size):
            P[a, b] -= gain * column[b]


@njit
def correct_by_drag(m, force, arm, drag, variance, matrix, work):
    """Correct by the specific force across thrust, one axis after the other.

    Args:
        m: The model's record.
        force: Mean specific force in body axes (3,) [m/s²].
        arm: What one metre of lever arm adds to it (2,) [1/s²].
        drag: D [1/s].
        variance: Of the measurement, each axis [m²/s⁴].
        matrix: R̂ by rows.
        work: Of `room`; adds to the error dx, writes the innovation in body axes before the correction
            (2,) [m/s²].
    """
    _, dx, column, _, innovation = work
    P, v, w = m.covariance, m.velocity, m.wind
    for k in range(2):
        x, y, z = -drag * matrix[k], -drag * matrix[3 + k], -drag * matrix[6 + k]
        bias, offset, thrust = ACCEL_BIAS + k, OFFSET + k, GRAVITY
        expected = x * (v[0] - w[0]) + y * (v[1] - w[1]) + z * v[2] + m.accel_bias[k] + thrust * m.offset[k]
        expected += arm[k] * m.lever
        innovation[k] = min(max(force[k] - expected, -INNOVATION_MAX), INNOVATION_MAX)
        known = x * (dx[VELOCITY] - dx[WIND]) + y * (dx[VELOCITY + 1] - dx[WIND + 1])
        known += dx[bias] + thrust * dx[offset] + arm[k] * dx[LEVER]
        for a in range(ERRORS):
            column[a] = x * (P[VELOCITY, a] - P[WIND, a]) + y * (P[VELOCITY + 1, a] - P[WIND + 1, a])
            column[a] += P[bias, a] + thrust * P[offset, a] + arm[k] * P[LEVER, a]
        total = x * (column[VELOCITY] - column[WIND]) + y * (column[VELOCITY + 1] - column[WIND + 1])
        total += column[bias] + thrust * column[offset] + arm[k] * column[LEVER] + variance
        correct(P, ERRORS, dx, column, total, innovation[k] - known)


@njit
def correct_by_zero_velocity(P, size, dx, column, v, variance):
    """Correct by the measurement v = 0, one horizontal axis after the other; column is scratch."""
    for k in range(2):
        x, y = (0.0, v[2]) if k == 0 else (-v[2], 0.0)  # of θ × v̂
        for a in range(size):
            column[a] = x * P[TILT, a] + y * P[TILT + 1, a] + P[VELOCITY + k, a]
        total = x * column[TILT] + y * column[TILT + 1] + column[VELOCITY + k] + variance
        known = x * dx[TILT] + y * dx[TILT + 1] + dx[VELOCITY + k]
        correct(P, size, dx, column, total, -v[k] - known)


@njit
def correct_by_zero_rate(P, size, dx, column, rate, bias, variance):
    """Correct by the gyroscope of a vehicle at rest, which reads its bias; column is scratch."""
    for k in range(3):
        for a in range(size):
            column[a] = P[GYRO_BIAS + k, a]
        residual = rate[k] - bias[k] - dx[GYRO_BIAS + k]
        correct(P, size, dx, column, column[GYRO_BIAS + k] + variance, residual)


@njit
def adapt_wind(m, p, dt, moved):
    """Raise the wind's noise while corrections of the airspeed (2,) follow each other, and else lower it.

    The square of their sum over a short memory is the sum of their squares where they are white, as those of
    a filter whose noise is right, and more where the wind turns faster than its noise says.
    """
    leak = min(dt / p.wind_window, 0.5)
    square = 0.0
    for k in range(2):
        m.airspeed_sum[k] += moved[k] - leak * m.airspeed_sum[k]
        square += m.airspeed_sum[k] ** 2
    m.airspeed_square += moved[0] ** 2 + moved[1] ** 2 - leak * (2.0 - leak) * m.airspeed_square
    if m.airspeed_square > 0.0:
        growth = (square / m.airspeed_square / p.wind_share - 1.0) * dt / p.wind_memory
        noise = m.wind_noise * math.exp(min(growth, 1.0))
        m.wind_noise = min(max(noise, p.wind_noise_least**2), WIND_NOISE_MOST**2)


@njit
def student(square, determinant):
    """Logarithm of the density of two variables, Student's t, less a constant; see `correct_by_drag`."""
    return -0.5 * (FREEDOM + 2.0) * math.log(1.0 + square / FREEDOM) - 0.5 * math.log(determinant)


@njit
def velocity_density(m, sigma):
    """Logarithm of the density of the horizontal velocity, of standard deviation sigma [m/s]."""
    P, vx, vy = m.covariance, m.velocity[0], m.velocity[1]
    xx, yy = sigma * sigma + P[VELOCITY, VELOCITY], sigma * sigma + P[VELOCITY + 1, VELOCITY + 1]
    xy = P[VELOCITY, VELOCITY + 1]
    determinant = xx * yy - xy * xy
    return student((yy * vx * vx - 2.0 * xy * vx * vy + xx * vy * vy) / determinant, determinant)


@njit
def across_thrust(m, force, arm):
    """Force (3,) across the direction of thrust, less the accelerometer's bias and the lever arm's [m/s²]."""
    x = force[0] - m.accel_bias[0] - GRAVITY * m.offset[0] - arm[0] * m.lever
    return x, force[1] - m.accel_bias[1] - GRAVITY * m.offset[1] - arm[1] * m.lever


@njit
def force_density(x, y, mean_square, least):
    """Logarithm of the density of a force across an axis, of that mean square for each of x and y [m/s²]."""
    variance = mean_square + least * least
    return student((x * x + y * y) / variance, variance * variance)


@njit
def predict(m, k, s, p, vector, accel, known, work):
    """Propagate one model over the interval; R̂ by rows.

    Args:
        m: The model's record.
        k: Which one it is.
        s: The filter's record.
        p: Its parameters.
        vector: Rotation vector that the gyroscope measured [rad].
        accel: Mean specific force, axes at the end of the interval (3,) [m/s²].
        known: Whether there is one.
        work: Of `room`.
    """
    T, _, _, walks, _ = work
    m.time = s.time
    dt, v, b, c = s.interval, m.velocity, m.gyro_bias, m.accel_bias
    turn = from_rotvec_core(vector[0] - b[0] * dt, vector[1] - b[1] * dt, vector[2] - b[2] * dt)
    qw, qx, qy, qz = m.quat
    qw, qx, qy, qz = multiply_core(qw, qx, qy, qz, turn[0], turn[1], turn[2], turn[3])
    m.quat[0], m.quat[1], m.quat[2], m.quat[3] = qw, qx, qy, qz
    matrix = matrix_core(qw, qx, qy, qz)
    rate_square = (vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2) / dt
    walks[TILT:VELOCITY] = p.gyro_noise**2 * dt + p.turn_noise**2 * rate_square + s.unseen
    walks[VELOCITY:GYRO_BIAS] = p.accel_noise**2 * dt + GAP_SPEED**2 * s.unseen
    walks[GYRO_BIAS:ACCEL_BIAS] = p.bias_noise**2 * dt
    walks[ACCEL_BIAS:WIND] = p.accel_bias_noise**2 * dt
    noise = max(m.vibration, p.drag_noise**2 / dt)
    walks[WIND:OFFSET] = max(m.wind_noise, gust_noise(m, p, noise, dt, p.drag)) * dt
    walks[OFFSET:LEVER] = p.offset_noise**2 * dt
    walks[LEVER] = p.lever_noise**2 * dt
    propagate(m.covariance, size_of(k), T, matrix, v, m.wind, dt, walks)
    if known:
        fx, fy, fz = rotate_core(qw, qx, qy, qz, accel[0] - c[0], accel[1] - c[1], accel[2])
        v[0], v[1] = v[0] + fx * dt, v[1] + fy * dt
        v[2] += (fz - GRAVITY - v[2] / p.climb_time) * dt
        square = 0.5 * (fx * fx + fy * fy)
        m.accel_square = mean_square(m.accel_square, square, dt, s.time, p.square_memory)
    return matrix


@njit
def correct_model(m, k, s, p, resting, rate, accel, body, thrust, arm, matrix, work):
    """Correct model k by its measurements; logarithm of their likelihood, of one measurement.

    Args:
        m: The model's record.
        k: Which one it is.
        s: The filter's record.
        p: Its parameters.
        resting: Whether the sensors are at rest.
        rate: Mean rate (3,) [rad/s].
        accel: Mean specific force, axes at the end of the interval (3,) [m/s²].
        body: Its mean in body axes, which turn (3,) [m/s²].
        thrust: Thrust per mass [m/s²].
        arm: What one metre of lever arm adds to that (2,) [1/s²].
        matrix: R̂ by rows.
        work: Of `room`.
    """
    _, dx, column, _, innovation = work
    P, v, w, dt, size = m.covariance, m.velocity, m.wind, s.interval, size_of(k)
    dx[:] = 0.0
    speed = p.hand_speed if k == HAND else p.flight_speed
    density = velocity_density(m, speed) * dt / p.speed_time
    weight = min(dt / p.evidence_time, 1.0)
    before = P[TILT, TILT] + P[TILT + 1, TILT + 1]
    if k == MULTIROTOR:
        airspeed = math.sqrt((v[0] - w[0]) ** 2 + (v[1] - w[1]) ** 2 + v[2] ** 2)
        drag = p.drag * math.sqrt(max(thrust, 0.0) / GRAVITY) + p.frame_drag * airspeed
        variance = max(m.vibration, p.drag_noise**2 / dt) + p.model_noise**2 * 2.0 * m.accel_square / dt
        correct_by_drag(m, body, arm, drag, variance, matrix, work)
        qw, qx, qy, qz = m.quat
        x, y, _ = rotate_core(qw, qx, qy, qz, innovation[0], innovation[1], 0.0)
        adapt_vibration(m, p, dt, x, y)
        if m.time > p.wind_window:  # the first corrections are those of the initial state
            adapt_wind(m, p, dt, (dx[VELOCITY] - dx[WIND], dx[VELOCITY + 1] - dx[WIND + 1]))
        x, y = across_thrust(m, body, arm)
        density += weight * force_density(x, y, s.body_square, p.least_accel)
    else:
        x = matrix[0] * accel[0] + matrix[1] * accel[1] + matrix[2] * accel[2]
        y = matrix[3] * accel[0] + matrix[4] * accel[1] + matrix[5] * accel[2]
        density += weight * force_density(x, y, m.accel_square, p.least_accel)
    speed = p.rest_speed if resting else speed
    correct_by_zero_velocity(P, size, dx, column, v, speed * speed * p.speed_time / dt)
    if resting:
        correct_by_zero_rate(P, size, dx, column, rate, m.gyro_bias, p.rest_noise**2 / dt)
    adapt_bias(m, p, dt, dx, before - P[TILT, TILT] - P[TILT + 1, TILT + 1], matrix)
    apply_error(m, k, dx)
    return density


@njit
def adapt_bias(m, p, dt, dx, removed, matrix):
    """Take a correction of the tilt, and the variance that it removed; know less of the bias if it steps.

    Args:
        m: The model's record.
        p: The filter's parameters.
        dt: Interval [s].
        dx: The error that was estimated.
        removed: From the variance of the tilt, both axes [rad²].
        matrix: R̂ by rows.
    """
    leak, scatter, P = dt / p.step_time, 0.0, m.covariance
    for k in range(2):
        m.tilt_sum[k] += dx[TILT + k] - leak * m.tilt_sum[k]
        scatter += m.tilt_sum[k] ** 2
    m.tilt_due += max(removed, 0.0) - 2.0 * leak * m.tilt_due
    if m.time > p.step_time and scatter > p.step_ratio * m.tilt_due:
        m.tilt_sum[:], m.tilt_due = 0.0, 0.0
        fallen = 0.5 * GRAVITY * p.step_time
        for k in range(3):
            x, y = -p.step_time * matrix[k], -p.step_time * matrix[3 + k]
            wrong = (x, y, fallen * y, -fallen * x)
            for i in range(4):
                for j in range(4):
                    P[i, j] += p.step_sigma**2 * wrong[i] * wrong[j]
                P[i, GYRO_BIAS + k] += p.step_sigma**2 * wrong[i]
                P[GYRO_BIAS + k, i] += p.step_sigma**2 * wrong[i]
            P[GYRO_BIAS + k, GYRO_BIAS + k] += p.step_sigma**2


@njit
def apply_error(m, k, dx):
    """Correct the state of model k by the error that was estimated."""
    qw, qx, qy, qz = m.quat
    m.quat[0], m.quat[1], m.quat[2], m.quat[3] = turned(qw, qx, qy, qz, dx[TILT], dx[TILT + 1])
    rw, rx, ry, rz = exp_core(dx[TILT], dx[TILT + 1], 0.0)
    v, w, b, c = m.velocity, m.wind, m.gyro_bias, m.accel_bias
    v[0], v[1], v[2] = rotate_core(rw, rx, ry, rz, v[0], v[1], v[2])
    for i in range(3):
        b[i] += dx[GYRO_BIAS + i]
    for i in range(2):
        v[i] += dx[VELOCITY + i]
        c[i] += dx[ACCEL_BIAS + i]
    if k == MULTIROTOR:
        w[0], w[1], _ = rotate_core(rw, rx, ry, rz, w[0], w[1], 0.0)
        for i in range(2):
            w[i] += dx[WIND + i]
            m.offset[i] += dx[OFFSET + i]
        m.lever += dx[LEVER]
