"""Quality of service by intent.

All publishers are reliable, so that the recorder loses nothing; best-effort
subscribers still match them. Latched topics and events are kept for late joiners.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msg_schemas.specifications import Intent

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile

_DEPTH = {
    Intent.COMMAND: 10,
    Intent.STATE: 100,
    Intent.SENSOR: 100,
    Intent.LATCHED: 1,
    Intent.EVENT: 200,
    Intent.CLOCK: 10,
}
LATCHED_NODES = 50
"""Depth of a queue for a latched topic that every node publishes: all messages arrive at once."""
_SENT_DEPTH = 1000  # of a publisher that keeps nothing for late joiners
_KEPT_FOR_LATE_JOINERS = frozenset({Intent.LATCHED, Intent.EVENT})


def describe(intent: Intent) -> str:
    """Return the profile in words, for the contract's document."""
    durability = "transient local" if intent in _KEPT_FOR_LATE_JOINERS else "volatile"
    sent = "" if intent in _KEPT_FOR_LATE_JOINERS else f", publishers {_SENT_DEPTH}"
    return f"reliable, {durability}, keep last {_DEPTH[intent]}{sent}"


def depth(intent: Intent, given: int | None = None) -> int:
    """Return the depth of a queue; ``given`` deepens a subscriber's."""
    return _DEPTH[intent] if given is None else given


def kept(intent: Intent) -> int:
    """Return how many messages a publisher keeps for late joiners."""
    return _DEPTH[intent] if intent in _KEPT_FOR_LATE_JOINERS else 0


def profile(intent: Intent, given_depth: int | None = None) -> QoSProfile:
    """Return the rclpy profile for an intent; ``given_depth`` deepens a subscriber's queue."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy  # noqa: PLC0415

    is_kept = intent in _KEPT_FOR_LATE_JOINERS
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth(intent, given_depth),
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_kept else DurabilityPolicy.VOLATILE,
    )


def publisher_profile(intent: Intent, kept: int | None = None) -> QoSProfile:
    """Return a publisher's rclpy profile for an intent.

    A publisher keeps what a stalled subscriber has not received yet, so that a recorder that gets
    no processor for a second loses nothing; it delays nobody.

    Args:
        intent: of the topic.
        kept: messages for late joiners, where the intent keeps any.
    """
    return profile(intent, kept if intent in _KEPT_FOR_LATE_JOINERS else _SENT_DEPTH)
