"""Operators' commands: one table for the command line `rover` and for the web page.

Units and limits are those of the contract. A node may refuse a command that keeps them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from msg_schemas import machine, topics
from msg_schemas.access import Act, node_that, nodes_that
from msg_schemas.fields import FieldError, FieldRule, known_names_hint, read_value
from msg_schemas.samples import JointSample, JointValue, PoseEstimateSample, PoseSample
from msg_schemas.table import TOPICS

_DEGREE = math.pi / 180.0
MISSION = "mission"
"""Prefix of the mission commands; at a terminal it is a word of its own."""


@dataclass(frozen=True)
class CommandArgument:
    """A number that a command takes.

    Attributes:
        name: as typed.
        about: description for help texts.
        part: field of the joint: position, velocity or effort.
        required: whether it must be given; the contract's default replaces an optional one.
        unit: unit for operators; empty = the contract's.
        scale: contract units per operator unit.
        parameter: node and parameter that hold the default; None = no default.
        minimum: smallest value in `unit`, if larger than the contract's.
    """

    name: str
    about: str
    part: str = "position"
    required: bool = True
    unit: str = ""
    scale: float = 1.0
    parameter: tuple[str, str] | None = None
    minimum: float = -math.inf


@dataclass(frozen=True)
class TopicRequest:
    """A message on a request topic.

    Attributes:
        joint: joint or vector that the arguments fill.
        node: node that handles the request.
        renewal_rate: rate at which the request must be repeated [Hz]; 0 = it is sent once.
        is_relative: whether the goal is a distance straight ahead of the rover.
    """

    topic: str
    joint: str
    node: str
    renewal_rate: float = 0.0
    is_relative: bool = False


@dataclass(frozen=True)
class ServiceCall:
    """One service call.

    Attributes:
        data: argument of a SetBool service, None for a Trigger.
        after_rest: whether it waits until the winch is at rest. A descent that holds while the drum
            still decelerates takes the winch again to keep its depth.
    """

    service: str
    data: bool | None = None
    after_rest: bool = False

    @property
    def servers(self) -> tuple[str, ...]:
        """Nodes that serve it; one of them runs."""
        return nodes_that(Act.SERVE, self.service)


@dataclass(frozen=True)
class OperatorCommand:
    """One command of an operator.

    Attributes:
        about: what it does: an imperative without a full stop.
        group: heading in help texts and on the page.
        moves: whether something may move; the page then asks for confirmation.
        request: message to publish; or
        calls: services to call, every available one; a server that has nothing to stop may refuse
            if another one accepts.
        all_required: whether the calls run in this order up to the first refusal.
        completes_at_rest: whether it is complete when the machine is at rest.
        lasts: whether its only call begins what ends later, by the record of the call.
        undo: command that stops it safely.
        direction: allowed side of the present depth: 1 deeper, -1 higher, 0 both.
    """

    name: str
    about: str
    group: str
    arguments: tuple[CommandArgument, ...] = ()
    moves: bool = False
    request: TopicRequest | None = None
    calls: tuple[ServiceCall, ...] = ()
    all_required: bool = False
    completes_at_rest: bool = False
    lasts: bool = False
    undo: str = ""
    direction: int = 0

    @property
    def nodes(self) -> tuple[str, ...]:
        """Nodes of which one executes it, or its last call."""
        return self.calls[-1].servers if self.request is None else (self.request.node,)

    def rule(self, argument: CommandArgument) -> FieldRule:
        """Unit and limits of an argument, in the unit for operators."""
        assert self.request is not None
        row = TOPICS[self.request.topic].by_path[f"{self.request.joint}.{argument.part}"]
        return FieldRule(
            float,
            argument.unit or row.unit,
            argument.about,
            max(row.minimum / argument.scale, argument.minimum),
            row.maximum / argument.scale,
        )

    def order(self, given: Mapping[str, object]) -> Order:
        """The command with its arguments.

        Args:
            given: numbers or their texts by the argument's name.

        Raises:
            FieldError: an argument is missing, unknown, not a number, or out of limits.
        """
        known = [argument.name for argument in self.arguments]
        for name, value in given.items():
            if name not in known:
                raise FieldError(name, value, f"{self.name} has no such argument" + (
                    known_names_hint(name, known) if known else ""))  # fmt: skip
        values: dict[str, float] = {}
        for argument in self.arguments:
            value = given.get(argument.name)
            rule = self.rule(argument)
            if value is not None:
                values[argument.name] = float(read_value(rule, _number(value), argument.name))
            elif argument.required:
                raise FieldError(argument.name, None, f"should be {rule.range_text()}")
        return Order(self, values)


def _number(value: object) -> object:
    """Convert the text of a decimal number; return anything else unchanged."""
    if not isinstance(value, str) or "_" in value:  # Python reads a mistyped 1_2 as 12
        return value
    try:
        return float(value)
    except ValueError:
        return value


@dataclass(frozen=True)
class Order:
    """A command with its arguments, in the units for operators."""

    command: OperatorCommand
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The command as an operator types it."""
        words = [self.command.name]
        for argument in self.command.arguments:
            if argument.name in self.values:
                words += [] if argument.required else [f"--{argument.name}"]
                words.append(f"{self.values[argument.name]:g}")
        return " ".join(words)

    @property
    def contract_values(self) -> Mapping[str, float]:
        """The arguments in the contract's units."""
        scales = {argument.name: argument.scale for argument in self.command.arguments}
        return {name: value * scales[name] for name, value in self.values.items()}

    def contradiction(self, depth: float) -> str:
        """Explain why the goal contradicts the command at this depth [m]; empty if it does not."""
        direction = self.command.direction
        if not direction or (self.contract_values["depth"] - depth) * direction >= 0.0:
            return ""
        other = next(row.name for row in _TABLE if row.direction == -direction)
        goal, where = self.contract_values["depth"], "above" if direction > 0 else "below"
        return f"the rover is at {depth:.2f} m, {goal:g} m is {where} it; `{other} {goal:g}`?"

    def goal(self, pose: PoseEstimateSample, stamp_ns: int) -> PoseSample:
        """The pose at the given distance straight ahead of the rover, with any heading."""
        (distance,) = self.contract_values.values()
        x, y, z = pose.position
        goal = (x + distance * math.cos(pose.heading), y + distance * math.sin(pose.heading), z)
        return PoseSample(stamp_ns, goal)

    def sample(self) -> JointSample:
        """The message to publish; stamp 0 means "now, on arrival"."""
        request = self.command.request
        assert request is not None
        contract_values = self.contract_values
        parts = {
            argument.part: contract_values[argument.name]
            for argument in self.command.arguments
            if argument.name in contract_values
        }
        return JointSample(0, {request.joint: JointValue(**parts)})


