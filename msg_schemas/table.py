"""The contract's table: every topic and service of the suite, in one place.

Each specification states message, rate, frame, units, limits, and the reaction to late and
missing messages; ``access`` lists who publishes and serves. Nodes, recorder, reports and the
generated document all read this table; topic names are defined in ``topics`` only.

The specifications are in ``plant_topics``, ``link_topics``, ``descent_topics``, ``drive_topics``,
``jump_topics``, ``mission_topics`` and ``node_topics``; their classes in ``specifications``;
frames, joints and limits in ``machine``. Other packages import all of them from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from msg_schemas.descent_topics import DESCENT_SERVICES, DESCENT_TOPICS
from msg_schemas.drive_topics import DRIVE_SERVICES, DRIVE_TOPICS
from msg_schemas.jump_topics import JUMP_SERVICES, JUMP_TOPICS
from msg_schemas.link_topics import LINK_SERVICES, LINK_TOPICS
from msg_schemas.machine import (
    ALARM_NAMES,
    BODY1_FRAME,
    BODY2_FRAME,
    BODY_SWITCH,
    CAMERA_FRAME,
    CAMERA_OPTICAL_FRAME,
    CAMERA_RATE,
    DEPTH,
    DEPTH_GOAL,
    ENERGY_NAMES,
    FLOOR_SWITCH,
    FLYWHEEL,
    FLYWHEEL_BUDGET,
    FLYWHEEL_MOMENTUM,
    FLYWHEEL_TRAVEL,
    FORWARD,
    FRAMES,
    GOAL_DISTANCE,
    GOALS_LEFT,
    GYRO_BIAS,
    HEADING,
    HEADING_ERROR,
    HEADING_GOAL,
    HEADING_TURN,
    IMU_FRAME,
    JUMP_LATCH,
    JUMP_MOTOR,
    JUMP_SCREW,
    JUMP_SLIDER,
    JUMP_STROKE,
    MAX_DRIVE_SPEED,
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
    MAX_TURN_RATE,
    MAX_WHEEL_RATE,
    MAX_WHEEL_TORQUE,
    OBSERVATION_STOP,
    PAYOUT,
    PICTURE,
    PITCH,
    PLAIN_STOP,
    POSITION_ERROR,
    REFERENCE,
    ROLL,
    SLIP,
    SMALLEST_LIMIT,
    SMEAR,
    STOPS_LEFT,
    STRETCHED,
    SWING_ERROR,
    SWING_FREQUENCY,
    SWING_MAJOR,
    SWING_MINOR,
    SWING_PLANE,
    TENSION,
    TETHER_FRAME,
    TETHER_OUT,
    TETHER_RANGE,
    TILT_X,
    TILT_Y,
    TRAVEL_BUDGET,
    WALL_DISTANCE,
    WHEEL_BUDGET,
    WHEEL_DRIVE,
    WHEEL_EFFORT,
    WHEEL_LEFT,
    WHEEL_MOMENTUM,
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
    WINCH_WHILE_RENEWED,
    WORLD_FRAME,
    YAW,
    YAW_ERROR,
)
from msg_schemas.mission_topics import MISSION_SERVICES, MISSION_TOPICS
from msg_schemas.node_topics import NODE_SERVICES, NODE_TOPICS
from msg_schemas.plant_topics import PLANT_SERVICES, PLANT_TOPICS
from msg_schemas.specifications import (
    Audience,
    Field,
    Intent,
    Service,
    StalePolicy,
    Topic,
    Unstamped,
)

__all__ = [
    "ALARM_NAMES",
    "BODY1_FRAME",
    "BODY2_FRAME",
    "BODY_SWITCH",
    "CAMERA_FRAME",
    "CAMERA_OPTICAL_FRAME",
    "CAMERA_RATE",
    "CONTRACT_VERSION",
    "DEPTH",
    "DEPTH_GOAL",
    "ENERGY_NAMES",
    "FLOOR_SWITCH",
    "FLYWHEEL",
    "FLYWHEEL_BUDGET",
    "FLYWHEEL_MOMENTUM",
    "FLYWHEEL_TRAVEL",
    "FORWARD",
    "FRAMES",
    "GOALS_LEFT",
    "GOAL_DISTANCE",
    "GYRO_BIAS",
    "HEADING",
    "HEADING_ERROR",
    "HEADING_GOAL",
    "HEADING_TURN",
    "IMU_FRAME",
    "JUMP_LATCH",
    "JUMP_MOTOR",
    "JUMP_SCREW",
    "JUMP_SLIDER",
    "JUMP_STROKE",
    "MAX_DRIVE_SPEED",
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
    "MAX_TURN_RATE",
    "MAX_WHEEL_RATE",
    "MAX_WHEEL_TORQUE",
    "OBSERVATION_STOP",
    "PAYOUT",
    "PICTURE",
    "PITCH",
    "PLAIN_STOP",
    "POSITION_ERROR",
    "REFERENCE",
    "ROLL",
    "SERVICES",
    "SLIP",
    "SMALLEST_LIMIT",
    "SMEAR",
    "STOPS_LEFT",
    "STRETCHED",
    "SWING_ERROR",
    "SWING_FREQUENCY",
    "SWING_MAJOR",
    "SWING_MINOR",
    "SWING_PLANE",
    "TENSION",
    "TETHER_FRAME",
    "TETHER_OUT",
    "TETHER_RANGE",
    "TILT_X",
    "TILT_Y",
    "TOPICS",
    "TRAVEL_BUDGET",
    "WALL_DISTANCE",
    "WHEEL_BUDGET",
    "WHEEL_DRIVE",
    "WHEEL_EFFORT",
    "WHEEL_LEFT",
    "WHEEL_MOMENTUM",
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
    "WINCH_WHILE_RENEWED",
    "WORLD_FRAME",
    "YAW",
    "YAW_ERROR",
    "Audience",
    "Field",
    "Intent",
    "Service",
    "StalePolicy",
    "Topic",
    "Unstamped",
    "find_topic",
]

CONTRACT_VERSION = "5.0.0"

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
