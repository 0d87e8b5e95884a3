"""``mother_rover bag resim``: simulates a recorded run once more and compares it with the record.

Scenario, seed and tick come from the simulator's latched configuration. Each recorded command is
given to the plant at the tick at which it was received: of the few possible ticks, the one is
chosen whose next state is nearest to the recorded one, as long as the run is reproduced within the
tolerance. Choices are reconsidered where their effect shows some ticks later. A run recorded in
lockstep is reproduced bit by bit on the machine that recorded it.
"""

import argparse
import bisect
import json
import math
import sys
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from tqdm import tqdm

from msg_schemas import topics
from msg_schemas.cdr import unpack
from msg_schemas.refusal import Refusal
from msg_schemas.samples import TETHER_COLUMNS, JointSample, Sample, TetherSample
from rover_bags.files.store import BagError
from rover_bags.reading.read import ContractMessage, ReadError
from rover_bags.resimulation.recorded_run import (
    RecordedRun,
    RunSegment,
    configured_seed,
    configured_tick,
    read_recorded_run,
)
from rover_sim import (
    START,
    AnyScenario,
    ScenarioError,
    Simulation,
    StaticsError,
    build_interface,
    build_plant,
    compile_ahead,
    scenario_from_mapping,
    simulation_from,
)

TOLERANCE: Final = 1e-6
"""Default tolerance of numbers, relative to 1 + their magnitude."""
_NANO: Final = 1_000_000_000
_MAX_DELAY: Final = 5
"""Largest delay of a command [ticks]."""
_RECONSIDERED: Final = 5
"""Decisions before the first difference that may have been other ones."""
_MOST_TRIALS: Final = 100
"""Most other runs that are tried at the first difference."""
_NOT_COMPARED: Final = frozenset({topics.CLOCK, topics.MARKERS})


class ResimError(BagError):
    """A bag that cannot be re-simulated; the message states what it lacks."""


@dataclass(frozen=True)
class Difference:
    """A number that differs.

    Attributes:
        time_s: simulated time [s].
        topic, field: topic and field path.
        recorded, resimulated: its two values.
    """

    time_s: float
    topic: str
    field: str
    recorded: float
    resimulated: float

    def text(self) -> str:
        """Return the difference as text."""
        return (
            f"at {self.time_s:.6f} s, {self.topic}, {self.field}: recorded {self.recorded!r}, "
            f"re-simulated {self.resimulated!r}"
        )


@dataclass
class TopicComparison:
    """Comparison of one topic.

    Attributes:
        compared: number of compared samples.
        identical: number of bit-identical samples.
        outside: number of samples outside the tolerance.
        first: the first difference.
        largest: the largest difference, relative to 1 + the magnitude.
        error: size of the largest difference.
    """

    compared: int = 0
    identical: int = 0
    outside: int = 0
    first: Difference | None = None
    largest: Difference | None = None
    error: float = 0.0


