"""What a step may do, each kind with its keys. What is done is done by `conduct`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.codecs import check
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
from msg_schemas.fields import not_known
from msg_schemas.parameters import ParameterError
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.specifications import Intent
from msg_schemas.table import SERVICES, TOPICS
from rover_hil.impairment import Impairment, impairment_from

COMMANDS = tuple(name for name, row in TOPICS.items() if row.intent is Intent.COMMAND)
"""Topics that a procedure may publish: what moves a machine, and what asks for it."""

_LONGEST = 3600.0  # [s]
_DEFAULT_RATE = 10.0  # where the contract gives none [Hz]
PARTS = ("position", "velocity", "effort")


@dataclass(frozen=True, kw_only=True)
class Action(Configuration):
    """What all kinds have."""

    @property
    def duration(self) -> float:
        """How long it takes at least [s]."""
        return 0.0

    @property
    def may_move(self) -> bool:
        """Whether a machine, right or wrong, could move by it."""
        return False

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to for it."""
        return ()

    @property
    def judges(self) -> bool:
        """Whether it is judged by itself."""
        return False


@dataclass(frozen=True, kw_only=True)
class Wait(Action):
    """Wait."""

    time: float = quantity("s", "how long", minimum=0.0, maximum=_LONGEST)

    @property
    def duration(self) -> float:
        """How long it takes at least [s]."""
        return self.time


@dataclass(frozen=True, kw_only=True)
class Mark(Action):
    """Note the time: what says ``counts_from: mark`` counts from here."""


@dataclass(frozen=True, kw_only=True)
class Reading(Configuration):
    """A value that the machine tells when the step begins: times x value + plus."""

    topic: str = choice(tuple(n for n, row in TOPICS.items() if row.fields), "topic with numbers")
    field: str = text("which number, as the contract names it: force.z")
    times: float = quantity("-", "factor", 1.0)
    plus: float = quantity("-", "added", 0.0)

    def check(self) -> None:
        """Refuse what no single key can show."""
        fields = TOPICS[self.topic].by_path
        if self.field not in fields:
            expected = f"{self.topic} has no such field{not_known(self.field, fields)}"
            raise ConfigurationError("field", self.field, expected)


Amount = float | Reading
"""A number, or where to read it."""


def _read_amount(value: object, path: str) -> Amount:
    if isinstance(value, Mapping):
        try:
            return Reading(**value)
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}.{error.path}", error.value, error.expected) from None
        except TypeError:
            expected = "should be a mapping of topic, field, times, plus"
            raise ConfigurationError(path, value, expected) from None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigurationError(path, value, "should be a number, or a mapping of topic and field")
    return float(value)


@dataclass(frozen=True, kw_only=True)
class JointAmounts(Configuration):
    """What one joint is told; what is not given is 0."""

    position: Amount = read_by(_read_amount, (float, Reading), "a number", 0.0)  # noqa: RUF009
    velocity: Amount = read_by(_read_amount, (float, Reading), "a number", 0.0)  # noqa: RUF009
    effort: Amount = read_by(_read_amount, (float, Reading), "a number", 0.0)  # noqa: RUF009

    def amounts(self) -> tuple[Amount, Amount, Amount]:
        """All three."""
        return self.position, self.velocity, self.effort


@dataclass(frozen=True, kw_only=True)
class Publish(Action):
    """Send a command or request, once or for a time.

    Unless ``forbidden`` is true, what is sent must keep the contract: a slip of the pen is found
    before anything runs.
    """

    topic: str = choice(COMMANDS, "command or request of the contract")
    joints: Mapping[str, JointAmounts] = sections(
        JointAmounts, "a mapping of joints to position, velocity, effort", keyed=True
    )
    time: float = quantity("s", "for how long; 0: once", 0.0, minimum=0.0, maximum=_LONGEST)
    rate: float | None = quantity(
        "Hz", "how often; null: as the contract says", None, above=0.0, maximum=1000.0,
        optional=True,
    )  # fmt: skip
    throughout: bool = flag("goes on until the step's last action has ended, beside the others")
    age: float = quantity("s", "by which the stamp lies before the sending; negative: ahead", 0.0)
    unstamped: bool = flag("the stamp is zero")
    omit: str | None = choice(PARTS, "array of the message that is left out", None, optional=True)
    forbidden: bool = flag("breaks the contract on purpose")

    @property
    def period(self) -> float:
        """Between two messages [s]."""
        return 1.0 / (self.rate or TOPICS[self.topic].rate or _DEFAULT_RATE)

    @property
    def duration(self) -> float:
        """How long it takes at least [s]."""
        return 0.0 if self.throughout else self.time

    @property
    def may_move(self) -> bool:
        """Whether a machine could move by it."""
        return True

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        readings = [
            amount
            for joint in self.joints.values()
            for amount in joint.amounts()
            if isinstance(amount, Reading)
        ]
        return tuple(each.topic for each in readings)

    def check(self) -> None:
        """Refuse what no single key can show."""
        if self.throughout and self.time:
            raise ConfigurationError("time", self.time, "should be left out of what is throughout")
        if self.forbidden:
            return
        try:
            check(
                TOPICS[self.topic], JointSample(0, {n: _trial(j) for n, j in self.joints.items()})
            )
        except Refusal as refusal:
            given = sorted(self.joints)
            expected = f"{refusal.reason} (or say forbidden: true)"
            raise ConfigurationError("joints", given, expected) from None
        if self.unstamped or self.omit or self.age:
            policy = TOPICS[self.topic].stale
            if self.omit or not -policy.max_lead <= self.age <= policy.max_age or self.unstamped:
                raise ConfigurationError(
                    "forbidden", False, "should be true of what breaks the contract on purpose"
                )


