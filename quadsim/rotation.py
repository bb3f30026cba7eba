"""Rotations as Hamilton quaternions, scalar first; `quat_WB` rotates body vectors to world axes.

Each equation is implemented once, as a scalar numba function `*_core` (floats in, tuples out) that other
kernels call. The public functions apply these equations to arrays: the last axis holds the components, and
the other axes broadcast. Euler angles are intrinsic z-y'-x'' (yaw, then pitch, then roll). All conversions to
other orders and frames are in this module.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .runs.compiled import njit

Array = NDArray[np.float64]

GIMBAL_LOCK = 1e-8
"""Cosine of pitch below which roll and yaw cannot be distinguished; roll is then 0."""


# --- equations ------------------------------------------------------------------------------------


@njit(cache=True)
def multiply_core(pw, px, py, pz, qw, qx, qy, qz):
    """Return the Hamilton product p ⊗ q: first the rotation q, then p."""
    return (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )


@njit(cache=True)
def rotate_core(qw, qx, qy, qz, x, y, z):
    """Rotate a body vector to the world, q ⊗ (0, v) ⊗ q* for a unit q, as v + 2 w (r × v) + 2 r × (r × v)."""
    tx = 2.0 * (qy * z - qz * y)
    ty = 2.0 * (qz * x - qx * z)
    tz = 2.0 * (qx * y - qy * x)
    return (
        x + qw * tx + qy * tz - qz * ty,
        y + qw * ty + qz * tx - qx * tz,
        z + qw * tz + qx * ty - qy * tx,
    )


@njit(cache=True)
def rotate_inverse_core(qw, qx, qy, qz, x, y, z):
    """Rotate a world vector to the body, q* ⊗ (0, v) ⊗ q for a unit q."""
    return rotate_core(qw, -qx, -qy, -qz, x, y, z)


@njit(cache=True, error_model="numpy")
def normalize_core(qw, qx, qy, qz):
    """Normalise a quaternion that is not zero."""
    scale = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    return qw * scale, qx * scale, qy * scale, qz * scale


@njit(cache=True)
def matrix_core(qw, qx, qy, qz):
    """Return the rotation matrix R_WB of a unit q, row by row."""
    return (
        1.0 - 2.0 * (qy * qy + qz * qz),
        2.0 * (qx * qy - qw * qz),
        2.0 * (qx * qz + qw * qy),
        2.0 * (qx * qy + qw * qz),
        1.0 - 2.0 * (qx * qx + qz * qz),
        2.0 * (qy * qz - qw * qx),
        2.0 * (qx * qz - qw * qy),
        2.0 * (qy * qz + qw * qx),
        1.0 - 2.0 * (qx * qx + qy * qy),
    )


@njit(cache=True)
def euler_core(qw, qx, qy, qz):
    """Return roll, pitch, yaw of a quaternion of any length [rad]; roll is 0 at a pitch of ±90°."""
    sin_pitch = 2.0 * (qw * qy - qx * qz)
    r00 = qw * qw + qx * qx - qy * qy - qz * qz
    r10 = 2.0 * (qx * qy + qw * qz)
    cos_pitch = math.hypot(r00, r10)
    pitch = math.atan2(sin_pitch, cos_pitch)
    if cos_pitch < GIMBAL_LOCK * abs(sin_pitch):
        return 0.0, pitch, math.atan2(2.0 * (qw * qz - qx * qy), qw * qw - qx * qx + qy * qy - qz * qz)
    roll = math.atan2(2.0 * (qy * qz + qw * qx), qw * qw - qx * qx - qy * qy + qz * qz)
    return roll, pitch, math.atan2(r10, r00)


@njit(cache=True)
def roll_pitch_of_up_core(x, y, z):
    """Return roll and pitch [rad] for the body components of the world's z axis.

    Zeros of any sign are level.
    """
    return math.atan2(y, z + 0.0), math.atan2(-x, math.hypot(y, z))


@njit(cache=True)
def from_euler_core(roll, pitch, yaw):
    """Return the quaternion of roll, pitch, yaw [rad], intrinsic z-y'-x''."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@njit(cache=True, error_model="numpy")
