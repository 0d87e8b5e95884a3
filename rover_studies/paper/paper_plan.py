"""Sweep plans of the paper's study: cases, figures and runs.

Figures 11 and 12 are Table 1 with a soft and a stiff tether, figures 13 and 14 Table 2 with a heavy
and a light Body 2, figures 15 and 16 Table 2 with three mass ratios at one total mass.

There are three sweeps. `jumps` has all points of all figures. `perturbed` repeats the jumps of
figures 13 and 14 with the slack value changed in its sixth decimal: a different landing shows that
the figure has scatter instead of a curve. `half_step` repeats some jumps with half the time step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from rover_studies.sweep.sweep_plan import SweepPlan, make_plan

GEOMETRIES: Final = ("-H", "-K", "+K")
SHAPES: Final = ("static", "catenary")
RELAXED, UNRELAXED = SHAPES
ELEMENTS: Final = (5, 10, 20, 40)
SLACK_PERTURBATION: Final = 1e-6
"""Perturbation of the slack value, without effect on a regular curve."""
THRESHOLD: Final = 1.5
"""Slack value beyond which the paper reports scatter."""
STEP, HALF_STEP = 1e-3, 5e-4
TOTAL_MASS: Final = 10.05
"""Total mass of both bodies in figures 15 and 16 [kg]."""
MASS_RATIOS: Final = (0.003, 0.004, 0.058)
"""m2/m1 in figures 15 and 16."""
_EVERY: Final = 3
"""Interval of the slack values that are run with half the time step."""


@dataclass(frozen=True)
class Case:
    """One setting of the paper: a tether and two bodies.

    Attributes:
        label: for legends and tables.
        scenario: of the package.
        m1, m2: masses of the bodies [kg].
    """

    label: str
    scenario: str
    m1: float
    m2: float


def _case_of_ratio(ratio: float) -> Case:
    m1 = TOTAL_MASS / (1.0 + ratio)
    return Case(f"m2/m1 = {ratio:g}", "paper_table2_case1", m1, ratio * m1)


SOFT, STIFF, HEAVY, LIGHT = "soft", "stiff", "heavy", "light"
RATIOS: Final = tuple(f"ratio {ratio:g}" for ratio in MASS_RATIOS)
CASES: Final[Mapping[str, Case]] = MappingProxyType(
    {
        SOFT: Case("E = 0.01 GPa", "paper_table1_low", 3.0, 2.0),
        STIFF: Case("E = 0.5 GPa", "paper_table1_high", 3.0, 2.0),
        HEAVY: Case("m2 = 0.5 kg", "paper_table2_case1", 10.0, 0.5),
        LIGHT: Case("m2 = 0.05 kg", "paper_table2_case2", 10.0, 0.05),
        **{name: _case_of_ratio(ratio) for name, ratio in zip(RATIOS, MASS_RATIOS, strict=True)},
    }
)
PERTURBED_CASES: Final = (HEAVY, LIGHT)


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper.

    Attributes:
        number: the paper's.
        title: of the figure.
        cases: of its curves.
        quantities: columns of the results in the figure.
    """

    number: int
    title: str
    cases: tuple[str, ...]
    quantities: tuple[str, ...]


HEIGHT, TURN = "jump_height_m", "attitude_variation_rad"
FIGURES: Final = (
    PaperFigure(11, "soft tether, 0.01 GPa", (SOFT,), (HEIGHT, TURN)),
    PaperFigure(12, "stiff tether, 0.5 GPa", (STIFF,), (HEIGHT, TURN)),
    PaperFigure(13, "70 GPa, heavy Body 2 (0.5 kg)", (HEAVY,), (HEIGHT, TURN)),
    PaperFigure(14, "70 GPa, light Body 2 (0.05 kg)", (LIGHT,), (HEIGHT, TURN)),
    PaperFigure(15, "height for three mass ratios", RATIOS, (HEIGHT,)),
    PaperFigure(16, "attitude for three mass ratios", RATIOS, (TURN,)),
)


@dataclass(frozen=True)
class Extent:
    """Extent of the study.

    Attributes:
        slacks: slack values, ascending.
        elements: numbers of tether elements, ascending.
        cases: of `CASES`.
        geometries: of `GEOMETRIES`.
    """

    slacks: tuple[float, ...]
    elements: tuple[int, ...] = ELEMENTS
    cases: tuple[str, ...] = tuple(CASES)
    geometries: tuple[str, ...] = GEOMETRIES


def even_slacks(step: float) -> tuple[float, ...]:
    """Return slack values from 0.5 to 3.5, the range of the paper's figures."""
    return tuple(round(0.5 + step * index, 6) for index in range(round(3.0 / step) + 1))


WHOLE: Final = Extent(even_slacks(0.1))
QUICK: Final = Extent(even_slacks(0.25))

JUMPS, PERTURBED, HALVED = "jumps", "perturbed", "half_step"


def plans(extent: Extent) -> dict[str, SweepPlan]:
    """Return the plans of the study's sweeps by name."""
    perturbed = [case for case in extent.cases if case in PERTURBED_CASES]
    found = {JUMPS: _plan(JUMPS, extent, extent.cases, extent.slacks, STEP)}
    if perturbed:
        slacks = [slack + SLACK_PERTURBATION for slack in extent.slacks]
        found[PERTURBED] = _plan(PERTURBED, extent, perturbed, slacks, STEP)
    found[HALVED] = _plan(HALVED, extent, extent.cases, extent.slacks[::_EVERY], HALF_STEP)
    return found


def _plan(
    name: str, extent: Extent, cases: Sequence[str], slacks: Sequence[float], h: float
) -> SweepPlan:
    bodies: list[dict[str, Any]] = [
        {"scenario": CASES[case].scenario, "rover.m1": CASES[case].m1, "rover.m2": CASES[case].m2}
        for case in cases
    ]
    return make_plan(
        {
            "name": name,
            "experiment": "jump",
            "set": {"integration.h": h},
            "grid": {
                "bodies": bodies,
                "start.geometry": list(extent.geometries),
                "start.initial_shape": list(SHAPES),
                "tether.elements": list(extent.elements),
                "start.slack": list(slacks),
            },
        }
    )


def case_of(row: Mapping[str, Any]) -> str:
    """Return the case of a row of the results."""
    for name, case in CASES.items():
        if (row["scenario"], row["rover.m1"], row["rover.m2"]) == (case.scenario, case.m1, case.m2):
            return name
    raise ValueError(f"the row belongs to no case of the study: {dict(row)}")
