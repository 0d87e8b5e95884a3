"""Batches over DDS: sends the streams of a node in batches, and receives those of all nodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile
from std_msgs.msg import UInt8MultiArray

from msg_schemas.access import BATCHES, batches_of
from msg_schemas.topics import CLOCK
from rover_runtime.batches import PERIOD, Batch, Entry, from_bytes
from rover_runtime.byte_array import from_array, to_array
from rover_runtime.ros.endpoint_matching import UNKNOWN_NODE, publisher_counts
from rover_runtime.ros.timers import steady_timer
from rover_runtime.ros.waiting_messages import taken

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher

_QUEUE_DEPTH = 1000  # of a receiver [batches]
_KEPT = 100  # for receivers that lag behind [batches]


class BatchPublisher:
    """Sends what the nodes of a process publish on their streams in batches, if somebody listens.

    Args:
        node: whose publisher sends the batches of all.
        topic: on which they are sent; see `batches_of`.
    """

    def __init__(self, node: Node, topic: str = BATCHES) -> None:
        self._batch = Batch(self._publish)
        self._topic = topic
        self._nodes = {node}
        self.publisher = self._open(node)
        steady_timer(node, PERIOD, self.flush)

    def join(self, node: Node) -> None:
        """Send also the streams of this node, before it creates their publishers.

        It opens the topic, by which receivers discover that its streams arrive in batches.
        """
        if node not in self._nodes:
            self._nodes.add(node)
            self._open(node)

    def _open(self, node: Node) -> Publisher:
        return node.create_publisher(UInt8MultiArray, self._topic, QoSProfile(depth=_KEPT))

    @property
    def has_subscribers(self) -> bool:
        """Whether somebody receives the batches."""
        return bool(self.publisher.get_subscription_count())

    def add(self, name: str, data: bytes) -> None:
        """Send a message of a stream, whose topic has this full name."""
        self._batch.add(name, time.time_ns(), data)

    def flush(self) -> None:
        """Send what has been added."""
        self._batch.flush()

    def _publish(self, data: bytes) -> None:
        if self.has_subscribers:
            self.publisher.publish(to_array(data))


class BatchPublishers:
    """Publishers of the batches of a process, one for each topic of batches."""

    def __init__(self) -> None:
        self._by_name: dict[str, BatchPublisher] = {}  # by full name of the topic

    def join(self, node: Node, topic: str) -> BatchPublisher:
        """Return the publisher that sends a stream of a node, before the node creates its own."""
        batches = batches_of(topic)
        name = node.resolve_topic_name(batches)
        if name not in self._by_name:
            self._by_name[name] = BatchPublisher(node, batches)
        self._by_name[name].join(node)
        return self._by_name[name]

    def flush(self) -> None:
        """Send what has been added to all of them."""
        for each in self._by_name.values():
            each.flush()

    @property
    def publishers(self) -> list[Publisher]:
        """Their rclpy publishers."""
        return [each.publisher for each in self._by_name.values()]


class BatchSubscription:
    """Receives streams in batches, and finds out which streams arrive in batches.

    Args:
        node: that receives.
        receive: called by the executor with each batch's messages; None: the node polls.

    Attributes:
        subscriptions: of the batches.
        covered: streams that all their publishers send in batches.
        foreign: streams that a publisher of another origin sends on its topic alone.
        clock_is_apart: whether the clock's publisher sends none of the streams.
    """

    def __init__(self, node: Node, receive: Callable[[list[Entry]], None] | None = None) -> None:
        self.subscriptions: list[Any] = []
        self.covered: frozenset[str] = frozenset()
        self.foreign: frozenset[str] = frozenset()
        self.clock_is_apart = False
        self._node = node
        self._clock = node.resolve_topic_name(CLOCK)
        self._receive = receive
        self._batches: dict[str, str] = {}  # topic of the batches by stream, full names
        self._counts: dict[str, int] = {}  # publishers by topic

    def add(self, topic: str) -> str:
        """Receive a stream of the contract too; returns its full name."""
        name, batches = map(self._node.resolve_topic_name, (topic, batches_of(topic)))
        if batches not in self._batches.values():
            self.subscriptions.append(
                self._node.create_subscription(
                    UInt8MultiArray, batches, self._on_message, QoSProfile(depth=_QUEUE_DEPTH),
                    raw=True,
                )
            )  # fmt: skip
        self._batches[name] = batches
        return str(name)

    def close(self) -> None:
        """Unsubscribe."""
        for subscription in self.subscriptions:
            self._node.destroy_subscription(subscription)
        self.subscriptions.clear()
        self._batches.clear()

    @property
    def names(self) -> Collection[str]:
        """Full names of the streams."""
        return self._batches.keys()

    def _on_message(self, message: bytes) -> None:
        assert self._receive is not None, "the subscription is polled"
        self._receive(self.read(message))

    def take(self) -> Iterator[list[Entry]]:
        """Take the batches that have arrived, where the node polls."""
        for subscription in self.subscriptions:
            for message, _ in taken(subscription, UInt8MultiArray, _QUEUE_DEPTH):
                yield self.read(message)

    def read(self, message: bytes) -> list[Entry]:
        """Return the streams' messages in a batch; none of bytes that are no batch."""
        try:
            entries = from_bytes(from_array(message))
        except ValueError as error:
            self._node.get_logger().warning(f"batches: {error}", once=True)
            return []
        return [each for each in entries if each.topic in self._batches]

    def look(self) -> None:
        """Look for publishers; call it periodically."""
        topics = {*self._batches.values(), *self._batches, self._clock}
        counts = publisher_counts(self._node, topics)
        if counts == self._counts:
            return
        found = {name: self._publishers(name) for name in topics if counts[name]}
        if any(UNKNOWN_NODE in name for each in found.values() for name in each):
            return
        self._counts = counts
        streams = self._batches.keys() & found.keys()
        self.foreign = frozenset(
            name for name in streams if not found[name] <= found.get(self._batches[name], set())
        )
        clocks = found.get(self._clock)
        senders = {name for each in streams - {self._clock} for name in found[each]}
        if clocks and senders:
            self.clock_is_apart = senders.isdisjoint(clocks)
        # A stream whose publisher has ended stays as it was.
        self.covered = (self.covered | streams) - self.foreign

    def _publishers(self, name: str) -> set[str]:
        return {
            f"{each.node_namespace}/{each.node_name}"
            for each in self._node.get_publishers_info_by_topic(name)
        }
