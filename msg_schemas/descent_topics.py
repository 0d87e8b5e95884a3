"""Specifications of the descent: requested stops, state of the controller, pictures."""

from __future__ import annotations

from math import pi

from msg_schemas import topics
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
    NO_WALL,
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
    TRIGGER,
    UNUSED,
    Entry,
    Field,
    Intent,
    JointRow,
    Service,
    StalePolicy,
    Topic,
    joint_fields,
)

_TURNING = 100.0  # largest published rate [rad/s]
_LATER_0 = (None, 0.0, 0.0)  # an operator may leave the rate to the node


def _rate(about: str) -> Entry:
    return ("rad/s", about, -_TURNING, _TURNING)


def _angle(about: str, limit: float = 2.0 * pi) -> Entry:
    return ("rad", about, -limit, limit)


def _share(of: str) -> Entry:
    return ("-", f"used fraction of the budget by {of}, signed; 1 = exhausted", -1e3, 1e3)


def _stop(name: str, about: str) -> tuple[Field, ...]:
    return joint_fields(
        name,
        ("m", f"depth, as length at the drum, {about}", 0.0, MAX_LENGTH),
        ("m/s", "largest payout rate; 0 = the node's parameter", 0.0, MAX_PAYOUT_RATE),
        defaults=_LATER_0,
    )


_STATE: tuple[JointRow, ...] = (
    (DEPTH, ("m", "length at the drum", 0.0, MAX_LENGTH), ("m/s", "its rate", -5.0, 5.0)),
    (DEPTH_GOAL, ("m", "depth setpoint, as length at the drum", 0.0, MAX_LENGTH)),
    (STOPS_LEFT, ("-", "number of remaining stops", 0.0, 1e6)),
    (SWING_MAJOR, _angle("larger amplitude of the swing's ellipse")),
    (
        SWING_MINOR,
        _angle("smaller amplitude, positive counter-clockwise from above, 0 = plane swing"),
    ),
    (SWING_PLANE, _angle("direction of the major axis, from base_link x to y")),
    (SWING_FREQUENCY, UNUSED, _rate("angular frequency of the swing")),
    (SWING_ERROR, UNUSED, _rate("standard deviation of the swing's rate")),
    (
        TILT_X,
        _angle("tilt of the rover relative to the tether, about base_link x"),
        _rate("its rate"),
    ),
    (
        TILT_Y,
        _angle("tilt of the rover relative to the tether, about base_link y"),
        _rate("its rate"),
    ),
    (HEADING, _angle("about the plumb line since the start, by the gyro"), _rate("its rate")),
    (HEADING_GOAL, _angle("heading setpoint; without one the present heading")),
    (YAW_ERROR, UNUSED, _rate("standard deviation of the heading's rate")),
    (CAMERA_RATE, UNUSED, _rate("magnitude of the camera's angular rate")),
    (WHEEL_MOMENTUM, ("N m s", "momentum demand on the wheels, about base_link y", -1e3, 1e3)),
    (WHEEL_BUDGET, _share("momentum")),
    (FLYWHEEL_MOMENTUM, ("N m s", "momentum demand on the flywheel, about base_link x", -1e3, 1e3)),
    (FLYWHEEL_BUDGET, _share("momentum")),
    (FLYWHEEL_TRAVEL, ("rad", "screw angle from the middle of the nut's free travel", -1e9, 1e9)),
    (TRAVEL_BUDGET, _share("screw travel")),
)

DESCENT_TOPICS = (
    Topic(
        topics.DESCENT_REQUEST,
        "requests a stop of the descent or ascent, with or without pictures by the joint's "
        "name; each message appends one stop. Without stops left, the heading joint requests "
        "a turn, whose heading is held until the next request",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        fields=(
            *_stop(OBSERVATION_STOP, "of a stop with pictures"),
            *_stop(PLAIN_STOP, "of a stop"),
            *joint_fields(
                HEADING_TURN,
                _angle("to turn by about the plumb line, counter-clockwise from above", pi),
                defaults=_LATER_0,
            ),
        ),
        joints=(OBSERVATION_STOP, PLAIN_STOP, HEADING_TURN),
        one_joint=True,
        stale=StalePolicy(max_age=2.0, max_lead=0.5),
    ),
    Topic(
        topics.DESCENT_PHASE,
        "phase of the descent controller",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(DescentPhase),
    ),
    Topic(
        topics.DESCENT_STATE,
        "estimates, setpoints and used rotor budgets of the descent controller",
        "sensor_msgs/msg/JointState",
        Intent.STATE,
        rate=10.0,
        fields=tuple(row for entry in _STATE for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _STATE),
    ),
    Topic(
        topics.DESCENT_OBSERVATION,
        "one picture of the wall, stamped with the time of its exposure; camera values are "
        "left out if the camera's samples are missing",
        "sensor_msgs/msg/JointState",
        Intent.EVENT,
        fields=(
            *joint_fields(PICTURE, ("-", "number since the start, from 1", 1.0, 1e9)),
            *joint_fields(DEPTH, ("m", "length at the drum", 0.0, MAX_LENGTH)),
            *joint_fields(
                HEADING, _angle("about the plumb line since the start, by the gyro")
            ),
            *joint_fields(
                CAMERA_RATE, velocity=_rate("estimated magnitude of the camera's angular rate")
            ),
            *joint_fields(SMEAR, ("px", "smear of the picture, from the camera", 0.0, 1e6)),
            *joint_fields(
                WALL_DISTANCE,
                (
                    "m",
                    f"distance of the wall along the camera's axis; {NO_WALL:g} = none seen",
                    0.0,
                    NO_WALL,
                ),
            ),
        ),
        joints=(PICTURE, DEPTH, HEADING, CAMERA_RATE),
        optional_joints=(SMEAR, WALL_DISTANCE),
    ),
)  # fmt: skip

DESCENT_SERVICES = (
    Service(
        topics.DESCENT_HOLD,
        "brings the rover to rest and keeps the attitude; the stops wait",
        TRIGGER,
    ),
    Service(topics.DESCENT_RESUME, "resumes the descent after a hold", TRIGGER),
    Service(
        topics.DESCENT_ABORT,
        "discards all stops and the heading, brings the rover to rest and keeps the attitude",
        TRIGGER,
    ),
    Service(
        topics.DESCENT_RELEASE,
        "releases winch, wheels and flywheel; refused while stops are left",
        TRIGGER,
    ),
)
