"""Subscriptions of the components of a process: a topic arrives, and is read, once for all.

With simulated time a process wakes up once per tick: the clock is the last message of a tick, and
on its arrival the components receive the samples of the streams. Commands and what is kept for late
joiners are received as they arrive.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.qos import ReliabilityPolicy

from msg_schemas import qos
from msg_schemas.message_types import message_class
from msg_schemas.table import Intent, Topic
from rover_runtime.admission import read_message
from rover_runtime.port import Cancel, Message

if TYPE_CHECKING:
    from rclpy.node import Node

Receive = Callable[[Message], None]

_MAX_MESSAGES_AT_ONCE = 50
_STREAMS = frozenset({Intent.SENSOR, Intent.STATE})
_LONGEST_WAIT = 0.1  # wall time between looks at the streams, also while simulated time pauses [s]


class Subscriptions:
    """Opens the subscriptions of all components of a process."""

    def __init__(self) -> None:
        self._shared: dict[tuple[str, int | None], _Subscription] = {}
        self._streams: tuple[_Subscription, ...] = ()
        self._is_timed = False

    def open(
        self, node: Node, topic: Topic, receive: Receive, depth: int | None, *, by_clock: bool
    ) -> Cancel:
        """Receive the messages of a topic; returns a function that ends it.

        Args:
            node: whose names and remappings apply; its executor excludes `is_stream`.
            topic: specification of the topic.
            receive: called with each message.
            depth: of the queue; None: the contract's.
            by_clock: whether the node receives a clock through this object.
        """
        if qos.kept(topic.intent):
            # Each component receives the kept messages, however late it subscribes.
            alone = _Subscription(node, topic, depth)
            alone.receivers = (receive,)
            return alone.close
        key = node.resolve_topic_name(topic.name), depth
        if key not in self._shared:
            before = self._take_streams if topic.intent is Intent.CLOCK else None
            self._shared[key] = _Subscription(node, topic, depth, before)
            if by_clock and topic.intent in _STREAMS:
                self._streams += (self._shared[key],)
                self._take_by_timer(node)
        shared = self._shared[key]
        shared.receivers += (receive,)

        def cancel() -> None:
            shared.receivers = tuple(each for each in shared.receivers if each is not receive)
            if not shared.receivers:
                self._streams = tuple(each for each in self._streams if each is not shared)
                self._shared.pop(key).close()

        return cancel

    def is_stream(self, subscription: Any) -> bool:
        """Whether messages of an rclpy subscription are taken here, without an executor."""
        return any(each.subscription is subscription for each in self._streams)

    def _take_by_timer(self, node: Node) -> None:
        if not self._is_timed:
            self._is_timed = True
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(_LONGEST_WAIT, self._take_streams, clock=steady)

    def _take_streams(self) -> None:
        for stream in self._streams:
            stream.take()


class _Subscription:
    def __init__(
        self,
        node: Node,
        topic: Topic,
        depth: int | None,
        before: Callable[[], None] | None = None,
    ) -> None:
        self.receivers: tuple[Receive, ...] = ()
        self._node = node
        self._topic = topic
        self._before = before
        self._kind = message_class(topic.message)
        profile = qos.profile(topic.intent, depth)
        if topic.intent is Intent.CLOCK:
            # Only the newest reading counts, and not every publisher of a clock is reliable.
            profile.depth, profile.reliability = 1, ReliabilityPolicy.BEST_EFFORT
        self.subscription = node.create_subscription(
            self._kind, topic.name, self._on_message, profile, raw=True
        )

    def _on_message(self, data: bytes) -> None:
        if self._before is not None:
            self._before()
        self._hand_on(data)
        # The executor takes several times as long per message, and a node that lags behind would
        # act on ever older samples.
        self.take()

    def take(self) -> None:
        """Hand on the messages that have arrived."""
        handle = self.subscription.handle
        with handle:
            for _ in range(_MAX_MESSAGES_AT_ONCE):
                taken = handle.take_message(self._kind, True)
                if taken is None:
                    return
                self._hand_on(taken[0])

    def _hand_on(self, data: bytes) -> None:
        message = read_message(self._topic, data)
        for receive in self.receivers:
            receive(message)

    def close(self) -> None:
        self.receivers = ()
        self._node.destroy_subscription(self.subscription)
