"""Expectations with a deadline: of a value, a text, an event, a refusal, a metric."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.configuration import ConfigurationError, choice, flag, read_by, text
from msg_schemas.events import EVENTS
from msg_schemas.fields import known_names_hint, shown
from msg_schemas.refusal import RefusalCode, read_refusal
from msg_schemas.samples import Status, StatusSample, TextSample
from msg_schemas.table import SERVICES, TOPICS
from rover_hil.rehearsal.expectation import (
    LATE,
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

_TEXTS = tuple(name for name, row in TOPICS.items() if row.sample is TextSample)
_STATUSES = tuple(name for name, row in TOPICS.items() if row.sample is StatusSample)
_VALUES = tuple(name for name, row in TOPICS.items() if row.fields)
_START, _MARK, _END = "start", "mark", "end"
_SINCE = {
    _START: "the start of the actions",
    _MARK: "the mark",
    _END: "the end of the actions",
}


def _read_list(value: object, path: str) -> tuple[str, ...]:
    one_of = [value] if isinstance(value, str) else value
    if not isinstance(one_of, list) or not one_of or not all(isinstance(w, str) for w in one_of):
        raise ConfigurationError(path, value, "should be a text or a list of texts")
    return tuple(one_of)


def _read_text(value: object, path: str) -> str:
    # Nodes write true and false in their own manner: only the procedure can state which.
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise ConfigurationError(path, value, "should be a number, or a text in quotes")
    return str(value)


def _read_texts(value: object, path: str) -> tuple[tuple[str, str], ...]:
    if not isinstance(value, Mapping):
        raise ConfigurationError(path, value, "should be a mapping of keys and texts")
    return tuple((str(key), _read_text(given, f"{path}.{key}")) for key, given in value.items())


@dataclass(frozen=True, kw_only=True)
class _TimedExpectation(Expectation):
    """Expectation over a time span after the start, the mark or the end of the actions."""

    within: float = within("time span, counted from `since`")
    since: str = choice(
        (_START, _MARK, _END),
        "start of the time span: start of the actions, their mark, or their end",
        _START,
    )

    def _from_ns(self, window: EvaluationWindow) -> int:
        if self.since == _MARK and window.mark_ns >= 0:
            return window.mark_ns
        return window.end_ns if self.since == _END else window.begin_ns

    def _deadline_ns(self, window: EvaluationWindow) -> int:
        return self._from_ns(window) + round(self.within * NANO)

    def _after(self, window: EvaluationWindow, time_ns: int) -> str:
        return f"{max(0, time_ns - self._from_ns(window)) / NANO:.3g} s"

    def _in_time(self) -> str:
        return f"within {self.within:g} s of {_SINCE[self.since]}"

    def _result(
        self,
        topic: str,
        window: EvaluationWindow,
        passed: bool,
        description: str,
        expected: str,
        measured: str,
    ) -> ExpectationResult:
        result = Result.PASS if passed else Result.FAIL
        end_ns = max(self._deadline_ns(window), window.end_ns)
        return ExpectationResult(
            result, description, expected, measured, (topic,), window.begin_ns, end_ns
        )


@dataclass(frozen=True, kw_only=True)
class Value(_TimedExpectation):
    """One field of a topic: reaches a range within the time, or stays in it.

    With ``when: always`` every sample of the time span must be in range, and there must be one.
    """

    topic: str = choice(_VALUES, "topic with numeric fields")
    field: str = text("path of the field in the contract: winch_drum.velocity")
    minimum: float | None = bound("the field's unit", "smallest value")
    maximum: float | None = bound("the field's unit", "largest value")
    when: str = choice(("reached", "always"), "the range is reached or kept", "reached")

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return (self.topic,)

    def check(self) -> None:
        """Refuse contradictory keys."""
        check_range(self.minimum, self.maximum)
        fields = TOPICS[self.topic].by_path
        if self.field not in fields:
            expected = f"{self.topic} has no such field{known_names_hint(self.field, fields)}"
            raise ConfigurationError("field", self.field, expected)

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result."""
        del now_ns
        if window.reaches(self.topic, self._deadline_ns(window)):
            return True
        return self.when == "reached" and self._first_in_range(window) is not None

    def _values(self, window: EvaluationWindow) -> list[tuple[int, float]]:
        from_ns, to_ns = self._from_ns(window), self._deadline_ns(window)
        return [
            (each.stamp_ns, value)
            for each in window.messages(self.topic, from_ns, to_ns)
            if each.sample is not None
            for path, value in each.sample.scalars()
            if path == self.field
        ]

    def _first_in_range(self, window: EvaluationWindow) -> int | None:
        return next(
            (
                stamp_ns
                for stamp_ns, value in self._values(window)
                if is_in_range(value, self.minimum, self.maximum)
            ),
            None,
        )

    def evaluate(self, window: EvaluationWindow) -> tuple[ExpectationResult, ...]:
        """One result."""
        unit = TOPICS[self.topic].by_path[self.field].unit
        sign = "" if unit == "-" else f" {unit}"
        limits = range_text(self.minimum, self.maximum, unit)
        samples = self._values(window)
        description = f"{self.topic} {self.field}"
        values = [value for _, value in samples]
        span = f"{min(values):.4g} to {max(values):.4g}{sign}" if values else "no message"
        if self.when == "always":
            passed = bool(values) and all(
                is_in_range(v, self.minimum, self.maximum) for v in values
            )
            expected = f"{limits}, always for {self.within:g} s from {_SINCE[self.since]}"
            return (self._result(self.topic, window, passed, description, expected, span),)
        first_ns = self._first_in_range(window)
        expected = f"{limits} {self._in_time()}"
        measured = f"not reached, {span}" if first_ns is None else self._after(window, first_ns)
        passed = first_ns is not None
        return (self._result(self.topic, window, passed, description, expected, measured),)


