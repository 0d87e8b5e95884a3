"""Cases of the bench, and the runs of both codes at matched tip error."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from rover_sim import PlanarPlant, PlanarState, PlantCommand, load_scenario
from rover_verify.bench.exudyn_peer import ExudynModel
from rover_verify.bench.trial import SAMPLE, BenchSetting, Trial

_NO_COMMAND = PlantCommand()

OURS = "energy_momentum"
# The step and tolerance of the suite's own runs.
FLOWN = BenchSetting(1e-3, 1e-8, OURS)
PEER_USUAL = BenchSetting(1e-3, 1e-8, "GeneralizedAlpha")

_COARSE = 20  # elements
# A shorter run is repeated and its shortest time counts: other load on the computer would otherwise
# distort short runs more than long ones [s].
_LONG_ENOUGH = 0.1
_MOST_REPEATS = 50
# Fine steps, so that errors can be matched closely; each divides the sampling period.
_PARTS = (10, 12, 14, 17, 20, 24, 28, 32, 36, 40, 45, 50, 60, 70, 80, 100, 140, 200, 400)
_STEPS = tuple(SAMPLE / k for k in _PARTS)


@dataclass(frozen=True)
class BenchCase:
    """One motion at one number of elements.

    Attributes:
        name: shown in the table.
        scenario: name of a shipped scenario.
        overrides: by dotted path.
        elements: n.
        duration: simulated time that is timed [s].
        compared_until: end of the comparison of tip errors [s]; later the motion is chaotic and
            paths cannot be compared point by point.
        accuracy: tip error at which the codes are compared [m].
    """

    name: str
    scenario: str
    overrides: tuple[tuple[str, object], ...]
    elements: int
    duration: float
    compared_until: float
    accuracy: float

    def plant(self, setting: BenchSetting = FLOWN) -> PlanarPlant:
        """Our plant at a setting."""
        overrides = {
            **dict(self.overrides),
            "tether.elements": self.elements,
            "integration.h": setting.h,
            "integration.tolerance": setting.tolerance,
        }
        return PlanarPlant(load_scenario(self.scenario, overrides))

    def start(self) -> PlanarState:
        """Initial state of both codes; a rover has just taken off."""
        plant = self.plant()
        state = plant.initial_state()
        return state if plant.scenario.rover is None else plant.take_off(state)


def _jump(geometry: str, slack: float) -> tuple[tuple[str, object], ...]:
    return (
        ("start.geometry", geometry),
        ("start.slack", slack),
        ("after_landing", "fly_on"),
    )


def cases() -> list[BenchCase]:
    """Every case, in the table's order."""
    pendulum, rover = "tether_pendulum", "paper_table1_high"
    below, above = _jump("-H", 0.5), _jump("+K", 2.0)
    return [
        *(BenchCase("pendulum, 1 s", pendulum, (), n, 1.0, 0.8, 1e-3) for n in (5, 20, 50, 100)),
        *(BenchCase("pendulum, 2 s", pendulum, (), n, 2.0, 0.8, 1e-3) for n in (20, 100)),
        *(BenchCase("jump", rover, below, n, 0.4, 0.4, 1e-4) for n in (5, 20, 50, 100)),
        *(BenchCase("jump, stretched", rover, above, n, 0.4, 0.4, 1e-4) for n in (20, 100)),
    ]


class Ours:
    """Our plant, through its public face, one call per sample."""

    def __init__(self, case: BenchCase) -> None:
        self._case = case
        self._start = case.start()

    def run(self, setting: BenchSetting, duration: float) -> Trial | None:
        """Simulate from the start; None if the plant diverges."""
        plant = self._case.plant(setting)
        plant.warm_up()
        state, path, iterations = self._start, [self._start.nodes[-1, 0]], 0
        began = time.process_time()
        for _ in range(round(duration / SAMPLE)):
            state, result = plant.step(state, _NO_COMMAND, SAMPLE)
            path.append(state.nodes[-1, 0])
            iterations += result.newton_iterations
        spent = time.process_time() - began
        return None if state.phase.final else Trial(spent, np.array(path), iterations)

    def settings(self) -> list[BenchSetting]:
        """Candidate settings: every step with loose and tight tolerances [m]."""
        return [
            BenchSetting(h, tolerance, OURS) for h in _STEPS for tolerance in (1e-3, 1e-5, 1e-8)
        ]

    def reference(self) -> BenchSetting:
        """Setting of the converged solution."""
        h = 1e-3 / 32 if self._case.elements <= _COARSE else 1e-3 / 16
        return BenchSetting(h, 1e-11, OURS)


