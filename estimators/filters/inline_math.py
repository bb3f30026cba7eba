"""Trigonometric functions that the compiler inlines, which are faster than those of the C library."""

import math

import numpy as np

from quadsim.rotation import multiply_core, rotate_core
from quadsim.runs.compiled import njit


@njit(error_model="numpy")
def atan2_core(y, x):
    """Compute atan2 to one unit in the last place, inlined and twice as fast as the C library.

    The function uses the rational approximation of Cephes (S. Moshier, `atan.c`) on [0, tan π/8] after a
    rotation by 0, 45 or 90°.
    """
    across, along = abs(y), abs(x)
    steep, middle = across > 2.414213562373095 * along, across > 0.41421356237309503 * along
    top = -along if steep else (across - along if middle else across)
    bottom = across if steep else (across + along if middle else along)
    turn = 0.5 * math.pi if steep else (0.25 * math.pi if middle else 0.0)
    r = top / (bottom if bottom != 0.0 else 1.0)
    z = r * r
    p = -8.750608600031904e-1 * z - 1.615753718733365e1
    p = ((p * z - 7.500855792314705e1) * z - 1.228866684490136e2) * z - 6.485021904942025e1
    q = ((z + 2.485846490142306e1) * z + 1.650270098316989e2) * z + 4.328810604912903e2
    q = (q * z + 4.853903996359137e2) * z + 1.945506571482614e2
    angle = turn + (r + r * z * p / q)
    angle = math.pi - angle if x < 0.0 else angle
    return angle if y >= 0.0 else -angle


@njit
def put(array, values):
    """Write a tuple or an array to an array, which compiles faster than a slice assignment."""
    for k in range(len(values)):
        array[k] = values[k]


@njit
def multiply(p, q):
    """Return the product p ⊗ q of two quaternions, tuples or arrays."""
    return multiply_core(p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3])


@njit
def rotate(q, v):
    """Rotate a vector by a quaternion, tuples or arrays."""
    return rotate_core(q[0], q[1], q[2], q[3], v[0], v[1], v[2])


@njit(error_model="numpy")
def direction_core(x, y, z):
    """Normalise a vector; zero remains zero."""
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / length if length > 0.0 else 0.0
    return x * scale, y * scale, z * scale


@njit(error_model="numpy")
def sincos_core(x):
    """Compute sine and cosine of a moderate angle [rad], inlined like `atan2_core` (Cephes, `sin.c`)."""
    quarter = np.floor(x * (2.0 / math.pi) + 0.5)
    r = ((x - quarter * 1.57079625129699707031) - quarter * 7.54978941586159635335e-8) - (
        quarter * 5.39030252995776476554e-15
    )
    z = r * r
    p = ((1.58962301576546568060e-10 * z - 2.50507477628578072866e-8) * z + 2.75573136213857245213e-6) * z
    p = ((p - 1.98412698295895385996e-4) * z + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1
    sine = r + r * z * p
    p = ((-1.13585365213876817300e-11 * z + 2.08757008419747316778e-9) * z - 2.75573141792967388112e-7) * z
    p = ((p + 2.48015872888517045348e-5) * z - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2
    cosine = 1.0 - 0.5 * z + z * z * p
    turn = quarter - 4.0 * np.floor(0.25 * quarter)
    odd = turn == 1.0 or turn == 3.0
    sine, cosine = cosine if odd else sine, sine if odd else cosine
    return -sine if turn >= 2.0 else sine, -cosine if turn == 1.0 or turn == 2.0 else cosine


@njit(error_model="numpy")
def exp_core(x, y, z):
    """Return the quaternion of a rotation vector, as `rotation.from_rotvec_core`, inlined."""
    angle = math.sqrt(x * x + y * y + z * z)
    sine, cosine = sincos_core(0.5 * angle)
    small = angle < 1e-4
    scale = 0.5 - angle * angle / 48.0 if small else sine / (1.0 if small else angle)
    return cosine, scale * x, scale * y, scale * z


@njit
def roll_pitch_core(q):
    """Return roll and pitch of a quaternion [rad]."""
    qw, qx, qy, qz = q
    across = 2.0 * (qy * qz + qw * qx)
    up = qw * qw - qx * qx - qy * qy + qz * qz
    return atan2_core(across, up), atan2_core(2.0 * (qw * qy - qx * qz), math.sqrt(across * across + up * up))


@njit
def tilt_of_force_core(ax, ay, az):
    """Return roll and pitch at which gravity alone would give this specific force [rad]."""
    return atan2_core(ay, az), atan2_core(-ax, math.sqrt(ay * ay + az * az))


@njit
def wrap_core(angle):
    """Wrap an angle within ±3π to ±π [rad]."""
    if angle > math.pi:
        return angle - 2.0 * math.pi
    if angle < -math.pi:
        return angle + 2.0 * math.pi
    return angle
