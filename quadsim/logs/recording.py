"""A log before resampling, and its conversion to FLU body axes and a world with z up."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..rotation import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_from_matrix,
    quat_multiply,
    swap_enu_flu_ned_frd,
    swap_enu_ned,
    swap_flu_frd,
)

Array = NDArray[np.float64]
AxesConvention = Literal["flu", "frd"]
"""Axes of a log: body forward-left-up in a world with z up (ROS), or forward-right-down in north-east-down
(PX4)."""
TruthAxes = Literal["body", "imu"]
"""Whether a true attitude is that of the body or that of the IMU's own axes. The latter holds for estimates
by the sensor or the autopilot, and for datasets whose body frame is that of the IMU."""

IN_BODY_AXES = ("mag",)
"""Sensors other than the IMU that measure a vector in IMU axes."""
FORMS = (
    'body axes as IMU axes ("z,-y,x"), Euler angles in degrees ("rpy 0 20 90"), a quaternion w x y z '
    "(4 numbers), or a matrix by rows (9 numbers)"
)
TOLERANCE = 0.01
"""Tolerance for rounding errors in the length of a quaternion and the orthogonality of a matrix."""
OWN_ESTIMATE = "own estimate, which is no independent truth"
"""Note of readers about an attitude that the sensor or the autopilot estimated."""


class Track(NamedTuple):
    """Readings of a sensor other than the IMU, with their own time stamps."""

    time: Array
    """Time stamps (K,) [s]."""
    values: Array
    """Readings (K, ·)."""


@dataclass(frozen=True)
class Recording:
    """One log as recorded, with its own time stamps."""

    name: str
    format: str
    time: Array
    """Stamps of the IMU (T,) [s]."""
    gyro: Array
    """Body rate (T, 3) [rad/s]."""
    accel: Array
    """Specific force (T, 3) [m/s²]."""
    truth: str = "none"
    """Source of the true attitude."""
    truth_time: Array | None = None
    """Stamps of the attitude (M,) [s]."""
    quat: Array | None = None
    """True attitude quat_WB (M, 4); NaN where the recording marks the attitude as invalid."""
    truth_axes: TruthAxes = "body"
    """Whether the true attitude is that of the body or of the IMU's own axes."""
    position: Array | None = None
    """Position in world axes at the stamps of the attitude (M, 3) [m]."""
    marked: NDArray[np.bool_] | None = None
    """Samples of the attitude (M,) that the recording marks for scoring; None for all."""
    path: str = "LOG"
    """The file, for suggested commands."""
    notes: tuple[str, ...] = ()
    """Decisions of the reader, in sentences."""
    sensors: Mapping[str, Track] = field(default_factory=dict)
    """Sensors other than the IMU, with names and units as in `quadsim.estimator.Readings`."""

    def with_truth(
        self, truth: str, time: Array, quat: Array, position: Array | None = None, own_axes: bool = False
    ) -> "Recording":
        """Add a true attitude; with `own_axes`, the attitude is that of the IMU's own axes."""
        axes: TruthAxes = "imu" if own_axes else "body"
        return replace(self, truth=truth, truth_time=time, quat=quat, position=position, truth_axes=axes)

    def rotated(self, body_from_log: Array, note: str) -> "Recording":
        """Rotate all vectors by a matrix (3, 3) from the axes of the log.

        The true attitude is not changed.
        """
        sensors = {
            name: Track(track.time, track.values @ body_from_log.T) if name in IN_BODY_AXES else track
            for name, track in self.sensors.items()
        }
        gyro, accel = self.gyro @ body_from_log.T, self.accel @ body_from_log.T
        return replace(self, gyro=gyro, accel=accel, sensors=sensors, notes=(*self.notes, note))


def from_frd(log: Recording) -> Recording:
    """Convert a log from FRD body axes and an NED world to FLU body axes and a world with z up."""
    note = "FRD body axes in an NED world turned into FLU axes in a world with z up"
    return replace(
        log.rotated(swap_flu_frd(np.eye(3)), note),
        quat=None if log.quat is None else swap_enu_flu_ned_frd(log.quat),
        position=None if log.position is None else swap_enu_ned(log.position),
    )


def mount_matrix(mount: str) -> Array:
    """Parse a rotation from IMU axes to body axes, (3, 3): body vector = matrix @ IMU vector.

    Args:
        mount: Words separated by commas or spaces, one of
            body x, y, z as axes of the IMU, such as "z,-y,x" for an IMU with x up and z forward;
            roll, pitch and yaw of the IMU with respect to the body in degrees (intrinsic z-y'-x''), such as
            "rpy 0 20 90";
            the quaternion (w, x, y, z) from IMU to body axes;
            the nine numbers of the matrix by rows.

    Raises:
        ValueError: The text has another format or is not a rotation.
    """
    words = mount.replace(",", " ").split()
    signed = ["x", "y", "z", "-x", "-y", "-z"]
    axes: dict[str, Array] = dict(zip(signed, np.vstack([np.eye(3), -np.eye(3)]), strict=True))
    is_euler = words[:1] == ["rpy"]
    try:
        if words and all(word.lstrip("+") in axes for word in words):
            numbers = np.concatenate([axes[word.lstrip("+")] for word in words])
        else:
            numbers = np.array([float(word) for word in words[is_euler:]])
    except ValueError:
        numbers = np.empty(0)
    if is_euler and len(numbers) == 3 and np.isfinite(numbers).all():
        return matrix_from_quat(quat_from_euler(*np.radians(numbers)))
    if is_euler or numbers.size not in (4, 9):
        raise ValueError(f'mount "{mount}": should be {FORMS}')
    if numbers.size == 4:
        length = float(np.linalg.norm(numbers))
        if not abs(length - 1.0) <= TOLERANCE:
            raise ValueError(f"mount {mount}: a quaternion of length {length:.3g}, and a rotation's is 1")
        return matrix_from_quat(numbers / length)
    matrix = numbers.reshape(3, 3)
    error = np.abs(matrix @ matrix.T - np.eye(3)).max() if np.isfinite(matrix).all() else np.inf
    if error > TOLERANCE or np.linalg.det(matrix) < 0:
        raise ValueError(f"mount {mount}: no rotation: its rows are not three orthogonal axes, right-handed")
    return matrix if error == 0.0 else np.asarray(Rotation.from_matrix(matrix).as_matrix())


def mount_text(body_from_imu: Array) -> str:
    """Format a rotation (3, 3) for `--mount`: axes for a permutation, otherwise Euler angles [deg]."""
    nearest = np.rint(body_from_imu)
    if np.abs(body_from_imu - nearest).max() < 1e-6:
        return ",".join(("-" if row.min() < 0 else "") + "xyz"[np.abs(row).argmax()] for row in nearest)
    yaw, pitch, roll = Rotation.from_matrix(body_from_imu).as_euler("ZYX", degrees=True)
    return "rpy " + " ".join(f"{round(float(angle), 2) + 0.0:.2f}" for angle in (roll, pitch, yaw))


def mounted(log: Recording, body_from_imu: Array) -> Recording:
    """Convert a log from IMU axes to body axes.

    All readings are rotated. The true attitude is rotated only if it is that of the IMU's own axes
    (`Recording.truth_axes`).

    Args:
        log: The log in IMU axes.
        body_from_imu: Rotation from IMU to body axes (3, 3).
    """
    quat = log.quat
    if quat is not None and log.truth_axes == "imu":
        quat = quat_multiply(quat, quat_conjugate(quat_from_matrix(body_from_imu)))
    return replace(log.rotated(body_from_imu, f"IMU mounted {mount_text(body_from_imu)}"), quat=quat)
