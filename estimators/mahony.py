"""Mahony's explicit complementary filter with bias estimation.

R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal group", IEEE
Transactions on Automatic Control 53(5), 2008, eq. 48. With v̂ the predicted and a the measured direction of
the specific force in body axes, and e = a × v̂:

    ḃ = −k_I e,    q̇ = ½ q ⊗ (0, ω − b̂ + k_P e)
"""

import math

from numba import njit

from quadsim.rotation import multiply_core, normalize_core, rotate_inverse_core

from .filters import Algorithm, Array, Parameter
from .sample import COMMON, record, roll_pitch_core, usable

QUAT, BIAS, SIZE = COMMON, COMMON + 4, 7


@njit(cache=True, nogil=True)
def sequence(states, params, dt, gyro, accel, out, target, squared_error):
    """Params: k_P [rad/s], k_I [rad/s²]. See `filters` for the arguments."""
    n, steps = gyro.shape[:2]
    for row in range(states.shape[0]):
        k_p, k_i = params[row // n, 0], params[row // n, 1]
        s, i = states[row], row % n
        for t in range(steps):
            gx, gy, gz, ax, ay, az = usable(s, dt, gyro, accel, i, t)
            qw, qx, qy, qz = s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3]
            ex = ey = ez = 0.0
            force = math.sqrt(ax * ax + ay * ay + az * az)
            if force > 0.0:
                vx, vy, vz = rotate_inverse_core(qw, qx, qy, qz, 0.0, 0.0, 1.0)
                ex = (ay * vz - az * vy) / force
                ey = (az * vx - ax * vz) / force
                ez = (ax * vy - ay * vx) / force
            s[BIAS] -= k_i * ex * dt
            s[BIAS + 1] -= k_i * ey * dt
            s[BIAS + 2] -= k_i * ez * dt
            dw, dx, dy, dz = multiply_core(
                qw, qx, qy, qz,
                0.0, gx - s[BIAS] + k_p * ex, gy - s[BIAS + 1] + k_p * ey, gz - s[BIAS + 2] + k_p * ez,
            )  # fmt: skip
            h = 0.5 * dt
            qw, qx, qy, qz = normalize_core(qw + h * dw, qx + h * dx, qy + h * dy, qz + h * dz)
            s[QUAT], s[QUAT + 1], s[QUAT + 2], s[QUAT + 3] = qw, qx, qy, qz
            roll, pitch = roll_pitch_core(qw, qx, qy, qz)
            record(row, i, t, roll, pitch, out, target, squared_error)


def _start(own: Array, quat: Array, known: bool, params: Array) -> None:
    own[:, :4] = quat


MAHONY = Algorithm(
    "mahony",
    {"k_p": Parameter(1.0, 1e-3, 10.0), "k_i": Parameter(0.3, 1e-6, 1.0)},
    sequence,
    SIZE,
    _start,
    quat=slice(0, 4),
    gyro_bias=slice(4, 7),
)
