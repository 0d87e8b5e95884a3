"""A node from which newer subscriptions receive has matched all older endpoints."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from msg_schemas import qos, topics
from msg_schemas.cdr import pack
from msg_schemas.message_types import message_class
from msg_schemas.samples import Level, Status, StatusSample
from msg_schemas.table import find_topic
from rover_runtime.ros.endpoint_matching import EndpointMatching
from rover_verify.harness.ros_domain import reserved_domain

pytestmark = [pytest.mark.ros]

TRIALS = 100  # of 0.1 s each


@pytest.fixture
def node() -> Iterator[Node]:
    with reserved_domain() as domain:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        made = rclpy.create_node("caller", context=context, start_parameter_services=False)
        yield made
        made.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize("topic", [topics.EVENTS, topics.DIAGNOSTICS])
def test_a_received_node_has_matched_all_older_endpoints(node: Node, topic: str):
    row, matched = find_topic(topic), []
    publisher = node.create_publisher(message_class(row.message), topic, qos.profile(row.intent))
    before = len(list(node.subscriptions))
    discovery = EndpointMatching(node, lambda: matched.append(topic))
    assert not discovery.is_matched("server")
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    for _ in range(TRIALS):
        publisher.publish(pack(topic, StatusSample(1, (Status("n", "m", Level.OK, "server", {}),))))
        executor.spin_once(timeout_sec=0.1)
        if matched:
            break
    assert discovery.is_matched("server")
    assert not discovery.is_matched("caller")
    discovery.close()
    assert len(list(node.subscriptions)) == before
    executor.shutdown()
