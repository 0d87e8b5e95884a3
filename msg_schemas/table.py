"""The contract's table: every topic and service of the suite, in one place.

Each specification states message, rate, frame, units, limits, and the reaction to late and
missing messages; ``access`` lists who publishes and serves. Nodes, recorder, reports and the
generated document all read this table; topic names are defined in ``topics`` only.

The specifications are in ``plant_topics``, ``link_topics``, ``descent_topics``, ``drive_topics``,
``jump_topics``, ``mission_topics`` and ``node_topics``; their classes in ``specifications``;
frames, joints and limits in ``machine``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from msg_schemas.descent_topics import DESCENT_SERVICES, DESCENT_TOPICS
from msg_schemas.drive_topics import DRIVE_SERVICES, DRIVE_TOPICS
from msg_schemas.jump_topics import JUMP_SERVICES, JUMP_TOPICS
from msg_schemas.link_topics import LINK_SERVICES, LINK_TOPICS
from msg_schemas.mission_topics import MISSION_SERVICES, MISSION_TOPICS
from msg_schemas.node_topics import NODE_SERVICES, NODE_TOPICS
from msg_schemas.plant_topics import PLANT_SERVICES, PLANT_TOPICS
from msg_schemas.specifications import Service, Topic

CONTRACT_VERSION = "7.0.0"

TOPICS: Mapping[str, Topic] = MappingProxyType(
    {
        row.name: row
        for row in (
            *PLANT_TOPICS,
            *LINK_TOPICS,
            *DESCENT_TOPICS,
            *DRIVE_TOPICS,
            *JUMP_TOPICS,
            *MISSION_TOPICS,
            *NODE_TOPICS,
        )
    }
)
SERVICES: Mapping[str, Service] = MappingProxyType(
    {
        row.name: row
        for row in (
            *PLANT_SERVICES,
            *LINK_SERVICES,
            *DESCENT_SERVICES,
            *DRIVE_SERVICES,
            *JUMP_SERVICES,
            *MISSION_SERVICES,
            *NODE_SERVICES,
        )
    }
)


def find_topic(name: str) -> Topic:
    """Return the specification of a topic; the KeyError of an unknown name lists all names."""
    try:
        return TOPICS[name]
    except KeyError:
        msg = f"the contract has no topic {name!r}; it has {', '.join(sorted(TOPICS))}"
        raise KeyError(msg) from None
