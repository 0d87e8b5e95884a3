"""Fault detection of the winch. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.faults import WinchFault
from msg_schemas.parameters import parameter
from msg_schemas.phases import LoadState


@dataclass(frozen=True)
class FaultParameters:
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


class FaultInputs(NamedTuple):
    """State that the fault monitor checks."""

    drum_fault: str  # why length and rate are unknown; empty = known
    tension: float  # [N]; NaN = not known
    tension_fault: str  # why it is unknown
    load: LoadState
    length: float  # [m]
    rate: float  # [m/s]
    is_moving: bool  # the brake is open or opening
    is_lagging: bool  # the drum lags behind its reference
    brake_opening_time: float  # time since the brake was commanded to open [s]
    feed_forward: float  # motor tension [N]
    allowed: float  # motor tension allowed by the thermal model [N]
    ends: tuple[float, float]  # hard ends [m]
    largest_rate: float  # largest commanded rate, trim included [m/s]
    tension_required: bool  # this motion requires a valid tension


class FaultMonitor:
    """Detects faults.

    Args:
        parameters: limits.
    """

    def __init__(self, parameters: FaultParameters) -> None:
        self.parameters = parameters
        self._since: dict[WinchFault, float] = {}

    def check(self, inputs: FaultInputs, now: float) -> tuple[WinchFault, str] | None:
        """Return the first fault with its reason; None = no fault.

        Args:
            inputs: state to check.
            now: controller's clock [s].
        """
        return next(self._faults(inputs, now), None)

    def _faults(self, inputs: FaultInputs, now: float) -> Iterator[tuple[WinchFault, str]]:
        p = self.parameters
        if inputs.drum_fault:
            yield WinchFault.DRUM_LOST, inputs.drum_fault
        if inputs.load is LoadState.OVER_TENSION:
            yield WinchFault.OVER_TENSION, f"the tension is too high: {inputs.tension:.4g} N"
        limit = inputs.largest_rate + p.overspeed_margin
        if self._lasts(WinchFault.OVERSPEED, abs(inputs.rate) > limit, p.overspeed_time, now):
            reason = (
                f"the drum runs at {inputs.rate:.3g} m/s, it may run at {limit:.3g} m/s at most"
            )
            yield WinchFault.OVERSPEED, reason
        low, high = inputs.ends
        if (inputs.length >= high and inputs.rate > 1e-3) or (
            inputs.length <= low and inputs.rate < -1e-3
        ):
            yield (
                WinchFault.TETHER_END,
                (f"{inputs.length:.4g} m are out, the ends are {low:g} and {high:g} m"),
            )
        lost = inputs.is_moving and inputs.tension_required and math.isnan(inputs.tension)
        if self._lasts(WinchFault.TENSION_LOST, lost, p.tension_timeout, now):
            yield (
                WinchFault.TENSION_LOST,
                (f"moving without a valid tension: {inputs.tension_fault}"),
            )
        if self._lasts(WinchFault.NOT_FOLLOWING, inputs.is_lagging, p.stall_timeout, now):
            reason = f"the drum lags behind its reference for {p.stall_timeout:g} s"
            yield WinchFault.NOT_FOLLOWING, reason
        if inputs.brake_opening_time > p.brake_release_timeout:
            yield (
                WinchFault.BRAKE_STUCK,
                (f"the brake did not open within {p.brake_release_timeout:g} s"),
            )
        if inputs.is_moving and inputs.feed_forward > inputs.allowed:
            yield (
                WinchFault.OVERHEATED,
                (
                    f"the motor is hot and may use {inputs.allowed:.4g} N, carrying the load takes "
                    f"{inputs.feed_forward:.4g} N"
                ),
            )

    def reset(self) -> None:
        """Reset all timers."""
        self._since.clear()

    def _lasts(self, fault: WinchFault, holds: bool, time: float, now: float) -> bool:
        if not holds:
            self._since.pop(fault, None)
            return False
        return now - self._since.setdefault(fault, now) >= time
