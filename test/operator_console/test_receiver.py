"""Operators receive streams in batches, and on their topics from publishers without batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from msg_schemas import machine, qos, topics
from msg_schemas.cdr import pack, unpack
from msg_schemas.message_types import message_class
from msg_schemas.phases import WinchMode
from msg_schemas.samples import JointSample, JointValue, TextSample, WrenchSample
from msg_schemas.table import find_topic
from operator_console.receiver import Receiver
from rover_runtime.ros.batches import BatchPublisher
from rover_verify.harness.ros_domain import reserved_domain

pytestmark = [pytest.mark.ros]

TRIALS = 100  # of 0.1 s each


def weight(number: int) -> WrenchSample:
    return WrenchSample(number, (0.0, 0.0, float(number)))


def drum(number: int) -> JointSample:
    value = JointValue(float(number), 0.0, 0.0)
    return JointSample(
        number, {machine.WINCH_DRUM: value, machine.WINCH_BRAKE: JointValue(0.0, 0.0, 0.0)}
    )


class Graph:
    """A node with a receiver, and a node of another participant that publishes."""

    def __init__(self, domain: int) -> None:
        self.contexts = [Context(), Context()]
        for context in self.contexts:
            rclpy.init(args=[], context=context, domain_id=domain)
        self.node, self.other = (
            rclpy.create_node(name, context=context)
            for name, context in zip(("operator", "plant"), self.contexts, strict=True)
        )
        self.received: list[tuple[str, Any]] = []
        self.receiver = Receiver(
            self.node, lambda name, data: self.received.append((name, unpack(name, data)))
        )
        self.executors = [SingleThreadedExecutor(context=context) for context in self.contexts]
        for executor, node in zip(self.executors, (self.node, self.other), strict=True):
            executor.add_node(node)

    def publisher(self, name: str) -> Any:
        row = find_topic(name)
        return self.other.create_publisher(
            message_class(row.message), name, qos.profile(row.intent)
        )

    def spin(self, until: Callable[[], bool]) -> None:
        for _ in range(TRIALS):
            if until():
                return
            for executor in self.executors:
                executor.spin_once(timeout_sec=0.05)
        assert until(), self.received

    def close(self) -> None:
        self.receiver.close()
        for executor in self.executors:
            executor.shutdown()
        for node in (self.node, self.other):
            node.destroy_node()
        for context in self.contexts:
            context.try_shutdown()


@pytest.fixture
def graph() -> Iterator[Graph]:
    with reserved_domain() as domain:
        made = Graph(domain)
        yield made
        made.close()


def test_of_a_batch_the_newest_sample_is_received_and_each_of_the_drum(graph: Graph):
    graph.receiver.subscribe(topics.LOAD_CELL, topics.WINCH_STATE)
    batch = BatchPublisher(graph.other)
    publishers = {name: graph.publisher(name) for name in (topics.LOAD_CELL, topics.WINCH_STATE)}
    graph.spin(lambda: batch.has_subscribers)
    for number in (1, 2, 3):
        batch.add(publishers[topics.LOAD_CELL].topic_name, pack(topics.LOAD_CELL, weight(number)))
        batch.add(publishers[topics.WINCH_STATE].topic_name, pack(topics.WINCH_STATE, drum(number)))
    batch.flush()
    graph.spin(lambda: len(graph.received) >= 4)
    assert [(name, sample.stamp_ns) for name, sample in graph.received] == [
        (topics.WINCH_STATE, 1),
        (topics.WINCH_STATE, 2),
        (topics.LOAD_CELL, 3),
        (topics.WINCH_STATE, 3),
    ]
    assert not any(each.get_subscription_count() for each in publishers.values())


def test_other_streams_of_a_batch_are_not_received(graph: Graph):
    graph.receiver.subscribe(topics.WINCH_STATE)
    batch = BatchPublisher(graph.other)
    cell, drums = graph.publisher(topics.LOAD_CELL), graph.publisher(topics.WINCH_STATE)
    graph.spin(lambda: batch.has_subscribers)
    batch.add(cell.topic_name, pack(topics.LOAD_CELL, weight(1)))
    batch.add(drums.topic_name, pack(topics.WINCH_STATE, drum(1)))
    batch.flush()
    graph.spin(lambda: bool(graph.received))
    assert [name for name, _ in graph.received] == [topics.WINCH_STATE]


def test_a_publisher_without_batches_is_received_on_its_topic(graph: Graph):
    graph.receiver.subscribe(topics.LOAD_CELL)
    publisher = graph.publisher(topics.LOAD_CELL)
    graph.spin(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(pack(topics.LOAD_CELL, weight(5)))
    graph.spin(lambda: bool(graph.received))
    assert graph.received == [(topics.LOAD_CELL, weight(5))]


def test_latched_topics_are_received_on_their_topics(graph: Graph):
    graph.publisher(topics.WINCH_MODE).publish(
        pack(topics.WINCH_MODE, TextSample(WinchMode.HOLD.value))
    )
    graph.receiver.subscribe(topics.WINCH_MODE)
    graph.spin(lambda: bool(graph.received))
    assert [name for name, _ in graph.received] == [topics.WINCH_MODE]
