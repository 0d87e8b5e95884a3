"""Offset of a device's clock from the bridge's, estimated from exchanges as in NTP.

An exchange is sent at t1 and its answer received at t4 by the bridge's clock; it is received at t2
and answered at t3 by the device's. The offset lies within [t3 - t4, t2 - t1] for any transit times;
the middle is the estimate, half the width its uncertainty. The narrowest of the last exchanges
counts, widened by the possible drift since then (RFC 5905, sections 8 and 10).
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

LARGEST_DRIFT = 100e-6
"""Assumed bound of the relative rate between two quartz clocks [-]."""
_KEPT = 64  # exchanges


class Offset(NamedTuple):
    """Estimated offset: device's clock minus bridge's clock."""

    value: float  # [s]
    uncertainty: float  # largest error [s]


class _Exchange(NamedTuple):
    at_ns: int
    middle: float
    half_width: float


class ClockOffset:
    """Estimator of the offset."""

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque(maxlen=_KEPT)

    def reset(self) -> None:
        """Forget all exchanges, after the device's clock restarted."""
        self._exchanges.clear()

    def add(self, sent_ns: int, arrived_ns: int, answered_ns: int, received_ns: int) -> bool:
        """Add an exchange, t1 to t4 [ns]; returns whether it is consistent.

        A negative transit time means that a frame of another exchange was taken for this one.
        """
        width = (received_ns - sent_ns) - (answered_ns - arrived_ns)
        if width < 0 or answered_ns < arrived_ns:
            return False
        middle = ((arrived_ns - sent_ns) + (answered_ns - received_ns)) / 2.0
        self._exchanges.append(_Exchange(received_ns, middle * 1e-9, width * 0.5e-9))
        return True

    def now(self, now_ns: int) -> Offset | None:
        """The best estimate at a time of the bridge's clock [ns]; None without an exchange."""
        best: Offset | None = None
        for exchange in self._exchanges:
            age = max(now_ns - exchange.at_ns, 0) * 1e-9
            uncertainty = exchange.half_width + LARGEST_DRIFT * age
            if best is None or uncertainty < best.uncertainty:
                best = Offset(exchange.middle, uncertainty)
        return best
