"""Components of a process share the subscription of a stream; each receives what is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

from msg_schemas import qos, topics
from msg_schemas.access import BATCHES, TRUTH_BATCHES
from msg_schemas.cdr import pack
from msg_schemas.message_types import message_class
from msg_schemas.phases import WinchMode
from msg_schemas.samples import ClockSample, Sample, TextSample, WrenchSample
from msg_schemas.table import find_topic
from rover_runtime.port import Message
from rover_runtime.ros.batches import BatchPublisher
from rover_runtime.ros.subscriptions import Subscriptions
from rover_verify.harness.ros_domain import reserved_domain

pytestmark = [pytest.mark.ros]

TRIALS = 100  # of 0.1 s each


class PollingNode(Node):
    """A node whose executor leaves alone what its subscriptions poll, as a component's node."""

    receiving: Subscriptions | None = None

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        for each in super().subscriptions:
            if self.receiving is None or not self.receiving.is_polled(each):
                yield each


class Graph:
    """Two nodes of a process, and a publisher of another participant."""

    def __init__(self, domain: int) -> None:
        self.contexts = [Context(), Context()]
        for context in self.contexts:
            rclpy.init(args=[], context=context, domain_id=domain)
        ours, other = self.contexts
        self.nodes = [PollingNode(name, context=ours) for name in ("first", "second")]
        self.outside = rclpy.create_node("outside", context=other)
        self.executor: Executor = SingleThreadedExecutor(context=ours)
        for node in self.nodes:
            self.executor.add_node(node)

    def publisher(self, name: str) -> Any:
        row = find_topic(name)
        return self.outside.create_publisher(
            message_class(row.message), name, qos.profile(row.intent)
        )

    def publish(self, name: str, sample: Sample, until: Callable[[], bool]) -> None:
        """Publish once the subscriptions are matched, and spin until a condition holds."""
        publisher = self.publisher(name)
        self.spin(lambda: publisher.get_subscription_count() == self.count(name) > 0)
        publisher.publish(pack(name, sample))
        self.spin(until)

    def spin(self, until: Callable[[], bool]) -> None:
        for _ in range(TRIALS):
            if until():
                return
            self.executor.spin_once(timeout_sec=0.1)
        assert until()

    def count(self, name: str) -> int:
        """Number of our subscriptions."""
        return sum(
            each.topic_name == f"/{name}" for node in self.nodes for each in node.subscriptions
        )

    def close(self) -> None:
        self.executor.shutdown()
        for node in (*self.nodes, self.outside):
            node.destroy_node()
        for context in self.contexts:
            context.try_shutdown()


@pytest.fixture
def graph() -> Iterator[Graph]:
    with reserved_domain() as domain:
        made = Graph(domain)
        yield made
        made.close()


def test_components_share_the_subscription_of_a_stream(graph: Graph):
    row, subscriptions = find_topic(topics.LOAD_CELL), Subscriptions()
    received: list[list[Message]] = [[], []]
    cancel_first, cancel_second = (
        subscriptions.open(node, row, each.append, None, by_clock=False)
        for node, each in zip(graph.nodes, received, strict=True)
    )
    assert graph.count(row.name) == 1
    first = WrenchSample(1, (0.0, 0.0, 1.0))
    graph.publish(row.name, first, lambda: all(received))
    assert [[message.content for message in each] for each in received] == [[first], [first]]
    cancel_first()
    second = WrenchSample(2, (0.0, 0.0, 2.0))
    graph.publish(row.name, second, lambda: len(received[1]) == 2)
    assert [len(each) for each in received] == [1, 2]
    cancel_second()
    assert graph.count(row.name) == 0


def test_a_message_may_close_its_subscription(graph: Graph):
    row, received = find_topic(topics.LOAD_CELL), list[Message]()

    def receive(message: Message) -> None:
        received.append(message)
        cancel()

    cancel = Subscriptions().open(graph.nodes[0], row, receive, None, by_clock=False)
    graph.publish(row.name, WrenchSample(1, (0.0, 0.0, 1.0)), lambda: bool(received))
    assert graph.count(row.name) == 0


def test_a_component_that_subscribes_late_receives_what_is_kept(graph: Graph):
    row, subscriptions = find_topic(topics.WINCH_MODE), Subscriptions()
    received: list[list[Message]] = [[], []]
    subscriptions.open(graph.nodes[0], row, received[0].append, None, by_clock=False)
    graph.publish(row.name, TextSample(WinchMode.HOLD.value), lambda: bool(received[0]))
    subscriptions.open(graph.nodes[1], row, received[1].append, None, by_clock=False)
    graph.spin(lambda: bool(received[1]))
    assert [len(each) for each in received] == [1, 1]


def by_clock(graph: Graph, name: str) -> list[Any]:
    """Receive a stream and the clock, by which its samples are taken."""
    node, received = graph.nodes[0], list[Any]()
    node.receiving = subscriptions = Subscriptions()
    for row in (find_topic(topics.CLOCK), find_topic(name)):
        subscriptions.open(
            node,
            row,
            lambda message: received.append(message.content),
            None,
            by_clock=row.name == name,
        )
    return received