@dataclass
class Resimulation:
    """Result of a re-simulation.

    Attributes:
        bag: path of the bag.
        scenario, seed, tick: scenario, seed and tick [s] of the first recorded simulation.
        tolerance: tolerance of the comparison.
        simulated_s: total simulated time [s].
        commands: number of commands given to the plant.
        refused: number of commands that the plant refused.
        delayed: number of commands with an inferred delay.
        resets: number of resets of plant or clock.
        comparisons: comparison of each topic.
        first: the first difference.
        first_outside: the first difference outside the tolerance.
        notes: limitations of the comparison.
    """

    bag: Path
    scenario: str
    seed: int
    tick: float
    tolerance: float
    simulated_s: float = 0.0
    commands: int = 0
    refused: int = 0
    delayed: int = 0
    resets: int = 0
    comparisons: dict[str, TopicComparison] = field(default_factory=dict)
    first: Difference | None = None
    first_outside: Difference | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def compared(self) -> int:
        """Number of compared samples."""
        return sum(one.compared for one in self.comparisons.values())

    @property
    def differing(self) -> int:
        """Number of samples that are not bit-identical."""
        return sum(one.compared - one.identical for one in self.comparisons.values())

    @property
    def identical(self) -> bool:
        """Whether every compared sample is bit-identical."""
        return self.compared > 0 and self.differing == 0

    @property
    def within(self) -> bool:
        """Whether every compared sample is within the tolerance."""
        return self.compared > 0 and self.first_outside is None

    def text(self) -> str:
        """Return the result as text for a terminal."""
        lines = [
            (
                f"{self.bag}: scenario {self.scenario}, seed {self.seed}, {self.simulated_s:.3f} s "
                f"re-simulated with a tick of {self.tick:g} s"
            ),
            f"{self.commands} commands given, {self.refused} refused"
            + (f", {self.delayed} of them delayed" if self.delayed else "")
            + (f"; {self.resets} resets" if self.resets else ""),
        ]
        lines += [f"! {note}" for note in self.notes]
        lines.append(
            f"  {'topic':24s}{'compared':>10s}{'identical':>11s}{'outside':>9s}  largest error"
        )
        for name, one in sorted(self.comparisons.items()):
            most = "" if one.largest is None else f"{one.error:.1e} in {one.largest.field}"
            lines.append(
                f"  {name:24s}{one.compared:10d}{one.identical:11d}{one.outside:9d}  {most}"
            )
        if self.identical:
            lines.append("every recorded sample is bit-identical")
            return "\n".join(lines)
        if self.first is not None:
            lines.append(f"first difference: {self.first.text()}")
        if self.within:
            lines.append(f"every sample is within the tolerance of {self.tolerance:g}")
        elif self.first_outside is not None:
            lines.append(
                f"first difference outside {self.tolerance:g}: {self.first_outside.text()}"
            )
        else:
            lines.append("no sample could be compared")
        return "\n".join(lines)

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "bag": str(self.bag),
            "scenario": self.scenario,
            "seed": self.seed,
            "tick_s": self.tick,
            "tolerance": self.tolerance,
            "simulated_s": self.simulated_s,
            "commands": self.commands,
            "refused": self.refused,
            "delayed": self.delayed,
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
                    "largest_error": one.error if math.isfinite(one.error) else None,
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
    """Simulate a recorded run again and compare it with the record.

    Args:
        path: the bag.
        tolerance: tolerance of numbers, relative to 1 + their magnitude.
        namespace: namespace of the rover, if the bag holds several.
        show_progress: whether to show a progress bar.

    Raises:
        ResimError: the bag holds no valid configuration of a simulator.
        BagError: the bag cannot be read.
    """
    recorded_run = read_recorded_run(path, namespace)
    first = recorded_run.segments[0].configuration
    if first is None:
        raise ResimError(
            f"{path} holds no configuration of a simulator ({topics.CONFIG} with a scenario): the "
            "scenario is unknown"
        )
    configured, simulation = _simulation(path, first, None)
    found = Resimulation(
        path, configured.scenario.name, configured.seed, configured.tick, tolerance
    )
    _note_limits(found, recorded_run)
    total = sum(segment.last_ns for segment in recorded_run.segments) / _NANO
    with tqdm(total=total, unit=" s", desc="re-simulating", disable=not show_progress) as bar:
        for number, segment in enumerate(recorded_run.segments):
            if number:
                known = configured, simulation
                configured, simulation = _simulation(path, segment.configuration or first, known)
                found.resets += 1
            _run_segment(simulation, segment, found, bar)
    return found


class _Configured(NamedTuple):
    """What determines a recorded simulation."""

    scenario: AnyScenario
    tick: float
    seed: int
    start: Mapping[str, Any] | None


_Known: TypeAlias = tuple[_Configured, Simulation[Any]]


def _simulation(path: Path, configuration: Mapping[str, Any], known: _Known | None) -> _Known:
    """Build a recorded simulation at its start, or reset the known one if it is the same."""
    try:
        configured = _Configured(
            scenario_from_mapping(configuration["scenario"]),
            configured_tick(configuration),
            configured_seed(configuration),
            configuration.get(START),
        )
        if known is not None and known[0] == configured:
            known[1].reset()
            return known
        # Ahead, so that this process runs the same compiled code as the recorded one.
        compile_ahead(configured.scenario)
        plant = build_plant(configured.scenario)
        plant.warm_up()
        interface = build_interface(plant, configured.seed)
        return configured, simulation_from(interface, configured.tick, configured.start)
    except KeyError as error:
        raise ResimError(
            f"the simulator's configuration in {path} lacks {error}: it holds "
            f"{', '.join(sorted(configuration))}"
        ) from error
    except (ScenarioError, StaticsError, TypeError, ValueError) as error:
        raise ResimError(
            f"the simulator's configuration in {path} cannot be simulated here: {error}"
        ) from error


