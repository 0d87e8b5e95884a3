"""Rate limit of the refusals on ``diagnostics``.

Of each subject (topic or service) the first refusals of a period are reported at once. The others
are counted; when the period ends, the last of them is reported with their number. So each source
reads why it was refused, at the latest one period later.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

from msg_schemas.refusal import Refusal, RefusalReport
from msg_schemas.samples import Status

SHOWN_PER_PERIOD = 10
"""How many refusals of one subject are reported at once in one period."""


@dataclass
class _Subject:
    """What has been refused of one topic or service."""

    refused: int = 0  # in all
    shown: int = 0  # in this period
    held_back: int = 0  # in this period
    last: Refusal | None = None  # the last one held back


class RefusalLog:
    """Counts one node's refusals and selects those to report; threads may share it.

    Args:
        node: name of the node that refuses.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self._subjects: dict[str, _Subject] = {}
        self._lock = threading.Lock()

    @property
    def refused(self) -> int:
        """How many refusals there were in all."""
        with self._lock:
            return sum(subject.refused for subject in self._subjects.values())

    def take(self, refusal: Refusal) -> Status | None:
        """Count a refusal; returns the status to report now, None = it is held back."""
        with self._lock:
            subject = self._subjects.setdefault(refusal.subject, _Subject())
            subject.refused += 1
            if subject.shown >= SHOWN_PER_PERIOD:
                subject.held_back += 1
                subject.last = refusal
                return None
            subject.shown += 1
            return self._status(refusal, refusal.reason, subject)

    def end_period(self) -> tuple[Status, ...]:
        """Begin a new period; returns for each subject the last refusal that was held back."""
        with self._lock:
            reported = []
            for subject in self._subjects.values():
                if subject.last is not None:
                    reason = f"{subject.held_back} more, the last one: {subject.last.reason}"
                    reported.append(self._status(subject.last, reason, subject))
                subject.shown, subject.held_back, subject.last = 0, 0, None
            return tuple(reported)

    def _status(self, refusal: Refusal, message: str, subject: _Subject) -> Status:
        report = RefusalReport(
            self._node,
            refusal.subject,
            refusal.code,
            message,
            refusal.command_source,
            subject.refused,
            max(0, subject.held_back - 1),
        )
        return report.status()
