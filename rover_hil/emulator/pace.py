"""How an emulated machine keeps pace with the world: one tick for each period of SYNC.

The plant makes its tick some time after each SYNC, when the answers are sent and the commands that
they bring about have come. The world does not wait for a bus master: where no SYNC comes, ticks go
on by the wall clock. Whether a machine is fast enough is measured, and what could not be caught up
is counted.
"""

from __future__ import annotations

import math
from collections import deque

_CATCH_UP = 0.2  # longest delay that is caught up [s]
_AFTER = 0.6  # of a period between SYNC and tick
_LOCKING = 0.05  # of the phase's error that is taken away at each SYNC
_ROUNDING = 1e-6  # of a period
_WINDOW = 2.0  # of the measured factor [s]
_REAL_TIME = 0.99  # factor from which it may be called so


class SyncPace:
    """Which ticks are due.

    Args:
        period: of SYNC and of ticks [s].

    Attributes:
        given_up: wall time that could not be caught up [s].
        measured: simulated per wall seconds over the last two wall seconds; None: not yet known.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.given_up = 0.0
        self.measured: float | None = None
        self._anchor: float | None = None
        self._done = 0
        self._marks: deque[tuple[float, int]] = deque()
        self._total = 0
        self._given_up_at = -math.inf

    def synchronise(self, wall: float) -> None:
        """A SYNC has come at a steady time [s]: ticks are counted around it."""
        if self._anchor is None:
            self._anchor = wall
            return
        phase = (wall - self._anchor) / self._period
        self._anchor += _LOCKING * (phase - round(phase)) * self._period

    def due(self, wall: float) -> int:
        """How many ticks are to be made now, 0 or 1; it counts as made."""
        if self._anchor is None:
            self._anchor = wall
        periods = (wall - self._anchor) / self._period - _AFTER
        behind = math.floor(periods + _ROUNDING) + 1 - self._done
        if behind * self._period > _CATCH_UP:
            self.given_up += (behind - 1) * self._period
            self._given_up_at = wall
            self._done += behind - 1
        ticks = int(behind > 0)
        self._done += ticks
        if ticks:
            self._mark(wall)
        return ticks

    def wait(self, wall: float) -> float:
        """How long it is until the next tick [s]."""
        if self._anchor is None:
            return self._period
        return max(self._anchor + (self._done + _AFTER) * self._period - wall, 0.0)

    def is_real_time(self, wall: float) -> bool:
        """Whether the plant keeps pace with the wall clock, and nothing was given up lately."""
        kept = wall - self._given_up_at > _WINDOW
        return kept and self.measured is not None and self.measured >= _REAL_TIME

    def _mark(self, wall: float) -> None:
        self._total += 1
        self._marks.append((wall, self._total))
        while len(self._marks) > 2 and wall - self._marks[1][0] > _WINDOW:
            self._marks.popleft()
        past, total = self._marks[0]
        if wall - past > 0.5 * _WINDOW:
            self.measured = (self._total - total) * self._period / (wall - past)