@dataclass(frozen=True, kw_only=True)
class Text(_TimedExpectation):
    """A text topic holds one of these texts, now or within the time."""

    topic: str = choice(_TEXTS, "topic of texts")
    one_of: tuple[str, ...] = read_by(_read_list, (tuple,), "a text, or a list of them")

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return (self.topic,)

    def check(self) -> None:
        """Refuse contradictory keys."""
        allowed = TOPICS[self.topic].words
        for word in self.one_of:
            if allowed and word not in allowed:
                raise ConfigurationError(
                    "one_of",
                    word,
                    f"should be one of {', '.join(allowed)} ({self.topic})",
                )

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result."""
        del now_ns
        return self._first(window) is not None

    def _texts(self, window: EvaluationWindow) -> list[ReceivedMessage]:
        from_ns, to_ns = self._from_ns(window), self._deadline_ns(window)
        before = window.state_at(self.topic, from_ns)
        texts = [] if before is None else [before]
        texts += window.messages(self.topic, from_ns + 1, to_ns)
        return [each for each in texts if each.sample is not None]

    def _first(self, window: EvaluationWindow) -> int | None:
        return next(
            (each.stamp_ns for each in self._texts(window) if each.sample.text in self.one_of), None
        )

    def evaluate(self, window: EvaluationWindow) -> tuple[ExpectationResult, ...]:
        """One result."""
        first_ns, texts = self._first(window), self._texts(window)
        expected = f"{' or '.join(self.one_of)} {self._in_time()}"
        if first_ns is None:
            measured = f"it is {texts[-1].sample.text!r}" if texts else "no message"
        else:
            measured = self._after(window, first_ns)
        passed = first_ns is not None
        description = f"text of {self.topic}"
        return (self._result(self.topic, window, passed, description, expected, measured),)


@dataclass(frozen=True, kw_only=True)
class _StatusExpectation(_TimedExpectation):
    """An event or a refusal that must occur in time, or must not occur."""

    absent: bool = flag("it must not occur")
    node: str = text("node that reports it: hil_bridge; empty: any node", "")

    _topic = topics.EVENTS

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return (self._topic,)

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result."""
        if self.absent:
            late_ns = max(self._deadline_ns(window), window.end_ns) + round(LATE * NANO)
            return now_ns >= late_ns or bool(self._matching(window))
        return bool(self._matching(window))

    def _matches(self, status: Status) -> bool:
        raise NotImplementedError

    def _description(self) -> str:
        raise NotImplementedError

    def _matching(self, window: EvaluationWindow) -> list[tuple[int, Status]]:
        from_ns, to_ns = self._from_ns(window), self._deadline_ns(window)
        found = window.statuses(
            self._topic,
            from_ns,
            lambda s: self._matches(s) and self.node in {"", s.hardware_id},
        )
        # A late event is reported with its time; `absent` counts events up to the deadline only.
        return [each for each in found if not self.absent or each[0] <= to_ns]

    def evaluate(self, window: EvaluationWindow) -> tuple[ExpectationResult, ...]:
        """One result."""
        found = self._matching(window)
        texts = f": {found[0][1].message}" if found else ""
        if self.absent:
            expected = f"none {self._in_time()}"
            measured = f"{len(found)}{texts}" if found else "none"
            passed = not found
        else:
            expected = f"occurs {self._in_time()}"
            measured = f"{self._after(window, found[0][0])}{texts}" if found else "did not occur"
            passed = bool(found) and found[0][0] <= self._deadline_ns(window)
        return (self._result(self._topic, window, passed, self._description(), expected, measured),)


