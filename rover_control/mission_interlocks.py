"""What must not be while the mission moves something, and what clears it. Pure.

The mission asks for nothing that `INTERLOCKS` forbids at the time. Where `remedy` names a service,
it calls that first; where there is none, it waits, and its leg ends by its time limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from types import MappingProxyType

from msg_schemas import topics
from rover_control.observed_state import ObservedState

TAUT = 2.0
"""Pull [N] of the rover on the tether from which on it does not jump."""


class Action(StrEnum):
    """What the mission asks for."""

    DESCEND = "descend, ascend or turn, swing and attitude under control"
    LOWER = "pay out until the floor carries the rover"
    LIFT = "reel in a rover that stands"
    DRIVE = "drive"
    SLACKEN = "give slack"
    JUMP = "jump"
    STOW = "give the drives back"


class Condition(StrEnum):
    """What may forbid it."""

    WINCH_SILENT = "the winch is not heard"
    DRIVE_SILENT = "the driving is not heard"
    STOPPED = "the winch was stopped"
    FAULT = "the winch is in a fault"
    UNARMED = "the winch is not armed"
    FLYING = "the rover flies, or comes to rest after a jump"
    JUMP_FAULT = "the jump is in a fault"
    COMPRESSED = "the latch may hold the spring"
    DRIVING = "the rover is driven"
    DESCENT = "the descent has winch and wheels"
    STANDING = "the rover stands on the floor"
    HANGING = "the rover hangs"
    TAUT = "the tether pulls"


_ALWAYS = (
    Condition.WINCH_SILENT,
    Condition.STOPPED,
    Condition.FAULT,
    Condition.UNARMED,
    Condition.FLYING,
    Condition.JUMP_FAULT,
    Condition.COMPRESSED,
)

INTERLOCKS: Mapping[Action, tuple[Condition, ...]] = MappingProxyType(
    {
        Action.DESCEND: (*_ALWAYS, Condition.DRIVING, Condition.STANDING),
        Action.LOWER: (*_ALWAYS, Condition.DRIVING, Condition.DESCENT),
        Action.LIFT: (*_ALWAYS, Condition.DRIVING, Condition.DESCENT),
        Action.DRIVE: (*_ALWAYS, Condition.DRIVE_SILENT, Condition.DESCENT, Condition.HANGING),
        Action.SLACKEN: (*_ALWAYS, Condition.DRIVING, Condition.DESCENT, Condition.HANGING),
        Action.JUMP: (
            *_ALWAYS, Condition.DRIVING, Condition.DESCENT, Condition.HANGING, Condition.TAUT,
        ),
        Action.STOW: (Condition.WINCH_SILENT, Condition.FLYING, Condition.COMPRESSED),
    }
)  # fmt: skip
"""What forbids each act; what stands first is cleared first."""

_HOLDS: Mapping[Condition, Callable[[ObservedState, float], bool]] = {
    Condition.WINCH_SILENT: lambda observed, now: observed.is_stale(topics.WINCH_ESTIMATE, now),
    Condition.DRIVE_SILENT: lambda observed, now: observed.is_stale(topics.ODOMETRY, now),
    Condition.STOPPED: lambda observed, _: observed.winch == "stop",
    Condition.FAULT: lambda observed, _: observed.winch == "fault",
    Condition.UNARMED: lambda observed, _: observed.winch in ("", "disarmed"),
    Condition.FLYING: lambda observed, _: observed.in_flight,
    Condition.JUMP_FAULT: lambda observed, _: observed.jump == "fault",
    Condition.COMPRESSED: lambda observed, _: observed.spring_compressed,
    Condition.DRIVING: lambda observed, _: observed.is_driving,
    Condition.DESCENT: lambda observed, _: observed.descent_engaged,
    Condition.STANDING: lambda observed, _: observed.on_floor,
    Condition.HANGING: lambda observed, _: not observed.on_floor,
    # A tension that is not known may be any.
    Condition.TAUT: lambda observed, _: not observed.net_tension <= TAUT,
}


def applies(condition: Condition, observed: ObservedState, now: float) -> bool:
    """Whether something is so now [s]."""
    return _HOLDS[condition](observed, now)


def violated_interlock(action: Action, observed: ObservedState, now: float) -> Condition | None:
    """The first that forbids an act now [s]; None = it may be."""
    return next((each for each in INTERLOCKS[action] if applies(each, observed, now)), None)


def remedy(condition: Condition, observed: ObservedState) -> str:
    """The service that clears it; empty = nothing but time, or people, do."""
    if condition in (Condition.UNARMED, Condition.FAULT):
        return topics.WINCH_REARM
    if condition is Condition.JUMP_FAULT:
        return topics.JUMP_ABORT
    if condition is Condition.COMPRESSED:
        # What is being compressed for somebody is his; what is let down takes its time.
        return "" if observed.jump == "letting_down" else topics.JUMP_ABORT
    if condition is Condition.DRIVING:
        return topics.DRIVE_STOP
    if condition is Condition.DESCENT:
        idle = observed.descent == "standby"
        return topics.DESCENT_RELEASE if idle else topics.DESCENT_ABORT
    return ""
