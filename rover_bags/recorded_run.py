"""A recorded run, sorted for being simulated again: by part of the run and by simulated time."""

import bisect
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from msg_schemas import topics
from msg_schemas.samples import ClockSample, DrawingSample, Sample, StatusSample, TextSample
from rover_bags.files.scan import BagScan
from rover_bags.read import Arrival, arrivals
from rover_sim import COMMANDS

_RESET_PLANT: Final = "reset_plant"
_GAP: Final = 5
"""Ticks without any record from which on commands may be lost."""


@dataclass
class Part:
    """What was recorded between two resets of the clock.

    Attributes:
        ticks: when the clock told which time: (sent [ns since 1970], simulated [ns]).
        commands: with when they were sent.
        recorded: samples by their stamp [ns] and topic.
        put_back: the same of the plant's start, told when it was put back.
        plant_resets: simulated times [ns] at which the plant was put back.
    """

    ticks: list[tuple[int, int]] = field(default_factory=list)
    commands: list[Arrival] = field(default_factory=list)
    recorded: dict[int, dict[str, Sample]] = field(default_factory=dict)
    put_back: dict[int, dict[str, Sample]] = field(default_factory=dict)
    plant_resets: set[int] = field(default_factory=set)

    @property
    def last_ns(self) -> int:
        """The last simulated time that is known."""
        return max([*(stamp for _, stamp in self.ticks), *self.recorded], default=0)

    @property
    def first_ns(self) -> int:
        """The first simulated time that is known."""
        return min([*(stamp for _, stamp in self.ticks), *self.recorded], default=0)

    def gaps(self, tick_ns: int, begin: int, end: int) -> Iterator[tuple[int, int]]:
        """Times [ns] from `begin` to `end` between which nothing is recorded: commands may be lost.

        All times are simulated ones; `tick_ns` is the simulation's tick.
        """
        told = {stamp for _, stamp in self.ticks} | set(self.recorded)
        stamps = [begin, *sorted(stamp for stamp in told if begin < stamp <= end)]
        for before, after in itertools.pairwise(stamps):
            if after - before > _GAP * tick_ns:
                yield before, after


@dataclass
class Record:
    """A bag, sorted for being simulated again.

    Attributes:
        configuration: that the simulator latched, None where the bag holds none.
        parts: in their order.
        remarks: what the bag's files lack, in words.
    """

    configuration: Mapping[str, Any] | None = None
    parts: list[Part] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def part(self, number: int) -> Part:
        """A part by its number, made if it is new."""
        while len(self.parts) <= number:
            self.parts.append(Part())
        return self.parts[number]


def read_record(path: Path, namespace: str | None) -> Record:
    """Sort a bag's messages by the part of the run and by simulated time.

    Each topic's stamps run forward but where the clock was put back; so each topic tells for itself
    to which part its messages belong. Commands belong to the part whose clock was told last.
    """
    record = Record()
    commands: list[Arrival] = []
    latest: dict[str, tuple[int, int]] = {}  # part and stamp, by topic
    scan = BagScan(path)
    first_ns: int | None = None
    for arrival in arrivals(scan, namespace=namespace):
        first_ns = arrival.log_ns if first_ns is None else min(first_ns, arrival.log_ns)
        name, sample = arrival.name, arrival.sample
        if isinstance(sample, TextSample):
            if name == topics.CONFIG and record.configuration is None:
                content = _content(sample.text)
                record.configuration = content if "scenario" in content else None
            continue
        if name in COMMANDS:
            commands.append(arrival)
            continue
        if isinstance(sample, DrawingSample):
            continue
        stamp = getattr(sample, "stamp_ns", 0)
        number, before = latest.get(name, (0, -1))
        if name in FROM_PLANT:
            number += stamp < before
            latest[name] = (number, stamp)
        if isinstance(sample, ClockSample):
            record.part(number).ticks.append((arrival.publish_ns, stamp))
        elif isinstance(sample, StatusSample):
            if name == topics.EVENTS and any(s.name == _RESET_PLANT for s in sample.statuses):
                clock = latest.get(topics.CLOCK, (0, 0))[0]
                record.part(clock).plant_resets.add(stamp)
        elif name in FROM_PLANT:
            part = record.part(number)
            # Time stands still while the plant is put back: its start bears the same stamp.
            told = part.put_back if stamp == before else part.recorded
            told.setdefault(stamp, {})[name] = sample
    _hand_out(record, commands)
    record.remarks = scan.remarks(first_ns or 0)
    return record


FROM_PLANT: Final = frozenset(
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
"""What the plant itself stamps."""


def _hand_out(record: Record, commands: Sequence[Arrival]) -> None:
    starts = [part.ticks[0][0] if part.ticks else -math.inf for part in record.parts]
    for command in sorted(commands, key=lambda one: (one.publish_ns, one.sequence)):
        number = max(bisect.bisect_right(starts, command.publish_ns) - 1, 0)
        record.part(number).commands.append(command)


def _content(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}
