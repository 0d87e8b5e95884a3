"""Specifications of jumping: requests, phase, prediction and measured jump."""

from __future__ import annotations

from math import pi

from msg_schemas import topics
from msg_schemas.machine import (
    JUMP_AHEAD,
    JUMP_CLEARANCE,
    JUMP_HEIGHT,
    JUMP_LEFT,
    JUMP_PREDICTION,
    JUMP_RANGE,
    JUMP_REQUESTED,
    JUMP_SLACK,
    JUMP_STROKE,
    JUMP_TENSION,
    JUMP_TILT,
    JUMP_TIME,
    JUMP_TURN,
    MAX_JUMP_HEIGHT,
    MAX_NUT_SPEED,
    MAX_STROKE,
    ROLLOUTS,
    SPRING_GAIN,
    SPRING_ZERO,
    UPRIGHT,
    WORLD_FRAME,
)
from msg_schemas.phases import JumpPhase
from msg_schemas.specifications import (
    TRIGGER,
    Entry,
    Field,
    Intent,
    JointRow,
    Service,
    StalePolicy,
    Topic,
    joint_fields,
)

_LATER_0 = (None, 0.0, 0.0)  # an operator may leave the speed to the node
_NUT_SPEED: Entry = (
    "m/s",
    "nut speed while compressing; 0 = the node's parameter",
    0.0,
    MAX_NUT_SPEED,
)


def _predicted(name: str, unit: str, about: str, low: float, high: float) -> JointRow:
    """Median and interval of a prediction."""
    return (
        name,
        (unit, f"{about}: median", low, high),
        (unit, "lower end of the 90 % interval", low, high),
        (unit, "its upper end", low, high),
    )


def _flown(name: str, unit: str, about: str, low: float, high: float) -> JointRow:
    """Measured value and predicted interval."""
    return (
        name,
        (unit, f"{about}, measured", low, high),
        (unit, "lower end of the predicted 90 % interval; both 0 = no prediction", low, high),
        (unit, "its upper end", low, high),
    )


_RISE = (JUMP_HEIGHT, "m", "largest rise of base_link", 0.0, 1e3)
_RANGE = (JUMP_RANGE, "m", "horizontal distance from release to rest", 0.0, 1e3)
_TURN = (JUMP_TURN, "rad", "turn about the vertical", -pi, pi)
_PULL = (JUMP_TENSION, "N", "largest tension of the tether at the rover", 0.0, 1e6)

_PREDICTION: tuple[JointRow, ...] = (
    _predicted(*_RISE),
    _predicted(*_RANGE),
    _predicted(*_TURN),
    _predicted(*_PULL),
    (JUMP_STROKE, ("m", "selected compression", 0.0, 1.0)),
    (JUMP_SLACK, ("m", "slack of the tether for the jump", -1e3, 1e3)),
    (UPRIGHT, ("-", "probability of landing upright", 0.0, 1.0)),
    (ROLLOUTS, ("-", "number of simulated jumps", 0.0, 1e4)),
)

_FLOWN: tuple[JointRow, ...] = (
    _flown(*_RISE),
    _flown(*_RANGE),
    _flown(*_TURN),
    _flown(*_PULL),
    (
        JUMP_REQUESTED,
        ("m", "requested height or clearance; 0 = a stroke was requested", 0.0, MAX_JUMP_HEIGHT),
    ),
    (JUMP_AHEAD, ("m", "displacement along the heading before the jump", -1e3, 1e3)),
    (JUMP_LEFT, ("m", "displacement to the left of it", -1e3, 1e3)),
    (JUMP_STROKE, ("m", "compression at the release", 0.0, MAX_STROKE)),
    (JUMP_TILT, ("rad", "change of the direction of base_link z at rest", 0.0, pi)),
    (JUMP_TIME, ("s", "from the contact's opening to its closing", 0.0, 1e3)),
    (
        SPRING_GAIN,
        ("-", "ratio of the measured to the nominal height, updated by this jump", 0.0, 10.0),
    ),
    (SPRING_ZERO, ("m", "offset of the effective stroke, updated by this jump", -0.1, 0.1)),
)

JUMP_TOPICS = (
    Topic(
        topics.JUMP_REQUEST,
        "requests a jump by stroke, height or clearance; for a clearance the node predicts "
        "the jump, selects stroke and slack, or rejects it. The prediction joint requests a "
        "prediction without a jump",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        fields=(
            *joint_fields(
                JUMP_STROKE,
                ("m", "compression of the spring at take-off", 0.005, MAX_STROKE),
                _NUT_SPEED,
                defaults=_LATER_0,
            ),
            *joint_fields(
                JUMP_HEIGHT,
                ("m", "largest rise of base_link", 0.01, MAX_JUMP_HEIGHT),
                _NUT_SPEED,
                defaults=_LATER_0,
            ),
            *joint_fields(
                JUMP_CLEARANCE,
                ("m", "rise of base_link at the accepted risk", 0.01, MAX_JUMP_HEIGHT),
                _NUT_SPEED,
                defaults=_LATER_0,
            ),
            *joint_fields(
                JUMP_PREDICTION,
                ("m", "clearance of the predicted jump", 0.01, MAX_JUMP_HEIGHT),
                defaults=_LATER_0,
            ),
        ),
        joints=(JUMP_STROKE, JUMP_HEIGHT, JUMP_CLEARANCE, JUMP_PREDICTION),
        one_joint=True,
        stale=StalePolicy(max_age=2.0, max_lead=0.5),
    ),
    Topic(
        topics.JUMP_PHASE,
        "phase of the jump sequence",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(JumpPhase),
    ),
    Topic(
        topics.JUMP_PREDICTION,
        "predicted jump, from many simulated jumps; events state why a jump is rejected",
        "sensor_msgs/msg/JointState",
        Intent.LATCHED,
        fields=tuple(row for entry in _PREDICTION for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _PREDICTION),
    ),
    Topic(
        topics.JUMP_FLOWN,
        "measured jump from the rover's IMU, with its prediction",
        "sensor_msgs/msg/JointState",
        Intent.LATCHED,
        fields=tuple(row for entry in _FLOWN for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _FLOWN),
    ),
    Topic(
        topics.PREDICTED_JUMP,
        "predicted height and range of the next jump: a mark over the 90 % interval of the "
        "height, and rings at the ends of that of the range, as no direction is predicted",
        "visualization_msgs/msg/MarkerArray",
        Intent.LATCHED,
        frame=WORLD_FRAME,
        fields=(Field("drawing", "m", "coordinates and sizes", -1e4, 1e4),),
        spatial_only=True,
    ),
)  # fmt: skip

JUMP_SERVICES = (
    Service(
        topics.JUMP_ABORT,
        "aborts a jump before its release and lets the spring down",
        TRIGGER,
    ),
)
