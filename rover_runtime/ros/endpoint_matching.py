"""Endpoint matching: whether a publisher reaches its subscribers, and a server its client.

A message is published after all known subscribers are matched. A service is called after its
server has matched the client.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

from msg_schemas import qos, topics
from msg_schemas.cdr import unpack
from msg_schemas.message_types import message_class
from msg_schemas.refusal import Refusal
from msg_schemas.samples import StatusSample
from msg_schemas.table import find_topic

if TYPE_CHECKING:
    from rclpy.node import Node

# Events are kept for late subscribers, so that most nodes are detected at once; a node without
# events is detected by its periodic diagnostics.
_DETECTION_TOPICS = (topics.EVENTS, topics.DIAGNOSTICS)
_MAX_NAMES = 1000

UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"
"""Name that rmw gives to the node of an endpoint until the node is discovered."""


def matched_subscribers(node: Node, publisher: Any) -> list[tuple[str, str]]:
    """Return name and namespace of a publisher's subscribers once all known ones are matched.

    Empty before: a message sent when only one of them is matched, perhaps a recorder, is lost for
    the others.
    """
    known = node.get_subscriptions_info_by_topic(publisher.topic_name)
    if publisher.get_subscription_count() < len(known):
        return []
    return [(each.node_name, each.node_namespace) for each in known]


def publisher_counts(node: Node, names: Iterable[str]) -> dict[str, int]:
    """Return the number of publishers of topics, by full name.

    ``Node.count_publishers`` takes four times as long, as it checks each name.
    """
    with node.handle:
        return {name: node.handle.get_count_publishers(name) for name in names}


class EndpointMatching:
    """Detects which nodes have matched all endpoints that a node opened before this object.

    A client sees its server as soon as the two participants have discovered each other. The server
    may match the client later, and Fast DDS discards a response after 0.1 s without a match: the
    request is executed, but the client gets no response. A participant's endpoints are discovered
    in the order of their creation, so a node that sends to the newest subscriptions has matched all
    older endpoints.

    Args:
        node: has opened the clients of the services that it will call.
        changed: called after each received message.
    """

    def __init__(self, node: Node, changed: Callable[[], None] = lambda: None) -> None:
        self._node = node
        self._changed = changed
        self._names: set[str] = set()
        self._newest = []
        for name in _DETECTION_TOPICS:
            row = find_topic(name)
            self._newest.append(
                node.create_subscription(
                    message_class(row.message),
                    name,
                    partial(self._on_status, name),
                    qos.profile(row.intent),
                    raw=True,
                )
            )

    def _on_status(self, topic: str, data: bytes) -> None:
        try:
            sample: StatusSample = unpack(topic, data)
        except Refusal:
            return
        if len(self._names) < _MAX_NAMES:  # anyone may send any name
            self._names.update(status.hardware_id for status in sample.statuses[:_MAX_NAMES])
        self._changed()

    def is_matched(self, name: str) -> bool:
        """Whether a node of this name has matched the endpoints."""
        return name in self._names

    def close(self) -> None:
        """Destroy the subscriptions; no executor may spin the node meanwhile."""
        for subscription in self._newest:
            self._node.destroy_subscription(subscription)
        self._newest.clear()
