"""Expectations of one thing at its own time: a value, a word, an event, a refusal, a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.configuration import ConfigurationError, choice, flag, read_by, text
from msg_schemas.fields import not_known, shown
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import Status, StatusSample, TextSample
from msg_schemas.table import SERVICES, TOPICS
from rover_hil.rehearsal.expectation import (
    LATE,
    NANO,
    Expectation,
    bound,
    check_range,
    range_text,
    within,
    within_bounds,
)
from rover_hil.rehearsal.finding import Finding, Verdict
from rover_hil.rehearsal.history import Heard, Window

_TEXTS = tuple(name for name, row in TOPICS.items() if row.sample is TextSample)
_STATUSES = tuple(name for name, row in TOPICS.items() if row.sample is StatusSample)
_VALUES = tuple(name for name, row in TOPICS.items() if row.fields)
_START, _MARK, _END = "start", "mark", "end"
_SINCE = {
    _START: "the start of the actions",
    _MARK: "the mark",
    _END: "the end of the actions",
}


def _read_words(value: object, path: str) -> tuple[str, ...]:
    words = [value] if isinstance(value, str) else value
    if not isinstance(words, list) or not words or not all(isinstance(w, str) for w in words):
        raise ConfigurationError(path, value, "should be a word or a list of words")
    return tuple(words)


def _read_texts(value: object, path: str) -> tuple[tuple[str, str], ...]:
    if not isinstance(value, Mapping):
        raise ConfigurationError(path, value, "should be a mapping of keys and texts")
    return tuple((str(key), str(given)) for key, given in value.items())


@dataclass(frozen=True, kw_only=True)
class _Timed(Expectation):
    """Of something that is to happen, or to hold, within a time."""

    within: float = within("time that is judged, from when it counts")
    counts_from: str = choice(
        (_START, _MARK, _END),
        "when its time begins: with the actions, at their mark, when they have ended",
        _START,
    )

    def _from_ns(self, window: Window) -> int:
        if self.counts_from == _MARK and window.mark_ns >= 0:
            return window.mark_ns
        return window.end_ns if self.counts_from == _END else window.begin_ns

    def _deadline_ns(self, window: Window) -> int:
        return self._from_ns(window) + round(self.within * NANO)

    def _after(self, window: Window, time_ns: int) -> str:
        return f"{max(0, time_ns - self._from_ns(window)) / NANO:.3g} s"

    def _in_time(self) -> str:
        return f"within {self.within:g} s of {_SINCE[self.counts_from]}"

    def _finding(
        self, topic: str, window: Window, right: bool, what: str, required: str, measured: str
    ) -> Finding:
        verdict = Verdict.PASS if right else Verdict.FAIL
        end_ns = max(self._deadline_ns(window), window.end_ns)
        return Finding(verdict, what, required, measured, (topic,), window.begin_ns, end_ns)


@dataclass(frozen=True, kw_only=True)
class Value(_Timed):
    """One number of a topic: reached within a time, or kept all the time.

    With ``when: always`` every sample of that time is judged, and there must be one.
    """

    topic: str = choice(_VALUES, "topic with numbers")
    field: str = text("which number, as the contract names it: winch_drum.velocity")
    minimum: float | None = bound("the field's unit", "smallest value")
    maximum: float | None = bound("the field's unit", "largest value")
    when: str = choice(("reached", "always"), "judged", "reached")

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return (self.topic,)

    def check(self) -> None:
        """Refuse what no single key can show."""
        check_range(self.minimum, self.maximum)
        fields = TOPICS[self.topic].by_path
        if self.field not in fields:
            expected = f"{self.topic} has no such field{not_known(self.field, fields)}"
            raise ConfigurationError("field", self.field, expected)

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing."""
        del now_ns
        if window.reaches(self.topic, self._deadline_ns(window)):
            return True
        return self.when == "reached" and self._first_right(window) is not None

    def _values(self, window: Window) -> list[tuple[int, float]]:
        from_ns, to_ns = self._from_ns(window), self._deadline_ns(window)
        return [
            (each.stamp_ns, value)
            for each in window.messages(self.topic, from_ns, to_ns)
            if each.sample is not None
            for path, value in each.sample.scalars()
            if path == self.field
        ]

    def _first_right(self, window: Window) -> int | None:
        return next(
            (
                stamp_ns
                for stamp_ns, value in self._values(window)
                if within_bounds(value, self.minimum, self.maximum)
            ),
            None,
        )

    def judge(self, window: Window) -> tuple[Finding, ...]:
        """What was found."""
        unit = TOPICS[self.topic].by_path[self.field].unit
        sign = "" if unit == "-" else f" {unit}"
        wanted = range_text(self.minimum, self.maximum, unit)
        values = self._values(window)
        what = f"{self.topic} {self.field}"
        seen = [value for _, value in values]
        span = f"{min(seen):.4g} to {max(seen):.4g}{sign}" if seen else "nothing came"
        if self.when == "always":
            right = bool(seen) and all(within_bounds(v, self.minimum, self.maximum) for v in seen)
            required = f"{wanted}, always for {self.within:g} s from {_SINCE[self.counts_from]}"
            return (self._finding(self.topic, window, right, what, required, span),)
        first_ns = self._first_right(window)
        required = f"{wanted} {self._in_time()}"
        measured = f"not reached, {span}" if first_ns is None else self._after(window, first_ns)
        right = first_ns is not None
        return (self._finding(self.topic, window, right, what, required, measured),)


