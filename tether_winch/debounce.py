"""Debouncing of a condition, with hysteresis. Pure."""

from __future__ import annotations


class Debounce:
    """Latch a condition that has held for a time, and release it the same way.

    Between the two thresholds (hysteresis) a running timer keeps running.
    """

    def __init__(self) -> None:
        self.is_on = False
        self._since: float | None = None  # start of the pending change [s]

    def step(self, begins: bool, ends: bool, now: float, on_after: float, off_after: float) -> bool:
        """Update with the condition at a time; returns the debounced condition.

        Args:
            begins: the value is beyond the set threshold.
            ends: the value is beyond the reset threshold.
            now: controller's clock [s].
            on_after: time for which it must hold before it is set [s].
            off_after: time for which it must be over before it is reset [s].
        """
        changes, returns = (ends, begins) if self.is_on else (begins, ends)
        if changes and self._since is None:
            self._since = now
        elif returns:
            self._since = None
        wait = off_after if self.is_on else on_after
        if self._since is not None and changes and now - self._since >= wait:
            self.is_on = not self.is_on
            self._since = None
        return self.is_on

    @property
    def is_pending(self) -> bool:
        """Whether a change is being timed."""
        return self._since is not None
