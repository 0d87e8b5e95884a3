"""The paper's claims about the tethered jump, each held against every world that its text fits.

A *world* is a geometry, a shape of the tether at the start, and a mesh: the paper names none of
the three fully. A claim is a question to the curves of one world, with its numbers. What holds in
static equilibrium on the finest mesh is a property of the tethered jump; what holds only where the
tether starts unrelaxed on a coarse mesh is a property of that mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import levene

from rover_studies.paper_curves import SCATTER, Curve, Curves, Floats, Key
from rover_studies.paper_plan import (
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
"""Relative spread of heights below which they count as the same."""
LARGE_HEIGHT: Final = 0.05
"""Relative spread above which they vary largely."""
EXTREME_HEIGHT: Final = 1.10
"""Ratio of heights from which an increase is extreme."""
SMALL_TURN: Final = np.radians(5.0)
"""Spread of the attitude variation [rad] below which attitude is not influenced."""
LARGE_TURN: Final = np.radians(10.0)
"""Spread [rad] above which it varies strongly."""
LESS: Final = 0.8
"""Ratio of spreads from which one is less than the other."""
_SIGNIFICANT: Final = 0.05


class World(NamedTuple):
    """What the paper leaves open."""

    geometry: str
    shape: str
    elements: int


@dataclass(frozen=True)
class Finding:
    """Whether a claim holds in one world.

    Attributes:
        holds: whether it does; None where scatter makes the question idle.
        numbers: what was measured, in words.
    """

    holds: bool | None
    numbers: str


OneWorld = Mapping[str, Curve]
"""Curves of one world by case."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes:
        name: short, for tables.
        figures: that the paper draws it from.
        statement: in our words.
        test: how it is held against the numbers, in words.
        cases: that must be there to ask.
        ask: asks one world.
    """

    name: str
    figures: str
    statement: str
    test: str
    cases: tuple[str, ...]
    ask: Callable[[OneWorld], Finding]


@dataclass(frozen=True)
class Verdict:
    """What became of a claim.

    Attributes:
        claim: which.
        words: the verdict in a few words.
        physics: geometries in which it holds in static equilibrium on the finest mesh.
        everywhere: whether those are all geometries.
        artefact: whether it holds in some unrelaxed world and in no relaxed one.
        findings: by world.
    """

    claim: Claim
    words: str
    physics: tuple[str, ...]
    everywhere: bool
    artefact: bool
    findings: Mapping[World, Finding]


def _spread(values: Floats) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def _over(one: float, other: float) -> float:
    """Ratio of two spreads; equal ones, none at all included, give 1."""
    return 1.0 if one == other else one / other if other else np.inf


def _relative(values: Floats) -> float:
    return _spread(values) / float(np.nanmean(values))


def _soft_height(world: OneWorld) -> Finding:
    found = _relative(world[SOFT].height)
    return Finding(found < SAME_HEIGHT, f"height spreads by {found:.2%}")


def _soft_turn(world: OneWorld) -> Finding:
    found = _spread(world[SOFT].turn)
    return Finding(found < SMALL_TURN, f"attitude variation spreads by {found:.3f} rad")


def _stiff_turn(world: OneWorld) -> Finding:
    found, soft = _spread(world[STIFF].turn), _spread(world[SOFT].turn)
    return Finding(
        found > LARGE_TURN and found > 3.0 * soft,
        f"attitude variation spreads by {found:.3f} rad, soft tether {soft:.3f} rad",
    )


def _stiff_height(world: OneWorld) -> Finding:
    found = _relative(world[STIFF].height)
    return Finding(found > LARGE_HEIGHT, f"height spreads by {found:.2%}")


def _higher_beyond(world: OneWorld) -> Finding:
    curve = world[HEAVY]
    below = float(np.nanmedian(curve.height[~curve.beyond]))
    ratio = float(np.nanmax(curve.height[curve.beyond])) / below
    return Finding(
        ratio > EXTREME_HEIGHT,
        f"highest beyond {THRESHOLD:g} is {ratio:.3f} of the usual up to it",
    )


def _scatter_beyond(world: OneWorld) -> Finding:
    curve = world[HEAVY]
    beyond = float(curve.scattered[curve.beyond].mean())
    below = float(curve.scattered[~curve.beyond].mean())
    return Finding(
        beyond > 0.5 and below < 0.5,
        f"{beyond:.0%} of the points beyond {THRESHOLD:g} scatter, {below:.0%} up to it",
    )


def _lighter_less(world: OneWorld) -> Finding:
    heavy, light = world[HEAVY], world[LIGHT]
    height = _over(_spread(light.height), _spread(heavy.height))
    turn = _over(_spread(light.turn), _spread(heavy.turn))
    words = f"light over heavy: spread of heights {height:.2f}, of attitudes {turn:.2f}"
    less = height < LESS and turn < LESS
    if heavy.scattered.mean() > 0.25 and light.scattered.mean() > 0.25:
        pair = [curve.turn[curve.scattered] for curve in (heavy, light)]
        chance = float(levene(*pair).pvalue)
        words += f"; both scatter, and chance alone spreads so in {chance:.0%} of draws"
        return Finding(less if chance < _SIGNIFICANT else None, words)
    return Finding(less, words)


def _over_ratios(world: OneWorld, name: str) -> tuple[Floats, Curve]:
    """Spread over the mass ratios at each slack value."""
    values = np.array([getattr(world[ratio], name) for ratio in RATIOS])
    return np.ptp(values, axis=0), world[RATIOS[0]]


def _same_over_ratios(world: OneWorld) -> Finding:
    spread, curve = _over_ratios(world, "height")
    worst = float(np.nanmax(spread / curve.height))
    return Finding(worst < LARGE_HEIGHT, f"heights differ by up to {worst:.2%}")


def _differs_at_end(world: OneWorld) -> Finding:
    spread, curve = _over_ratios(world, "height")
    there = (curve.slack >= 2.95) & (curve.slack <= 3.25)
    at_end, usual = float(np.nanmax(spread[there])), float(np.nanmedian(spread))
    relative = at_end / float(np.nanmedian(curve.height))
    return Finding(
        at_end > 3.0 * usual and relative > SAME_HEIGHT,
        f"near 3.1 by up to {1e3 * at_end:.2g} mm, usually {1e3 * usual:.2g} mm",
    )


def _ratio_turns(world: OneWorld) -> Finding:
    spread, curve = _over_ratios(world, "turn")
    beyond = float(np.nanmedian(spread[curve.beyond]))
    below = float(np.nanmedian(spread[~curve.beyond]))
    return Finding(
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
        f"highest jump beyond over the median up to it above {EXTREME_HEIGHT:g}",
        (HEAVY,),
        _higher_beyond,
    ),
    Claim(
        "scatter beyond 1.5",
        "13",
        "Beyond a slack value of 1.5 the attitude takes various values, up to it it does not.",
        "more than half of the points beyond are scatter, fewer than half up to it",
        (HEAVY,),
        _scatter_beyond,
    ),
    Claim(
        "lighter Body 2",
        "14",
        "With the lighter Body 2 height and attitude change less.",
        f"both spreads below {LESS:g} of those with the heavy one, beyond what chance makes"
        f" (Levene's test at {_SIGNIFICANT:.0%}) where both scatter",
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
        f"difference above three times the usual one and {SAME_HEIGHT:.0%} of the height",
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


def verdicts(curves: Curves) -> list[Verdict]:
    """Of every claim whose cases are among the curves."""
    worlds: dict[World, dict[str, Curve]] = {}
    for key, curve in curves.items():
        worlds.setdefault(World(*key[1:]), {})[key.case] = curve
    found = []
    for claim in CLAIMS:
        findings = {
            world: claim.ask(cases)
            for world, cases in worlds.items()
            if all(case in cases for case in claim.cases)
        }
        if findings:
            found.append(_verdict(claim, findings))
    return found


def _verdict(claim: Claim, findings: Mapping[World, Finding]) -> Verdict:
    geometries = tuple(dict.fromkeys(world.geometry for world in findings))
    finest = max(world.elements for world in findings)
    relaxed = {world: found for world, found in findings.items() if world.shape == RELAXED}
    physics = tuple(
        geometry for geometry in geometries if relaxed[World(geometry, RELAXED, finest)].holds
    )
    # A claim that on a coarse mesh fares otherwise is not settled by that mesh.
    unsettled = sorted(
        {
            world.elements
            for world, found in relaxed.items()
            if found.holds != relaxed[World(world.geometry, RELAXED, finest)].holds
        }
    )
    unrelaxed = [w for w, found in findings.items() if w.shape == UNRELAXED and found.holds]
    everywhere = physics == geometries
    artefact = not physics and bool(unrelaxed)
    if everywhere:
        words = "holds"
        spoilt = sorted(
            {w.elements for w, f in findings.items() if w.shape == UNRELAXED and not f.holds}
        )
        if spoilt:
            words += f", but not where an unrelaxed tether has n = {_listed(spoilt)}"
    elif physics:
        words = f"holds in geometry {_listed(physics)} only"
    elif artefact:
        meshes = sorted({world.elements for world in unrelaxed})
        places = tuple(dict.fromkeys(world.geometry for world in unrelaxed))
        words = (
            f"an artefact: only of the unrelaxed tether, n = {_listed(meshes)},"
            f" geometry {_listed(places)}"
        )
    else:
        words = "not reproduced"
    if unsettled:
        words += f" (in equilibrium n = {_listed(unsettled)} tells otherwise)"
    return Verdict(claim, words, physics, everywhere, artefact, findings)


def _listed(values: tuple[str, ...] | list[int]) -> str:
    return ", ".join(str(value) for value in values)


def keys_of(curves: Curves, case: str, geometry: str, shape: str) -> list[Key]:
    """Curves of one case, geometry and shape, coarse mesh first."""
    return sorted(
        (key for key in curves if key[:3] == (case, geometry, shape)), key=lambda key: key.elements
    )
