"""Every command of an operator, once: the command line and the web page are made of this table.

Units and limits are those of the contract. What a node refuses beyond them it says itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from msg_schemas import topics
from msg_schemas.fields import FieldError, Rule, not_known, read_value
from msg_schemas.machine import (
    HEADING_TURN,
    JUMP_STROKE,
    OBSERVATION_STOP,
    PLAIN_STOP,
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
)
from msg_schemas.samples import JointSample, JointValue, OdometrySample, PoseSample
from msg_schemas.table import SERVICES, TOPICS
from operator_console.completion import CompletionCriterion

_DEGREE = math.pi / 180.0
MISSION = "mission"
"""With what the commands of the mission begin: at a terminal a word of its own."""


@dataclass(frozen=True)
class Argument:
    """A number that a command is given.

    Attributes:
        name, about: for people.
        part: of the joint's three numbers: position, velocity or effort.
        required: whether it must be given; what is left out is what the contract says.
        unit: in which people give it; empty = the contract's.
        scale: the contract's units in one of these.
        parameter: node and parameter of its own that stand for it where it is left out.
        least: the smallest value, where that is more than the contract's, in `unit`.
    """

    name: str
    about: str
    part: str = "position"
    required: bool = True
    unit: str = ""
    scale: float = 1.0
    parameter: tuple[str, str] | None = None
    least: float = -math.inf


@dataclass(frozen=True)
class Request:
    """A message on a topic of requests.

    Attributes:
        joint: whose numbers the arguments are; of a way ahead the vector that it adds to.
        taker: node that acts on it.
        ahead: a pose is asked for, straight ahead of where the taker sees the rover.
        renew: how often it must be said again [Hz]; 0 = once is enough.
    """

    topic: str
    joint: str
    taker: str
    renew: float = 0.0
    ahead: bool = False


@dataclass(frozen=True)
class Call:
    """One call of a service.

    Attributes:
        data: what a switch is given.
        at_rest: it comes after the others, when all rests by them: a descent that is asked to hold
            while the drum still slows down would take the winch again, to keep its depth.
    """

    service: str
    data: bool | None = None
    at_rest: bool = False

    @property
    def server(self) -> str:
        """The node that serves it."""
        return SERVICES[self.service].server


@dataclass(frozen=True)
class Command:
    """What an operator can tell the machine.

    Attributes:
        about: what it does, one sentence without its end.
        group: under which heading people find it.
        moves: something moves by it, or may from then on: to be confirmed where a slip is easy.
        request: what is published; or
        calls: services, all of those that are there; a server that has nothing under way may
            refuse as long as another one does not.
        needs_all: they are called in this order, and the first one that refuses ends it.
        ends: how it is recognised that a request is over; None = when all is at rest.
        rests: it is over when everything is at rest.
        undo: the command that ends it halfway, safely.
        heads: which way its depth must lie from the present one: 1 deeper, -1 higher, 0 either.
    """

    name: str
    about: str
    group: str
    arguments: tuple[Argument, ...] = ()
    moves: bool = False
    request: Request | None = None
    calls: tuple[Call, ...] = ()
    needs_all: bool = False
    ends: CompletionCriterion | None = None
    rests: bool = False
    undo: str = ""
    heads: int = 0

    def rule(self, argument: Argument) -> Rule:
        """What an argument accepts, in the unit in which people give it."""
        assert self.request is not None
        row = TOPICS[self.request.topic].by_path[f"{self.request.joint}.{argument.part}"]
        return Rule(
            float,
            argument.unit or row.unit,
            argument.about,
            max(row.minimum / argument.scale, argument.least),
            row.maximum / argument.scale,
        )

    def order(self, given: Mapping[str, object]) -> Order:
        """The command with its arguments, numbers or texts.

        Raises:
            FieldError: one is missing, not known, no number, or out of the contract's limits.
        """
        known = [argument.name for argument in self.arguments]
        for name, value in given.items():
            if name not in known:
                raise FieldError(name, value, f"{self.name} has no such argument" + (
                    not_known(name, known) if known else ""))  # fmt: skip
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
    """A number that is given as a text; what is none stays what it is."""
    if not isinstance(value, str):
        return value
    try:
        return float(value)
    except ValueError:
        return value


@dataclass(frozen=True)
class Order:
    """A command with its arguments, in the units in which people give them."""

    command: Command
    values: Mapping[str, float] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """As an operator would type it."""
        words = [self.command.name]
        for argument in self.command.arguments:
            if argument.name in self.values:
                words += [] if argument.required else [f"--{argument.name}"]
                words.append(f"{self.values[argument.name]:g}")
        return " ".join(words)

    @property
    def told(self) -> Mapping[str, float]:
        """The arguments in the contract's units."""
        scales = {argument.name: argument.scale for argument in self.command.arguments}
        return {name: value * scales[name] for name, value in self.values.items()}

    def contradiction(self, depth: float) -> str:
        """Why it cannot be meant at the present depth [m]; empty if it can."""
        heads = self.command.heads
        if not heads or (self.told["depth"] - depth) * heads >= 0.0:
            return ""
        other = next(row.name for row in _TABLE if row.heads == -heads)
        goal, where = self.told["depth"], "above" if heads > 0 else "below"
        return f"the rover is at {depth:.2f} m, {goal:g} m is {where} it; `{other} {goal:g}`?"

    def goal(self, seen: OdometrySample, stamp_ns: int) -> PoseSample:
        """The pose so far ahead of where the rover was seen; the heading there is left open."""
        (way,) = self.told.values()
        x, y, z, w = seen.orientation
        heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        px, py, pz = seen.position
        there = (px + way * math.cos(heading), py + way * math.sin(heading), pz)
        return PoseSample(stamp_ns, there)

    def sample(self) -> JointSample:
        """What is published, not stamped: taken as sent on arrival."""
        request = self.command.request
        assert request is not None
        told = self.told
        parts = {
            argument.part: told[argument.name]
            for argument in self.command.arguments
            if argument.name in told
        }
        return JointSample(0, {request.joint: JointValue(**parts)})


