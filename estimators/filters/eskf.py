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

from quadsim.rotation import matrix_core, multiply_core, normalize_core, rotate_core
from quadsim.runs.compiled import njit
from quadsim.vehicle import GRAVITY

from .algorithm import Algorithm, Array, Parameter, Records, tilt_block
from .ekf import NOTHING_KNOWN, SIGMA_UNKNOWN
from .inline_math import atan2_core, exp_core, four, put_four, roll_pitch_core, three
from .samples import LANES, by_lanes, by_rows, lanes_of, parameter_record

STATE = np.dtype([("quat", "f8", 4), ("gyro_bias", "f8", 3), ("covariance", "f8", (5, 5))])

SIGMA_GIVEN = 0.3
"""Standard deviation of an initial attitude that is given [rad]: one that is wrong would pass for a bias."""

PARAMETERS = {
    "gyro_noise": Parameter(0.003, 1e-5, 0.3),
    "accel_noise": Parameter(0.05, 1e-3, 10.0, minimum=1e-9),
    "force_weight": Parameter(1.0, 0.01, 100.0),
    "bias_noise": Parameter(1e-4, 1e-6, 1e-2),
    "bias_sigma": Parameter(0.01, 1e-4, 0.1),
}
"""Noise densities of the rate [rad/√s] and of the measured tilt [rad √s]; κ; noise density of the bias's walk
[rad/s/√s] and standard deviation of the initial bias [rad/s]."""
PARAMS = parameter_record(PARAMETERS)
STATE_LANES, PARAM_LANES = lanes_of(STATE, LANES), lanes_of(PARAMS, LANES)


@njit(error_model="numpy")
def tilt_core(x, y, z):
    """Rotation vector x, y [rad] that takes a world vector to the z axis the short way; any length."""
    across = math.sqrt(x * x + y * y)
    scale = atan2_core(across, z) / (across if across > 0.0 else 1.0)
    return y * scale, -x * scale


@njit
def turned(qw, qx, qy, qz, x, y):
    """The quaternion after a small rotation (x, y, 0) [rad] about world axes."""
    rw, rx, ry, rz = exp_core(x, y, 0.0)
    w, x, y, z = multiply_core(rw, rx, ry, rz, qw, qx, qy, qz)
    return normalize_core(w, x, y, z)


@njit
def five(field, k):
    """Lane k of a field (5, lanes)."""
    return field[0, k], field[1, k], field[2, k], field[3, k], field[4, k]


@njit
def put_five(field, k, values):
    """Write it."""
    field[0, k], field[1, k], field[2, k], field[3, k], field[4, k] = values


@njit
def plus(a, scale, b):
    """Sum a + scale b of two tuples."""
    return (
        a[0] + scale * b[0],
        a[1] + scale * b[1],
        a[2] + scale * b[2],
        a[3] + scale * b[3],
        a[4] + scale * b[4],
    )


@njit
def turned_by_bias(row, r, dt):
    """One row of P Fᵀ from one of P: its θ less dt R̂ times its δb."""
    return (
        row[0] - dt * (r[0] * row[2] + r[1] * row[3] + r[2] * row[4]),
        row[1] - dt * (r[3] * row[2] + r[4] * row[3] + r[5] * row[4]),
        row[2], row[3], row[4],
    )  # fmt: skip


@njit
def propagated(rows, r, dt, attitude_walk, bias_walk):
    """F P Fᵀ + Q for F = [[I, −R̂ dt], [0, I]], from and to rows of P; r is R̂ by rows."""
    P0, P1, P2, P3, P4 = rows
    P0 = plus(plus(plus(P0, -dt * r[0], P2), -dt * r[1], P3), -dt * r[2], P4)
    P1 = plus(plus(plus(P1, -dt * r[3], P2), -dt * r[4], P3), -dt * r[5], P4)
    P0, P1, P2, P3, P4 = (
        turned_by_bias(P0, r, dt),
        turned_by_bias(P1, r, dt),
        turned_by_bias(P2, r, dt),
        turned_by_bias(P3, r, dt),
        turned_by_bias(P4, r, dt),
    )
    return (
        (P0[0] + attitude_walk, P0[1], P0[2], P0[3], P0[4]),
        (P1[0], P1[1] + attitude_walk, P1[2], P1[3], P1[4]),
        (P2[0], P2[1], P2[2] + bias_walk, P2[3], P2[4]),
        (P3[0], P3[1], P3[2], P3[3] + bias_walk, P3[4]),
        (P4[0], P4[1], P4[2], P4[3], P4[4] + bias_walk),
    )


