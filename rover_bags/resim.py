"""``mother_rover bag resim``: simulates a recorded run once more and compares it with the record.

The scenario, its seed and the control tick come from the configuration that the simulator latched;
the commands are those of the bag, each given to the plant at the tick at which it came. A run
recorded in lockstep comes out bit by bit on the machine that recorded it.

Where nothing held the simulator back, a command may have come while a tick was being computed. The
record then tells: of the few ticks that are possible the one is taken that brings the next recorded
state nearest, as long as the run is followed within the tolerance.
"""

import argparse
import bisect
import json
import math
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from tqdm import tqdm

from msg_schemas import topics
from msg_schemas.codecs import decode
from msg_schemas.refusal import Refusal
from msg_schemas.samples import (
    TETHER_COLUMNS,
    JointSample,
    Sample,
    TetherSample,
)
from rover_bags.files.store import BagError
from rover_bags.read import ReadError, ReceivedMessage
from rover_bags.recorded_run import RecordedRun, RunSegment, read_recorded_run
from rover_sim import (
    AnyScenario,
    ScenarioError,
    Simulation,
    StaticsError,
    build_interface,
    build_plant,
    compile_ahead,
    scenario_from_mapping,
)

TOLERANCE: Final = 1e-6
"""Of two numbers that count as the same where bits differ, relative to 1 + their size."""
_NANO: Final = 1_000_000_000
_LATEST: Final = 5
"""So many ticks after it was sent a command has come at the latest."""
_NOT_COMPARED: Final = frozenset({topics.CLOCK, topics.MARKERS})


class ResimError(BagError):
    """A bag that cannot be simulated again; the text says what it lacks."""


@dataclass(frozen=True)
class Difference:
    """A number that came out otherwise.

    Attributes:
        time_s: simulated time [s].
        topic, field: which number.
        recorded, resimulated: its two values.
    """

    time_s: float
    topic: str
    field: str
    recorded: float
    resimulated: float

    def text(self) -> str:
        """In words."""
        return (
            f"at {self.time_s:.6f} s, {self.topic}, {self.field}: recorded {self.recorded!r}, "
            f"re-simulated {self.resimulated!r}"
        )


@dataclass
class Comparison:
    """How one topic compares.

    Attributes:
        compared: samples that were compared.
        identical: those that are the same to the last bit.
        outside: those with a number outside the tolerance.
        first: the first number that differs at all.
        largest: the number that differs most, relative to 1 + its size.
        error: by how much.
    """

    compared: int = 0
    identical: int = 0
    outside: int = 0
    first: Difference | None = None
    largest: Difference | None = None
    error: float = 0.0