# --- the table -----------------------------------------------------------------------------------


_DESCENT = node_that(Act.PUBLISH, topics.DESCENT_PHASE)
_WINCH = node_that(Act.PUBLISH, topics.WINCH_MODE)
_JUMP = node_that(Act.PUBLISH, topics.JUMP_PHASE)
_DRIVE = node_that(Act.PUBLISH, topics.DRIVE_PHASE)

_RENEWAL = 5.0  # [Hz]
_DEFAULT = "; default: the node's parameter"


def _depth(shallowest: bool) -> tuple[CommandArgument, ...]:
    parameter = (_DESCENT, "min_depth") if shallowest else None
    about = "target depth, as tether length at the drum"
    if shallowest:
        about += "; default: the shallowest allowed"
    return (
        CommandArgument("depth", about, parameter=parameter),
        CommandArgument("rate", f"maximum rate{_DEFAULT}", "velocity", required=False),
    )


def _stop(name: str, about: str, joint: str, direction: int = 0) -> OperatorCommand:
    return OperatorCommand(
        name, about, "descent", _depth(direction < 0), moves=True,
        request=TopicRequest(topics.DESCENT_REQUEST, joint, _DESCENT), undo="hold",
        direction=direction,
    )  # fmt: skip


def _winch(
    name: str,
    about: str,
    joint: str,
    *arguments: CommandArgument,
    renewal_rate: float = 0.0,
) -> OperatorCommand:
    return OperatorCommand(
        name, about, "winch", arguments, moves=True,
        request=TopicRequest(topics.WINCH_REQUEST, joint, _WINCH, renewal_rate), undo="hold",
    )  # fmt: skip


def _calls(*services: str) -> tuple[ServiceCall, ...]:
    return tuple(ServiceCall(name) for name in services)


def _of_mission(name: str, about: str, service: str, *, lasts: bool = False) -> OperatorCommand:
    return OperatorCommand(
        f"{MISSION}-{name}", about, "mission", calls=_calls(service),
        moves=name not in ("hold", "abort"), lasts=lasts, undo="hold" if lasts else "",
    )  # fmt: skip


_RATE = CommandArgument("rate", f"maximum rate{_DEFAULT}", "velocity", required=False)
_LIMIT = CommandArgument("tension", f"maximum tension{_DEFAULT}", "effort", required=False)