@njit(error_model="numpy")
def corrected(rows, dx, column, residual, total):
    """One measurement of an error of the state: the rows of P, and the error dx estimated so far, after it.

    Args:
        rows: Rows of P.
        dx: Error estimated so far.
        column: Column of P that belongs to the error measured.
        residual: Measured less dx.
        total: Variance of the error and the measurement.
    """
    P0, P1, P2, P3, P4 = rows
    gain = 1.0 / total
    return (
        plus(P0, -gain * column[0], column),
        plus(P1, -gain * column[1], column),
        plus(P2, -gain * column[2], column),
        plus(P3, -gain * column[3], column),
        plus(P4, -gain * column[4], column),
        plus(dx, gain * residual, column),
    )


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, sample):
    """See `algorithm`.

    A missing specific force has the variance of nothing known: a branch would keep the compiler from vectors.
    """
    dt, P = sample.dt, s.covariance
    gx, gy, gz = sample.gyro
    ax, ay, az = sample.accel
    walk = p.gyro_noise[k] * p.gyro_noise[k] * dt + sample.unseen
    bias_walk = p.bias_noise[k] * p.bias_noise[k] * dt
    bx, by, bz = three(s.gyro_bias, k)
    ew, ex, ey, ez = exp_core((gx - bx) * dt, (gy - by) * dt, (gz - bz) * dt)
    qw, qx, qy, qz = four(s.quat, k)
    qw, qx, qy, qz = multiply_core(qw, qx, qy, qz, ew, ex, ey, ez)
    rows = five(P[0], k), five(P[1], k), five(P[2], k), five(P[3], k), five(P[4], k)
    P0, P1, P2, P3, P4 = propagated(rows, matrix_core(qw, qx, qy, qz), dt, walk, bias_walk)
    force = math.sqrt(ax * ax + ay * ay + az * az)
    wx, wy, wz = rotate_core(qw, qx, qy, qz, ax, ay, az)
    tilt_x, tilt_y = tilt_core(wx, wy, wz)
    excess = p.force_weight[k] * (force / GRAVITY - 1.0)
    variance = p.accel_noise[k] * p.accel_noise[k] / dt * (1.0 + excess * excess)
    variance += 0.0 if force > 0.0 else NOTHING_KNOWN
    dx = (0.0, 0.0, 0.0, 0.0, 0.0)
    column = (P0[0], P1[0], P2[0], P3[0], P4[0])
    rows = P0, P1, P2, P3, P4
    P0, P1, P2, P3, P4, dx = corrected(rows, dx, column, tilt_x, P0[0] + variance)
    column = (P0[1], P1[1], P2[1], P3[1], P4[1])
    rows = P0, P1, P2, P3, P4
    P0, P1, P2, P3, P4, dx = corrected(rows, dx, column, tilt_y - dx[1], P1[1] + variance)
    qw, qx, qy, qz = turned(qw, qx, qy, qz, dx[0], dx[1])
    put_four(s.quat, k, (qw, qx, qy, qz))
    s.gyro_bias[0, k], s.gyro_bias[1, k], s.gyro_bias[2, k] = bx + dx[2], by + dx[3], bz + dx[4]
    put_five(P[0], k, P0)
    put_five(P[1], k, P1)
    put_five(P[2], k, P2)
    put_five(P[3], k, P3)
    put_five(P[4], k, P4)
    return roll_pitch_core(qw, qx, qy, qz)


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `algorithm`."""
    by_rows(advance, True, states, params, dt, gyro, accel, out)


@njit(cache=True, nogil=True)
def score(states, params, dt, flights):
    """See `algorithm`."""
    work = np.empty(1, STATE_LANES), np.empty(1, PARAM_LANES)
    return by_lanes(advance, True, work, states, params, dt, flights)


def _start(states: Records, quat: Array, known: bool, params: Records) -> None:
    states["quat"][..., 0] = quat
    states["covariance"][:, [0, 1], [0, 1], 0] = (SIGMA_GIVEN if known else SIGMA_UNKNOWN) ** 2
    states["covariance"][:, [2, 3, 4], [2, 3, 4], 0] = params["bias_sigma"] ** 2


ESKF = Algorithm(
    "eskf", PARAMETERS, lanes_of(STATE), lanes_of(PARAMS), sequence, score, _start, tilt_covariance=tilt_block
)