# --- the table -----------------------------------------------------------------------------------


def _taken_by(word: str) -> str:
    """The node that says what it is doing on a topic."""
    return TOPICS[word].publisher


_DESCENT = _taken_by(topics.DESCENT_PHASE)
_WINCH = _taken_by(topics.WINCH_MODE)
_JUMP = _taken_by(topics.JUMP_PHASE)
_DRIVE = _taken_by(topics.DRIVE_PHASE)

_ELSEWHERE = ("descent_interrupted", "descent_holding", "descent_released")
_STOP = CompletionCriterion("stop_ended", of={"depth": "depth"}, lost=_ELSEWHERE)
_TURN = CompletionCriterion("pointing_reached", lost=("pointing_ended", *_ELSEWHERE))
_NO_MOTION = ("winch_stop", "winch_fault", "winch_disarmed")
_MOTIONS = ("winch_length", "winch_rate", "winch_tension", "winch_slack", "winch_relax")
_LENGTH = CompletionCriterion(
    "winch_hold", near={"length": ("length", 0.05)}, lost=_NO_MOTION + _MOTIONS
)
_SLACK = CompletionCriterion("winch_hold", lost=_NO_MOTION + _MOTIONS)
_UNTIL_LEFT = CompletionCriterion("", lost=("winch_hold", *_NO_MOTION, *_MOTIONS))
_LEAP = CompletionCriterion("jump_standby", lost=("jump_letting_down", "jump_fault"))

_WAY = CompletionCriterion(
    "drive_done", lost=("drive_stopped", "drive_failed", "drive_stuck", "drive_begun")
)

_RENEWAL = 5.0  # [Hz]
_OWN = "; left out: the node's own"


def _depth(shallowest: bool) -> tuple[Argument, ...]:
    parameter = (_DESCENT, "min_depth") if shallowest else None
    about = "to go to, as length at the drum"
    if shallowest:
        about += "; left out: the shallowest that the node allows"
    return (
        Argument("depth", about, parameter=parameter),
        Argument("rate", f"largest rate on the way{_OWN}", "velocity", required=False),
    )


def _stop(name: str, about: str, joint: str, heads: int = 0) -> Command:
    return Command(
        name, about, "descent", _depth(heads < 0), moves=True,
        request=Request(topics.DESCENT_REQUEST, joint, _DESCENT), ends=_STOP, undo="hold",
        heads=heads,
    )  # fmt: skip


def _winch(
    name: str,
    about: str,
    joint: str,
    ends: CompletionCriterion,
    *arguments: Argument,
    renew: float = 0.0,
) -> Command:
    return Command(
        name, about, "winch", arguments, moves=True,
        request=Request(topics.WINCH_REQUEST, joint, _WINCH, renew), ends=ends, undo="hold",
    )  # fmt: skip


def _calls(*services: str) -> tuple[Call, ...]:
    return tuple(Call(name) for name in services)


def _of_mission(name: str, about: str, service: str) -> Command:
    return Command(
        f"{MISSION}-{name}", about, "mission", calls=_calls(service),
        moves=name not in ("hold", "abort"),
    )  # fmt: skip


_RATE = Argument("rate", f"largest rate{_OWN}", "velocity", required=False)
_LIMIT = Argument("tension", f"largest tension to use{_OWN}", "effort", required=False)

