"""Actions: typed goals beside the topics, which `action_node` turns into commands.

The messages are those of the package `mother_rover_interfaces`. A goal becomes one command, whose
record determines feedback and result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from msg_schemas import topics

INTERFACES = "mother_rover_interfaces"
"""Package of the actions' messages."""


@dataclass(frozen=True)
class ActionSpecification:
    """Specification of an action.

    Attributes:
        name: of the action.
        about: what it does.
        action: its type.
        command: request topic, or service, by which its goals go to the node that executes them.
        hold: service that a cancelled goal calls.
    """

    name: str
    about: str
    action: str
    command: str
    hold: str


_ROWS = (
    ActionSpecification(
        "descend",
        "lowers or raises the hanging rover to a depth",
        f"{INTERFACES}/action/Descend",
        topics.DESCENT_REQUEST,
        topics.DESCENT_HOLD,
    ),
    ActionSpecification(
        "turn",
        "turns the hanging rover about the plumb line",
        f"{INTERFACES}/action/Turn",
        topics.DESCENT_REQUEST,
        topics.DESCENT_HOLD,
    ),
    ActionSpecification(
        "drive",
        "drives to a place on the floor",
        f"{INTERFACES}/action/Drive",
        topics.DRIVE_GOAL,
        topics.DRIVE_STOP,
    ),
    ActionSpecification(
        "jump",
        "compresses the spring and jumps",
        f"{INTERFACES}/action/Jump",
        topics.JUMP_REQUEST,
        topics.JUMP_ABORT,
    ),
    ActionSpecification(
        "mission",
        "flies the plan of the mission",
        f"{INTERFACES}/action/Mission",
        topics.MISSION_GO,
        topics.MISSION_HOLD,
    ),
)

ACTIONS: Mapping[str, ActionSpecification] = MappingProxyType({row.name: row for row in _ROWS})
"""Actions by name."""
