"""Client of the winch: sends, renews and supervises its requests. Pure.

A length request must be renewed, so a winch whose controller has died comes to rest. A winch that
does not follow its request has been stopped by an operator or by itself; the link then waits for a
new request.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.faults import Reason
from msg_schemas.parameters import parameter
from msg_schemas.phases import WinchMode
from msg_schemas.table import TOPICS

FREE = frozenset({WinchMode.HOLD, WinchMode.LENGTH})
"""Modes in which no other node moves the winch."""
_OF_OTHERS = frozenset(mode for mode in WinchMode if mode.is_armed) - FREE
# A trimmed winch rests only after the trim has timed out; one that rests sooner was stopped.
_TRIM_TIMEOUT = TOPICS[topics.WINCH_TRIM].stale.timeout  # [s]
_TRIM_STOPPED = 0.8 * _TRIM_TIMEOUT  # [s]


class WinchRequest(NamedTuple):
    """A request to the winch."""

    length: float  # [m]
    rate: float  # largest [m/s]


class LinkFault(NamedTuple):
    """Why the winch does not follow its request."""

    reason: Reason
    text: str


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
    """Link to the winch; one request at a time.

    Args:
        parameters: timing.
        length_tolerance: error within which a length is reached [m].
    """

    def __init__(self, parameters: WinchLinkParameters, length_tolerance: float) -> None:
        self.parameters = parameters
        self.length_tolerance = length_tolerance
        self.mode = ""
        self._mode_since = -math.inf
        self.clear()

    def clear(self) -> None:
        """Drop the request; it is no longer renewed."""
        self._request: WinchRequest | None = None
        self._sent_at = -math.inf
        self._requested_at: float | None = None  # first request of this motion [s]
        self._is_accepted = False
        self._moves = False
        self._trimmed_at = -math.inf

    def on_mode(self, mode: str, now: float) -> None:
        """Update with the mode of the winch."""
        if mode != self.mode:
            self.mode, self._mode_since = mode, now

    def is_at_rest(self, now: float) -> bool:
        """Whether the winch has held for longer than `winch_rest_timeout`."""
        return (
            self.mode == WinchMode.HOLD
            and now - self._mode_since > self.parameters.winch_rest_timeout
        )

    def step(
        self,
        request: WinchRequest | None,
        length: float,
        now: float,
        *,
        moves: bool = False,
        trims: bool = False,
    ) -> WinchRequest | None:
        """Return the request to send now, or None.

        Args:
            request: of the controller; None = unchanged.
            length: payout [m].
            now: [s].
            moves: the winch is expected to move.
            trims: the winch is trimmed now.
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
        if self.mode == WinchMode.LENGTH and self._requested_at is not None:
            self._is_accepted = True
        if self._trim_was_stopped:
            return None
        if self._requested_at is None and request is not None:
            self._requested_at = now
        elif now - self._sent_at < self.parameters.renewal_period:
            return None
        elif self.mode == WinchMode.LENGTH:
            # Near the goal no renewal is needed; a late one would open the brake again. A trim may
            # begin before the winch has ended its motion, and moves the drum until it times out.
            has_settled = not moves and now - self._trimmed_at >= _TRIM_TIMEOUT
            if has_settled and abs(length - self._request.length) < self.length_tolerance:
                return None
        elif request is None or (self._is_accepted and moves):
            return None
        self._sent_at = now
        return self._request

    @property
    def _trim_was_stopped(self) -> bool:
        return self.mode == WinchMode.HOLD and self._mode_since - self._trimmed_at < _TRIM_STOPPED

    def fault(self, length: float, now: float) -> LinkFault | None:
        """Why the winch does not follow its request; None = it does."""
        if self.mode not in FREE:
            reason = Reason.TAKEN_OVER if self.mode in _OF_OTHERS else Reason.FAULT
            return LinkFault(reason, f"the winch is in {self.mode or 'no known mode'}")
        text = f"the winch was stopped at {length:.4g} m; see its events"
        stopped = LinkFault(Reason.TAKEN_OVER, text)
        if self._trim_was_stopped and self.is_at_rest(now):
            return stopped
        if self._request is None or self._requested_at is None or not self._moves:
            return None
        if self._is_accepted and self.is_at_rest(now):
            return stopped
        if (
            not self._is_accepted
            and now - self._requested_at > self.parameters.winch_response_timeout
        ):
            return LinkFault(
                Reason.NOT_ACCEPTED,
                f"the winch has not accepted the request for {self._request.length:g} m within "
                f"{self.parameters.winch_response_timeout:g} s; see its diagnostics",
            )
        return None
