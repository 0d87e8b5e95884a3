"""Receives topics of the contract for operators: streams in batches, the others on their topics.

Operators need the newest sample of a stream, so the older ones of a batch are not even unpacked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node

from msg_schemas import qos, topics
from msg_schemas.message_types import message_class
from msg_schemas.table import find_topic
from rover_runtime.batches import STREAMS, Entry
from rover_runtime.ros.batches import BatchSubscription
from rover_runtime.ros.timers import steady_timer

Receive = Callable[[str, bytes], None]

_QUEUE_DEPTH = 200  # latched messages of all nodes arrive at the same time
_LOOK_PERIOD = 0.2  # at the publishers of the streams [s]
# Statuses that name different parts, and the drum, which rests if none of its samples moves.
_IN_FULL = frozenset({topics.LINK_STATUS, topics.SIM_STATUS, topics.WINCH_STATE})


class Receiver:
    """Subscribes to topics with their latched messages.

    Args:
        node: that receives; another thread spins it.
        receive: called in that thread with the name of a topic and a serialized message.
    """

    def __init__(self, node: Node, receive: Receive) -> None:
        self._node = node
        self._receive = receive
        self._subscriptions: dict[str, Any] = {}
        self._streams: dict[str, str] = {}  # names in the contract by full name
        self._batches: BatchSubscription | None = None
        self._timer: Any = None

    def subscribe(self, *names: str) -> None:
        """Receive these topics, and those of earlier calls."""
        for name in names:
            if name in STREAMS:
                self._streams[self._node.resolve_topic_name(name)] = name
            elif name not in self._subscriptions:
                self._open(name)
        if self._streams and self._batches is None:
            self._batches = BatchSubscription(self._node, self._on_batch)
            for name in STREAMS:
                self._batches.add(name)
            self._timer = steady_timer(self._node, _LOOK_PERIOD, self._look)

    def close(self) -> None:
        """Unsubscribe."""
        if self._batches is not None:
            self._node.destroy_timer(self._timer)
            self._batches.close()
            self._batches = None
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._streams.clear()

    def _open(self, name: str) -> None:
        row = find_topic(name)

        def on_message(data: bytes) -> None:
            self._receive(name, data)

        self._subscriptions[name] = self._node.create_subscription(
            message_class(row.message), name, on_message, qos.profile(row.intent, _QUEUE_DEPTH),
            raw=True,
        )  # fmt: skip

    def _on_batch(self, entries: Sequence[Entry]) -> None:
        last = {each.topic: each.number for each in entries}
        for topic, number, _, data in entries:
            name = self._streams.get(topic)
            if name is None or name in self._subscriptions:
                continue
            if number == last[topic] or name in _IN_FULL:
                self._receive(name, data)

    def _look(self) -> None:
        """Subscribe to the streams that a publisher sends without batches, and to no others."""
        if self._batches is None:
            return
        self._batches.look()
        for topic, name in tuple(self._streams.items()):
            is_foreign = topic in self._batches.foreign
            if is_foreign and name not in self._subscriptions:
                self._open(name)
            elif not is_foreign and name in self._subscriptions:
                self._node.destroy_subscription(self._subscriptions.pop(name))
