"""``mother_rover validate cable report``: measured over predicted, errors over time, coverage."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rover_validation.cable.comparison import coverage, error_of, has_free_markers
from rover_validation.cable.model import Cable
from rover_validation.cable.takes import Floats, Take, read_takes
from rover_validation.refusals import OK, SetError, refusing

_MEASURED, _PREDICTED, _BAND = "#212529", "#d55e00", "#56b4e9"
_SHAPES = 6
"""Frames of a take whose shapes are drawn."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Draw measured takes over their predictions, the errors over time and the coverage of the "
        "band, as one SVG or PNG file. Exit codes: 0 drawn, 2 a file is refused."
    )
    parser.add_argument("cable", type=Path, help="YAML file that identify wrote")
    parser.add_argument("folder", type=Path, help="folder of measured takes, with free markers")
    parser.add_argument("--out", type=Path, required=True, help="picture to write")


@refusing("cable report")
def run(options: argparse.Namespace) -> int:
    """Draw; return the exit code."""
    cable = Cable.read(options.cable)
    takes = read_takes(options.folder)
    figure = draw(cable, takes)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out)
    print(f"{options.out}: {len(takes)} takes")
    return OK


def draw(cable: Cable, takes: list[Take]) -> Figure:
    """Draw the comparison of all takes, with the shapes of the one of median error.

    Raises:
        SetError: a take is of another cable, or none has free markers.
    """
    assert cable.band is not None
    compared = [take for take in takes if has_free_markers(take)]
    if not compared:
        raise SetError("no take has free markers after the second frame: nothing to compare with")
    predicted = [cable.predict(take) for take in compared]
    bounds = [
        cable.band.bounds(each, take.period) for each, take in zip(predicted, compared, strict=True)
    ]
    errors = [error_of(take, each) for take, each in zip(compared, predicted, strict=True)]
    shown = int(np.argsort(errors)[len(errors) // 2])
    figure = Figure(figsize=(12.0, 9.0), layout="constrained")
    grid = figure.subplots(2, 2)
    _draw_shapes(grid[0, 0], compared[shown], predicted[shown])
    _draw_marker(grid[0, 1], compared[shown], predicted[shown], bounds[shown])
    _draw_errors(grid[1, 0], compared, predicted)
    _draw_coverage(grid[1, 1], compared, bounds)
    mean = 1e3 * float(np.mean(errors))
    figure.suptitle(f"{len(compared)} takes, mean distance of the free markers {mean:.1f} mm")
    return figure


def _draw_shapes(axes: Axes, take: Take, predicted: Floats) -> None:
    """Shapes seen along the world's axis across the line between the ends."""
    chord = np.abs(np.mean(take.positions[:, -1] - take.positions[:, 0], axis=0))
    across = 0 if chord[0] >= chord[1] else 1
    frames = np.linspace(0, len(take.times) - 1, _SHAPES).astype(int)
    for place, frame in enumerate(frames.tolist()):
        strength = 0.35 + 0.65 * place / (_SHAPES - 1)
        held = take.positions[frame]
        whole = np.concatenate([held[:2], predicted[frame], held[-2:]])
        axes.plot(
            held[:, across], held[:, 2], "o-", color=_MEASURED, alpha=strength, markersize=3,
            linewidth=0.8, label="measured" if place == _SHAPES - 1 else None,
        )  # fmt: skip
        axes.plot(
            whole[:, across], whole[:, 2], "x--", color=_PREDICTED, alpha=strength, markersize=4,
            linewidth=0.8, label="predicted" if place == _SHAPES - 1 else None,
        )  # fmt: skip
    axes.set(xlabel=f"{'xy'[across]} [m]", ylabel="z [m]", aspect="equal")
    axes.set_title(f"{take.name}: shapes at {_SHAPES} instants")
    axes.legend()


def _draw_marker(axes: Axes, take: Take, predicted: Floats, bounds: tuple[Floats, Floats]) -> None:
    """Coordinates of the middle marker with the band."""
    marker = predicted.shape[1] // 2
    for k, name in enumerate("xyz"):
        low, high = bounds[0][:, marker, k], bounds[1][:, marker, k]
        axes.fill_between(take.times, low, high, color=_BAND, alpha=0.4, linewidth=0.0)
        axes.plot(take.times, predicted[:, marker, k], "--", color=_PREDICTED, linewidth=1.0)
        axes.plot(take.times, take.free[:, marker, k], color=_MEASURED, linewidth=1.0)
        axes.annotate(name, (take.times[-1], predicted[-1, marker, k]))
    axes.set(xlabel="time [s]", ylabel="position [m]")
    axes.set_title(f"{take.name}: marker {marker + 2} with the 90 % band")


def _draw_errors(axes: Axes, takes: list[Take], predicted: list[Floats]) -> None:
    for take, own in zip(takes, predicted, strict=True):
        distance = 1e3 * np.nanmean(np.linalg.norm(own - take.free, axis=-1), axis=1)
        axes.plot(take.times - take.times[0], distance, color=_MEASURED, alpha=0.3, linewidth=0.7)
    axes.set(xlabel="time [s]", ylabel="mean distance of the free markers [mm]", ylim=(0.0, None))
    axes.set_title("Errors over time, each take")


def _draw_coverage(axes: Axes, takes: list[Take], bounds: list[tuple[Floats, Floats]]) -> None:
    inside = []
    width = []
    for take, (low, high) in zip(takes, bounds, strict=True):
        fraction, mean = coverage(take, low, high)
        inside.append(100.0 * fraction)
        width.append(1e3 * mean)
    axes.plot(width, inside, "o", color=_MEASURED)
    axes.axhline(90.0, color=_PREDICTED, linestyle="--", linewidth=1.0)
    axes.set(xlabel="mean width of the band [mm]", ylabel="coordinates in the band [%]")
    axes.set_ylim(0.0, 102.0)
    axes.set_title(f"Coverage of each take, mean {np.mean(inside):.0f} %, {np.mean(width):.0f} mm")
