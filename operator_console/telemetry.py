"""What an operator wants to know now: values with their ages, health of every node. Pure.

It is fed with samples of the contract and a steady time of their arrival. A value that is older
than its topic allows is shown as stale and not hidden: what was last known is still worth knowing.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS
from msg_schemas.codecs import topic_row
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    Level,
    Status,
    StatusSample,
    TextSample,
    WrenchSample,
)

SILENT_AFTER = 3.0
"""A node whose health (1 Hz) was not heard for longer is silent [s]."""

_DEGREES = 180.0 / math.pi
_SLOWEST = 1.0  # a value that is younger is never stale [s]
_MISSED = 5.0  # so many messages of a topic may be missed
_AT_REST = 2e-3  # payout rates below count as rest [m/s]
_WHILE_NS = 500_000_000  # for which a drum must rest that is at rest
_DRUM_KEPT = 1000
_KEPT = 50  # refusals and events


@dataclass(frozen=True)
class Quantity:
    """A number that is shown.

    Attributes:
        key: name for programs.
        label, unit: for people.
        group: heading under which it stands.
        sources: topics with the number's path, the best first: the first that is fresh is shown.
        scale: the shown unit's per contract's unit.
        digits: behind the point.
        warn_above: a magnitude beyond which it is told as a warning, in the shown unit.
        words: of a switch, what 0 and 1 mean.
    """

    key: str
    label: str
    unit: str
    group: str
    sources: tuple[tuple[str, str], ...]
    scale: float = 1.0
    digits: int = 2
    warn_above: float = math.inf
    words: tuple[str, str] | None = None


def _of_descent(
    key: str, label: str, unit: str, group: str, joint: str, part: str = "position",
    scale: float = 1.0, digits: int = 2, warn_above: float = math.inf,
) -> Quantity:  # fmt: skip
    source = (topics.DESCENT_STATE, f"{joint}.{part}")
    return Quantity(key, label, unit, group, (source,), scale, digits, warn_above)


_BUDGETS = tuple(
    _of_descent(f"{key}_budget", label, "%", "momentum budgets", joint, "position", 100.0, 0, 100.0)
    for key, label, joint in (
        ("wheels", "wheels", machine.WHEEL_BUDGET),
        ("flywheel", "flywheel", machine.FLYWHEEL_BUDGET),
        ("travel", "screw's travel", machine.TRAVEL_BUDGET),
    )
)

QUANTITIES: tuple[Quantity, ...] = (
    Quantity(
        "depth", "depth", "m", "tether",
        (
            (topics.WINCH_ESTIMATE, f"{machine.PAYOUT}.position"),
            (topics.WINCH_STATE, f"{machine.WINCH_DRUM}.position"),
        ), digits=3,
    ),
    Quantity(
        "payout_rate", "payout rate", "m/s", "tether",
        (
            (topics.WINCH_ESTIMATE, f"{machine.PAYOUT}.velocity"),
            (topics.WINCH_STATE, f"{machine.WINCH_DRUM}.velocity"),
        ), digits=3,
    ),
    Quantity(
        "tension", "tension", "N", "tether",
        (
            (topics.WINCH_ESTIMATE, f"{machine.TENSION}.effort"),
            (topics.LOAD_CELL, "force"),
        ),
    ),
    Quantity(
        "brake_released", "brake", "", "tether",
        ((topics.WINCH_STATE, f"{machine.WINCH_BRAKE}.position"),), words=("closed", "released"),
    ),
    _of_descent("depth_goal", "depth aimed at", "m", "descent", machine.DEPTH_GOAL, digits=3),
    _of_descent("stops_left", "stops left", "", "descent", machine.STOPS_LEFT, digits=0),
    _of_descent(
        "swing_major", "swing", "deg", "swing and attitude", machine.SWING_MAJOR, scale=_DEGREES
    ),
    _of_descent(
        "swing_minor", "across", "deg", "swing and attitude", machine.SWING_MINOR, scale=_DEGREES
    ),
    _of_descent("heading", "heading", "deg", "swing and attitude", machine.HEADING,
                scale=_DEGREES, digits=1),
    _of_descent("camera_rate", "camera turns", "deg/s", "swing and attitude", machine.CAMERA_RATE,
                "velocity", _DEGREES),
    *_BUDGETS,
    Quantity(
        "driven", "driven", "m", "drive",
        ((topics.DRIVE_STATE, f"{machine.FORWARD}.position"),),
    ),
    Quantity(
        "to_goal", "to the goal", "m", "drive",
        ((topics.DRIVE_STATE, f"{machine.GOAL_DISTANCE}.position"),),
    ),
    Quantity(
        "compression", "nut (+ compresses)", "m", "jump",
        ((topics.JUMP_MOTOR_STATE, f"{machine.JUMP_SCREW}.position"),), digits=3,
    ),
)  # fmt: skip

WORDS: Mapping[str, tuple[str, str]] = {
    topics.WINCH_MODE: ("winch", "winch"),
    topics.TENSION_WATCH: ("tension_watch", "load"),
    topics.DESCENT_PHASE: ("descent", "descent"),
    topics.JUMP_PHASE: ("jump", "jump"),
    topics.DRIVE_PHASE: ("drive", "drive"),
    topics.TRUTH_PHASE: ("plant", "plant"),
}
"""Topics of words: key and label of what each says."""

_SPEAKERS: Mapping[str, frozenset[str]] = {
    topic: frozenset(node for node, access in ACCESS.items() if topic in access.publishes)
    for topic in WORDS
}
"""Nodes that may say these words: the plant is played by several."""

HEARD: tuple[str, ...] = tuple(
    dict.fromkeys([
        topics.DIAGNOSTICS,
        topics.EVENTS,
        topics.CONFIG,
        topics.WINCH_ALARMS,
        topics.LINK_STATUS,
        topics.SIM_STATUS,
        *WORDS,
        *(topic for row in QUANTITIES for topic, _ in row.sources),
    ])
)  # fmt: skip
"""Topics that it is fed with."""


@dataclass(frozen=True)
class Reading:
    """One value as it is known now.

    Attributes:
        value: number or word; None = never heard.
        age: since it was heard [s]; None = never heard.
        is_stale: it should have been heard again, or who said it is silent.
        is_warning: it is beyond what is right.
        text: as it is shown.
    """

    key: str
    label: str
    group: str
    unit: str
    value: float | str | None
    age: float | None
    is_stale: bool
    is_warning: bool
    text: str


@dataclass(frozen=True)
class NodeHealth:
    """What a node says of itself.

    Attributes:
        condition: `ready`, or what it waits for.
        level: `OK`, `WARN`, `ERROR`; of the worst that it says.
        is_silent: it was not heard for longer than `SILENT_AFTER`.
        details: what else it says, where that is not in order.
    """

    node: str
    condition: str
    level: str
    age: float
    is_silent: bool
    details: tuple[str, ...]


@dataclass(frozen=True)
class Told:
    """A refusal, or an event.

    Attributes:
        stamp: when it was told, by its node's clock [s].
        age: since it was heard; what is kept for late comers was told before that.
    """

    node: str
    name: str
    message: str
    level: str
    stamp: float
    age: float
    values: Mapping[str, str]


@dataclass(frozen=True)
class Snapshot:
    """Everything at one time; plain values throughout."""

    readings: tuple[Reading, ...]
    words: tuple[Reading, ...]
    alarms: tuple[str, ...]
    nodes: tuple[NodeHealth, ...]
    link: tuple[NodeHealth, ...]
    simulation: NodeHealth | None
    refusals: tuple[Told, ...]
    events: tuple[Told, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def reading(self, key: str) -> Reading:
        """A value or word by its key."""
        return next(each for each in (*self.readings, *self.words) if each.key == key)


class _DrumSeen(NamedTuple):
    heard: float  # [s]
    stamp_ns: int
    rests: bool


def _rests(drum: JointSample) -> bool:
    brake = drum.joints.get(machine.WINCH_BRAKE)
    is_closed = brake is None or brake.position < 0.5
    return is_closed and abs(drum.joints[machine.WINCH_DRUM].velocity) < _AT_REST


class Telemetry:
    """What was heard last of everything; not locked, whoever shares it does that."""

    def __init__(self) -> None:
        self._numbers: dict[str, tuple[Mapping[str, float], float]] = {}
        self._words: dict[str, tuple[str, float]] = {}
        self._alarms: tuple[str, ...] = ()
        self._health: dict[str, dict[str, Status]] = {}
        self._heard: dict[str, float] = {}
        self._link: dict[str, tuple[Status, float]] = {}
        self._simulation: tuple[Status, float] | None = None
        self._refusals: deque[tuple[Status, int, float]] = deque(maxlen=_KEPT)
        self._events: deque[tuple[Status, int, float]] = deque(maxlen=_KEPT)
        self._drum: deque[_DrumSeen] = deque(maxlen=_DRUM_KEPT)
        self._parameters: dict[str, Mapping[str, Any]] = {}
        self.clock_ns: int | None = None

    def hear(self, topic: str, sample: Any, now: float) -> None:
        """Take a sample; ``now`` is its arrival by a steady clock [s]."""
        if isinstance(sample, StatusSample):
            for status in sample.statuses:
                self._on_status(topic, status, sample.stamp_ns, now)
        elif topic == topics.CONFIG:
            content = json.loads(sample.text)
            if isinstance(content, dict) and isinstance(content.get("parameters"), dict):
                node = str(content.get("node", "")).rpartition("/")[2]
                self._parameters[node] = content["parameters"]
        elif isinstance(sample, TextSample):
            self._words[topic] = (sample.text, now)
        elif isinstance(sample, ClockSample):
            self.clock_ns = sample.stamp_ns
        elif isinstance(sample, WrenchSample):
            self._numbers[topic] = ({"force": math.hypot(*sample.force)}, now)
        elif isinstance(sample, JointSample):
            self._numbers[topic] = (dict(sample.scalars()), now)
            if topic == topics.WINCH_STATE:
                self._drum.append(_DrumSeen(now, sample.stamp_ns, _rests(sample)))
            if topic == topics.WINCH_ALARMS:
                joints = sample.joints.items()
                self._alarms = tuple(name for name, value in joints if value.position > 0.5)

    def _on_status(self, topic: str, status: Status, stamp_ns: int, now: float) -> None:
        if topic == topics.EVENTS:
            self._events.append((status, stamp_ns, now))
        elif topic == topics.LINK_STATUS:
            self._link[status.name] = (status, now)
        elif topic == topics.SIM_STATUS:
            self._simulation = (status, now)
        elif topic == topics.DIAGNOSTICS:
            node = status.hardware_id or status.name.partition(":")[0]
            what = status.name.partition(": ")[2]
            if what.startswith("refused "):
                self._refusals.append((status, stamp_ns, now))
            elif what == "node":
                self._heard[node] = now
                self._health[node] = {what: status}  # what it says besides follows at once
            else:
                self._health.setdefault(node, {})[what] = status

    # --- asked ---------------------------------------------------------------------------------

    def is_heard(self, node: str, now: float) -> bool:
        """Whether a node tells its health."""
        return now - self._heard.get(node, -math.inf) <= SILENT_AFTER

    @property
    def hears_anybody(self) -> bool:
        """Whether a node has told its health."""
        return bool(self._heard)

    @property
    def knows_phases(self) -> bool:
        """Whether every node that is heard has said what it is doing."""
        return all(topic in self._words for topic in WORDS if self._heard.keys() & _SPEAKERS[topic])

    def word(self, topic: str) -> str:
        """What a topic of words says; empty = never heard."""
        return self._words.get(topic, ("", 0.0))[0]

    def number(self, topic: str, path: str) -> float | None:
        """A topic's number; None = never heard."""
        return self._numbers.get(topic, ({}, 0.0))[0].get(path)

    def parameter(self, node: str, name: str) -> Any:
        """A node's parameter, as it told its configuration last; None = not known."""
        return self._parameters.get(node, {}).get(name)

    @property
    def is_idle(self) -> bool | None:
        """Whether no descent is under way; None = not known."""
        phase = self.word(topics.DESCENT_PHASE)
        return phase in {"released", "standby"} if phase else None

    @property
    def depth(self) -> float | None:
        """Length at the drum [m]; None = not known."""
        return self.number(topics.WINCH_STATE, f"{machine.WINCH_DRUM}.position")

    def is_at_rest(self, since: float) -> bool:
        """Whether drum and nut have rested for a while, brake closed, since a time of hearing [s].

        The while counts by the drum's stamps: simulated time may be slow.
        """
        if self.word(topics.JUMP_PHASE) in {"compressing", "letting_down"} or not self._drum:
            return False
        last_ns = self._drum[-1].stamp_ns
        for seen in reversed(self._drum):
            if not seen.rests or seen.heard <= since:
                return False
            if last_ns - seen.stamp_ns >= _WHILE_NS:
                return True
        return False

    def snapshot(self, now: float) -> Snapshot:
        """All of it, at a time."""
        return Snapshot(
            tuple(self._reading(row, now) for row in QUANTITIES),
            tuple(self._word_reading(topic, now) for topic in WORDS),
            self._alarms,
            tuple(self._node(name, now) for name in sorted(self._heard)),
            tuple(_line(status, now - at) for status, at in self._link.values()),
            None if self._simulation is None
            else _line(self._simulation[0], now - self._simulation[1]),
            tuple(_told(status, stamp, now - at) for status, stamp, at in self._refusals),
            tuple(_told(status, stamp, now - at) for status, stamp, at in self._events),
        )  # fmt: skip

    def _reading(self, row: Quantity, now: float) -> Reading:
        found: tuple[float, float, str] | None = None
        for topic, path in row.sources:
            values, at = self._numbers.get(topic, ({}, 0.0))
            if path not in values or not _is_known(topic, path, values):
                continue
            if found is None or _is_old(found[2], now - found[1]):
                found = (values[path], at, topic)
        if found is None:
            return Reading(row.key, row.label, row.group, row.unit, None, None, True, False, "–")
        value, age = found[0] * row.scale, now - found[1]
        shown = f"{value:.{row.digits}f}"
        if float(shown) == 0.0:
            shown = shown.lstrip("-")
        text = f"{shown} {row.unit}".rstrip()
        if row.words is not None:
            text = row.words[value > 0.5]
        stale = _is_old(found[2], age)
        warns = abs(value) > row.warn_above
        return Reading(row.key, row.label, row.group, row.unit, value, age, stale, warns, text)

    def _word_reading(self, topic: str, now: float) -> Reading:
        key, label = WORDS[topic]
        said = self._words.get(topic)
        if said is None:
            return Reading(key, label, "phases", "", None, None, True, False, "–")
        word, at = said
        stale = not any(self.is_heard(node, now) for node in _SPEAKERS[topic])
        warns = word in {"fault", "over_tension", "diverged", "tether_broken"}
        return Reading(key, label, "phases", "", word, now - at, stale, warns, word)

    def _node(self, name: str, now: float) -> NodeHealth:
        statuses = self._health[name]
        own = statuses.get("node")
        condition = own.message if own is not None else "?"
        bad = tuple(
            f"{what}: {status.message}"
            for what, status in statuses.items()
            if status.level is not Level.OK and what != "node"
        )
        worst = max((status.level for status in statuses.values()), default=Level.OK)
        age = now - self._heard[name]
        return NodeHealth(name, condition, worst.name, age, age > SILENT_AFTER, bad)


def _is_known(topic: str, path: str, values: Mapping[str, float]) -> bool:
    """The winch tells an unknown tension as 0, and that it is not valid."""
    if topic == topics.WINCH_ESTIMATE and path == f"{machine.TENSION}.effort":
        return values.get(f"{machine.TENSION}.position", 0.0) > 0.5
    return True


def _is_old(topic: str, age: float) -> bool:
    rate = topic_row(topic).rate
    return rate is not None and age > max(_SLOWEST, _MISSED / rate)


def _line(status: Status, age: float) -> NodeHealth:
    name = status.name.partition(": ")[2] or status.name
    details = tuple(f"{key}: {value}" for key, value in status.values.items())
    return NodeHealth(name, status.message, status.level.name, age, age > SILENT_AFTER, details)


def _told(status: Status, stamp_ns: int, age: float) -> Told:
    name = status.name.partition(": ")[2] or status.name
    level, values = status.level.name, dict(status.values)
    return Told(status.hardware_id, name, status.message, level, stamp_ns * 1e-9, age, values)
