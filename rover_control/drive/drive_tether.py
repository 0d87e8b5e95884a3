"""Tether control while the rover drives: the winch holds a low tension. Pure.

The winch pays out and reels in by itself to hold a tension of the paid-out tether's weight plus a
margin. The request must be renewed, so that the winch stops if the drive controller dies. When the
drive ends, the controller requests the present length, which the winch then holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.parameters import parameter
from msg_schemas.phases import WinchMode

_FREE = frozenset({WinchMode.HOLD, WinchMode.LENGTH, WinchMode.SLACK, WinchMode.TENSION})
_STANDING = 1.0e-3  # drum speed below which the drum is at rest [m/s]
_TAUT = 0.4  # fraction of the margin above which the tether is taut, on average
_MEAN = 1.0  # averaging time of the tension [s]


@dataclass(frozen=True)
class TetherParameters:
    """Tension of the tether while the rover drives, and time limits of the winch."""

    tension_margin: float = parameter(
        0.8, "N", "tension setpoint above the weight of the paid-out tether", 0.0, 100.0
    )
    tension_limit: float = parameter(
        3.0, "N", "tension above that weight at which the rover stops", 0.1, 1e3
    )
    tension_limit_time: float = parameter(
        1.0, "s", "time above it after which the rover stops", 0.0, 60.0
    )
    slack_timeout: float = parameter(
        60.0, "s", "time with a slack tether after which the drive fails", 0.1, 600.0
    )
    take_up_rate: float = parameter(
        0.04, "m/s", "winch rate at which slack is taken up before the rover moves", 1e-3, 0.5
    )
    follow_rate: float = parameter(
        0.2, "m/s", "largest winch rate while the rover moves", 1e-3, 0.5
    )
    take_up_timeout: float = parameter(
        20.0, "s", "time for taking up slack, after which the rover moves anyway", 0.0, 600.0
    )
    request_period: float = parameter(
        0.25, "s", "period at which the winch request is renewed", 0.02, 1.0
    )
    request_timeout: float = parameter(
        3.0, "s", "time in which the winch must enter the mode tension", 0.1, 60.0
    )
    max_tether_length: float = parameter(
        58.0, "m", "longest length that the winch can pay out", 1.0, 1e3
    )
    uses_winch: bool = parameter(True, "-", "false: drive_node sends the winch no requests")


class TetherRequest(NamedTuple):
    """A request to the winch: joint and values."""

    joint: str
    position: float
    velocity: float
    effort: float


class TetherControl:
    """Requests tension while the rover drives, and a length afterwards.

    Args:
        parameters: tensions and time limits.
    """

    def __init__(self, parameters: TetherParameters) -> None:
        self.parameters = parameters
        self.mode = ""
        self.length = math.nan  # paid-out length at the drum [m]
        self.rate = 0.0  # payout rate [m/s]
        self.tension = math.nan  # at the fairlead; NaN = unknown [N]
        self.weight = 0.0  # of the paid-out tether [N]
        self._is_leading = False
        self._since = 0.0
        self._sent_at = -math.inf
        self._held_tension = False
        self._is_tensioned = False  # whether the tether has been taut since the drive began
        self._mean_pull = 0.0  # mean tension beyond the tether's weight [N]
        self._over_tension_time = self._slack_time = 0.0

    @property
    def is_taut(self) -> bool:
        """Whether the winch controls the tension and the tether is taut."""
        return (
            self.mode == WinchMode.TENSION
            and self._mean_pull > _TAUT * self.parameters.tension_margin
        )

    @property
    def is_ready(self) -> bool:
        """Whether the tether is under control, so that the rover may move."""
        if not self.parameters.uses_winch:
            return True
        return self._is_leading and self.mode == WinchMode.TENSION and self._is_tensioned

    def on_mode(self, mode: str) -> None:
        """Process the winch mode."""
        self.mode = mode

    def on_estimate(self, length: float, rate: float, tension: float, weight: float) -> None:
        """Process the winch estimate."""
        self.length, self.rate, self.tension, self.weight = length, rate, tension, weight

    def not_ready_reason(self) -> str:
        """Why the winch cannot control the tension; empty = ready."""
        if not self.parameters.uses_winch or self.mode in _FREE:
            return ""
        return f"the winch is in {self.mode or 'an unknown mode'}; arm it ({topics.WINCH_REARM})"

    def step(self, now: float, h: float, *, is_driving: bool) -> TetherRequest | None:
        """Advance by h; returns the winch request to send, or None.

        Args:
            now: time [s].
            h: time since the last step [s].
            is_driving: whether the rover is driving.
        """
        p = self.parameters
        if not p.uses_winch:
            return None
        if is_driving and not self._is_leading:
            self._since, self._held_tension, self._sent_at = now, False, -math.inf
            self._is_tensioned = False
            self._over_tension_time = self._slack_time = 0.0
        self._is_leading = is_driving
        force = self.tension - self.weight
        if math.isfinite(force):
            self._mean_pull += min(h / _MEAN, 1.0) * (force - self._mean_pull)
        self._over_tension_time = self._over_tension_time + h if force > p.tension_limit else 0.0
        self._slack_time = self._slack_time + h if self._mean_pull < 0.1 * p.tension_margin else 0.0
        self._held_tension = is_driving and (self._held_tension or self.mode == WinchMode.TENSION)
        waited = now - self._since > p.take_up_timeout
        self._is_tensioned = is_driving and (self._is_tensioned or self.is_taut or waited)
        if now - self._sent_at < p.request_period:
            return None
        if is_driving and not self.fault_reason(now):
            self._sent_at = now
            return self._hold()
        is_still = abs(self.rate) < _STANDING
        if (
            not is_driving
            and self.mode == WinchMode.TENSION
            and is_still
            and math.isfinite(self.length)
        ):
            self._sent_at = now
            return TetherRequest(machine.WINCH_TO_LENGTH, self.length, 0.0, 0.0)
        if not is_driving and self.mode == WinchMode.TENSION:
            # The drum still moves: keep the tension mode until it is at rest.
            self._sent_at = now
            return self._hold()
        return None

    def _hold(self) -> TetherRequest:
        p = self.parameters
        rate = p.follow_rate if self._is_tensioned else p.take_up_rate
        return TetherRequest(machine.WINCH_AT_TENSION, 0.0, rate, self.weight + p.tension_margin)

    def fault_reason(self, now: float) -> str:
        """Why the rover must stop; empty = no fault."""
        p = self.parameters
        if not p.uses_winch or not self._is_leading:
            return ""
        if self._held_tension and self.mode != WinchMode.TENSION:
            return f"the winch left mode tension for {self.mode}; see its events"
        if not self._held_tension and now - self._since > p.request_timeout:
            return (
                f"the winch did not enter mode tension within {p.request_timeout:g} s; see its "
                "diagnostics"
            )
        if self._over_tension_time > p.tension_limit_time:
            return (
                f"the tether tension is {self.tension:.3g} N, limit "
                f"{self.weight + p.tension_limit:.3g} N: the tether may be snagged"
            )
        if self._slack_time > p.slack_timeout:
            return (
                f"the tether is slack ({self.tension:.3g} N) for {p.slack_timeout:g} s and the "
                "winch does not take it up"
            )
        return ""
