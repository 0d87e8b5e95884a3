"""Driving the nut clear of the latch, so that its motor can be a reaction wheel. Pure."""

from __future__ import annotations

import math

from msg_schemas.events import DescentEvent, EventReport
from rover_control.hanging.descent_settings import DescentSettings

_CLEAR_FRACTION = 0.2  # fraction of the travel about its middle in which the nut is clear


class NutClearing:
    """Judges where the nut is, and drives it clear of the latch.

    Args:
        settings: of the descent.
        changes: list that receives the events.
    """

    def __init__(self, settings: DescentSettings, changes: list[EventReport]) -> None:
        self.settings = settings
        self.screw = math.nan  # screw angle [rad]
        self._changes = changes
        self._since: float | None = None  # start of driving the nut clear [s]

    @property
    def _lead_per_radian(self) -> float:
        """Lead of the screw [m/rad]."""
        return self.settings.descent.screw_lead / math.tau

    @property
    def position(self) -> float:
        """Position of the nut [m]; NaN before the first sample of the screw."""
        return self.screw * self._lead_per_radian

    def restart(self) -> None:
        """Let the next step judge anew whether the nut is clear."""
        self._since = None

    def step(self, now: float) -> float | None:
        """Return the nut position [m] that frees its motor as a reaction wheel; None = it is clear.

        Args:
            now: [s].
        """
        rotors = self.settings.hanging_controller.rotors
        away = abs(self.screw - rotors.screw_travel_centre)
        if self._since is None and not away > rotors.screw_travel:
            return None
        if self._since is None:
            self._since = now
            text = "driving the nut clear of the latch"
            self._changes.append(EventReport(DescentEvent.NUT_CLEARING_STARTED, text))
        if away < _CLEAR_FRACTION * rotors.screw_travel:
            self._since = None
            text = "the jump motor now is a reaction wheel"
            self._changes.append(EventReport(DescentEvent.NUT_CLEARING_COMPLETED, text))
            return None
        return rotors.screw_travel_centre * self._lead_per_radian

    def overdue(self, now: float) -> str:
        """Report at a time [s] that the nut is not clear in time; empty = not overdue.

        After a report the time starts anew.
        """
        timeout = self.settings.descent.nut_timeout
        if self._since is None or not now - self._since > timeout:
            return ""
        self._since = now
        return f"the nut is not clear of the latch after {timeout:g} s"
