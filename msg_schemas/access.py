"""Access control: the topics and services that each node may use.

A ``Component`` that opens anything else fails to configure. The SROS 2 policy
(``msg_schemas.access_policy``) is generated from the same table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from msg_schemas import topics
from msg_schemas.actions import ACTIONS
from msg_schemas.specifications import Audience
from msg_schemas.table import TOPICS

ALL = ("*",)
"""Every name, as a pattern of DDS Security's permissions."""

TRANSFORMS = ("tf", "tf_static")
"""Moving and fixed frames, as viewers subscribe to them."""


@dataclass(frozen=True)
class Access:
    """What one participant may do; names of topics and services as in the contract, or ``ALL``.

    Attributes:
        publishes, subscribes: topics.
        serves, calls: services.
        publishes_outside_contract: topics of ROS itself, such as ``tf``.
        executes: actions, with their hidden topics and services.
        requests: actions whose goals it sends.
    """

    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    publishes_outside_contract: tuple[str, ...] = ()
    executes: tuple[str, ...] = ()
    requests: tuple[str, ...] = ()


LOCKSTEP = ("lockstep/reports", "lockstep/releases", "lockstep/alive")
"""Topics by which processes in lockstep wait for each other."""

BATCHES, TRUTH_BATCHES = "batches", "truth/batches"
"""Topics on which a process sends its nodes' streams in few messages; ground truth has its own."""

OF_ALL_NODES = Access(
    publishes=(topics.CONFIG, topics.EVENTS, topics.COMMANDS, topics.DIAGNOSTICS),
    publishes_outside_contract=LOCKSTEP,
)
"""Access of every node besides its own row; all may also subscribe to clock and lockstep."""


def batches_of(topic: str) -> str:
    """Return the topic on which a topic of the contract is sent in batches, if it is a stream.

    What controllers may not receive is not in the batches that they receive.
    """
    is_for_all = TOPICS[topic].audience is not Audience.NOT_CONTROLLERS
    return BATCHES if is_for_all else TRUTH_BATCHES


_DRIVEN = (
    topics.JUMP_MOTOR_COMMAND,
    topics.FLYWHEEL_COMMAND,
    topics.WHEEL_COMMAND,
    topics.WHEEL_TORQUE_COMMAND,
    topics.WINCH_COMMAND,
)
_SENSED = (
    topics.IMU,
    topics.CONTACT,
    topics.LOAD_CELL,
    topics.ROVER_LOAD_CELL,
    topics.MOTOR_CURRENTS,
    topics.JUMP_MOTOR_STATE,
    topics.FLYWHEEL_STATE,
    topics.WHEEL_STATE,
    topics.WINCH_STATE,
)
_SEEN = (
    topics.CLOCK,
    topics.TRUTH_BODY1,
    topics.TRUTH_BODY2,
    topics.TRUTH_TETHER,
    topics.TRUTH_ENERGY,
    topics.TRUTH_PHASE,
    topics.TRUTH_STATE,
    topics.CAMERA,
    topics.SIM_STATUS,
    topics.MARKERS,
    topics.PLACE,
    topics.ROBOT_DESCRIPTION,
)
_TO_DRIVE = (topics.CMD_VEL, topics.DRIVE_GOAL, topics.DRIVE_PATH, topics.DRIVE_START)
_REQUESTS = (topics.JUMP_REQUEST, topics.WINCH_REQUEST, topics.DESCENT_REQUEST, *_TO_DRIVE)
_RESETS = (topics.SIM_RESET, topics.SIM_RESET_PLANT)

_PLANT = Access(
    publishes=(*_SEEN, *_SENSED),
    subscribes=_DRIVEN,
    serves=(topics.SIM_PAUSE, topics.SIM_STEP, *_RESETS),
)

