"""Timers of a node that do not follow simulated time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.clock import Clock
from rclpy.clock_type import ClockType

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.timer import Timer


def steady_timer(node: Node, period: float, callback: Callable[[], object]) -> Timer:
    """Call back by the steady clock, each time that a period [s] has passed."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
