"""Mahony's explicit complementary filter with bias estimation.

R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal group", IEEE
Transactions on Automatic Control 53(5), 2008, eq. 48. With v̂ the predicted and a the measured direction of
the specific force in body axes, and e = a × v̂:

    ḃ = −k_I e,    q̇ = ½ q ⊗ (0, ω − b̂ + k_P e)
"""

import numpy as np

from quadsim.rotation import multiply_core, normalize_core, rotate_inverse_core
from quadsim.runs.compiled import njit

from .algorithm import Algorithm, Array, Parameter, Records
from .inline_math import direction_core, four, put_four, roll_pitch_core, three
from .samples import LANES, by_lanes, by_rows, lanes_of, parameter_record, reacquire

STATE = np.dtype([("quat", "f8", 4), ("gyro_bias", "f8", 3), ("tilt_variance", "f8")])
"""The variance is that of the tilt that gaps have left [rad²]."""

PARAMETERS = {"k_p": Parameter(1.0, 1e-3, 10.0), "k_i": Parameter(0.3, 1e-6, 1.0)}
"""Gains k_P [rad/s] and k_I [rad/s²]."""
PARAMS = parameter_record(PARAMETERS)
STATE_LANES, PARAM_LANES = lanes_of(STATE, LANES), lanes_of(PARAMS, LANES)


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, sample):
    """See `algorithm`."""
    dt, k_i = sample.dt, p.k_i[k]
    gx, gy, gz = sample.gyro
    qw, qx, qy, qz = four(s.quat, k)
    bx, by, bz = three(s.gyro_bias, k)
    ax, ay, az = direction_core(sample.accel[0], sample.accel[1], sample.accel[2])
    vx, vy, vz = rotate_inverse_core(qw, qx, qy, qz, 0.0, 0.0, 1.0)
    ex, ey, ez = ay * vz - az * vy, az * vx - ax * vz, ax * vy - ay * vx
    bx, by, bz = bx - k_i * ex * dt, by - k_i * ey * dt, bz - k_i * ez * dt
    share, s.tilt_variance[k] = reacquire(s.tilt_variance[k], sample)
    k_p = max(p.k_p[k], share / dt)
    dw, dx, dy, dz = multiply_core(
        qw, qx, qy, qz, 0.0, gx - bx + k_p * ex, gy - by + k_p * ey, gz - bz + k_p * ez
    )
    h = 0.5 * dt
    qw, qx, qy, qz = normalize_core(qw + h * dw, qx + h * dx, qy + h * dy, qz + h * dz)
    put_four(s.quat, k, (qw, qx, qy, qz))
    s.gyro_bias[0, k], s.gyro_bias[1, k], s.gyro_bias[2, k] = bx, by, bz
    return roll_pitch_core(qw, qx, qy, qz)


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `algorithm`."""
    by_rows(advance, False, states, params, dt, gyro, accel, out)


@njit(cache=True, nogil=True)
def score(states, params, dt, flights):
    """See `algorithm`."""
    work = np.empty(1, STATE_LANES), np.empty(1, PARAM_LANES)
    return by_lanes(advance, False, work, states, params, dt, flights)


def _start(states: Records, quat: Array, known: bool, params: Records) -> None:
    states["quat"][..., 0] = quat


MAHONY = Algorithm("mahony", PARAMETERS, lanes_of(STATE), lanes_of(PARAMS), sequence, score, _start)
