"""How the tether is led while the rover drives: held at a low tension by the winch. Pure.

The winch pays out and takes in by itself, at a tension that carries what hangs of the tether and a
margin more; it refuses less. It asks for renewal, so a rover whose controller has died is not
pulled for long. When the driving is over, it is asked for the length that is out, and so holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.machine import WINCH_AT_TENSION, WINCH_TO_LENGTH
from msg_schemas.parameters import parameter

_HOLD, _TENSION = "hold", "tension"  # modes of the winch
_FREE = frozenset({_HOLD, "length", "slack", _TENSION})
_STANDING = 1.0e-3  # a drum that is slower stands [m/s]
_TAUT = 0.4  # part of the margin with which the tether is taut, as a mean
_MEAN = 1.0  # over so long [s]


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
    """A request to the winch: the joint that it is about, and its values."""

    joint: str
    position: float
    velocity: float
    effort: float


class TetherCare:
    """Leads the tether.

    Args:
        parameters: how.
    """

    def __init__(self, parameters: TetherParameters) -> None:
        self.parameters = parameters
        self.mode = ""
        self.length = math.nan  # paid out at the drum [m]
        self.rate = 0.0  # of payout [m/s]
        self.tension = math.nan  # at the fairlead; NaN = not known [N]
        self.weight = 0.0  # of the tether that is out [N]
        self._leads = False
        self._since = 0.0
        self._sent = -math.inf
        self._had_it = False
        self._is_taken_up = False  # the tether was taut since the driving began
        self._pull = 0.0  # beyond the tether's weight, mean [N]
        self._pulls = self._slack = 0.0

    @property
    def is_taut(self) -> bool:
        """Whether the winch holds it at a tension, and it has it."""
        return self.mode == _TENSION and self._pull > _TAUT * self.parameters.tension_margin

    @property
    def holds(self) -> bool:
        """Whether the tether is led as it shall be, so that the rover may move."""
        if not self.parameters.uses_winch:
            return True
        return self._leads and self.mode == _TENSION and self._is_taken_up

    def on_mode(self, mode: str) -> None:
        """Take what the winch is doing."""
        self.mode = mode

    def on_estimate(self, length: float, rate: float, tension: float, weight: float) -> None:
        """Take what the winch makes of its sensors."""
        self.length, self.rate, self.tension, self.weight = length, rate, tension, weight

    def unready(self) -> str:
        """Why the winch cannot lead the tether; empty = it can."""
        if not self.parameters.uses_winch or self.mode in _FREE:
            return ""
        return f"the winch is in {self.mode or 'no known mode'}, it must be armed and hold"

    def step(self, now: float, h: float, *, leads: bool) -> TetherRequest | None:
        """What to ask of the winch now.

        Args:
            now: [s].
            h: since the last step [s].
            leads: whether the rover is to be driven.
        """
        p = self.parameters
        if not p.uses_winch:
            return None
        if leads and not self._leads:
            self._since, self._had_it, self._sent = now, False, -math.inf
            self._is_taken_up = False
            self._pulls = self._slack = 0.0
        self._leads = leads
        pull = self.tension - self.weight
        if math.isfinite(pull):
            self._pull += min(h / _MEAN, 1.0) * (pull - self._pull)
        self._pulls = self._pulls + h if pull > p.tension_limit else 0.0
        self._slack = self._slack + h if self._pull < 0.1 * p.tension_margin else 0.0
        self._had_it = leads and (self._had_it or self.mode == _TENSION)
        waited = now - self._since > p.take_up_timeout
        self._is_taken_up = leads and (self._is_taken_up or self.is_taut or waited)
        if now - self._sent < p.request_period:
            return None
        if leads and not self.trouble(now):
            self._sent = now
            return self._hold()
        stands = abs(self.rate) < _STANDING
        if not leads and self.mode == _TENSION and stands and math.isfinite(self.length):
            self._sent = now
            return TetherRequest(WINCH_TO_LENGTH, self.length, 0.0, 0.0)
        if not leads and self.mode == _TENSION:
            # The drum still moves; it is asked to hold its tension until it stands.
            self._sent = now
            return self._hold()
        return None

    def _hold(self) -> TetherRequest:
        p = self.parameters
        rate = p.follow_rate if self._is_taken_up else p.take_up_rate
        return TetherRequest(WINCH_AT_TENSION, 0.0, rate, self.weight + p.tension_margin)

    def trouble(self, now: float) -> str:
        """Why the rover must not go on; empty = it may."""
        p = self.parameters
        if not p.uses_winch or not self._leads:
            return ""
        if self._had_it and self.mode != _TENSION:
            return f"the winch has left its tension for {self.mode}, its events say why"
        if not self._had_it and now - self._since > p.request_timeout:
            return "the winch has not taken the request for a tension, its diagnostics say why"
        if self._pulls > p.tension_limit_time:
            return f"the tether pulls with {self.tension:.3g} N, it is held somewhere"
        if self._slack > p.slack_timeout:
            return f"the tether is slack ({self.tension:.3g} N) and the winch does not take it up"
        return ""