@dataclass
class Resimulation:
    """What came of it.

    Attributes:
        bag: which was simulated again.
        scenario, seed, tick: of the recorded simulation; tick in s.
        tolerance: that the comparison uses.
        simulated_s: simulated time [s], all parts together.
        commands: given to the plant.
        refused: commands that the plant refused, as the recorded one did.
        moved: commands that came later than when they were sent, as the record tells.
        resets: how often the plant was put back to its start.
        comparisons: by topic.
        schedule: the commands that were given, with the simulated time [ns] of each.
        first: the first number that differs at all.
        first_outside: the first number outside the tolerance.
        notes: what limits the comparison.
    """

    bag: Path
    scenario: str
    seed: int
    tick: float
    tolerance: float
    simulated_s: float = 0.0
    commands: int = 0
    refused: int = 0
    moved: int = 0
    resets: int = 0
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    schedule: list[tuple[int, ReceivedMessage]] = field(default_factory=list)
    first: Difference | None = None
    first_outside: Difference | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def compared(self) -> int:
        """Samples that were compared."""
        return sum(one.compared for one in self.comparisons.values())

    @property
    def differing(self) -> int:
        """Samples that are not the same to the last bit."""
        return sum(one.compared - one.identical for one in self.comparisons.values())

    @property
    def identical(self) -> bool:
        """Whether all that was recorded came out to the last bit."""
        return self.compared > 0 and self.differing == 0

    @property
    def within(self) -> bool:
        """Whether all of it came out within the tolerance."""
        return self.compared > 0 and self.first_outside is None

    def text(self) -> str:
        """For a terminal."""
        lines = [
            (
                f"{self.bag}: scenario {self.scenario}, seed {self.seed}, {self.simulated_s:.3f} s "
                f"simulated again in ticks of {self.tick:g} s"
            ),
            f"{self.commands} commands given, {self.refused} refused"
            + (f", {self.moved} of them later than sent" if self.moved else "")
            + (f"; {self.resets} resets" if self.resets else ""),
        ]
        lines += [f"! {note}" for note in self.notes]
        lines.append(f"  {'topic':24s}{'compared':>10s}{'identical':>11s}{'outside':>9s}  largest")
        for name, one in sorted(self.comparisons.items()):
            most = "" if one.largest is None else f"{one.error:.1e} in {one.largest.field}"
            lines.append(
                f"  {name:24s}{one.compared:10d}{one.identical:11d}{one.outside:9d}  {most}"
            )
        if self.identical:
            lines.append("every recorded sample came out to the last bit")
            return "\n".join(lines)
        if self.first is not None:
            lines.append(f"first difference {self.first.text()}")
        if self.within:
            lines.append(f"all of it within the tolerance of {self.tolerance:g}")
        elif self.first_outside is not None:
            lines.append(f"first outside {self.tolerance:g} {self.first_outside.text()}")
        else:
            lines.append("nothing could be compared")
        return "\n".join(lines)

    def to_mapping(self) -> dict[str, Any]:
        """For machines."""
        return {
            "bag": str(self.bag),
            "scenario": self.scenario,
            "seed": self.seed,
            "tick_s": self.tick,
            "tolerance": self.tolerance,
            "simulated_s": self.simulated_s,
            "commands": self.commands,
            "refused": self.refused,
            "moved": self.moved,
            "resets": self.resets,
            "identical": self.identical,
            "within_tolerance": self.within,
            "compared": self.compared,
            "differing": self.differing,
            "first_difference": _plain(self.first),
            "first_outside_tolerance": _plain(self.first_outside),
            "topics": {
                name: {
                    "compared": one.compared,
                    "identical": one.identical,
                    "outside": one.outside,
                    "largest_error": one.error,
                    "first_difference": _plain(one.first),
                }
                for name, one in sorted(self.comparisons.items())
            },
            "notes": self.notes,
        }


def _plain(difference: Difference | None) -> dict[str, Any] | None:
    if difference is None:
        return None
    values = dict(vars(difference))
    for name in ("recorded", "resimulated"):
        if not math.isfinite(values[name]):
            values[name] = None
    return values


# --- the run --------------------------------------------------------------------------------------


def resimulate(
    path: Path,
    *,
    tolerance: float = TOLERANCE,
    namespace: str | None = None,
    show_progress: bool = False,
) -> Resimulation:
    """Simulate a recorded run once more.

    Args:
        path: the bag.
        tolerance: of numbers whose bits differ, relative to 1 + their size.
        namespace: which rover, where the bag holds several.
        show_progress: whether a progress bar is drawn.

    Raises:
        ResimError: it holds no simulator's configuration, or one that makes no scenario here.
        BagError: it cannot be read.
    """
    recorded_run = read_recorded_run(path, namespace)
    if recorded_run.configuration is None:
        raise ResimError(
            f"{path} holds no configuration of a simulator ({topics.CONFIG} with a scenario), so "
            "it is not known what was simulated"
        )
    configuration = recorded_run.configuration
    try:
        scenario = scenario_from_mapping(configuration["scenario"])
        tick = float(configuration["parameters"]["tick"])
        seed = int(configuration["seed"])
        simulation = _simulation(scenario, tick, seed)
    except KeyError as error:
        raise ResimError(
            f"the simulator's configuration in {path} lacks {error}: it holds "
            f"{', '.join(sorted(configuration))}"
        ) from error
    except (ScenarioError, StaticsError, TypeError, ValueError) as error:
        raise ResimError(
            f"the simulator's configuration in {path} cannot be simulated here: {error}"
        ) from error
    found = Resimulation(path, scenario.name, seed, tick, tolerance)
    _note_limits(found, recorded_run)
    total = sum(segment.last_ns for segment in recorded_run.segments) / _NANO
    with tqdm(total=total, unit=" s", desc="re-simulating", disable=not show_progress) as bar:
        for number, segment in enumerate(recorded_run.segments):
            if number:
                simulation.reset()
                found.resets += 1
            _run_segment(simulation, segment, found, bar)
    return found


def _simulation(scenario: AnyScenario, tick: float, seed: int) -> Simulation[Any]:
    compile_ahead(scenario)  # so that this process runs the code that the recorded one ran
    plant = build_plant(scenario)
    plant.warm_up()
    return Simulation(build_interface(plant, seed), tick)


