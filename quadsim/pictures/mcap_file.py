"""A flight as an MCAP file with JSON messages for Foxglove.

The topics are /body, the true pose (foxglove.PoseInFrame); /frames/body and /frames/ESTIMATOR
(foxglove.FrameTransform); /scene (foxglove.SceneUpdate); /imu (sensor_msgs/Imu); /traces/NAME; and /spikes,
which lists the neurons that spike at a time, by population.
"""

import heapq
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .timeline import BODY, Array, SpikeRaster, Timeline, outline, styles

Json = dict[str, Any]
IMU, SCENE = "sensor_msgs/Imu", "foxglove.SceneUpdate"
NO_ORIENTATION = [-1.0] + 8 * [0.0]  # as ROS has it for a sensor without one
OTHER_SHAPES = "metadata", "arrows", "cubes", "spheres", "cylinders", "triangles", "texts", "models"
ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}
AT_ORIGIN = {"position": ORIGIN, "orientation": ORIGIN | {"w": 1.0}}
LINE: Json = {"type": 0, "pose": AT_ORIGIN, "thickness": 0.008, "scale_invariant": False}
LINE |= {"colors": [], "indices": []}
JSON_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string"}


class McapChannel(NamedTuple):
    """All messages of a topic."""

    name: str
    schema: str
    time: Array  #: (M,) [s]
    contents: list[Json]  #: without their stamps, (M,)

    def messages(self) -> Iterator[tuple[int, str, Json]]:
        """Time [ns], topic and content of each message."""
        for ns, content in zip(np.rint(1e9 * self.time).astype(int).tolist(), self.contents, strict=True):
            yield ns, self.name, self.stamped(ns, content)

    def stamped(self, ns: int, content: Json) -> Json:
        """Return a message content with time stamps in the formats of ROS and Foxglove."""
        stamp = {"sec": ns // 10**9, "nsec": ns % 10**9}
        heads = {IMU: {"header": {"stamp": stamp, "frame_id": BODY}}, SCENE: {}}
        return heads.get(self.schema, {"timestamp": stamp}) | content


def write_mcap(path: Path, timeline: Timeline) -> None:
    """Write an MCAP file whose time starts at 0 s.

    Args:
        path: File to write, `.mcap`.
        timeline: The flight to show.
    """
    from mcap.writer import Writer

    topics = [each for each in _topics(timeline) if each.contents]
    with path.open("wb") as stream:
        writer, channels = Writer(stream), {}
        writer.start(library="quadsim")
        for topic in topics:
            fields = {name: value for content in topic.contents for name, value in content.items()}
            described = json.dumps(_schema(topic.stamped(0, fields))).encode()
            schema = writer.register_schema(topic.schema, "jsonschema", described)
            channels[topic.name] = writer.register_channel(topic.name, "json", schema)
        for ns, name, content in heapq.merge(*(each.messages() for each in topics), key=itemgetter(0)):
            writer.add_message(channels[name], ns, json.dumps(content).encode(), ns)
        writer.finish()


def _topics(timeline: Timeline) -> Iterator[McapChannel]:
    yield McapChannel("/scene", SCENE, timeline.time[:1], [_scene(timeline)])
    for name, quat in timeline.poses.items():
        known = np.isfinite(np.hstack([timeline.position, quat])).all(axis=1)
        time, frames = timeline.time[known], {"parent_frame_id": "world", "child_frame_id": name}
        poses = list(zip(_rows("xyz", timeline.position[known]), _rows("wxyz", quat[known]), strict=True))
        moves = [frames | {"translation": at, "rotation": turn} for at, turn in poses]
        yield McapChannel(f"/frames/{_plain(name)}", "foxglove.FrameTransform", time, moves)
        if name == BODY:
            true = [
                {"frame_id": "world", "pose": {"position": at, "orientation": turn}} for at, turn in poses
            ]
            yield McapChannel("/body", "foxglove.PoseInFrame", time, true)
    known = np.isfinite(np.hstack([timeline.gyro, timeline.accel])).all(axis=1)
    readings = zip(_rows("xyz", timeline.gyro[known]), _rows("xyz", timeline.accel[known]), strict=True)
    unknown = {"orientation": AT_ORIGIN["orientation"], "orientation_covariance": NO_ORIENTATION}
    samples = [unknown | {"angular_velocity": rate, "linear_acceleration": force} for rate, force in readings]
    yield McapChannel("/imu", IMU, timeline.time[known], samples)
    for name, trace in timeline.traces.items():
        rows = _rows(map(_plain, trace.curves), np.stack(list(trace.curves.values()), axis=1))
        yield McapChannel(f"/traces/{_plain(name)}", f"{name} [{trace.unit}]", timeline.time, rows)
    if timeline.spikes:
        yield _spikes(timeline.spikes)


def _spikes(populations: Mapping[str, SpikeRaster]) -> McapChannel:
    steps = np.unique(np.concatenate([spikes.time for spikes in populations.values()]))
    rows: list[Json] = [{} for _ in steps]
    for name, (time, neuron) in populations.items():
        at, first = np.unique(time, return_index=True)
        parts = np.split(neuron, first[1:])
        for k, part in zip(np.searchsorted(steps, at), parts, strict=True):
            rows[k][_plain(name)] = part.tolist()
    return McapChannel("/spikes", "spikes", steps, rows)


def _scene(timeline: Timeline) -> Json:
    """Return the outlines of the vehicle, which move with the frames of the poses."""
    start, entities = {"sec": 0, "nsec": 0}, []
    strips = [LINE | {"points": _rows("xyz", points)} for points in outline(timeline.vehicle)]
    for name, (colour, _) in zip(timeline.poses, styles(timeline.poses, timeline.poses), strict=True):
        rgb = np.divide(colour, 255).tolist()
        line = {"color": dict(zip("rgba", [*rgb, 1.0], strict=True))}
        entity = {"timestamp": start, "lifetime": start, "frame_id": name, "id": name, "frame_locked": True}
        entity |= {other: [] for other in OTHER_SHAPES}
        entities.append(entity | {"lines": [strip | line for strip in strips]})
    return {"entities": entities, "deletions": []}


def _rows(names: Iterable[str], values: Array) -> list[Json]:
    """Return the rows of an array (T, names) as dictionaries, without missing numbers."""
    keys = list(names)
    return [{key: x for key, x in zip(keys, row, strict=True) if x == x} for row in values.tolist()]


def _plain(name: str) -> str:
    """Return a name without characters that Foxglove's message paths forbid."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name)


def _schema(value: Any) -> Json:
    """Return the JSON schema of a value."""
    if isinstance(value, dict):
        return {"type": "object", "properties": {name: _schema(each) for name, each in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": _schema(value[0]) if value else {}}
    return {"type": JSON_TYPES[type(value)]}
