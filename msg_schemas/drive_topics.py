"""Rows of driving: what operators ask of the wheels, and what their controller tells."""

from __future__ import annotations

from math import pi

from msg_schemas import samples, topics
from msg_schemas.machine import (
    BODY1_FRAME,
    FORWARD,
    GOAL_DISTANCE,
    GOALS_LEFT,
    GYRO_BIAS,
    HEADING_ERROR,
    MAX_DRIVE_SPEED,
    MAX_LENGTH,
    MAX_TURN_RATE,
    PITCH,
    POSITION_ERROR,
    ROLL,
    SLIP,
    TETHER_RANGE,
    WHEEL_EFFORT,
    WORLD_FRAME,
    YAW,
)
from msg_schemas.phases import DrivePhase
from msg_schemas.specifications import (
    UNUSED,
    Entry,
    Field,
    Intent,
    Service,
    StalePolicy,
    Topic,
    axis_fields,
    joint_fields,
)

_NODE = "drive_node"
_GOAL_STALE = StalePolicy(max_age=2.0, max_lead=0.5)

_POSE = (
    *axis_fields("position", "m", "where base_link is to be; z is not used", MAX_LENGTH),
    *axis_fields(
        "orientation",
        "-",
        "unit quaternion, of which the heading is used; all 0 leaves the heading open",
        1.0 + 1e-9,
        "xyzw",
    ),
)

_TWIST = (
    Field(
        "linear.x",
        "m/s",
        "straight ahead; while turning 0, or what the turn about the right wheel gives by itself",
        -MAX_DRIVE_SPEED,
        MAX_DRIVE_SPEED,
    ),
    Field("linear.y", "m/s", "not used, 0", 0.0, 0.0),
    Field("linear.z", "m/s", "not used, 0", 0.0, 0.0),
    Field("angular.x", "rad/s", "not used, 0", 0.0, 0.0),
    Field("angular.y", "rad/s", "not used, 0", 0.0, 0.0),
    Field(
        "angular.z",
        "rad/s",
        "turning left about the right wheel, which the ratchet holds",
        -MAX_TURN_RATE,
        MAX_TURN_RATE,
    ),
)


def _angle(about: str) -> Entry:
    return ("rad", about, -pi, pi)


_STATE: tuple[tuple[str, Entry, Entry, Entry], ...] = (
    (
        FORWARD,
        ("m", "way driven since the start", -1e6, 1e6),
        ("m/s", "speed along base_link x", -10.0, 10.0),
        UNUSED,
    ),
    (
        YAW,
        _angle("heading in map"),
        ("rad/s", "its rate", -100.0, 100.0),
        UNUSED,
    ),
    (PITCH, _angle("nose down positive, as far as IMU and gravity tell"), UNUSED, UNUSED),
    (ROLL, _angle("right side down positive"), UNUSED, UNUSED),
    (SLIP, ("-", "slip of the driven wheels that is counted on", -1.0, 1.0), UNUSED, UNUSED),
    (GYRO_BIAS, UNUSED, ("rad/s", "of the gyro about base_link z", -1.0, 1.0), UNUSED),
    (POSITION_ERROR, ("m", "standard deviation of the position", 0.0, 1e4), UNUSED, UNUSED),
    (HEADING_ERROR, ("rad", "standard deviation of the heading", 0.0, 1e3), UNUSED, UNUSED),
    (GOAL_DISTANCE, ("m", "to the present goal; 0 without one", 0.0, 1e4), UNUSED, UNUSED),
    (GOALS_LEFT, ("-", "poses of the path that wait", 0.0, 1e6), UNUSED, UNUSED),
    (
        WHEEL_EFFORT,
        UNUSED,
        UNUSED,
        ("N m", "torque at the wheels, by the motor's current", -1e3, 1e3),
    ),
    (
        TETHER_RANGE,
        ("m", "length from the fairlead to the rover, when the tether is taut; else 0", 0.0, 1e4),
        UNUSED,
        UNUSED,
    ),
)

DRIVE_TOPICS = (
    Topic(
        topics.CMD_VEL,
        "an operator steers: straight ahead, or a left turn about the right wheel, which is what "
        "one motor with ratchets can do; anything else is refused with what would be possible",
        "geometry_msgs/msg/TwistStamped",
        samples.TwistSample,
        Intent.COMMAND,
        "operator",
        None,
        BODY1_FRAME,
        fields=_TWIST,
        spatial_only=True,
        stale=StalePolicy(
            max_age=0.5,
            max_lead=0.1,
            timeout=0.5,
            on_timeout="the rover stops",
        ),
    ),
    Topic(
        topics.DRIVE_GOAL,
        "an operator or the mission asks the rover to drive to a pose; it replaces what was driven "
        "to before",
        "geometry_msgs/msg/PoseStamped",
        samples.PoseSample,
        Intent.COMMAND,
        "operator",
        None,
        WORLD_FRAME,
        fields=_POSE,
        spatial_only=True,
        stale=_GOAL_STALE,
    ),
    Topic(
        topics.DRIVE_PATH,
        "the same for several poses; of all but the last the positions count alone",
        "nav_msgs/msg/Path",
        samples.PathSample,
        Intent.COMMAND,
        "operator",
        None,
        WORLD_FRAME,
        fields=_POSE,
        spatial_only=True,
        stale=_GOAL_STALE,
    ),
    Topic(
        topics.DRIVE_START,
        "where the rover stands, said by who knows it, as after the touchdown; a heading that is "
        "left open stays as it was",
        "geometry_msgs/msg/PoseStamped",
        samples.PoseSample,
        Intent.COMMAND,
        "operator",
        None,
        WORLD_FRAME,
        fields=_POSE,
        spatial_only=True,
        stale=_GOAL_STALE,
    ),
    Topic(
        topics.DRIVE_PHASE,
        "what the driving is doing; released = it drives nothing until it is asked to",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        _NODE,
        None,
        words=tuple(DrivePhase),
        spatial_only=True,
    ),
    Topic(
        topics.DRIVE_STATE,
        "what the drive controller makes of encoders, IMU, currents and tether",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.STATE,
        _NODE,
        10.0,
        fields=tuple(row for entry in _STATE for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _STATE),
        spatial_only=True,
    ),
    Topic(
        topics.ODOMETRY,
        "where the rover is by its own reckoning, with the covariance of x, y and heading",
        "nav_msgs/msg/Odometry",
        samples.OdometrySample,
        Intent.STATE,
        _NODE,
        20.0,
        WORLD_FRAME,
        BODY1_FRAME,
        fields=(
            *axis_fields("position", "m", "of base_link in the world frame", 1e4),
            *axis_fields("orientation", "-", "unit quaternion, body to world", 1.0 + 1e-9, "xyzw"),
            *axis_fields("linear", "m/s", "velocity in the body's frame", 1e3),
            *axis_fields("angular", "rad/s", "angular velocity in the body's frame", 1e4),
        ),
        spatial_only=True,
    ),
)  # fmt: skip

DRIVE_SERVICES = (
    Service(
        topics.DRIVE_STOP,
        "comes to rest, forgets what was driven to and gives wheels and winch back",
        "std_srvs/srv/Trigger",
        _NODE,
    ),
)
