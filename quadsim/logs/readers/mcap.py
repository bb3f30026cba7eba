"""Topics and messages of MCAP files in the encodings of ROS 2, ROS 1 and Foxglove's JSON."""

import json
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

ROS = {"ros2msg": "deserialize_cdr", "ros1msg": "deserialize_ros1"}
"""For each schema encoding, the method of a rosbags typestore that decodes messages."""


class Topic(NamedTuple):
    """A topic of a log, with the number and the kind of its messages."""

    name: str
    kind: str
    """Message type in the notation of ROS 2 (sensor_msgs/msg/Imu) or Foxglove (foxglove.PoseInFrame)."""
    messages: int


Message = tuple[Topic, float, Any]
"""Topic, time of reception [s], and an object with the fields of the message."""
Opened = tuple[list[Topic], Callable[[Collection[str]], Iterator[Message]]]
"""Readable topics of a log, and a function that iterates over the messages of named topics."""


@contextmanager
def open_mcap(path: Path) -> Iterator[Opened]:
    """Return topics of an MCAP file and its messages in order of time; Protobuf topics are omitted.

    Raises:
        ValueError: The file is truncated, or none of its topics has a supported encoding.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        reader, summary = make_reader(stream), None
        with suppress(McapError):
            summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError(f"{path}: damaged, or cut off: no summary at its end; `mcap recover` makes one")
        topics, decoders, others = {}, {}, set()
        for number, channel in summary.channels.items():
            schema = summary.schemas.get(channel.schema_id)
            if schema is None or (decode := _decoder(schema, channel.message_encoding)) is None:
                others.add(channel.message_encoding)
                continue
            count = summary.statistics.channel_message_counts.get(number, 0)
            topics[number], decoders[number] = Topic(channel.topic, _kind(schema.name), count), decode
        if others and not topics:
            raise ValueError(f"{path}: messages in {', '.join(sorted(others))}; JSON and ROS can be read")

        def messages(wanted: Collection[str]) -> Iterator[Message]:
            for _, channel, message in reader.iter_messages(wanted):
                if channel.id in topics:
                    yield topics[channel.id], message.log_time * 1e-9, decoders[channel.id](message.data)

        yield list(topics.values()), messages


def _decoder(schema: Any, encoding: str) -> Callable[[bytes], Any] | None:
    """Return a function that decodes the bytes of a message; None for an unknown encoding."""
    if encoding == "json":
        return partial(json.loads, object_hook=lambda fields: SimpleNamespace(**fields))
    if schema.encoding not in ROS or encoding not in ("cdr", "ros1"):
        return None
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
    store.register(get_types_from_msg(schema.data.decode(), name))
    return partial(getattr(store, ROS[schema.encoding]), typename=name)


def _kind(schema: str) -> str:
    """Return the name of a schema in the notation of ROS 2 or Foxglove."""
    if schema.startswith("foxglove_msgs/"):
        return f"foxglove.{schema.rpartition('/')[2]}"
    return re.sub(r"^(\w+)/(\w+)$", r"\1/msg/\2", schema)
