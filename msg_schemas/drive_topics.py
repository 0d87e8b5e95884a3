"""Specifications of driving: requests to the wheels, and the state of the drive controller."""

from __future__ import annotations

from math import pi

from msg_schemas import topics
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
    ODOM_FRAME,
    PITCH,
    POSITION_ERROR,
    ROLL,
    SLIP,
    TETHER_DROP,
    TETHER_RANGE,
    WHEEL_EFFORT,
    WORLD_FRAME,
    YAW,
)
from msg_schemas.phases import DrivePhase
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
    axis_fields,
    joint_fields,
)

_GOAL_STALE = StalePolicy(max_age=2.0, max_lead=0.5)

_POSE = (
    *axis_fields("position", "m", "requested position of base_link; z is ignored", MAX_LENGTH),
    *axis_fields(
        "orientation",
        "-",
        "unit quaternion, of which the heading is used; all 0 leaves the heading open",
        1.0 + 1e-9,
        "xyzw",
    ),
)

_COVARIANCE = tuple(
    Field(f"pose_covariance[{place}]", f"{unit}^2", f"variance of {what}", 0.0, 1e6)
    for place, unit, what in ((0, "m", "x"), (7, "m", "y"), (35, "rad", "the heading"))
)

_TWIST = (
    Field(
        "linear.x",
        "m/s",
        "speed straight ahead; while turning 0 or the speed that the turn implies",
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
        "yaw rate of a left turn about the right wheel",
        -MAX_TURN_RATE,
        MAX_TURN_RATE,
    ),
)


def _angle(about: str) -> Entry:
    return ("rad", about, -pi, pi)


_STATE: tuple[JointRow, ...] = (
    (
        FORWARD,
        ("m", "distance driven since the start", -1e6, 1e6),
        ("m/s", "speed along base_link x", -10.0, 10.0),
    ),
    (YAW, _angle("heading in map"), ("rad/s", "its rate", -100.0, 100.0)),
    (PITCH, _angle("pitch, nose down positive")),
    (ROLL, _angle("roll, right side down positive")),
    (SLIP, ("-", "assumed slip of the driven wheels", -1.0, 1.0)),
    (GYRO_BIAS, UNUSED, ("rad/s", "gyro bias about base_link z", -1.0, 1.0)),
    (POSITION_ERROR, ("m", "standard deviation of the position", 0.0, 1e4)),
    (HEADING_ERROR, ("rad", "standard deviation of the heading", 0.0, 1e3)),
    (GOAL_DISTANCE, ("m", "distance to the present goal; 0 = no goal", 0.0, 1e4)),
    (GOALS_LEFT, ("-", "number of remaining poses", 0.0, 1e6)),
    (
        WHEEL_EFFORT,
        UNUSED,
        UNUSED,
        ("N m", "torque at the wheels, by the motor's current", -1e3, 1e3),
    ),
    (
        TETHER_RANGE,
        ("m", "length from the fairlead to the rover, when the tether is taut; else 0", 0.0, 1e4),
    ),
    (
        TETHER_DROP,
        ("m", "height of the fairlead above the tether attachment; 0 = not known yet", 0.0, 1e4),
    ),
)

DRIVE_TOPICS = (
    Topic(
        topics.CMD_VEL,
        "steers the rover: straight ahead, or left about the right wheel, as one motor with "
        "ratchets allows; other motions are refused with the possible ones",
        "geometry_msgs/msg/TwistStamped",
        Intent.COMMAND,
        frame=BODY1_FRAME,
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
        "requests a drive to a pose; replaces the present goal",
        "geometry_msgs/msg/PoseStamped",
        Intent.COMMAND,
        frame=WORLD_FRAME,
        fields=_POSE,
        spatial_only=True,
        stale=_GOAL_STALE,
    ),
    Topic(
        topics.DRIVE_PATH,
        "requests a drive through several poses; only the last one's heading is used",
        "nav_msgs/msg/Path",
        Intent.COMMAND,
        frame=WORLD_FRAME,
        fields=_POSE,
        spatial_only=True,
        stale=_GOAL_STALE,
    ),
    Topic(
        topics.DRIVE_START,
        "sets the rover's pose, for instance after the touchdown; an open heading keeps the "
        "present one, and without variances the node's parameters apply",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        Intent.COMMAND,
        frame=WORLD_FRAME,
        fields=(*_POSE, *_COVARIANCE),
        spatial_only=True,
        stale=_GOAL_STALE,
    ),
    Topic(
        topics.DRIVE_PHASE,
        "phase of the drive controller",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(DrivePhase),
        spatial_only=True,
    ),
    Topic(
        topics.DRIVE_STATE,
        "estimates of the drive controller from encoders, IMU, currents and tether",
        "sensor_msgs/msg/JointState",
        Intent.STATE,
        rate=10.0,
        fields=tuple(row for entry in _STATE for row in joint_fields(*entry)),
        joints=tuple(name for name, *_ in _STATE),
        spatial_only=True,
    ),
    Topic(
        topics.ODOMETRY,
        "dead reckoning by wheels and gyro since its start, never corrected, with its "
        "covariance; the height is unknown",
        "nav_msgs/msg/Odometry",
        Intent.STATE,
        rate=20.0,
        frame=ODOM_FRAME,
        child_frame=BODY1_FRAME,
        fields=(
            *axis_fields("position", "m", "of base_link in odom", 1e4),
            *axis_fields("orientation", "-", "unit quaternion, body to odom", 1.0 + 1e-9, "xyzw"),
            *axis_fields("linear", "m/s", "velocity in the body's frame", 1e3),
            *axis_fields("angular", "rad/s", "angular velocity in the body's frame", 1e4),
        ),
        spatial_only=True,
    ),
    Topic(
        topics.POSE,
        "estimated pose of the rover; until one is given, the tether's length bounds the position "
        "and the heading is unknown, as the covariance states",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        Intent.STATE,
        rate=20.0,
        frame=WORLD_FRAME,
        fields=(
            *axis_fields("position", "m", "of base_link in map", 1e4),
            *axis_fields("orientation", "-", "unit quaternion, body to map", 1.0 + 1e-9, "xyzw"),
        ),
        spatial_only=True,
    ),
)  # fmt: skip

DRIVE_SERVICES = (
    Service(
        topics.DRIVE_STOP,
        "stops the rover, discards the goals and releases wheels and winch",
        TRIGGER,
    ),
)
