"""Parts of ROS messages that several codecs share: classes, times, headers, frames, vectors."""

from __future__ import annotations

import functools
from importlib import import_module
from typing import Any

from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Quaternion, Vector
from msg_schemas.specifications import Topic

Message = Any

_NANO = 1_000_000_000


@functools.cache
def message_class(type_name: str) -> type[Any]:
    """Return the Python class of a message or service type such as ``nav_msgs/msg/Odometry``."""
    package, kind, name = type_name.split("/")
    found = getattr(import_module(f"{package}.{kind}"), name)
    if not isinstance(found, type):
        msg = f"{type_name} is not a message type"
        raise TypeError(msg)
    return found


def to_time(stamp_ns: int) -> Message:
    """Return builtin_interfaces/Time for nanoseconds."""
    time_class = message_class("builtin_interfaces/msg/Time")
    return time_class(sec=stamp_ns // _NANO, nanosec=stamp_ns % _NANO)


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


def check_frame(topic: Topic, got: str, expected: str, which: str) -> None:
    """Refuse a frame that is given and is not the expected one."""
    if expected and got not in {"", expected}:
        raise Refusal(
            topic.name, RefusalCode.WRONG_FRAME, f"{which} is {got!r}, it must be {expected!r}"
        )


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