def _trial(joint: JointAmounts) -> JointValue:
    # What will be read cannot be judged yet; it stands for whatever is allowed least.
    return JointValue(*(0.0 if isinstance(a, Reading) else a for a in joint.amounts()))


def _read_data(value: object, path: str) -> bool:
    if not isinstance(value, bool):
        raise ConfigurationError(path, value, "should be true or false")
    return value


def _read_scalar(value: object, path: str) -> object:
    raise ConfigurationError(path, value, "should be a number, a text, true or false")


@dataclass(frozen=True, kw_only=True)
class BeyondLimits(Action):
    """Send, for each number of a topic, one message just beyond each of its limits.

    It is judged by itself: each must be refused as out of its limits, with the number's name.
    """

    topic: str = choice(COMMANDS, "command or request of the contract")
    pause: float = quantity(
        "s", "between two messages: refusals of one topic are told ten times a second", 0.12,
        minimum=0.1, maximum=10.0,
    )  # fmt: skip
    within: float = quantity("s", "time for each refusal", 2.0, above=0.0, maximum=60.0)

    @property
    def duration(self) -> float:
        """How long it takes at least [s]."""
        return self.pause

    @property
    def may_move(self) -> bool:
        """Whether a machine could move by it."""
        return True

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return (topics.DIAGNOSTICS,)

    @property
    def judges(self) -> bool:
        """It is judged by itself."""
        return True

    def messages(self) -> list[tuple[str, dict[str, JointValue]]]:
        """Field and joints of each message that is sent."""
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
    """Values of a joint that its limits allow, as near to nothing as they let."""
    rows = TOPICS[topic].by_path
    fields = [rows[f"{joint}.{part}"] for part in PARTS]
    return JointValue(*(min(max(0.0, field.minimum), field.maximum) for field in fields))


@dataclass(frozen=True, kw_only=True)
class Call(Action):
    """Call a service of the contract; it is judged by itself: whether it answers as wanted."""

    service: str = choice(tuple(SERVICES), "service of the contract")
    data: bool | None = read_by(_read_data, (bool, type(None)), "true or false", None)
    success: bool = flag("what it should answer", True)
    within: float = quantity("s", "time for the answer", 5.0, above=0.0, maximum=60.0)

    @property
    def may_move(self) -> bool:
        """Whether a machine could move by it."""
        return self.service == topics.DRIVES_ARM and self.data is True

    @property
    def judges(self) -> bool:
        """It is judged by itself."""
        return True

    def check(self) -> None:
        """Refuse what no single key can show."""
        takes_data = SERVICES[self.service].service.endswith("SetBool")
        if takes_data and self.data is None:
            raise ConfigurationError("data", None, f"missing; {self.service} takes true or false")
        if not takes_data and self.data is not None:
            raise ConfigurationError("data", self.data, f"{self.service} takes none")


@dataclass(frozen=True, kw_only=True)
class SetParameter(Action):
    """Set a parameter of a node; it is put back when the step is over."""

    node: str = text("the node: drive_emulator")
    parameter: str = text("its parameter")
    value: str | float | int | bool = read_by(
        _read_scalar, (str, float, int, bool), "a single value"
    )
    keep: bool = flag("it stays set when the step is over")


def _read_impairments(value: object, path: str) -> tuple[Impairment, ...]:
    if not isinstance(value, list) or not value:
        raise ConfigurationError(path, value, "should be a list of impairments")
    made = []
    for index, each in enumerate(value):
        if not isinstance(each, Mapping):
            raise ConfigurationError(
                f"{path}[{index}]", each, "should be a mapping of what, on ..."
            )
        try:
            made.append(impairment_from(each))
        except ParameterError as error:
            raise ConfigurationError(f"{path}[{index}]", dict(each), str(error)) from None
    return tuple(made)


@dataclass(frozen=True, kw_only=True)
class Impair(Action):
    """Impair the link, devices or processes of an emulated machine, until the step is over."""

    these: tuple[Impairment, ...] = read_by(
        _read_impairments, (tuple,), "a list of impairments, as docs/hil.md has them"
    )

    @property
    def text(self) -> str:
        """As the emulator's parameter takes it."""
        return f"[{', '.join(map(str, self.these))}]"


@dataclass(frozen=True, kw_only=True)
class Ask(Action):
    """Have the operator do something by hand; what cannot be done leaves the step not run."""

    key: str = text("one word for it, for a program that acts as the operator's hands")
    what: str = text("what is to be done, as the operator reads it")


@dataclass(frozen=True, kw_only=True)
class Look(Action):
    """Have the operator judge something; it is judged by the answer."""

    key: str = text("one word for it, for a program that acts as the operator's hands")
    question: str = text("what is right if it is answered with yes")

    @property
    def judges(self) -> bool:
        """It is judged by itself."""
        return True


ACTIONS: Mapping[str, type[Action]] = {
    "wait": Wait,
    "mark": Mark,
    "publish": Publish,
    "beyond_limits": BeyondLimits,
    "call": Call,
    "set": SetParameter,
    "impair": Impair,
    "ask": Ask,
    "look": Look,
}
"""What may stand under `do`, by its word."""
