"""Messages that wait in an rclpy subscription, taken without the executor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rclpy.exceptions import InvalidHandle

if TYPE_CHECKING:
    from rclpy.subscription import Subscription


def taken(
    subscription: Subscription, kind: type[Any], most: int
) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
    """Take waiting messages, until there are none or a message has closed the subscription.

    Args:
        subscription: that they wait in; it is raw.
        kind: class of the messages.
        most: number of messages to take.

    Yields:
        The bytes of each message, and what the middleware knows of it.
    """
    for _ in range(most):
        try:
            with subscription.handle:
                message = subscription.handle.take_message(kind, True)
        except InvalidHandle:
            return
        if message is None:
            return
        yield message
