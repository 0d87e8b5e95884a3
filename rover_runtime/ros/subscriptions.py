"""Subscriptions of the components of a process: a topic arrives, and is read, once for all.

With simulated time a process wakes up once per tick: the clock is the last message of a tick, and
on its arrival the components receive the samples of the streams, in batches from the nodes that
send them (``rover_runtime.batches``). Commands and what is kept for late joiners are received as
they arrive; so are all streams where the clock's publisher sends none of them, as with emulated
drives: the bridge sends theirs after the clock, and they would wait for the next tick.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.qos import ReliabilityPolicy

from msg_schemas import qos
from msg_schemas.message_types import message_class
from msg_schemas.specifications import Intent, Topic
from rover_runtime.admission import read_message
from rover_runtime.batches import STREAMS
from rover_runtime.port import Cancel, Message
from rover_runtime.ros.batches import BatchSubscription
from rover_runtime.ros.timers import steady_timer
from rover_runtime.ros.waiting_messages import taken

if TYPE_CHECKING:
    from rclpy.node import Node

Receive = Callable[[Message], None]

_SAMPLED = frozenset({Intent.SENSOR, Intent.STATE})
_MAX_MESSAGES_AT_ONCE = 50
_LONGEST_WAIT = 0.1  # wall time until samples are received while simulated time pauses [s]
_LOOK_PERIOD = 0.3  # at the publishers of the streams [s]


class Subscriptions:
    """Opens the subscriptions of all components of a process.

    Args:
        end_tick: called after the components have received a reading of the clock.
    """

    def __init__(self, end_tick: Callable[[], object] = lambda: None) -> None:
        self._end_tick = end_tick
        self._shared: dict[tuple[str, int | None], _Subscription] = {}
        self._streams: dict[str, _Stream] = {}  # by full name
        self._batches: BatchSubscription | None = None  # of the streams
        self._follow_clock = True  # whether the streams' samples come before the clock

    def open(
        self,
        node: Node,
        topic: Topic,
        receive: Receive,
        depth: int | None,
        *,
        by_clock: bool,
        newest: bool = False,
    ) -> Cancel:
        """Receive the messages of a topic; returns a function that ends it.

        Args:
            node: whose names and remappings apply; its executor excludes `is_polled`.
            topic: specification of the topic.
            receive: called with each message.
            depth: of the queue; None: the contract's.
            by_clock: whether the node receives a clock through this object.
            newest: whether only the newest of a stream's messages in batches is handed on.
        """
        if qos.kept(topic.intent):
            # Each component receives the kept messages, however late it subscribes.
            alone = _Subscription(node, topic, depth)
            alone.receivers = (receive,)
            return alone.close
        name = node.resolve_topic_name(topic.name)
        if by_clock and topic.name in STREAMS and topic.intent in _SAMPLED:
            stream = self._stream(node, topic)
            return (stream.newest if newest else stream).add(receive)
        key = name, depth
        if key not in self._shared:
            around = (self._take_streams, self._end_tick) if topic.intent is Intent.CLOCK else ()
            self._shared[key] = _Subscription(node, topic, depth, *around)
        shared = self._shared[key]
        cancel_one = shared.add(receive)

        def cancel() -> None:
            cancel_one()
            if not shared.receivers:
                self._shared.pop(key).close()

        return cancel

    def open_slow_clock(self, node: Node, topic: Topic, receive: Receive) -> Cancel:
        """Receive the clock as a stream: at each `call`, and 0.1 s after it at the latest."""
        return self._stream(node, topic).add(receive)

    def call(self, callback: Callable[[], None]) -> None:
        """Call back after the components have received what has arrived."""
        self._take_streams()
        callback()
        self._end_tick()

    def is_polled(self, subscription: Any) -> bool:
        """Whether messages of an rclpy subscription are taken here, without an executor."""
        if self._batches is not None and any(
            subscription is each for each in self._batches.subscriptions
        ):
            return True
        return self._follow_clock and any(
            each.is_direct(subscription) for each in self._streams.values()
        )

    def _stream(self, node: Node, topic: Topic) -> _Stream:
        name = node.resolve_topic_name(topic.name)
        if name in self._streams:
            return self._streams[name]
        if self._batches is None:
            self._batches = BatchSubscription(node)
            steady_timer(node, _LONGEST_WAIT, self._take_streams)
            steady_timer(node, _LOOK_PERIOD, self._look)
        self._batches.add(topic.name)
        stream = self._streams[name] = _Stream(node, topic)
        return stream

    def _look(self) -> None:
        """See which streams arrive in batches, and which on their topics alone."""
        assert self._batches is not None
        self._batches.look()
        is_apart = self._batches.clock_is_apart
        if is_apart == self._follow_clock:
            self._follow_clock = not is_apart
            for stream in self._streams.values():
                stream.follow(is_alone=False)  # subscribed anew: by the executor or not
        for name, stream in self._streams.items():
            stream.follow(is_alone=is_apart or name in self._batches.foreign)

    def _take_streams(self) -> None:
        if self._batches is None:
            return
        for entries in self._batches.take():
            for entry in entries:
                self._streams[entry.topic].hand_on_batched(entry.data)
        for stream in self._streams.values():
            stream.hand_on_newest()
            stream.take()


class _Receivers:
    """Those who receive the messages of a topic."""

    def __init__(self, topic: Topic) -> None:
        self.receivers: tuple[Receive, ...] = ()
        self.topic = topic

    def add(self, receive: Receive) -> Cancel:
        self.receivers += (receive,)
        return lambda: self._remove(receive)

    def _remove(self, receive: Receive) -> None:
        self.receivers = tuple(each for each in self.receivers if each is not receive)

    def hand_on(self, data: bytes) -> None:
        if self.receivers:
            message = read_message(self.topic, data)
            for receive in self.receivers:
                receive(message)


class _Stream(_Receivers):
    """A stream: in batches, or on its topic alone.

    Attributes:
        newest: receivers of the newest message alone of the batches that are taken together.
    """

    def __init__(self, node: Node, topic: Topic) -> None:
        super().__init__(topic)
        self.newest = _Receivers(topic)
        self._last: bytes | None = None  # of the batches taken
        self._node = node
        self._direct: _Subscription | None = None

    def is_direct(self, subscription: Any) -> bool:
        return self._direct is not None and self._direct.subscription is subscription

    def follow(self, *, is_alone: bool) -> None:
        if is_alone and self._direct is None:
            self._direct = _Subscription(self._node, self.topic)
            self._direct.add(self._receive)
        elif not is_alone and self._direct is not None:
            self._direct.close()
            self._direct = None

    def hand_on_batched(self, data: bytes) -> None:
        if self._direct is None:
            self._last = data
            self.hand_on(data)

    def hand_on_newest(self) -> None:
        last, self._last = self._last, None
        if last is not None:
            self.newest.hand_on(last)

    def take(self) -> None:
        if self._direct is not None:
            self._direct.take()

    def _receive(self, message: Message) -> None:
        for receive in self.receivers + self.newest.receivers:
            receive(message)


class _Subscription(_Receivers):
    def __init__(
        self,
        node: Node,
        topic: Topic,
        depth: int | None = None,
        before: Callable[[], None] | None = None,
        after: Callable[[], object] | None = None,
    ) -> None:
        super().__init__(topic)
        self._node = node
        self._before = before
        self._after = after
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
        self.hand_on(data)
        # The executor takes several times as long per message, and a node that lags behind would
        # act on ever older samples.
        self.take()
        if self._after is not None:
            self._after()

    def take(self) -> None:
        """Hand on the messages that have arrived."""
        for data, _ in taken(self.subscription, self._kind, _MAX_MESSAGES_AT_ONCE):
            self.hand_on(data)

    def close(self) -> None:
        self.receivers = ()
        self._node.destroy_subscription(self.subscription)
