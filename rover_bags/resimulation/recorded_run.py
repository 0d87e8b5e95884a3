"""A recorded run, sorted by run segment and simulated time for re-simulation."""

import bisect
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from msg_schemas import topics
from msg_schemas.events import SimulationEvent
from msg_schemas.fields import FieldRule, read_value
from msg_schemas.samples import ClockSample, Sample, StatusSample, TextSample
from rover_bags.files.scan import BagScan
from rover_bags.reading.read import ContractMessage, json_object, received_messages
from rover_sim import COMMANDS

_GAP: Final = 5
"""Number of ticks without any message from which commands may be missing."""
TICK: Final = FieldRule(kind=float, unit="s", minimum=1e-4, maximum=0.05)
SEED: Final = FieldRule(kind=int, minimum=0, maximum=2**31 - 1)
"""Ticks and seeds that the simulator can have."""
_SECOND_NS: Final = 1_000_000_000
_SIMULATION_END_NS: Final = 10**9 * _SECOND_NS
"""Later stamps are those of a wall clock [ns]."""


def configured_tick(configuration: Mapping[str, Any]) -> float:
    """Return the simulator's tick [s] from its configuration.

    Raises:
        KeyError: it is missing.
        FieldError: the simulator cannot have this tick.
    """
    return float(read_value(TICK, configuration["parameters"]["tick"], "parameters.tick"))


def configured_seed(configuration: Mapping[str, Any]) -> int:
    """Return the simulator's seed from its configuration.

    Raises:
        KeyError: it is missing.
        FieldError: the simulator cannot have this seed.
    """
    return int(read_value(SEED, configuration["seed"], "seed"))


@dataclass
class RunSegment:
    """Messages recorded between two resets of the clock.

    Attributes:
        configuration: the simulator's latched configuration; None if it is not recorded.
        ticks: clock messages: (time of publication [ns since 1970], simulated time [ns]).
        commands: command messages.
        recorded: samples by stamp [ns] and topic.
        after_reset: samples of the plant's initial state, published after a reset of the plant.
        plant_resets: simulated times [ns] at which the plant was reset.
    """

    configuration: Mapping[str, Any] | None = None
    ticks: list[tuple[int, int]] = field(default_factory=list)
    commands: list[ContractMessage] = field(default_factory=list)
    recorded: dict[int, dict[str, Sample]] = field(default_factory=dict)
    after_reset: dict[int, dict[str, Sample]] = field(default_factory=dict)
    plant_resets: set[int] = field(default_factory=set)

    @property
    def last_ns(self) -> int:
        """The last recorded simulated time [ns]."""
        return max([*(stamp for _, stamp in self.ticks), *self.recorded], default=0)

    @property
    def first_ns(self) -> int:
        """The first recorded simulated time [ns]."""
        return min([*(stamp for _, stamp in self.ticks), *self.recorded], default=0)

    def gaps(self, tick_ns: int, begin: int, end: int) -> Iterator[tuple[int, int]]:
        """Yield the gaps [ns] in the record, in which commands may be missing.

        Args:
            tick_ns: Tick of the simulation [ns].
            begin: First simulated time [ns].
            end: Last simulated time [ns].
        """
        recorded_ns = {stamp for _, stamp in self.ticks} | set(self.recorded)
        stamps = [begin, *sorted(stamp for stamp in recorded_ns if begin < stamp <= end)]
        for before, after in itertools.pairwise(stamps):
            if after - before > _GAP * tick_ns:
                yield before, after


@dataclass
class RecordedRun:
    """A bag, sorted for re-simulation.

    Attributes:
        segments: run segments in their order, at least one.
        file_defects: descriptions of what is missing, damaged or cannot be used.
    """

    segments: list[RunSegment] = field(default_factory=lambda: [RunSegment()])
    file_defects: list[str] = field(default_factory=list)

    def segment(self, number: int) -> RunSegment:
        """Return a segment by its number; create it if needed."""
        while len(self.segments) <= number:
            self.segments.append(RunSegment())
        return self.segments[number]


