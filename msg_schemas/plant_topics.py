"""Specifications of the plant's topics, simulated or real, and of the simulation."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.machine import (
    BODY_SWITCH,
    CAMERA_FRAME,
    ENERGY_NAMES,
    FAIRLEAD_FRAME,
    FLOOR_SWITCH,
    FLYWHEEL,
    IMU_FRAME,
    JUMP_LATCH,
    JUMP_MOTOR,
    JUMP_SCREW,
    JUMP_SLIDER,
    MAX_FLYWHEEL_TORQUE,
    MAX_FREE_TRAVEL,
    MAX_LENGTH,
    MAX_NUT_FORCE,
    MAX_NUT_SPEED,
    MAX_PAYOUT_RATE,
    MAX_STROKE,
    MAX_TENSION,
    MAX_WHEEL_RATE,
    MAX_WHEEL_TORQUE,
    NO_WALL,
    SMALLEST_LIMIT,
    SMEAR,
    SWITCH_FRAME,
    TETHER_FRAME,
    TRUTH_BODY1_FRAME,
    TRUTH_BODY2_FRAME,
    WALL_DISTANCE,
    WHEEL_DRIVE,
    WHEEL_LEFT,
    WHEEL_MOTOR,
    WHEEL_RIGHT,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_LIMIT,
    WINCH_MOTOR,
    WINCH_TIMEOUT_MOVING,
    WORLD_FRAME,
)
from msg_schemas.phases import PlantPhase
from msg_schemas.specifications import (
    SET_BOOL,
    TRIGGER,
    Audience,
    Entry,
    Field,
    Intent,
    Service,
    StalePolicy,
    Topic,
    Unstamped,
    axis_fields,
    joint_fields,
    scalar_fields,
)


def _stale_drive(on_timeout: str) -> StalePolicy:
    return StalePolicy(
        max_age=0.5,
        max_lead=0.1,
        unstamped=Unstamped.REFUSE,
        timeout=0.5,
        on_timeout=on_timeout,
    )


_SWITCH: Entry = ("-", "1 = closed (contact), 0 = open", 0.0, 1.0)
_AMPERES: Entry = ("A", "current, positive drives the motor forward", -1e4, 1e4)

_TURNED: tuple[Entry, Entry] = (
    ("rad", "angle turned, positive rolls forward", -1e9, 1e9),
    ("rad/s", "rate relative to Body 1", -1e4, 1e4),
)

_BODY_FIELDS = (
    *axis_fields("position", "m", "centre of mass in the world frame", 1e4),
    *axis_fields("orientation", "-", "unit quaternion, body to world", 1.0 + 1e-9, "xyzw"),
    *axis_fields("linear", "m/s", "velocity in the body's frame", 1e3),
    *axis_fields("angular", "rad/s", "angular velocity in the body's frame", 1e4),
)

_TRUTH = (
    Topic(
        topics.CLOCK,
        "simulated time; every node with use_sim_time follows it",
        "rosgraph_msgs/msg/Clock",
        Intent.CLOCK,
        rate=100.0,
        fields=(Field("clock", "s", "simulated time since the start", 0.0),),
    ),
    Topic(
        topics.TRUTH_BODY1,
        "true motion of Body 1",
        "nav_msgs/msg/Odometry",
        Intent.STATE,
        rate=100.0,
        frame=WORLD_FRAME,
        child_frame=TRUTH_BODY1_FRAME,
        fields=_BODY_FIELDS,
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_BODY2,
        "true motion of Body 2",
        "nav_msgs/msg/Odometry",
        Intent.STATE,
        rate=100.0,
        frame=WORLD_FRAME,
        child_frame=TRUTH_BODY2_FRAME,
        fields=_BODY_FIELDS,
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_TETHER,
        "true shape and tension of the tether, node by node from the fairlead to the rover; "
        "the number of nodes changes with the length paid out",
        "sensor_msgs/msg/PointCloud2",
        Intent.STATE,
        rate=50.0,
        frame=WORLD_FRAME,
        fields=(
            Field("x", "m", "node position, x", -1e4, 1e4),
            Field("y", "m", "node position, y", -1e4, 1e4),
            Field("z", "m", "node position, z", -1e4, 1e4),
            Field("tx", "-", "slope dr/ds, x"),
            Field("ty", "-", "slope dr/ds, y"),
            Field("tz", "-", "slope dr/ds, z"),
            Field("tension", "N", "axial force, negative in compression"),
        ),
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_ENERGY,
        "energy balance of the plant; terms that the plant lacks are 0",
        "sensor_msgs/msg/JointState",
        Intent.STATE,
        rate=100.0,
        fields=scalar_fields(
            "J",
            kinetic="kinetic energy of tether and bodies",
            rotors="kinetic energy of flywheel, wheels, motors and drum",
            gravity="potential energy of gravity, zero at the level of the fairlead",
            axial="stored by stretching the tether",
            bending="stored by bending the tether",
            twist="stored by twisting the tether",
            spring="stored in the jump spring and the slider's end stops",
            contact="stored in the compressed ground contacts",
            input="work of motors, driven ends, take-offs and incoming tether since the start",
            driven_ends="part of input: work of what drives the tether's ends",
            dissipated="lost to damping, friction and air since the start",
            air_drag="part of dissipated: lost to the air, negative where wind drives the tether",
            drift="stored - initially stored - input + dissipated: zero for a perfect integrator",
        ),
        joints=ENERGY_NAMES,
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_PHASE,
        "phase of the plant; the planar rover is held or landed, the spatial one hangs or is "
        "grounded",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(PlantPhase),
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_STATE,
        "whole state of the plant without drives' commands and sensors' errors, with its simulated "
        "time in ns; while time is paused it is repeated by the wall clock",
        "std_msgs/msg/String",
        Intent.STATE,
        rate=1.0,
        is_json=True,
        audience=Audience.NOT_CONTROLLERS,
    ),
)  # fmt: skip

_SENSOR_ROWS = (
    Topic(
        topics.IMU,
        "gyro and accelerometer of Body 1",
        "sensor_msgs/msg/Imu",
        Intent.SENSOR,
        rate=100.0,
        frame=IMU_FRAME,
        fields=(
            *axis_fields("angular_velocity", "rad/s", "angular rate", 1e4),
            *axis_fields(
                "linear_acceleration", "m/s^2", "specific force (at rest: +g upwards)", 1e6
            ),
        ),
    ),
    Topic(
        topics.CONTACT,
        "contact switches of Body 1; a machine may have the floor's alone",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=100.0,
        frame=SWITCH_FRAME,
        fields=(
            *joint_fields(FLOOR_SWITCH, ("-", "1 = closed (standing), 0 = open", 0.0, 1.0)),
            *joint_fields(WHEEL_LEFT, _SWITCH),
            *joint_fields(WHEEL_RIGHT, _SWITCH),
            *joint_fields(BODY_SWITCH, _SWITCH),
        ),
        joints=(FLOOR_SWITCH,),
        optional_joints=(WHEEL_LEFT, WHEEL_RIGHT, BODY_SWITCH),
    ),
    Topic(
        topics.LOAD_CELL,
        "tension force of the tether on the mother machine at the fairlead; its magnitude is "
        "the tension. A single-axis cell, as in the spatial plant, reports the magnitude "
        "along -z",
        "geometry_msgs/msg/WrenchStamped",
        Intent.SENSOR,
        rate=100.0,
        frame=FAIRLEAD_FRAME,
        fields=(
            *axis_fields("force", "N", "force of the tether on the fairlead", 1e6),
            *axis_fields("torque", "N m", "zero: the fairlead is a point", 0.0),
        ),
    ),
    Topic(
        topics.ROVER_LOAD_CELL,
        "tension force of the tether on the rover at its attachment; its magnitude is the "
        "tension. A single-axis cell, as in the spatial plant, reports the magnitude along z",
        "geometry_msgs/msg/WrenchStamped",
        Intent.SENSOR,
        rate=100.0,
        frame=TETHER_FRAME,
        fields=(
            *axis_fields("force", "N", "force of the tether on Body 1", 1e6),
            *axis_fields("torque", "N m", "zero: the cell measures forces", 0.0),
        ),
    ),
    Topic(
        topics.MOTOR_CURRENTS,
        "currents of the three motors",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=100.0,
        fields=(
            *joint_fields(JUMP_MOTOR, effort=_AMPERES),
            *joint_fields(WHEEL_MOTOR, effort=_AMPERES),
            *joint_fields(WINCH_MOTOR, effort=_AMPERES),
        ),
        joints=(JUMP_MOTOR, WHEEL_MOTOR, WINCH_MOTOR),
        spatial_only=True,
    ),
    Topic(
        topics.CAMERA,
        "range and image smear of the wall camera",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=10.0,
        frame=CAMERA_FRAME,
        fields=(
            *joint_fields(
                WALL_DISTANCE,
                (
                    "m",
                    f"distance of the wall along the camera's axis; {NO_WALL:g} = none seen",
                    0.0,
                    NO_WALL,
                ),
            ),
            *joint_fields(SMEAR, ("px", "smear of the wall's image in one exposure", 0.0, 1e6)),
        ),
        joints=(WALL_DISTANCE, SMEAR),
        spatial_only=True,
    ),
)

_DRIVE_STATES = (
    Topic(
        topics.JUMP_MOTOR_STATE,
        "ball screw of the jump motor",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=100.0,
        fields=joint_fields(
            JUMP_SCREW,
            (
                "m",
                "compression of the spring by the nut; below 0 the nut stands clear of the latch",
                -MAX_FREE_TRAVEL,
                MAX_STROKE,
            ),
            ("m/s", "nut speed, positive compresses", -MAX_NUT_SPEED, MAX_NUT_SPEED),
            ("N", "spring force on the nut", 0.0, MAX_NUT_FORCE),
        ),
        joints=(JUMP_SCREW,),
    ),
    Topic(
        topics.FLYWHEEL_STATE,
        "flywheel on the jump motor's shaft",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=100.0,
        fields=joint_fields(
            FLYWHEEL,
            ("rad", "angle turned about base_link x, positive drives the nut down", -1e9, 1e9),
            ("rad/s", "rate relative to Body 1", -1e5, 1e5),
        ),
        joints=(FLYWHEEL,),
        spatial_only=True,
    ),
    Topic(
        topics.WHEEL_STATE,
        "encoders of the two wheels",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=100.0,
        fields=(
            *joint_fields(WHEEL_LEFT, *_TURNED),
            *joint_fields(WHEEL_RIGHT, *_TURNED),
        ),
        joints=(WHEEL_LEFT, WHEEL_RIGHT),
        spatial_only=True,
    ),
    Topic(
        topics.WINCH_STATE,
        "drum and brake of the winch",
        "sensor_msgs/msg/JointState",
        Intent.SENSOR,
        rate=100.0,
        fields=(
            *joint_fields(
                WINCH_DRUM,
                ("m", "length paid out, measured at the drum (unstretched)", 0.0, MAX_LENGTH),
                ("m/s", "payout rate, positive lengthens", -5.0, 5.0),
                ("N", "tension that the motor carries (its torque)", -MAX_TENSION, MAX_TENSION),
            ),
            *joint_fields(WINCH_BRAKE, ("-", "1 = released, 0 = closed", 0.0, 1.0)),
        ),
        joints=(WINCH_DRUM, WINCH_BRAKE),
    ),
)

_DRIVE_COMMANDS = (
    Topic(
        topics.JUMP_MOTOR_COMMAND,
        "setpoint of the ball screw's nut; at a setpoint above 0 the latch trips and the "
        "rover jumps, unless the latch joint holds",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        rate=20.0,
        fields=(
            *joint_fields(
                JUMP_SCREW,
                (
                    "m",
                    "compression at which the latch trips; 0 lets the spring down, less clears it",
                    -MAX_FREE_TRAVEL,
                    MAX_STROKE,
                ),
                ("m/s", "nut speed", 1e-4, MAX_NUT_SPEED),
                ("N", "largest force that the nut may use", SMALLEST_LIMIT, MAX_NUT_FORCE),
            ),
            *joint_fields(
                JUMP_LATCH,
                ("-", "1 = trips at the setpoint, 0 = the nut stays there; left out: 1", 0.0, 1.0),
            ),
        ),
        joints=(JUMP_SCREW,),
        optional_joints=(JUMP_LATCH,),
        owned=JUMP_MOTOR,
        stale=_stale_drive("the nut comes to rest with the quick-stop deceleration, and stays"),
    ),
    Topic(
        topics.FLYWHEEL_COMMAND,
        "torque of the jump motor as a reaction wheel, while the nut is clear of the latch; "
        "replaces a nut command and is replaced by one",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        rate=50.0,
        fields=joint_fields(
            FLYWHEEL,
            effort=(
                "N m",
                "torque at the shaft, positive drives the nut down",
                -MAX_FLYWHEEL_TORQUE,
                MAX_FLYWHEEL_TORQUE,
            ),
        ),
        joints=(FLYWHEEL,),
        owned=JUMP_MOTOR,
        stale=_stale_drive("the flywheel comes to rest with the quick-stop deceleration"),
        spatial_only=True,
    ),
    Topic(
        topics.WHEEL_COMMAND,
        "rate of the wheel motor; forward both wheels turn, backward only the left one; "
        "replaces a torque command and is replaced by one",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        rate=20.0,
        fields=joint_fields(
            WHEEL_DRIVE,
            velocity=("rad/s", "rate of the left wheel", -MAX_WHEEL_RATE, MAX_WHEEL_RATE),
            effort=(
                "N m",
                "largest torque that the motor may use, at the wheel",
                SMALLEST_LIMIT,
                MAX_WHEEL_TORQUE,
            ),
        ),
        joints=(WHEEL_DRIVE,),
        owned=WHEEL_MOTOR,
        stale=_stale_drive("the wheels come to rest with the quick-stop deceleration"),
        spatial_only=True,
    ),
    Topic(
        topics.WHEEL_TORQUE_COMMAND,
        "torque of the wheel motor for attitude control; replaces a rate command and is "
        "replaced by one",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        rate=50.0,
        fields=joint_fields(
            WHEEL_DRIVE,
            effort=(
                "N m",
                "torque at the wheel, positive forward",
                -MAX_WHEEL_TORQUE,
                MAX_WHEEL_TORQUE,
            ),
        ),
        joints=(WHEEL_DRIVE,),
        owned=WHEEL_MOTOR,
        stale=_stale_drive("the wheels come to rest with the quick-stop deceleration"),
        spatial_only=True,
    ),
    Topic(
        topics.WINCH_COMMAND,
        "payout rate of the drum; a drum without a motor accepts holding only",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        rate=50.0,
        fields=(
            *joint_fields(
                WINCH_DRUM,
                (
                    "m",
                    "length setpoint at the drum, for monitoring; the drive ignores it",
                    0.0,
                    MAX_LENGTH,
                ),
                ("m/s", "payout rate setpoint", -MAX_PAYOUT_RATE, MAX_PAYOUT_RATE),
                ("N", "tension feed-forward of the motor", 0.0, MAX_TENSION),
            ),
            *joint_fields(WINCH_BRAKE, ("-", "1 = release, 0 = close", 0.0, 1.0)),
            *joint_fields(
                WINCH_LIMIT,
                effort=("N", "largest tension that the motor may use", SMALLEST_LIMIT, MAX_TENSION),
            ),
        ),
        joints=(WINCH_DRUM, WINCH_BRAKE, WINCH_LIMIT),
        owned=WINCH_MOTOR,
        stale=StalePolicy(
            max_age=0.5,
            max_lead=0.1,
            unstamped=Unstamped.REFUSE,
            timeout=0.5,
            on_timeout="the brake closes, then the motor is off",
            timeout_moving=WINCH_TIMEOUT_MOVING,
            on_timeout_moving="the drum comes to rest with the quick-stop deceleration, the brake "
            "closes, then the motor is off",
        ),
    ),
)

_SIMULATION = (
    Topic(
        topics.SIM_STATUS,
        "status of the integration: outcome, iterations, halvings, measured real-time factor; "
        "published by the wall clock, also while paused",
        "diagnostic_msgs/msg/DiagnosticArray",
        Intent.STATE,
        rate=10.0,
    ),
    Topic(
        topics.MARKERS,
        "tether, bodies and contact forces for viewers",
        "visualization_msgs/msg/MarkerArray",
        Intent.STATE,
        rate=20.0,
        frame=WORLD_FRAME,
        fields=(Field("drawing", "m", "coordinates and sizes", -1e4, 1e4),),
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.PLACE,
        "floor, boulders and wall of the hole for viewers",
        "visualization_msgs/msg/MarkerArray",
        Intent.LATCHED,
        frame=WORLD_FRAME,
        fields=(Field("drawing", "m", "coordinates and sizes", -1e4, 1e4),),
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.JOINT_STATES,
        "joints of the robot description, by the encoders, at most at the rate of the frames; the "
        "slider as far as the nut holds it",
        "sensor_msgs/msg/JointState",
        Intent.STATE,
        fields=(
            *joint_fields(WHEEL_LEFT, *_TURNED),
            *joint_fields(WHEEL_RIGHT, *_TURNED),
            *joint_fields(
                JUMP_SLIDER,
                ("m", "of Body 2 on Body 1, 0 with a free spring", -MAX_STROKE, 0.0),
                ("m/s", "its rate", -MAX_NUT_SPEED, MAX_NUT_SPEED),
            ),
            *joint_fields(
                WINCH_DRUM,
                ("rad", "angle turned, positive pays out", -1e9, 1e9),
                ("rad/s", "its rate", -1e4, 1e4),
            ),
        ),
        optional_joints=(WHEEL_LEFT, WHEEL_RIGHT, JUMP_SLIDER, WINCH_DRUM),
    ),
    Topic(
        topics.ROBOT_DESCRIPTION,
        "rover and drum of the spatial plant as URDF; its root is the world frame",
        "std_msgs/msg/String",
        Intent.LATCHED,
        spatial_only=True,
    ),
    Topic(
        topics.OBSERVED_WALL,
        "picture positions on the wall, from depth, heading and measured range; green = "
        "steady, red = smeared",
        "visualization_msgs/msg/MarkerArray",
        Intent.LATCHED,
        frame=WORLD_FRAME,
        fields=(Field("drawing", "m", "coordinates and sizes", -1e4, 1e4),),
        spatial_only=True,
    ),
)

PLANT_TOPICS = (*_TRUTH, *_SENSOR_ROWS, *_DRIVE_STATES, *_DRIVE_COMMANDS, *_SIMULATION)

PLANT_SERVICES = (
    Service(
        topics.SIM_PAUSE,
        "true pauses simulated time, false resumes it",
        SET_BOOL,
    ),
    Service(
        topics.SIM_STEP,
        "while paused: advances one tick and publishes the clock and the state",
        TRIGGER,
    ),
    Service(
        topics.SIM_RESET,
        "resets plant, clock and energy balance; simulated time jumps back",
        TRIGGER,
    ),
    Service(
        topics.SIM_RESET_PLANT,
        "resets the plant; simulated time goes on",
        TRIGGER,
    ),
)
