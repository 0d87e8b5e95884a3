"""What ends every motion of the winch, whoever asked for it. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from msg_schemas.parameters import parameter
from tether_winch.load_watch import LoadState


class Fault(StrEnum):
    """Why the winch has braked and stays so until it is armed again."""

    COMMAND_TIMEOUT = "command_timeout"
    DRUM_LOST = "drum_lost"
    TENSION_LOST = "tension_lost"
    OVERSPEED = "overspeed"
    OVER_TENSION = "over_tension"
    TETHER_END = "tether_end"
    NOT_FOLLOWING = "not_following"
    BRAKE_STUCK = "brake_stuck"
    OVERHEATED = "overheated"
    BAD_READING = "bad_reading"
    CLOCK_JUMP = "clock_jump"
    NODE_LATE = "node_late"

    @property
    def comes_to_rest_first(self) -> bool:
        """Whether the drum is sound, so that it may slow down before the brake closes."""
        return self is Fault.COMMAND_TIMEOUT


@dataclass(frozen=True)
class GuardParameters:
    """Limits beyond which the winch brakes and latches a fault until it is armed again."""

    command_timeout: float = parameter(
        1.0, "s", "time without renewal after which a rate or tension request times out", 0.1, 60.0
    )
    tension_timeout: float = parameter(
        0.2, "s", "time without a valid tension after which a motion ends", 0.02, 10.0
    )
    load_cell_required: bool = parameter(
        True, "-", "false: without the load cell the tension comes from the motor current"
    )
    overspeed_margin: float = parameter(
        0.1, "m/s", "excess over largest_rate plus trim_rate that is an overspeed", 0.01, 5.0
    )
    overspeed_time: float = parameter(0.03, "s", "time for which the overspeed must last", 0.0, 1.0)
    stall_timeout: float = parameter(
        2.0, "s", "longest time for which the drum may lag behind its reference", 0.1, 60.0
    )
    brake_release_timeout: float = parameter(
        0.6, "s", "time within which the brake must open", 0.05, 10.0
    )
    max_step_delay: float = parameter(
        0.25, "s", "longest delay of a control step while the drum moves", 0.02, 5.0
    )


class Watched(NamedTuple):
    """What the guard looks at."""

    drum_fault: str  # why length and rate are not known; empty = they are
    tension: float  # [N]; NaN = not known
    tension_fault: str  # why it is not
    load: LoadState
    length: float  # [m]
    rate: float  # [m/s]
    is_moving: bool  # the brake is open, or about to be
    waits: bool  # the drum lags behind
    brake_wait: float  # how long the brake has been asked to open [s]
    feed_forward: float  # tension that the motor is to carry [N]
    allowed: float  # tension that the motor may use without overheating [N]
    ends: tuple[float, float]  # hard ends [m]
    largest_rate: float  # that may be commanded, trim included [m/s]
    tension_needed: bool  # this motion needs to know the tension


class Guard:
    """Looks for reasons to brake.

    Args:
        parameters: when a motion is ended.
    """

    def __init__(self, parameters: GuardParameters) -> None:
        self.parameters = parameters
        self._since: dict[Fault, float] = {}

    def find(self, seen: Watched, now: float) -> tuple[Fault, str] | None:
        """The first reason to brake, with what was found; None = there is none.

        Args:
            seen: what is known.
            now: controller's clock [s].
        """
        p = self.parameters
        if seen.drum_fault:
            return Fault.DRUM_LOST, seen.drum_fault
        if seen.load is LoadState.OVER_TENSION:
            return Fault.OVER_TENSION, f"the tension is too high: {seen.tension:.4g} N"
        limit = seen.largest_rate + p.overspeed_margin
        if self._lasts(Fault.OVERSPEED, abs(seen.rate) > limit, p.overspeed_time, now):
            reason = f"the drum runs at {seen.rate:.3g} m/s, it may run at {limit:.3g} m/s at most"
            return Fault.OVERSPEED, reason
        low, high = seen.ends
        if (seen.length >= high and seen.rate > 1e-3) or (seen.length <= low and seen.rate < -1e-3):
            return Fault.TETHER_END, (
                f"{seen.length:.4g} m are out, the ends are {low:g} and {high:g} m"
            )
        lost = seen.is_moving and seen.tension_needed and math.isnan(seen.tension)
        if self._lasts(Fault.TENSION_LOST, lost, p.tension_timeout, now):
            return Fault.TENSION_LOST, f"moving without a valid tension: {seen.tension_fault}"
        if self._lasts(Fault.NOT_FOLLOWING, seen.waits, p.stall_timeout, now):
            reason = f"the drum lags behind its reference for {p.stall_timeout:g} s"
            return Fault.NOT_FOLLOWING, reason
        if seen.brake_wait > p.brake_release_timeout:
            return Fault.BRAKE_STUCK, f"the brake did not open within {p.brake_release_timeout:g} s"
        if seen.is_moving and seen.feed_forward > seen.allowed:
            return Fault.OVERHEATED, (
                f"the motor is hot and may use {seen.allowed:.4g} N, carrying the load takes "
                f"{seen.feed_forward:.4g} N"
            )
        return None

    def forget(self) -> None:
        """Start all timers anew."""
        self._since.clear()

    def _lasts(self, fault: Fault, holds: bool, time: float, now: float) -> bool:
        if not holds:
            self._since.pop(fault, None)
            return False
        return now - self._since.setdefault(fault, now) >= time
