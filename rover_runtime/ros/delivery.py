"""Delivery of the last messages of a process, which are lost when it ends too early."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rclpy.duration import Duration

if TYPE_CHECKING:
    from rclpy.publisher import Publisher

_TIMEOUT = 0.5  # [s]


def wait_until_acknowledged(publishers: Iterable[Publisher]) -> None:
    """Wait until the subscribers have all messages, 0.5 s at most."""
    deadline = time.monotonic() + _TIMEOUT
    for publisher in publishers:
        left = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(Duration(nanoseconds=round(left * 1e9)))
