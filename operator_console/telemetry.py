"""The machine's state for operators: values with their ages, health of every node.

It processes samples of the contract with their steady arrival times. A value that is older than its
topic allows is marked stale, not hidden.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeVar

from msg_schemas import machine, topics
from msg_schemas.access import ACCESS, Act, node_that, nodes_that
from msg_schemas.commands import CommandRecord, CommandTable, read_command
from msg_schemas.health import read_health
from msg_schemas.phases import (
    DescentPhase,
    HealthState,
    JumpPhase,
    LoadState,
    PlantPhase,
    WinchMode,
)
from msg_schemas.refusal import read_refusal
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    Level,
    Status,
    StatusSample,
    TextSample,
    WrenchSample,
)
from msg_schemas.table import find_topic
from operator_console.liveness import DEAD_AFTER, SILENT_AFTER, Danger, Liveness

_DEGREES = 180.0 / math.pi
_REST_SPEED = 2e-3  # payout rate below which the drum is at rest [m/s]
_REST_TIME_NS = 500_000_000  # time below that rate
_DRUM_SAMPLES = 1000
_REPORTS = 50  # refusals, events and commands
_STREAMS = {
    node: topic
    for topic in (
        topics.WINCH_ESTIMATE,
        topics.DESCENT_STATE,
        topics.DRIVE_STATE,
        topics.SIM_STATUS,
        topics.LINK_STATUS,
    )
    for node in nodes_that(Act.PUBLISH, topic)
}
"""A topic that a node alone publishes at its rate; only one plant runs."""
_WINCH = node_that(Act.PUBLISH, topics.WINCH_ESTIMATE)
_BRIDGE = node_that(Act.PUBLISH, topics.LINK_STATUS)
_INACTIVE = HealthState.INACTIVE.value
_NAMES = 64  # nodes, and statuses of a node

T = TypeVar("T")


_BAD_WORDS = frozenset(
    {
        WinchMode.FAULT,
        LoadState.OVER_TENSION,
        PlantPhase.DIVERGED,
        PlantPhase.TETHER_BROKEN,
    }
)
"""Words that the console shows as warnings; `fault` is also that of the jump."""


@dataclass(frozen=True)
class Quantity:
    """A number that is shown.

    Attributes:
        key: name for programs.
        label: name for people.
        unit: unit for people.
        group: heading.
        sources: topics and paths of the number, the best first; the first fresh one is shown.
        scale: shown units per contract unit.
        digits: decimals.
        warn_above: magnitude above which it is a warning, in the shown unit.
        states: names of 0 and 1, if the number is a switch.
    """

    key: str
    label: str
    unit: str
    group: str
    sources: tuple[tuple[str, str], ...]
    scale: float = 1.0
    digits: int = 2
    warn_above: float = math.inf
    states: tuple[str, str] | None = None


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
        ("travel", "screw travel", machine.TRAVEL_BUDGET),
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
        ((topics.WINCH_STATE, f"{machine.WINCH_BRAKE}.position"),), states=("closed", "released"),
    ),
    _of_descent("depth_goal", "depth goal", "m", "descent", machine.DEPTH_GOAL, digits=3),
    _of_descent("stops_left", "stops left", "", "descent", machine.STOPS_LEFT, digits=0),
    _of_descent(
        "swing_major", "swing, major axis", "deg", "swing and attitude", machine.SWING_MAJOR,
        scale=_DEGREES,
    ),
    _of_descent(
        "swing_minor", "swing, minor axis", "deg", "swing and attitude", machine.SWING_MINOR,
        scale=_DEGREES,
    ),
    _of_descent("heading", "heading", "deg", "swing and attitude", machine.HEADING,
                scale=_DEGREES, digits=1),
    _of_descent("camera_rate", "camera rate", "deg/s", "swing and attitude", machine.CAMERA_RATE,
                "velocity", _DEGREES),
    *_BUDGETS,
    Quantity(
        "driven", "distance driven", "m", "drive",
        ((topics.DRIVE_STATE, f"{machine.FORWARD}.position"),),
    ),
    Quantity(
        "to_goal", "distance to goal", "m", "drive",
        ((topics.DRIVE_STATE, f"{machine.GOAL_DISTANCE}.position"),),
    ),
    Quantity(
        "compression", "nut position (+ compresses)", "m", "jump",
        ((topics.JUMP_MOTOR_STATE, f"{machine.JUMP_SCREW}.position"),), digits=3,
    ),
)  # fmt: skip

PHASE_TOPICS: Mapping[str, tuple[str, str]] = {
    topics.MISSION_PHASE: ("mission", "mission"),
    topics.WINCH_MODE: ("winch", "winch"),
    topics.TENSION_WATCH: ("tension_watch", "load"),
    topics.DESCENT_PHASE: ("descent", "descent"),
    topics.JUMP_PHASE: ("jump", "jump"),
    topics.DRIVE_PHASE: ("drive", "drive"),
    topics.TRUTH_PHASE: ("plant", "plant"),
}
"""Topics of phases and modes: key and label of each."""

_PUBLISHERS: Mapping[str, frozenset[str]] = {
    topic: frozenset(node for node, access in ACCESS.items() if topic in access.publishes)
    for topic in PHASE_TOPICS
}
"""Nodes that may publish each phase; several nodes may act as the plant."""

TELEMETRY_TOPICS: tuple[str, ...] = tuple(
    dict.fromkeys([
        topics.DIAGNOSTICS,
        topics.EVENTS,
        topics.COMMANDS,
        topics.CONFIG,
        topics.WINCH_ALARMS,
        topics.LINK_STATUS,
        topics.SIM_STATUS,
        *PHASE_TOPICS,
        *(topic for row in QUANTITIES for topic, _ in row.sources),
    ])
)  # fmt: skip
"""Topics that it processes."""


@dataclass(frozen=True)
class TelemetryReading:
    """One value at one time.

    Attributes:
        value: number or phase; None = never received.
        age: time since its arrival [s]; None = never received.
        is_stale: whether its topic is dead or its node is silent.
        is_warning: whether it is outside its normal range.
        text: as shown.
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
    """Health of a node, as it reports it.

    Attributes:
        condition: `ready`, or what it waits for.
        level: `OK`, `WARN`, `ERROR`: the worst of its reports.
        age: time since its last report [s].
        is_silent: whether its reports or its stream are missing.
        details: its other reports that are not OK.
        lacks: what is missing if it is silent, for people.
    """

    node: str
    condition: str
    level: str
    age: float
    is_silent: bool
    details: tuple[str, ...]
    lacks: str = ""

    @property
    def values(self) -> dict[str, str]:
        """Its reported values by name."""
        return dict(detail.split(": ", 1) for detail in self.details if ": " in detail)

    @property
    def pace(self) -> str:
        """The speed that a simulation reaches; empty if it reports none."""
        try:
            factor = float(self.values.get("measured_real_time_factor", ""))
        except ValueError:
            return ""
        return f"{factor:.1f} × real time" if math.isfinite(factor) else ""


