"""Simulated time by SYNC: each tick of a lockstep is a cycle of the link."""

from __future__ import annotations

import time
from collections.abc import Callable

from rover_hil.canopen.devices import SYNC_PERIOD
from rover_runtime.pacing import NANO

SYNC_PERIOD_NS = round(SYNC_PERIOD * NANO)
ANSWER_LIMIT = 2.0
"""Longest wall time for which time waits for the devices' end of the link [s]."""

_TIME_SIZE = 7  # bytes


def cycle_over(counter: int, stamp_ns: int) -> bytes:
    """Return the frame by which the devices' end reports that it has sent all answers.

    Args:
        counter: of the answered SYNC; 0 = none yet.
        stamp_ns: simulated time of the answers [ns].
    """
    return bytes([counter]) + stamp_ns.to_bytes(_TIME_SIZE, "little")


class SyncSource:
    """Source of simulated time: advances by a cycle of SYNC, and waits for its end.

    The devices' end determines the time. When it does not answer within ``ANSWER_LIMIT``, the next
    cycles follow the wall clock until it answers again.

    Args:
        begin_cycle: sends a SYNC whose answers have a stamp [ns]; returns its counter.
        dispatch: processes the next frame within a wall time [s].
        go_back: called after simulated time has gone back, by a reset or another devices' end.

    Attributes:
        stamp_ns: simulated time [ns].
        is_known: whether the devices' end has reported its time.
    """

    paused = False

    def __init__(
        self,
        begin_cycle: Callable[[int], int],
        dispatch: Callable[[float], object],
        go_back: Callable[[], None],
    ) -> None:
        self.stamp_ns = 0
        self.is_known = False
        self._begin_cycle = begin_cycle
        self._dispatch = dispatch
        self._go_back = go_back
        self._over: tuple[int, int] = (0, 0)  # counter and time of the last answered SYNC
        self._is_answered = True

    @property
    def next_ns(self) -> int:
        """Simulated time after the next cycle [ns]."""
        return self.stamp_ns + SYNC_PERIOD_NS

    def begin(self) -> None:
        """Begin: the devices' end has reported its time before."""

    def on_cycle_over(self, data: bytes) -> None:
        """Take the frame of ``cycle_over``."""
        if len(data) != 1 + _TIME_SIZE:
            return
        self._over = data[0], int.from_bytes(data[1:], "little")
        if not self.is_known:
            self.is_known, self.stamp_ns = True, self._over[1]

    def advance(self) -> None:
        """Make a cycle."""
        while self._dispatch(0.0):
            pass  # frames received so far belong to the past cycle
        before_ns, next_ns = self.stamp_ns, self.next_ns
        counter = self._begin_cycle(next_ns)
        limit = time.monotonic() + (ANSWER_LIMIT if self._is_answered else SYNC_PERIOD)
        while self._over[0] != counter and (left := limit - time.monotonic()) > 0.0:
            self._dispatch(left)
        self._is_answered = self._over[0] == counter
        self.stamp_ns = self._over[1] if self._is_answered else next_ns
        if self.stamp_ns < before_ns:
            self._go_back()

    def on_crash(self, error: Exception) -> None:
        """Raise an error of a cycle."""
        raise error
