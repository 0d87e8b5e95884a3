"""A condition that must last before it is believed. Pure."""

from __future__ import annotations


class Debounce:
    """Turns true when a condition has held long enough, and false when its opposite has.

    A value between the two thresholds (hysteresis) keeps what is pending as it is.
    """

    def __init__(self) -> None:
        self.is_on = False
        self._since: float | None = None  # [s] on or off has been asked for since then

    def step(self, begins: bool, ends: bool, now: float, on_after: float, off_after: float) -> bool:
        """Take the condition at a time; returns whether it is believed.

        Args:
            begins: beyond the threshold that turns it on.
            ends: beyond the threshold that takes it back.
            now: controller's clock [s].
            on_after: how long it must last to be believed [s].
            off_after: how long its end must last [s].
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
        """Whether a change has begun and is not believed yet."""
        return self._since is not None
