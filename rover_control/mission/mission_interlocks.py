"""Interlocks of the mission: conditions that forbid an action, and services that clear them. Pure.

The mission sends no request that `INTERLOCKS` forbids at that time. If `remedy` names a service,
the mission calls it first; otherwise it waits, up to the time limit of the leg.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from types import MappingProxyType

from msg_schemas import topics
from msg_schemas.phases import DescentPhase, JumpPhase, WinchMode
from rover_control.mission.observed_state import ObservedState

MAX_JUMP_TENSION = 2.0
"""Net tether tension [N] above which the rover does not jump."""


class RequestedAction(StrEnum):
    """Action that a request starts."""

    DESCEND = "travel or turn under descent control"
    LOWER = "pay out until touchdown"
    LIFT = "reel in a standing rover"
    DRIVE = "drive"
    SLACKEN = "give slack"
    JUMP = "jump"
    STOW = "release the actuators at the stow"


class Condition(StrEnum):
    """Condition that forbids an action."""

    WINCH_STALE = "the winch estimate is missing or stale"
    DRIVE_STALE = "the rover's pose is missing or stale"
    STOPPED = "the winch was stopped by an operator"
    FAULT = "the winch is in a fault"
    UNARMED = "the winch is not armed"
    FLYING = "a jump is in progress"
    JUMP_FAULT = "the jump controller is in a fault"
    COMPRESSED = "the spring may be compressed"
    DRIVING = "the rover is driving"
    DESCENT = "the descent controller holds winch and wheels"
    STANDING = "the rover stands on the floor"
    HANGING = "the rover hangs"
    TAUT = "the tether is taut"


_ALWAYS = (
    Condition.WINCH_STALE,
    Condition.STOPPED,
    Condition.FAULT,
    Condition.UNARMED,
    Condition.FLYING,
    Condition.JUMP_FAULT,
    Condition.COMPRESSED,
)

INTERLOCKS: Mapping[RequestedAction, tuple[Condition, ...]] = MappingProxyType(
    {
        RequestedAction.DESCEND: (*_ALWAYS, Condition.DRIVING, Condition.STANDING),
        RequestedAction.LOWER: (*_ALWAYS, Condition.DRIVING, Condition.DESCENT),
        RequestedAction.LIFT: (*_ALWAYS, Condition.DRIVING, Condition.DESCENT),
        RequestedAction.DRIVE: (
            *_ALWAYS, Condition.DRIVE_STALE, Condition.DESCENT, Condition.HANGING,
        ),
        RequestedAction.SLACKEN: (
            *_ALWAYS, Condition.DRIVING, Condition.DESCENT, Condition.HANGING,
        ),
        RequestedAction.JUMP: (
            *_ALWAYS, Condition.DRIVING, Condition.DESCENT, Condition.HANGING, Condition.TAUT,
        ),
        RequestedAction.STOW: (Condition.WINCH_STALE, Condition.FLYING, Condition.COMPRESSED),
    }
)  # fmt: skip
"""Conditions that forbid each action, in the order in which they are cleared."""

_PREDICATES: Mapping[Condition, Callable[[ObservedState, float], bool]] = {
    Condition.WINCH_STALE: lambda observed, now: observed.is_stale(topics.WINCH_ESTIMATE, now),
    Condition.DRIVE_STALE: lambda observed, now: observed.is_stale(topics.POSE, now),
    Condition.STOPPED: lambda observed, _: observed.winch == WinchMode.STOP,
    Condition.FAULT: lambda observed, _: observed.winch == WinchMode.FAULT,
    Condition.UNARMED: lambda observed, _: observed.winch in ("", WinchMode.DISARMED),
    Condition.FLYING: lambda observed, _: observed.in_flight,
    Condition.JUMP_FAULT: lambda observed, _: observed.jump == JumpPhase.FAULT,
    Condition.COMPRESSED: lambda observed, _: observed.spring_compressed,
    Condition.DRIVING: lambda observed, _: observed.is_driving,
    Condition.DESCENT: lambda observed, _: observed.descent_engaged,
    Condition.STANDING: lambda observed, _: observed.on_floor,
    Condition.HANGING: lambda observed, _: not observed.on_floor,
    # An unknown tension counts as taut.
    Condition.TAUT: lambda observed, _: not observed.net_tension <= MAX_JUMP_TENSION,
}


def applies(condition: Condition, observed: ObservedState, now: float) -> bool:
    """Whether a condition applies at a time [s]."""
    return _PREDICATES[condition](observed, now)


def violated_interlock(
    action: RequestedAction, observed: ObservedState, now: float
) -> Condition | None:
    """The first condition that forbids an action at a time [s]; None = allowed."""
    return next((each for each in INTERLOCKS[action] if applies(each, observed, now)), None)


def remedy(condition: Condition, observed: ObservedState) -> str:
    """The service that clears a condition; empty = wait for time or an operator."""
    if condition in (Condition.UNARMED, Condition.FAULT):
        return topics.WINCH_REARM
    if condition is Condition.JUMP_FAULT:
        return topics.JUMP_ABORT
    if condition is Condition.COMPRESSED:
        # Another command source may be compressing the spring; letting it down takes time.
        return "" if observed.jump == JumpPhase.LETTING_DOWN else topics.JUMP_ABORT
    if condition is Condition.DRIVING:
        return topics.DRIVE_STOP
    if condition is Condition.DESCENT:
        idle = observed.descent == DescentPhase.STANDBY
        return topics.DESCENT_RELEASE if idle else topics.DESCENT_ABORT
    return ""
