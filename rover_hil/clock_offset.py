"""The offset of a device's clock from the bridge's, from exchanges over the link.

As NTP does: an exchange is sent at t1 and answered at t4 by the bridge's clock, taken at t2 and
answered at t3 by the device's. The offset lies within [t3 - t4, t2 - t1], whatever the ways took;
the middle is the estimate, half the width its uncertainty. Of the last exchanges the narrowest one
counts, widened by what the clocks may have drifted apart since (RFC 5905, sections 8 and 10).
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

_DRIFT = 100e-6  # two quartzes may run apart so fast [s/s]
_KEPT = 64  # exchanges


class Offset(NamedTuple):
    """An estimate: the device's clock less the bridge's."""

    value: float  # [s]
    uncertainty: float  # largest error [s]


class _Exchange(NamedTuple):
    at_ns: int
    middle: float
    half_width: float


class ClockOffset:
    """The offset as it is known now."""

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque(maxlen=_KEPT)

    def reset(self) -> None:
        """Forget all: the device's clock began anew."""
        self._exchanges.clear()

    def add(self, sent_ns: int, taken_ns: int, answered_ns: int, received_ns: int) -> bool:
        """Take an exchange: t1 to t4 [ns]; returns whether it can be so.

        An exchange of negative length is none: a frame of another exchange was taken for its own.
        """
        width = (received_ns - sent_ns) - (answered_ns - taken_ns)
        if width < 0 or answered_ns < taken_ns:
            return False
        middle = ((taken_ns - sent_ns) + (answered_ns - received_ns)) / 2.0
        self._exchanges.append(_Exchange(received_ns, middle * 1e-9, width * 0.5e-9))
        return True

    def now(self, now_ns: int) -> Offset | None:
        """The best estimate at a time of the bridge's clock [ns]; None without an exchange."""
        best: Offset | None = None
        for exchange in self._exchanges:
            age = max(now_ns - exchange.at_ns, 0) * 1e-9
            uncertainty = exchange.half_width + _DRIFT * age
            if best is None or uncertainty < best.uncertainty:
                best = Offset(exchange.middle, uncertainty)
        return best
