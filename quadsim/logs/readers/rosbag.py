"""ROS 1 and ROS 2 bags, through rosbags: FLU body axes in an ENU world, as REP 103 has it."""

from pathlib import Path
from typing import Any

import numpy as np

from ..recording import OWN_ESTIMATE, Recording

IMU = "sensor_msgs/msg/Imu"
POSES = {
    "geometry_msgs/msg/PoseStamped": ("pose", "position", "orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose", "position", "orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform", "translation", "rotation"),
    "nav_msgs/msg/Odometry": ("pose.pose", "position", "orientation"),
}
"""Messages that hold a pose, the most likely motion capture first, and where in them it is."""


def read_rosbag(path: Path, imu: str | None = None, truth: str | None = None) -> Recording:
    """Read the IMU topic and a pose topic.

    Args:
        path: A .bag file (ROS 1), or a ROS 2 bag's folder, .db3 or .mcap, in its folder or alone.
        imu: Topic of the IMU; None for the one with the most messages.
        truth: Topic of the true attitude; None for the first kind of POSES that is there, and failing that
            the orientation in the IMU's own messages.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    default = get_typestore(Stores.ROS2_HUMBLE)
    in_folder = path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").is_file()
    readings, poses, own = [], [], []
    try:
        with AnyReader([path.parent if in_folder else path], default_typestore=default) as reader:
            imu_topic = _topic(reader, path, imu, [IMU])
            if imu_topic is None:
                raise ValueError(f"{path}: no topic of {IMU}; topics: {_all_topics(reader)}")
            pose_topic = _topic(reader, path, truth, list(POSES))
            wanted = [each for each in reader.connections if each.topic in (imu_topic, pose_topic)]
            for connection, received, raw in reader.messages(connections=wanted):
                message: Any = reader.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 or received * 1e-9
                if connection.topic != imu_topic:
                    poses.append((stamp, *_pose(message, connection.msgtype)))
                    continue
                readings.append((stamp, *_xyz(message.angular_velocity), *_xyz(message.linear_acceleration)))
                q = message.orientation
                if message.orientation_covariance[0] != -1.0 and abs(q.w) + sum(map(abs, _xyz(q))) > 0.5:
                    own.append((stamp, q.w, *_xyz(q)))
    except AnyReaderError as error:
        raise ValueError(f"{path}: {error}") from error
    time, gyro, accel = _columns(readings, 1, 3, 3)
    log = Recording(path.name, "ROS bag", time[:, 0], gyro, accel, notes=(f"IMU from {imu_topic}",))
    if poses:
        time, position, quat = _columns(poses, 1, 3, 4)
        return log.with_truth(f"{pose_topic}: poses", time[:, 0], quat, position)
    if own:
        time, quat = _columns(own, 1, 4)
        return log.with_truth(f"{imu_topic}: the sensor's {OWN_ESTIMATE}", time[:, 0], quat, own_axes=True)
    return log


def _pose(message: Any, kind: str) -> tuple[float, ...]:
    """Position and quaternion (w, x, y, z)."""
    place, position, orientation = POSES[kind]
    for name in place.split("."):
        message = getattr(message, name)
    q = getattr(message, orientation)
    return (*_xyz(getattr(message, position)), q.w, *_xyz(q))


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _columns(rows: list[tuple[float, ...]], *widths: int) -> list[np.ndarray]:
    return np.split(np.array(rows, np.float64), np.cumsum(widths)[:-1], axis=1)


def _topic(reader: Any, path: Path, asked: str | None, kinds: list[str]) -> str | None:
    """The topic asked for, or else that of the first kind with the most messages; None if there is none."""
    found = [each for each in reader.connections if each.msgtype in kinds and asked in (None, each.topic)]
    if asked is not None and not found:
        raise ValueError(f'{path}: no topic "{asked}" of the right kind; topics: {_all_topics(reader)}')
    found.sort(key=lambda each: (kinds.index(each.msgtype), -each.msgcount, each.topic))
    return found[0].topic if found else None


def _all_topics(reader: Any) -> str:
    return ", ".join(sorted(f"{each.topic} ({each.msgtype})" for each in reader.connections)) or "none"