@dataclass(frozen=True, kw_only=True)
class EventExpectation(_StatusExpectation):
    """Expectation of an event."""

    name: str = text("name of an event of the contract", "")
    values: tuple[tuple[str, str], ...] = read_by(
        _read_texts, (tuple,), "a mapping of keys and texts that the event must have", ()
    )

    def check(self) -> None:
        """Refuse contradictory keys."""
        if not self.name:
            raise ConfigurationError("name", None, "missing; should be text")
        if self.name not in EVENTS:
            expected = f"no such event{known_names_hint(self.name, EVENTS)}"
            raise ConfigurationError("name", self.name, expected)
        declared = EVENTS[self.name].values
        for key, value in self.values:
            if key not in declared:
                names = ", ".join(declared) or "none"
                expected = f"event {self.name} declares no such value, it declares: {names}"
                raise ConfigurationError(f"values.{key}", value, expected)

    def _matches(self, status: Status) -> bool:
        matches_values = all(status.values.get(key) == text for key, text in self.values)
        return status.name == self.name and matches_values

    def _description(self) -> str:
        matches_values = ", ".join(f"{key} {value}" for key, value in self.values)
        return f"event {self.name}" + (f" ({matches_values})" if matches_values else "")


@dataclass(frozen=True, kw_only=True)
class RefusalExpectation(_StatusExpectation):
    """Expectation of a refusal, by its subject and reason."""

    subject: str = choice((*TOPICS, *SERVICES), "refused topic or service", "")
    code: str = choice(tuple(RefusalCode), "reason, one of the contract's")

    _topic = topics.DIAGNOSTICS

    def _matches(self, status: Status) -> bool:
        return is_refusal(status, self.subject, self.code)

    def _description(self) -> str:
        return f"refusal of {self.subject}, {self.code}"


def is_refusal(status: Status, subject: str, code: str) -> bool:
    """Whether a status reports the refusal of a subject for a reason."""
    refusal = read_refusal(status)
    return refusal is not None and refusal.subject == subject and refusal.code == code


