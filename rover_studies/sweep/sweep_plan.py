"""Plan of a sweep: read from YAML, checked, and expanded to numbered runs.

    name: slack_and_tilt
    scenario: paper_table1_high      # of the package, or a path beside this file
    experiment: jump                 # see `sweep --help`
    seed: 1
    runs: 50                         # for each point of the grid, with different random draws
    set: {tether.elements: 10}       # for every run
    grid:                            # every combination
      start.geometry: [-H, +K]
      start.slack: {from: 0.6, to: 3.4, count: 15}
      bodies:                        # values that change together
        - {rover.m1: 3.0, rover.m2: 2.0}
        - {rover.m1: 4.0, rover.m2: 1.0}
    random:                          # random draws of every run
      start.theta0: {normal: [0.0, 5.0], within: [-15.0, 15.0]}
      rover.spring_rate: {factor: {uniform: [0.95, 1.05]}}

A number in a path is the index of a list's entry, from 0: `start.tilt.1`.

A run is defined by its number: its random draws derive from the seed and the number, independent of
the number of workers and the order of the runs.

In place of `runs` and `grid`, a plan may have the probability of a rare event estimated:

    rare_event:
      quantity: peak_tension_N       # a numerical result of the experiment
      above: 400.0                   # or below
      relative_error: 0.2            # of the probability, at 95 %
      max_runs: 10000
      method: importance_sampling    # or monte_carlo: random draws as they are
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.special import ndtr, ndtri

from msg_schemas.fields import is_finite_number, shown
from rover_sim import AnyScenario, ScenarioError, load_scenario, read_yaml, scenario_from_mapping
from rover_studies.sweep.experiments import EXPERIMENTS, SweepExperiment, Value
from rover_studies.sweep.rare_event import MOST_VALUES, Floats, Method, RareEvent, Round, points_of

SCENARIO: Final = "scenario"
_KEYS: Final = (
    "name", "about", "scenario", "experiment", "seed", "runs", "set", "grid", "random", "settings",
    "rare_event",
)  # fmt: skip
_MOST_RUNS: Final = 100_000_000
_MOST_POINTS: Final = 100_000  # of an axis
_LONGEST: Final = 120  # characters of a name
_LEAST_WITHIN: Final = 1e-4  # of a distribution
_LARGEST_WHOLE: Final = 2**63 - 1  # of a column of the results
_FEWEST_RUNS: Final = 2000  # of a rare event; intervals from fewer are too narrow
_DISTRIBUTIONS: Final = ("uniform", "log_uniform", "normal", "integers")


class SweepPlanError(ValueError):
    """An invalid plan; the message has the path, the value and the expected values."""


@dataclass(frozen=True)
class Axis:
    """One dimension of the grid; each of its points sets one or more values."""

    name: str
    points: tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Draw:
    """A random value.

    Attributes:
        path: of the value.
        kind: distribution, of `_DISTRIBUTIONS`, or ``choice``.
        numbers: parameters of the distribution, or the values to choose from.
        within: range that cuts the distribution off.
        factor: whether it multiplies the scenario's value.
    """

    path: str
    kind: str
    numbers: tuple[Any, ...]
    within: tuple[float, float] | None = None
    factor: bool = False

    def value(self, normal: float) -> Any:
        """Return the value of the same cumulative probability as a standard normal value."""
        probability = float(ndtr(normal))
        if self.kind == "choice":
            return self.numbers[min(int(probability * len(self.numbers)), len(self.numbers) - 1)]
        first, second = self.numbers
        low, high = self.within or (-math.inf, math.inf)
        if self.kind == "normal":
            if self.within is None:
                return first + second * normal
            start, end = self._normal_range()
            value = first + second * float(ndtri(start + probability * (end - start)))
            return min(max(value, low), high)
        low, high = max(low, first), min(high, second)
        if self.kind == "integers":
            low, high = math.ceil(low), math.floor(high)
            return min(int(low + probability * (high - low + 1)), high)
        if self.kind == "log_uniform":
            return float(low * (high / low) ** probability)
        return float(low + probability * (high - low))

    def _normal_range(self) -> tuple[float, float]:
        mean, deviation = self.numbers
        start, end = (float(ndtr((edge - mean) / deviation)) for edge in self.within or ())
        return start, end

    @property
    def share_within(self) -> float:
        """Part of the distribution that lies in the range."""
        if self.within is None:
            return 1.0
        if self.kind == "normal":
            start, end = self._normal_range()
            return end - start
        first, second = self.numbers
        low, high = max(self.within[0], first), min(self.within[1], second)
        if self.kind == "integers":
            return float(max(math.floor(high) - math.ceil(low) + 1, 0) / (second - first + 1))
        if self.kind == "log_uniform" and high > low:
            return float(math.log(high / low) / math.log(second / first))
        return float(max(high - low, 0.0) / (second - first))


@dataclass(frozen=True)
class SweepRun:
    """One run of a plan.

    Attributes:
        number: from 0.
        scenario: name of its scenario.
        overrides: values by dotted path, of the grid and the random draws.
        seed: of the random numbers within the run.
    """

    number: int
    scenario: str
    overrides: Mapping[str, Any]
    seed: int


@dataclass(frozen=True)
class SweepPlan:
    """A checked plan with complete scenarios, so that other machines need no files.

    Attributes:
        content: the plan as plain values with complete scenarios, to be hashed, stored and sent.
    """

    content: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Short name."""
        return str(self.content["name"])

    @property
    def seed(self) -> int:
        """Seed of every draw."""
        return int(self.content["seed"])

    @property
    def settings(self) -> Mapping[str, float]:
        """Settings of the experiment."""
        return dict(self.content["settings"])

    @cached_property
    def experiment(self) -> SweepExperiment:
        """Experiment of each run."""
        return EXPERIMENTS[self.content["experiment"]]

    @cached_property
    def scenarios(self) -> Mapping[str, AnyScenario]:
        """Scenarios by name, with the changes of `set`."""
        return {
            name: scenario_from_mapping(mapping)
            for name, mapping in self.content["scenarios"].items()
        }

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """The grid's dimensions; the last one changes fastest."""
        return tuple(Axis(name, tuple(points)) for name, points in self.content["grid"].items())

    @cached_property
    def draws(self) -> tuple[Draw, ...]:
        """Random values in the order of drawing."""
        return tuple(
            Draw(
                path,
                row["kind"],
                tuple(row["numbers"]),
                None if row["within"] is None else (row["within"][0], row["within"][1]),
                row["factor"],
            )
            for path, row in self.content["random"].items()
        )

    @cached_property
    def rare_event(self) -> RareEvent | None:
        """The event of which the probability is estimated."""
        event = self.content["rare_event"]
        return None if event is None else RareEvent(**{**event, "method": Method(event["method"])})

    @cached_property
    def rounds(self) -> tuple[Round, ...]:
        """Rounds of runs so far for a rare event, in their order."""
        return tuple(Round.from_mapping(one) for one in self.content["rounds"])

    @cached_property
    def _normals(self) -> Floats:
        return points_of(self.rounds, self.seed)

    def with_round(self, one: Round) -> SweepPlan:
        """Return the plan with one more round."""
        rounds = [*self.content["rounds"], one.to_mapping()]
        return SweepPlan({**self.content, "rounds": rounds})

    @property
    def runs_per_point(self) -> int:
        """Number of runs of each point of the grid."""
        return int(self.content["runs"])

    @cached_property
    def points(self) -> int:
        """Number of points of the grid."""
        return math.prod(len(axis.points) for axis in self.axes)

    @property
    def count(self) -> int:
        """Number of runs; for a rare event, of the rounds so far."""
        if self.rounds:
            return sum(one.runs for one in self.rounds)
        return self.points * self.runs_per_point

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Dotted paths (and ``scenario``) that differ between runs, in their order."""
        paths = [path for axis in self.axes for path in axis.points[0]]
        return tuple(dict.fromkeys([*paths, *(draw.path for draw in self.draws)]))

    def values_of(self, path: str) -> tuple[Any, ...]:
        """Return all values of a parameter in the grid."""
        return tuple(point[path] for axis in self.axes for point in axis.points if path in point)

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the plan's content."""
        text = json.dumps(self.content, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def run(self, number: int) -> SweepRun:
        """Return the run of a number from 0 to `count` - 1."""
        if not 0 <= number < self.count:
            raise IndexError(f"run {number} of a plan of {self.count}")
        values: dict[str, Any] = {}
        rest = number // self.runs_per_point
        for axis in reversed(self.axes):
            rest, place = divmod(rest, len(axis.points))
            values = {**axis.points[place], **values}
        scenario = str(values.pop(SCENARIO, next(iter(self.scenarios))))
        if self.rounds:
            normals = self._normals[number]
        else:
            generator = np.random.default_rng([self.seed, number])
            normals = generator.standard_normal(len(self.draws))
        for draw, normal in zip(self.draws, normals, strict=True):
            value = draw.value(float(normal))
            if draw.factor:
                value *= _number_at(self.scenarios[scenario].to_mapping() | values, draw.path)
            values[draw.path] = value
        seed = int(np.random.SeedSequence([self.seed, number, 1]).generate_state(1)[0])
        return SweepRun(number, scenario, values, seed)

    def scenario_of(self, run: SweepRun) -> AnyScenario:
        """Return the scenario of a run.

        Raises:
            ScenarioError: the values of the run are invalid.
        """
        base = self.scenarios[run.scenario]
        return base.with_overrides(run.overrides) if run.overrides else base

    def row(self, run: SweepRun) -> dict[str, Value]:
        """Return number, seed and parameters of a run."""
        values = {**run.overrides, SCENARIO: run.scenario}
        row: dict[str, Value] = {"run": run.number, "seed": run.seed}
        for path in self.parameters:
            value = values[path]
            row[path] = json.dumps(value) if isinstance(value, list) else value
        return row


def _number_at(mapping: Mapping[str, Any], path: str) -> float:
    names = path.split(".")
    # A value of the run goes before the scenario's, also as an entry of a section or list.
    given = (count for count in range(len(names), 0, -1) if ".".join(names[:count]) in mapping)
    first = next(given, 1)
    node: Any = mapping.get(".".join(names[:first]))
    for name in names[first:]:
        if isinstance(node, list) and name.isdecimal():
            node = node[int(name)] if int(name) < len(node) else None
        else:
            node = node.get(name) if isinstance(node, Mapping) else None
    if not is_finite_number(node):
        raise SweepPlanError(
            f"random.{path}: `factor` needs a number to multiply, this is {shown(node)}"
        )
    return float(node)


# --- reading --------------------------------------------------------------------------------------


def load_plan(path: Path, changes: Mapping[str, Any] | None = None) -> SweepPlan:
    """Read a plan from a YAML file.

    Args:
        path: of the file; paths of scenarios are relative to it.
        changes: replace top-level keys (runs, seed); ``set`` is added to.

    Raises:
        SweepPlanError: it cannot be read or is invalid.
    """
    try:
        content = read_yaml(path)
    except ScenarioError as error:
        raise SweepPlanError(str(error)) from None
    if not isinstance(content, Mapping):
        raise SweepPlanError(f"{path}: should hold a mapping of {', '.join(_KEYS)}")
    given = dict(content)
    for key, value in (changes or {}).items():
        given[key] = {**_mapping(given, key), **value} if key == "set" else value
    return make_plan(given, path.resolve().parent, path.stem)


def make_plan(
    content: Mapping[str, Any], folder: Path | None = None, name: str = "sweep"
) -> SweepPlan:
    """Check a plan given as a mapping; the module's docstring has its keys.

    Args:
        content: the plan.
        folder: for relative paths of scenarios.
        name: default name of the plan.

    Raises:
        SweepPlanError: it is invalid.
    """
    unknown = [str(key) for key in content if key not in _KEYS]
    if unknown:
        raise SweepPlanError(f"{', '.join(unknown)}: no such key; known are {', '.join(_KEYS)}")
    grid = _grid(_mapping(content, "grid"))
    shared = _mapping(content, "set")
    named = [str(point[SCENARIO]) for points in grid.values() for point in points
             if SCENARIO in point]  # fmt: skip
    if "scenario" in content and named:
        raise SweepPlanError(
            "scenario: given at the top level and in the grid; it should be given once"
        )
    names = named or [str(content.get("scenario", ""))]
    scenarios = {each: _scenario(each, folder, shared).to_mapping() for each in names}
    experiment = str(content.get("experiment", "jump"))
    if experiment not in EXPERIMENTS:
        raise SweepPlanError(
            f"experiment: {shown(experiment)} should be one of {', '.join(EXPERIMENTS)}"
        )
    random = _random(_mapping(content, "random"))
    _check_once(shared, grid, random)
    event, rounds = None, []
    if content.get("rare_event") is not None:
        event = _rare_event(content, EXPERIMENTS[experiment], len(random))
        rounds = [Round.first(event, len(random)).to_mapping()]
    plan = SweepPlan(
        {
            "name": _name(content.get("name", name)),
            "about": str(content.get("about", "")),
            "scenarios": scenarios,
            "experiment": experiment,
            "settings": _settings(EXPERIMENTS[experiment], _mapping(content, "settings")),
            "seed": _whole(content, "seed", 1, 0, 2**63 - 1),
            "runs": _whole(content, "runs", 1, 1, _MOST_RUNS),
            "grid": grid,
            "random": random,
            "rare_event": None if event is None else dict(vars(event)),
            "rounds": rounds,
        }
    )
    if plan.count > _MOST_RUNS:
        raise SweepPlanError(f"the plan has {plan.count} runs; it should have at most {_MOST_RUNS}")
    if plan.runs_per_point > 1 and not plan.draws:
        raise SweepPlanError(
            f"runs: the {plan.runs_per_point} runs of each point would be equal; add random values "
            "under `random`, or set runs to 1"
        )
    _try(plan)
    return plan


def _mapping(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = content.get(key)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise SweepPlanError(f"{key}: {shown(value)} should be a mapping")
    return value


def _name(given: Any) -> str:
    """The plan's name, which is that of the folder of its results."""
    name = str(given)
    if not name.isprintable() or "/" in name or name in {"", ".", ".."} or len(name) > _LONGEST:
        raise SweepPlanError(
            f"name: {name!r:.60} should be the name of a folder: 1 to {_LONGEST} characters, no /"
        )
    return name


def _check_once(
    shared: Mapping[str, Any],
    grid: Mapping[str, Sequence[Mapping[str, Any]]],
    random: Mapping[str, Mapping[str, Any]],
) -> None:
    """Refuse a value that is given in two places; a factor multiplies what another one gives."""
    in_grid = {path for points in grid.values() for path in points[0]}
    drawn = {path for path, draw in random.items() if not draw.get("factor")}
    for first, paths, second, others in (
        ("set", set(shared), "grid", in_grid),
        ("set", set(shared), "random", drawn),
        ("grid", in_grid, "random", drawn),
    ):
        for path in sorted(paths & others):
            raise SweepPlanError(f"{second}.{path}: given under `{first}` too; give it once")


def _whole(content: Mapping[str, Any], key: str, default: int, low: int, high: int) -> int:
    value = content.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise SweepPlanError(f"{key}: {shown(value)} should be a whole number from {low} to {high}")
    return value


def _scenario(name: str, folder: Path | None, shared: Mapping[str, Any]) -> AnyScenario:
    source: str | Path = name
    if name.endswith((".yaml", ".yml")) and folder is not None:
        source = folder / name
    try:
        return load_scenario(source, shared)
    except ScenarioError as error:
        raise SweepPlanError(str(error)) from None


def _settings(experiment: SweepExperiment, given: Mapping[str, Any]) -> dict[str, float]:
    values = {name: setting.default for name, setting in experiment.settings.items()}
    for name, value in given.items():
        if name not in values:
            raise SweepPlanError(f"settings.{name}: no such setting; known are {', '.join(values)}")
        setting = experiment.settings[name]
        if not is_finite_number(value) or not setting.minimum <= value <= setting.maximum:
            raise SweepPlanError(
                f"settings.{name}: {shown(value)} should be a number from {setting.minimum:g} to"
                f" {setting.maximum:g} {setting.unit}"
            )
        values[name] = float(value)
    return values


def _grid(given: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    axes: dict[str, list[dict[str, Any]]] = {}
    seen: set[str] = set()
    for name, values in given.items():
        points = _points(name, values)
        paths = set(points[0])
        for point in points:
            if set(point) != paths:
                raise SweepPlanError(
                    f"grid.{name}: every entry should set the same values; {sorted(paths)} and"
                    f" {sorted(point)} differ"
                )
        texts = Counter(json.dumps(point, sort_keys=True, default=str) for point in points)
        text, times = texts.most_common(1)[0]
        if times > 1:
            raise SweepPlanError(f"grid.{name}: {text:.80} stands {times} times; give it once")
        if seen & paths:
            raise SweepPlanError(f"grid.{name}: {', '.join(sorted(seen & paths))} is given twice")
        seen |= paths
        axes[name] = points
    return axes


def _points(name: str, values: Any) -> list[dict[str, Any]]:
    where = f"grid.{name}"
    if isinstance(values, Mapping):
        return [{name: value} for value in _range(where, values)]
    if not isinstance(values, Sequence) or isinstance(values, str) or not values:
        raise SweepPlanError(
            f"{where}: {shown(values)} should be a list of values, or a range such as"
            " {from: 0.5, to: 3.5, count: 13} (add `log: true` for equal ratios)"
        )
    if all(isinstance(value, Mapping) for value in values):
        return [{str(path): value for path, value in point.items()} for point in values]
    return [{name: value} for value in values]


def _range(where: str, given: Mapping[str, Any]) -> list[float]:
    keys = {"from", "to", "count"}
    if not keys <= set(given) <= {*keys, "log"}:
        raise SweepPlanError(
            f"{where}: {shown(dict(given))} should have from, to and count (and log)"
        )
    first, last, count = given["from"], given["to"], given["count"]
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= _MOST_POINTS:
        raise SweepPlanError(
            f"{where}.count: {shown(count)} should be a whole number from 2 to {_MOST_POINTS}"
        )
    if not (is_finite_number(first) and is_finite_number(last)):
        raise SweepPlanError(
            f"{where}: from = {shown(first)}, to = {shown(last)}; should be finite numbers"
        )
    is_logarithmic = given.get("log", False)
    if not isinstance(is_logarithmic, bool):
        raise SweepPlanError(f"{where}.log: {is_logarithmic!r:.60} should be true or false")
    if not is_logarithmic:
        return [float(value) for value in np.linspace(first, last, count)]
    if not (first > 0.0 and last > 0.0):
        raise SweepPlanError(
            f"{where}: from = {shown(first)}, to = {shown(last)}; should be above 0 with log"
        )
    return [float(value) for value in np.geomspace(first, last, count)]


def _random(given: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    return {str(path): _draw(f"random.{path}", row) for path, row in given.items()}


def _draw(where: str, given: Any) -> dict[str, Any]:
    kinds = (*_DISTRIBUTIONS, "choice")
    if not isinstance(given, Mapping) or not given:
        raise SweepPlanError(
            f"{where}: {shown(given)} should be one of {', '.join(kinds)} with its numbers"
        )
    if set(given) == {"factor"}:
        factor = _draw(f"{where}.factor", given["factor"])
        if not all(map(is_finite_number, factor["numbers"])):
            raise SweepPlanError(
                f"{where}.factor: {shown(factor['numbers'])} should be finite numbers, as they"
                " multiply a value"
            )
        return {**factor, "factor": True}
    found = [key for key in given if key in kinds]
    if len(found) != 1 or set(given) - {found[0], "within"}:
        raise SweepPlanError(
            f"{where}: {shown(dict(given))} should have exactly one of {', '.join(kinds)}"
            " (and within), or be {factor: {...}}"
        )
    kind, numbers, within = found[0], given[found[0]], given.get("within")
    if not isinstance(numbers, Sequence) or isinstance(numbers, str) or not numbers:
        raise SweepPlanError(f"{where}.{kind}: {shown(numbers)} should be a list")
    if kind != "choice":
        _check_numbers(where, kind, numbers)
    for value in numbers:
        is_whole = isinstance(value, int) or kind == "integers"
        if is_whole and abs(value) > _LARGEST_WHOLE:
            raise SweepPlanError(
                f"{where}.{kind}: {shown(value)} should be at most {_LARGEST_WHOLE} in size"
            )
    if within is not None and (
        not isinstance(within, Sequence) or len(within) != 2
        or not all(map(is_finite_number, within))
        or not within[0] < within[1] or kind == "choice"
    ):  # fmt: skip
        raise SweepPlanError(
            f"{where}.within: {shown(within)} should be [low, high], with a numerical distribution"
        )
    limits = None if within is None else (float(within[0]), float(within[1]))
    share = Draw(where, kind, tuple(numbers), limits).share_within
    if share < _LEAST_WITHIN:
        raise SweepPlanError(
            f"{where}.within: {shown(list(within or ()))} holds {share:.1g} of the distribution; "
            f"the range should hold at least {_LEAST_WITHIN:g} of it"
        )
    return {"kind": kind, "numbers": list(numbers), "within": limits, "factor": False}


def _check_numbers(where: str, kind: str, numbers: Sequence[Any]) -> None:
    if len(numbers) != 2 or not all(map(is_finite_number, numbers)):
        raise SweepPlanError(f"{where}.{kind}: {shown(numbers)} should be two finite numbers")
    first, second = numbers
    right = {
        "uniform": first < second,
        "log_uniform": 0.0 < first < second,
        "normal": second > 0.0,
        "integers": first <= second and all(float(value).is_integer() for value in numbers),
    }[kind]
    if not right:
        words = {
            "uniform": "[low, high]",
            "log_uniform": "[low, high], both above 0",
            "normal": "[mean, standard deviation above 0]",
            "integers": "[low, high], whole numbers",
        }[kind]
        raise SweepPlanError(f"{where}.{kind}: {shown(list(numbers))} should be {words}")


def _rare_event(content: Mapping[str, Any], experiment: SweepExperiment, values: int) -> RareEvent:
    given = _mapping(content, "rare_event")
    keys = ("quantity", "above", "below", "relative_error", "max_runs", "method")
    unknown = [str(key) for key in given if key not in keys]
    if unknown:
        raise SweepPlanError(
            f"rare_event.{', '.join(unknown)}: no such key; known are {', '.join(keys)}"
        )
    if "grid" in content or "runs" in content:
        raise SweepPlanError(
            "rare_event: the plan has a grid or runs; a rare event is of one distribution, given "
            "under `random`, and determines its runs, up to rare_event.max_runs"
        )
    if not values:
        raise SweepPlanError("rare_event: the plan should have random values under `random`")
    quantities = [name for name, kind in experiment.columns.items() if kind in {float, int}]
    quantity = given.get("quantity")
    if quantity not in quantities:
        raise SweepPlanError(
            f"rare_event.quantity: {shown(quantity)} should be one of {', '.join(quantities)}"
        )
    sides = [side for side in ("above", "below") if side in given]
    if len(sides) != 1 or not is_finite_number(given[sides[0]]):
        printed = {side: given[side] for side in sides}
        raise SweepPlanError(
            f"rare_event: {shown(printed)} should be either above or below with a finite number"
        )
    error = given.get("relative_error", 0.2)
    if not is_finite_number(error) or not 0.01 <= error <= 1.0:
        raise SweepPlanError(
            f"rare_event.relative_error: {shown(error)} should be a number from 0.01 to 1"
        )
    method = given.get("method", str(Method.IMPORTANCE_SAMPLING))
    if method not in list(Method):
        raise SweepPlanError(
            f"rare_event.method: {shown(method)} should be one of {', '.join(Method)}"
        )
    if method == Method.IMPORTANCE_SAMPLING and values > MOST_VALUES:
        raise SweepPlanError(
            f"rare_event: {values} random values; importance_sampling takes at most {MOST_VALUES}: "
            "fix the values of least influence, or use the method monte_carlo"
        )
    try:
        runs = _whole(given, "max_runs", 10_000, _FEWEST_RUNS, _MOST_RUNS)
    except SweepPlanError as caught:
        raise SweepPlanError(f"rare_event.{caught}") from None
    limit = float(given[sides[0]])
    return RareEvent(quantity, limit, sides[0] == "above", float(error), runs, Method(method))


# --- trial scenarios ------------------------------------------------------------------------------

_TRIED_PER_POINT: Final = 24


def _try(plan: SweepPlan) -> None:
    """Refuse a value of the grid for which no run has a valid scenario."""
    if not plan.axes:
        _try_some(plan, "no run of the plan", range(min(plan.count, _TRIED_PER_POINT)))
    for place, axis in enumerate(plan.axes):
        for index, point in enumerate(axis.points):
            numbers = itertools.islice(_numbers_with(plan, place, index), _TRIED_PER_POINT)
            printed = ", ".join(f"{path} = {shown(value)}" for path, value in point.items())
            _try_some(plan, f"no run with {printed} (grid.{axis.name})", numbers)


def _try_some(plan: SweepPlan, what: str, numbers: Iterator[int] | range) -> None:
    error: Exception | None = None
    for number in numbers:
        try:
            plan.experiment.accepts(plan.scenario_of(plan.run(number)))
        except ScenarioError as caught:
            error = error or caught
        else:
            return
    if error is not None:
        raise SweepPlanError(f"{what} can be built: {error}")


def _numbers_with(plan: SweepPlan, place: int, index: int) -> Iterator[int]:
    """Yield numbers of some runs at one point of an axis, at random points of the other axes."""
    sizes = [len(axis.points) for axis in plan.axes]
    generator = np.random.default_rng(0)
    for _ in range(_TRIED_PER_POINT):
        places = [int(generator.integers(size)) for size in sizes]
        places[place] = index
        yield int(np.ravel_multi_index(places, sizes)) * plan.runs_per_point
