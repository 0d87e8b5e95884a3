"""Kinds of actions of a step, with their keys; `procedure_runner` carries them out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.cdr import check
from msg_schemas.configuration import (
    Configuration,
    ConfigurationError,
    choice,
    flag,
    quantity,
    read_by,
    sections,
    text,
)
from msg_schemas.fields import known_names_hint
from msg_schemas.parameters import ParameterError
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.specifications import Intent
from msg_schemas.table import SERVICES, TOPICS
from rover_hil.canopen.impairment import Impairment, impairment_from
from rover_hil.rehearsal.expectation import LONGEST

COMMANDS = tuple(name for name, row in TOPICS.items() if row.intent is Intent.COMMAND)
"""Topics that a procedure may publish: commands to drives and requests to controllers."""

_DEFAULT_RATE = 10.0  # where the contract gives none [Hz]
_LARGEST_AGE = 1.0e8  # of a stamp: a message cannot state one after the year 2038 [s]
_PARAMETER_RANGE = range(-(2**63), 2**63)  # of ROS' whole numbers
PARTS = ("position", "velocity", "effort")


@dataclass(frozen=True, kw_only=True)
class Action(Configuration):
    """Base class of all actions.

    Attributes:
        is_evaluated: whether it has a result of its own.
    """

    is_evaluated = False

    @property
    def minimum_duration(self) -> float:
        """Shortest time that it takes [s]."""
        return 0.0

    @property
    def may_move(self) -> bool:
        """Whether it could move a machine, correct or faulty."""
        return False

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return ()


@dataclass(frozen=True, kw_only=True)
class Wait(Action):
    """Wait for a time."""

    duration: float = quantity("s", "how long", minimum=0.0, maximum=LONGEST)

    @property
    def minimum_duration(self) -> float:
        """Shortest time that it takes [s]."""
        return self.duration


@dataclass(frozen=True, kw_only=True)
class Mark(Action):
    """Note the time: expectations with ``since: mark`` count from here."""


@dataclass(frozen=True, kw_only=True)
class MachineReading(Configuration):
    """A value published by the machine when the action begins: scale x value + offset."""

    topic: str = choice(
        tuple(n for n, row in TOPICS.items() if row.fields), "topic with numeric fields"
    )
    field: str = text("path of the field in the contract: force.z")
    scale: float = quantity("-", "factor", 1.0)
    offset: float = quantity("-", "added", 0.0)

    def check(self) -> None:
        """Refuse contradictory keys."""
        fields = TOPICS[self.topic].by_path
        if self.field not in fields:
            expected = f"{self.topic} has no such field{known_names_hint(self.field, fields)}"
            raise ConfigurationError("field", self.field, expected)


Amount = float | MachineReading
"""A number, or the field to read it from."""


def _read_amount(value: object, path: str) -> Amount:
    if isinstance(value, Mapping):
        try:
            return MachineReading(**value)
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}.{error.path}", error.value, error.expected) from None
        except TypeError:
            expected = "should be a mapping of topic, field, scale, offset"
            raise ConfigurationError(path, value, expected) from None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigurationError(path, value, "should be a number, or a mapping of topic and field")
    try:
        return float(value)
    except OverflowError:
        raise ConfigurationError(path, value, "should be a smaller number") from None


@dataclass(frozen=True, kw_only=True)
class JointAmounts(Configuration):
    """Command values of one joint; 0 where not given."""

    position: Amount = read_by(_read_amount, (float, MachineReading), "a number", 0.0)  # noqa: RUF009
    velocity: Amount = read_by(_read_amount, (float, MachineReading), "a number", 0.0)  # noqa: RUF009
    effort: Amount = read_by(_read_amount, (float, MachineReading), "a number", 0.0)  # noqa: RUF009

    def amounts(self) -> tuple[Amount, Amount, Amount]:
        """All three."""
        return self.position, self.velocity, self.effort


@dataclass(frozen=True, kw_only=True)
class Publish(Action):
    """Publish a command or request, once or for a time.

    Unless ``invalid`` is true, the message must conform to the contract, which is checked before
    the procedure runs.
    """

    topic: str = choice(COMMANDS, "command or request of the contract")
    joints: Mapping[str, JointAmounts] = sections(
        JointAmounts, "a mapping of joints to position, velocity, effort", keyed=True
    )
    duration: float = quantity(
        "s", "for how long; 0: one message", 0.0, minimum=0.0, maximum=LONGEST
    )
    rate: float | None = quantity(
        "Hz", "rate; null: the contract's", None, minimum=1.0 / LONGEST, maximum=1000.0,
        optional=True,
    )  # fmt: skip
    throughout: bool = flag("publish until the step's last action has ended")
    age: float = quantity(
        "s", "age of the stamp when it is sent; negative: in the future", 0.0,
        minimum=-_LARGEST_AGE, maximum=_LARGEST_AGE,
    )  # fmt: skip
    unstamped: bool = flag("the stamp is zero")
    omit: str | None = choice(PARTS, "array of the message that stays empty", None, optional=True)
    invalid: bool = flag("the message deliberately violates the contract")

    may_move = True

    @property
    def period(self) -> float:
        """Time between two messages [s]."""
        return 1.0 / (self.rate or TOPICS[self.topic].rate or _DEFAULT_RATE)

    @property
    def minimum_duration(self) -> float:
        """Shortest time that it takes [s]."""
        return 0.0 if self.throughout else self.duration

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        readings = [
            amount
            for joint in self.joints.values()
            for amount in joint.amounts()
            if isinstance(amount, MachineReading)
        ]
        return tuple(each.topic for each in readings)

    def check(self) -> None:
        """Refuse contradictory keys."""
        if self.throughout and self.duration:
            raise ConfigurationError(
                "duration", self.duration, "should be left out where throughout is true"
            )
        if self.invalid:
            return
        try:
            check(self.topic, JointSample(0, {n: _assumed(j) for n, j in self.joints.items()}))
        except Refusal as refusal:
            given = sorted(self.joints)
            expected = f"{refusal.reason} (or set invalid: true)"
            raise ConfigurationError("joints", given, expected) from None
        if self.unstamped or self.omit or self.age:
            policy = TOPICS[self.topic].stale
            if self.omit or not -policy.max_lead <= self.age <= policy.max_age or self.unstamped:
                raise ConfigurationError(
                    "invalid",
                    False,
                    "should be true for a deliberately invalid message",
                )


def _assumed(joint: JointAmounts) -> JointValue:
    # A reading is not known yet: 0 stands for it.
    return JointValue(*(0.0 if isinstance(a, MachineReading) else a for a in joint.amounts()))


def _read_data(value: object, path: str) -> bool:
    if not isinstance(value, bool):
        raise ConfigurationError(path, value, "should be true or false")
    return value


def _read_scalar(value: object, path: str) -> object:
    if not isinstance(value, (str, float, int)):
        raise ConfigurationError(path, value, "should be a number, a text, true or false")
    if isinstance(value, int) and value not in _PARAMETER_RANGE:
        raise ConfigurationError(path, value, "should be a whole number of 64 bits")
    return value


@dataclass(frozen=True, kw_only=True)
class BeyondLimits(Action):
    """Publish, for each field of a topic, one message just beyond each of its limits.

    It passes if each is refused as out_of_limits before the next one is published.
    """

    topic: str = choice(COMMANDS, "command or request of the contract")
    timeout: float = quantity("s", "longest time until a refusal", 2.0, above=0.0, maximum=60.0)

    may_move = True
    is_evaluated = True
    subscribed_topics = (topics.DIAGNOSTICS,)

    def messages(self) -> list[tuple[str, dict[str, JointValue]]]:
        """Field and joints of each message."""
        row = TOPICS[self.topic]
        made = []
        for field in row.fields:
            joint, _, part = field.path.partition(".")
            whole = (joint,) if row.one_joint else (*row.joints, *row.optional_joints)
            for limit, step in ((field.minimum, -1.0), (field.maximum, 1.0)):
                if math.isinf(limit):
                    continue
                beyond = limit + step * max(1.0, abs(limit)) * 0.01
                joints = {name: _allowed(self.topic, name) for name in whole}
                joints[joint] = joints[joint]._replace(**{part: beyond})
                made.append((field.path, joints))
        return made


def _allowed(topic: str, joint: str) -> JointValue:
    """Values of a joint within its limits, as close to 0 as possible."""
    rows = TOPICS[topic].by_path
    fields = [rows[f"{joint}.{part}"] for part in PARTS]
    return JointValue(*(min(max(0.0, field.minimum), field.maximum) for field in fields))


@dataclass(frozen=True, kw_only=True)
class CallAction(Action):
    """Call a service of the contract; passes if the response is `success`."""

    service: str = choice(tuple(SERVICES), "service of the contract")
    data: bool | None = read_by(_read_data, (bool, type(None)), "true or false", None)
    success: bool = flag("expected response", True)
    timeout: float = quantity("s", "longest time until the response", 5.0, above=0.0, maximum=60.0)

    is_evaluated = True

    @property
    def may_move(self) -> bool:
        """Whether it could move a machine."""
        return self.service == topics.DRIVES_ARM and self.data is True

    def check(self) -> None:
        """Refuse contradictory keys."""
        takes_data = SERVICES[self.service].service.endswith("SetBool")
        if takes_data and self.data is None:
            raise ConfigurationError("data", None, f"missing; {self.service} takes true or false")
        if not takes_data and self.data is not None:
            raise ConfigurationError("data", self.data, f"{self.service} takes no data")


@dataclass(frozen=True, kw_only=True)
class SetParameter(Action):
    """Set a parameter of a node; it is restored after the step."""

    node: str = text("name of the node: drive_emulator")
    parameter: str = text("name of the parameter")
    value: str | float | int | bool = read_by(_read_scalar, (), "a single value")
    keep: bool = flag("do not restore it after the step")


def _read_impairments(value: object, path: str) -> tuple[Impairment, ...]:
    if not isinstance(value, list) or not value:
        raise ConfigurationError(path, value, "should be a list of impairments")
    made = []
    for index, each in enumerate(value):
        if not isinstance(each, Mapping):
            raise ConfigurationError(
                f"{path}[{index}]", each, "should be a mapping of kind, target ..."
            )
        try:
            made.append(impairment_from(each))
        except ParameterError as error:
            raise ConfigurationError(f"{path}[{index}]", dict(each), str(error)) from None
    return tuple(made)


@dataclass(frozen=True, kw_only=True)
class Impair(Action):
    """Impair the link, devices or processes of an emulated machine until the end of the step."""

    impairments: tuple[Impairment, ...] = read_by(
        _read_impairments, (tuple,), "a list of impairments, see docs/hil.md"
    )

    @property
    def text(self) -> str:
        """Value of the emulator's parameter `impairments`."""
        return f"[{', '.join(map(str, self.impairments))}]"


@dataclass(frozen=True, kw_only=True)
class Prompt(Action):
    """Have the operator carry out an instruction; if impossible, the step is NOT RUN."""

    key: str = text("one word, for a program in the operator's place")
    instruction: str = text("instruction to the operator")


@dataclass(frozen=True, kw_only=True)
class Inspection(Action):
    """Have the operator inspect something; passes if the answer is yes."""

    key: str = text("one word, for a program in the operator's place")
    question: str = text("question that is answered with yes where all is right")

    is_evaluated = True


ACTIONS: Mapping[str, type[Action]] = {
    "wait": Wait,
    "mark": Mark,
    "publish": Publish,
    "beyond_limits": BeyondLimits,
    "call": CallAction,
    "set": SetParameter,
    "impair": Impair,
    "prompt": Prompt,
    "inspect": Inspection,
}
"""Kinds of actions under a step's `do`, by their keys."""
