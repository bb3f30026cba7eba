"""Error-state Kalman filter that knows why a flying quadrotor's accelerometer reads what it reads.

Without drag the accelerometer of a flying quadrotor reads thrust along body z at any tilt. What is left
across it is rotor and frame drag, so it measures velocity through the air, not tilt (Martin & Salaün, "The
true role of accelerometer feedback in quadrotor control", ICRA 2010; Leishman et al., "Quadrotors and
accelerometers", IEEE Control Systems 34(1), 2014). Tilt then follows from how that velocity changes.

State: attitude R, velocity v and horizontal wind w (world axes), gyroscope bias b, accelerometer bias c:

    Ṙ = R [ω − b]×,    v̇ = R (a − c) + g,    ẇ, ḃ, ċ random walks,
    a_xy = −D (Rᵀ (v − w))_xy + c_xy + noise,    D = √(a_z / g) / τ + f |v − w|

because rotor drag is proportional to the sum of rotor speeds, which goes with the root of thrust; τ is the
time constant of rotor drag at hover and f the frame's quadratic drag per mass. A second, weak measurement
says that the vehicle stays where it is on the whole: v = 0, each sample with a large noise.

The error is right-invariant as in `eskf`: θ in world axes, v = exp([θ]×) v̂ + δv and so for w. The drag
measurement then does not depend on θ at all, its matrix is −D R̂ᵀ on δv − δw, and heading drops out. Error
state: θ_x, θ_y, δv, δw_x, δw_y, δb, δc (13).
"""

import math

import numpy as np
from numba import njit

from quadsim.rotation import from_rotvec_core, matrix_core, multiply_core, rotate_core
from quadsim.vehicle import AIR_DENSITY, GRAVITY, Vehicle

from .ekf import SIGMA_KNOWN, SIGMA_UNKNOWN
from .eskf import turned
from .filters import Algorithm, Array, Parameter
from .sample import COMMON, roll_pitch_core, usable_between, wrap_core

ERRORS = 13
QUAT, VELOCITY, WIND, BIAS, ACCEL_BIAS = COMMON, COMMON + 4, COMMON + 7, COMMON + 9, COMMON + 12
COVARIANCE, SIZE = COMMON + 15, 15 + ERRORS * ERRORS

SPEED_SIGMA = 3.0
"""Standard deviation of the initial velocity, which is taken as zero [m/s]."""
ACCEL_NOISE = 0.01
"""Noise density of the specific force in the prediction of velocity [m/s/√s]."""
ACCEL_BIAS_WALK = 0.006
"""Random walk of the accelerometer's bias [m/s²/√s]."""


