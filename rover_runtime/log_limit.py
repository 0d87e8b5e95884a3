"""Rate limit of a node's log: what is repeated too often is counted instead."""

from __future__ import annotations

from collections import Counter

_LINES_PER_PERIOD = 20  # of one subject


class LogLimit:
    """Selects the lines to log; each subject has its own limit."""

    def __init__(self) -> None:
        self._lines: Counter[str] = Counter()

    def take(self, subject: str) -> bool:
        """Count a line; returns whether to log it."""
        self._lines[subject] += 1
        return self._lines[subject] <= _LINES_PER_PERIOD

    def end_period(self) -> tuple[str, ...]:
        """Begin a new period; returns a line for each subject with lines that were not logged."""
        left = {name: count - _LINES_PER_PERIOD for name, count in self._lines.items()}
        self._lines.clear()
        return tuple(
            f"{name}: {count} more, not logged" for name, count in left.items() if count > 0
        )
