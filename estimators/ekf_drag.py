"""Error-state Kalman filter that knows why a flying quadrotor's accelerometer reads what it reads.

Without drag the accelerometer of a flying quadrotor reads thrust along body z at any tilt. What is left
across it is rotor and frame drag, so it measures velocity through the air, not tilt (Martin & Salaün, "The
true role of accelerometer feedback in quadrotor control", ICRA 2010; Leishman et al., "Quadrotors and
accelerometers", IEEE Control Systems 34(1), 2014). Tilt then follows from how that velocity changes.

State: attitude R, velocity through the air v (world axes), gyroscope bias b, accelerometer bias across
thrust c:

    Ṙ = R [ω − b]×,    v̇ = R (a − c) + g + gusts,    a_xy = −D (Rᵀ v)_xy + c + noise,
    D = √(a_z / g) / τ + f |v|

because rotor drag is proportional to the sum of rotor speeds, which goes with the root of thrust; τ is the
time constant of rotor drag at hover and f the frame's quadratic drag per mass. A weak prior says that the
vertical velocity is about zero; without it a bias along thrust would carry it away.

The error is right-invariant as in `eskf`: θ in world axes, v = exp([θ]×) v̂ + δv. The drag measurement then
does not depend on θ at all, its matrix is (−D R̂ᵀ) on δv, and heading drops out. Error state: θ_x, θ_y, δv,
δb, δc (10).
"""

import math

import numpy as np
from numba import njit

from quadsim.rotation import from_rotvec_core, matrix_core, multiply_core, rotate_core
from quadsim.vehicle import AIR_DENSITY, GRAVITY, Vehicle

from .ekf import SIGMA_KNOWN, SIGMA_UNKNOWN
from .eskf import turned
from .filters import Algorithm, Array, Parameter
from .sample import COMMON, record, roll_pitch_core, usable_between

QUAT, VELOCITY, BIAS, ACCEL_BIAS, COVARIANCE, SIZE = (
    COMMON,
    COMMON + 4,
    COMMON + 7,
    COMMON + 10,
    COMMON + 12,
    112,
)

VELOCITY_SIGMA = 2.0
"""Standard deviation of the initial velocity, which is taken as zero [m/s]."""
ACCEL_BIAS_WALK = 0.006
"""Random walk of the accelerometer's bias [m/s²/√s]."""