@dataclass(frozen=True, kw_only=True)
class Word(_Timed):
    """A topic of words says one of these, or says so already."""

    topic: str = choice(_TEXTS, "topic of words")
    words: tuple[str, ...] = read_by(_read_words, (tuple,), "a word, or a list of them", ("",))

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return (self.topic,)

    def check(self) -> None:
        """Refuse what no single key can show."""
        allowed = TOPICS[self.topic].words
        for word in self.words:
            if allowed and word not in allowed:
                raise ConfigurationError(
                    "words", word, f"should be one of {', '.join(allowed)}, as {self.topic} has"
                )

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing."""
        del now_ns
        return self._first(window) is not None

    def _said(self, window: Window) -> list[Heard]:
        from_ns, to_ns = self._from_ns(window), self._deadline_ns(window)
        before = window.state_at(self.topic, from_ns)
        said = [] if before is None else [before]
        said += window.messages(self.topic, from_ns + 1, to_ns)
        return [each for each in said if each.sample is not None]

    def _first(self, window: Window) -> int | None:
        return next(
            (each.stamp_ns for each in self._said(window) if each.sample.text in self.words), None
        )

    def judge(self, window: Window) -> tuple[Finding, ...]:
        """What was found."""
        first_ns, said = self._first(window), self._said(window)
        required = f"{' or '.join(self.words)} {self._in_time()}"
        if first_ns is None:
            measured = f"it says {said[-1].sample.text!r}" if said else "nothing came"
        else:
            measured = self._after(window, first_ns)
        right = first_ns is not None
        what = f"what {self.topic} says"
        return (self._finding(self.topic, window, right, what, required, measured),)


@dataclass(frozen=True, kw_only=True)
class _OfStatuses(_Timed):
    """An event or a refusal, that comes in time, or must not come."""

    absent: bool = flag("it must not come")
    node: str = text("who tells it, as hil_bridge; empty: anybody", "")

    _topic = topics.EVENTS

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return (self._topic,)

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing."""
        if self.absent:
            late_ns = max(self._deadline_ns(window), window.end_ns) + round(LATE * NANO)
            return now_ns >= late_ns or bool(self._found(window))
        return bool(self._found(window))

    def _wanted(self, status: Status) -> bool:
        raise NotImplementedError

    def _named(self) -> str:
        raise NotImplementedError

    def _found(self, window: Window) -> list[tuple[int, Status]]:
        from_ns, to_ns = self._from_ns(window), self._deadline_ns(window)
        found = window.statuses(
            self._topic,
            from_ns,
            lambda s: self._wanted(s) and self.node in {"", s.hardware_id},
        )
        # Something late is shown with its time; only what was absent must be so until the deadline.
        return [each for each in found if not self.absent or each[0] <= to_ns]

    def judge(self, window: Window) -> tuple[Finding, ...]:
        """What was found."""
        found = self._found(window)
        said = f": {found[0][1].message}" if found else ""
        if self.absent:
            required = f"none {self._in_time()}"
            measured = f"{len(found)}{said}" if found else "none"
            right = not found
        else:
            required = f"it comes {self._in_time()}"
            measured = f"{self._after(window, found[0][0])}{said}" if found else "it did not come"
            right = bool(found) and found[0][0] <= self._deadline_ns(window)
        return (self._finding(self._topic, window, right, self._named(), required, measured),)


@dataclass(frozen=True, kw_only=True)
class Event(_OfStatuses):
    """An event by its name."""

    name: str = text("of the event, as docs and nodes name it: winch_disarmed", "")
    values: tuple[tuple[str, str], ...] = read_by(
        _read_texts, (tuple,), "a mapping of keys and texts that the event holds", ()
    )

    def check(self) -> None:
        """Refuse what no single key can show."""
        if not self.name:
            raise ConfigurationError("name", None, "missing; should be text")

    def _wanted(self, status: Status) -> bool:
        held = all(status.values.get(key) == text for key, text in self.values)
        return status.name == self.name and held

    def _named(self) -> str:
        held = ", ".join(f"{key} {value}" for key, value in self.values)
        return f"event {self.name}" + (f" ({held})" if held else "")


