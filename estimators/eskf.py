"""Error-state Kalman filter of attitude and gyroscope bias, its error in world axes: an invariant filter.

True and estimated attitude differ by R = exp([θ]×) R̂ with θ in the world (right-invariant error: Barrau &
Bonnabel, "The invariant extended Kalman filter as a stable observer", IEEE TAC 62(4), 2017). Then

    θ̇ = −R̂ (δb + noise),   and the tilt of the specific force R̂ a from the world's vertical is θ_x, θ_y:

the measurement matrix is constant, so that a large initial error is corrected as well as a small one.
Heading and its error are not observable from an IMU and are left out: the error state is θ_x, θ_y, δb (5).

The specific force of a vehicle that accelerates is not gravity. Its variance grows with how far its
magnitude is from gravity: σ² / dt (1 + (κ (|a| / g − 1))²).
"""

import math

import numpy as np
from numba import njit

from quadsim.rotation import from_rotvec_core, matrix_core, multiply_core, normalize_core, rotate_core
from quadsim.vehicle import GRAVITY

from .ekf import SIGMA_KNOWN, SIGMA_UNKNOWN
from .filters import Algorithm, Array, Parameter
from .sample import COMMON, record, roll_pitch_core, usable_between

QUAT, BIAS, COVARIANCE, SIZE = COMMON, COMMON + 4, COMMON + 7, 32


@njit
def tilt_core(x, y, z):
    """Rotation vector x, y [rad] that takes a world vector to the z axis the short way; any length."""
    across = math.sqrt(x * x + y * y)
    scale = math.atan2(across, z) / across if across > 0.0 else 0.0
    return y * scale, -x * scale


@njit
def turned(qw, qx, qy, qz, x, y):
    """The quaternion after a small rotation (x, y, 0) [rad] about world axes."""
    rw, rx, ry, rz = from_rotvec_core(x, y, 0.0)
    w, x, y, z = multiply_core(rw, rx, ry, rz, qw, qx, qy, qz)
    return normalize_core(w, x, y, z)


@njit
def propagate(P, qw, qx, qy, qz, dt, attitude_walk, bias_walk):
    """P ← F P Fᵀ + Q for F = [[I, −R̂ dt], [0, I]], the rows and columns of θ one after the other."""
    r00, r01, r02, r10, r11, r12, _, _, _ = matrix_core(qw, qx, qy, qz)
    for j in range(5):
        P[0, j] -= dt * (r00 * P[2, j] + r01 * P[3, j] + r02 * P[4, j])
        P[1, j] -= dt * (r10 * P[2, j] + r11 * P[3, j] + r12 * P[4, j])
    for i in range(5):
        P[i, 0] -= dt * (r00 * P[i, 2] + r01 * P[i, 3] + r02 * P[i, 4])
        P[i, 1] -= dt * (r10 * P[i, 2] + r11 * P[i, 3] + r12 * P[i, 4])
    P[0, 0] += attitude_walk
    P[1, 1] += attitude_walk
    for i in range(2, 5):
        P[i, i] += bias_walk


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out, target, squared_error):
    """Params as in `PARAMETERS`. See `filters` for the arguments."""
    n, steps = gyro.shape[:2]
    dx, column = np.empty(5), np.empty(5)
    for row in range(states.shape[0]):
        gyro_noise, accel_noise, force_weight, bias_noise = params[row // n, :4]
        walk, bias_walk = gyro_noise * gyro_noise * dt, bias_noise * bias_noise * dt
        s, i = states[row], row % n
        P = s[COVARIANCE : COVARIANCE + 25].reshape(5, 5)
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable_between(s, dt, gyro, accel, i, t)
            dw, dqx, dqy, dqz = from_rotvec_core(
                (gx - s[BIAS]) * dt, (gy - s[BIAS + 1]) * dt, (gz - s[BIAS + 2]) * dt
            )
            qw, qx, qy, qz = multiply_core(s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3], dw, dqx, dqy, dqz)
            propagate(P, qw, qx, qy, qz, dt, walk, bias_walk)
            force = math.sqrt(ax * ax + ay * ay + az * az)
            dx[:] = 0.0
            if force > 0.0:
                wx, wy, wz = rotate_core(qw, qx, qy, qz, ax, ay, az)
                tilt = tilt_core(wx, wy, wz)
                excess = force_weight * (force / GRAVITY - 1.0)
                variance = accel_noise * accel_noise / dt * (1.0 + excess * excess)
                for k in range(2):
                    residual = tilt[k] - dx[k]
                    total = P[k, k] + variance
                    for j in range(5):
                        column[j] = P[j, k]
                    for a in range(5):
                        gain = column[a] / total
                        dx[a] += gain * residual
                        for b in range(5):
                            P[a, b] -= gain * column[b]
            qw, qx, qy, qz = turned(qw, qx, qy, qz, dx[0], dx[1])
            s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = qw, qx, qy, qz
            for k in range(3):
                s[BIAS + k] += dx[2 + k]
            roll, pitch = roll_pitch_core(qw, qx, qy, qz)
            record(row, i, t, roll, pitch, out, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat
    covariance = own[:, 7:].reshape(-1, 5, 5)
    covariance[:, [0, 1], [0, 1]] = (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2
    covariance[:, [2, 3, 4], [2, 3, 4]] = params[:, 4:5] ** 2


PARAMETERS = {
    "gyro_noise": Parameter(0.003, 1e-5, 0.3),
    "accel_noise": Parameter(0.05, 1e-3, 10.0, minimum=1e-9),
    "force_weight": Parameter(1.0, 0.01, 100.0),
    "bias_noise": Parameter(1e-4, 1e-6, 1e-2),
    "bias_sigma": Parameter(0.01, 1e-4, 0.1),
}
"""Noise densities of the rate [rad/√s] and of the measured tilt [rad √s]; κ; noise density of the bias's walk
[rad/s/√s] and standard deviation of the initial bias [rad/s]."""

ESKF = Algorithm("eskf", PARAMETERS, sequence, SIZE, _start, quat=slice(0, 4), gyro_bias=slice(4, 7))
