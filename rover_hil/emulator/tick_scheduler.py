"""Real-time schedule of the emulated plant: one tick for each period of SYNC.

A tick follows its SYNC after a delay, in which answers are sent and commands arrive. Without SYNC,
ticks follow the wall clock. The scheduler measures the real-time factor and counts the wall time
that was dropped because it could not be caught up.
"""

from __future__ import annotations

import math
from collections import deque

_CATCH_UP = 0.2  # longest delay to catch up [s]
_TICK_DELAY = 0.6  # from SYNC to tick, as a fraction of the period
_LOCKING = 0.05  # fraction of the phase error corrected at each SYNC
_ROUNDING = 1e-6  # of a period
_WINDOW = 2.0  # of the measured factor [s]
_REAL_TIME = 0.99  # smallest real-time factor


class TickScheduler:
    """Decides which ticks are due.

    Args:
        period: of SYNC and of ticks [s].

    Attributes:
        dropped: wall time that was not caught up [s].
        measured: real-time factor over the last two seconds of wall time; None: unknown.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.dropped = 0.0
        self.measured: float | None = None
        self._anchor: float | None = None
        self._done = 0
        self._marks: deque[tuple[float, int]] = deque()
        self._total = 0
        self._dropped_at = -math.inf

    def synchronise(self, wall: float) -> None:
        """Lock the phase of the ticks to a SYNC at a steady time [s]."""
        if self._anchor is None:
            self._anchor = wall
            return
        phase = (wall - self._anchor) / self._period
        self._anchor += _LOCKING * (phase - round(phase)) * self._period

    def due(self, wall: float) -> int:
        """Number of ticks due now, 0 or 1; the caller makes it."""
        if self._anchor is None:
            self._anchor = wall
        periods = (wall - self._anchor) / self._period - _TICK_DELAY
        behind = math.floor(periods + _ROUNDING) + 1 - self._done
        if behind * self._period > _CATCH_UP:
            self.dropped += (behind - 1) * self._period
            self._dropped_at = wall
            self._done += behind - 1
        ticks = int(behind > 0)
        self._done += ticks
        if ticks:
            self._mark(wall)
        return ticks

    def wait(self, wall: float) -> float:
        """Time until the next tick [s]."""
        if self._anchor is None:
            return self._period
        return max(self._anchor + (self._done + _TICK_DELAY) * self._period - wall, 0.0)

    def is_real_time(self, wall: float) -> bool:
        """Whether the plant keeps real time and dropped no wall time lately."""
        kept = wall - self._dropped_at > _WINDOW
        return kept and self.measured is not None and self.measured >= _REAL_TIME

    def _mark(self, wall: float) -> None:
        self._total += 1
        self._marks.append((wall, self._total))
        while len(self._marks) > 2 and wall - self._marks[1][0] > _WINDOW:
            self._marks.popleft()
        past, total = self._marks[0]
        if wall - past > 0.5 * _WINDOW:
            self.measured = (self._total - total) * self._period / (wall - past)
