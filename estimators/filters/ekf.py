"""Extended Kalman filter of the quaternion: gyroscope in the prediction, accelerometer in the correction.

State q, a random walk in quaternion space around the integrated gyroscope:

    q ← q ⊗ exp(½ ω dt),   F the matrix of that product,   P ← F P Fᵀ + ¼ N² dt I

Measurement: the direction of the specific force in body axes, predicted h(q) = R(q)ᵀ (0, 0, 1), with
covariance σ² / dt I. Noises are densities, so that the filter acts alike at any sample rate. ω is the mean
of the last two samples. `filterpy_filters` holds the same filter on filterpy's classes.
"""

import numpy as np

from quadsim.rotation import multiply_core, normalize_core
from quadsim.runs.compiled import njit

from .algorithm import Algorithm, Array, Parameter, Records
from .inline_math import direction_core, exp_core, four, put_four, roll_pitch_core
from .samples import LANES, by_lanes, by_rows, lanes_of, parameter_record

SIGMA_KNOWN = 0.01
"""Standard deviation of a known initial attitude [rad]."""
SIGMA_UNKNOWN = 0.5
"""The same of one that is not known and taken as level [rad]."""
NOTHING_KNOWN = 1e300
"""Variance of a measurement that is missing."""

STATE = np.dtype([("quat", "f8", 4), ("covariance", "f8", (4, 4))])

PARAMETERS = {
    "gyro_noise": Parameter(0.005, 1e-5, 0.3),
    "accel_noise": Parameter(0.05, 1e-3, 10.0, minimum=1e-9),
}
"""Noise densities N of the rate [rad/√s] and σ of the measured direction [√s]."""
PARAMS = parameter_record(PARAMETERS)
STATE_LANES, PARAM_LANES = lanes_of(STATE, LANES), lanes_of(PARAMS, LANES)


@njit
def times(a, b):
    """Product a ⊗ b of two tuples."""
    return multiply_core(a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3])


@njit
def dot(a, b):
    """Inner product of two tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@njit
def plus(a, scale, b):
    """Sum a + scale b of two tuples."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2], a[3] + scale * b[3]


@njit
def predicted(P0, P1, P2, P3, step, noise):
    """F P Fᵀ + noise I, from and to rows of P. F x = x ⊗ step, and P is symmetric: F (F P)ᵀ."""
    A0, A1, A2, A3 = times(P0, step), times(P1, step), times(P2, step), times(P3, step)
    w, x, y, z = (
        times((A0[0], A1[0], A2[0], A3[0]), step),
        times((A0[1], A1[1], A2[1], A3[1]), step),
        times((A0[2], A1[2], A2[2], A3[2]), step),
        times((A0[3], A1[3], A2[3], A3[3]), step),
    )
    return (
        (w[0] + noise, w[1], w[2], w[3]),
        (x[0], x[1] + noise, x[2], x[3]),
        (y[0], y[1], y[2] + noise, y[3]),
        (z[0], z[1], z[2], z[3] + noise),
    )


@njit(error_model="numpy")
def corrected(P0, P1, P2, P3, dx, h, residual, variance):
    """One scalar measurement of row h: the rows of P, and the error dx estimated so far, after it."""
    column = (dot(P0, h), dot(P1, h), dot(P2, h), dot(P3, h))
    gain = 1.0 / (dot(h, column) + variance)
    dx = plus(dx, gain * (residual - dot(h, dx)), column)
    return (
        plus(P0, -gain * column[0], column),
        plus(P1, -gain * column[1], column),
        plus(P2, -gain * column[2], column),
        plus(P3, -gain * column[3], column),
        dx,
    )


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, sample):
    """See `algorithm`.

    The noises of the measurement's axes are independent, so that correcting by one after the other equals
    correcting by all at once. A missing force has the variance of nothing known: a branch would keep the
    compiler from vectors.
    """
    dt, P = sample.dt, s.covariance
    gx, gy, gz = sample.gyro
    ax, ay, az = sample.accel
    step = exp_core(gx * dt, gy * dt, gz * dt)
    q = times(four(s.quat, k), step)
    noise = 0.25 * (p.gyro_noise[k] * p.gyro_noise[k] * dt + sample.unseen)
    found = ax != 0.0 or ay != 0.0 or az != 0.0
    variance = p.accel_noise[k] * p.accel_noise[k] / dt + (0.0 if found else NOTHING_KNOWN)
    P0, P1, P2, P3 = predicted(four(P[0], k), four(P[1], k), four(P[2], k), four(P[3], k), step, noise)
    ax, ay, az = direction_core(ax, ay, az)
    w, x, y, z = q
    dx, residual = (0.0, 0.0, 0.0, 0.0), ax - 2.0 * (x * z - w * y)
    P0, P1, P2, P3, dx = corrected(
        P0, P1, P2, P3, dx, (-2.0 * y, 2.0 * z, -2.0 * w, 2.0 * x), residual, variance
    )
    residual = ay - 2.0 * (y * z + w * x)
    P0, P1, P2, P3, dx = corrected(
        P0, P1, P2, P3, dx, (2.0 * x, 2.0 * w, 2.0 * z, 2.0 * y), residual, variance
    )
    residual = az - (w * w - x * x - y * y + z * z)
    P0, P1, P2, P3, dx = corrected(
        P0, P1, P2, P3, dx, (2.0 * w, -2.0 * x, -2.0 * y, 2.0 * z), residual, variance
    )
    q = normalize_core(w + dx[0], x + dx[1], y + dx[2], z + dx[3])
    put_four(s.quat, k, q)
    put_four(P[0], k, P0)
    put_four(P[1], k, P1)
    put_four(P[2], k, P2)
    put_four(P[3], k, P3)
    return roll_pitch_core(q[0], q[1], q[2], q[3])


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
    states["covariance"][:, range(4), range(4), 0] = 0.25 * (SIGMA_KNOWN if known else SIGMA_UNKNOWN) ** 2


def _tilt_covariance(states: Records) -> Array:
    """Of the error θ = 2 (δq ⊗ q*) in world axes, its x and y: (n, 2, 2) [rad²]."""
    w, x, y, z = states["quat"][..., 0].T
    to_tilt = 2.0 * np.stack([-x, w, -z, y, -y, z, w, -x], axis=-1).reshape(-1, 2, 4)
    return to_tilt @ states["covariance"][..., 0] @ np.swapaxes(to_tilt, 1, 2)


EKF = Algorithm(
    "ekf",
    PARAMETERS,
    lanes_of(STATE),
    lanes_of(PARAMS),
    sequence,
    score,
    _start,
    tilt_covariance=_tilt_covariance,
)
