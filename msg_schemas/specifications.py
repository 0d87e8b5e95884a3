"""Classes of the contract's specifications: topics, services, fields, stale policies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import StrEnum
from functools import cached_property
from math import inf

from msg_schemas.described import Described
from msg_schemas.samples import SAMPLE_TYPES, JointSample, JointValue, Sample


class Intent(StrEnum):
    """Purpose of a topic; it determines the quality of service."""

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
    """Reaction to late, early and missing messages.

    Attributes:
        max_age: largest accepted age on arrival [s]; inf = any age.
        max_lead: largest accepted lead of the stamp [s].
        unstamped: reaction to a zero stamp.
        timeout: longest time without an accepted message [s].
        on_timeout: description of the reaction after it.
        timeout_moving: as ``timeout``, for a moving drive [s].
        on_timeout_moving: description of the reaction after it.
    """

    max_age: float = inf
    max_lead: float = inf
    unstamped: Unstamped = Unstamped.NOW
    timeout: float = inf
    on_timeout: str = "nothing"
    timeout_moving: float = inf
    on_timeout_moving: str = "nothing"


@dataclass(frozen=True)
class Topic:
    """Specification of a topic.

    Attributes:
        rate: of publication [Hz]; None = on change.
        fields: the numbers of a message with units and limits.
        joints: names that a joint message holds, each once.
        optional_joints: further names, of parts that a machine may lack.
        one_joint: a message names exactly one of ``joints``.
        words: texts that are allowed; empty = any.
        owned: what a command source owns while it commands, on all topics that name it: a motor,
            or the trim of the winch; commands of other sources are refused. Empty = nothing.
        spatial_only: concerns parts that the planar plant lacks.
    """

    name: str
    about: str
    message: str
    intent: Intent
    _: KW_ONLY
    rate: float | None = None
    frame: str = ""
    child_frame: str = ""
    fields: tuple[Field, ...] = ()
    joints: tuple[str, ...] = ()
    optional_joints: tuple[str, ...] = ()
    one_joint: bool = False
    words: tuple[Described, ...] = ()
    is_json: bool = False
    stale: StalePolicy = field(default_factory=StalePolicy)
    audience: Audience = Audience.ALL
    owned: str = ""
    spatial_only: bool = False

    @cached_property
    def by_path(self) -> Mapping[str, Field]:
        """Fields by their path."""
        return {item.path: item for item in self.fields}

    # Computed once, for each message asks: Python 3.11 finds an enumeration's member slowly.

    @cached_property
    def sample(self) -> type[Sample]:
        """Class of the samples."""
        return SAMPLE_TYPES[self.message]

    @cached_property
    def is_command(self) -> bool:
        """Whether the messages are commands."""
        return self.intent is Intent.COMMAND

    @cached_property
    def is_latched(self) -> bool:
        """Whether late joiners process the last message."""
        return self.intent is Intent.LATCHED

    @cached_property
    def _joint_limits(self) -> Mapping[str, tuple[tuple[float, float], ...]]:
        """Smallest and largest position, velocity and effort by joint."""
        return {
            name: tuple(
                (row.minimum, row.maximum)
                for row in (self.by_path[f"{name}.{part}"] for part in JointValue._fields)
            )
            for name in (*self.joints, *self.optional_joints)
        }

    def saturated(self, stamp_ns: int, joints: Mapping[str, JointValue]) -> JointSample:
        """Return the sample of a sensor that saturates at the limits of the fields."""
        return JointSample(
            stamp_ns,
            {
                name: JointValue(
                    *(
                        min(max(number, low), high)
                        for number, (low, high) in zip(value, self._joint_limits[name], strict=True)
                    )
                )
                for name, value in joints.items()
            },
        )


TRIGGER = "std_srvs/srv/Trigger"
SET_BOOL = "std_srvs/srv/SetBool"


@dataclass(frozen=True)
class Service:
    """Specification of a service."""

    name: str
    about: str
    service: str


# --- groups of fields that many rows share ------------------------------------------------------

Entry = tuple[str, str, float, float]
"""Unit, meaning, smallest and largest value of one number."""

UNUSED: Entry = ("-", "not used, 0", 0.0, 0.0)

JointRow = tuple[str, *tuple[Entry, ...]]
"""A joint with the entries of its position, velocity and effort; the last ones may be unused."""


def joint_fields(
    name: str,
    position: Entry = UNUSED,
    velocity: Entry = UNUSED,
    effort: Entry = UNUSED,
    *,
    defaults: tuple[float | None, float | None, float | None] = (None, None, None),
) -> tuple[Field, ...]:
    """Return the three fields of one joint."""
    parts = zip(
        ("position", "velocity", "effort"), (position, velocity, effort), defaults, strict=True
    )
    return tuple(
        Field(f"{name}.{part}", unit, about, low, high, default)
        for part, (unit, about, low, high), default in parts
    )


def scalar_fields(unit: str, **about: str) -> tuple[Field, ...]:
    """Return the fields of named scalars: joints that use only their position."""
    rows: tuple[Field, ...] = ()
    for name, text in about.items():
        rows += joint_fields(name, (unit, text, -inf, inf))
    return rows


def axis_fields(
    prefix: str, unit: str, about: str, limit: float = inf, axes: str = "xyz"
) -> tuple[Field, ...]:
    """Return one field for each axis of a vector or quaternion."""
    return tuple(
        Field(f"{prefix}.{axis}", unit, f"{about}, {axis}", -limit, limit) for axis in axes
    )