@dataclass(frozen=True)
class StatusReport:
    """A refusal or an event.

    Attributes:
        stamp: time of the report by the node's clock [s].
        age: time since its arrival [s]; a latched report is older than that.
    """

    node: str
    name: str
    message: str
    level: str
    stamp: float
    age: float
    values: Mapping[str, str]


@dataclass(frozen=True)
class CommandReport:
    """A command and what became of it.

    Attributes:
        subject: topic or service.
        name: sender and identifier; without a sender the identifier alone.
        what: its content.
        taken, changed: by the node's clock [s].
        state, reason: words of the contract; an empty reason = it has not ended.
        text: reason or present activity, for people.
        progress: fraction done; None = unknown.
        is_over: whether it never changes again.
        is_warning: whether it did not end as requested.
    """

    node: str
    subject: str
    name: str
    what: str
    taken: float
    changed: float
    state: str
    reason: str
    text: str
    progress: float | None
    is_over: bool
    is_warning: bool


@dataclass(frozen=True)
class Snapshot:
    """The whole state at one time, in plain values.

    Attributes:
        has_plant: whether a simulation or a link is there.
        is_paused: whether simulated time is.
        is_clock_over: whether drives on a link have followed a simulation, whose clock stands.
    """

    readings: tuple[TelemetryReading, ...]
    phases: tuple[TelemetryReading, ...]
    alarms: tuple[str, ...]
    nodes: tuple[NodeHealth, ...]
    link: tuple[NodeHealth, ...]
    simulation: NodeHealth | None
    refusals: tuple[StatusReport, ...]
    events: tuple[StatusReport, ...]
    commands: tuple[CommandReport, ...]
    dangers: tuple[Danger, ...] = ()
    has_plant: bool = False
    is_paused: bool = False
    is_clock_over: bool = False

    def obstacle(self, nodes: Collection[str]) -> str:
        """Why nothing may be moved through any of these nodes, for people; empty = it may."""
        if self.dangers:
            return f"{self.dangers[0].part}: {self.dangers[0].text}"
        if not self.has_plant:
            return "no plant: nothing was received from it"
        known = [each for each in self.nodes if each.node in nodes]
        reasons = [each.lacks or _INACTIVE * (each.condition == _INACTIVE) for each in known]
        if not all(reasons):
            return ""
        found = [f"{each.node}: {why}" for each, why in zip(known, reasons, strict=True)]
        return "; ".join(found) or f"{' or '.join(nodes)} does not run"

    def as_dict(self) -> dict[str, Any]:
        """Convert to a mapping for JSON."""
        return asdict(self)

    def reading(self, key: str) -> TelemetryReading:
        """A value or phase by its key."""
        return next(each for each in (*self.readings, *self.phases) if each.key == key)