def _note_limits(found: Resimulation, recorded_run: RecordedRun) -> None:
    found.notes += recorded_run.file_defects
    tick_ns = round(found.tick * _NANO)
    for segment in recorded_run.segments:
        found.notes += [
            f"nothing is recorded from {before / _NANO:.3f} s to {after / _NANO:.3f} s of "
            "simulated time: commands in this gap are missing, and later samples may differ"
            for before, after in segment.gaps(tick_ns, segment.first_ns, segment.last_ns)
        ]
    first = (
        recorded_run.segments[0].ticks[0][1] / _NANO
        if recorded_run.segments and recorded_run.segments[0].ticks
        else 0.0
    )
    if first > 2.0 * found.tick:
        found.notes.append(
            f"the recording starts at {first:.3f} s of simulated time: earlier commands are missing"
        )
    if not any(segment.ticks for segment in recorded_run.segments):
        found.notes.append("the clock was not recorded: commands are given at their stamps")


def _run_segment(
    simulation: Simulation[Any], segment: RunSegment, found: Resimulation, bar: Any
) -> None:
    waiting = [(earliest_instant(segment, command), command) for command in segment.commands]
    run = _Run(simulation, segment, waiting, found)
    _compare(simulation, segment.recorded.get(0, {}), found, over_a_tick=False)
    decisions: deque[_Decision] = deque(maxlen=_RECONSIDERED)
    while run.simulation.stamp_ns < segment.last_ns:
        is_exact = run.found.first is None
        decision = run.advance()
        if decision is not None:
            decisions.append(decision)
        if is_exact and run.found.first is not None:
            run = _reconsidered(decisions, run)
            decisions.clear()
        bar.update(run.simulation.tick_ns / _NANO)
    vars(found).update(vars(run.found))


class _TriedTick(NamedTuple):
    """A tick with some of the commands that may be given."""

    taken: tuple[int, ...]
    simulation: Simulation[Any]
    given: Resimulation
    error: float


@dataclass
class _Run:
    """A re-simulation of a segment of the record.

    Attributes:
        simulation: at the present instant.
        segment: of the recorded run.
        waiting: commands with the earliest instants [ns] at which they can have arrived.
        found: the result until now.
        place: of the first of `waiting` that cannot have arrived yet.
        arrived: commands that may be given.
    """

    simulation: Simulation[Any]
    segment: RunSegment
    waiting: Sequence[tuple[int, ContractMessage]]
    found: Resimulation
    place: int = 0
    arrived: tuple[tuple[int, ContractMessage], ...] = ()

    def advance(self) -> "_Decision | None":
        """Advance by a tick; returns its decision, if there was one and the run was exact."""
        simulation, now = self.simulation, self.simulation.stamp_ns
        if now in self.segment.plant_resets:
            simulation.reset_plant()
            self.found.resets += 1
            initial = self.segment.after_reset.get(now, {})
            _compare(simulation, initial, self.found, over_a_tick=False)
        first = self.place
        while self.place < len(self.waiting) and self.waiting[self.place][0] <= now:
            self.place += 1
        self.arrived += tuple(self.waiting[first : self.place])
        if not self.arrived or self.found.first_outside is not None:
            _apply(simulation, [command for _, command in self.arrived], self.found)
            self.arrived = ()
            simulation.tick()
            self._compare()
            return None
        oldest = now - (_MAX_DELAY - 1) * simulation.tick_ns
        forced = Counter(command.name for at, command in self.arrived if at <= oldest)
        choices = _choices([command for _, command in self.arrived], forced)
        best = self.tried(next(choices))
        while best.error and (taken := next(choices, None)) is not None:
            best = min(best, self.tried(taken), key=lambda trial: trial.error)
        decision = _Decision(self.copy(), choices) if self.found.first is None else None
        self.take(best)
        return decision

    def tried(self, taken: tuple[int, ...]) -> _TriedTick:
        """Advance a copy of the simulation by a tick, with the commands at these places."""
        trial, whole = self.simulation.fork(), self.found
        given = Resimulation(whole.bag, whole.scenario, whole.seed, whole.tick, whole.tolerance)
        _apply(trial, [self.arrived[place][1] for place in taken], given)
        trial.tick()
        return _TriedTick(taken, trial, given, _distance(trial, self.segment))

    def take(self, trial: _TriedTick) -> None:
        """Go on from a trial."""
        self.simulation = trial.simulation
        self.found.commands += trial.given.commands
        self.found.refused += trial.given.refused
        self.found.delayed += len(self.arrived) - len(trial.taken)
        self.arrived = tuple(
            each for place, each in enumerate(self.arrived) if place not in trial.taken
        )
        self._compare()

    def _compare(self) -> None:
        recorded = self.segment.recorded.get(self.simulation.stamp_ns, {})
        _compare(self.simulation, recorded, self.found)
        self.found.simulated_s += self.simulation.tick_ns / _NANO

    def copy(self) -> "_Run":
        """Return a copy of the run; they share the simulation until one is advanced by a trial."""
        comparisons = {name: replace(row) for name, row in self.found.comparisons.items()}
        return replace(self, found=replace(self.found, comparisons=comparisons))


