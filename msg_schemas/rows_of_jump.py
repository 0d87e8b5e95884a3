"""Rows of jumping: what operators ask for, and what its controller tells."""

from __future__ import annotations

from math import pi

from msg_schemas import samples, topics
from msg_schemas.machine import (
    JUMP_HEIGHT,
    JUMP_RANGE,
    JUMP_STROKE,
    JUMP_TILT,
    JUMP_TIME,
    JUMP_TURN,
    JUMP_WANTED,
    MAX_JUMP_HEIGHT,
    MAX_NUT_SPEED,
    MAX_STROKE,
    SPRING_GAIN,
    SPRING_ZERO,
)
from msg_schemas.row_kinds import (
    UNUSED,
    Entry,
    Intent,
    Service,
    StalePolicy,
    Topic,
    joint_fields,
)

_NODE = "jump_node"
_LATER_0 = (None, 0.0, 0.0)  # an operator may leave the speed to the node
_NUT_SPEED: Entry = ("m/s", "nut speed while compressing; 0 = the node's own", 0.0, MAX_NUT_SPEED)

_FLOWN: tuple[tuple[str, Entry, Entry, Entry], ...] = (
    (
        JUMP_HEIGHT,
        ("m", "largest rise of base_link, as flown", 0.0, 1e3),
        ("m", "lower end of the interval of 90 % that was foretold", 0.0, 1e3),
        ("m", "its upper end", 0.0, 1e3),
    ),
    (
        JUMP_WANTED,
        ("m", "height that was asked for; 0 = a stroke was", 0.0, MAX_JUMP_HEIGHT),
        UNUSED,
        UNUSED,
    ),
    (JUMP_STROKE, ("m", "compression at the release", 0.0, MAX_STROKE), UNUSED, UNUSED),
    (JUMP_RANGE, ("m", "horizontal way from release to rest, as flown", 0.0, 1e3), UNUSED, UNUSED),
    (JUMP_TURN, ("rad", "about the vertical, as flown", -pi, pi), UNUSED, UNUSED),
    (JUMP_TILT, ("rad", "of base_link z at rest against before", 0.0, pi), UNUSED, UNUSED),
    (JUMP_TIME, ("s", "from the contact's opening to its closing", 0.0, 1e3), UNUSED, UNUSED),
    (
        SPRING_GAIN,
        ("-", "height over what the parameters say, as learnt with this jump", 0.0, 10.0),
        UNUSED,
        UNUSED,
    ),
    (
        SPRING_ZERO,
        ("m", "stroke beyond what the nut says, as learnt with this jump", -0.1, 0.1),
        UNUSED,
        UNUSED,
    ),
)

JUMP_TOPICS = (
    Topic(
        topics.JUMP_REQUEST,
        "an operator or the mission asks for a jump, by the spring's stroke or by the height, for "
        "which the node finds the stroke by what it has learnt of the spring",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.COMMAND,
        "operator",
        None,
        fields=(
            *joint_fields(
                JUMP_STROKE,
                ("m", "compression of the spring at take-off", 0.005, MAX_STROKE),
                _NUT_SPEED,
                UNUSED,
                _LATER_0,
            ),
            *joint_fields(
                JUMP_HEIGHT,
                ("m", "largest rise of base_link", 0.01, MAX_JUMP_HEIGHT),
                _NUT_SPEED,
                UNUSED,
                _LATER_0,
            ),
        ),
        joints=(JUMP_STROKE, JUMP_HEIGHT),
        one_joint=True,
        stale=StalePolicy(max_age=2.0, max_lead=0.5),
    ),
    Topic(
        topics.JUMP_PHASE,
        "what the jump sequencer is doing",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        _NODE,
        None,
        words=(
            "standby", "compressing", "settling", "releasing", "flight", "landed", "hooking",
            "letting_down", "fault",
        ),
    ),
    Topic(
        topics.JUMP_FLOWN,
        "what a jump came to by the rover's own IMU, beside what was foretold of it",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.LATCHED,
        _NODE,
        None,
        fields=tuple(row for entry in _FLOWN for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _FLOWN),
    ),
)  # fmt: skip

JUMP_SERVICES = (
    Service(
        topics.JUMP_ABORT,
        "ends a compression and lets the spring down softly",
        "std_srvs/srv/Trigger",
        _NODE,
    ),
)
