"""EuRoC (ASL) folders of CSV: the EuRoC MAV and TUM-VI datasets."""

import re
from pathlib import Path

import numpy as np

from ...rotation import quat_conjugate, quat_from_matrix, quat_multiply
from ..recording import Array, Recording

TRUTHS = {
    "state_groundtruth_estimate0": "the dataset's ground truth",
    "mocap0": "motion capture",
    "vicon0": "Vicon poses",
}
"""Folders with stamp, position and quaternion, the most accurate first."""


def euroc_folder(path: Path) -> Path | None:
    """Return the folder of a sequence that contains imu0; None if there is none."""
    places = [path, path / "mav0", *sorted(path.glob("*/mav0"))]
    return next((place for place in places if (place / "imu0" / "data.csv").is_file()), None)


def read_euroc(path: Path, truth: str | None = None) -> Recording:
    """Read imu0, rotated by its T_BS into the body axes of the dataset, and the ground truth.

    In EuRoC, the body axes are those of the IMU, with x up. A mount rotates both readings and ground truth.

    Args:
        path: The folder of a sequence, or its subfolder mav0.
        truth: Folder of the true attitude; None for the first existing one of TRUTHS.
    """
    folder = euroc_folder(path)
    if folder is None:
        raise ValueError(f"{path}: no imu0/data.csv, not an EuRoC sequence")
    if folder.parent.parent == path and len(more := sorted(path.glob("*/mav0"))) > 1:
        raise ValueError(f"{path} holds {len(more)} sequences: give one, such as {more[0].parent}")
    imu = _numbers(folder / "imu0" / "data.csv", 7)
    body_from_sensor = _rotation(folder / "imu0" / "sensor.yaml")
    gyro, accel = (imu[:, part] @ body_from_sensor.T for part in (slice(1, 4), slice(4, 7)))
    notes = [] if np.allclose(body_from_sensor, np.eye(3)) else ["IMU turned into body axes by its T_BS"]
    name = path.name if path.name != "mav0" else path.parent.name
    log = Recording(name, "EuRoC (ASL) CSV", imu[:, 0] * 1e-9, gyro, accel, notes=tuple(notes))
    chosen = truth or next((each for each in TRUTHS if (folder / each / "data.csv").is_file()), None)
    if chosen is None:
        return log
    poses = _numbers(folder / chosen / "data.csv", 8)
    quat = poses[:, 4:8]
    if chosen == "vicon0":  # q_RS of the marker frame; the others are of the body itself
        turn = quat_from_matrix(_rotation(folder / chosen / "sensor.yaml"))
        quat = quat_multiply(quat, quat_conjugate(turn))
    kind = f"{chosen}: {TRUTHS.get(chosen, 'as asked for')}"
    return log.with_truth(kind, poses[:, 0] * 1e-9, quat, poses[:, 1:4], own_axes=True)


def _numbers(file: Path, least: int) -> Array:
    if not file.is_file():
        raise FileNotFoundError(f"{file}: no such file")
    try:
        values = np.loadtxt(file, delimiter=",", ndmin=2, comments="#")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    if values.shape[1] < least or len(values) < 2:
        raise ValueError(f"{file}: {values.shape} numbers, at least {least} columns and 2 rows are required")
    return values


def _rotation(file: Path) -> Array:
    """Return the rotation of T_BS in a sensor.yaml; the identity if there is none."""
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    found = re.search(r"T_BS:.*?data:\s*\[([^\]]*)\]", text, re.DOTALL)
    if found is None:
        return np.eye(3)
    return np.array([float(each) for each in found.group(1).split(",")]).reshape(4, 4)[:3, :3]