class _Decision(NamedTuple):
    """An instant at which other commands may have been taken.

    Attributes:
        run: at the instant.
        others: places of commands that were not tried.
    """

    run: _Run
    others: Iterator[tuple[int, ...]]


def _reconsidered(decisions: Iterable[_Decision], run: _Run) -> _Run:
    """Return a run to the same instant, exact by other decisions; the run itself if none is.

    The effect of a command may show only some ticks later: as long as the nut does not move, one
    that is refused in flight and one that is accepted after the landing differ by nothing.
    """
    until = run.simulation.stamp_ns
    open_decisions = list(decisions)
    for _ in range(_MOST_TRIALS):
        if not open_decisions:
            break
        taken = next(open_decisions[-1].others, None)
        if taken is None:
            open_decisions.pop()
            continue
        other = open_decisions[-1].run.copy()
        other.take(other.tried(taken))
        while other.found.first is None and other.simulation.stamp_ns < until:
            decision = other.advance()
            if decision is not None:
                open_decisions.append(decision)
        if other.found.first is None:
            return other
    return run


def earliest_instant(segment: RunSegment, command: ContractMessage) -> int:
    """Return the earliest simulated time at which a command can have arrived [ns]."""
    place = bisect.bisect_right(segment.ticks, (command.publish_ns, 1 << 62)) - 1
    clock_ns = segment.ticks[place][1] if place >= 0 else 0
    stamp: int = getattr(command.sample, "stamp_ns", 0)
    return max(clock_ns, 0) if segment.ticks else stamp


def _choices(
    arrived: Sequence[ContractMessage], forced: Mapping[str, int]
) -> Iterator[tuple[int, ...]]:
    """Places of the commands that may have been taken: of each topic the first ones; all first."""
    places: dict[str, list[int]] = {}
    for place, command in enumerate(arrived):
        places.setdefault(command.name, []).append(place)
    counts = (range(len(own), forced.get(name, 0) - 1, -1) for name, own in places.items())
    for numbers in product(*counts):
        pairs = zip(places.values(), numbers, strict=True)
        yield tuple(sorted(place for own, number in pairs for place in own[:number]))


def _apply(
    simulation: Simulation[Any], commands: Sequence[ContractMessage], found: Resimulation
) -> None:
    """Give commands to the plant, validated as in the simulator's node."""
    for command in commands:
        try:
            sample = unpack(command.name, command.data, simulation.stamp_ns)
            if isinstance(sample, JointSample):
                simulation.accept_command(command.name, sample)
                found.commands += 1
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
    """Differences relative to 1 + magnitude; infinite where they cannot be compared."""
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
        row = found.comparisons.setdefault(name, TopicComparison())
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


class ResimExitCode(IntEnum):
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
                        help="tolerance of numbers, relative to 1 + their magnitude "
                        "(default: %(default)g)")  # fmt: skip
    parser.add_argument(
        "--exact", action="store_true", help="exit with 1 unless every sample is bit-identical"
    )
    parser.add_argument(
        "--namespace", metavar="NS", help="namespace of the rover, if the bag holds several"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`ResimExitCode`."""
    if not 0.0 <= options.tolerance < math.inf:
        print(
            f"mother_rover bag resim: --tolerance is {options.tolerance}, it should be a finite "
            "number of at least 0",
            file=sys.stderr,
        )
        return ResimExitCode.REFUSED
    try:
        found = resimulate(
            options.bag,
            tolerance=options.tolerance,
            namespace=options.namespace,
            show_progress=sys.stderr.isatty(),
        )
    except (BagError, ReadError) as error:
        print(f"mother_rover bag resim: {error}", file=sys.stderr)
        return ResimExitCode.REFUSED
    print(json.dumps(found.to_mapping(), indent=2) if options.json else found.text())
    good = found.identical if options.exact else found.within
    return ResimExitCode.SAME if good else ResimExitCode.DIFFERS
