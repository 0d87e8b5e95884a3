"""Expectations of whole streams of messages, judged while a step's actions go on."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from msg_schemas.configuration import ConfigurationError, quantity, read_by
from msg_schemas.fields import not_known
from msg_schemas.table import TOPICS
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

_LONGEST = 3600.0  # [s]


def _read_topics(value: object, path: str) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names:
        raise ConfigurationError(path, value, "should be a topic or a list of topics")
    for index, name in enumerate(names):
        if name not in TOPICS:
            place = path if isinstance(value, str) else f"{path}[{index}]"
            raise ConfigurationError(place, name, f"no such topic{not_known(str(name), TOPICS)}")
    return tuple(names)


def _topics(about: str) -> Any:
    return read_by(_read_topics, (tuple,), about)


@dataclass(frozen=True, kw_only=True)
class _OfStreams(Expectation):
    """Of whole streams, while the actions go on."""

    topics: tuple[str, ...] = _topics("topics")

    @property
    def heard_on(self) -> tuple[str, ...]:
        """Topics that must be listened to."""
        return self.topics

    @property
    def needs_time(self) -> bool:
        """It is judged over the time that the actions take."""
        return True

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing."""
        del now_ns
        return all(window.reaches(topic, window.end_ns) for topic in self.topics)

    def judge(self, window: Window) -> tuple[Finding, ...]:
        """What was found."""
        return tuple(
            self._judge_one(topic, window, window.messages(topic, window.begin_ns, window.end_ns))
            for topic in self.topics
        )

    def _judge_one(self, topic: str, window: Window, heard: list[Heard]) -> Finding:
        raise NotImplementedError

    @staticmethod
    def _finding(
        topic: str, window: Window, right: bool, what: str, required: str, measured: str
    ) -> Finding:
        verdict = Verdict.PASS if right else Verdict.FAIL
        return Finding(verdict, what, required, measured, (topic,), window.begin_ns, window.end_ns)


@dataclass(frozen=True, kw_only=True)
class Rate(_OfStreams):
    """Each topic's rate, by the stamps of its messages."""

    minimum: float | None = bound("Hz", "smallest rate")
    maximum: float | None = bound("Hz", "largest rate")

    def check(self) -> None:
        """Refuse what no single key can show."""
        check_range(self.minimum, self.maximum)

    def _judge_one(self, topic: str, window: Window, heard: list[Heard]) -> Finding:
        required = range_text(self.minimum, self.maximum, "Hz")
        stamps = sorted({each.stamp_ns for each in heard})
        what = f"rate of {topic}"
        span = (window.end_ns - window.begin_ns) / NANO
        if len(stamps) < 2 or span <= 0.0:
            measured = f"{len(stamps)} messages in {span:.3g} s"
            return self._finding(topic, window, False, what, required, measured)
        # What was silent at the beginning or the end counts as well.
        first, last = stamps[0] - window.begin_ns, window.end_ns - stamps[-1]
        mean = (stamps[-1] - stamps[0]) / (len(stamps) - 1)
        missing = sum(max(0.0, edge / mean - 1.0) for edge in (first, last))
        rate = (len(stamps) - 1) / ((len(stamps) - 1 + missing) * mean / NANO)
        right = within_bounds(rate, self.minimum, self.maximum)
        return self._finding(topic, window, right, what, required, f"{rate:.4g} Hz")


@dataclass(frozen=True, kw_only=True)
class Gap(_OfStreams):
    """The longest time between two stamps of each topic."""

    at_most: float = quantity("s", "longest gap", above=0.0, maximum=_LONGEST)

    def _judge_one(self, topic: str, window: Window, heard: list[Heard]) -> Finding:
        times = sorted([window.begin_ns, *(each.stamp_ns for each in heard), window.end_ns])
        gap = max(b - a for a, b in itertools.pairwise(times)) / NANO
        right = gap <= self.at_most and bool(heard)
        return self._finding(
            topic, window, right, f"longest gap of {topic}", f"at most {self.at_most:g} s",
            f"{gap:.3g} s" if heard else "nothing came",
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Age(_OfStreams):
    """How old each topic's messages are when they are heard."""

    at_most: float = quantity("s", "largest age", above=0.0, maximum=_LONGEST)
    share: float = quantity("-", "of the messages, that keeps to it", 0.99, above=0.0, maximum=1.0)

    def _judge_one(self, topic: str, window: Window, heard: list[Heard]) -> Finding:
        ages = [(each.heard_ns - each.stamp_ns) / NANO for each in heard]
        what = f"age of {topic} on arrival, {self.share:.4g} of {len(ages)} messages"
        required = f"at most {self.at_most:g} s"
        if not ages:
            return self._finding(topic, window, False, what, required, "nothing came")
        age = float(np.quantile(ages, self.share, method="higher"))
        return self._finding(
            topic, window, age <= self.at_most, what, required, f"{age * 1e3:.3g} ms"
        )


@dataclass(frozen=True, kw_only=True)
class Obeys(_OfStreams):
    """Each message keeps the contract: names, finite numbers, limits, frame."""

    def _judge_one(self, topic: str, window: Window, heard: list[Heard]) -> Finding:
        wrong = [each.refusal for each in heard if each.sample is None]
        measured = f"{len(heard) - len(wrong)} of {len(heard)}"
        if wrong:
            measured += f"; the first other: {wrong[0]}"
        right = bool(heard) and not wrong
        return self._finding(
            topic, window, right, f"messages of {topic} that keep the contract", "all", measured
        )


@dataclass(frozen=True, kw_only=True)
class Silent(_OfStreams):
    """Nothing comes on the topics, from some time after the actions begin until they end."""

    after: float = within("so long after the actions begin, messages may still come", 0.0)

    def is_decided(self, window: Window, now_ns: int) -> bool:
        """Whether waiting longer changes nothing."""
        return now_ns >= window.end_ns + LATE * NANO

    def _judge_one(self, topic: str, window: Window, heard: list[Heard]) -> Finding:
        from_ns = window.begin_ns + round(self.after * NANO)
        late = [each for each in heard if each.stamp_ns > from_ns]
        return self._finding(
            topic, window, not late, f"messages of {topic} from {self.after:g} s on", "none",
            str(len(late)) if late else "none",
        )  # fmt: skip
