"""Rows of the descent: stops that operators ask for, what its controller tells, its pictures."""

from __future__ import annotations

from math import pi

from msg_schemas import samples, topics
from msg_schemas.machine import (
    CAMERA_RATE,
    DEPTH,
    DEPTH_GOAL,
    FLYWHEEL_BUDGET,
    FLYWHEEL_MOMENTUM,
    FLYWHEEL_TRAVEL,
    HEADING,
    HEADING_GOAL,
    HEADING_TURN,
    MAX_LENGTH,
    MAX_PAYOUT_RATE,
    OBSERVATION_STOP,
    PICTURE,
    PLAIN_STOP,
    SMEAR,
    STOPS_LEFT,
    SWING_ERROR,
    SWING_FREQUENCY,
    SWING_MAJOR,
    SWING_MINOR,
    SWING_PLANE,
    TILT_X,
    TILT_Y,
    TRAVEL_BUDGET,
    WALL_DISTANCE,
    WHEEL_BUDGET,
    WHEEL_MOMENTUM,
    YAW_ERROR,
)
from msg_schemas.phases import DescentPhase
from msg_schemas.specifications import (
    UNUSED,
    Entry,
    Field,
    Intent,
    Service,
    StalePolicy,
    Topic,
    joint_fields,
)

_NODE = "descent_node"
_TURNING = 100.0  # largest rate that is told [rad/s]
_LATER_0 = (None, 0.0, 0.0)  # an operator may leave the rate to the node


def _rate(about: str) -> Entry:
    return ("rad/s", about, -_TURNING, _TURNING)


def _angle(about: str, limit: float = 2.0 * pi) -> Entry:
    return ("rad", about, -limit, limit)


def _share(of: str) -> Entry:
    return ("-", f"part of the budget that {of} uses, with its sign; 1 = spent", -1e3, 1e3)


def _stop(name: str, about: str) -> tuple[Field, ...]:
    return joint_fields(
        name,
        ("m", f"depth, as length at the drum, {about}", 0.0, MAX_LENGTH),
        ("m/s", "largest payout rate on the way; 0 = the node's own", 0.0, MAX_PAYOUT_RATE),
        UNUSED,
        _LATER_0,
    )


_STATE: tuple[tuple[str, Entry, Entry], ...] = (
    (DEPTH, ("m", "length at the drum", 0.0, MAX_LENGTH), ("m/s", "its rate", -5.0, 5.0)),
    (DEPTH_GOAL, ("m", "length that is gone to or kept", 0.0, MAX_LENGTH), UNUSED),
    (STOPS_LEFT, ("-", "stops that wait behind the present one", 0.0, 1e6), UNUSED),
    (SWING_MAJOR, _angle("larger amplitude of the swing's ellipse"), UNUSED),
    (
        SWING_MINOR,
        _angle("smaller one, positive counter-clockwise seen from above, 0 in a plane"),
        UNUSED,
    ),
    (SWING_PLANE, _angle("where the major axis lies, from base_link x to y"), UNUSED),
    (SWING_FREQUENCY, UNUSED, _rate("angular frequency of the swing")),
    (SWING_ERROR, UNUSED, _rate("standard deviation of the swing's rate")),
    (TILT_X, _angle("of the rover against the tether, about base_link x"), _rate("its rate")),
    (TILT_Y, _angle("of the rover against the tether, about base_link y"), _rate("its rate")),
    (HEADING, _angle("about the plumb line since the start, by the gyro"), _rate("its rate")),
    (HEADING_GOAL, _angle("heading that is turned to or held; without one the present"), UNUSED),
    (YAW_ERROR, UNUSED, _rate("standard deviation of the heading's rate")),
    (CAMERA_RATE, UNUSED, _rate("magnitude of the rate at which the camera turns")),
    (
        WHEEL_MOMENTUM,
        ("N m s", "that the attitude asks of the wheels, about base_link y", -1e3, 1e3),
        UNUSED,
    ),
    (WHEEL_BUDGET, _share("it"), UNUSED),
    (
        FLYWHEEL_MOMENTUM,
        ("N m s", "that the attitude asks of the flywheel, about base_link x", -1e3, 1e3),
        UNUSED,
    ),
    (FLYWHEEL_BUDGET, _share("it"), UNUSED),
    (
        FLYWHEEL_TRAVEL,
        ("rad", "angle of the screw from the middle of the nut's free travel", -1e9, 1e9),
        UNUSED,
    ),
    (TRAVEL_BUDGET, _share("the screw's angle"), UNUSED),
)

