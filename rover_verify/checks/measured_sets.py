"""Measured sets of cables and wheels, predicted by the laws of tether and wheel.

The sets are no part of the suite: a folder of them is named by `mother_rover verify --sets`, as
`mother_rover validate summary` describes it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path

from rover_validation.sets.summary import (
    CableSummary,
    WheelSummary,
    set_folders,
    summarise_cable,
    summarise_wheel,
)
from rover_validation.wheel.comparison import BEYOND, GroupErrors
from rover_verify.checks import CheckBatch, Measured, SetsNotGiven

_FORWARD, _SIDEWAYS, _SINKAGE = range(3)
_AHEAD = "straight ahead"


def cable_error(batch: CheckBatch) -> Measured:
    """Mean distance of predicted free markers, mean over the cables [mm]."""
    errors = _of_cables(batch, lambda cable: cable.errors.mean)
    mean = sum(errors.values()) / len(errors)
    takes = sum(cable.errors.takes for cable in _cables(batch))
    return Measured(mean, f"{len(errors)} cables, {takes} takes predicted", dict(errors))


def worst_cable(batch: CheckBatch) -> Measured:
    """Largest mean distance of a cable [mm]."""
    return _extreme(_of_cables(batch, lambda cable: cable.errors.mean), max)


def least_coverage(batch: CheckBatch) -> Measured:
    """Smallest fraction of a cable's coordinates in the band."""
    return _extreme(_of_cables(batch, lambda cable: cable.errors.coverage), min)


def largest_coverage(batch: CheckBatch) -> Measured:
    """Largest fraction of a cable's coordinates in the band."""
    return _extreme(_of_cables(batch, lambda cable: cable.errors.coverage), max)


def prediction_speed(batch: CheckBatch) -> Measured:
    """Length of the takes over the processor time of their predictions, slowest cable."""
    return _extreme(_of_cables(batch, lambda cable: cable.errors.speed), min)


def forward_force_ahead(batch: CheckBatch) -> Measured:
    """RMS error of the forward force of wheels straight ahead [N]."""
    return _of_wheels(batch, _FORWARD, ahead=True)


def sinkage_ahead(batch: CheckBatch) -> Measured:
    """RMS error of the sinkage of wheels straight ahead [mm]."""
    return _of_wheels(batch, _SINKAGE, ahead=True)


def forward_force_askew(batch: CheckBatch) -> Measured:
    """RMS error of the forward force of wheels at angles [N]."""
    return _of_wheels(batch, _FORWARD, ahead=False)


def sideways_force_askew(batch: CheckBatch) -> Measured:
    """RMS error of the sideways force of wheels at angles [N]."""
    return _of_wheels(batch, _SIDEWAYS, ahead=False)


def sinkage_askew(batch: CheckBatch) -> Measured:
    """RMS error of the sinkage of wheels at angles [mm]."""
    return _of_wheels(batch, _SINKAGE, ahead=False)


def _of_cables(batch: CheckBatch, value: Callable[[CableSummary], float]) -> dict[str, float]:
    return {cable.name: value(cable) for cable in _cables(batch)}


def _extreme(values: dict[str, float], choose: Callable[..., str]) -> Measured:
    name = choose(values, key=lambda each: values[each])
    return Measured(values[name], name, dict(values))


def _of_wheels(batch: CheckBatch, quantity: int, *, ahead: bool) -> Measured:
    """RMS over the runs of all wheels within the law's limit of validity."""
    groups: dict[str, GroupErrors] = {
        f"{wheel.name}, {group.label}": group
        for wheel in _wheels(batch)
        for group in wheel.errors
        if group.label.endswith(_AHEAD) == ahead and not group.label.endswith(BEYOND)
    }
    if not groups:
        raise SetsNotGiven("no run of a wheel is " + (_AHEAD if ahead else "at an angle"))
    runs = sum(group.runs for group in groups.values())
    squares = sum(group.runs * group.rms[quantity] ** 2 for group in groups.values())
    details: dict[str, float | str] = {name: group.rms[quantity] for name, group in groups.items()}
    return Measured(math.sqrt(squares / runs), f"{runs} runs predicted from the others", details)


def _cables(batch: CheckBatch) -> tuple[CableSummary, ...]:
    keep = (batch.kept or batch.folder) / "cables"
    return tuple(_cable(each, keep) for each in _folders(batch, "cables"))


def _wheels(batch: CheckBatch) -> tuple[WheelSummary, ...]:
    return tuple(_wheel(each) for each in _folders(batch, "wheels"))


def _folders(batch: CheckBatch, kind: str) -> list[Path]:
    if batch.sets is None:
        raise SetsNotGiven("no measured sets are given; name their folder with --sets")
    folders = list(set_folders(batch.sets, kind))
    if not folders:
        raise SetsNotGiven(f"{batch.sets} holds no {kind}/NAME")
    return folders


@functools.cache
def _cable(folder: Path, keep: Path) -> CableSummary:
    return summarise_cable(folder, keep)


@functools.cache
def _wheel(folder: Path) -> WheelSummary:
    return summarise_wheel(folder)
