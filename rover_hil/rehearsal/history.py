"""What a rehearsal has heard, topic by topic: samples, and messages that break the contract."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from msg_schemas.samples import Status, StatusSample

_NEVER = -1
_KEPT = 1000  # of each topic, when a new step begins


@dataclass(frozen=True)
class Heard:
    """One message.

    Attributes:
        stamp_ns: its own stamp; of an unstamped one when it was heard, by the rehearsal's clock.
        heard_ns: when it was heard, by the rehearsal's clock (the one that stamps follow).
        steady_ns: the same by the computer's steady clock.
        sample: what it says; None: it breaks the contract.
        refusal: how it breaks it.
    """

    stamp_ns: int
    heard_ns: int
    steady_ns: int
    sample: Any = None
    refusal: str = ""


class History:
    """All that was heard; one thread adds, another looks."""

    def __init__(self) -> None:
        self._topics: dict[str, list[Heard]] = {}
        self._lock = threading.Lock()

    def add(self, topic: str, heard: Heard) -> None:
        """Take a message."""
        with self._lock:
            self._topics.setdefault(topic, []).append(heard)

    def forget_old(self) -> None:
        """Keep the newest messages of each topic alone."""
        with self._lock:
            for heard in self._topics.values():
                del heard[:-_KEPT]

    def forget(self, topic: str) -> None:
        """Forget all of a topic: it is heard no more."""
        with self._lock:
            self._topics.pop(topic, None)

    def of(self, topic: str) -> list[Heard]:
        """Everything kept of a topic, as it came."""
        with self._lock:
            return list(self._topics.get(topic, ()))

    def last(self, topic: str) -> Heard | None:
        """The newest message that keeps the contract."""
        with self._lock:
            kept = self._topics.get(topic, [])
            return next((each for each in reversed(kept) if each.sample is not None), None)


@dataclass(frozen=True)
class Window:
    """The part of a history by which a step is judged.

    Attributes:
        history: of the whole rehearsal.
        begin_ns: when the step's first action began.
        end_ns: when its last action had ended; of a sending the stamp of its last message.
        mark_ns: the time that was noted; without a mark when the first action began.
    """

    history: History
    begin_ns: int
    end_ns: int = _NEVER
    mark_ns: int = _NEVER

    def messages(self, topic: str, from_ns: int, to_ns: int) -> list[Heard]:
        """Messages of a topic by their stamps, both ends included, in the order of their coming."""
        return [each for each in self.history.of(topic) if from_ns <= each.stamp_ns <= to_ns]

    def reaches(self, topic: str, time_ns: int) -> bool:
        """Whether a message with such a stamp, or a later one, has come."""
        last = self.history.of(topic)[-1:]
        return bool(last) and last[0].stamp_ns >= time_ns

    def state_at(self, topic: str, time_ns: int) -> Heard | None:
        """The last message at a time."""
        before = [each for each in self.history.of(topic) if each.stamp_ns <= time_ns]
        return before[-1] if before else None

    def statuses(
        self, topic: str, from_ns: int, wanted: Callable[[Status], bool]
    ) -> Iterator[tuple[int, Status]]:
        """Stamps and statuses as wanted, from a time on."""
        for heard in self.history.of(topic):
            if heard.stamp_ns >= from_ns and isinstance(heard.sample, StatusSample):
                for status in heard.sample.statuses:
                    if wanted(status):
                        yield heard.stamp_ns, status