@njit(cache=True)
def propagate(P, matrix, vx, vy, vz, dt, walks):
    """P ← F P Fᵀ + Q, by rows, then by columns, for θ̇ = −R̂ δb and δv̇ = −θ × g − R̂ δc − v̂ × R̂ δb."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = matrix
    # v̂ × (columns of R̂), the effect of δb on δv
    c00, c01, c02 = vy * r20 - vz * r10, vy * r21 - vz * r11, vy * r22 - vz * r12
    c10, c11, c12 = vz * r00 - vx * r20, vz * r01 - vx * r21, vz * r02 - vx * r22
    c20, c21, c22 = vx * r10 - vy * r00, vx * r11 - vy * r01, vx * r12 - vy * r02
    for j in range(10):
        b0, b1, b2, a0, a1 = P[5, j], P[6, j], P[7, j], P[8, j], P[9, j]
        P[2, j] += dt * (GRAVITY * P[1, j] - r00 * a0 - r01 * a1 - c00 * b0 - c01 * b1 - c02 * b2)
        P[3, j] -= dt * (GRAVITY * P[0, j] + r10 * a0 + r11 * a1 + c10 * b0 + c11 * b1 + c12 * b2)
        P[4, j] -= dt * (r20 * a0 + r21 * a1 + c20 * b0 + c21 * b1 + c22 * b2)
        P[0, j] -= dt * (r00 * b0 + r01 * b1 + r02 * b2)
        P[1, j] -= dt * (r10 * b0 + r11 * b1 + r12 * b2)
    for i in range(10):
        b0, b1, b2, a0, a1 = P[i, 5], P[i, 6], P[i, 7], P[i, 8], P[i, 9]
        P[i, 2] += dt * (GRAVITY * P[i, 1] - r00 * a0 - r01 * a1 - c00 * b0 - c01 * b1 - c02 * b2)
        P[i, 3] -= dt * (GRAVITY * P[i, 0] + r10 * a0 + r11 * a1 + c10 * b0 + c11 * b1 + c12 * b2)
        P[i, 4] -= dt * (r20 * a0 + r21 * a1 + c20 * b0 + c21 * b1 + c22 * b2)
        P[i, 0] -= dt * (r00 * b0 + r01 * b1 + r02 * b2)
        P[i, 1] -= dt * (r10 * b0 + r11 * b1 + r12 * b2)
    for i in range(10):
        P[i, i] += walks[i]


@njit(cache=True)
def correct(P, dx, column, h, residual, variance):
    """One scalar measurement with row h (10,): adds to the error dx (10,), reduces P; column is scratch."""
    total = variance
    for a in range(10):
        column[a] = 0.0
        for b in range(10):
            column[a] += P[a, b] * h[b]
    for a in range(10):
        total += h[a] * column[a]
        residual -= h[a] * dx[a]
    for a in range(10):
        gain = column[a] / total
        dx[a] += gain * residual
        for b in range(10):
            P[a, b] -= gain * column[b]


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out, target, squared_error):
    """Params as in `PARAMETERS`. See `filters` for the arguments."""
    n, steps = gyro.shape[:2]
    dx, column, h, walks = np.empty(10), np.empty(10), np.empty(10), np.empty(10)
    for row in range(states.shape[0]):
        gyro_noise, gust_noise, drag_noise, climb_noise, bias_noise = params[row // n, :5]
        drag_time, frame_drag = params[row // n, 5], params[row // n, 6]
        walks[:2] = gyro_noise * gyro_noise * dt
        walks[2:5] = gust_noise * gust_noise * dt
        walks[5:8] = bias_noise * bias_noise * dt
        walks[8:] = ACCEL_BIAS_WALK * ACCEL_BIAS_WALK * dt
        s, i = states[row], row % n
        v, bias, accel_bias = s[VELOCITY : VELOCITY + 3], s[BIAS : BIAS + 3], s[ACCEL_BIAS : ACCEL_BIAS + 2]
        P = s[COVARIANCE : COVARIANCE + 100].reshape(10, 10)
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable_between(s, dt, gyro[i, t], accel[i, t])
            dw, dqx, dqy, dqz = from_rotvec_core(
                (gx - bias[0]) * dt, (gy - bias[1]) * dt, (gz - bias[2]) * dt
            )
            qw, qx, qy, qz = multiply_core(s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3], dw, dqx, dqy, dqz)
            matrix = matrix_core(qw, qx, qy, qz)
            propagate(P, matrix, v[0], v[1], v[2], dt, walks)
            dx[:] = 0.0
            if ax != 0.0 or ay != 0.0 or az != 0.0:
                fx, fy, fz = rotate_core(qw, qx, qy, qz, ax - accel_bias[0], ay - accel_bias[1], az)
                v[0] += fx * dt
                v[1] += fy * dt
                v[2] += (fz - GRAVITY) * dt
                speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
                drag = math.sqrt(max(az, 0.0) / GRAVITY) / drag_time + frame_drag * speed
                for k in range(2):
                    h[:] = 0.0
                    h[2], h[3], h[4] = -drag * matrix[k], -drag * matrix[3 + k], -drag * matrix[6 + k]
                    h[8 + k] = 1.0
                    expected = h[2] * v[0] + h[3] * v[1] + h[4] * v[2] + accel_bias[k]
                    measured = ax if k == 0 else ay
                    correct(P, dx, column, h, measured - expected, drag_noise * drag_noise / dt)
                h[:] = 0.0
                h[0], h[1], h[4] = v[1], -v[0], 1.0
                correct(P, dx, column, h, -v[2], climb_noise * climb_noise / dt)
            qw, qx, qy, qz = turned(qw, qx, qy, qz, dx[0], dx[1])
            s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = qw, qx, qy, qz
            rw, rx, ry, rz = from_rotvec_core(dx[0], dx[1], 0.0)
            vx, vy, vz = rotate_core(rw, rx, ry, rz, v[0], v[1], v[2])
            v[0], v[1], v[2] = vx + dx[2], vy + dx[3], vz + dx[4]
            for k in range(3):
                bias[k] += dx[5 + k]
            accel_bias[0] += dx[8]
            accel_bias[1] += dx[9]
            roll, pitch = roll_pitch_core(qw, qx, qy, qz)
            record(row, i, t, roll, pitch, out, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat
    covariance = own[:, 12:].reshape(-1, 10, 10)
    attitude = SIGMA_KNOWN if known else SIGMA_UNKNOWN
    for axes, sigma in (([0, 1], attitude), ([2, 3, 4], VELOCITY_SIGMA)):
        covariance[:, axes, axes] = sigma**2
    covariance[:, [5, 6, 7], [5, 6, 7]] = params[:, 7:8] ** 2
    covariance[:, [8, 9], [8, 9]] = params[:, 8:9] ** 2


PARAMETERS = {
    "gyro_noise": Parameter(5e-4, 1e-5, 0.1),
    "gust_noise": Parameter(0.3, 1e-3, 10.0),
    "drag_noise": Parameter(0.01, 1e-4, 1.0, minimum=1e-9),
    "climb_noise": Parameter(1.0, 1e-2, 100.0, minimum=1e-9),
    "bias_noise": Parameter(4e-5, 1e-6, 1e-3),
    "drag_time": Parameter(4.90, 1.0, 20.0, minimum=1e-3, searched=False),
    "frame_drag": Parameter(0.0, 1e-4, 1.0, searched=False),
    "bias_sigma": Parameter(0.0087, 1e-4, 0.1, searched=False),
    "accel_bias_sigma": Parameter(0.196, 1e-3, 1.0, searched=False),
}
"""Noise densities of the rate [rad/√s], of the wind's change [m/s/√s], of the drag measurement [m/s²·√s], of
the vertical velocity around zero [m/s·√s] and of the gyroscope bias's walk [rad/s/√s]; τ [s] and f [1/m];
standard deviations of the initial biases [rad/s], [m/s²]. The last four are known, not searched."""

EKF_DRAG = Algorithm(
    "ekf-drag", PARAMETERS, sequence, SIZE, _start,
    quat=slice(0, 4), gyro_bias=slice(7, 10), velocity=slice(4, 7),
)  # fmt: skip


def drag_of(vehicle: Vehicle) -> dict[str, float]:
    """`drag_time` and `frame_drag` of a vehicle."""
    area = 0.5 * (vehicle.frame.drag_area[0] + vehicle.frame.drag_area[1])
    return {
        "drag_time": vehicle.drag_time_constant,
        "frame_drag": 0.5 * AIR_DENSITY * area / vehicle.mass,
    }