ACCESS: dict[str, Access] = {
    "sim_node": _PLANT,
    "mock_plant": _PLANT,
    "drive_emulator": Access(publishes=_SEEN, subscribes=(topics.CONFIG,), serves=_RESETS),
    "hil_bridge": Access(
        publishes=(*_SENSED, topics.LINK_STATUS),
        subscribes=_DRIVEN,
        serves=(topics.DRIVES_ARM,),
    ),
    "winch_node": Access(
        publishes=(
            topics.WINCH_COMMAND,
            topics.WINCH_ESTIMATE,
            topics.WINCH_MODE,
            topics.WINCH_ALARMS,
            topics.TENSION_WATCH,
        ),
        subscribes=(
            topics.WINCH_STATE,
            topics.LOAD_CELL,
            topics.MOTOR_CURRENTS,
            topics.JUMP_PHASE,
            topics.WINCH_TRIM,
            topics.WINCH_REQUEST,
        ),
        serves=(topics.WINCH_HOLD, topics.WINCH_RELAX, topics.WINCH_STOP, topics.WINCH_REARM),
    ),
    "descent_node": Access(
        publishes=(
            topics.WHEEL_COMMAND,
            topics.FLYWHEEL_COMMAND,
            topics.JUMP_MOTOR_COMMAND,
            topics.WINCH_REQUEST,
            topics.WINCH_TRIM,
            topics.DESCENT_PHASE,
            topics.DESCENT_STATE,
            topics.DESCENT_OBSERVATION,
        ),
        subscribes=(
            topics.IMU,
            topics.WINCH_STATE,
            topics.WHEEL_STATE,
            topics.FLYWHEEL_STATE,
            topics.LOAD_CELL,
            topics.CAMERA,
            topics.WINCH_MODE,
            topics.JUMP_PHASE,
            topics.DRIVE_PHASE,
            topics.DESCENT_REQUEST,
        ),
        serves=(
            topics.DESCENT_HOLD,
            topics.DESCENT_RESUME,
            topics.DESCENT_ABORT,
            topics.DESCENT_RELEASE,
        ),
    ),
    "jump_node": Access(
        publishes=(
            topics.JUMP_MOTOR_COMMAND,
            topics.WINCH_REQUEST,
            topics.JUMP_PHASE,
            topics.JUMP_PREDICTION,
            topics.JUMP_FLOWN,
        ),
        subscribes=(
            topics.CONTACT,
            topics.JUMP_MOTOR_STATE,
            topics.IMU,
            topics.ROVER_LOAD_CELL,
            topics.POSE,
            topics.DRIVE_STATE,
            topics.WINCH_ESTIMATE,
            topics.DESCENT_PHASE,
            topics.COMMANDS,
            topics.JUMP_REQUEST,
        ),
        serves=(topics.JUMP_ABORT,),
    ),
    "drive_node": Access(
        publishes=(
            topics.WHEEL_COMMAND,
            topics.WINCH_REQUEST,
            topics.DRIVE_PHASE,
            topics.DRIVE_STATE,
            topics.ODOMETRY,
            topics.POSE,
        ),
        subscribes=(
            topics.IMU,
            topics.WHEEL_STATE,
            topics.MOTOR_CURRENTS,
            topics.CONTACT,
            topics.WINCH_ESTIMATE,
            topics.WINCH_MODE,
            topics.JUMP_PHASE,
            topics.JUMP_FLOWN,
            topics.DESCENT_PHASE,
            *_TO_DRIVE,
        ),
        serves=(topics.DRIVE_STOP,),
    ),
    "mission_node": Access(
        publishes=(
            topics.MISSION_PHASE,
            topics.MISSION_STATE,
            topics.WINCH_REQUEST,
            topics.DESCENT_REQUEST,
            topics.DRIVE_GOAL,
            topics.DRIVE_START,
            topics.JUMP_REQUEST,
        ),
        subscribes=(
            topics.WINCH_MODE,
            topics.WINCH_ALARMS,
            topics.WINCH_ESTIMATE,
            topics.DESCENT_PHASE,
            topics.DESCENT_STATE,
            topics.DRIVE_PHASE,
            topics.DRIVE_STATE,
            topics.POSE,
            topics.JUMP_PHASE,
            topics.JUMP_MOTOR_STATE,
            topics.EVENTS,
            topics.COMMANDS,
            topics.CONFIG,
        ),
        serves=(
            topics.MISSION_GO,
            topics.MISSION_HOLD,
            topics.MISSION_RESUME,
            topics.MISSION_SKIP,
            topics.MISSION_ABORT,
        ),
        calls=(
            topics.WINCH_HOLD,
            topics.WINCH_REARM,
            topics.DESCENT_HOLD,
            topics.DESCENT_RESUME,
            topics.DESCENT_ABORT,
            topics.DESCENT_RELEASE,
            topics.DRIVE_STOP,
            topics.JUMP_ABORT,
        ),
    ),
    "view_node": Access(
        publishes=(
            topics.JOINT_STATES,
            topics.ROBOT_DESCRIPTION,
            topics.OBSERVED_WALL,
            topics.PREDICTED_JUMP,
        ),
        subscribes=(
            topics.ROBOT_DESCRIPTION,
            topics.DESCENT_OBSERVATION,
            topics.JUMP_PREDICTION,
            topics.ODOMETRY,
            topics.POSE,
            topics.TRUTH_BODY1,
            topics.TRUTH_BODY2,
            topics.WHEEL_STATE,
            topics.JUMP_MOTOR_STATE,
            topics.WINCH_STATE,
        ),
        publishes_outside_contract=TRANSFORMS,
    ),
    "action_node": Access(
        publishes=(topics.DESCENT_REQUEST, topics.DRIVE_GOAL, topics.JUMP_REQUEST),
        subscribes=(topics.COMMANDS, topics.EVENTS),
        calls=(
            topics.DESCENT_HOLD,
            topics.DRIVE_STOP,
            topics.JUMP_ABORT,
            topics.MISSION_GO,
            topics.MISSION_HOLD,
        ),
        executes=tuple(ACTIONS),
    ),
    "bag_record": Access(subscribes=ALL),
    "hil_rehearsal": Access(publishes=(*_DRIVEN, *_REQUESTS), subscribes=ALL, calls=ALL),
    "operator_console": Access(publishes=_REQUESTS, subscribes=ALL, calls=ALL),
    "operator": Access(publishes=_REQUESTS, subscribes=ALL, calls=ALL, requests=ALL),
}
"""Access by the node's name; ``operator`` is a person at a command line."""


