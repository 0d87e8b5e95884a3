"""One plant per clock: a node that publishes the clock refuses to do so beside another one."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from msg_schemas import qos, topics
from msg_schemas.message_types import message_class
from msg_schemas.parameters import ParameterError
from msg_schemas.samples import ClockSample
from msg_schemas.table import find_topic
from rover_runtime.admission import read_message
from rover_runtime.component import Component, ExitCode
from rover_runtime.ros.endpoint_matching import UNKNOWN_NODE
from rover_runtime.ros.timers import steady_timer

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.subscription import Subscription

_DISCOVERY_TIME = 0.8  # from its start until a node usually knows the others [s]
_WATCH_PERIOD = 1.0  # of the search for a second publisher of the clock [s]
_MARGIN_NS = 200_000_000  # of another plant's time, ahead of this one's


class ClockGuard:
    """Finds a second publisher of a node's clock, at the node's start and later.

    Args:
        node: just made.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._created_at = time.monotonic()
        self._is_watching = False
        self._other: Subscription | None = None

    def refuse_second(self, component: Component) -> None:
        """Refuse to publish a clock that another node publishes: the plants would upset each other.

        Args:
            component: of the node; it ends if another publisher is found later.

        Raises:
            ParameterError: there is another publisher.
        """
        node = self._node
        clock = node.resolve_topic_name(topics.CLOCK)
        if not any(each.node_name == node.get_name() for each in self._publishers(clock)):
            return
        deadline, pause = self._created_at + _DISCOVERY_TIME, threading.Event()
        while not self._is_second(clock) and time.monotonic() < deadline:
            if component.shutdown_requested():
                return
            pause.wait(_DISCOVERY_TIME / 20)
        if self._is_second(clock):
            raise ParameterError(self._reason(clock))
        if not self._is_watching:
            self._is_watching = True
            steady_timer(node, _WATCH_PERIOD, partial(self._watch, clock, component))

    def _publishers(self, topic: str) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(topic))

    def _is_second(self, clock: str) -> bool:
        return len(self._publishers(clock)) > 1

    def _reason(self, clock: str) -> str:
        others = {
            f"{each.node_namespace.rstrip('/')}/{each.node_name}"
            for each in self._publishers(clock)
            if each.node_name != UNKNOWN_NODE
        }
        names = (
            ", ".join(sorted(others - {self._node.get_fully_qualified_name()})) or "another node"
        )
        return (
            f"{clock} is published by {names} already: start this plant with another "
            f"ROS_DOMAIN_ID, or with a clock of its own in its namespace, -r {topics.CLOCK}:=clock"
        )

    def _watch(self, clock: str, component: Component) -> None:
        """Find a second publisher that was discovered late; the younger plant ends."""
        if self._is_second(clock):
            if self._other is None:
                row = find_topic(topics.CLOCK)
                self._other = self._node.create_subscription(
                    message_class(row.message), clock, partial(self._on_clock, clock, component),
                    qos.profile(row.intent), raw=True,
                )  # fmt: skip
        elif self._other is not None:
            self._node.destroy_subscription(self._other)
            self._other = None

    def _on_clock(self, clock: str, component: Component, data: bytes) -> None:
        content = read_message(find_topic(topics.CLOCK), data).content
        is_ahead = (
            isinstance(content, ClockSample) and content.stamp_ns > component.now_ns() + _MARGIN_NS
        )
        if is_ahead and component.exit_code is None and self._is_second(clock):
            self._node.get_logger().error(self._reason(clock))
            component.exit_code = ExitCode.BAD_CONFIGURATION
