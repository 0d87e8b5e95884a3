"""Python classes of ROS message and service types, for code that calls rclpy."""

from __future__ import annotations

import functools
from importlib import import_module
from typing import Any


@functools.cache
def message_class(type_name: str) -> type[Any]:
    """Return the Python class of a message or service type such as ``nav_msgs/msg/Odometry``."""
    package, kind, name = type_name.split("/")
    found = getattr(import_module(f"{package}.{kind}"), name)
    if not isinstance(found, type):
        msg = f"{type_name} is not a message type"
        raise TypeError(msg)
    return found


def to_time(stamp_ns: int) -> Any:
    """Return builtin_interfaces/Time for nanoseconds."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return message_class("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)
