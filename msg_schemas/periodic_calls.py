"""Calls that are due by a clock that is told, as simulated time is.

rclpy's timers are not had for it: where two readings of the clock come before the executor of
events gets to a timer, it calls it twice and leaves the next call out (seen with rclpy 7.1.6).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(eq=False)
class _Call:
    period_ns: int
    callback: Callable[[], None]
    due_ns: int


class PeriodicCalls:
    """What is called once, whenever one of its periods or more have passed."""

    def __init__(self) -> None:
        self._calls: list[_Call] = []

    def add(self, period_ns: int, callback: Callable[[], None], now_ns: int) -> None:
        """Have something called from one period on [ns]."""
        self._calls.append(_Call(period_ns, callback, now_ns + period_ns))

    def advance(self, now_ns: int) -> None:
        """The clock says a later time: call what is due, in the order in which it was added."""
        for call in self._calls.copy():
            if call.due_ns <= now_ns and call in self._calls:
                missed = (now_ns - call.due_ns) // call.period_ns
                call.due_ns += (missed + 1) * call.period_ns
                call.callback()

    def restart(self, now_ns: int) -> None:
        """The clock has been put back: periods begin now."""
        for call in self._calls:
            call.due_ns = now_ns + call.period_ns

    def clear(self) -> None:
        """Call nothing any more."""
        self._calls.clear()
