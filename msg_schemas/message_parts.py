"""Parts of ROS messages that several codecs share: times, headers, vectors."""

from __future__ import annotations

from typing import Any

from msg_schemas.message_types import message_class
from msg_schemas.samples import Quaternion, Vector
from msg_schemas.specifications import Topic

Message = Any

_NANO = 1_000_000_000


def from_time(time: Message) -> int:
    """Return nanoseconds of a builtin_interfaces/Time."""
    return int(time.sec) * _NANO + int(time.nanosec)


def new_message(topic: Topic, stamp_ns: int) -> Message:
    """Return an empty message of a topic with its header filled."""
    message = message_class(topic.message)()
    message.header.stamp.sec = stamp_ns // _NANO
    message.header.stamp.nanosec = stamp_ns % _NANO
    message.header.frame_id = topic.frame
    return message


def set_values(target: Message, values: tuple[float, ...], axes: str = "xyz") -> None:
    """Set the components of a message."""
    for axis, value in zip(axes, values, strict=True):
        setattr(target, axis, float(value))


def vector_of(source: Message) -> Vector:
    """Return x, y and z of a message."""
    return (float(source.x), float(source.y), float(source.z))


def quaternion_of(source: Message) -> Quaternion:
    """Return x, y, z and w of a message."""
    return (float(source.x), float(source.y), float(source.z), float(source.w))
