"""The operator's link closes everything it opens; its node continues."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from msg_schemas import qos, topics
from msg_schemas.cdr import pack
from msg_schemas.health import Health
from msg_schemas.message_types import message_class
from msg_schemas.phases import HealthState
from msg_schemas.samples import StatusSample, TextSample
from msg_schemas.table import find_topic
from operator_console import operator_link
from operator_console.commands import COMMANDS
from operator_console.exchange import OrderStatus
from operator_console.operator_link import OperatorLink

pytestmark = [pytest.mark.ros]


@pytest.fixture
def node() -> Iterator[Node]:
    context = Context()
    rclpy.init(args=[], context=context)
    made = rclpy.create_node("console_of_a_test", context=context, start_parameter_services=False)
    yield made
    made.destroy_node()
    context.try_shutdown()


def opened(node: Node) -> list[Any]:
    return [*node.subscriptions, *node.publishers, *node.clients]


def test_a_link_closes_what_it_opens_and_can_be_opened_again(node: Node):
    before = opened(node)
    for _ in range(2):
        link = OperatorLink(node, "somebody")
        link.subscribe(topics.WINCH_MODE, topics.WINCH_MODE)
        link.prepare()
        received = [each.topic_name.strip("/") for each in node.subscriptions]
        assert received.count(topics.EVENTS) == received.count(topics.WINCH_MODE) == 1
        assert len(opened(node)) > len(before) + 10
        link.close()
        assert opened(node) == before


def test_latched_messages_of_all_nodes_arrive_although_they_come_at_once(node: Node):
    row = find_topic(topics.CONFIG)
    names = [f"node_{number}" for number in range(8)]
    publishers = []
    for name in names:
        text = json.dumps({"node": f"/{name}", "parameters": {"depth": 2.0}})
        publishers.append(
            node.create_publisher(
                message_class(row.message), topics.CONFIG, qos.profile(row.intent)
            )
        )
        publishers[-1].publish(pack(topics.CONFIG, TextSample(text)))
    received: list[str] = []
    link = OperatorLink(node, "somebody", lambda _, sample: received.append(sample.text))
    link.subscribe(topics.CONFIG)
    arriving = threading.Event()
    for _ in range(100):
        if all(publisher.get_subscription_count() for publisher in publishers):
            break
        arriving.wait(0.1)
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    for _ in range(100):
        executor.spin_once(timeout_sec=0.1)
        if len(received) == len(names):
            break
    assert {json.loads(text)["node"] for text in received} == {f"/{name}" for name in names}
    executor.shutdown()
    link.close()


@pytest.mark.parametrize(
    ("name", "value", "cancelled", "status"),
    [
        ("descend", {"depth": 12.0}, True, OrderStatus.CANCELLED),
        ("drive", {"distance": 1.0}, True, OrderStatus.CANCELLED),
        ("drive", {"distance": 1.0}, False, OrderStatus.UNAVAILABLE),
    ],
)
def test_nothing_is_sent_after_ctrl_c_or_without_a_pose(
    node: Node, monkeypatch: pytest.MonkeyPatch,
    name: str, value: dict[str, float], cancelled: bool, status: OrderStatus,
):  # fmt: skip
    receivers = {(each, "/") for each in ("descent_node", "drive_node")}
    monkeypatch.setattr(operator_link, "matched_subscribers", lambda *_: receivers)
    link = OperatorLink(node, "somebody")
    for each, _ in receivers:
        ready = Health(each, HealthState.READY).status({})
        link._on_message(topics.DIAGNOSTICS, pack(topics.DIAGNOSTICS, StatusSample(1, (ready,))))
    sent = link.send(COMMANDS[name].order(value), 0.1, lambda: cancelled)
    link.close()
    assert (sent.outcome.status, sent.exchange) == (status, None)
