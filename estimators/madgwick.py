"""Madgwick's gradient-descent filter, without magnetometer.

S. Madgwick, A. Harrison, R. Vaidyanathan, "Estimation of IMU and MARG orientation using a gradient descent
algorithm", ICORR 2011. With f the difference of the predicted and the measured direction of the specific
force (eq. 25) and J its Jacobian (eq. 26):

    q̇ = ½ q ⊗ (0, ω) − β Jᵀf / ‖Jᵀf‖
"""

import math

from numba import njit

from quadsim.rotation import multiply_core, normalize_core

from .filters import Algorithm, Array, Parameter
from .sample import COMMON, record, roll_pitch_core, usable

QUAT, SIZE = COMMON, 4


@njit
def descent(qw, qx, qy, qz, ax, ay, az):
    """Direction of steepest ascent Jᵀf / ‖Jᵀf‖ at q; zero where the gradient or the specific force is."""
    force = math.sqrt(ax * ax + ay * ay + az * az)
    if force == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    fx = 2.0 * (qx * qz - qw * qy) - ax / force
    fy = 2.0 * (qw * qx + qy * qz) - ay / force
    fz = 2.0 * (0.5 - qx * qx - qy * qy) - az / force
    w = -2.0 * qy * fx + 2.0 * qx * fy
    x = 2.0 * qz * fx + 2.0 * qw * fy - 4.0 * qx * fz
    y = -2.0 * qw * fx + 2.0 * qz * fy - 4.0 * qy * fz
    z = 2.0 * qx * fx + 2.0 * qy * fy
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return w / length, x / length, y / length, z / length


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out, target, squared_error):
    """Params: β [rad/s]. See `filters` for the arguments."""
    n, steps = gyro.shape[:2]
    for row in range(states.shape[0]):
        beta = params[row // n, 0]
        s, i = states[row], row % n
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable(s, dt, gyro, accel, i, t)
            qw, qx, qy, qz = s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3]
            dw, dx, dy, dz = multiply_core(qw, qx, qy, qz, 0.0, 0.5 * gx, 0.5 * gy, 0.5 * gz)
            gw, gx, gy, gz = descent(qw, qx, qy, qz, ax, ay, az)
            qw, qx, qy, qz = normalize_core(
                qw + (dw - beta * gw) * dt,
                qx + (dx - beta * gx) * dt,
                qy + (dy - beta * gy) * dt,
                qz + (dz - beta * gz) * dt,
            )
            s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = qw, qx, qy, qz
            roll, pitch = roll_pitch_core(qw, qx, qy, qz)
            record(row, i, t, roll, pitch, out, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat


MADGWICK = Algorithm(
    "madgwick", {"beta": Parameter(0.033, 1e-4, 1.0)}, sequence, SIZE, _start, quat=slice(0, 4)
)
