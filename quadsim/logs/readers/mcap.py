"""Topics and messages of an MCAP file, through mcap: encodings of ROS 2 and ROS 1, and Foxglove's JSON."""

import json
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

ROS = {"ros2msg": "deserialize_cdr", "ros1msg": "deserialize_ros1"}
"""Encoding of a schema to the method of a rosbags typestore that reads its messages."""


class Topic(NamedTuple):
    """A topic of a log, and how many messages of which kind it has."""

    name: str
    kind: str
    """As ROS 2 names it, such as sensor_msgs/msg/Imu, or as Foxglove does, such as foxglove.PoseInFrame."""
    messages: int


Message = tuple[Topic, float, Any]
"""Its topic, when it was received [s], and an object with the message's fields."""
Opened = tuple[list[Topic], Callable[[Collection[str]], Iterator[Message]]]
"""Topics of a log that can be read, and a function that iterates over the messages of those named."""


@contextmanager
def open_mcap(path: Path) -> Iterator[Opened]:
    """Topics of an MCAP file, and its messages in the order of time; a topic in Protobuf is left out.

    Raises:
        ValueError: The file is cut off, or has topics, but none in an encoding that can be read.
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
    """From the bytes of a message to an object with its fields; None for an encoding that is not known."""
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
    """A schema's name as ROS 2 has it, or as Foxglove has its own."""
    if schema.startswith("foxglove_msgs/"):
        return f"foxglove.{schema.rpartition('/')[2]}"
    return re.sub(r"^(\w+)/(\w+)$", r"\1/msg/\2", schema)