@njit
def transition(P, matrix, v, w, dt):
    """P ← F P, with θ̇ = −R̂ δb, δv̇ = −θ × g − R̂ δc − v̂ × R̂ δb and δẇ = −ŵ × R̂ δb."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix
    vx, vy, vz, wx, wy = v[0], v[1], v[2], w[0], w[1]
    for j in range(ERRORS):
        x, y = P[0, j], P[1, j]
        b0, b1, b2, c0, c1, c2 = P[7, j], P[8, j], P[9, j], P[10, j], P[11, j], P[12, j]
        # R̂ δb and R̂ δc
        bx, cx = r00 * b0 + r01 * b1 + r02 * b2, r00 * c0 + r01 * c1 + r02 * c2
        by, cy = r10 * b0 + r11 * b1 + r12 * b2, r10 * c0 + r11 * c1 + r12 * c2
        bz, cz = r20 * b0 + r21 * b1 + r22 * b2, r20 * c0 + r21 * c1 + r22 * c2
        P[0, j] = x - dt * bx
        P[1, j] = y - dt * by
        P[2, j] += dt * (GRAVITY * y - cx - (vy * bz - vz * by))
        P[3, j] += dt * (-GRAVITY * x - cy - (vz * bx - vx * bz))
        P[4, j] += dt * (-cz - (vx * by - vy * bx))
        P[5, j] -= dt * wy * bz
        P[6, j] += dt * wx * bz


@njit
def propagate(P, T, matrix, v, w, dt, walks):
    """P ← F P Fᵀ + Q = F (F P)ᵀ + Q for a symmetric P; T is scratch."""
    transition(P, matrix, v, w, dt)
    for i in range(ERRORS):
        for j in range(ERRORS):
            T[i, j] = P[j, i]
    transition(T, matrix, v, w, dt)
    for i in range(ERRORS):
        for j in range(ERRORS):
            P[i, j] = T[i, j]
        P[i, i] += walks[i]


@njit
def correct(P, dx, column, total, residual):
    """One scalar measurement with row h: adds to the error dx, reduces P.

    Args:
        P: Covariance.
        dx: Error found so far.
        column: P hᵀ.
        total: h P hᵀ and the measurement's variance.
        residual: Measured less expected, less h dx.
    """
    for a in range(ERRORS):
        gain = column[a] / total
        dx[a] += gain * residual
        for b in range(ERRORS):
            P[a, b] -= gain * column[b]


@njit
def correct_by_drag(P, dx, column, matrix, v, w, c, ax, ay, drag, variance):
    """Correct by the specific force across thrust, one axis after the other; column is scratch."""
    for k in range(2):
        x, y, z = -drag * matrix[k], -drag * matrix[3 + k], -drag * matrix[6 + k]
        expected = x * (v[0] - w[0]) + y * (v[1] - w[1]) + z * v[2] + c[k]
        found = x * (dx[2] - dx[5]) + y * (dx[3] - dx[6]) + z * dx[4] + dx[10 + k]
        for a in range(ERRORS):
            column[a] = x * (P[2, a] - P[5, a]) + y * (P[3, a] - P[6, a]) + z * P[4, a] + P[10 + k, a]
        total = x * (column[2] - column[5]) + y * (column[3] - column[6]) + z * column[4] + column[10 + k]
        measured = ax if k == 0 else ay
        correct(P, dx, column, total + variance, measured - expected - found)


@njit
def correct_by_rest(P, dx, column, v, speed_variance, climb_variance):
    """Correct by the measurement v = 0, one axis after the other; column is scratch."""
    for k in range(3):
        x, y = 0.0, 0.0  # of θ × v̂
        if k == 0:
            y = v[2]
        elif k == 1:
            x = -v[2]
        else:
            x, y = v[1], -v[0]
        for a in range(ERRORS):
            column[a] = x * P[0, a] + y * P[1, a] + P[2 + k, a]
        total = x * column[0] + y * column[1] + column[2 + k]
        found = x * dx[0] + y * dx[1] + dx[2 + k]
        correct(P, dx, column, total + (climb_variance if k == 2 else speed_variance), -v[k] - found)


@njit
def advance(s, p, dt, gx, gy, gz, ax, ay, az, T, dx, column, walks):
    """Take one sample; s is a vehicle's row, p its parameters, the last four are scratch."""
    walks[0:2] = p[0] * p[0] * dt
    walks[2:5] = ACCEL_NOISE * ACCEL_NOISE * dt
    walks[5:7] = p[1] * p[1] * dt
    walks[7:10] = p[6] * p[6] * dt
    walks[10:13] = ACCEL_BIAS_WALK * ACCEL_BIAS_WALK * dt
    v, w = s[VELOCITY : VELOCITY + 3], s[WIND : WIND + 2]
    bias, c = s[BIAS : BIAS + 3], s[ACCEL_BIAS : ACCEL_BIAS + 3]
    P = s[COVARIANCE : COVARIANCE + ERRORS * ERRORS].reshape(ERRORS, ERRORS)
    dw, dqx, dqy, dqz = from_rotvec_core((gx - bias[0]) * dt, (gy - bias[1]) * dt, (gz - bias[2]) * dt)
    qw, qx, qy, qz = multiply_core(s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3], dw, dqx, dqy, dqz)
    matrix = matrix_core(qw, qx, qy, qz)
    propagate(P, T, matrix, v, w, dt, walks)
    dx[:] = 0.0
    if ax != 0.0 or ay != 0.0 or az != 0.0:
        fx, fy, fz = rotate_core(qw, qx, qy, qz, ax - c[0], ay - c[1], az - c[2])
        v[0] += fx * dt
        v[1] += fy * dt
        v[2] += (fz - GRAVITY) * dt
        speed = math.sqrt((v[0] - w[0]) ** 2 + (v[1] - w[1]) ** 2 + v[2] ** 2)
        drag = math.sqrt(max(az, 0.0) / GRAVITY) / p[7] + p[8] * speed
        correct_by_drag(P, dx, column, matrix, v, w, c, ax, ay, drag, p[2] * p[2] / dt)
        correct_by_rest(P, dx, column, v, p[3] * p[3] / dt, p[4] * p[4] / dt)
    qw, qx, qy, qz = turned(qw, qx, qy, qz, dx[0], dx[1])
    s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = qw, qx, qy, qz
    rw, rx, ry, rz = from_rotvec_core(dx[0], dx[1], 0.0)
    vx, vy, vz = rotate_core(rw, rx, ry, rz, v[0], v[1], v[2])
    wx, wy, _ = rotate_core(rw, rx, ry, rz, w[0], w[1], 0.0)
    v[0], v[1], v[2] = vx + dx[2], vy + dx[3], vz + dx[4]
    w[0], w[1] = wx + dx[5], wy + dx[6]
    for k in range(3):
        bias[k] += dx[7 + k]
        c[k] += dx[10 + k]
    return roll_pitch_core(qw, qx, qy, qz)


