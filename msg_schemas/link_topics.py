"""Specifications of the bridge to the drives of a real or emulated machine."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.specifications import SET_BOOL, Intent, Service, Topic

LINK_TOPICS = (
    Topic(
        topics.LINK_STATUS,
        "status of the link to the drives: round trips, missed deadlines and lost frames; of "
        "each device its state, clock offset and losses; published by the wall clock",
        "diagnostic_msgs/msg/DiagnosticArray",
        Intent.STATE,
        rate=2.0,
    ),
)

LINK_SERVICES = (
    Service(
        topics.DRIVES_ARM,
        "true arms all drives, refused while one is missing; false removes their power and "
        "closes the brake, always accepted",
        SET_BOOL,
    ),
)
