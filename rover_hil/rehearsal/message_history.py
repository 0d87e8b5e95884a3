"""Messages received during a rehearsal, by topic, including those that violate the contract."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from msg_schemas.samples import Status, StatusSample

_NEVER = -1
_KEPT = 1000  # messages of each topic that stay when a new step begins


@dataclass(frozen=True)
class ReceivedMessage:
    """One message.

    Attributes:
        stamp_ns: stamp of the message; of an unstamped one `received_ns`.
        received_ns: time of reception by the rehearsal's clock, which the stamps follow.
        steady_ns: time of reception by the computer's steady clock.
        sample: decoded content; None: the message violates the contract.
        refusal: how it violates the contract.
    """

    stamp_ns: int
    received_ns: int
    steady_ns: int
    sample: Any = None
    refusal: str = ""


class MessageHistory:
    """All received messages. One thread adds, another reads."""

    def __init__(self) -> None:
        self._topics: dict[str, list[ReceivedMessage]] = {}
        self._lock = threading.Lock()

    def add(self, topic: str, message: ReceivedMessage) -> None:
        """Append a message."""
        with self._lock:
            self._topics.setdefault(topic, []).append(message)

    def discard_old(self) -> None:
        """Keep only the newest messages of each topic."""
        with self._lock:
            for messages in self._topics.values():
                del messages[:-_KEPT]

    def discard(self, topic: str) -> None:
        """Discard all messages of a topic, after its subscription was closed."""
        with self._lock:
            self._topics.pop(topic, None)

    def of(self, topic: str) -> list[ReceivedMessage]:
        """All kept messages of a topic, in the order of reception."""
        with self._lock:
            return list(self._topics.get(topic, ()))

    def last(self, topic: str) -> ReceivedMessage | None:
        """The newest message that keeps the contract."""
        with self._lock:
            kept = self._topics.get(topic, [])
            return next((each for each in reversed(kept) if each.sample is not None), None)


@dataclass(frozen=True)
class EvaluationWindow:
    """The time span over which a step is evaluated.

    Attributes:
        history: messages of the whole rehearsal.
        begin_ns: start of the step's first action.
        end_ns: end of its last action; after a `publish`, the stamp of the last message sent.
        mark_ns: time of the `mark` action; negative: the step has none.
    """

    history: MessageHistory
    begin_ns: int
    end_ns: int = _NEVER
    mark_ns: int = _NEVER

    def messages(self, topic: str, from_ns: int, to_ns: int) -> list[ReceivedMessage]:
        """Messages with stamps in [from_ns, to_ns], in the order of reception."""
        return [each for each in self.history.of(topic) if from_ns <= each.stamp_ns <= to_ns]

    def reaches(self, topic: str, time_ns: int) -> bool:
        """Whether the last message of a topic has this stamp or a later one."""
        last = self.history.of(topic)[-1:]
        return bool(last) and last[0].stamp_ns >= time_ns

    def state_at(self, topic: str, time_ns: int) -> ReceivedMessage | None:
        """The last message of a topic at a time."""
        before = [each for each in self.history.of(topic) if each.stamp_ns <= time_ns]
        return before[-1] if before else None

    def statuses(
        self, topic: str, from_ns: int, matches: Callable[[Status], bool]
    ) -> Iterator[tuple[int, Status]]:
        """Stamps and statuses that match, from a time on."""
        for message in self.history.of(topic):
            if message.stamp_ns >= from_ns and isinstance(message.sample, StatusSample):
                for status in message.sample.statuses:
                    if matches(status):
                        yield message.stamp_ns, status