@njit
def scratch():
    """Arrays for `advance`."""
    return np.empty((ERRORS, ERRORS)), np.empty(ERRORS), np.empty(ERRORS), np.empty(ERRORS)


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `filters`."""
    n, steps = gyro.shape[:2]
    T, dx, column, walks = scratch()
    for row in range(states.shape[0]):
        s, p, i = states[row], params[row // n], row % n
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable_between(s, dt, gyro, accel, i, t)
            out[row, t, 0], out[row, t, 1] = advance(s, p, dt, gx, gy, gz, ax, ay, az, T, dx, column, walks)


@njit(cache=True, nogil=True)
def score(states, params, dt, gyro, accel, target, squared_error):
    """See `filters`; one set after the other: its covariance is too large to lie side by side."""
    n, steps = gyro.shape[:2]
    T, dx, column, walks = scratch()
    for row in range(states.shape[0]):
        s, p, i = states[row], params[row // n], row % n
        total = 0.0
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable_between(s, dt, gyro, accel, i, t)
            roll, pitch = advance(s, p, dt, gx, gy, gz, ax, ay, az, T, dx, column, walks)
            error = wrap_core(roll - target[i, t, 0]) ** 2 + (pitch - target[i, t, 1]) ** 2
            total += error if math.isfinite(target[i, t, 0] + target[i, t, 1]) else 0.0
        squared_error[row // n, i] = total


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat
    covariance = own[:, 15:].reshape(-1, ERRORS, ERRORS)
    wind, bias, accel_bias = params[:, 5:6], params[:, 9:10], params[:, 10:11]
    attitude = SIGMA_KNOWN if known else SIGMA_UNKNOWN
    for first, last, sigma in (
        (0, 2, attitude), (2, 5, SPEED_SIGMA), (5, 7, wind), (7, 10, bias), (10, 13, accel_bias),
    ):  # fmt: skip
        axes = np.arange(first, last)
        covariance[:, axes, axes] = sigma**2


PARAMETERS = {
    "gyro_noise": Parameter(5e-4, 1e-5, 0.1),
    "gust_noise": Parameter(0.3, 1e-3, 10.0),
    "drag_noise": Parameter(0.01, 1e-4, 1.0, minimum=1e-9),
    "speed_noise": Parameter(3.0, 0.03, 300.0, minimum=1e-9),
    "climb_noise": Parameter(1.0, 0.01, 100.0, minimum=1e-9),
    "wind_sigma": Parameter(2.0, 0.01, 20.0),
    "bias_noise": Parameter(3.8785e-5, 1e-6, 1e-3, searched=False),
    "drag_time": Parameter(4.90, 1.0, 20.0, minimum=1e-3, searched=False),
    "frame_drag": Parameter(0.00684, 1e-4, 1.0, searched=False),
    "bias_sigma": Parameter(0.0087, 1e-4, 0.1, searched=False),
    "accel_bias_sigma": Parameter(0.196, 1e-3, 1.0, searched=False),
}
"""Noise densities of the rate [rad/√s], of the wind's walk [m/s/√s], of the drag measurement [m/s²·√s], of
the horizontal and of the vertical velocity around zero [m/s·√s]; standard deviation of the wind [m/s]; noise
density of the gyroscope bias's walk [rad/s/√s]; τ [s] and f [1/m] of the Hummingbird; standard deviations of
the initial biases [rad/s], [m/s²]. The last five are known of the vehicle and its IMU, not searched."""

EKF_DRAG = Algorithm(
    "ekf-drag",
    PARAMETERS,
    sequence,
    score,
    SIZE,
    _start,
    quat=slice(0, 4),
    gyro_bias=slice(9, 12),
    velocity=slice(4, 7),
)


def drag_of(vehicle: Vehicle) -> dict[str, float]:
    """`drag_time` and `frame_drag` of a vehicle."""
    area = 0.5 * (vehicle.frame.drag_area[0] + vehicle.frame.drag_area[1])
    return {
        "drag_time": vehicle.drag_time_constant,
        "frame_drag": 0.5 * AIR_DENSITY * area / vehicle.mass,
    }
