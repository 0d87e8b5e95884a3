"""What the page shows at one time, live or out of a bag: plain values that can be written as JSON.

A frame is made of what ``telemetry`` knows and of what an ``PageState`` has seen besides: where
tether and rover are, what time it is for the machine, and the journal.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from msg_schemas import topics
from msg_schemas.machine import PAYOUT, WINCH_DRUM
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    Level,
    OdometrySample,
    Status,
    StatusSample,
    TetherSample,
    TextSample,
)
from operator_console.scene import BY_TRUTH, geometry, machine_of, place_of
from operator_console.telemetry import HEARD, NodeHealth, Reading, Snapshot

SEEN: Final = tuple(
    dict.fromkeys([
        *HEARD,
        topics.CLOCK,
        topics.CONFIG,
        topics.PLACE,
        topics.TRUTH_BODY1,
        topics.TRUTH_BODY2,
        topics.TRUTH_TETHER,
        topics.DESCENT_OBSERVATION,
    ])
)  # fmt: skip
"""Topics of which a page is made."""

_OLD: Final = 1.0  # a shape that was told longer ago is old [s]
_GONE: Final = 5.0  # and then the payout tells more [s]
_KEPT: Final = 300  # journal entries
_YOUNG: Final = 3.0  # an age that needs no telling [s]
_BAD_ALARMS: Final = frozenset({"snag", "over_tension"})
_QUIET_ALARMS: Final = frozenset({"touchdown"})
_LEVELS: Final = {"OK": "ok", "WARN": "warn", "ERROR": "error", "STALE": "stale"}
_RANKS: Final = ("ok", "stale", "warn", "error")


@dataclass(frozen=True)
class Entry:
    """One line of the journal.

    Attributes:
        time: of the machine [s].
        level: ok, warn or error.
        source: node that says it, or who asked.
        title, text: what happened.
    """

    time: float
    level: str
    source: str
    title: str
    text: str

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "time": round(self.time, 3),
            "level": self.level,
            "source": self.source,
            "title": self.title,
            "text": self.text,
        }


class PageState:
    """Sees what telemetry does not keep; fed with the same samples."""

    def __init__(self) -> None:
        self.clock_ns: int | None = None
        self.machine: dict[str, Any] | None = None
        self.place: dict[str, Any] | None = None
        self.journal: deque[Entry] = deque(maxlen=_KEPT)
        self._shape: dict[str, tuple[Any, float]] = {}
        self._payout: tuple[float, float] | None = None

    def see(self, topic: str, sample: Any, now: float, time: float) -> list[Entry]:
        """Take a sample.

        Args:
            topic: it came by.
            sample: of the contract.
            now: its arrival by a steady clock [s].
            time: the machine's [s].

        Returns:
            What is new in the journal.
        """
        if topic == topics.CLOCK and isinstance(sample, ClockSample):
            self.clock_ns = sample.stamp_ns
        elif isinstance(sample, TetherSample | OdometrySample):
            self._shape[topic] = (sample, now)
        elif topic in {topics.WINCH_ESTIMATE, topics.WINCH_STATE}:
            self._see_payout(topic, sample, now)
        elif topic == topics.PLACE:
            self.place = place_of(sample)
        elif topic == topics.CONFIG and isinstance(sample, TextSample):
            self.machine = machine_of(sample.text) or self.machine
        elif isinstance(sample, StatusSample) and topic in {topics.EVENTS, topics.DIAGNOSTICS}:
            news = entries(topic, sample.statuses, time)
            self.journal.extend(news)
            return news
        elif topic == topics.DESCENT_OBSERVATION and isinstance(sample, JointSample):
            news = [_picture_taken(sample, time)]
            self.journal.extend(news)
            return news
        return []

    def _see_payout(self, topic: str, sample: JointSample, now: float) -> None:
        name = PAYOUT if topic == topics.WINCH_ESTIMATE else WINCH_DRUM
        if name in sample.joints:
            self._payout = (sample.joints[name].position, now)

    def geometry(self, now: float) -> dict[str, Any] | None:
        """Where tether and rover are, how long ago [s], and whether that is too long."""
        told = {topic: pair for topic, pair in self._shape.items() if now - pair[1] < _GONE}
        if not told and self._payout is None:
            told = self._shape
        body1, body2, tether = (
            told.get(name, (None, -math.inf))
            for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2, topics.TRUTH_TETHER)
        )
        payout = None if self._payout is None else self._payout[0]
        found = geometry(tether[0], body1[0], body2[0], payout)
        if found is None:
            return None
        at = max(tether[1], body1[1]) if found.source == BY_TRUTH or self._payout is None else (
            self._payout[1]
        )  # fmt: skip
        age = max(0.0, now - at)
        return {
            "source": found.source,
            "age": round(age, 2),
            "stale": age > _OLD,
            "tether": found.tether,
            "body1": found.body1,
            "body2": found.body2,
        }


def frame(snapshot: Snapshot, page_state: PageState, now: float, time: float) -> dict[str, Any]:
    """All that changes, at one time; ``now`` by the steady clock, ``time`` the machine's [s]."""
    parts = _parts(snapshot)
    return {
        "time": round(time, 3),
        "values": {each.key: _value(each) for each in snapshot.readings},
        "words": {each.key: _word(each) for each in snapshot.words},
        "geometry": page_state.geometry(now),
        "parts": parts,
        "health": health(parts),
    }


