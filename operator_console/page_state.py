"""What the page shows at one time, live or from a bag, as plain values for JSON.

A frame combines ``telemetry`` with the ``PageState``: geometry of tether and rover, machine time,
and the journal.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Final

from msg_schemas import machine, topics
from msg_schemas.refusal import read_refusal
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
from operator_console.commands import COMMANDS
from operator_console.scene import BY_TRUTH, geometry, machine_of, place_of
from operator_console.telemetry import (
    TELEMETRY_TOPICS,
    CommandReport,
    NodeHealth,
    Snapshot,
    TelemetryReading,
)

PAGE_TOPICS: Final = tuple(
    dict.fromkeys([
        *TELEMETRY_TOPICS,
        topics.CLOCK,
        topics.CONFIG,
        topics.PLACE,
        topics.TRUTH_BODY1,
        topics.TRUTH_BODY2,
        topics.TRUTH_TETHER,
        topics.DESCENT_OBSERVATION,
    ])
)  # fmt: skip
"""Topics that the page needs."""

_STALE_AGE: Final = 1.0  # geometry older than this is stale [s]
_LOST_AGE: Final = 5.0  # geometry older than this is replaced by the payout [s]
_JOURNAL_LENGTH: Final = 300  # journal entries
_COMMANDS: Final = 8  # last commands in a frame
_SHOWN_AGE: Final = 3.0  # a smaller age is not shown [s]
_SEVERE_ALARMS: Final = frozenset({machine.SNAG, machine.OVER_TENSION})
_INFORMATIVE_ALARMS: Final = frozenset({machine.TOUCHDOWN})
_LEVELS: Final = {"OK": "ok", "WARN": "warn", "ERROR": "error", "STALE": "stale"}
_RANKS: Final = ("ok", "warn", "stale", "error")


@dataclass(frozen=True)
class JournalEntry:
    """One line of the journal.

    Attributes:
        time: machine time [s].
        level: ok, warn or error.
        source: node, or this console.
        title: event, refusal or order.
        text: message.
    """

    time: float
    level: str
    source: str
    title: str
    text: str

    def as_dict(self) -> dict[str, Any]:
        """Convert to a mapping for JSON."""
        return asdict(self) | {"time": round(self.time, 3)}


class PageState:
    """State that telemetry does not keep; processes the same samples."""

    def __init__(self) -> None:
        self.clock_ns: int | None = None
        self.machine: dict[str, Any] | None = None
        self.place: dict[str, Any] | None = None
        self.journal: deque[JournalEntry] = deque(maxlen=_JOURNAL_LENGTH)
        self._shape: dict[str, tuple[Any, float]] = {}
        self._payout: tuple[float, float] | None = None

    def on_sample(self, topic: str, sample: Any, now: float, time: float) -> list[JournalEntry]:
        """Process a sample.

        Args:
            topic: its topic.
            sample: sample of the contract.
            now: its arrival by a steady clock [s].
            time: machine time [s].

        Returns:
            New entries of the journal.
        """
        if topic == topics.CLOCK and isinstance(sample, ClockSample):
            self.clock_ns = sample.stamp_ns
        elif isinstance(sample, TetherSample | OdometrySample):
            self._shape[topic] = (sample, now)
        elif topic in {topics.WINCH_ESTIMATE, topics.WINCH_STATE}:
            self._on_payout(topic, sample, now)
        elif topic == topics.PLACE:
            self.place = place_of(sample)
        elif topic == topics.CONFIG and isinstance(sample, TextSample):
            self.machine = machine_of(sample.text) or self.machine
        elif isinstance(sample, StatusSample) and topic in {topics.EVENTS, topics.DIAGNOSTICS}:
            new_entries = entries(topic, sample.statuses, time)
            self.journal.extend(new_entries)
            return new_entries
        elif topic == topics.DESCENT_OBSERVATION and isinstance(sample, JointSample):
            new_entries = [_imaging_entry(sample, time)]
            self.journal.extend(new_entries)
            return new_entries
        return []

    def _on_payout(self, topic: str, sample: JointSample, now: float) -> None:
        name = machine.PAYOUT if topic == topics.WINCH_ESTIMATE else machine.WINCH_DRUM
        if name in sample.joints:
            self._payout = (sample.joints[name].position, now)

    def geometry(self, now: float) -> dict[str, Any] | None:
        """Geometry of tether and rover, its age [s], and whether it is stale."""
        recent = {topic: pair for topic, pair in self._shape.items() if now - pair[1] < _LOST_AGE}
        if not recent and self._payout is None:
            recent = self._shape
        body1, body2, tether = (
            recent.get(name, (None, -math.inf))
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
            "stale": age > _STALE_AGE,
            "tether": found.tether,
            "body1": found.body1,
            "body2": found.body2,
        }


def frame(snapshot: Snapshot, page_state: PageState, now: float, time: float) -> dict[str, Any]:
    """Everything that changes; ``now`` by a steady clock, ``time`` is machine time [s]."""
    parts = _parts(snapshot)
    return {
        "time": round(time, 3),
        "values": {each.key: _value(each) for each in snapshot.readings},
        "phases": {each.key: _phase(each) for each in snapshot.phases},
        "geometry": page_state.geometry(now),
        "parts": parts,
        "health": health(parts, has_plant=snapshot.has_plant),
        "mode": _mode(snapshot),
        "obstacles": obstacles(snapshot),
        "commands": [_command(each) for each in snapshot.commands[-_COMMANDS:]],
    }


def health(parts: Iterable[dict[str, Any]], *, has_plant: bool) -> dict[str, str]:
    """The worst level of all parts as one title and one line; not nominal without a plant."""
    found = list(parts)
    if not found:
        return {"level": "unknown", "title": "no data", "text": "no node reports its health"}
    worst = max((part["level"] for part in found), key=_RANKS.index)
    bad = [part for part in found if part["level"] == worst]
    if worst == "ok" and not has_plant:
        return {"level": "unknown", "title": "no plant", "text": "nothing was received from it"}
    if worst == "ok":
        return {"level": "ok", "title": "nominal", "text": f"all {len(found)} parts are OK"}
    title = {"warn": "warning", "error": "fault", "stale": "silent"}[worst]
    more = f" and {len(bad) - 1} more" if len(bad) > 1 else ""
    return {"level": worst, "title": title, "text": f"{bad[0]['name']}: {bad[0]['text']}{more}"}


def entries(topic: str, statuses: Iterable[Status], time: float) -> list[JournalEntry]:
    """Journal entries of statuses: every event and every refusal."""
    found = []
    for status in statuses:
        name = status.name.partition(": ")[2] or status.name
        if topic == topics.EVENTS or read_refusal(status) is not None:
            level = _LEVELS[status.level.name]
            text = status.message
            if "code" in status.values:
                text = f"{text} [{status.values['code']}]"
            found.append(JournalEntry(time, level, status.hardware_id, name, text))
    return found


def _imaging_entry(sample: JointSample, time: float) -> JournalEntry:
    values = {name: joint.position for name, joint in sample.joints.items()}
    text = f"of the wall at {values.get('depth', math.nan):.2f} m"
    if "smear" in values:
        text += f", smear {values['smear']:.2f} px"
    return JournalEntry(time, "ok", "camera", f"image {values.get('picture', 0):.0f}", text)


def _command(each: CommandReport) -> dict[str, Any]:
    level = "warn" if each.is_warning else "ok"
    return {
        "time": round(each.taken, 3),
        "title": f"{each.subject} {each.what}".rstrip(),
        "sender": each.name,
        "state": each.state,
        "progress": each.progress,
        "text": each.text,
        "level": level,
        "over": each.is_over,
    }


def _value(reading: TelemetryReading) -> list[Any]:
    value = reading.value if isinstance(reading.value, float) else None
    if value is not None and not math.isfinite(value):
        value = None
    age = None if reading.age is None else round(reading.age, 2)
    return [None if value is None else round(value, 5), age, reading.is_stale]


def _phase(reading: TelemetryReading) -> list[Any]:
    age = None if reading.age is None else round(reading.age, 2)
    return [reading.value or "", age, reading.is_stale, reading.is_warning]


def _mode(snapshot: Snapshot) -> str:
    """Whether the plant is absent, its data stale, its time paused, or all is live."""
    if not snapshot.has_plant:
        return "absent"
    return "stale" if snapshot.dangers else "paused" if snapshot.is_paused else "live"


def obstacles(snapshot: Snapshot) -> dict[str, str]:
    """Why each of the commands that move something would be refused, by name."""
    found = {
        name: snapshot.obstacle(command.nodes)
        for name, command in COMMANDS.items()
        if command.moves
    }
    return {name: why for name, why in found.items() if why}


def _parts(snapshot: Snapshot) -> list[dict[str, Any]]:
    """All parts with their states, the worst first."""
    found = [_part(each.part, "error", each.text) for each in snapshot.dangers]
    found += [_alarm(name) for name in snapshot.alarms]
    found += [_node(node) for node in snapshot.nodes]
    found += [_node(line, "link: ") for line in snapshot.link]
    found += [
        _part(title.label, "error", f"{title.text}")
        for title in snapshot.phases
        if title.is_warning and not title.is_stale
    ]
    found += [
        _part(f"{each.label} budget", "warn", f"{each.text} used: the attitude is not controlled")
        for each in snapshot.readings
        if each.is_warning and not each.is_stale
    ]
    if snapshot.simulation is not None:
        found.append(_simulation(snapshot.simulation))
    return sorted(found, key=lambda part: -_RANKS.index(part["level"]))


def _alarm(name: str) -> dict[str, Any]:
    level = "error" if name in _SEVERE_ALARMS else "ok" if name in _INFORMATIVE_ALARMS else "warn"
    return _part(f"winch: {name.replace('_', ' ')}", level, "detected by the winch")


def _part(name: str, level: str, text: str, age: float | None = None) -> dict[str, Any]:
    shown = None if age is None or age < _SHOWN_AGE else round(age, 1)
    return {"name": name, "level": level, "text": text, "age": shown}


def _node(node: NodeHealth, prefix: str = "") -> dict[str, Any]:
    name = prefix + node.node
    details = () if prefix and node.level == Level.OK.name else node.details
    if node.is_silent:
        level = "error" if node.level == Level.ERROR.name else "stale"
        texts = [node.lacks, f"last report: {node.condition}", *details]
        return _part(name, level, "; ".join(texts))
    return _part(name, _LEVELS[node.level], "; ".join([node.condition, *details]))


def _simulation(line: NodeHealth) -> dict[str, Any]:
    if line.is_silent:
        return _part("simulation", "stale", "silent", line.age)
    if line.level == Level.ERROR.name:
        return _part("simulation", "error", line.condition)
    if line.values.get("paused") == "true":
        return _part("simulation", "warn", "paused: simulated time is stopped")
    return _part("simulation", "ok", line.pace or line.condition)


class ValueHistory:
    """Values of the last minutes, for pages that are opened later."""

    def __init__(self, length: float, period: float) -> None:
        self._period = period
        self._frames: deque[dict[str, Any]] = deque(maxlen=max(1, round(length / period)))

    def add(self, made: dict[str, Any]) -> None:
        """Keep a frame's values if the last kept frame is a period older."""
        if self._frames:
            passed = made["time"] - self._frames[-1]["time"]
            if passed < 0.0:
                self._frames.clear()
            elif passed < self._period:
                return
        self._frames.append({"time": made["time"], "values": made["values"]})

    def frames(self) -> list[dict[str, Any]]:
        """Kept frames in order of time."""
        return list(self._frames)