class Exudyn:
    """The peer: implicit methods with pins and joints, explicit ones with springs as pins.

    Exudyn's explicit integrators eliminate the pin's constraint wrongly if the mass matrix is not
    diagonal (they converge to a motion that deviates by 18 mm), so they get a stiff spring instead,
    whose compliance counts as their error. They do not support the joints of a rover.
    """

    def __init__(self, case: BenchCase) -> None:
        plant, start = case.plant(), case.start()
        self._case = case
        self._pinned = ExudynModel(plant, start, springy_pins=False)
        self._springy = (
            ExudynModel(plant, start, springy_pins=True) if plant.scenario.rover is None else None
        )

    def run(self, setting: BenchSetting, duration: float) -> Trial | None:
        """Simulate from the start; None if the solver gives up."""
        if setting.method == "VelocityVerlet":
            return None if self._springy is None else self._springy.run(setting, duration)
        return self._pinned.run(setting, duration)

    def settings(self) -> list[BenchSetting]:
        """Candidate settings: generalised-alpha, and Verlet where its stable step is not tiny."""
        steps, tolerances = list(_STEPS), [1e-2, 1e-3, 1e-5]
        if self._case.elements > _COARSE:
            # Others are never the best on fine meshes; with a rover they fail after minutes.
            steps, tolerances = [h for h in steps if 5e-4 <= h <= 2.5e-3], [1e-3, 1e-5]
            if self._springy is None:
                steps = [h for h in steps if h <= 1.25e-3]
        found = [BenchSetting(h, each, "GeneralizedAlpha") for h in steps for each in tolerances]
        found.append(PEER_USUAL)
        if self._springy is not None and self._case.elements <= _COARSE:
            found += [BenchSetting(h, 0.0, "VelocityVerlet") for h in (2.5e-4, 1.25e-4)]
        return found

    def reference(self) -> BenchSetting:
        """Setting of the converged solution."""
        h = 1e-3 / 32 if self._case.elements <= _COARSE else 1e-3 / 16
        return BenchSetting(h, 1e-10, "GeneralizedAlpha")


@dataclass(frozen=True)
class Point:
    """Cost and error of one setting of one code in a case."""

    setting: BenchSetting
    cpu: float
    error: float
    iterations: int


@dataclass(frozen=True)
class Survey:
    """Results of a code's settings in a case, and the convergence of its reference.

    Attributes:
        points: every setting that completed the run.
        reference_change: largest change of the reference when its step is halved [m].
    """

    points: tuple[Point, ...]
    reference_change: float

    def fastest(self, error: float) -> Point | None:
        """The fastest setting whose error is not above the given one."""
        good = [point for point in self.points if point.error <= error]
        return min(good, key=lambda point: point.cpu, default=None)

    def most_accurate(self) -> Point:
        """The setting with the smallest error."""
        return min(self.points, key=lambda point: point.error)

    def at(self, setting: BenchSetting) -> Point | None:
        """The point of a setting, None if it did not complete the run."""
        return next((point for point in self.points if point.setting == setting), None)

    def frontier(self) -> list[Point]:
        """Pareto front of cost and error, by increasing cost."""
        kept: list[Point] = []
        for point in sorted(self.points, key=lambda point: point.cpu):
            if not kept or point.error < kept[-1].error:
                kept.append(point)
        return kept


Code = Ours | Exudyn


def survey(case: BenchCase, code: Code, progress: Callable[[str], None]) -> Survey:
    """Run a code on a case at its reference and at all its settings."""
    until = case.compared_until
    fine = code.reference()
    coarser = BenchSetting(2.0 * fine.h, fine.tolerance, fine.method)
    progress("reference")
    reference = _trial(code.run(fine, until)).path
    change = _trial(code.run(coarser, until)).error(reference, until)
    points = []
    for setting in code.settings():
        progress(str(setting))
        trial = _best(partial(code.run, setting, case.duration))
        if trial is not None:
            points.append(
                Point(setting, trial.cpu, trial.error(reference, until), trial.iterations)
            )
    return Survey(tuple(points), change)


def _best(run: Callable[[], Trial | None]) -> Trial | None:
    """The fastest of repeated runs; short runs are repeated more often."""
    best = run()
    if best is None:
        return None
    for _ in range(min(_MOST_REPEATS, round(_LONG_ENOUGH / max(best.cpu, 1e-9)))):
        again = run()
        if again is not None and again.cpu < best.cpu:
            best = again
    return best


def _trial(trial: Trial | None) -> Trial:
    if trial is None:
        raise RuntimeError("the reference solution diverged")
    return trial


@dataclass(frozen=True)
class Match:
    """The settings of both codes that are compared; ours is at least as accurate."""

    ours: Point
    peer: Point | None


def match(case: BenchCase, ours: Survey, peer: Survey | None) -> Match:
    """Settings of equal accuracy: the peer's fastest within the case's accuracy, ours to match.

    Ours is the fastest that is at least as accurate as the peer's, so the remaining difference in
    accuracy is to our disadvantage.
    """
    if peer is None:
        return Match(ours.fastest(case.accuracy) or ours.most_accurate(), None)
    theirs = peer.fastest(case.accuracy) or peer.most_accurate()
    return Match(ours.fastest(theirs.error) or ours.most_accurate(), theirs)


def ratios_along(ours: Survey, peer: Survey, accuracy: float) -> Iterator[tuple[float, float]]:
    """(peer's error, peer's cost over ours) at each point of the peer's frontier.

    Only points that ours can match and whose error is at most ten times the case's accuracy.
    """
    for theirs in peer.frontier():
        own = ours.fastest(theirs.error)
        if own is not None and theirs.error <= 10.0 * accuracy:
            yield theirs.error, theirs.cpu / own.cpu


def timed(
    runs: Sequence[Callable[[], Trial | None]], repetitions: int, progress: Callable[[str], None]
) -> list[float]:
    """Median CPU time of each run [s]; runs take turns so that other load affects all alike.

    Short runs are repeated each time, see `_best`.
    """
    spent: list[list[float]] = [[] for _ in runs]
    for repetition in range(repetitions):
        progress(f"timing {repetition + 1}/{repetitions}")
        for index, run in enumerate(runs):
            trial = _best(run)
            if trial is not None:
                spent[index].append(trial.cpu)
    return [statistics.median(times) if times else float("nan") for times in spent]
