"""Least time between two requests of the same name. Pure."""

from __future__ import annotations

import math

from rover_control.mission.mission_legs import LegRequest

_SERVICE_PERIOD = 2.0  # least time between two calls of one service [s]


class RequestTimer:
    """Remembers when each topic and service was last requested."""

    def __init__(self) -> None:
        self._sent_at: dict[str, float] = {}  # [s]

    def clear(self) -> None:
        """Let the next request of each name be due at once."""
        self._sent_at.clear()

    def is_due(self, name: str, period: float, now: float) -> bool:
        """Whether a request may be sent at a time [s]; then it counts as sent.

        Args:
            name: topic or service.
            period: least time since the last request of this name [s].
            now: [s].
        """
        if now - self._sent_at.get(name, -math.inf) < period:
            return False
        self._sent_at[name] = now
        return True

    def call(self, service: str, now: float) -> tuple[LegRequest, ...]:
        """Call a service at a time [s]; empty while the last call is too recent."""
        return (LegRequest(service),) if self.is_due(service, _SERVICE_PERIOD, now) else ()