def _note_limits(found: Resimulation, recorded_run: RecordedRun) -> None:
    found.notes += recorded_run.file_defects
    tick_ns = round(found.tick * _NANO)
    for segment in recorded_run.segments:
        found.notes += [
            f"nothing is recorded from {before / _NANO:.3f} s to {after / _NANO:.3f} s of "
            "simulated time: commands given then are not in the bag, and what comes after may "
            "differ for that"
            for before, after in segment.gaps(tick_ns, segment.first_ns, segment.last_ns)
        ]
    first = (
        recorded_run.segments[0].ticks[0][1] / _NANO
        if recorded_run.segments and recorded_run.segments[0].ticks
        else 0.0
    )
    if first > 2.0 * found.tick:
        found.notes.append(
            f"the recording begins at {first:.3f} s of simulated time: commands before that are "
            "not in it"
        )
    if not any(segment.ticks for segment in recorded_run.segments):
        found.notes.append("the clock was not recorded: commands are given at their own stamps")


def _run_segment(
    simulation: Simulation[Any], segment: RunSegment, found: Resimulation, bar: Any
) -> None:
    waiting = deque((earliest_instant(segment, command), command) for command in segment.commands)
    _compare(simulation, segment.recorded.get(0, {}), found, over_a_tick=False)
    followed = True
    while simulation.stamp_ns < segment.last_ns:
        now = simulation.stamp_ns
        if now in segment.plant_resets:
            simulation.reset_plant()
            found.resets += 1
            _compare(simulation, segment.after_reset.get(now, {}), found, over_a_tick=False)
        come: list[ReceivedMessage] = []
        forced = 0
        for earliest, command in waiting:
            if earliest > now:
                break
            come.append(command)
            forced += earliest + (_LATEST - 1) * simulation.tick_ns <= now
        taken = len(come)
        if come and followed:
            simulation, taken = _as_recorded(simulation, segment, come, forced, found)
        else:
            _give(simulation, come, found)
            simulation.tick()
        for _ in range(taken):
            waiting.popleft()
        _compare(simulation, segment.recorded.get(simulation.stamp_ns, {}), found)
        followed = found.first_outside is None
        found.simulated_s += simulation.tick_ns / _NANO
        bar.update(simulation.tick_ns / _NANO)


def earliest_instant(segment: RunSegment, command: ReceivedMessage) -> int:
    """Simulated time at which a command can have come at the earliest [ns]."""
    place = bisect.bisect_right(segment.ticks, (command.publish_ns, 1 << 62)) - 1
    clock_ns = segment.ticks[place][1] if place >= 0 else 0
    stamp: int = getattr(command.sample, "stamp_ns", 0)
    return max(clock_ns, 0) if segment.ticks else stamp


def _as_recorded(
    simulation: Simulation[Any],
    segment: RunSegment,
    come: list[ReceivedMessage],
    forced: int,
    found: Resimulation,
) -> tuple[Simulation[Any], int]:
    """Make a tick with as many of the commands as bring the recorded state nearest.

    Returns:
        The simulation after the tick, and how many of the commands it took.
    """
    start = simulation.fork()
    best: tuple[float, Simulation[Any], int, Resimulation] | None = None
    for taken in range(len(come), forced - 1, -1):
        trial = start.fork()
        given = Resimulation(found.bag, found.scenario, found.seed, found.tick, found.tolerance)
        _give(trial, come[:taken], given)
        trial.tick()
        error = _distance(trial, segment)
        if best is None or error < best[0]:
            best = (error, trial, taken, given)
        if error == 0.0:
            break
    if best is None:
        raise AssertionError("more commands must be taken than have come")
    _, trial, taken, given = best
    found.commands += given.commands
    found.refused += given.refused
    found.schedule += given.schedule
    found.moved += len(come) - taken
    return trial, taken


def _give(
    simulation: Simulation[Any], commands: Sequence[ReceivedMessage], found: Resimulation
) -> None:
    """Hand over commands, judged as the simulator's node judges them."""
    for command in commands:
        try:
            sample = decode(command.name, command.message, simulation.stamp_ns)
            if isinstance(sample, JointSample):
                simulation.accept_command(command.name, sample)
                found.commands += 1
                found.schedule.append((simulation.stamp_ns, command))
        except Refusal:
            found.refused += 1


# --- the comparison -------------------------------------------------------------------------------


def _distance(simulation: Simulation[Any], segment: RunSegment) -> float:
    """Largest error against the recorded samples of this instant; 0 if they are bit-identical."""
    recorded_samples = segment.recorded.get(simulation.stamp_ns, {})
    return max(
        (
            float(np.max(_errors(_numbers(recorded), _numbers(mine)), initial=0.0))
            for _, recorded, mine in _pairs(simulation, recorded_samples)
        ),
        default=0.0,
    )