_TABLE = (
    # Commands that stop a motion come first, so that operators find them at once.
    OperatorCommand(
        "hold", "stop all motion: brake the winch, stop the wheels, keep the attitude",
        "everything", completes_at_rest=True,
        calls=(
            *_calls(topics.MISSION_HOLD, topics.WINCH_HOLD, topics.DRIVE_STOP),
            ServiceCall(topics.DESCENT_HOLD, after_rest=True),
        ),
    ),
    OperatorCommand(
        "abort", "unload the jump spring, cancel all stops and stop all motion",
        "everything", completes_at_rest=True,
        calls=(
            *_calls(
                topics.MISSION_ABORT, topics.JUMP_ABORT, topics.WINCH_HOLD, topics.DRIVE_STOP
            ),
            ServiceCall(topics.DESCENT_ABORT, after_rest=True),
        ),
    ),
    OperatorCommand(
        "disarm", "close the winch brake at once and switch the drives off",
        "everything", calls=(ServiceCall(topics.WINCH_STOP), ServiceCall(topics.DRIVES_ARM, False)),
        completes_at_rest=True,
    ),
    OperatorCommand(
        "arm", "switch the drives on and arm the winch; refused while a fault persists",
        "everything", moves=True, all_required=True,
        calls=(ServiceCall(topics.DRIVES_ARM, True), ServiceCall(topics.WINCH_REARM)),
    ),
    _stop("descend", "lower the rover to a depth while damping its swing", machine.PLAIN_STOP, 1),
    _stop("ascend", "raise the rover to a depth while damping its swing", machine.PLAIN_STOP, -1),
    _stop(
        "observe", "move to a depth, steady the rover and image the wall", machine.OBSERVATION_STOP
    ),
    OperatorCommand(
        "turn", "turn the hanging rover about the plumb line and hold the heading",
        "descent",
        (
            CommandArgument(
                "angle", "rotation, counter-clockwise seen from above", unit="deg", scale=_DEGREE
            ),
        ),
        moves=True, request=TopicRequest(topics.DESCENT_REQUEST, machine.HEADING_TURN, _DESCENT),
        undo="hold",
    ),
    OperatorCommand(
        "resume", "resume the descent after a hold", "descent", moves=True,
        calls=_calls(topics.DESCENT_RESUME),
    ),
    OperatorCommand(
        "release", "hand winch, wheels and flywheel back after the last stop", "descent",
        calls=_calls(topics.DESCENT_RELEASE),
    ),
    _winch(
        "payout", "pay out or reel in to a tether length, by the winch alone",
        machine.WINCH_TO_LENGTH,
        CommandArgument("length", "target tether length at the drum"), _RATE, _LIMIT,
    ),
    _winch(
        "jog", "pay out at a rate (negative: reel in) while it is renewed",
        machine.WINCH_AT_RATE, CommandArgument("rate", "payout rate", "velocity"), _LIMIT,
        renewal_rate=_RENEWAL,
    ),
    _winch(
        "pull", "control the tension at the fairlead while it is renewed",
        machine.WINCH_AT_TENSION, CommandArgument("tension", "tension setpoint", "effort"), _RATE,
        renewal_rate=_RENEWAL,
    ),
    _winch(
        "slack", "give slack to a standing rover, or take it up", machine.WINCH_SLACK,
        CommandArgument("amount", "tether length beyond taut; 0 takes the slack up"), _RATE,
    ),
    OperatorCommand(
        "relax", "lower the tension until the tether carries little more than its own weight",
        "winch",
        moves=True, calls=_calls(topics.WINCH_RELAX), completes_at_rest=True, undo="hold",
    ),
    OperatorCommand(
        "jump", "compress the spring and jump", "jump",
        (
            CommandArgument("stroke", "spring compression at take-off"),
            CommandArgument(
                "speed", f"nut speed while compressing{_DEFAULT}", "velocity", required=False
            ),
        ),
        moves=True, request=TopicRequest(topics.JUMP_REQUEST, machine.JUMP_STROKE, _JUMP),
        undo="abort",
    ),
    OperatorCommand(
        "drive", "drive straight ahead on the floor", "drive",
        (CommandArgument("distance", "distance from the present position", "x", minimum=0.05),),
        moves=True,
        request=TopicRequest(topics.DRIVE_GOAL, "position", _DRIVE, is_relative=True),
        undo="hold",
    ),
    _of_mission(
        "go", "start the mission; after an abort, return home", topics.MISSION_GO, lasts=True
    ),
    _of_mission("hold", "hold the mission in its present leg", topics.MISSION_HOLD),
    _of_mission(
        "resume", "restart the held leg of the mission", topics.MISSION_RESUME, lasts=True
    ),
    _of_mission("skip", "skip the mission's present leg", topics.MISSION_SKIP),
    _of_mission(
        "abort", "stop the mission and cancel its plan; go then returns home",
        topics.MISSION_ABORT,
    ),
    OperatorCommand(
        "pause", "pause simulated time", "simulation", calls=(ServiceCall(topics.SIM_PAUSE, True),)
    ),
    OperatorCommand(
        "run", "continue simulated time", "simulation",
        calls=(ServiceCall(topics.SIM_PAUSE, False),), moves=True,
    ),
)  # fmt: skip

COMMANDS: Mapping[str, OperatorCommand] = MappingProxyType({row.name: row for row in _TABLE})
