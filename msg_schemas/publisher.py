"""Publisher of one topic of the contract: checks a sample, encodes it and sends the message."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import TYPE_CHECKING

from rclpy.duration import Duration

from msg_schemas import qos
from msg_schemas.codecs import encode, find_topic, message_class
from msg_schemas.refusal import Refusal
from msg_schemas.samples import Sample

if TYPE_CHECKING:
    from rclpy.node import Node


class ContractPublisher:
    """Publishes samples of one topic; a sample that violates the contract is refused, not sent.

    Args:
        node: the node that publishes.
        name: topic of the table.
        refuse: called with the refusal of each such sample.
    """

    def __init__(self, node: Node, name: str, refuse: Callable[[Refusal], None]) -> None:
        row = find_topic(name)
        self._node = node
        self._name = name
        self._refuse = refuse
        # Unique for each publisher: two nodes of the same name are two command sources.
        self._command_source = f"{node.get_fully_qualified_name()}#{secrets.token_hex(4)}"
        self._is_owned = row.one_owner
        self._publisher = node.create_publisher(
            message_class(row.message), name, qos.profile(row.intent)
        )

    def send(self, sample: Sample, requester: str = "") -> bool:
        """Encode and publish a sample; returns whether it was sent.

        Args:
            sample: of the topic's type.
            requester: name that the response to a request repeats; empty = none.
        """
        try:
            message = encode(self._name, sample)
            if self._is_owned:
                message.header.frame_id = self._command_source
            elif requester:
                message.header.frame_id = requester
            self._publisher.publish(message)
        except Refusal as refusal:
            self._refuse(refusal)
            return False
        return True

    @property
    def has_subscribers(self) -> bool:
        """Whether the topic has a subscriber; without one a costly sample need not be made."""
        return bool(self._publisher.get_subscription_count())

    def wait_for_delivery(self, timeout: float) -> None:
        """Wait until all subscribers have acknowledged what was sent, at most ``timeout`` [s]."""
        self._publisher.wait_for_all_acked(Duration(nanoseconds=round(timeout * 1e9)))

    def destroy(self) -> None:
        """Remove the publisher from the graph."""
        self._node.destroy_publisher(self._publisher)
