"""Source of simulated time, its pacing by the wall clock, and the thread that advances it."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

from msg_schemas.refusal import Refusal, RefusalCode

T = TypeVar("T")

NANO = 1_000_000_000
_CATCH_UP_FACTOR = 2.0  # of the real-time factor, while a delay is caught up


class TimeSource(Protocol):
    """What advances simulated time: a simulated plant."""

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]."""

    @property
    def next_ns(self) -> int:
        """Simulated time after the next tick [ns]."""

    @property
    def paused(self) -> bool:
        """Whether simulated time is paused."""

    def begin(self) -> None:
        """Called before the first tick."""

    def advance(self) -> None:
        """Simulate one tick."""

    def on_crash(self, error: Exception) -> None:
        """Called after an unexpected error, which has ended simulated time."""


class Stepper(Protocol):
    """Advances a source of time; nothing else accesses it meanwhile."""

    pacer: Pacer

    def start(self) -> None:
        """Start time."""

    def stop(self) -> None:
        """Stop time after the current tick; it may be started again."""

    def call(self, act: Callable[[], T]) -> T:
        """Call a function between two ticks, and return its result.

        Raises:
            Refusal: from ``act``; or time is not started.
        """


class Pacer:
    """Paces simulated time by absolute deadlines of wall time.

    A delay up to `CATCH_UP` is caught up at no more than twice the real-time factor, so that the
    controllers can respond to each tick and no drive's watchdog fires. A longer delay is dropped
    and counted.

    Args:
        factor: simulated seconds per wall second; 0 = as fast as possible.
        burst: waits below this are left out, and made up for by the first that reaches it: ticks
            then run ahead of the factor by as much [s].
    """

    CATCH_UP = 0.2  # longest delay that is caught up [s]
    WINDOW = 2.0  # the measured factor's window [s]

    def __init__(self, factor: float, burst: float = 0.0) -> None:
        self.factor = factor
        self._burst = burst
        self.dropped = 0.0  # wall time that was not caught up [s]
        # Real-time factor reached over the last `WINDOW`; None: not yet known.
        self.measured: float | None = None
        self._anchor: tuple[float, int] | None = None
        # Wall time when the tick before this one was over, its wait included, and simulated time.
        self._before: tuple[float, int] | None = None
        self._marks: deque[tuple[float, int]] = deque()
        self._late_until = -math.inf

    def set_factor(self, factor: float) -> None:
        """Continue at another factor."""
        self.factor = factor
        self.restart()

    def restart(self) -> None:
        """Set new deadlines from the next tick on: after a pause, a reset or a new factor."""
        self._anchor = self._before = None
        self.measured = None
        self._marks.clear()
        self._late_until = -math.inf

    def wait(self, wall: float, stamp_ns: int) -> float:
        """Return the time to wait before the next tick [s].

        Args:
            wall: monotonic wall time [s].
            stamp_ns: simulated time reached.
        """
        self._mark(wall, stamp_ns)
        if self.factor == 0.0:
            return 0.0
        if self._anchor is None:
            self._anchor = (wall, stamp_ns)
        start, start_ns = self._anchor
        deadline = start + (stamp_ns - start_ns) / NANO / self.factor
        late = wall - deadline
        if late > self.CATCH_UP:
            self.dropped += late
            self._late_until = wall + self.WINDOW
            self._anchor = (wall, stamp_ns)
        begun, begun_ns = self._before or (wall, stamp_ns)
        soonest = begun + (stamp_ns - begun_ns) / NANO / (_CATCH_UP_FACTOR * self.factor)
        wait = max(0.0, -late, soonest - wall)
        self._before = (wall + wait, stamp_ns)
        return wait if wait >= self._burst else 0.0

    def _mark(self, wall: float, stamp_ns: int) -> None:
        self._marks.append((wall, stamp_ns))
        while len(self._marks) > 2 and wall - self._marks[1][0] > self.WINDOW:
            self._marks.popleft()
        past, past_ns = self._marks[0]
        if wall > past:
            self.measured = (stamp_ns - past_ns) / NANO / (wall - past)

    def keeps_up(self, wall: float) -> bool:
        """Return whether no delay was dropped within the window."""
        return wall > self._late_until


class PacedThread:
    """Advances a source of time in a thread of its own, paced; other threads call it in between.

    A tick and a call exclude each other, and a call waits for one tick at most.

    Args:
        source: to advance.
        factor: simulated seconds per wall second; 0 = as fast as possible.
    """

    def __init__(self, source: TimeSource, factor: float) -> None:
        self.pacer = Pacer(factor)
        self._source = source
        self._turn = threading.Lock()  # held by who accesses the source next
        self._changed = threading.Condition(threading.Lock())  # held by who accesses the source
        self._is_stopping = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread."""
        self.pacer.restart()
        self._is_stopping = False
        self._thread = threading.Thread(target=self._run, name="plant")
        self._thread.start()

    def stop(self) -> None:
        """End the thread after the current tick; it may be started again."""
        if self._thread is not None:
            with self._access():
                self._is_stopping = True
                self._changed.notify()
            self._thread.join()
            self._thread = None

    def call(self, act: Callable[[], T]) -> T:
        """Call a function between two ticks, and return its result.

        Raises:
            Refusal: from ``act``; or the thread does not run.
        """
        with self._access():
            if self._thread is None or not self._thread.is_alive():
                raise Refusal("simulation", RefusalCode.NOT_ACTIVE, "the simulation is not running")
            before = self._source.paused, self.pacer.factor
            try:
                return act()
            finally:
                if (self._source.paused, self.pacer.factor) != before:
                    self._changed.notify()

    @contextmanager
    def _access(self) -> Iterator[None]:
        with self._turn:
            self._changed.acquire()
        try:
            yield
        finally:
            self._changed.release()

    def _run(self) -> None:
        try:
            with self._access():
                self._source.begin()
            while not self._is_stopping:
                with self._access():
                    if self._is_due():
                        self._source.advance()
        except Exception as error:  # noqa: BLE001 - a bug must reach the process, not end here
            self._source.on_crash(error)

    def _is_due(self) -> bool:
        """Wait for the next tick; returns False if something has changed meanwhile."""
        if self._source.paused:
            self._changed.wait_for(lambda: self._is_stopping or not self._source.paused)
            return False
        due_in = self.pacer.wait(time.monotonic(), self._source.stamp_ns)
        is_changed = due_in > 0.0 and self._changed.wait(min(due_in, threading.TIMEOUT_MAX))
        return not (is_changed or self._is_stopping or self._source.paused)
