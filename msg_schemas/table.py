"""The contract's table: every topic and service of the suite, in one place.

Each row says who speaks to whom, with which message, how often, in which frame
and units, within which limits, and what happens when it falls silent or comes
late. Nodes, recorder, reports and the generated document all read this table;
no topic name stands anywhere else.

The rows stand in ``rows_of_plant`` and ``rows_of_nodes``; what a row can say in
``row_kinds``; frames, joints and largest values in ``machine``. Others import all
of it from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from msg_schemas.machine import (
    ALARM_NAMES,
    BODY1_FRAME,
    BODY2_FRAME,
    BODY_SWITCH,
    ENERGY_NAMES,
    FLOOR_SWITCH,
    FLYWHEEL,
    FRAMES,
    JUMP_LATCH,
    JUMP_MOTOR,
    JUMP_SCREW,
    JUMP_STROKE,
    MAX_FLYWHEEL_TORQUE,
    MAX_FREE_TRAVEL,
    MAX_LENGTH,
    MAX_NUT_FORCE,
    MAX_NUT_SPEED,
    MAX_PAYOUT_RATE,
    MAX_RATE_TRIM,
    MAX_SLACK,
    MAX_STROKE,
    MAX_TENSION,
    MAX_WHEEL_RATE,
    MAX_WHEEL_TORQUE,
    PAYOUT,
    REFERENCE,
    SMALLEST_LIMIT,
    SMEAR,
    STRETCHED,
    TENSION,
    TETHER_OUT,
    WALL_DISTANCE,
    WHEEL_DRIVE,
    WHEEL_LEFT,
    WHEEL_MOTOR,
    WHEEL_RIGHT,
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_LIMIT,
    WINCH_MOTOR,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
    WORLD_FRAME,
)
from msg_schemas.row_kinds import (
    Audience,
    Field,
    Intent,
    Service,
    StalePolicy,
    Topic,
    Unstamped,
)
from msg_schemas.rows_of_nodes import NODE_SERVICES, NODE_TOPICS
from msg_schemas.rows_of_plant import PLANT_SERVICES, PLANT_TOPICS

__all__ = [
    "ALARM_NAMES",
    "BODY1_FRAME",
    "BODY2_FRAME",
    "BODY_SWITCH",
    "CONTRACT_VERSION",
    "ENERGY_NAMES",
    "FLOOR_SWITCH",
    "FLYWHEEL",
    "FRAMES",
    "JUMP_LATCH",
    "JUMP_MOTOR",
    "JUMP_SCREW",
    "JUMP_STROKE",
    "MAX_FLYWHEEL_TORQUE",
    "MAX_FREE_TRAVEL",
    "MAX_LENGTH",
    "MAX_NUT_FORCE",
    "MAX_NUT_SPEED",
    "MAX_PAYOUT_RATE",
    "MAX_RATE_TRIM",
    "MAX_SLACK",
    "MAX_STROKE",
    "MAX_TENSION",
    "MAX_WHEEL_RATE",
    "MAX_WHEEL_TORQUE",
    "PAYOUT",
    "REFERENCE",
    "SERVICES",
    "SMALLEST_LIMIT",
    "SMEAR",
    "STRETCHED",
    "TENSION",
    "TETHER_OUT",
    "TOPICS",
    "WALL_DISTANCE",
    "WHEEL_DRIVE",
    "WHEEL_LEFT",
    "WHEEL_MOTOR",
    "WHEEL_RIGHT",
    "WINCH_AT_RATE",
    "WINCH_AT_TENSION",
    "WINCH_BRAKE",
    "WINCH_DRUM",
    "WINCH_LIMIT",
    "WINCH_MOTOR",
    "WINCH_SLACK",
    "WINCH_TO_LENGTH",
    "WORLD_FRAME",
    "Audience",
    "Field",
    "Intent",
    "Service",
    "StalePolicy",
    "Topic",
    "Unstamped",
]

CONTRACT_VERSION = "2.0.0"

TOPICS: Mapping[str, Topic] = MappingProxyType(
    {row.name: row for row in (*PLANT_TOPICS, *NODE_TOPICS)}
)
SERVICES: Mapping[str, Service] = MappingProxyType(
    {row.name: row for row in (*PLANT_SERVICES, *NODE_SERVICES)}
)
