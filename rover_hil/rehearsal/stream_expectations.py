"""Expectations of message streams, evaluated over the time of a step's actions."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from msg_schemas.configuration import ConfigurationError, quantity, read_by
from msg_schemas.fields import known_names_hint
from msg_schemas.table import TOPICS
from rover_hil.rehearsal.expectation import (
    LATE,
    LONGEST,
    NANO,
    Expectation,
    bound,
    check_range,
    is_in_range,
    range_text,
    within,
)
from rover_hil.rehearsal.expectation_result import ExpectationResult, Result
from rover_hil.rehearsal.message_history import EvaluationWindow, ReceivedMessage


def _read_topics(value: object, path: str) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names:
        raise ConfigurationError(path, value, "should be a topic or a list of topics")
    for index, name in enumerate(names):
        if not isinstance(name, str) or name not in TOPICS:
            place = path if isinstance(value, str) else f"{path}[{index}]"
            raise ConfigurationError(
                place, name, f"no such topic{known_names_hint(str(name), TOPICS)}"
            )
    return tuple(names)


def _topics(about: str) -> Any:
    return read_by(_read_topics, (tuple,), about)


@dataclass(frozen=True, kw_only=True)
class _StreamExpectation(Expectation):
    """Expectation of each of several topics, over the time of the actions."""

    topics: tuple[str, ...] = _topics("topics")

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return self.topics

    @property
    def evaluated_after(self) -> float:
        """It is evaluated over the whole time of the actions."""
        return 0.0

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result."""
        del now_ns
        return all(window.reaches(topic, window.end_ns) for topic in self.topics)

    def evaluate(self, window: EvaluationWindow) -> tuple[ExpectationResult, ...]:
        """One result for each topic."""
        return tuple(
            self._evaluate_topic(
                topic, window, window.messages(topic, window.begin_ns, window.end_ns)
            )
            for topic in self.topics
        )

    def _evaluate_topic(
        self, topic: str, window: EvaluationWindow, messages: list[ReceivedMessage]
    ) -> ExpectationResult:
        raise NotImplementedError

    @staticmethod
    def _result(
        topic: str,
        window: EvaluationWindow,
        passed: bool,
        description: str,
        expected: str,
        measured: str,
    ) -> ExpectationResult:
        result = Result.PASS if passed else Result.FAIL
        return ExpectationResult(
            result, description, expected, measured, (topic,), window.begin_ns, window.end_ns
        )


@dataclass(frozen=True, kw_only=True)
class Rate(_StreamExpectation):
    """Rate of each topic, by the stamps of its messages."""

    minimum: float | None = bound("Hz", "smallest rate")
    maximum: float | None = bound("Hz", "largest rate")

    def check(self) -> None:
        """Refuse an empty range."""
        check_range(self.minimum, self.maximum)

    def _evaluate_topic(
        self, topic: str, window: EvaluationWindow, messages: list[ReceivedMessage]
    ) -> ExpectationResult:
        expected = range_text(self.minimum, self.maximum, "Hz")
        stamps = sorted({each.stamp_ns for each in messages})
        description = f"rate of {topic}"
        span = (window.end_ns - window.begin_ns) / NANO
        if len(stamps) < 2 or span <= 0.0:
            measured = f"{len(stamps)} messages in {span:.3g} s"
            return self._result(topic, window, False, description, expected, measured)
        # Missing messages at the beginning and the end lower the rate, too.
        first, last = stamps[0] - window.begin_ns, window.end_ns - stamps[-1]
        mean = (stamps[-1] - stamps[0]) / (len(stamps) - 1)
        missing = sum(max(0.0, edge / mean - 1.0) for edge in (first, last))
        rate = (len(stamps) - 1) / ((len(stamps) - 1 + missing) * mean / NANO)
        passed = is_in_range(rate, self.minimum, self.maximum)
        return self._result(topic, window, passed, description, expected, f"{rate:.4g} Hz")


@dataclass(frozen=True, kw_only=True)
class Gap(_StreamExpectation):
    """The longest time between two stamps of each topic."""

    maximum: float = quantity("s", "longest gap", above=0.0, maximum=LONGEST)

    def _evaluate_topic(
        self, topic: str, window: EvaluationWindow, messages: list[ReceivedMessage]
    ) -> ExpectationResult:
        instants = sorted([window.begin_ns, *(each.stamp_ns for each in messages), window.end_ns])
        gap = max(b - a for a, b in itertools.pairwise(instants)) / NANO
        passed = gap <= self.maximum and bool(messages)
        return self._result(
            topic, window, passed, f"longest gap of {topic}", f"at most {self.maximum:g} s",
            f"{gap:.3g} s" if messages else "no message",
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Age(_StreamExpectation):
    """Age of the messages of each topic when they are received."""

    maximum: float = quantity("s", "largest age", above=0.0, maximum=LONGEST)
    quantile: float = quantity(
        "-", "quantile of the ages that is tested", 0.99, above=0.0, maximum=1.0
    )

    def _evaluate_topic(
        self, topic: str, window: EvaluationWindow, messages: list[ReceivedMessage]
    ) -> ExpectationResult:
        ages = [(each.received_ns - each.stamp_ns) / NANO for each in messages]
        description = f"age of {topic} at reception, {self.quantile:.4g} quantile of {len(ages)}"
        expected = f"at most {self.maximum:g} s"
        if not ages:
            return self._result(topic, window, False, description, expected, "no message")
        age = float(np.quantile(ages, self.quantile, method="higher"))
        return self._result(
            topic, window, age <= self.maximum, description, expected, f"{age * 1e3:.3g} ms"
        )


@dataclass(frozen=True, kw_only=True)
class Conforms(_StreamExpectation):
    """Each message conforms to the contract: names, finite numbers, limits, frame."""

    def _evaluate_topic(
        self, topic: str, window: EvaluationWindow, messages: list[ReceivedMessage]
    ) -> ExpectationResult:
        wrong = [each.refusal for each in messages if each.sample is None]
        measured = f"{len(messages) - len(wrong)} of {len(messages)}"
        if wrong:
            measured += f"; first violation: {wrong[0]}"
        passed = bool(messages) and not wrong
        return self._result(
            topic,
            window,
            passed,
            f"conforming messages of {topic}",
            "all",
            measured,
        )


@dataclass(frozen=True, kw_only=True)
class NoMessages(_StreamExpectation):
    """No message on the topics, from a time after the start of the actions to their end."""

    after: float = within("time after the start of the actions in which messages are allowed", 0.0)

    @property
    def evaluated_after(self) -> float:
        """It is evaluated over the rest of the time of the actions."""
        return self.after

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result."""
        return now_ns >= window.end_ns + LATE * NANO

    def _evaluate_topic(
        self, topic: str, window: EvaluationWindow, messages: list[ReceivedMessage]
    ) -> ExpectationResult:
        from_ns = window.begin_ns + round(self.after * NANO)
        late = [each for each in messages if each.stamp_ns > from_ns]
        return self._result(
            topic, window, not late, f"messages of {topic} from {self.after:g} s on", "none",
            str(len(late)) if late else "none",
        )  # fmt: skip
