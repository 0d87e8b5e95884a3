"""Which refusals are told: a flood is counted, and still nobody waits in vain for an answer.

Of each subject (topic or service) the first few refusals of a period are told as they
happen. Of those held back, the last is told when the period ends, with how many there
were. So whoever was refused reads why, at the latest one period later.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

from msg_schemas.refusal import Refusal, RefusalReport
from msg_schemas.samples import Status

SHOWN_PER_PERIOD = 10
"""How many refusals of one subject are told in one period as they happen."""


@dataclass
class _Subject:
    """What has been refused of one topic or service."""

    refused: int = 0  # in all
    shown: int = 0  # in this period
    held_back: int = 0  # in this period
    last: Refusal | None = None  # the last one held back


class RefusalLog:
    """Counts one node's refusals and chooses those that are told; threads may share it.

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
        """Count a refusal; returns what is to be told now, None = it is held back."""
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
            told = []
            for subject in self._subjects.values():
                if subject.last is not None:
                    reason = f"{subject.held_back} more, the last one: {subject.last.reason}"
                    told.append(self._status(subject.last, reason, subject))
                subject.shown, subject.held_back, subject.last = 0, 0, None
            return tuple(told)

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