class _DrumSample(NamedTuple):
    received: float  # [s]
    stamp_ns: int
    is_at_rest: bool


def _is_drum_at_rest(drum: JointSample) -> bool:
    brake = drum.joints.get(machine.WINCH_BRAKE)
    is_closed = brake is None or brake.position < 0.5
    return is_closed and abs(drum.joints[machine.WINCH_DRUM].velocity) < _REST_SPEED


class Telemetry:
    """The latest sample of every topic. Not thread-safe: the caller locks.

    Args:
        patience: gap between samples up to which every source lives [s].
    """

    def __init__(self, patience: float = DEAD_AFTER) -> None:
        self._numbers: dict[str, tuple[Mapping[str, float], float]] = {}
        self._texts: dict[str, tuple[str, float]] = {}
        self._alarms: tuple[str, ...] = ()
        # By node, those that have reported last.
        self._health: dict[str, dict[str, Status]] = {}
        self._last_received: dict[str, float] = {}
        self._reported_ns: dict[str, int] = {}
        self._link: dict[str, tuple[Status, float]] = {}
        self._simulation: tuple[Status, float] | None = None
        self._refusals: deque[tuple[Status, int, float]] = deque(maxlen=_REPORTS)
        self._events: deque[tuple[Status, int, float]] = deque(maxlen=_REPORTS)
        self.commands = CommandTable(_REPORTS)
        self._drum: deque[_DrumSample] = deque(maxlen=_DRUM_SAMPLES)
        self._parameters: dict[str, Mapping[str, Any]] = {}
        self._liveness = Liveness(patience)

    def on_sample(self, topic: str, sample: Any, now: float) -> None:
        """Process a sample; ``now`` is its arrival by a steady clock [s]."""
        self._liveness.on_sample(topic, now)
        if isinstance(sample, StatusSample):
            for status in sample.statuses:
                self._on_status(topic, status, sample.stamp_ns, now)
        elif topic == topics.CONFIG:
            content = json.loads(sample.text)
            if isinstance(content, dict) and isinstance(content.get("parameters"), dict):
                node = str(content.get("node", "")).rpartition("/")[2]
                _keep(self._parameters, node, content["parameters"])
        elif isinstance(sample, TextSample):
            self._texts[topic] = (sample.text, now)
        elif isinstance(sample, ClockSample):
            self._liveness.on_clock(sample.stamp_ns, now)
        elif isinstance(sample, WrenchSample):
            self._numbers[topic] = ({"force": math.hypot(*sample.force)}, now)
        elif isinstance(sample, JointSample):
            self._numbers[topic] = (dict(sample.scalars()), now)
            if topic == topics.WINCH_STATE:
                self._drum.append(_DrumSample(now, sample.stamp_ns, _is_drum_at_rest(sample)))
            if topic == topics.WINCH_ALARMS:
                joints = sample.joints.items()
                self._alarms = tuple(name for name, value in joints if value.position > 0.5)

    def _on_status(self, topic: str, status: Status, stamp_ns: int, now: float) -> None:
        if topic == topics.EVENTS:
            self._events.append((status, stamp_ns, now))
            self.commands.on_event(status, stamp_ns)
        elif topic == topics.COMMANDS:
            record = read_command(status)
            if record is not None:
                self.commands.on_record(record, stamp_ns)
        elif topic == topics.LINK_STATUS:
            _keep(self._link, status.name, (status, now))
        elif topic == topics.SIM_STATUS:
            self._simulation = (status, now)
            self._liveness.on_pause(status.values.get("paused") == "true", now)
        elif topic == topics.DIAGNOSTICS:
            node = status.hardware_id or status.name.partition(":")[0]
            what = status.name.partition(": ")[2]
            if read_refusal(status) is not None:
                self._refusals.append((status, stamp_ns, now))
            elif (health := read_health(status)) is not None:
                # Its other reports follow at once; those of its end hold the reason.
                ended = health.state is HealthState.INACTIVE
                kept = _errors(self._health.get(node, {})) if ended else {}
                _keep(self._last_received, node, now)
                _keep(self._reported_ns, node, stamp_ns)
                _keep(self._health, node, {**kept, what: status})
            elif node in self._health:
                _keep(self._health[node], what, status)

    def _is_inactive(self, node: str) -> bool:
        own = self._health.get(node, {}).get("node")
        health = None if own is None else read_health(own)
        return health is not None and health.state is HealthState.INACTIVE

    def _has_ended(self, node: str, now: float) -> bool:
        """Whether a node was inactive at last and reports nothing any more: it ended well."""
        failed = bool(_errors(self._health.get(node, {})))
        return self._is_inactive(node) and not failed and not self.is_alive(node, now)

    def _lacks(self, node: str, now: float) -> str:
        """What is missing of a node that should work, for people; empty = nothing."""
        age = now - self._last_received.get(node, now)
        if age > SILENT_AFTER:
            return f"silent for {age:.0f} s"
        stream = _STREAMS.get(node, "")
        if not stream or self._is_inactive(node):
            return ""
        return self._dead(stream, now)

    def _dead(self, topic: str, now: float) -> str:
        """How long nothing valid has arrived on a topic, for people; empty = it lives."""
        age = self._liveness.dead_for(topic, now)
        return "" if age is None else f"dead: nothing valid on {topic} for {age:.0f} s"

    def _has_link(self, now: float) -> bool:
        return bool(self._link) and not self._has_ended(_BRIDGE, now)

    def _is_simulation_over(self, now: float) -> bool:
        """Whether there was a simulation whose node has ended well; its clock stands then."""
        return self._simulation is not None and self._has_ended(
            self._simulation[0].hardware_id, now
        )

    def _has_plant(self, now: float) -> bool:
        if self._simulation is None:
            return self._liveness.has_plant and not self._has_ended(_BRIDGE, now)
        return not self._is_simulation_over(now) or self._has_link(now)

    def dangers(self, now: float) -> tuple[Danger, ...]:
        """The dead or stopped plant, link and winch, the worst first.

        Nothing that moves the rover should be commanded meanwhile. What was never received, or has
        ended well, is absent and not dead.
        """
        if not self._has_plant(now):
            return ()
        found = {
            "plant": self._fault_of_plant(now),
            "link": self._fault_of_link(now),
            "winch": "" if self._is_inactive(_WINCH) else self._dead(topics.WINCH_ESTIMATE, now),
        }
        return tuple(Danger(part, text) for part, text in found.items() if text)

    def _fault_of_plant(self, now: float) -> str:
        if self._is_simulation_over(now):
            return ""
        dead = self._dead(topics.SIM_STATUS, now)
        if dead:
            return dead
        if self._simulation is not None and self._simulation[0].level is Level.ERROR:
            return self._simulation[0].message
        fault = self._liveness.fault_of_time(now)
        return fault or ("" if self._has_link(now) else self._dead(topics.WINCH_STATE, now))

    def _fault_of_link(self, now: float) -> str:
        if not self._has_link(now):
            return ""
        for status, _ in self._link.values():
            if status.name.endswith(": link") and status.level is Level.ERROR:
                return status.message
        return self._dead(topics.WINCH_STATE, now) or self._dead(topics.LINK_STATUS, now)

    # --- queries -------------------------------------------------------------------------------

    def is_alive(self, node: str, now: float) -> bool:
        """Whether a node reports its health."""
        return now - self._last_received.get(node, -math.inf) <= SILENT_AFTER

    def reported_ns(self, node: str) -> int:
        """Time of a node's last health report by its clock [ns]; 0 = none was received."""
        return self._reported_ns.get(node, 0)

    @property
    def has_any_node(self) -> bool:
        """Whether any node has reported its health."""
        return bool(self._last_received)

    @property
    def has_all_phases(self) -> bool:
        """Whether every node that reports its health has published its phase."""
        return all(
            topic in self._texts
            for topic in PHASE_TOPICS
            if self._last_received.keys() & _PUBLISHERS[topic]
        )

    def text(self, topic: str) -> str:
        """The latest text of a phase topic; empty = never received."""
        return self._texts.get(topic, ("", 0.0))[0]

    def number(self, topic: str, path: str) -> float | None:
        """The latest number of a topic; None = never received."""
        return self._numbers.get(topic, ({}, 0.0))[0].get(path)

    def parameter(self, node: str, name: str) -> Any:
        """A parameter from the latest configuration of a node; None = unknown."""
        return self._parameters.get(node, {}).get(name)

    @property
    def is_idle(self) -> bool | None:
        """Whether no descent is active; None = unknown."""
        phase = self.text(topics.DESCENT_PHASE)
        return phase in {DescentPhase.RELEASED, DescentPhase.STANDBY} if phase else None

    @property
    def depth(self) -> float | None:
        """Tether length at the drum [m]; None = unknown."""
        return self.number(topics.WINCH_STATE, f"{machine.WINCH_DRUM}.position")

    def is_at_rest(self, since: float) -> bool:
        """Whether drum and nut have been at rest, brake closed, after a steady time [s].

        The drum must rest for 0.5 s by its stamps, since simulated time may be slow.
        """
        if (
            self.text(topics.JUMP_PHASE) in {JumpPhase.COMPRESSING, JumpPhase.LETTING_DOWN}
            or not self._drum
        ):
            return False
        last_ns = self._drum[-1].stamp_ns
        for sample in reversed(self._drum):
            if not sample.is_at_rest or sample.received <= since:
                return False
            if last_ns - sample.stamp_ns >= _REST_TIME_NS:
                return True
        return False

    def snapshot(self, now: float) -> Snapshot:
        """The state at a steady time [s]."""
        return Snapshot(
            tuple(self._reading(row, now) for row in QUANTITIES),
            tuple(self._phase_reading(topic, now) for topic in PHASE_TOPICS),
            () if self._has_ended(_WINCH, now) else self._alarms,
            tuple(
                self._node(name, now)
                for name in sorted(self._last_received)
                if not self._has_ended(name, now)
            ),
            tuple(_health_of(status, now - at) for status, at in self._link.values())
            if self._has_link(now) else (),
            None if self._simulation is None or self._is_simulation_over(now)
            else _health_of(self._simulation[0], now - self._simulation[1]),
            tuple(_report(status, stamp, now - at) for status, stamp, at in self._refusals),
            tuple(_report(status, stamp, now - at) for status, stamp, at in self._events),
            tuple(_command(record, stamp) for record, stamp in self.commands),
            self.dangers(now),
            self._has_plant(now),
            self._liveness.is_paused and not self._is_simulation_over(now),
            self._has_link(now) and self._is_simulation_over(now),
        )  # fmt: skip

    def _reading(self, row: Quantity, now: float) -> TelemetryReading:
        found: tuple[float, float, str] | None = None
        for topic, path in row.sources:
            values, at = self._numbers.get(topic, ({}, 0.0))
            if path not in values or not _is_valid(topic, path, values):
                continue
            if found is None or self._is_stale(found[2], now):
                found = (values[path], at, topic)
        if found is None:
            return TelemetryReading(
                row.key, row.label, row.group, row.unit, None, None, True, False, "–"
            )
        value, age = found[0] * row.scale, now - found[1]
        shown = f"{value:.{row.digits}f}"
        if float(shown) == 0.0:
            shown = shown.lstrip("-")
        text = f"{shown} {row.unit}".rstrip()
        if row.states is not None:
            text = row.states[value > 0.5]
        stale = self._is_stale(found[2], now)
        warns = abs(value) > row.warn_above
        return TelemetryReading(
            row.key, row.label, row.group, row.unit, value, age, stale, warns, text
        )

    def _is_stale(self, topic: str, now: float) -> bool:
        return find_topic(topic).rate is not None and self._dead(topic, now) != ""

    def _phase_reading(self, topic: str, now: float) -> TelemetryReading:
        key, label = PHASE_TOPICS[topic]
        received = self._texts.get(topic)
        if received is None:
            return TelemetryReading(key, label, "phases", "", None, None, True, False, "–")
        word, at = received
        lives = (node for node in _PUBLISHERS[topic] if self.is_alive(node, now))
        stale = all(self._lacks(node, now) for node in lives)
        warns = word in _BAD_WORDS
        return TelemetryReading(key, label, "phases", "", word, now - at, stale, warns, word)

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
        age, lacks = now - self._last_received[name], self._lacks(name, now)
        return NodeHealth(name, condition, worst.name, age, bool(lacks), bad, lacks)


