"""Measured sets of cables and wheels, predicted by the laws of tether and wheel.

The sets are no part of the suite: a folder of them is named by `mother_rover verify --sets`, as
`mother_rover validate summary` describes it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

from rover_validation.sets.summary import (
    CableSummary,
    WheelSummary,
    set_folders,
    summarise_cable,
    summarise_wheel,
)
from rover_verify.checks import Check, CheckBatch, Measured, SetsNotGiven

_QUANTITIES = ("forward force [N]", "sideways force [N]", "sinkage [mm]")
_FORWARD, _SIDEWAYS, _SINKAGE = range(3)
_AHEAD, _ASKEW = "straight ahead", "at angles"


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


def _of_cables(batch: CheckBatch, value: Callable[[CableSummary], float]) -> dict[str, float]:
    return {cable.name: value(cable) for cable in _cables(batch)}


def _extreme(values: dict[str, float], choose: Callable[..., str]) -> Measured:
    name = choose(values, key=lambda each: values[each])
    return Measured(values[name], name, dict(values))


def _of_wheel(name: str, quantity: int, course: str) -> Check:
    """Check of the RMS error of a quantity over the runs of the wheel of this name."""

    def measured(batch: CheckBatch) -> Measured:
        label = f"{name}, {course}"
        found = {
            f"{wheel.name}: {group.label}": group
            for wheel in _wheels(batch)
            for group in wheel.errors
            if group.label == label
        }
        if not found:
            raise SetsNotGiven(f"no set holds runs of {label}")
        runs = sum(group.runs for group in found.values())
        worst = max(found, key=lambda each: found[each].rms[quantity])
        details: dict[str, float | str] = {each: found[each].rms[quantity] for each in found}
        value = found[worst].rms[quantity]
        return Measured(value, f"{worst}; {runs} runs predicted from the others", details)

    measured.__doc__ = f"RMS error of the {_QUANTITIES[quantity]} of a wheel {name!r} {course}."
    return measured


smooth_forward_ahead = _of_wheel("smooth", _FORWARD, _AHEAD)
smooth_sinkage_ahead = _of_wheel("smooth", _SINKAGE, _AHEAD)
grouser_forward_ahead = _of_wheel("grouser", _FORWARD, _AHEAD)
grouser_sinkage_ahead = _of_wheel("grouser", _SINKAGE, _AHEAD)
smooth_forward_askew = _of_wheel("smooth", _FORWARD, _ASKEW)
smooth_sideways_askew = _of_wheel("smooth", _SIDEWAYS, _ASKEW)
smooth_sinkage_askew = _of_wheel("smooth", _SINKAGE, _ASKEW)
grouser_forward_askew = _of_wheel("grouser", _FORWARD, _ASKEW)
grouser_sideways_askew = _of_wheel("grouser", _SIDEWAYS, _ASKEW)
grouser_sinkage_askew = _of_wheel("grouser", _SINKAGE, _ASKEW)


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