def read_recorded_run(path: Path, namespace: str | None) -> RecordedRun:
    """Sort a bag's messages by run segment and simulated time.

    A stamp that runs backward starts a new segment, for each topic by itself. A command belongs to
    the segment whose clock was published last, and a segment to the simulator that was configured
    last before its clock. A sample that is stamped beyond the end of simulated
    time, as by a wall clock, is not used.
    """
    recorded_run = RecordedRun()
    configurations: list[tuple[int, Mapping[str, Any]]] = []
    commands: list[ContractMessage] = []
    stamped: list[_Stamped] = []
    scan = BagScan(path)
    first_ns: int | None = None
    for message in received_messages(scan, namespace=namespace):
        first_ns = message.log_ns if first_ns is None else min(first_ns, message.log_ns)
        name, sample = message.name, message.sample
        if isinstance(sample, TextSample):
            content = json_object(sample.text) if name == topics.CONFIG else {}
            if "scenario" in content:
                configurations.append((message.publish_ns, content))
            continue
        if name in COMMANDS:
            commands.append(message)
            continue
        if name in PLANT_TOPICS or name == topics.EVENTS:
            stamped.append(_Stamped(name, message.publish_ns, sample))
    recorded_run.file_defects = scan.defects(first_ns or 0)
    _assign_samples(recorded_run, stamped)
    starts = [
        segment.ticks[0][0] if segment.ticks else -math.inf for segment in recorded_run.segments
    ]
    _assign_commands(recorded_run, starts, commands)
    _assign_configurations(recorded_run, starts, configurations)
    return recorded_run


class _Stamped(NamedTuple):
    """A message of the plant or an event."""

    name: str
    publish_ns: int
    sample: Any


def _assign_samples(recorded_run: RecordedRun, stamped: Sequence[_Stamped]) -> None:
    latest: dict[str, tuple[int, int]] = {}  # segment and stamp, by topic
    end_ns = _end_of_simulated_time(stamped)
    resets = {
        each.sample.stamp_ns: each.publish_ns
        for each in stamped
        if each.name == topics.EVENTS and _is_plant_reset(each.sample)
    }
    ahead: Counter[str] = Counter()
    for name, publish_ns, sample in stamped:
        stamp = sample.stamp_ns
        if stamp > end_ns and name in PLANT_TOPICS:
            ahead[name] += 1
            continue
        number, before = latest.get(name, (0, -1))
        if name in PLANT_TOPICS:
            number += stamp < before
            latest[name] = (number, stamp)
        if isinstance(sample, ClockSample):
            recorded_run.segment(number).ticks.append((publish_ns, stamp))
        elif isinstance(sample, StatusSample):
            if name == topics.EVENTS and _is_plant_reset(sample):
                clock = latest.get(topics.CLOCK, (0, 0))[0]
                recorded_run.segment(clock).plant_resets.add(stamp)
        else:
            segment = recorded_run.segment(number)
            # Simulated time does not advance during a reset of the plant: its initial state has the
            # same stamp, and may be the only sample of a topic that was not due.
            is_initial = stamp == before or publish_ns > resets.get(stamp, publish_ns)
            samples = segment.after_reset if is_initial else segment.recorded
            samples.setdefault(stamp, {})[name] = sample
    recorded_run.file_defects += [
        f"samples of {name} stamped after the end of simulated time, not used: {count}"
        for name, count in sorted(ahead.items())
    ]


def _is_plant_reset(sample: StatusSample) -> bool:
    return any(status.name == SimulationEvent.PLANT_RESET for status in sample.statuses)


def _end_of_simulated_time(stamped: Sequence[_Stamped]) -> int:
    """Return the last time that a stamp can have [ns]: that of the clock and a little more."""
    clock = (each.sample.stamp_ns for each in stamped if each.name == topics.CLOCK)
    last = max((stamp for stamp in clock if stamp < _SIMULATION_END_NS), default=_SIMULATION_END_NS)
    return min(last + _SECOND_NS, _SIMULATION_END_NS)


PLANT_TOPICS: Final = frozenset(
    {
        topics.CLOCK,
        topics.TRUTH_BODY1,
        topics.TRUTH_BODY2,
        topics.TRUTH_TETHER,
        topics.TRUTH_ENERGY,
        topics.IMU,
        topics.CONTACT,
        topics.LOAD_CELL,
        topics.ROVER_LOAD_CELL,
        topics.MOTOR_CURRENTS,
        topics.CAMERA,
        topics.JUMP_MOTOR_STATE,
        topics.FLYWHEEL_STATE,
        topics.WHEEL_STATE,
        topics.WINCH_STATE,
    }
)
"""Topics that the plant stamps."""


def _assign_commands(
    recorded_run: RecordedRun, starts: Sequence[float], commands: Sequence[ContractMessage]
) -> None:
    for command in sorted(commands, key=lambda one: (one.publish_ns, one.sequence)):
        number = max(bisect.bisect_right(starts, command.publish_ns) - 1, 0)
        recorded_run.segment(number).commands.append(command)


def _assign_configurations(
    recorded_run: RecordedRun,
    starts: Sequence[float],
    configurations: Sequence[tuple[int, Mapping[str, Any]]],
) -> None:
    known = sorted(configurations, key=lambda one: one[0])
    for segment, start in zip(recorded_run.segments, starts, strict=True):
        number = bisect.bisect_right(known, start, key=lambda one: one[0])
        segment.configuration = known[max(number - 1, 0)][1] if known else None