def health(parts: Iterable[dict[str, Any]]) -> dict[str, str]:
    """All parts in one word and one line: the worst says it."""
    found = list(parts)
    if not found:
        return {"level": "unknown", "word": "nothing heard", "text": "no node tells how it is"}
    worst = max((part["level"] for part in found), key=_RANKS.index)
    bad = [part for part in found if part["level"] == worst]
    if worst == "ok":
        return {"level": "ok", "word": "all well", "text": f"{len(found)} parts say so"}
    word = {"warn": "warning", "error": "fault", "stale": "silent"}[worst]
    more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
    return {"level": worst, "word": word, "text": f"{bad[0]['name']}: {bad[0]['text']}{more}"}


def entries(topic: str, statuses: Iterable[Status], time: float) -> list[Entry]:
    """What of statuses belongs into a journal: every event, and every refusal."""
    found = []
    for status in statuses:
        name = status.name.partition(": ")[2] or status.name
        if topic == topics.EVENTS or name.startswith("refused "):
            level = _LEVELS[status.level.name]
            text = status.message
            if "code" in status.values:
                text = f"{text} [{status.values['code']}]"
            found.append(Entry(time, level, status.hardware_id, name, text))
    return found


def _picture_taken(sample: JointSample, time: float) -> Entry:
    values = {name: joint.position for name, joint in sample.joints.items()}
    text = f"of the wall at {values.get('depth', math.nan):.2f} m"
    if "smear" in values:
        text += f", smear {values['smear']:.2f} px"
    return Entry(time, "ok", "camera", f"picture {values.get('picture', 0):.0f}", text)


def _value(reading: Reading) -> list[Any]:
    value = reading.value if isinstance(reading.value, float) else None
    if value is not None and not math.isfinite(value):
        value = None
    age = None if reading.age is None else round(reading.age, 2)
    return [None if value is None else round(value, 5), age, reading.is_stale]


def _word(reading: Reading) -> list[Any]:
    age = None if reading.age is None else round(reading.age, 2)
    return [reading.value or "", age, reading.is_stale, reading.is_warning]


def _parts(snapshot: Snapshot) -> list[dict[str, Any]]:
    found = [_alarm(name) for name in snapshot.alarms]
    found += [
        _part(word.label, "error", f"{word.text}")
        for word in snapshot.words
        if word.is_warning and not word.is_stale
    ]
    found += [
        _part(f"{each.label} budget", "warn", f"{each.text} used: the attitude is not held")
        for each in snapshot.readings
        if each.is_warning and not each.is_stale
    ]
    found += [_node(node) for node in snapshot.nodes]
    found += [_node(line, "link: ") for line in snapshot.link]
    if snapshot.simulation is not None:
        found.append(_simulation(snapshot.simulation))
    return found


def _alarm(name: str) -> dict[str, Any]:
    level = "error" if name in _BAD_ALARMS else "ok" if name in _QUIET_ALARMS else "warn"
    return _part(f"winch: {name.replace('_', ' ')}", level, "the winch has found it")


def _part(name: str, level: str, text: str, age: float | None = None) -> dict[str, Any]:
    shown = None if age is None or age < _YOUNG else round(age, 1)
    return {"name": name, "level": level, "text": text, "age": shown}


def _node(node: NodeHealth, prefix: str = "") -> dict[str, Any]:
    name = prefix + node.node
    if node.is_silent:
        return _part(name, "stale", f"silent; it said: {node.condition}", node.age)
    details = () if prefix and node.level == Level.OK.name else node.details
    return _part(name, _LEVELS[node.level], "; ".join([node.condition, *details]))


def _simulation(line: NodeHealth) -> dict[str, Any]:
    values = dict(each.split(": ", 1) for each in line.details if ": " in each)
    if line.is_silent:
        return _part("simulation", "stale", "silent", line.age)
    factor = values.get("measured_real_time_factor", "")
    if values.get("paused") == "true":
        return _part("simulation", "warn", "paused: simulated time stands still")
    # Whether that is well is told by the node itself.
    speed = f"{float(factor):.1f} × real time" if _is_number(factor) else line.condition
    return _part("simulation", "ok", speed)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


class History:
    """Values of the last minutes, for pages that come later."""

    def __init__(self, length: float, period: float) -> None:
        self._period = period
        self._frames: deque[dict[str, Any]] = deque(maxlen=max(1, round(length / period)))

    def add(self, made: dict[str, Any]) -> None:
        """Keep a frame's values, if the last one is old enough."""
        if self._frames:
            passed = made["time"] - self._frames[-1]["time"]
            if passed < 0.0:
                self._frames.clear()
            elif passed < self._period:
                return
        self._frames.append({"time": made["time"], "values": made["values"]})

    def frames(self) -> list[dict[str, Any]]:
        """What is kept, in order of time."""
        return list(self._frames)
