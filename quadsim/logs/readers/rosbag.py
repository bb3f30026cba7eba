"""Bags of ROS 1 and ROS 2, and MCAP files: FLU body axes in an ENU world (REP 103)."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from ..recording import OWN_ESTIMATE, Recording
from .mcap import Message, Opened, Topic, open_mcap

IMU = "sensor_msgs/msg/Imu"
POSES = {
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
    "nav_msgs/msg/Odometry": ("pose.pose.position", "pose.pose.orientation"),
    "foxglove.PoseInFrame": ("pose.position", "pose.orientation"),
}
"""Message types that contain a pose, most likely motion capture first, and the path to the pose."""


def read_rosbag(path: Path, imu: str | None = None, truth: str | None = None) -> Recording:
    """Read the IMU topic and a pose topic.

    Args:
        path: A .bag file (ROS 1); or a folder, .db3 or .mcap file of a ROS 2 bag.
        imu: Topic of the IMU; None for the one with the most messages.
        truth: Topic of the true attitude; None for the first type of POSES in the bag or, if there is none,
            the orientation in the IMU messages.
    """
    in_folder = path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").is_file()
    alone = path.suffix == ".mcap" and not in_folder and path.is_file()
    readings, poses, own = [], [], []
    with open_mcap(path) if alone else _open_bag(path.parent if in_folder else path) as (topics, read):
        imu_topic = _topic(topics, path, imu, [IMU])
        if imu_topic is None:
            raise ValueError(f"{path}: no topic of {IMU}; topics: {_all_topics(topics)}")
        pose_topic = _topic(topics, path, truth, list(POSES))
        for topic, received, message in read([each.name for each in (imu_topic, pose_topic) if each]):
            stamp = _stamp(message) or received
            if topic.name != imu_topic.name:
                poses.append((stamp, *_pose(message, topic.kind)))
                continue
            readings.append((stamp, *_xyz(message.angular_velocity), *_xyz(message.linear_acceleration)))
            q, covariance = (getattr(message, f"orientation{each}", None) for each in ("", "_covariance"))
            if q is None or (covariance is not None and covariance[0] == -1.0):
                continue
            if abs(q.w) + sum(map(abs, _xyz(q))) > 0.5:
                own.append((stamp, q.w, *_xyz(q)))
    rows, notes = np.array(readings, np.float64), (f"IMU from {imu_topic.name}",)
    kind = "MCAP" if alone else "ROS bag"
    log = Recording(path.name, kind, rows[:, 0], rows[:, 1:4], rows[:, 4:], notes=notes)
    if poses and pose_topic:
        rows = np.array(poses, np.float64)
        return log.with_truth(f"{pose_topic.name}: poses", rows[:, 0], rows[:, 4:], rows[:, 1:4])
    if own:
        rows, estimate = np.array(own, np.float64), f"{imu_topic.name}: the sensor's {OWN_ESTIMATE}"
        return log.with_truth(estimate, rows[:, 0], rows[:, 1:], own_axes=True)
    return log


def _pose(message: Any, kind: str) -> tuple[float, ...]:
    """Return position and quaternion (w, x, y, z)."""
    position, q = (attrgetter(name)(message) for name in POSES[kind])
    return (*_xyz(position), q.w, *_xyz(q))


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _stamp(message: Any) -> float:
    """Return the time stamp in a message [s]; 0 if there is none."""
    stamp = message.header.stamp if hasattr(message, "header") else getattr(message, "timestamp", None)
    if stamp is None:
        return 0.0
    return stamp.sec + (stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec) * 1e-9


@contextmanager
def _open_bag(path: Path) -> Iterator[Opened]:
    """Return topics and messages of a bag, as `open_mcap` does."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            topics = {each.id: Topic(each.topic, each.msgtype, each.msgcount) for each in reader.connections}

            def messages(wanted: Collection[str]) -> Iterator[Message]:
                chosen = [each for each in reader.connections if each.topic in wanted]
                for connection, received, raw in reader.messages(connections=chosen):
                    message = reader.deserialize(raw, connection.msgtype)
                    yield topics[connection.id], received * 1e-9, message

            yield list(topics.values()), messages
    except AnyReaderError as error:
        raise ValueError(f"{path}: {error}") from error


def _topic(topics: list[Topic], path: Path, asked: str | None, kinds: list[str]) -> Topic | None:
    """Return the requested topic or, by default, the topic of the first kind with most messages.

    The result is None if there is none.
    """
    found = [each for each in topics if each.kind in kinds and asked in (None, each.name)]
    if asked is not None and not found:
        raise ValueError(f'{path}: no topic "{asked}" of the right kind; topics: {_all_topics(topics)}')
    return min(found, key=lambda each: (kinds.index(each.kind), -each.messages, each.name), default=None)


def _all_topics(topics: list[Topic]) -> str:
    return ", ".join(sorted(f"{each.name} ({each.kind})" for each in topics)) or "none"
