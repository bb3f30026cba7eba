"""Mahony's explicit complementary filter with bias estimation.

R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear complementary filters on the special orthogonal group", IEEE
Transactions on Automatic Control 53(5), 2008, eq. 48. With v̂ the predicted and a the measured direction of
the specific force in body axes, and e = a × v̂:

    ḃ = −k_I e,    q̇ = ½ q ⊗ (0, ω − b̂ + k_P e)
"""

from quadsim.rotation import multiply_core, normalize_core, rotate_inverse_core
from quadsim.runs.compiled import njit

from .algorithm import Algorithm, Array, Parameter
from .inline_math import direction_core, roll_pitch_core
from .samples import LANES, by_lanes, by_rows, regain

SIZE = 8


@njit(forceinline=True, error_model="numpy")
def advance(s, p, k, dt, gx, gy, gz, ax, ay, az, unseen):
    """State: quaternion, bias, doubt after a gap. Params: k_P [rad/s], k_I [rad/s²]; see `filters`."""
    k_p, k_i = p[0, k], p[1, k]
    qw, qx, qy, qz = s[0, k], s[1, k], s[2, k], s[3, k]
    ax, ay, az = direction_core(ax, ay, az)
    vx, vy, vz = rotate_inverse_core(qw, qx, qy, qz, 0.0, 0.0, 1.0)
    ex, ey, ez = ay * vz - az * vy, az * vx - ax * vz, ax * vy - ay * vx
    bx, by, bz = s[4, k] - k_i * ex * dt, s[5, k] - k_i * ey * dt, s[6, k] - k_i * ez * dt
    share, s[7, k] = regain(s[7, k], unseen, ax, ay, az, dt)
    k_p = max(k_p, share / dt)
    dw, dx, dy, dz = multiply_core(
        qw, qx, qy, qz, 0.0, gx - bx + k_p * ex, gy - by + k_p * ey, gz - bz + k_p * ez
    )
    h = 0.5 * dt
    qw, qx, qy, qz = normalize_core(qw + h * dw, qx + h * dx, qy + h * dy, qz + h * dz)
    s[0, k], s[1, k], s[2, k], s[3, k] = qw, qx, qy, qz
    s[4, k], s[5, k], s[6, k] = bx, by, bz
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


MAHONY = Algorithm(
    "mahony",
    {"k_p": Parameter(1.0, 1e-3, 10.0), "k_i": Parameter(0.3, 1e-6, 1.0)},
    sequence,
    score,
    SIZE,
    _start,
    quat=slice(0, 4),
    gyro_bias=slice(4, 7),
)
