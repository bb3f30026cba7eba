"""Extended Kalman filter of the quaternion: gyroscope in the prediction, accelerometer in the correction.

State q, a random walk in quaternion space around the integrated gyroscope:

    q ← q ⊗ exp(½ ω dt),   F the matrix of that product,   P ← F P Fᵀ + ¼ N² dt I

Measurement: the direction of the specific force in body axes, predicted h(q) = R(q)ᵀ (0, 0, 1), with
covariance σ² / dt I. Noises are densities, so that the filter acts alike at any sample rate. ω is the mean
of the last two samples. `filterpy_filters` holds the same filter on filterpy's classes.
"""

import numpy as np
from numba import njit

from quadsim.rotation import from_rotvec_core, normalize_core

from .filters import Algorithm, Array, Parameter
from .sample import COMMON, record, roll_pitch_core, usable_between

SIGMA_KNOWN = 0.01
"""Standard deviation of a known initial attitude [rad]."""
SIGMA_UNKNOWN = 0.5
"""The same of one that is not known and taken as level [rad]."""

QUAT, COVARIANCE, SIZE = COMMON, COMMON + 4, 20


@njit
def predict(q, P, F, FP, gx, gy, gz, dt, noise):
    """Advance quaternion q (4,) and covariance P (4, 4) by one sample; F and FP are scratch (4, 4)."""
    c, x, y, z = from_rotvec_core(gx * dt, gy * dt, gz * dt)
    F[0, 0], F[0, 1], F[0, 2], F[0, 3] = c, -x, -y, -z
    F[1, 0], F[1, 1], F[1, 2], F[1, 3] = x, c, z, -y
    F[2, 0], F[2, 1], F[2, 2], F[2, 3] = y, -z, c, x
    F[3, 0], F[3, 1], F[3, 2], F[3, 3] = z, y, -x, c
    qw, qx, qy, qz = q[0], q[1], q[2], q[3]
    for i in range(4):
        q[i] = F[i, 0] * qw + F[i, 1] * qx + F[i, 2] * qy + F[i, 3] * qz
        for j in range(4):
            FP[i, j] = F[i, 0] * P[0, j] + F[i, 1] * P[1, j] + F[i, 2] * P[2, j] + F[i, 3] * P[3, j]
    for i in range(4):
        for j in range(i + 1):
            P[i, j] = FP[i, 0] * F[j, 0] + FP[i, 1] * F[j, 1] + FP[i, 2] * F[j, 2] + FP[i, 3] * F[j, 3]
            P[j, i] = P[i, j]
        P[i, i] += noise


@njit
def correct(q, P, H, dx, ax, ay, az, variance):
    """Correct q (4,) and P (4, 4) by a specific force, axis by axis; H (3, 4) and dx (4,) are scratch.

    The axes' noises are independent, so this equals the correction by all three at once.
    """
    w, x, y, z = q[0], q[1], q[2], q[3]
    H[0, 0], H[0, 1], H[0, 2], H[0, 3] = -2.0 * y, 2.0 * z, -2.0 * w, 2.0 * x
    H[1, 0], H[1, 1], H[1, 2], H[1, 3] = 2.0 * x, 2.0 * w, 2.0 * z, 2.0 * y
    H[2, 0], H[2, 1], H[2, 2], H[2, 3] = 2.0 * w, -2.0 * x, -2.0 * y, 2.0 * z
    scale = 1.0 / np.sqrt(ax * ax + ay * ay + az * az)
    dx[:] = 0.0
    for k in range(3):
        if k == 0:
            residual = ax * scale - 2.0 * (x * z - w * y)
        elif k == 1:
            residual = ay * scale - 2.0 * (y * z + w * x)
        else:
            residual = az * scale - (w * w - x * x - y * y + z * z)
        residual -= H[k, 0] * dx[0] + H[k, 1] * dx[1] + H[k, 2] * dx[2] + H[k, 3] * dx[3]
        p0 = P[0, 0] * H[k, 0] + P[0, 1] * H[k, 1] + P[0, 2] * H[k, 2] + P[0, 3] * H[k, 3]
        p1 = P[1, 0] * H[k, 0] + P[1, 1] * H[k, 1] + P[1, 2] * H[k, 2] + P[1, 3] * H[k, 3]
        p2 = P[2, 0] * H[k, 0] + P[2, 1] * H[k, 1] + P[2, 2] * H[k, 2] + P[2, 3] * H[k, 3]
        p3 = P[3, 0] * H[k, 0] + P[3, 1] * H[k, 1] + P[3, 2] * H[k, 2] + P[3, 3] * H[k, 3]
        total = H[k, 0] * p0 + H[k, 1] * p1 + H[k, 2] * p2 + H[k, 3] * p3 + variance
        column = (p0, p1, p2, p3)
        for i in range(4):
            gain = column[i] / total
            dx[i] += gain * residual
            for j in range(4):
                P[i, j] -= gain * column[j]
    q[0], q[1], q[2], q[3] = normalize_core(w + dx[0], x + dx[1], y + dx[2], z + dx[3])


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out, target, squared_error):
    """Params: noise densities N of the rate [rad/√s], σ of the measured direction [√s]. See `filters`."""
    n, steps = gyro.shape[:2]
    F, FP, H, dx = np.empty((4, 4)), np.empty((4, 4)), np.empty((3, 4)), np.empty(4)
    for row in range(states.shape[0]):
        gyro_noise, accel_noise = params[row // n, 0], params[row // n, 1]
        walk, variance = 0.25 * gyro_noise * gyro_noise * dt, accel_noise * accel_noise / dt
        s, i = states[row], row % n
        q, P = s[QUAT : QUAT + 4], s[COVARIANCE : COVARIANCE + 16].reshape(4, 4)
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable_between(s, dt, gyro, accel, i, t)
            predict(q, P, F, FP, gx, gy, gz, dt, walk)
            if ax != 0.0 or ay != 0.0 or az != 0.0:
                correct(q, P, H, dx, ax, ay, az, variance)
            roll, pitch = roll_pitch_core(q[0], q[1], q[2], q[3])
            record(row, i, t, roll, pitch, out, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat
    own[:, 4::5] = 0.25 * (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2


PARAMETERS = {
    "gyro_noise": Parameter(0.005, 1e-5, 0.3),
    "accel_noise": Parameter(0.05, 1e-3, 10.0, minimum=1e-9),
}
EKF = Algorithm("ekf", PARAMETERS, sequence, SIZE, _start, quat=slice(0, 4))
