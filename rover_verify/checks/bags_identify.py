"""Known machines, identified from noisy bags of the identification procedure."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from rover_bags.identification.dry_run import PROCEDURE, Manoeuvre, record
from rover_bags.identification.identify import Estimate, identify
from rover_bags.identification.parameters import PARAMETERS, value_of, with_stiffness, with_values
from rover_sim import SpatialScenario, load_spatial
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.flights import fly_batch

SOUGHT: Final = (
    "EA", "EI", "axial_damping", "swivel_friction", "wheel_friction", "inertia_x", "inertia_y",
    "inertia_z",
)  # fmt: skip
"""Parameters that every trial has to identify."""
_LEAST_TRIALS: Final = 20
"""Smallest number of trials for a meaningful fraction."""
_FARTHEST: Final = 0.3
"""Largest deviation of true from configured values, as logarithms."""


def _start(generator: np.random.Generator, configured: SpatialScenario) -> dict[str, object]:
    """A start of the hanging run that deviates from the configuration."""
    tilt = generator.normal(0.0, 1.0, 2)
    push = generator.normal(configured.start.body_rate, 0.5)
    return {
        "start.swing_angle": abs(float(generator.normal(0.0, 0.5))),
        "start.swing_heading": float(generator.uniform(-180.0, 180.0)),
        "start.swing_rate": float(generator.normal(0.0, 0.5)),
        "start.tilt": [*tilt.tolist(), 0.0],
        "start.body_rate": push.tolist(),
        "start.twist": float(generator.normal(configured.start.twist, 3.0)),
    }


@dataclass(frozen=True)
class IdentificationTrial:
    """Result of one trial.

    Attributes:
        found: estimates by name.
        truth: true values by name.
        converged: whether the search converged.
        simulations: number of simulations.
    """

    found: Mapping[str, Estimate]
    truth: Mapping[str, float]
    converged: bool
    simulations: int

    def holds_individually(self, name: str) -> bool:
        """Whether a parameter is shown and its own 95 % interval holds the true value."""
        low, high = self.found[name].individual
        return self.found[name].identifiable and low <= self.truth[name] <= high

    @property
    def misses(self) -> list[str]:
        """Reasons why the trial failed; empty if it is good."""
        hidden = [
            f"{name} is not identifiable" for name in SOUGHT if not self.found[name].identifiable
        ]
        outside = [
            name
            for name, one in self.found.items()
            if one.identifiable and not one.covers(self.truth[name])
        ]
        return [*hidden, *outside, *([] if self.converged else ["the search did not converge"])]


def trial(
    folder: Path,
    seed: int,
    index: int,
    procedure: Mapping[str, Manoeuvre] = PROCEDURE,
    changed: Mapping[str, object] | None = None,
) -> IdentificationTrial:
    """Record the procedure with a known machine and identify it.

    Args:
        folder: folder of its bags.
        seed: seed of all random numbers.
        index: index of the trial, part of the seed.
        procedure: manoeuvres by scenario.
        changed: overridden scenario values by path.
    """
    generator = np.random.default_rng([seed, index])
    truth: dict[str, float] = {}
    bags = []
    for name, manoeuvre in procedure.items():
        configured = with_stiffness(load_spatial(name, changed or {}))
        truth = truth or _truth(configured, generator)
        real = with_values(configured, truth)
        if configured.start.kind == "hanging":
            real = real.with_overrides(_start(generator, configured))
        noise = int(generator.integers(1, 2**31 - 1))
        bags.append(record(folder / name, configured, real, manoeuvre, seed=noise))
    found = identify(bags)
    return IdentificationTrial(
        {one.name: one for one in found.estimates}, truth, found.converged, found.simulations
    )


def fly_trial(seed: int, index: int) -> IdentificationTrial:
    """One trial of the whole procedure; its bags are deleted."""
    with tempfile.TemporaryDirectory() as folder:
        return trial(Path(folder), seed, index)


def _trials(batch: CheckBatch) -> Sequence[IdentificationTrial]:
    return fly_batch(batch, max(batch.runs, _LEAST_TRIALS), fly_trial)


def _truth(configured: SpatialScenario, generator: np.random.Generator) -> dict[str, float]:
    truth = {}
    for name in PARAMETERS:
        value = value_of(configured, name)
        if value is not None:
            truth[name] = value * math.exp(float(generator.uniform(-_FARTHEST, _FARTHEST)))
    return truth


def together(batch: CheckBatch) -> Measured:
    """Fraction of trials with all parameters identifiable and all true values in the intervals.

    The intervals are simultaneous: all of a trial hold with a probability of 95 %.
    """
    made = _trials(batch)
    good = sum(not one.misses for one in made)
    failures = {
        f"trial {index} misses": ", ".join(one.misses)
        for index, one in enumerate(made)
        if one.misses
    }
    median = float(np.median([one.simulations for one in made]))
    note = f"{good} of {len(made)} trials, {median:.0f} simulations each (median)"
    return Measured(good / len(made), note, failures)


def each(batch: CheckBatch) -> Measured:
    """Fraction of the individual 95 % intervals that contain the true value.

    Required parameters that are not identifiable, and searches that do not converge, count as
    missed.
    """
    made = _trials(batch)
    counts = {name: _held(name, made) for name in PARAMETERS}
    total = sum(of for _, of in counts.values())
    share = sum(held for held, _ in counts.values()) / total if total else math.nan
    worst = min(held / of for held, of in counts.values() if of)
    details = {name: _summary(name, made) for name in PARAMETERS}
    return Measured(share, f"{total} intervals; the worst parameter's share {worst:.2f}", details)


_HANG: Final = PROCEDURE["identify_hang"]
_UNTWISTED: Final = {"start.twist": 0.0, "start.body_rate": [0.0, 0.0, 0.0]}
_LACKING: Final[tuple[tuple[str, Manoeuvre, Mapping[str, object], tuple[str, ...]], ...]] = (
    (
        "wheels at rest, no bow",
        replace(_HANG, wheels=()),
        {},
        ("EI", "wheel_friction", "wheel_drag"),
    ),
    ("not twisted, no bow", _HANG, _UNTWISTED, ("EI", "swivel_friction")),
)
"""Omitted manoeuvres, and the parameters that are then not identifiable."""
_MOST_LACKING: Final = 2
"""Bags of each case; each takes as long as a trial."""


def lacking(batch: CheckBatch) -> Measured:
    """Number of parameters identified from bags that do not excite them."""
    wrong: dict[str, str] = {}
    claims = shown = held = 0
    runs = min(batch.runs, _MOST_LACKING)
    for case, (about, _, _, hidden) in enumerate(_LACKING):
        for number, one in enumerate(fly_batch(batch, runs, fly_lacking, case)):
            known = [name for name in one.found if one.found[name].identifiable]
            claimed = [name for name in known if name in hidden]
            claims += len(claimed)
            shown += len(known) - len(claimed)
            held += sum(one.found[n].covers(one.truth[n]) for n in known if n not in hidden)
            if claimed:
                wrong[f"{about}, {number}"] = ", ".join(claimed)
    note = f"{runs * len(_LACKING)} bags; {held} of {shown} intervals of identified parameters hold"
    return Measured(claims, note, wrong)


def fly_lacking(seed: int, index: int, case: int) -> IdentificationTrial:
    """One trial from a bag that lacks a manoeuvre."""
    _, manoeuvre, changed, _ = _LACKING[case]
    with tempfile.TemporaryDirectory() as folder:
        return trial(Path(folder), seed, index, {"identify_hang": manoeuvre}, changed)


def _held(name: str, made: Sequence[IdentificationTrial]) -> tuple[int, int]:
    """Number of individual intervals that hold the true value, and their total."""
    counted = [one for one in made if one.found[name].identifiable or name in SOUGHT]
    held = sum(one.converged and one.holds_individually(name) for one in counted)
    return held, len(counted)


def _summary(name: str, made: Sequence[IdentificationTrial]) -> str:
    held, of = _held(name, made)
    errors = [one.found[name].error for one in made if one.found[name].identifiable]
    if not errors:
        return f"identifiable in none of {len(made)} trials"
    return (
        f"identifiable in {len(errors)} of {len(made)} trials; {held} of {of} intervals hold the "
        f"true value; standard error {float(np.median(errors)):.2g} (median, relative)"
    )
