"""Identify a cable's laws from takes, in stages from few numbers to many."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rover_sim import available_cores, natural_curvature_of
from rover_validation.cable.comparison import error_of
from rover_validation.cable.model import (
    Band,
    Cable,
    CableGeometry,
    Prepared,
    arcs_of,
    band_factor,
    with_numbers,
)
from rover_validation.cable.takes import GIVEN_FRAMES, Floats, Take
from rover_validation.estimation import EstimatedNumber, Identified, estimate
from rover_validation.refusals import SetError

FEW, MANY = 5, 15
"""Numbers that can be identified: three laws and what two numbers show of the shape, or all."""
_RESIDUAL: Final = 0.02
"""Size of an error from which it counts linearly [m]."""
_EVERY: Final = 0.1
"""Time between frames whose errors are counted [s]."""
_SCOUTS: Final = 6
"""Takes on which first guesses are tried."""
_KNOTS: Final = 3
"""Places along the cable between which its natural curvature is linear."""
_LITTLE_DRAG: Final = 0.012
"""Drag per mass below which the takes do not show it [1/m]."""
_LITTLE_RELAXATION: Final = 0.05
"""Ratio of the stiffness that relaxes below which the takes do not show it [-]."""
_COVERAGE: Final = 0.90
_SLOPES: Final = (0.0, 0.5, 1.0, 2.0, 4.0)
_RISES: Final = (0.05, 0.15, 0.4)

_FIXED: Final[Mapping[str, float]] = {
    "marker_mass": 0.03, "twist_ratio": 0.8, "length_ratio": 1.0, "drag": 0.0,
    "root_tilt_1": 0.0, "root_tilt_2": 0.0, "tip_tilt_1": 0.0, "tip_tilt_2": 0.0,
    "relaxation_ratio": 0.0, "relaxation_time": 3.0,
}  # fmt: skip
"""What is not identified: marker masses as metres of cable, GJ/EI, ratio of length.

Takes of 5 s fit relaxation times of 1 to 10 s about equally well.
"""


@dataclass(frozen=True)
class CableIdentification:
    """An identified cable and how it was found.

    Attributes:
        cable: with its band.
        errors: mean distance of the free markers from the third frame on by take [m].
        excluded: takes that were not used, with the reason.
        simulations: their number.
    """

    cable: Cable
    errors: Mapping[str, float]
    excluded: Mapping[str, str]
    simulations: int


class _Simulations:
    """Predictions of prepared takes on all cores."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool
        self.count = 0

    def run(self, takes: Sequence[Prepared], values: Mapping[str, float]) -> list[Floats]:
        """Predicted free markers of each take; the compiled simulation releases the lock.

        A simulation that fails stays where it is: its error is large, not infinite.
        """
        self.count += len(takes)
        return [free for free, _ in self._pool.map(lambda one: one.simulate(values), takes)]

    def residuals(
        self, takes: Sequence[Prepared], fixed: Mapping[str, float]
    ) -> Callable[[dict[str, float]], list[Floats]]:
        """Residuals of each take as a function of the numbers."""

        def function(values: dict[str, float]) -> list[Floats]:
            predicted = self.run(takes, {**fixed, **values})
            return [_residuals(one.take, own) for one, own in zip(takes, predicted, strict=True)]

        return function

    def cost(self, takes: Sequence[Prepared], values: Mapping[str, float]) -> float:
        """Sum of the losses."""
        residuals = np.concatenate(self.residuals(takes, {})(dict(values)))
        return float(np.sum(2.0 * (np.sqrt(1.0 + residuals**2) - 1.0)))


def _residuals(take: Take, predicted: Floats) -> Floats:
    every = max(1, round(_EVERY / take.period))
    error = (predicted - take.free)[GIVEN_FRAMES::every].ravel() / _RESIDUAL
    return np.asarray(error[np.isfinite(error)])


@contextmanager
def _simulations() -> Iterator[_Simulations]:
    with ThreadPoolExecutor(available_cores()) as pool:
        yield _Simulations(pool)


def identify(
    takes: Sequence[Take], shape: Floats | None = None, count: int = MANY
) -> CableIdentification:
    """Identify a cable.

    Args:
        takes: measured, with free markers.
        shape: positions of the markers at rest [m], (markers, 3).
        count: numbers that are identified, FEW or MANY.

    Raises:
        SetError: no take can be used.
    """
    with _simulations() as simulations:
        return _identify(takes, shape, count, simulations)


