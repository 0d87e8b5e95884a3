"""``mother_rover validate wheel report``: measured over predicted, in pictures and a table."""

from __future__ import annotations

import argparse
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from rover_validation.refusals import OK, refusing
from rover_validation.wheel.comparison import UNITS, compare, largest_errors
from rover_validation.wheel.fitting import bands, check_wheels
from rover_validation.wheel.sets import IdentifiedSoil, Runs, read_runs, read_soil

_LABELS = ("forward force [N]", "sideways force [N]", "sinkage [mm]")
_MARKS = ("o", "^", "s", "v", "D")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = "Compare measured runs with the predictions of an identified soil."
    parser.add_argument("soil", type=Path, metavar="soil.yaml")
    parser.add_argument("measured", type=Path, metavar="MEASURED.csv")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")


@refusing("wheel report")
def run(options: argparse.Namespace) -> int:
    """Write pictures and the table of errors; 2 after a refusal."""
    found = read_soil(options.soil)
    runs = read_runs(options.measured)
    check_wheels(found.wheels, runs, str(options.measured))
    options.out.mkdir(parents=True, exist_ok=True)
    text = write_report(options.out, found, runs)
    print(text)
    return OK


def write_report(folder: Path, found: IdentifiedSoil, runs: Runs) -> str:
    """Write `report.md` and its pictures into a folder; return the text."""
    centre, half = bands(found, runs)
    error = centre - runs.measured
    lines = [
        "| runs | n | forward force [N] | sideways force [N] | sinkage [mm] | in the 90 % band |",
        "|---|---|---|---|---|---|",
    ]
    for each in compare(runs, centre, half):
        cells = " | ".join(f"{value:.2f}" for value in each.rms)
        lines.append(f"| {each.label} | {each.runs} | {cells} | {each.coverage:.0%} |")
    lines += ["", "Largest errors, predicted less measured:", ""]
    lines += [f"- {text}" for text in largest_errors(runs, error, found.scatter)]
    text = "\n".join(lines)
    (folder / "report.md").write_text(
        "# Wheel on soil: measured over predicted\n\nRMS errors.\n\n" + text + "\n\n"
        "![measured over predicted](measured_over_predicted.png)\n\n"
        "![errors over slip](errors_over_slip.png)\n",
        encoding="utf-8",
    )
    mpl.use("Agg")
    _measured_over_predicted(folder / "measured_over_predicted.png", runs, centre, half)
    _errors_over_slip(folder / "errors_over_slip.png", runs, error)
    return text


def _measured_over_predicted(path: Path, runs: Runs, centre: Any, half: Any) -> None:
    figure, axes = _figure(1)
    angle = np.degrees(runs.angle)
    for j, axis in enumerate(axes[0]):
        axis.errorbar(
            centre[:, j] * UNITS[j],
            runs.measured[:, j] * UNITS[j],
            xerr=half[:, j] * UNITS[j],
            fmt="none",
            ecolor="0.85",
            zorder=0,
        )
        for name, mark in zip(sorted(set(runs.wheel)), cycle(_MARKS), strict=False):
            own = np.array([wheel == name for wheel in runs.wheel])
            points = axis.scatter(
                centre[own, j] * UNITS[j],
                runs.measured[own, j] * UNITS[j],
                c=angle[own],
                vmin=0.0,
                vmax=90.0,
                marker=mark,
                s=16,
                label=name,
            )
        ends = [*axis.get_xlim(), *axis.get_ylim()]
        axis.plot([min(ends), max(ends)], [min(ends), max(ends)], "k-", lw=0.8)
        axis.set(xlabel=f"predicted {_LABELS[j]}", ylabel=f"measured {_LABELS[j]}")
    axes[0][0].legend()
    figure.colorbar(points, ax=axes[0][-1], label="angle between travel and wheel plane [deg]")
    figure.savefig(path, dpi=110)


def _errors_over_slip(path: Path, runs: Runs, error: Any) -> None:
    names = sorted(set(runs.wheel))
    figure, axes = _figure(len(names))
    forward = runs.travel * np.cos(runs.angle)
    slip = (runs.rim - forward) / np.maximum(runs.rim, forward)
    for row, name in zip(axes, names, strict=True):
        own = np.array([wheel == name for wheel in runs.wheel])
        for j, axis in enumerate(row):
            for angle in sorted(set(np.round(np.degrees(runs.angle[own]), 1))):
                part = own & (np.abs(np.degrees(runs.angle) - angle) < 0.05)
                order = np.argsort(slip[part])
                axis.plot(
                    slip[part][order],
                    (error[part, j] * UNITS[j])[order],
                    ".-",
                    label=f"{angle:g} deg",
                )
            axis.axhline(0.0, color="k", lw=0.8)
            axis.set(
                xlabel="slip [-]", ylabel=f"error of {_LABELS[j]}", title=name, xlim=(-1.05, 1.05)
            )
    figure.get_layout_engine().set(rect=(0.0, 0.0, 0.9, 1.0))  # the legend's place
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="upper right")
    figure.savefig(path, dpi=110)


def _figure(rows: int) -> tuple[Any, Any]:
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import

    figure = Figure(figsize=(14.0, 4.2 * rows), layout="constrained")
    return figure, figure.subplots(rows, 3, squeeze=False)