_TABLE = (
    # What ends a motion comes first: it must be found at once.
    Command(
        "hold", "comes to rest: the winch brakes, the wheels stand, the descent keeps the attitude",
        "everything", rests=True,
        calls=(
            *_calls(topics.MISSION_HOLD, topics.WINCH_HOLD, topics.DRIVE_STOP),
            Call(topics.DESCENT_HOLD, at_rest=True),
        ),
    ),
    Command(
        "abort", "lets a compressed spring down, forgets all stops and comes to rest",
        "everything", rests=True,
        calls=(
            *_calls(
                topics.MISSION_ABORT, topics.JUMP_ABORT, topics.WINCH_HOLD, topics.DRIVE_STOP
            ),
            Call(topics.DESCENT_ABORT, at_rest=True),
        ),
    ),
    Command(
        "disarm", "closes the winch's brake at once and takes the drives' power",
        "everything", calls=(Call(topics.WINCH_STOP), Call(topics.DRIVES_ARM, False)),
        rests=True,
    ),
    Command(
        "arm", "powers the drives and arms the winch, when what disarmed them is gone",
        "everything", moves=True, needs_all=True,
        calls=(Call(topics.DRIVES_ARM, True), Call(topics.WINCH_REARM)),
    ),
    _stop("descend", "goes down to a depth, damping the swing on the way", PLAIN_STOP, 1),
    _stop("ascend", "goes up to a depth, damping the swing on the way", PLAIN_STOP, -1),
    _stop("observe", "goes to a depth, steadies the rover and images the wall", OBSERVATION_STOP),
    Command(
        "turn", "turns the hanging rover about the plumb line and holds the heading",
        "descent",
        (Argument("angle", "counter-clockwise from above", unit="deg", scale=_DEGREE),),
        moves=True, request=Request(topics.DESCENT_REQUEST, HEADING_TURN, _DESCENT), ends=_TURN,
        undo="hold",
    ),
    Command(
        "resume", "goes on with what a hold has left", "descent", moves=True,
        calls=_calls(topics.DESCENT_RESUME),
    ),
    Command(
        "release", "gives winch, wheels and flywheel back, once no stops are left", "descent",
        calls=_calls(topics.DESCENT_RELEASE),
    ),
    _winch(
        "payout", "pays out or reels in to a length, by the winch alone", WINCH_TO_LENGTH, _LENGTH,
        Argument("length", "length at the drum"), _RATE, _LIMIT,
    ),
    _winch(
        "jog", "pays out at a rate, below 0 reels in, for as long as it is renewed",
        WINCH_AT_RATE, _UNTIL_LEFT, Argument("rate", "payout rate", "velocity"), _LIMIT,
        renew=_RENEWAL,
    ),
    _winch(
        "pull", "holds a tension at the fairlead, for as long as it is renewed",
        WINCH_AT_TENSION, _UNTIL_LEFT, Argument("tension", "to hold", "effort"), _RATE,
        renew=_RENEWAL,
    ),
    _winch(
        "slack", "gives slack to a rover that stands, or takes it up", WINCH_SLACK, _SLACK,
        Argument("amount", "beyond the taut length; 0 takes it up"), _RATE,
    ),
    Command(
        "relax", "lets the pull down until the tether carries little more than itself", "winch",
        moves=True, calls=_calls(topics.WINCH_RELAX), rests=True, undo="hold",
    ),
    Command(
        "jump", "compresses the spring and jumps", "jump",
        (
            Argument("stroke", "compression of the spring at take-off"),
            Argument("speed", f"of the nut while compressing{_OWN}", "velocity", required=False),
        ),
        moves=True, request=Request(topics.JUMP_REQUEST, JUMP_STROKE, _JUMP), ends=_LEAP,
        undo="abort",
    ),
    Command(
        "drive", "drives straight ahead on the floor", "drive",
        (Argument("way", "from where the rover stands", "x", least=0.05),), moves=True,
        request=Request(topics.DRIVE_GOAL, "position", _DRIVE, ahead=True), ends=_WAY, undo="hold",
    ),
    _of_mission("go", "begins the mission; after an abort, the way home", topics.MISSION_GO),
    _of_mission("hold", "brings the mission to rest; its leg waits", topics.MISSION_HOLD),
    _of_mission("resume", "begins the leg again that a hold has left", topics.MISSION_RESUME),
    _of_mission("skip", "leaves the mission's present leg out", topics.MISSION_SKIP),
    _of_mission(
        "abort", "brings the mission to rest and forgets its plan; go then leads home",
        topics.MISSION_ABORT,
    ),
    Command(
        "pause", "stops simulated time", "simulation", calls=(Call(topics.SIM_PAUSE, True),)
    ),
    Command(
        "run", "lets simulated time run on", "simulation",
        calls=(Call(topics.SIM_PAUSE, False),), moves=True,
    ),
)  # fmt: skip

COMMANDS: Mapping[str, Command] = MappingProxyType({row.name: row for row in _TABLE})