@dataclass(frozen=True, kw_only=True)
class Refused(_OfStatuses):
    """A refusal, by what was refused and why."""

    subject: str = choice((*TOPICS, *SERVICES), "topic or service", "")
    code: str = choice(tuple(RefusalCode), "reason, as the contract lists them")
    mentions: str = text("that its sentence holds", "")

    _topic = topics.DIAGNOSTICS

    def _wanted(self, status: Status) -> bool:
        return is_refusal(status, self.subject, self.code) and self.mentions in status.message

    def _named(self) -> str:
        return f"refusal of {self.subject}, {self.code}"


def is_refusal(status: Status, subject: str, code: str) -> bool:
    """Whether a status tells that something was refused, for that reason."""
    return status.name.endswith(f": refused {subject}") and status.values.get("code") == code


@dataclass(frozen=True, kw_only=True)
class Figure(_Timed):
    """One value of a status: what it says last, how much it grew, or that it comes to say it.

    Without ``key`` it is the status's own sentence.
    """

    topic: str = choice(_STATUSES, "topic of statuses", topics.LINK_STATUS)
    status: str = text("name of the status, as 'hil_bridge: link'", "")
    key: str = text("which value; empty: the status's sentence", "")
    minimum: float | None = bound("", "smallest value")
    maximum: float | None = bound("", "largest value")
    equals: str | None = read_by(
        lambda value, _: str(value), (str, type(None)), "text that it should be", None
    )
    measure: str = choice(
        ("last", "change", "reached"),
        "last: in the first report after the time and the actions; change: from the last report "
        "before the actions to that one; reached: in any report within the time",
        "last",
    )

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return (self.topic,)

    def check(self) -> None:
        """Refuse what no single key can show."""
        if not self.status:
            raise ConfigurationError("status", None, "missing; should be text")
        if self.equals is None:
            check_range(self.minimum, self.maximum)
        elif self.minimum is not None or self.maximum is not None:
            raise ConfigurationError("equals", self.equals, "should stand without a range")
        if self.equals is not None and self.measure == "change":
            raise ConfigurationError("measure", self.measure, "should be last or reached of a text")

    def _after_ns(self, window: Window) -> int:
        return max(self._deadline_ns(window), window.end_ns)

    def _told(self, window: Window, from_ns: int) -> list[tuple[int, str]]:
        found = window.statuses(self.topic, from_ns, lambda s: s.name == self.status)
        return [
            (stamp_ns, status.values.get(self.key, "") if self.key else status.message)
            for stamp_ns, status in found
        ]

    def _right(self, told: str) -> bool:
        if self.equals is not None:
            return told == self.equals
        value = _number(told)
        return value is not None and within_bounds(value, self.minimum, self.maximum)

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing."""
        del now_ns
        if self.measure == "reached":
            told = self._told(window, self._from_ns(window))
            return any(self._right(value) for _, value in told)
        return bool(self._told(window, self._after_ns(window)))

    def judge(self, window: Window) -> tuple[Finding, ...]:
        """What was found."""
        what = f"{self.key or 'what it says'} of {self.status}"
        wanted = range_text(self.minimum, self.maximum, "") if self.equals is None else self.equals
        if self.measure == "reached":
            told = self._told(window, self._from_ns(window))
            first = next((ns for ns, value in told if self._right(value)), None)
            right = first is not None and first <= self._deadline_ns(window)
            last = f"not reached, it is {told[-1][1]!r}" if told else "nothing came"
            measured = last if first is None else self._after(window, first)
            required = f"{wanted} {self._in_time()}"
            return (self._finding(self.topic, window, right, what, required, measured),)
        after = self._told(window, self._after_ns(window))
        if not after:
            return (self._finding(self.topic, window, False, what, wanted, "nothing came"),)
        if self.measure == "last":
            told_last = after[0][1]
            value = _number(told_last)
            measured = told_last if value is None else f"{value:.4g}"
            right = self._right(told_last)
            return (self._finding(self.topic, window, right, what, wanted, measured),)
        return (self._judge_change(window, what, wanted, after[0][1]),)

    def _judge_change(self, window: Window, what: str, wanted: str, told_after: str) -> Finding:
        # Without a report of before, the value is counted from nothing.
        before = [told for stamp_ns, told in self._told(window, 0) if stamp_ns <= window.begin_ns][
            -1:
        ] or ["0"]
        first, second = _number(before[0]), _number(told_after)
        if first is None or second is None:
            measured = f"{shown(before[0])} to {shown(told_after)}: no numbers"
            return self._finding(self.topic, window, False, what, wanted, measured)
        change = second - first
        right = within_bounds(change, self.minimum, self.maximum)
        return self._finding(
            self.topic, window, right, f"change of {what}", wanted, f"{change:.4g}"
        )


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
