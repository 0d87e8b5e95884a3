"""Measured sets of cables and wheels, predicted by the laws of tether and wheel.

The sets are no part of the suite: a folder of them is named by `mother_rover verify --sets`, as
`mother_rover validate summary` describes it.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Literal

from rover_validation.sets.summary import (
    CableSummary,
    set_folders,
    summarise_cable,
    summarise_wheel,
)
from rover_verify.checks import CheckBatch, Measured, SetsNotGiven

_QUANTITIES = ("forward", "sideways", "sinkage")
"""Quantities of a wheel, as their RMS errors are given: [N], [N], [mm]."""


def cables(
    batch: CheckBatch, choose: Literal["largest", "smallest", "mean"], quantity: str
) -> Measured:
    """Largest, smallest or mean value of the cables: of ``mean`` [mm], ``coverage`` or ``speed``.

    ``speed`` is the length of the takes over the processor time of their predictions.
    """
    found = {each.name: float(getattr(each.errors, quantity)) for each in _cables(batch)}
    if choose == "mean":
        takes = sum(each.errors.takes for each in _cables(batch))
        mean = sum(found.values()) / len(found)
        return Measured(mean, f"{len(found)} cables, {takes} takes predicted", found)
    name = (max if choose == "largest" else min)(found, key=lambda each: found[each])
    return Measured(found[name], name, found)


def wheel(batch: CheckBatch, name: str, quantity: str, course: str) -> Measured:
    """Largest RMS error of a quantity over the runs of the wheels of a name."""
    label = f"{name}, {course}"
    place = _QUANTITIES.index(quantity)
    found = {
        f"{each.name}: {group.label}": group
        for each in map(_wheel, _folders(batch, "wheels"))
        for group in each.errors
        if group.label == label
    }
    if not found:
        raise SetsNotGiven(f"no set holds runs of {label}")
    runs = sum(group.runs for group in found.values())
    errors = {each: group.rms[place] for each, group in found.items()}
    worst = max(errors, key=lambda each: errors[each])
    return Measured(errors[worst], f"{worst}; {runs} runs predicted from the others", errors)


def _cables(batch: CheckBatch) -> tuple[CableSummary, ...]:
    keep = (batch.kept or batch.folder) / "cables"
    return tuple(_cable(each, keep) for each in _folders(batch, "cables"))


def _folders(batch: CheckBatch, kind: str) -> list[Path]:
    if batch.sets is None:
        raise SetsNotGiven("no measured sets are given; name their folder with --sets")
    folders = list(set_folders(batch.sets, kind))
    if not folders:
        raise SetsNotGiven(f"{batch.sets} holds no {kind}/NAME")
    return folders


_cable = functools.cache(summarise_cable)
_wheel = functools.cache(summarise_wheel)
