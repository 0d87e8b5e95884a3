"""Specifications of the mission: its phase and progress, and its services."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.machine import FAILED_TRIALS, JUMPS_FLOWN, LEGS_LEFT, MISSION_LEG, PICTURES_TAKEN
from msg_schemas.phases import MissionPhase
from msg_schemas.specifications import TRIGGER, Intent, Service, Topic, scalar_fields

_STATE = {
    MISSION_LEG: "number of the present or next leg, from 1; 0 = none",
    LEGS_LEFT: "number of remaining legs",
    FAILED_TRIALS: "failed trials of the leg",
    PICTURES_TAKEN: "number of pictures of the wall",
    JUMPS_FLOWN: "number of jumps",
}

MISSION_TOPICS = (
    Topic(
        topics.MISSION_PHASE,
        "phase of the mission; holding and aborted wait for an operator",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(MissionPhase),
        spatial_only=True,
    ),
    Topic(
        topics.MISSION_STATE,
        "progress of the mission",
        "sensor_msgs/msg/JointState",
        Intent.STATE,
        rate=2.0,
        fields=scalar_fields("-", **_STATE),
        joints=tuple(_STATE),
        spatial_only=True,
    ),
)  # fmt: skip

MISSION_SERVICES = (
    Service(
        topics.MISSION_GO,
        "starts the mission; after an abort, the way home from the present position",
        TRIGGER,
    ),
    Service(topics.MISSION_HOLD, "brings all drives to rest; the leg waits", TRIGGER),
    Service(topics.MISSION_RESUME, "restarts the leg of a hold", TRIGGER),
    Service(
        topics.MISSION_SKIP,
        "skips the present leg; refused if the rover could not return without it",
        TRIGGER,
    ),
    Service(
        topics.MISSION_ABORT,
        "brings all drives to rest and discards the plan; always accepted",
        TRIGGER,
    ),
)