COMPOSED: dict[str, tuple[str, ...]] = {
    "mother_nodes": ("winch_node",),
    "rover_nodes": ("descent_node", "drive_node", "jump_node"),
    "operations_nodes": ("mission_node",),
}
"""Executables that run several controllers in one process, as they would be deployed."""


class Act(StrEnum):
    """Kinds of access; the value is the attribute of ``Access``."""

    PUBLISH = "publishes"
    SUBSCRIBE = "subscribes"
    SERVE = "serves"
    CALL = "calls"
    EXECUTE = "executes"
    REQUEST = "requests"


def nodes_that(act: Act, name: str) -> tuple[str, ...]:
    """Return the nodes whose rows name a topic or service; empty: every node has this access."""
    if name in getattr(OF_ALL_NODES, act):
        return ()
    return tuple(node for node, access in ACCESS.items() if name in getattr(access, act))


def node_that(act: Act, name: str) -> str:
    """Return the only node whose row names a topic or service.

    Raises:
        ValueError: several nodes have this access.
    """
    (node,) = nodes_that(act, name)
    return node


def check_access(node: str, act: Act, name: str) -> None:
    """Check that a node's row grants an access; a node without a row may do everything.

    Args:
        node: its name in ``ACCESS``.
        act: kind of access.
        name: topic or service.

    Raises:
        PermissionError: the row does not grant it.
    """
    if node not in ACCESS:
        return
    granted = getattr(ACCESS[node], act) + getattr(OF_ALL_NODES, act)
    if name not in granted and granted != ALL:
        msg = f"{node} {act} {name}: its row in msg_schemas/access.py should grant it"
        raise PermissionError(msg)
