"""Madgwick's gradient-descent filter, without magnetometer.

S. Madgwick, A. Harrison, R. Vaidyanathan, "Estimation of IMU and MARG orientation using a gradient descent
algorithm", ICORR 2011. With f the difference of the predicted and the measured direction of the specific
force (eq. 25) and J its Jacobian (eq. 26):

    q̇ = ½ q ⊗ (0, ω) − β Jᵀf / ‖Jᵀf‖
"""

import math

from quadsim.rotation import multiply_core, normalize_core
from quadsim.runs.compiled import njit

from .algorithm import Algorithm, Array, Parameter
from .inline_math import direction_core, roll_pitch_core
from .samples import LANES, by_lanes, by_rows, regain

SIZE = 5


@njit(error_model="numpy")
def descent(qw, qx, qy, qz, ax, ay, az):
    """Direction of steepest ascent Jᵀf / ‖Jᵀf‖ at q, zero where the gradient or the force is, and ‖f‖."""
    ax, ay, az = direction_core(ax, ay, az)
    fx = 2.0 * (qx * qz - qw * qy) - ax
    fy = 2.0 * (qw * qx + qy * qz) - ay
    fz = 2.0 * (0.5 - qx * qx - qy * qy) - az
    w = -2.0 * qy * fx + 2.0 * qx * fy
    x = 2.0 * qz * fx + 2.0 * qw * fy - 4.0 * qx * fz
    y = -2.0 * qw * fx + 2.0 * qz * fy - 4.0 * qy * fz
    z = 2.0 * qx * fx + 2.0 * qy * fy
    length = math.sqrt(w * w + x * x + y * y + z * z)
    known = length > 0.0 and (ax != 0.0 or ay != 0.0 or az != 0.0)
    scale = 1.0 / length if known else 0.0
    return w * scale, x * scale, y * scale, z * scale, math.sqrt(fx * fx + fy * fy + fz * fz)


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, dt, gx, gy, gz, ax, ay, az, unseen):
    """State: quaternion, doubt after a gap. Params: β [rad/s]. See `filters` for the arguments."""
    qw, qx, qy, qz = s[0, k], s[1, k], s[2, k], s[3, k]
    dw, dx, dy, dz = multiply_core(qw, qx, qy, qz, 0.0, 0.5 * gx, 0.5 * gy, 0.5 * gz)
    fw, fx, fy, fz, error = descent(qw, qx, qy, qz, ax, ay, az)
    share, s[4, k] = regain(s[4, k], unseen, ax, ay, az, dt)
    beta = max(p[0, k], 0.5 * share * error / dt)
    qw, qx, qy, qz = normalize_core(
        qw + (dw - beta * fw) * dt,
        qx + (dx - beta * fx) * dt,
        qy + (dy - beta * fy) * dt,
        qz + (dz - beta * fz) * dt,
    )
    s[0, k], s[1, k], s[2, k], s[3, k] = qw, qx, qy, qz
    return roll_pitch_core(qw, qx, qy, qz)


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out):
    """See `filters`."""
    by_rows(advance, False, states, params, dt, gyro, accel, out)


@njit(cache=True, nogil=True)
def score(states, params, dt, gyro, accel, target, squared_error):
    """See `filters`."""
    by_lanes(advance, LANES, False, states, params, dt, gyro, accel, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat


MADGWICK = Algorithm(
    "madgwick", {"beta": Parameter(0.033, 1e-4, 1.0)}, sequence, score, SIZE, _start, quat=slice(0, 4)
)
