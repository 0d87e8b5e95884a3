"""The paper's claims about the tethered jump, evaluated in every world that its text permits.

A *world* is a geometry, an initial shape of the tether and a mesh: the paper defines none of the
three fully. A claim is a numerical test of the curves of one world. A claim that holds in static
equilibrium on the finest mesh is a property of the tethered jump; one that holds only for a tether
unrelaxed on a coarse mesh is a property of that mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import levene

from rover_studies.paper.paper_curves import SCATTER, Curve, Curves, Floats, Key
from rover_studies.paper.paper_plan import (
    HEAVY,
    LIGHT,
    RATIOS,
    RELAXED,
    SOFT,
    STIFF,
    THRESHOLD,
    UNRELAXED,
)

SAME_HEIGHT: Final = 0.02
"""Relative spread of heights below which they are considered equal."""
LARGE_HEIGHT: Final = 0.05
"""Relative spread above which they vary largely."""
EXTREME_HEIGHT: Final = 1.10
"""Ratio of heights from which an increase is extreme."""
SMALL_TURN: Final = np.radians(5.0)
"""Spread of the attitude variation [rad] below which attitude is not influenced."""
LARGE_TURN: Final = np.radians(10.0)
"""Spread [rad] above which it varies strongly."""
LESS: Final = 0.8
"""Ratio of spreads below which one is considered smaller."""
_SIGNIFICANT: Final = 0.05


class World(NamedTuple):
    """A combination of the choices that the paper does not define."""

    geometry: str
    shape: str
    elements: int


@dataclass(frozen=True)
class ClaimResult:
    """Result of a claim in one world.

    Attributes:
        holds: whether the claim holds; None: undecided because of scatter.
        measured: the measured values, as text.
    """

    holds: bool | None
    measured: str


OneWorld = Mapping[str, Curve]
"""Curves of one world by case."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes:
        name: short, for tables.
        figure: of the paper.
        statement: of the claim, paraphrased.
        test: the numerical criterion, as text.
        cases: required for the evaluation.
        evaluate: evaluates one world.
    """

    name: str
    figure: str
    statement: str
    test: str
    cases: tuple[str, ...]
    evaluate: Callable[[OneWorld], ClaimResult]


@dataclass(frozen=True)
class Verdict:
    """Verdict on a claim.

    Attributes:
        claim: the claim.
        summary: the verdict as text.
        physics: geometries in which it holds in static equilibrium on the finest mesh.
        everywhere: whether it holds so in all geometries.
        artefact: whether it holds in some unrelaxed world and in no relaxed one.
        results: by world.
    """

    claim: Claim
    summary: str
    physics: tuple[str, ...]
    everywhere: bool
    artefact: bool
    results: Mapping[World, ClaimResult]


def _spread(values: Floats) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def _over(one: float, other: float) -> float:
    """Return the ratio of two spreads; 1 if they are equal, including zero."""
    return 1.0 if one == other else one / other if other else np.inf


def _relative(values: Floats) -> float:
    return _spread(values) / float(np.nanmean(values))


def _soft_height(world: OneWorld) -> ClaimResult:
    found = _relative(world[SOFT].height)
    return ClaimResult(found < SAME_HEIGHT, f"height spreads by {found:.2%}")


def _soft_turn(world: OneWorld) -> ClaimResult:
    found = _spread(world[SOFT].turn)
    return ClaimResult(found < SMALL_TURN, f"attitude variation spreads by {found:.3f} rad")


def _stiff_turn(world: OneWorld) -> ClaimResult:
    found, soft = _spread(world[STIFF].turn), _spread(world[SOFT].turn)
    return ClaimResult(
        found > LARGE_TURN and found > 3.0 * soft,
        f"attitude variation spreads by {found:.3f} rad, soft tether {soft:.3f} rad",
    )


def _stiff_height(world: OneWorld) -> ClaimResult:
    found = _relative(world[STIFF].height)
    return ClaimResult(found > LARGE_HEIGHT, f"height spreads by {found:.2%}")


def _higher_beyond(world: OneWorld) -> ClaimResult:
    curve = world[HEAVY]
    below = float(np.nanmedian(curve.height[~curve.beyond]))
    ratio = float(np.nanmax(curve.height[curve.beyond])) / below
    return ClaimResult(
        ratio > EXTREME_HEIGHT,
        f"largest height beyond {THRESHOLD:g} is {ratio:.3f} of the median up to it",
    )


def _scatter_beyond(world: OneWorld) -> ClaimResult:
    curve = world[HEAVY]
    beyond = float(curve.scattered[curve.beyond].mean())
    below = float(curve.scattered[~curve.beyond].mean())
    return ClaimResult(
        beyond > 0.5 and below < 0.5,
        f"{beyond:.0%} of the points beyond {THRESHOLD:g} scatter, {below:.0%} up to it",
    )


def _lighter_less(world: OneWorld) -> ClaimResult:
    heavy, light = world[HEAVY], world[LIGHT]
    height = _over(_spread(light.height), _spread(heavy.height))
    turn = _over(_spread(light.turn), _spread(heavy.turn))
    summary = f"light over heavy: spread of heights {height:.2f}, of attitudes {turn:.2f}"
    less = height < LESS and turn < LESS
    if heavy.scattered.mean() > 0.25 and light.scattered.mean() > 0.25:
        pair = [curve.turn[curve.scattered] for curve in (heavy, light)]
        chance = float(levene(*pair).pvalue)
        summary += f"; both scatter, and chance alone gives this in {chance:.0%} of draws"
        return ClaimResult(less if chance < _SIGNIFICANT else None, summary)
    return ClaimResult(less, summary)


def _over_ratios(world: OneWorld, name: str) -> tuple[Floats, Curve]:
    """Return the spread over the mass ratios at each slack value."""
    values = np.array([getattr(world[ratio], name) for ratio in RATIOS])
    return np.ptp(values, axis=0), world[RATIOS[0]]


def _same_over_ratios(world: OneWorld) -> ClaimResult:
    spread, curve = _over_ratios(world, "height")
    worst = float(np.nanmax(spread / curve.height))
    return ClaimResult(worst < LARGE_HEIGHT, f"heights differ by up to {worst:.2%}")


def _differs_at_end(world: OneWorld) -> ClaimResult:
    spread, curve = _over_ratios(world, "height")
    there = (curve.slack >= 2.95) & (curve.slack <= 3.25)
    at_end, usual = float(np.nanmax(spread[there])), float(np.nanmedian(spread))
    relative = at_end / float(np.nanmedian(curve.height))
    return ClaimResult(
        at_end > 3.0 * usual and relative > SAME_HEIGHT,
        f"difference near 3.1 up to {1e3 * at_end:.2g} mm, median {1e3 * usual:.2g} mm",
    )


def _ratio_turns(world: OneWorld) -> ClaimResult:
    spread, curve = _over_ratios(world, "turn")
    beyond = float(np.nanmedian(spread[curve.beyond]))
    below = float(np.nanmedian(spread[~curve.beyond]))
    return ClaimResult(
        beyond > SCATTER and beyond > 2.0 * below,
        f"attitudes differ by {beyond:.4f} rad beyond {THRESHOLD:g}, {below:.4f} rad up to it"
        " (medians)",
    )


CLAIMS: Final = (
    Claim(
        "soft: height",
        "11",
        "With the low Young's modulus the slack does not influence the height.",
        f"spread of the heights over the slack values below {SAME_HEIGHT:.0%}",
        (SOFT,),
        _soft_height,
    ),
    Claim(
        "soft: attitude",
        "11",
        "With the low Young's modulus the slack does not influence the attitude.",
        f"spread of the attitude variation below {np.degrees(SMALL_TURN):.0f} deg",
        (SOFT,),
        _soft_turn,
    ),
    Claim(
        "stiff: attitude",
        "12",
        "With the high Young's modulus the attitude varies strongly with the slack.",
        f"spread above {np.degrees(LARGE_TURN):.0f} deg and three times the soft tether's",
        (SOFT, STIFF),
        _stiff_turn,
    ),
    Claim(
        "stiff: height",
        "12",
        "With the high Young's modulus the height varies largely with the slack.",
        f"spread of the heights above {LARGE_HEIGHT:.0%}",
        (STIFF,),
        _stiff_height,
    ),
    Claim(
        "height beyond 1.5",
        "13",
        "Beyond a slack value of 1.5 the height increases extremely.",
        f"ratio of the largest height beyond 1.5 to the median up to it above {EXTREME_HEIGHT:g}",
        (HEAVY,),
        _higher_beyond,
    ),
    Claim(
        "scatter beyond 1.5",
        "13",
        "Beyond a slack value of 1.5, and only there, the attitude takes various values.",
        "more than half of the points beyond 1.5 are scatter, fewer than half up to it",
        (HEAVY,),
        _scatter_beyond,
    ),
    Claim(
        "lighter Body 2",
        "14",
        "With the lighter Body 2 height and attitude change less.",
        f"both spreads below {LESS:g} of those with the heavy one; if both scatter,"
        f" significantly (Levene's test at {_SIGNIFICANT:.0%})",
        (HEAVY, LIGHT),
        _lighter_less,
    ),
    Claim(
        "mass ratio: height",
        "15",
        "The mass ratio makes no large difference to the height.",
        f"heights of the three ratios within {LARGE_HEIGHT:.0%} at every slack value",
        RATIOS,
        _same_over_ratios,
    ),
    Claim(
        "mass ratio at 3.1",
        "15",
        "At a slack value of about 3.1 the heights differ more.",
        f"difference above three times the median one and {SAME_HEIGHT:.0%} of the height",
        RATIOS,
        _differs_at_end,
    ),
    Claim(
        "mass ratio: attitude",
        "16",
        "Beyond a slack value of 1.5 the attitude depends on the mass ratio.",
        "median difference between the ratios above 1 deg and twice that up to 1.5",
        RATIOS,
        _ratio_turns,
    ),
)


def evaluate_claims(curves: Curves) -> list[Verdict]:
    """Return the verdict on every claim whose cases are among the curves."""
    worlds: dict[World, dict[str, Curve]] = {}
    for key, curve in curves.items():
        worlds.setdefault(World(*key[1:]), {})[key.case] = curve
    found = []
    for claim in CLAIMS:
        results = {
            world: claim.evaluate(cases)
            for world, cases in worlds.items()
            if all(case in cases for case in claim.cases)
        }
        if results:
            found.append(_verdict(claim, results))
    return found


def _verdict(claim: Claim, results: Mapping[World, ClaimResult]) -> Verdict:
    geometries = tuple(dict.fromkeys(world.geometry for world in results))
    finest = max(world.elements for world in results)
    relaxed = {world: found for world, found in results.items() if world.shape == RELAXED}
    physics = tuple(
        geometry for geometry in geometries if relaxed[World(geometry, RELAXED, finest)].holds
    )
    # Coarse meshes whose result differs from that of the finest mesh.
    unsettled = sorted(
        {
            world.elements
            for world, found in relaxed.items()
            if found.holds != relaxed[World(world.geometry, RELAXED, finest)].holds
        }
    )
    unrelaxed = [w for w, found in results.items() if w.shape == UNRELAXED and found.holds]
    everywhere = physics == geometries
    artefact = not physics and bool(unrelaxed)
    if everywhere:
        summary = "holds"
        spoilt = sorted(
            {w.elements for w, f in results.items() if w.shape == UNRELAXED and not f.holds}
        )
        if spoilt:
            summary += f", but not where an unrelaxed tether has n = {_listed(spoilt)}"
    elif physics:
        summary = f"holds in geometry {_listed(physics)} only"
    elif artefact:
        meshes = sorted({world.elements for world in unrelaxed})
        places = tuple(dict.fromkeys(world.geometry for world in unrelaxed))
        summary = (
            f"an artefact: only of the unrelaxed tether, n = {_listed(meshes)},"
            f" geometry {_listed(places)}"
        )
    else:
        summary = "not reproduced"
    if unsettled:
        summary += f" (in equilibrium n = {_listed(unsettled)} gives another result)"
    return Verdict(claim, summary, physics, everywhere, artefact, results)


def _listed(values: tuple[str, ...] | list[int]) -> str:
    return ", ".join(str(value) for value in values)


def keys_of(curves: Curves, case: str, geometry: str, shape: str) -> list[Key]:
    """Return the keys of one case, geometry and shape, coarsest mesh first."""
    return sorted(
        (key for key in curves if key[:3] == (case, geometry, shape)), key=lambda key: key.elements
    )
