"""How an IMU sits in the body: the rotation from its axes to the body's, as it is written and applied."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..rotation import matrix_from_quat, quat_conjugate, quat_from_euler, quat_from_matrix, quat_multiply
from .recording import Array, Recording

Mount = str | Sequence[float] | Sequence[Sequence[float]]
"""A rotation as it is written: see `mount_matrix`."""

FORMS = (
    'body axes as IMU axes ("z,-y,x"), Euler angles in degrees ("rpy 0 20 90"), a quaternion w x y z '
    "(4 numbers), or a matrix by rows (9 numbers)"
)
TOLERANCE = 0.01
"""A quaternion's length and a matrix' products of columns may differ from a rotation's by this: rounding."""


def mount_matrix(mount: Mount) -> Array:
    """Rotation from IMU to body axes, (3, 3): body vector = matrix @ IMU vector.

    Args:
        mount: One of
            body x, y, z as axes of the IMU, such as "z,-y,x" for an IMU with x up and z forward;
            roll, pitch and yaw of the IMU with respect to the body in degrees (intrinsic z-y'-x''), such as
            "rpy 0 20 90";
            the quaternion (w, x, y, z) from IMU to body axes;
            the matrix itself, (3, 3) or its nine numbers by rows.
            Numbers in a text are separated by commas or spaces.

    Raises:
        ValueError: None of these, or no rotation.
    """
    if not isinstance(mount, str):
        return _from_numbers(np.ravel(mount).tolist(), mount)
    words = mount.replace(",", " ").split()
    if words and all(word.lstrip("+-") in ("x", "y", "z") for word in words):
        return _from_axes(words, mount)
    is_euler = words[:1] == ["rpy"]
    try:
        numbers = [float(word) for word in (words[1:] if is_euler else words)]
    except ValueError:
        raise ValueError(f'mount "{mount}": should be {FORMS}') from None
    if is_euler:
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise ValueError(f'mount "{mount}": rpy takes roll, pitch and yaw, such as "rpy 0 20 90"')
        return matrix_from_quat(quat_from_euler(*np.radians(numbers)))
    return _from_numbers(numbers, mount)


def mount_text(body_from_imu: Array) -> str:
    """A rotation (3, 3) as `--mount` takes it: axes where it is a permutation, else Euler angles [deg]."""
    nearest = np.rint(body_from_imu)
    if np.abs(body_from_imu - nearest).max() < 1e-6:
        columns = np.abs(nearest).argmax(axis=1)
        return ",".join(
            ("-" if nearest[row, k] < 0 else "") + "xyz"[k] for row, k in enumerate(columns.tolist())
        )
    yaw, pitch, roll = Rotation.from_matrix(body_from_imu).as_euler("ZYX", degrees=True)
    return "rpy " + " ".join(f"{round(float(angle), 2) + 0.0:.2f}" for angle in (roll, pitch, yaw))


def mounted(log: Recording, mount: Mount) -> Recording:
    """A log of an IMU that is mounted in another way, in body axes.

    Readings are rotated from IMU to body axes. So is the attitude where it is the IMU's own
    (`Recording.truth_axes`); an attitude of the body is left as it is.

    Args:
        log: In IMU axes.
        mount: Rotation from IMU to body axes: see `mount_matrix`.

    Raises:
        ValueError: No rotation.
    """
    body_from_imu = mount_matrix(mount)
    quat = log.quat
    if quat is not None and log.truth_axes == "imu":
        quat = quat_multiply(quat, quat_conjugate(quat_from_matrix(body_from_imu)))
    return replace(
        log,
        gyro=log.gyro @ body_from_imu.T,
        accel=log.accel @ body_from_imu.T,
        quat=quat,
        notes=(*log.notes, f"IMU mounted {mount_text(body_from_imu)}"),
        sensors=log.with_vectors(body_from_imu),
    )


def _from_axes(words: list[str], mount: str) -> Array:
    """Rows of the identity, with signs."""
    matrix = np.zeros((len(words), 3))
    for row, word in enumerate(words):
        matrix[row, "xyz".index(word[-1])] = -1.0 if word.startswith("-") else 1.0
    if matrix.shape != (3, 3) or abs(np.linalg.det(matrix)) < 0.5:
        raise ValueError(f'mount "{mount}": three different axes are required, for example "z,-y,x"')
    return _proper(matrix, mount)


def _from_numbers(numbers: Sequence[float], mount: Mount) -> Array:
    """Matrix of a quaternion or of nine numbers."""
    values = np.array(numbers, np.float64)
    if values.size == 4:
        length = float(np.linalg.norm(values))
        if not abs(length - 1.0) <= TOLERANCE:
            raise ValueError(f"mount {mount}: a quaternion of length {length:.3g}, and a rotation's is 1")
        return matrix_from_quat(values / length)
    if values.size != 9:
        raise ValueError(f"mount {mount}: {values.size} numbers; should be {FORMS}")
    matrix = values.reshape(3, 3)
    error = np.abs(matrix @ matrix.T - np.eye(3)).max() if np.isfinite(matrix).all() else np.inf
    if error > TOLERANCE:
        raise ValueError(
            f"mount {mount}: no rotation: matrix times its transpose is off the identity by {error:.2g}"
        )
    return np.asarray(Rotation.from_matrix(_proper(matrix, mount)).as_matrix())


def _proper(matrix: Array, mount: Mount) -> Array:
    if np.linalg.det(matrix) < 0:
        raise ValueError(f"mount {mount}: a mirror image, not a rotation: turn one sign")
    return matrix