def _identify(
    takes: Sequence[Take], shape: Floats | None, count: int, simulations: _Simulations
) -> CableIdentification:
    arcs = arcs_of(takes)
    places = np.concatenate([[0.0], np.cumsum(arcs)]) - arcs[0]
    geometry = CableGeometry(arcs, np.zeros((2, CableGeometry.elements + 1)))
    nodes = np.linspace(0.0, geometry.places[-1], geometry.elements + 1)
    if shape is not None:
        geometry = replace(geometry, rest=natural_curvature_of(shape, places, nodes))
    excluded: dict[str, str] = {}
    prepared = []
    for take in takes:
        one = Prepared(geometry, take)
        if one.exchanged:
            excluded[take.name] = "the two held markers of an end carry each other's name"
        elif not _residuals(take, take.free).size:
            excluded[take.name] = (
                f"no free marker is given in the frames compared, every {_EVERY} s"
            )
        else:
            prepared.append(one)
    if not prepared:
        raise SetError("no take can be used: " + "; ".join(excluded.values()))
    few = _spread(prepared, _SCOUTS)
    scouts = {axis: _turned(few, axis) for axis in (0, 1)}
    laws = _first_laws(scouts[1], simulations)
    axis, numbers = _uniform_numbers(laws, scouts, simulations)
    half = prepared[:: 1 + len(prepared) // 20]
    if count == MANY:
        prepared = _turned(prepared, axis)
        uniform = estimate(simulations.residuals(_turned(half, axis), _FIXED), numbers, 10)
        identified = _many_numbers(uniform, prepared, _turned(half, axis), simulations)
    else:
        starts = [(axis, numbers), _tilt_numbers(laws, _spread(half, 10), simulations)]
        if np.any(geometry.rest):
            starts.append((axis, _rest_numbers(laws, scouts[axis], simulations)))
        axis, identified = _best(starts, half, prepared, simulations)
        prepared = _turned(prepared, axis)
    cable = with_numbers(Cable(replace(geometry, reference=axis), _FIXED, ()), identified)
    predicted = simulations.run(prepared, cable.values)
    own = [one.take for one in prepared]
    errors = {take.name: error_of(take, each) for take, each in zip(own, predicted, strict=True)}
    cable = replace(cable, band=_band(own, predicted))
    return CableIdentification(cable, errors, excluded, simulations.count)


def _spread(takes: Sequence[Prepared], count: int) -> list[Prepared]:
    return list(takes[:: max(1, len(takes) // count)][:count])


def _first_laws(takes: Sequence[Prepared], simulations: _Simulations) -> dict[str, float]:
    """Best laws of a grid, without natural curvature."""
    grid = itertools.product(np.geomspace(0.003, 0.3, 6).tolist(), (0.02, 0.06), (0.1, 0.6))
    tried = [
        {"bending_stiffness": stiffness, "bending_damping_time": damping, "drag": drag}
        for stiffness, damping, drag in grid
    ]
    return min(tried, key=lambda laws: simulations.cost(takes, {**_FIXED, **laws}))


def _law_numbers(laws: Mapping[str, float]) -> list[EstimatedNumber]:
    return [
        EstimatedNumber(
            "bending_stiffness", "m4/s2", laws["bending_stiffness"], 1e-5, 10.0, 0.3, True
        ),
        EstimatedNumber(
            "bending_damping_time", "s", laws["bending_damping_time"], 1e-4, 2.0, 0.5, True
        ),
        EstimatedNumber("drag", "1/m", laws["drag"], 0.005, 20.0, 0.5, True),
    ]


def _turned(takes: Sequence[Prepared], axis: int) -> list[Prepared]:
    """The takes with frames of the ends that begin near an axis of the world."""
    return [one.turned(axis) for one in takes]


def _uniform_numbers(
    laws: Mapping[str, float], scouts: Mapping[int, Sequence[Prepared]], simulations: _Simulations
) -> tuple[int, list[EstimatedNumber]]:
    """First guess of laws and a uniform natural curvature, and the axis of its frames."""
    tried = []
    angles = np.linspace(0.0, 2.0 * math.pi, 9)[:-1].tolist()
    for axis, size, angle in itertools.product(scouts, (2.0, 5.0), angles):
        first, second = size * math.cos(angle), size * math.sin(angle)
        values = {**_FIXED, **laws, "curvature_1_0": first, "curvature_2_0": second}
        tried.append((simulations.cost(scouts[axis], values), axis, first, second))
    _, axis, first, second = min(tried)
    return axis, [*_law_numbers(laws), *_curvature_numbers([first], [second])]


def _tilt_numbers(
    laws: Mapping[str, float], takes: Sequence[Prepared], simulations: _Simulations
) -> tuple[int, list[EstimatedNumber]]:
    """First guess of two laws, drag or length, and the two tilts that explain most; their axis.

    The pairs are tried from where all tilts, drag and length have been identified together.
    """
    further = {each.name: each for each in _further_numbers(0.0)}
    tilts = [name for name in further if "_tilt_" in name]
    together = [*_law_numbers(laws), *(further[name] for name in ("length_ratio", *tilts))]
    fitted = []
    for axis in (0, 1):
        turned = _turned(takes, axis)
        found = estimate(simulations.residuals(turned, _FIXED), together, 8)
        fitted.append((simulations.cost(turned, _with(found)), axis, found))
    _, axis, found = min(fitted, key=lambda each: each[0])
    turned = _turned(takes, axis)
    start = {each.name: each for each in _again(found)}
    tried = []
    for third, two in itertools.product(("drag", "length_ratio"), itertools.combinations(tilts, 2)):
        names = ("bending_stiffness", "bending_damping_time", third, *two)
        numbers = [start[name] for name in names]
        found = estimate(simulations.residuals(turned, _FIXED), numbers, 4)
        tried.append((simulations.cost(turned, _with(found)), found))
    return axis, _again(min(tried, key=lambda each: each[0])[1])


def _best(
    starts: Sequence[tuple[int, Sequence[EstimatedNumber]]],
    half: Sequence[Prepared],
    takes: Sequence[Prepared],
    simulations: _Simulations,
) -> tuple[int, list[Identified]]:
    """The numbers of the least cost among searches on half of the takes, then on all; their axis.

    Drag that the takes do not show leaves its place to the ratio of the lengths.
    """
    fitted = []
    for axis, start in starts:
        found = estimate(simulations.residuals(_turned(half, axis), _FIXED), start, 10)
        turned = _turned(takes, axis)
        found = estimate(simulations.residuals(turned, _FIXED), _shown(found), 4)
        fitted.append((simulations.cost(turned, _with(found)), axis, found))
    _, axis, found = min(fitted, key=lambda each: each[0])
    return axis, found


def _with(found: Sequence[Identified]) -> dict[str, float]:
    return {**_FIXED, **{each.name: each.value for each in found}}


def _curvature_numbers(first: Sequence[float], second: Sequence[float]) -> list[EstimatedNumber]:
    return [
        EstimatedNumber(f"curvature_{direction}_{knot}", "1/m", value, -60.0, 60.0, 2.0)
        for direction, values in ((1, first), (2, second))
        for knot, value in enumerate(values)
    ]


def _rest_numbers(
    laws: Mapping[str, float], takes: Sequence[Prepared], simulations: _Simulations
) -> list[EstimatedNumber]:
    """First guess of laws, and scale and roll of the shape at rest."""
    tried = [
        (
            simulations.cost(takes, {**_FIXED, **laws, "rest_scale": 0.8, "rest_roll": roll}),
            roll,
        )
        for roll in np.linspace(0.0, 2.0 * math.pi, 9)[:-1].tolist()
    ]
    return [
        *_law_numbers(laws),
        EstimatedNumber("rest_scale", "-", 0.8, 0.0, 5.0, 0.3),
        EstimatedNumber("rest_roll", "rad", min(tried)[1], -10.0, 10.0, 0.3),
    ]


def _again(numbers: Sequence[Identified]) -> list[EstimatedNumber]:
    """The numbers to be identified again, from where they were found."""
    known = {
        each.name: each
        for each in (
            *_law_numbers(
                dict.fromkeys(("bending_stiffness", "bending_damping_time", "drag"), 1.0)
            ),
            *_curvature_numbers([0.0] * _KNOTS, [0.0] * _KNOTS),
            *_further_numbers(0.0),
            EstimatedNumber("rest_scale", "-", 0.8, 0.0, 5.0, 0.3),
            EstimatedNumber("rest_roll", "rad", 0.0, -10.0, 10.0, 0.3),
        )
    }
    return [replace(known[each.name], start=each.value) for each in numbers]


def _shown(numbers: Sequence[Identified]) -> list[EstimatedNumber]:
    """As `_again`; drag that the takes do not show leaves its place to the ratio of the lengths."""
    length = _further_numbers(0.0)[-1]
    again = zip(numbers, _again(numbers), strict=True)
    return [length if own.name == "drag" and own.remark else each for own, each in again]


def _further_numbers(roll: float) -> list[EstimatedNumber]:
    return [
        EstimatedNumber("twist_ratio", "-", 0.8, 0.05, 20.0, 0.5, True),
        *(
            EstimatedNumber(f"{end}_tilt_{axis}", "-", 0.0, -1.5, 1.5, 0.1)
            for end in ("root", "tip")
            for axis in (1, 2)
        ),
        EstimatedNumber("tip_roll", "rad", roll, -8.0, 8.0, 0.5),
        EstimatedNumber("relaxation_ratio", "-", 0.5, 0.01, 20.0, 0.5, True),
        EstimatedNumber("length_ratio", "-", 1.0, 0.9, 1.1, 0.005),
    ]


def _many_numbers(
    few: Sequence[Identified],
    takes: Sequence[Prepared],
    half: Sequence[Prepared],
    simulations: _Simulations,
) -> list[Identified]:
    """Identify all numbers: in turn without, then with the roll of the tip, then on all takes.

    Drag that the takes do not show leaves its place to the ratio of the lengths; the smallest tilt
    of a holder leaves its place to the relaxation, if the takes show this.
    """
    found = {each.name: each.value for each in few}
    laws = _law_numbers(found)
    fixed = dict(_FIXED)
    curvature = _curvature_numbers(
        [found["curvature_1_0"]] * _KNOTS, [found["curvature_2_0"]] * _KNOTS
    )
    further = [each for each in _further_numbers(0.0) if each.name != "tip_roll"]
    scouts = _spread(half, 10)
    first = estimate(simulations.residuals(scouts, fixed), [*laws, *further, *curvature], 7)
    values = {**fixed, **{each.name: each.value for each in first}}
    length = next(n for n in first if n.name == "length_ratio")
    unused = "drag" if values["drag"] < _LITTLE_DRAG else "length_ratio"
    values[unused] = fixed[unused]
    first = [each for each in first if each.name != unused]
    rolls = np.linspace(-math.pi, math.pi, 13)[:-1].tolist()
    roll = min(
        rolls,
        key=lambda roll: simulations.cost(scouts, {**values, "tip_roll": roll}),
    )
    start = [*_again(first), next(n for n in _further_numbers(roll) if n.name == "tip_roll")]
    second = estimate(simulations.residuals(half, fixed), start, 8)
    second = [length if each.name == "drag" and each.remark else each for each in second]
    tilts = [each for each in second if "_tilt_" in each.name]
    least = min(tilts, key=lambda each: abs(each.value))
    relaxation = next(each for each in second if each.name == "relaxation_ratio")
    if relaxation.value < _LITTLE_RELAXATION:
        least = relaxation
    second = [each for each in second if each is not least]
    return estimate(simulations.residuals(takes, fixed), _again(second), 6)


def _band(takes: Sequence[Take], predicted: Sequence[Floats]) -> Band:
    """The narrowest band of a few shapes that holds 90 % of the coordinates."""
    speed = float(
        np.mean([
            np.linalg.norm(np.gradient(each, take.period, axis=0), axis=-1).mean()
            for take, each in zip(takes, predicted, strict=True)
        ])
    )  # fmt: skip
    best: tuple[float, Band] | None = None
    for slope, rise in itertools.product(_SLOPES, _RISES):
        factors = [
            band_factor(each, take.period, slope, speed, rise)[GIVEN_FRAMES:]
            for take, each in zip(takes, predicted, strict=True)
        ]
        scaled = np.concatenate([
            (take.free - each)[GIVEN_FRAMES:] / factor
            for take, each, factor in zip(takes, predicted, factors, strict=True)
        ])  # fmt: skip
        tail = 0.5 * (1.0 - _COVERAGE)
        low, high = np.nanquantile(scaled, [tail, 1.0 - tail], axis=0)
        width = float(np.mean(high - low) * np.mean(np.concatenate(factors)))
        if best is None or width < best[0]:
            best = width, Band(low, high, slope, speed, rise)
    assert best is not None
    return best[1]
