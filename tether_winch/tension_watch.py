"""Watches the tether's tension by the load cell: slack, too much, or not known. Pure.

Thresholds are parts of a weight given by parameter, such as that of the rover where it
hangs. A change is believed when it has lasted for the hold time, and taken back only
beyond a margin (hysteresis), so that a bounce is no news.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.samples import Level, WrenchSample

_NANO = 1e9


class TensionState(StrEnum):
    """What the load cell says; the words of the contract."""

    UNKNOWN = "unknown"
    NORMAL = "normal"
    SLACK = "slack"
    OVER_TENSION = "over_tension"

    @property
    def level(self) -> Level:
        """How bad it is."""
        return {
            TensionState.UNKNOWN: Level.WARN,
            TensionState.OVER_TENSION: Level.ERROR,
        }.get(self, Level.OK)


@dataclass(frozen=True)
class TensionParameters:
    """Thresholds of the watch."""

    weight_reference: float = parameter(
        8.1, "N", "weight that the tether is to carry: 5 kg on the Moon", 1e-3, 5000.0
    )
    slack_below: float = parameter(
        0.5, "-", "below this part of the weight the tether is slack", 0.0, 1.0
    )
    over_above: float = parameter(
        4.0, "-", "above this part of the weight the tension is too high", 1.0, 100.0
    )
    hysteresis: float = parameter(
        0.1, "-", "part of the weight beyond the threshold that takes it back", 0.0, 0.9
    )
    hold_time: float = parameter(0.2, "s", "how long slack must last to be believed", 0.0, 10.0)
    over_hold_time: float = parameter(
        0.02, "s", "how long too much tension must last to be believed", 0.0, 10.0
    )
    silence: float = parameter(
        0.5, "s", "without a sample for this long the tension is not known", 0.05, 10.0
    )
    largest_force: float = parameter(
        5000.0, "N", "the load cell's range: a reading beyond is not valid", 1.0, 1e6
    )

    def __post_init__(self) -> None:
        """Refuse thresholds that leave nothing between them."""
        if self.slack_below + self.hysteresis >= self.over_above - self.hysteresis:
            msg = (
                f"slack_below is {self.slack_below:g} and over_above {self.over_above:g}, they "
                f"must be further apart than twice the hysteresis, {self.hysteresis:g}"
            )
            raise ParameterError(msg)


@dataclass(frozen=True)
class TensionChange:
    """A new state with its reason."""

    state: TensionState
    reason: str
    tension: float  # [N]; NaN = not known


class TensionWatch:
    """What to make of one load cell.

    Args:
        parameters: thresholds.
    """

    def __init__(self, parameters: TensionParameters) -> None:
        self.parameters = parameters
        self.state = TensionState.UNKNOWN
        self.tension = math.nan
        self._pending: tuple[TensionState, int] | None = None

    def hear(self, sample: WrenchSample, now_ns: int) -> TensionChange | None:
        """Take a sample of the load cell; returns the change that it makes.

        Args:
            sample: the load cell's.
            now_ns: the controller's clock.
        """
        tension = math.hypot(*sample.force)
        limit = self.parameters.largest_force
        if not tension <= limit:
            self.tension = math.nan
            reason = f"the load cell reads {tension:.4g} N, beyond its range of {limit:g} N"
            return self._change(TensionState.UNKNOWN, reason)
        self.tension = tension
        wanted = self._wanted(tension / self.parameters.weight_reference)
        if wanted is self.state:
            self._pending = None
            return None
        if self._pending is None or self._pending[0] is not wanted:
            self._pending = (wanted, now_ns)
        lasted = (now_ns - self._pending[1]) / _NANO
        if self.state is not TensionState.UNKNOWN and lasted < self._hold_time(wanted):
            return None
        return self._change(wanted, f"tension {tension:.4g} N")

    def check(self, silence: float) -> TensionChange | None:
        """Say how long the load cell has been silent [s]; returns the change that this makes."""
        if silence <= self.parameters.silence:
            return None
        self.tension = math.nan
        return self._change(
            TensionState.UNKNOWN, f"the load cell is silent for more than {silence:.2g} s"
        )

    def _wanted(self, ratio: float) -> TensionState:
        """State that a tension over the weight asks for, from the present state."""
        p = self.parameters
        slack_limit, over_limit = p.slack_below, p.over_above
        if self.state is TensionState.SLACK:
            slack_limit += p.hysteresis
        if self.state is TensionState.OVER_TENSION:
            over_limit -= p.hysteresis
        if ratio < slack_limit:
            return TensionState.SLACK
        if ratio > over_limit:
            return TensionState.OVER_TENSION
        return TensionState.NORMAL

    def _hold_time(self, wanted: TensionState) -> float:
        if wanted is TensionState.OVER_TENSION:
            return self.parameters.over_hold_time
        return self.parameters.hold_time

    def _change(self, state: TensionState, reason: str) -> TensionChange | None:
        self._pending = None
        if state is self.state:
            return None
        self.state = state
        return TensionChange(state, reason, self.tension)