DESCENT_TOPICS = (
    Topic(
        topics.DESCENT_REQUEST,
        "an operator or the mission asks for a stop of the descent or ascent; the joint's name "
        "says whether pictures are taken there. Each message adds one stop to those that are "
        "still to come. Where none is left, a heading can be turned to, and is held until the "
        "next request",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.COMMAND,
        "operator",
        None,
        fields=(
            *_stop(OBSERVATION_STOP, "to go to and take pictures at"),
            *_stop(PLAIN_STOP, "to go to"),
            *joint_fields(
                HEADING_TURN,
                _angle("to turn by about the plumb line, counter-clockwise from above", pi),
                UNUSED,
                UNUSED,
                _LATER_0,
            ),
        ),
        joints=(OBSERVATION_STOP, PLAIN_STOP, HEADING_TURN),
        one_joint=True,
        stale=StalePolicy(max_age=2.0, max_lead=0.5),
    ),
    Topic(
        topics.DESCENT_PHASE,
        "what the descent is doing; released = it drives nothing until a stop is asked for",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        _NODE,
        None,
        words=tuple(DescentPhase),
    ),
    Topic(
        topics.DESCENT_STATE,
        "what the descent's controller makes of IMU and encoders, what it goes to, and how much "
        "of its rotors' budgets is used",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.STATE,
        _NODE,
        10.0,
        fields=tuple(row for entry in _STATE for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _STATE),
    ),
    Topic(
        topics.DESCENT_OBSERVATION,
        "one picture of the wall, stamped with the time of its exposure; what the camera says of "
        "it is left out where the camera was not heard",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.EVENT,
        _NODE,
        None,
        fields=(
            *joint_fields(PICTURE, ("-", "number since the start, from 1", 1.0, 1e9)),
            *joint_fields(DEPTH, ("m", "length at the drum", 0.0, MAX_LENGTH)),
            *joint_fields(
                HEADING, _angle("about the plumb line since the start, by the gyro")
            ),
            *joint_fields(
                CAMERA_RATE, velocity=_rate("magnitude of the camera's rate, as estimated")
            ),
            *joint_fields(SMEAR, ("px", "smear of the picture, as the camera tells", 0.0, 1e6)),
            *joint_fields(
                WALL_DISTANCE,
                ("m", "distance of the wall along the camera's axis; 1000 = none seen", 0.0, 1e3),
            ),
        ),
        joints=(PICTURE, DEPTH, HEADING, CAMERA_RATE),
        optional_joints=(SMEAR, WALL_DISTANCE),
    ),
)  # fmt: skip

_TRIGGER = "std_srvs/srv/Trigger"

DESCENT_SERVICES = (
    Service(
        topics.DESCENT_HOLD,
        "comes to rest where it is and keeps the attitude; what was to be done waits",
        _TRIGGER,
        _NODE,
    ),
    Service(topics.DESCENT_RESUME, "goes on with what a hold has left", _TRIGGER, _NODE),
    Service(
        topics.DESCENT_ABORT,
        "forgets all stops and a heading, comes to rest where it is and keeps the attitude",
        _TRIGGER,
        _NODE,
    ),
    Service(
        topics.DESCENT_RELEASE,
        "gives winch, wheels and flywheel back to others; refused while stops are left",
        _TRIGGER,
        _NODE,
    ),
)