def from_rotvec_core(x, y, z):
    """Return the exponential map of v, the rotation by the angle |v| [rad] about v."""
    angle = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), scale * x, scale * y, scale * z


# --- the same equations over arrays ---------------------------------------------------------------


@njit(cache=True)
def _multiply(p, q, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = multiply_core(
            p[i, 0], p[i, 1], p[i, 2], p[i, 3], q[i, 0], q[i, 1], q[i, 2], q[i, 3]
        )


@njit(cache=True)
def _rotate(q, v, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = rotate_core(
            q[i, 0], q[i, 1], q[i, 2], q[i, 3], v[i, 0], v[i, 1], v[i, 2]
        )


@njit(cache=True)
def _euler(q, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = euler_core(q[i, 0], q[i, 1], q[i, 2], q[i, 3])


@njit(cache=True)
def roll_pitch_rows(v, out):
    """Compute `roll_pitch_of_up` of rows (n, 3), and write to rows (n, 2)."""
    for i in range(len(out)):
        out[i, 0], out[i, 1] = roll_pitch_of_up_core(v[i, 0], v[i, 1], v[i, 2])


@njit(cache=True)
def _from_euler(v, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = from_euler_core(v[i, 0], v[i, 1], v[i, 2])


@njit(cache=True)
def _from_rotvec(v, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = from_rotvec_core(v[i, 0], v[i, 1], v[i, 2])


@njit(cache=True)
def _matrix(q, out):
    for i in range(len(out)):
        row = matrix_core(q[i, 0], q[i, 1], q[i, 2], q[i, 3])
        for k in range(9):
            out[i, k] = row[k]


def _over_arrays(loop: Callable[..., None], size: int, *operands: Array) -> Array:
    """Return results (..., size) of a compiled loop over operands (..., components), which broadcast."""
    leading = operands[0].shape[:-1]
    if any(each.shape[:-1] != leading for each in operands):
        leading = np.broadcast_shapes(*(each.shape[:-1] for each in operands))
    count = math.prod(leading)
    rows = []
    for each in operands:
        if each.shape[:-1] != leading or not each.flags.carray:  # the one layout that is compiled
            repeated = np.empty((*leading, each.shape[-1]))
            repeated[...] = each
            each = repeated
        rows.append(each.reshape(count, each.shape[-1]))
    out = np.empty((count, size))
    loop(*rows, out)
    return out.reshape(*leading, size)


def _components(name: str, value: ArrayLike, size: int) -> Array:
    """Convert to a float64 array with `size` components in the last axis; otherwise raise ValueError."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f"{name} has shape {array.shape}; its last axis must hold {size} components")
    return array


def quat_multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Return the Hamilton product p ⊗ q, shapes (..., 4): first the rotation q, then p."""
    return _over_arrays(_multiply, 4, _components("p", p, 4), _components("q", q, 4))


def quat_conjugate(q: ArrayLike) -> Array:
    """Return the conjugate, shape (..., 4); for a unit quaternion, this is the inverse rotation."""
    return _components("q", q, 4) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate body vectors v (..., 3) to world axes by unit quaternions q (..., 4)."""
    return _over_arrays(_rotate, 3, _components("q", q, 4), _components("v", v, 3))


def quat_rotate_inverse(q: ArrayLike, v: ArrayLike) -> Array:
    """Rotate world vectors v (..., 3) to body axes by unit quaternions q (..., 4)."""
    return quat_rotate(quat_conjugate(q), v)


def quat_normalize(q: ArrayLike) -> Array:
    """Normalise quaternions (..., 4) to length 1.

    Raises:
        ValueError: A quaternion is zero or not finite.
    """
    array = _components("q", q, 4)
    w, x, y, z = np.moveaxis(array, -1, 0)
    length = np.sqrt(w * w + x * x + y * y + z * z)
    if not np.all((length > 0.0) & np.isfinite(length)):
        raise ValueError("a quaternion to normalise must be finite and not zero")
    return array * (1.0 / length)[..., None]


def euler_from_quat(q: ArrayLike) -> Array:
    """Return roll, pitch, yaw (..., 3) [rad] of quaternions (..., 4)."""
    return _over_arrays(_euler, 3, _components("q", q, 4))


def roll_pitch_from_quat(q: ArrayLike) -> Array:
    """Return roll and pitch (..., 2) [rad] of quaternions (..., 4)."""
    return euler_from_quat(q)[..., :2]


def roll_pitch_of_up(up: ArrayLike) -> Array:
    """Return roll and pitch (..., 2) [rad] from the world's z axis in body axes (..., 3), of any length.

    The equations are roll = atan2(u_y, u_z) and pitch = atan2(-u_x, √(u_y² + u_z²)).
    """
    return _over_arrays(roll_pitch_rows, 2, _components("up", up, 3))


def quat_from_euler(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Return quaternions (..., 4) of roll, pitch and yaw [rad], which broadcast."""
    angles = np.broadcast_arrays(*(np.asarray(angle, dtype=np.float64) for angle in (roll, pitch, yaw)))
    return _over_arrays(_from_euler, 4, np.stack(angles, axis=-1))


def quat_from_roll_pitch(roll_pitch: ArrayLike, yaw: ArrayLike = 0.0) -> Array:
    """Return quaternions (..., 4) of roll and pitch (..., 2) [rad] with the given yaw [rad]."""
    angles = _components("roll_pitch", roll_pitch, 2)
    return quat_from_euler(angles[..., 0], angles[..., 1], yaw)


def quat_from_rotvec(v: ArrayLike) -> Array:
    """Return quaternions (..., 4) of rotation vectors (..., 3) [rad]."""
    return _over_arrays(_from_rotvec, 4, _components("v", v, 3))


def matrix_from_quat(q: ArrayLike) -> Array:
    """Return rotation matrices R_WB (..., 3, 3) of unit quaternions (..., 4)."""
    flat = _over_arrays(_matrix, 9, _components("q", q, 4))
    return flat.reshape(*flat.shape[:-1], 3, 3)


def quat_from_matrix(R: ArrayLike) -> Array:
    """Return quaternions (..., 4) with w ≥ 0 of rotation matrices (..., 3, 3)."""
    from scipy.spatial.transform import Rotation  # takes a tenth of a second

    return Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True)


# --- other orders and frames ----------------------------------------------------------------------


def xyzw_from_wxyz(q: ArrayLike) -> Array:
    """Convert scalar-first quaternions to scalar-last ones (ROS, SciPy), shape (..., 4)."""
    return np.roll(_components("q", q, 4), -1, axis=-1)


def wxyz_from_xyzw(q: ArrayLike) -> Array:
    """Convert scalar-last quaternions (ROS, SciPy) to scalar-first ones, shape (..., 4)."""
    return np.roll(_components("q", q, 4), 1, axis=-1)


def swap_flu_frd(v: ArrayLike) -> Array:
    """Convert body vectors (..., 3) from forward-left-up to forward-right-down axes, or back."""
    return _components("v", v, 3) * np.array([1.0, -1.0, -1.0])


def swap_enu_ned(v: ArrayLike) -> Array:
    """Convert world vectors (..., 3) from east-north-up to north-east-down axes, or back."""
    return _components("v", v, 3)[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def swap_enu_flu_ned_frd(q: ArrayLike) -> Array:
    """Convert attitudes (..., 4) from FLU body in ENU world to FRD body in NED world, or back."""
    world = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])
    return quat_multiply(world, quat_multiply(q, np.array([0.0, 1.0, 0.0, 0.0])))