def _errors(recorded: Any, mine: Any) -> Any:
    """Differences relative to 1 + their size; infinite where they cannot be compared."""
    if recorded.shape != mine.shape:
        return np.array([math.inf])
    errors = np.abs(recorded - mine) / (1.0 + np.abs(recorded))
    return np.where(np.isfinite(errors), errors, math.inf)


def _pairs(
    simulation: Simulation[Any], recorded: Mapping[str, Sample], *, over_a_tick: bool = True
) -> Iterator[tuple[str, Sample, Sample]]:
    interface = simulation.interface
    due = [
        name
        for name in recorded
        if name in interface.topics
        and name not in _NOT_COMPARED
        and (over_a_tick or name not in interface.available_after_tick)
    ]
    for name, sample in interface.samples(due):
        yield name, recorded[name], sample


def _compare(
    simulation: Simulation[Any],
    recorded_samples: Mapping[str, Sample],
    found: Resimulation,
    *,
    over_a_tick: bool = True,
) -> None:
    time = simulation.stamp_ns / _NANO
    for name, recorded, mine in _pairs(simulation, recorded_samples, over_a_tick=over_a_tick):
        row = found.comparisons.setdefault(name, Comparison())
        row.compared += 1
        a, b = _numbers(recorded), _numbers(mine)
        if a.shape == b.shape and np.array_equal(a, b):
            row.identical += 1
            continue
        if a.shape != b.shape:
            place, error = 0, math.inf
            difference = Difference(time, name, "number of values", float(a.size), float(b.size))
            least = difference
        else:
            errors = _errors(a, b)
            place, error = int(np.argmax(errors)), float(np.max(errors))
            fields = _fields(recorded)
            first = int(np.flatnonzero(a != b)[0])
            least = Difference(time, name, fields[first], float(a[first]), float(b[first]))
            difference = Difference(time, name, fields[place], float(a[place]), float(b[place]))
        row.first = row.first or least
        found.first = found.first or least
        if error >= row.error:
            row.largest, row.error = difference, error
        if error > found.tolerance:
            row.outside += 1
            found.first_outside = found.first_outside or difference


def _numbers(sample: Sample) -> Any:
    if isinstance(sample, TetherSample):
        return sample.nodes.ravel()
    return np.array([value for _, value in sample.scalars()])


def _fields(sample: Sample) -> list[str]:
    if isinstance(sample, TetherSample):
        return [
            f"node {node}: {column}"
            for node in range(len(sample.nodes))
            for column in TETHER_COLUMNS
        ]
    return [name for name, _ in sample.scalars()]


# --- the executable -------------------------------------------------------------------------------


class ExitCode(IntEnum):
    """Exit codes of ``mother_rover bag resim``."""

    SAME = 0
    DIFFERS = 1
    REFUSED = 2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Simulate a recorded run again, with the configuration and the commands in the bag, and "
        "compare every recorded sample of the plant with the simulated one. Locate the first "
        "difference by time, topic and field."
    )
    parser.epilog = (
        "Exit codes: 0 identical, or within the tolerance; 1 different; 2 no bag, or the bag holds "
        "no configuration."
    )
    parser.add_argument("bag", type=Path, help="the bag: its folder or one of its files")
    parser.add_argument("--tolerance", type=float, default=TOLERANCE, metavar="X",
                        help="tolerance of numbers, relative to 1 + their size "
                        "(default: %(default)g)")  # fmt: skip
    parser.add_argument("--exact", action="store_true", help="exit with 1 if a single bit differs")
    parser.add_argument("--namespace", metavar="NS", help="which rover, if the bag holds several")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`ExitCode`."""
    if not 0.0 <= options.tolerance < math.inf:
        print(
            f"mother_rover bag resim: --tolerance is {options.tolerance}, it should be a finite "
            "number of at least 0",
            file=sys.stderr,
        )
        return ExitCode.REFUSED
    try:
        found = resimulate(
            options.bag,
            tolerance=options.tolerance,
            namespace=options.namespace,
            show_progress=sys.stderr.isatty(),
        )
    except (BagError, ReadError) as error:
        print(f"mother_rover bag resim: {error}", file=sys.stderr)
        return ExitCode.REFUSED
    print(json.dumps(found.to_mapping(), indent=2) if options.json else found.text())
    good = found.identical if options.exact else found.within
    return ExitCode.SAME if good else ExitCode.DIFFERS
