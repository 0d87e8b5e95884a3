"""Quality of service that publishers offer: what a recorder may request, and its form in bags."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

QUEUE_DEPTH = 1000
_NANO = 1_000_000_000


STRICTEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=QUEUE_DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def strongest_profile(offers: Sequence[Any], requested: QoSProfile = STRICTEST) -> QoSProfile:
    """The strongest profile, at most as strong as ``requested``, that every publisher satisfies."""
    reliable = requested.reliability == ReliabilityPolicy.RELIABLE and all(
        offer.qos_profile.reliability == ReliabilityPolicy.RELIABLE for offer in offers
    )
    latched = requested.durability == DurabilityPolicy.TRANSIENT_LOCAL and all(
        offer.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers
    )
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=requested.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def are_equal(one: QoSProfile, other: QoSProfile) -> bool:
    """Whether reliability and durability are equal."""
    return bool(one.reliability == other.reliability and one.durability == other.durability)


def as_rosbags(profile: QoSProfile) -> Qos:
    """Convert a QoS profile to the form of bags; unset durations are infinite in rmw."""

    def span(duration: Any) -> QosTime:
        return QosTime(duration.nanoseconds // _NANO, duration.nanoseconds % _NANO)

    return Qos(
        history=_named(QosHistory, profile.history),
        depth=profile.depth,
        reliability=_named(QosReliability, profile.reliability),
        durability=_named(QosDurability, profile.durability),
        deadline=span(profile.deadline),
        lifespan=span(profile.lifespan),
        liveliness=_named(QosLiveliness, profile.liveliness),
        liveliness_lease_duration=span(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions),
    )


def _named(kind: Any, policy: Any) -> Any:
    return kind.__members__.get(policy.name, kind.UNKNOWN)
