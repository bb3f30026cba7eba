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

from quadsim.rotation import matrix_core, normalize_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from .driver import Array, CompiledFilter, Records
from .ekf import NOTHING_KNOWN, SIGMA_UNKNOWN, correct
from .inline_math import atan2_core, exp_core, multiply, put, roll_pitch_core, rotate
from .samples import run_all

RECORD = np.dtype(
    [
        ("quat", "f8", 4),
        ("gyro_bias", "f8", 3),
        ("covariance", "f8", (5, 5)),
        ("error", "f8", 5),  # scratch: estimated so far, and P hᵀ of a measurement
        ("column", "f8", 5),
    ]
)

SIGMA_GIVEN = 0.3
"""Standard deviation of an initial attitude that is given [rad]: one that is wrong would pass for a bias."""


@njit(error_model="numpy")
def tilt_core(force):
    """Rotation vector x, y [rad] that takes a world vector to the z axis the short way; any length."""
    x, y, z = force
    across = math.sqrt(x * x + y * y)
    scale = atan2_core(across, z) / (across if across > 0.0 else 1.0)
    return y * scale, -x * scale


@njit
def turned(q, x, y):
    """A quaternion after a small rotation (x, y, 0) [rad] about world axes."""
    w, x, y, z = multiply(exp_core(x, y, 0.0), q)
    return normalize_core(w, x, y, z)


@njit
def propagate(P, r, dt, attitude_walk, bias_walk):
    """P ← F P Fᵀ + Q for F = [[I, −R̂ dt], [0, I]]; r is R̂ by rows."""
    for j in range(5):
        x, y, z = P[2, j], P[3, j], P[4, j]
        P[0, j] -= dt * (r[0] * x + r[1] * y + r[2] * z)
        P[1, j] -= dt * (r[3] * x + r[4] * y + r[5] * z)
    for i in range(5):
        x, y, z = P[i, 2], P[i, 3], P[i, 4]
        P[i, 0] -= dt * (r[0] * x + r[1] * y + r[2] * z)
        P[i, 1] -= dt * (r[3] * x + r[4] * y + r[5] * z)
        P[i, i] += attitude_walk if i < 2 else bias_walk


@njit(inline="always")
def step(s, p, sample):
    """See `driver`. A missing specific force has the variance of nothing known."""
    dt, P, dx, b = sample.dt, s.covariance, s.error, s.gyro_bias
    gx, gy, gz = sample.mean_gyro
    ax, ay, az = sample.accel
    q = multiply(s.quat, exp_core((gx - b[0]) * dt, (gy - b[1]) * dt, (gz - b[2]) * dt))
    walk = p.gyro_noise * p.gyro_noise * dt + sample.unseen
    propagate(P, matrix_core(q[0], q[1], q[2], q[3]), dt, walk, p.bias_noise * p.bias_noise * dt)
    force = math.sqrt(ax * ax + ay * ay + az * az)
    tilt = tilt_core(rotate(q, sample.accel))
    excess = p.force_weight * (force / GRAVITY - 1.0)
    variance = p.accel_noise * p.accel_noise / dt * (1.0 + excess * excess)
    variance += 0.0 if sample.found else NOTHING_KNOWN
    dx[:] = 0.0
    for k in range(2):
        put(s.column, P[k])
        correct(P, 5, dx, s.column, P[k, k] + variance, tilt[k] - dx[k])
    put(s.quat, turned(q, dx[0], dx[1]))
    for k in range(3):
        b[k] += dx[2 + k]
    return roll_pitch_core(s.quat)


@njit(cache=True, nogil=True, error_model="numpy")
def run(states, samples, params, dt, gyro, accel, rotor_vel, out):
    """See `driver`."""
    run_all(step, states, samples, params, dt, gyro, accel, rotor_vel, out)


class Eskf(CompiledFilter):
    """The filter of n vehicles."""

    record, run = RECORD, staticmethod(run)

    def begin(self, states: Records, quat: Array, known: bool) -> None:
        """Also the variances of tilt and bias."""
        states["quat"] = quat
        sigma = [SIGMA_GIVEN if known else SIGMA_UNKNOWN] * 2 + [self.values["bias_sigma"]] * 3
        states["covariance"] = np.diag(np.square(sigma))
