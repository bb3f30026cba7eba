"""ROS 1 and ROS 2 bags, through rosbags: FLU body axes in an ENU world, as REP 103 has it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..recording import Recording
from .needs import needed

IMU = "sensor_msgs/msg/Imu"
POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
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
    highlevel = needed("rosbags.highlevel", "logs")
    stores = needed("rosbags.typesys", "logs")
    default = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    in_folder = path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").is_file()
    bag = path.parent if in_folder else path
    try:
        with highlevel.AnyReader([bag], default_typestore=default) as reader:
            imu_topic = _topic(reader, path, imu, [IMU])
            if imu_topic is None:
                raise ValueError(f"{path}: no topic of {IMU}; topics: {_all_topics(reader)}")
            pose_topic = _topic(reader, path, truth, list(POSES))
            read = _Read()
            wanted = [each for each in reader.connections if each.topic in (imu_topic, pose_topic)]
            for connection, stamp, raw in reader.messages(connections=wanted):
                message = reader.deserialize(raw, connection.msgtype)
                read.add(message, connection.topic == imu_topic, connection.msgtype, stamp)
    except highlevel.AnyReaderError as error:
        raise ValueError(f"{path}: {error}") from error
    return read.recording(path, imu_topic, pose_topic)


class _Read:
    """What has been read of a bag so far."""

    def __init__(self) -> None:
        self.imu: list[tuple[float, ...]] = []
        self.pose: list[tuple[float, ...]] = []
        self.own: list[tuple[float, ...]] = []

    def add(self, message: Any, is_imu: bool, kind: str, received: int) -> None:
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 or received * 1e-9
        if not is_imu:
            p, q = POSES[kind](message)
            self.pose.append((stamp, p.x, p.y, p.z, q.w, q.x, q.y, q.z))
            return
        w, f, q = message.angular_velocity, message.linear_acceleration, message.orientation
        self.imu.append((stamp, w.x, w.y, w.z, f.x, f.y, f.z))
        if message.orientation_covariance[0] != -1.0 and abs(q.w) + abs(q.x) + abs(q.y) + abs(q.z) > 0.5:
            self.own.append((stamp, q.w, q.x, q.y, q.z))

    def recording(self, path: Path, imu_topic: str, pose_topic: str | None) -> Recording:
        imu = np.array(self.imu, np.float64)
        truth, truth_time, quat, position = "none", None, None, None
        if pose_topic is not None and self.pose:
            poses = np.array(self.pose, np.float64)
            truth, truth_time = f"{pose_topic}: poses", poses[:, 0]
            quat, position = poses[:, 4:8], poses[:, 1:4]
        elif self.own:
            own = np.array(self.own, np.float64)
            truth_time, quat = own[:, 0], own[:, 1:]
            truth = f"{imu_topic}: the sensor's own estimate, which is no independent truth"
        return Recording(
            path.name, "ROS bag", imu[:, 0], imu[:, 1:4], imu[:, 4:7], truth=truth, truth_time=truth_time,
            quat=quat, truth_axes="imu" if position is None else "body", position=position,
            notes=(f"IMU from {imu_topic}",),
        )  # fmt: skip


def _topic(reader: Any, path: Path, asked: str | None, kinds: list[str]) -> str | None:
    if asked is not None:
        if not any(each.topic == asked and each.msgtype in kinds for each in reader.connections):
            raise ValueError(f'{path}: no topic "{asked}" of the right kind; topics: {_all_topics(reader)}')
        return asked
    found = [each for each in reader.connections if each.msgtype in kinds]
    found.sort(key=lambda each: (kinds.index(each.msgtype), -each.msgcount, each.topic))
    return found[0].topic if found else None


def _all_topics(reader: Any) -> str:
    return ", ".join(sorted(f"{each.topic} ({each.msgtype})" for each in reader.connections)) or "none"