def _errors(statuses: Mapping[str, Status]) -> dict[str, Status]:
    return {what: status for what, status in statuses.items() if status.level is Level.ERROR}


def _keep(kept: dict[str, T], name: str, value: T) -> None:
    """Keep the newest values under their names: anyone may send any name."""
    kept.pop(name, None)
    kept[name] = value
    if len(kept) > _NAMES:
        del kept[next(iter(kept))]


def _is_valid(topic: str, path: str, values: Mapping[str, float]) -> bool:
    """Whether a value is valid; the winch reports an unknown tension as 0 with a validity flag."""
    if topic == topics.WINCH_ESTIMATE and path == f"{machine.TENSION}.effort":
        return values.get(f"{machine.TENSION}.position", 0.0) > 0.5
    return True


def _health_of(status: Status, age: float) -> NodeHealth:
    name = status.name.partition(": ")[2] or status.name
    details = tuple(f"{key}: {value}" for key, value in status.values.items())
    lacks = f"silent for {age:.0f} s" if age > SILENT_AFTER else ""
    level = status.level.name
    return NodeHealth(name, status.message, level, age, bool(lacks), details, lacks)


def _command(record: CommandRecord, changed_ns: int) -> CommandReport:
    name = f"{record.sender}#{record.identifier}" if record.sender else record.identifier
    progress = None if math.isnan(record.progress) else record.progress
    return CommandReport(
        record.node, record.subject, name, record.what, record.taken_ns * 1e-9, changed_ns * 1e-9,
        record.state.value, "" if record.reason is None else record.reason.value, record.text,
        progress, record.state.is_over, record.is_warning,
    )  # fmt: skip


def _report(status: Status, stamp_ns: int, age: float) -> StatusReport:
    name = status.name.partition(": ")[2] or status.name
    level, values = status.level.name, dict(status.values)
    return StatusReport(
        status.hardware_id, name, status.message, level, stamp_ns * 1e-9, age, values
    )
