"""What a controller asks of the winch from another process: sent, renewed, and watched. Pure.

A length is asked for with a request that must be renewed: a winch whose controller has died comes
to rest by itself. The other way round, a winch that does not do what it was asked has been taken
away, by an operator or by itself, and is not asked again before somebody says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.parameters import parameter
from msg_schemas.table import TOPICS
from rover_control.hanging_controller import WinchRequest

HOLD = "hold"
"""Mode of a winch that is_at_rest."""
_LENGTH = "length"
FREE = frozenset({HOLD, _LENGTH})
"""Modes in which nobody else moves the winch."""
# A winch that is trimmed does not come to rest by itself before the trim has been silent so long.
_TRIM_TIMEOUT = 0.8 * TOPICS[topics.WINCH_TRIM].stale.timeout  # [s]


@dataclass(frozen=True)
class WinchLinkParameters:
    """Timing of requests to the winch."""

    renewal_period: float = parameter(0.25, "s", "period of a request's renewals", 0.02, 10.0)
    winch_response_timeout: float = parameter(
        2.0, "s", "time within which the winch must accept a length request", 0.1, 60.0
    )
    winch_rest_timeout: float = parameter(
        0.3,
        "s",
        "rest of the winch during a motion after which it counts as stopped by others",
        0.02,
        10.0,
    )


class WinchLink:
    """One request at a time.

    Args:
        parameters: patience.
        length_tolerance: so length_tolerance is at a length [m].
    """

    def __init__(self, parameters: WinchLinkParameters, length_tolerance: float) -> None:
        self.parameters = parameters
        self.length_tolerance = length_tolerance
        self.mode = ""
        self._mode_since = -math.inf
        self.clear()

    def clear(self) -> None:
        """Forget what was asked: it is not renewed any more."""
        self._request: WinchRequest | None = None
        self._sent_at = -math.inf
        self._requested_at: float | None = None  # when this motion was asked for first
        self._is_accepted = False
        self._moves = False
        self._trimmed_at = -math.inf

    def on_mode(self, mode: str, now: float) -> None:
        """Take what the winch is doing."""
        if mode != self.mode:
            self.mode, self._mode_since = mode, now

    def is_at_rest(self, now: float) -> bool:
        """Whether the winch holds, and has done so for a while."""
        return self.mode == HOLD and now - self._mode_since > self.parameters.winch_rest_timeout

    def step(
        self,
        request: WinchRequest | None,
        length: float,
        now: float,
        *,
        moves: bool = False,
        trims: bool = False,
    ) -> WinchRequest | None:
        """What to send now.

        Args:
            request: what the controller asks for, anew or again.
            length: paid out [m].
            now: [s].
            moves: whether the winch is meant to be on its way.
            trims: whether it is trimmed now.
        """
        differs = request is not None and (
            self._request is None or request.length != self._request.length
        )
        if differs or (moves and not self._moves):
            self._requested_at, self._is_accepted = None, False
        self._moves = moves
        if trims:
            self._trimmed_at = now
        self._request = request or self._request
        if self._request is None:
            return None
        if self.mode == _LENGTH and self._requested_at is not None:
            self._is_accepted = True
        if self._trim_was_stopped:
            return None
        if self._requested_at is None and request is not None:
            self._requested_at = now
        elif now - self._sent_at < self.parameters.renewal_period:
            return None
        elif self.mode == _LENGTH:
            # Near its goal it needs no renewal, and one that comes late opens the brake again.
            if not moves and abs(length - self._request.length) < self.length_tolerance:
                return None
        elif request is None or (self._is_accepted and moves):
            return None
        self._sent_at = now
        return self._request

    @property
    def _trim_was_stopped(self) -> bool:
        return self.mode == HOLD and self._mode_since - self._trimmed_at < _TRIM_TIMEOUT

    def fault(self, length: float, now: float) -> str:
        """Why the winch does not do what it was asked; empty = it does."""
        if self.mode not in FREE:
            return f"the winch is in {self.mode or 'no known mode'}"
        stopped = f"the winch was stopped at {length:.4g} m, its events say why"
        if self._trim_was_stopped and self.is_at_rest(now):
            return stopped
        if self._request is None or self._requested_at is None or not self._moves:
            return ""
        if self._is_accepted and self.is_at_rest(now):
            return stopped
        if (
            not self._is_accepted
            and now - self._requested_at > self.parameters.winch_response_timeout
        ):
            return (
                f"the winch has not taken the request for {self._request.length:g} m, its "
                "diagnostics say why"
            )
        return ""
