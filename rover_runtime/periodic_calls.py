"""Periodic calls by simulated time.

They replace rclpy's timers: if two clock messages arrive before the events executor runs a timer,
it runs the timer twice and omits the next call (seen with rclpy 7.1.6).
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
    """Callbacks with a period each; several elapsed periods cause one call."""

    def __init__(self) -> None:
        self._calls: list[_Call] = []

    def add(self, period_ns: int, callback: Callable[[], None], now_ns: int) -> Callable[[], None]:
        """Add a callback; the first call is due one period from now [ns].

        Returns:
            A function that removes it.
        """
        call = _Call(period_ns, callback, now_ns + period_ns)
        self._calls.append(call)
        return lambda: self._calls.remove(call)

    def advance(self, now_ns: int) -> None:
        """Run the callbacks that are due at a later time, in the order of their addition."""
        for call in self._calls.copy():
            if call.due_ns <= now_ns and call in self._calls:
                missed = (now_ns - call.due_ns) // call.period_ns
                call.due_ns += (missed + 1) * call.period_ns
                call.callback()

    def restart(self, now_ns: int) -> None:
        """Start all periods at this time, because the clock has gone back."""
        for call in self._calls:
            call.due_ns = now_ns + call.period_ns
