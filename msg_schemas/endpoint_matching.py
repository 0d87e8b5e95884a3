"""Who has met whom: whom a publisher reaches, and which server knows a client.

Something is published when all that listen are met, and a service is called when its server knows
the client.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msg_schemas import qos, topics
from msg_schemas.codecs import find_topic, message_class

if TYPE_CHECKING:
    from rclpy.node import Node

# What has happened is kept for who listens late, so that a node is heard at once; one that has
# nothing to tell of yet is heard by its health.
_HEARD = (topics.EVENTS, topics.DIAGNOSTICS)


def matched_subscribers(node: Node, publisher: Any) -> list[tuple[str, str]]:
    """Name and namespace of each who listens to a publisher, once all known ones are met.

    Empty before: what is published to the one who was met first, as it may be a recorder, is lost
    to who is met a moment later.
    """
    known = node.get_subscriptions_info_by_topic(publisher.topic_name)
    if publisher.get_subscription_count() < len(known):
        return []
    return [(each.node_name, each.node_namespace) for each in known]


class EndpointMatching:
    """Who knows all that a node had opened when this was made.

    A client finds its server at once where the two participants have met. The server may take
    longer to get to know the client, and in Fast DDS gives up an answer after 0.1 s: what was asked
    for is done, and who asked is not told. What a participant opens becomes known to another in the
    order in which it was opened, so whoever sends to the newest subscriptions knows what is older.

    Args:
        node: that has opened clients and will call.
        changed: called after each message that was heard.
    """

    def __init__(self, node: Node, changed: Callable[[], None] = lambda: None) -> None:
        self._node = node
        self._changed = changed
        self._names: set[str] = set()
        self._newest = []
        for name in _HEARD:
            row = find_topic(name)
            self._newest.append(
                node.create_subscription(
                    message_class(row.message), name, self._hear, qos.profile(row.intent)
                )
            )

    def _hear(self, message: Any) -> None:
        self._names.update(status.hardware_id for status in message.status)
        self._changed()

    def is_matched(self, name: str) -> bool:
        """Whether a node of this name knows what is older than this."""
        return name in self._names

    def close(self) -> None:
        """Hear no more; only where nobody spins the node meanwhile."""
        for subscription in self._newest:
            self._node.destroy_subscription(subscription)
        self._newest.clear()
