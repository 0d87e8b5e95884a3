"""The link of an operator within a node: what it opens it can close, and the node goes on."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from msg_schemas import topics
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


def test_what_is_opened_is_closed_and_can_be_opened_again(node: Node):
    before = opened(node)
    for _ in range(2):
        link = OperatorLink(node, "somebody")
        link.listen(topics.WINCH_MODE, topics.WINCH_MODE)
        link.prepare()
        heard = [each.topic_name.strip("/") for each in node.subscriptions]
        assert heard.count(topics.EVENTS) == heard.count(topics.WINCH_MODE) == 1
        assert len(opened(node)) > len(before) + 10
        link.close()
        assert opened(node) == before
