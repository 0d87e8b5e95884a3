"""The contract's table: every topic and service of the suite, in one place.

Each row says who speaks to whom, with which message, how often, in which frame
and units, within which limits, and what happens when it falls silent or comes
late. Nodes, recorder, reports and the generated document all read this table;
no topic name stands anywhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from math import inf
from types import MappingProxyType

from msg_schemas import samples, topics
from msg_schemas.samples import Sample

CONTRACT_VERSION = "1.0.0"

WORLD_FRAME = "map"
BODY1_FRAME = "base_link"
BODY2_FRAME = "body2"

FRAMES: Mapping[str, str] = MappingProxyType(
    {
        WORLD_FRAME: "fixed to the mother machine: origin at the fairlead, x forward along the "
        "jumping plane, z up against gravity",
        BODY1_FRAME: "Body 1 (wheels, motors, tether attachment): origin at its centre of mass, "
        "x forward, y left, z along the slider",
        BODY2_FRAME: "Body 2 (the mass that jumps): origin at its centre of mass, axes of Body 1",
    }
)


class Intent(StrEnum):
    """Why something is sent; it fixes the quality of service."""

    COMMAND = "command"
    STATE = "state"
    SENSOR = "sensor"
    LATCHED = "latched"
    EVENT = "event"
    CLOCK = "clock"


class Audience(StrEnum):
    """Who may read a topic."""

    ALL = "all"
    NOT_CONTROLLERS = "bags, console and tests; never controllers"


class Unstamped(StrEnum):
    """What to do with a zero stamp."""

    REFUSE = "refused"
    NOW = "taken as sent on arrival"


@dataclass(frozen=True)
class Field:
    """One number of a message.

    Attributes:
        path: field path as the sample's ``scalars`` yields it.
        unit: SI unit, or ``-``.
        about: what it means.
        minimum, maximum: limits, inclusive; outside them the message is refused.
        default: value taken when a joint message leaves the whole array out
            (operators' topics only); None = the array must be given.
    """

    path: str
    unit: str
    about: str
    minimum: float = -inf
    maximum: float = inf
    default: float | None = None


@dataclass(frozen=True)
class StalePolicy:
    """What late, early and missing messages mean.

    Attributes:
        max_age: older than this on arrival is refused [s]; inf = any age.
        max_lead: stamped further ahead than this is refused [s].
        unstamped: what a zero stamp means.
        silence: after this long without an accepted message ``on_silence`` happens [s].
        on_silence: what then happens, in words.
    """

    max_age: float = inf
    max_lead: float = inf
    unstamped: Unstamped = Unstamped.NOW
    silence: float = inf
    on_silence: str = "nothing"


@dataclass(frozen=True)
class Topic:
    """One row of the table."""

    name: str
    about: str
    message: str
    sample: type[Sample]
    intent: Intent
    publisher: str
    rate: float | None
    frame: str = ""
    child_frame: str = ""
    fields: tuple[Field, ...] = ()
    joints: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    is_json: bool = False
    stale: StalePolicy = field(default_factory=StalePolicy)
    audience: Audience = Audience.ALL

    @cached_property
    def by_path(self) -> Mapping[str, Field]:
        """Fields by their path."""
        return {item.path: item for item in self.fields}


@dataclass(frozen=True)
class Service:
    """One service of the suite."""

    name: str
    about: str
    service: str
    server: str


_STALE_ACTUATOR = StalePolicy(
    max_age=0.5,
    max_lead=0.1,
    unstamped=Unstamped.REFUSE,
    silence=0.5,
    on_silence="the drive stops where it is",
)
_STALE_REQUEST = StalePolicy(max_age=2.0, max_lead=0.5)


def _joint(
    name: str,
    position: tuple[str, str, float, float],
    velocity: tuple[str, str, float, float],
    effort: tuple[str, str, float, float],
    defaults: tuple[float | None, float | None, float | None] = (None, None, None),
) -> tuple[Field, ...]:
    parts = zip(
        ("position", "velocity", "effort"), (position, velocity, effort), defaults, strict=True
    )
    return tuple(
        Field(f"{name}.{part}", unit, about, low, high, default)
        for part, (unit, about, low, high), default in parts
    )


_UNUSED = ("-", "not used, 0", 0.0, 0.0)


def _scalars(unit: str, **about: str) -> tuple[Field, ...]:
    rows: tuple[Field, ...] = ()
    for name, text in about.items():
        rows += _joint(name, (unit, text, -inf, inf), _UNUSED, _UNUSED)
    return rows


def _axes(
    prefix: str, unit: str, about: str, limit: float = inf, axes: str = "xyz"
) -> tuple[Field, ...]:
    return tuple(
        Field(f"{prefix}.{axis}", unit, f"{about}, {axis}", -limit, limit) for axis in axes
    )


_BODY_FIELDS = (
    *_axes("position", "m", "centre of mass in the world frame", 1e4),
    *_axes("orientation", "-", "unit quaternion, body to world", 1.0 + 1e-9, "xyzw"),
    *_axes("linear", "m/s", "velocity in the body's frame", 1e3),
    *_axes("angular", "rad/s", "angular velocity in the body's frame", 1e4),
)

JUMP_SCREW = "jump_screw"
WHEEL_DRIVE = "wheel_drive"
WINCH_DRUM = "winch_drum"
JUMP_STROKE = "jump_stroke"
FLOOR_SWITCH = "floor"

ENERGY_NAMES = (
    "kinetic", "gravity", "axial", "bending", "spring", "input", "dissipated", "drift",
)  # fmt: skip

MAX_STROKE = 0.40
MAX_NUT_SPEED = 0.5
MAX_NUT_FORCE = 1000.0
MAX_TENSION = 5000.0
MAX_LENGTH = 1000.0

_TOPIC_ROWS = (
    Topic(
        topics.CLOCK,
        "simulated time; every node with use_sim_time follows it",
        "rosgraph_msgs/msg/Clock",
        samples.ClockSample,
        Intent.CLOCK,
        "sim_node",
        100.0,
        fields=(Field("clock", "s", "simulated time since the start", 0.0),),
    ),
    Topic(
        topics.TRUTH_BODY1,
        "true motion of Body 1",
        "nav_msgs/msg/Odometry",
        samples.OdometrySample,
        Intent.STATE,
        "sim_node",
        100.0,
        WORLD_FRAME,
        BODY1_FRAME,
        _BODY_FIELDS,
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_BODY2,
        "true motion of Body 2",
        "nav_msgs/msg/Odometry",
        samples.OdometrySample,
        Intent.STATE,
        "sim_node",
        100.0,
        WORLD_FRAME,
        BODY2_FRAME,
        _BODY_FIELDS,
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_TETHER,
        "true shape and tension of the tether, node by node from the fairlead to the rover",
        "sensor_msgs/msg/PointCloud2",
        samples.TetherSample,
        Intent.STATE,
        "sim_node",
        50.0,
        WORLD_FRAME,
        fields=(
            Field("x", "m", "node position, x", -1e4, 1e4),
            Field("y", "m", "node position, y", -1e4, 1e4),
            Field("z", "m", "node position, z", -1e4, 1e4),
            Field("tx", "-", "slope dr/ds, x"),
            Field("ty", "-", "slope dr/ds, y"),
            Field("tz", "-", "slope dr/ds, z"),
            Field("tension", "N", "axial force, negative when pressed"),
        ),
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_ENERGY,
        "energy ledger of the plant",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.STATE,
        "sim_node",
        100.0,
        fields=_scalars(
            "J",
            kinetic="kinetic energy of tether and rover",
            gravity="potential energy of gravity, zero at the level of the fairlead",
            axial="stored by stretching the tether",
            bending="stored by bending the tether",
            spring="stored in the jump spring",
            input="put in by actuators since the start",
            dissipated="lost to dampers and stops since the start",
            drift="stored - initially stored - input + dissipated: zero for a perfect integrator",
        ),
        joints=ENERGY_NAMES,
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.TRUTH_PHASE,
        "what the plant is doing",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        "sim_node",
        None,
        words=("held", "flight", "landed", "free", "diverged", "tether_broken"),
        audience=Audience.NOT_CONTROLLERS,
    ),
    Topic(
        topics.IMU,
        "gyro and accelerometer of Body 1",
        "sensor_msgs/msg/Imu",
        samples.ImuSample,
        Intent.SENSOR,
        "sim_node or hardware bridge",
        100.0,
        BODY1_FRAME,
        fields=(
            *_axes("angular_velocity", "rad/s", "angular rate", 1e4),
            *_axes("linear_acceleration", "m/s^2", "specific force (at rest: +g upwards)", 1e6),
        ),
    ),
    Topic(
        topics.CONTACT,
        "contact switches under Body 1",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.SENSOR,
        "sim_node or hardware bridge",
        100.0,
        fields=_joint(
            FLOOR_SWITCH, ("-", "1 = closed (standing), 0 = open", 0.0, 1.0), _UNUSED, _UNUSED
        ),
        joints=(FLOOR_SWITCH,),
    ),
    Topic(
        topics.LOAD_CELL,
        "pull of the tether on the mother machine at the fairlead",
        "geometry_msgs/msg/WrenchStamped",
        samples.WrenchSample,
        Intent.SENSOR,
        "sim_node or hardware bridge",
        100.0,
        WORLD_FRAME,
        fields=(
            *_axes("force", "N", "force of the tether on the fairlead", 1e6),
            *_axes("torque", "N m", "zero: the fairlead is a point", 0.0),
        ),
    ),
    Topic(
        topics.JUMP_MOTOR_STATE,
        "ball screw of the jump motor",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.SENSOR,
        "sim_node or hardware bridge",
        100.0,
        fields=_joint(
            JUMP_SCREW,
            ("m", "compression of the spring by the nut", 0.0, MAX_STROKE),
            ("m/s", "nut speed, positive compresses", -MAX_NUT_SPEED, MAX_NUT_SPEED),
            ("N", "spring force on the nut", 0.0, MAX_NUT_FORCE),
        ),
        joints=(JUMP_SCREW,),
    ),
    Topic(
        topics.WINCH_STATE,
        "drum of the winch",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.SENSOR,
        "sim_node or hardware bridge",
        100.0,
        fields=_joint(
            WINCH_DRUM,
            ("m", "length paid out, measured at the drum (unstretched)", 0.0, MAX_LENGTH),
            ("m/s", "payout rate, positive lengthens", -5.0, 5.0),
            ("N", "tension at the drum", -MAX_TENSION, MAX_TENSION),
        ),
        joints=(WINCH_DRUM,),
    ),
    Topic(
        topics.JUMP_MOTOR_COMMAND,
        "drives the nut of the ball screw; at the setpoint the latch trips and the rover jumps",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.COMMAND,
        "jump_node (one owner)",
        20.0,
        fields=_joint(
            JUMP_SCREW,
            ("m", "compression at which the latch trips; 0 lets the spring down", 0.0, MAX_STROKE),
            ("m/s", "nut speed", 1e-4, MAX_NUT_SPEED),
            ("N", "largest force that the nut may use", 0.0, MAX_NUT_FORCE),
        ),
        joints=(JUMP_SCREW,),
        stale=_STALE_ACTUATOR,
    ),
    Topic(
        topics.WINCH_COMMAND,
        "drives the drum; a drum without a motor accepts holding only",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.COMMAND,
        "winch_node (one owner)",
        20.0,
        fields=_joint(
            WINCH_DRUM,
            ("m", "length setpoint at the drum", 0.0, MAX_LENGTH),
            ("m/s", "payout rate; 0 = hold", -0.5, 0.5),
            ("N", "largest tension that the drive may use", 0.0, MAX_TENSION),
        ),
        joints=(WINCH_DRUM,),
        stale=StalePolicy(0.5, 0.1, Unstamped.REFUSE, 0.5, "the brake closes"),
    ),
    Topic(
        topics.JUMP_REQUEST,
        "an operator asks for a jump",
        "sensor_msgs/msg/JointState",
        samples.JointSample,
        Intent.COMMAND,
        "operator",
        None,
        fields=_joint(
            JUMP_STROKE,
            ("m", "compression of the spring at take-off", 0.005, MAX_STROKE),
            ("m/s", "nut speed while compressing; 0 = the node's own", 0.0, MAX_NUT_SPEED),
            _UNUSED,
            (None, 0.0, 0.0),
        ),
        joints=(JUMP_STROKE,),
        stale=_STALE_REQUEST,
    ),
    Topic(
        topics.JUMP_PHASE,
        "what the jump sequencer is doing",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        "jump_node",
        None,
        words=("standby", "compressing", "letting_down", "flight", "landed", "fault"),
    ),
    Topic(
        topics.TENSION_WATCH,
        "what the winch makes of its load cell",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        "winch_node",
        None,
        words=("unknown", "normal", "slack", "over_tension"),
    ),
    Topic(
        topics.CONFIG,
        "configuration of each node as JSON: node, package and contract version, parameters; "
        "the sim node adds scenario and seed",
        "std_msgs/msg/String",
        samples.TextSample,
        Intent.LATCHED,
        "every node",
        None,
        is_json=True,
    ),
    Topic(
        topics.EVENTS,
        "every transition with its reason and its values",
        "diagnostic_msgs/msg/DiagnosticArray",
        samples.StatusSample,
        Intent.EVENT,
        "every node",
        None,
    ),
    Topic(
        topics.DIAGNOSTICS,
        "health of every node at 1 Hz and when it changes (`ready`, or what it waits for), and "
        "each refusal with its reason as it happens; of a flood on one topic the first ones, then "
        "the last one of each second and how many there were",
        "diagnostic_msgs/msg/DiagnosticArray",
        samples.StatusSample,
        Intent.STATE,
        "every node",
        1.0,
    ),
    Topic(
        topics.SIM_STATUS,
        "how the integration goes: outcome, iterations, halvings, measured real-time factor; at "
        "its rate by the wall clock, also while paused",
        "diagnostic_msgs/msg/DiagnosticArray",
        samples.StatusSample,
        Intent.STATE,
        "sim_node",
        10.0,
    ),
    Topic(
        topics.MARKERS,
        "tether and bodies to look at",
        "visualization_msgs/msg/MarkerArray",
        samples.DrawingSample,
        Intent.STATE,
        "sim_node",
        20.0,
        WORLD_FRAME,
        fields=(Field("drawing", "m", "coordinates and sizes", -1e4, 1e4),),
        audience=Audience.NOT_CONTROLLERS,
    ),
)

_SERVICE_ROWS = (
    Service(
        topics.SIM_PAUSE,
        "true stops simulated time, false lets it run on",
        "std_srvs/srv/SetBool",
        "sim_node",
    ),
    Service(
        topics.SIM_STEP,
        "while paused: advances one tick and publishes the clock and the state",
        "std_srvs/srv/Trigger",
        "sim_node",
    ),
    Service(
        topics.SIM_RESET,
        "starts again: plant, clock and ledger at zero (simulated time jumps back)",
        "std_srvs/srv/Trigger",
        "sim_node",
    ),
    Service(
        topics.SIM_RESET_PLANT,
        "puts the plant back to its start; simulated time runs on",
        "std_srvs/srv/Trigger",
        "sim_node",
    ),
    Service(
        topics.JUMP_ABORT,
        "ends a compression and lets the spring down softly",
        "std_srvs/srv/Trigger",
        "jump_node",
    ),
)

TOPICS: Mapping[str, Topic] = MappingProxyType({row.name: row for row in _TOPIC_ROWS})
SERVICES: Mapping[str, Service] = MappingProxyType({row.name: row for row in _SERVICE_ROWS})