@dataclass(frozen=True, kw_only=True)
class Metric(_TimedExpectation):
    """One value of a diagnostic status: its last value, its change, or that it reaches a value."""

    topic: str = choice(_STATUSES, "topic of statuses", topics.LINK_STATUS)
    status: str = text("name of the status: 'hil_bridge: link'", "")
    key: str = text("key of the value", "")
    minimum: float | None = bound("", "smallest value")
    maximum: float | None = bound("", "largest value")
    equals: str | None = read_by(_read_text, (str, type(None)), "required text", None)
    measure: str = choice(
        ("last", "change", "reached"),
        "last: in the first report after the time and the actions; change: from the last report "
        "before the actions to that one; reached: in any report within the time",
        "last",
    )

    @property
    def subscribed_topics(self) -> tuple[str, ...]:
        """Topics to subscribe to."""
        return (self.topic,)

    def check(self) -> None:
        """Refuse contradictory keys."""
        for name in ("status", "key"):
            if not getattr(self, name):
                raise ConfigurationError(name, None, "missing; should be text")
        if self.equals is None:
            check_range(self.minimum, self.maximum)
        elif self.minimum is not None or self.maximum is not None:
            raise ConfigurationError("equals", self.equals, "should be given without a range")
        if self.equals is not None and self.measure == "change":
            raise ConfigurationError("measure", self.measure, "should be last or reached of a text")

    def _after_ns(self, window: EvaluationWindow) -> int:
        return max(self._deadline_ns(window), window.end_ns)

    def _reports(self, window: EvaluationWindow, from_ns: int) -> list[tuple[int, str]]:
        found = window.statuses(self.topic, from_ns, lambda s: s.name == self.status)
        return [(stamp_ns, status.values.get(self.key, "")) for stamp_ns, status in found]

    def _fulfils(self, reports: str) -> bool:
        if self.equals is not None:
            return reports == self.equals
        value = _number(reports)
        return value is not None and is_in_range(value, self.minimum, self.maximum)

    def is_decided(self, window: EvaluationWindow, now_ns: int) -> bool:
        """Whether waiting longer cannot change the result."""
        del now_ns
        if self.measure == "reached":
            reports = self._reports(window, self._from_ns(window))
            return any(self._fulfils(value) for _, value in reports)
        return bool(self._reports(window, self._after_ns(window)))

    def evaluate(self, window: EvaluationWindow) -> tuple[ExpectationResult, ...]:
        """One result."""
        description = f"{self.key or 'message'} of {self.status}"
        limits = range_text(self.minimum, self.maximum, "") if self.equals is None else self.equals
        if self.measure == "reached":
            reports = self._reports(window, self._from_ns(window))
            first = next((ns for ns, value in reports if self._fulfils(value)), None)
            passed = first is not None and first <= self._deadline_ns(window)
            last = f"not reached, it is {reports[-1][1]!r}" if reports else "no message"
            measured = last if first is None else self._after(window, first)
            expected = f"{limits} {self._in_time()}"
            return (self._result(self.topic, window, passed, description, expected, measured),)
        after = self._reports(window, self._after_ns(window))
        if not after:
            return (self._result(self.topic, window, False, description, limits, "no message"),)
        if self.measure == "last":
            last_report = after[0][1]
            value = _number(last_report)
            measured = last_report if value is None else f"{value:.4g}"
            passed = self._fulfils(last_report)
            return (self._result(self.topic, window, passed, description, limits, measured),)
        return (self._evaluate_change(window, description, limits, after[0][1]),)

    def _evaluate_change(
        self, window: EvaluationWindow, description: str, limits: str, reported_after: str
    ) -> ExpectationResult:
        # Without an earlier report, the change counts from zero.
        before = [
            reports for stamp_ns, reports in self._reports(window, 0) if stamp_ns <= window.begin_ns
        ][-1:] or ["0"]
        first, second = _number(before[0]), _number(reported_after)
        if first is None or second is None:
            measured = f"{shown(before[0])} to {shown(reported_after)}: not numeric"
            return self._result(self.topic, window, False, description, limits, measured)
        change = second - first
        passed = is_in_range(change, self.minimum, self.maximum)
        return self._result(
            self.topic, window, passed, f"change of {description}", limits, f"{change:.4g}"
        )


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
