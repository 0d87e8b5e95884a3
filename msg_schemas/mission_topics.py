"""Rows of the mission: what its supervisor tells, and what operators ask of it."""

from __future__ import annotations

from msg_schemas import samples, topics
from msg_schemas.machine import (
    FAILED_TRIALS,
    JUMPS_FLOWN,
    LEGS_LEFT,
    MISSION_LEG,
    PICTURES_TAKEN,
)
from msg_schemas.phases import MissionPhase
from msg_schemas.specifications import Intent, Service, Topic, scalar_fields

_NODE = "mission_node"

_STATE = {
    MISSION_LEG: "number of the leg that is done or comes next, from 1; 0 = none",
    LEGS_LEFT: "legs that come after it",
    FAILED_TRIALS: "trials of the leg that have failed",
    PICTURES_TAKEN: "pictures of the wall in this mission",
    JUMPS_FLOWN: "jumps in this mission",
}

MISSION_TOPICS = (
    Topic(
        topics.MISSION_PHASE,
        "what the mission is doing; standby = nothing is under way, holding and aborted wait for "
        "an operator",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        _NODE,
        None,
        words=tuple(MissionPhase),
        spatial_only=True,
    ),
    Topic(
        topics.MISSION_STATE,
        "how far the mission is",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.STATE,
        _NODE,
        2.0,
        fields=scalar_fields("-", **_STATE),
        joints=tuple(_STATE),
        spatial_only=True,
    ),
)  # fmt: skip

_TRIGGER = "std_srvs/srv/Trigger"

MISSION_SERVICES = (
    Service(
        topics.MISSION_GO,
        "begins the mission; after an abort, the way home from where the rover is",
        _TRIGGER,
        _NODE,
    ),
    Service(topics.MISSION_HOLD, "brings all to rest; the leg waits", _TRIGGER, _NODE),
    Service(topics.MISSION_RESUME, "begins the leg again that a hold has left", _TRIGGER, _NODE),
    Service(
        topics.MISSION_SKIP,
        "leaves the present leg out; refused where the rover would not come home without it",
        _TRIGGER,
        _NODE,
    ),
    Service(
        topics.MISSION_ABORT,
        "brings all to rest and forgets the plan; always done",
        _TRIGGER,
        _NODE,
    ),
)
