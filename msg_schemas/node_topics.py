"""Specifications of the winch's topics and services, and of the topics of every node."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.machine import (
    ALARM_NAMES,
    MAX_LENGTH,
    MAX_PAYOUT_RATE,
    MAX_RATE_TRIM,
    MAX_SLACK,
    MAX_TENSION,
    PAYOUT,
    REFERENCE,
    STRETCHED,
    TENSION,
    TETHER_OUT,
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_DRUM,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
    WINCH_WHILE_RENEWED,
)
from msg_schemas.phases import LoadState, WinchMode
from msg_schemas.specifications import (
    TRIGGER,
    UNUSED,
    Entry,
    Intent,
    Service,
    StalePolicy,
    Topic,
    Unstamped,
    joint_fields,
)

_STALE_REQUEST = StalePolicy(max_age=2.0, max_lead=0.5)
_LATER_0 = (None, 0.0, 0.0)  # an operator may leave speed and force to the node
_ALL_BUT_SPEED_0 = (0.0, None, 0.0)
_ALL_BUT_FORCE_0 = (0.0, 0.0, None)
_LARGEST_RATE: Entry = ("m/s", "largest rate; 0 = the node's parameter", 0.0, MAX_PAYOUT_RATE)
_LARGEST_TENSION: Entry = (
    "N",
    "largest tension of the motor; 0 = the node's parameter",
    0.0,
    MAX_TENSION,
)

_WINCH = (
    Topic(
        topics.WINCH_REQUEST,
        "requests a motion of the winch; the joint's name is the mode. Length and slack end "
        "by themselves. The others must be renewed within the node's timeout; otherwise rate "
        "and tension end in a fault, a renewed length in a hold",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        fields=(
            *joint_fields(
                WINCH_TO_LENGTH,
                ("m", "length setpoint at the drum", 0.0, MAX_LENGTH),
                _LARGEST_RATE,
                _LARGEST_TENSION,
                defaults=_LATER_0,
            ),
            *joint_fields(
                WINCH_WHILE_RENEWED,
                (
                    "m",
                    "length at the drum, reached only while the request is renewed",
                    0.0,
                    MAX_LENGTH,
                ),
                _LARGEST_RATE,
                _LARGEST_TENSION,
                defaults=_LATER_0,
            ),
            *joint_fields(
                WINCH_AT_RATE,
                UNUSED,
                ("m/s", "payout rate, positive lengthens", -MAX_PAYOUT_RATE, MAX_PAYOUT_RATE),
                _LARGEST_TENSION,
                defaults=_ALL_BUT_SPEED_0,
            ),
            *joint_fields(
                WINCH_AT_TENSION,
                ("m", "longest length to pay out; 0 = the node's parameter", 0.0, MAX_LENGTH),
                _LARGEST_RATE,
                ("N", "tension to hold at the fairlead", 0.0, MAX_TENSION),
                defaults=_ALL_BUT_FORCE_0,
            ),
            *joint_fields(
                WINCH_SLACK,
                ("m", "slack beyond the taut length; 0 takes the slack up", 0.0, MAX_SLACK),
                _LARGEST_RATE,
                defaults=_LATER_0,
            ),
        ),
        joints=(
            WINCH_TO_LENGTH, WINCH_WHILE_RENEWED, WINCH_AT_RATE, WINCH_AT_TENSION, WINCH_SLACK,
        ),
        one_joint=True,
        stale=_STALE_REQUEST,
    ),
    Topic(
        topics.WINCH_TRIM,
        "payout rate that the winch adds to its own to damp the swing; the node bounds it "
        "further",
        "sensor_msgs/msg/JointState",
        Intent.COMMAND,
        rate=50.0,
        fields=joint_fields(
            WINCH_DRUM,
            velocity=("m/s", "added rate, positive lengthens", -MAX_RATE_TRIM, MAX_RATE_TRIM),
        ),
        joints=(WINCH_DRUM,),
        owned="winch_trim",
        stale=StalePolicy(
            max_age=0.5,
            max_lead=0.1,
            unstamped=Unstamped.REFUSE,
            timeout=0.5,
            on_timeout="nothing is added",
        ),
    ),
    Topic(
        topics.WINCH_ESTIMATE,
        "estimates and reference of the winch from encoder, motor current and load cell",
        "sensor_msgs/msg/JointState",
        Intent.STATE,
        rate=50.0,
        fields=(
            *joint_fields(
                PAYOUT,
                ("m", "length paid out at the drum (unstretched)", 0.0, MAX_LENGTH),
                ("m/s", "its rate", -5.0, 5.0),
            ),
            *joint_fields(
                STRETCHED,
                ("m", "length from the fairlead to the rover, stretched", 0.0, 2.0 * MAX_LENGTH),
                ("m/s", "its rate", -50.0, 50.0),
            ),
            *joint_fields(
                TENSION,
                ("-", "1 = valid, 0 = unknown and reported as 0", 0.0, 1.0),
                effort=("N", "tension at the fairlead", 0.0, 1e6),
            ),
            *joint_fields(
                TETHER_OUT,
                ("kg", "mass of the tether paid out", 0.0, 1e3),
                effort=("N", "its weight", 0.0, 1e4),
            ),
            *joint_fields(
                REFERENCE,
                ("m", "length reference", 0.0, MAX_LENGTH),
                ("m/s", "rate reference, trim included", -MAX_PAYOUT_RATE, MAX_PAYOUT_RATE),
                ("N", "tension reference or feed-forward", 0.0, MAX_TENSION),
            ),
        ),
        joints=(PAYOUT, STRETCHED, TENSION, TETHER_OUT, REFERENCE),
    ),
    Topic(
        topics.WINCH_MODE,
        "mode of the winch; in disarmed, stop and fault the brake stays closed until it is "
        "armed",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(WinchMode),
    ),
    Topic(
        topics.WINCH_ALARMS,
        "alarms of the winch, each with hysteresis; every change is also an event",
        "sensor_msgs/msg/JointState",
        Intent.LATCHED,
        fields=tuple(
            row
            for name in ALARM_NAMES
            for row in joint_fields(
                name,
                ("-", "1 = raised, 0 = not raised", 0.0, 1.0),
                effort=("N", "tension when it was raised", 0.0, 1e6),
            )
        ),
        joints=ALARM_NAMES,
    ),
    Topic(
        topics.TENSION_WATCH,
        "classification of the tension at the fairlead",
        "std_msgs/msg/String",
        Intent.LATCHED,
        words=tuple(state for state in LoadState if state.tension_state is state),
    ),
)  # fmt: skip

_EVERY_NODE = (
    Topic(
        topics.CONFIG,
        "configuration of each node as JSON: node, package and contract version, parameters; "
        "the sim node adds scenario and seed",
        "std_msgs/msg/String",
        Intent.LATCHED,
        is_json=True,
    ),
    Topic(
        topics.EVENTS,
        "events of every node, with severity, reason and values",
        "diagnostic_msgs/msg/DiagnosticArray",
        Intent.EVENT,
    ),
    Topic(
        topics.COMMANDS,
        "records of the requests and service calls that each node has taken: sender, state, "
        "progress and reason; one message for each change",
        "diagnostic_msgs/msg/DiagnosticArray",
        Intent.EVENT,
    ),
    Topic(
        topics.DIAGNOSTICS,
        "health of every node at 1 Hz and on change, and each refusal as it happens; of a "
        "flood on one topic only the first ones and a summary each second",
        "diagnostic_msgs/msg/DiagnosticArray",
        Intent.STATE,
        rate=1.0,
    ),
)

NODE_TOPICS = (*_WINCH, *_EVERY_NODE)

NODE_SERVICES = (
    Service(
        topics.WINCH_HOLD,
        "stops smoothly, closes the brake and holds the length",
        TRIGGER,
    ),
    Service(
        topics.WINCH_RELAX,
        "pays out slowly until the tether carries little more than its own weight, then holds",
        TRIGGER,
    ),
    Service(
        topics.WINCH_STOP,
        "closes the brake at once and switches the motor off; always accepted",
        TRIGGER,
    ),
    Service(
        topics.WINCH_REARM,
        "arms the winch after its start, a stop or a fault; refused while the cause persists",
        TRIGGER,
    ),
)