def test_a_stream_arrives_in_its_batch_before_the_clock(graph: Graph):
    received = by_clock(graph, topics.LOAD_CELL)
    batch = BatchPublisher(graph.outside)
    cell, clock = map(graph.publisher, (topics.LOAD_CELL, topics.CLOCK))
    graph.spin(lambda: batch.has_subscribers and clock.get_subscription_count() == 1)
    samples = [WrenchSample(number, (0.0, 0.0, 1.0)) for number in (1, 2)]
    for sample in samples:
        batch.add(cell.topic_name, pack(topics.LOAD_CELL, sample))
    batch.flush()
    clock.publish(pack(topics.CLOCK, ClockSample(2)))
    graph.spin(lambda: len(received) == 3)
    assert received == [*samples, ClockSample(2)]
    assert not cell.get_subscription_count()


def test_a_stream_without_batches_arrives_on_its_topic(graph: Graph):
    received = by_clock(graph, topics.LOAD_CELL)
    cell, sample = graph.publisher(topics.LOAD_CELL), WrenchSample(1, (0.0, 0.0, 1.0))
    graph.spin(lambda: bool(cell.get_subscription_count()))
    cell.publish(pack(topics.LOAD_CELL, sample))
    graph.spin(lambda: bool(received))
    assert received == [sample]


def test_ground_truth_has_batches_of_its_own(graph: Graph):
    by_clock(graph, topics.TRUTH_BODY1)
    node, plant = graph.nodes[0], BatchPublisher(graph.outside, TRUTH_BATCHES)
    graph.spin(lambda: plant.has_subscribers)
    assert not node.count_subscribers(BATCHES)


def test_a_stream_arrives_at_once_where_the_clock_has_another_source(graph: Graph):
    received = by_clock(graph, topics.LOAD_CELL)
    source = rclpy.create_node("clock_source", context=graph.contexts[1])
    row = find_topic(topics.CLOCK)
    clock = source.create_publisher(message_class(row.message), row.name, qos.profile(row.intent))
    batch, cell = BatchPublisher(graph.outside), graph.publisher(topics.LOAD_CELL)
    graph.spin(lambda: cell.get_subscription_count() == 1 == graph.count(topics.LOAD_CELL))
    assert batch.has_subscribers
    assert clock.get_subscription_count() == 1
    samples = [WrenchSample(number, (0.0, 0.0, 1.0)) for number in (1, 2)]
    for sample in samples:
        cell.publish(pack(topics.LOAD_CELL, sample))
    graph.spin(lambda: len(received) == len(samples))
    assert received == samples
    source.destroy_node()


def test_a_slow_clock_is_received_with_calls_alone(graph: Graph):
    node, received, ended = graph.nodes[0], list[Message](), list[bool]()
    node.receiving = subscriptions = Subscriptions(lambda: ended.append(True))
    cancel = subscriptions.open_slow_clock(node, find_topic(topics.CLOCK), received.append)
    clock, seen = graph.publisher(topics.CLOCK), list[int]()

    def is_received() -> bool:
        clock.publish(pack(topics.CLOCK, ClockSample(2)))
        subscriptions.call(lambda: seen.append(len(received)))
        return bool(received)

    graph.spin(is_received)
    assert received[0].content == ClockSample(2)
    assert seen[-1] == len(received)
    assert len(ended) == len(seen)
    assert graph.count(topics.CLOCK) == 0  # the executor receives nothing
    cancel()
    count = len(received)
    is_received()
    assert len(received) == count


def test_a_slow_clock_arrives_in_batches_with_the_streams(graph: Graph):
    node, received = graph.nodes[0], list[Any]()
    node.receiving = subscriptions = Subscriptions()
    clock_row, cell_row = map(find_topic, (topics.CLOCK, topics.LOAD_CELL))
    subscriptions.open_slow_clock(node, clock_row, lambda each: received.append(each.content))
    subscriptions.open(
        node, cell_row, lambda each: received.append(each.content), None, by_clock=True
    )
    batch = BatchPublisher(graph.outside)
    cell, clock = map(graph.publisher, (topics.LOAD_CELL, topics.CLOCK))
    graph.spin(lambda: batch.has_subscribers)
    sent: list[Sample] = [ClockSample(1), WrenchSample(2, (0.0, 0.0, 1.0)), ClockSample(2)]
    for publisher, name, sample in zip(
        (clock, cell, clock), (topics.CLOCK, topics.LOAD_CELL, topics.CLOCK), sent, strict=True
    ):
        batch.add(publisher.topic_name, pack(name, sample))
    batch.flush()
    graph.spin(lambda: len(received) == len(sent))
    assert received == sent
    assert not clock.get_subscription_count()


def test_a_receiver_of_the_newest_message_gets_one_of_each_batch(graph: Graph):
    node, newest, every = graph.nodes[0], list[Any](), list[Any]()
    node.receiving = subscriptions = Subscriptions()
    for received, is_newest in ((newest, True), (every, False)):
        subscriptions.open(
            node,
            find_topic(topics.LOAD_CELL),
            partial(lambda contents, each: contents.append(each.content), received),
            None,
            by_clock=True,
            newest=is_newest,
        )
    batch, cell = BatchPublisher(graph.outside), graph.publisher(topics.LOAD_CELL)
    graph.spin(lambda: batch.has_subscribers)

    def send(samples: Sequence[Sample]) -> None:
        total = len(every) + len(samples)
        for sample in samples:
            batch.add(cell.topic_name, pack(topics.LOAD_CELL, sample))
        batch.flush()
        graph.spin(lambda: len(every) == total)

    samples = [WrenchSample(number, (0.0, 0.0, 1.0)) for number in range(6)]
    send(samples[:4])
    send(samples[4:])
    assert every == samples
    assert newest == [samples[3], samples[5]]
