"""``mother_rover validate wheel report``: measured over predicted, in pictures and a table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from rover_validation.refusals import OK, refusing
from rover_validation.wheel.fitting import bands, check_wheels, within_validity
from rover_validation.wheel.identify import groups
from rover_validation.wheel.sets import IdentifiedSoil, Runs, read_runs, read_soil

_LABELS = ("forward force [N]", "sideways force [N]", "sinkage [mm]")
_UNITS = np.array([1.0, 1.0, 1e3])
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
    valid = within_validity(runs)
    lines = [
        "| runs | n | forward force [N] | sideways force [N] | sinkage [mm] | in the 90 % band |",
        "|---|---|---|---|---|---|",
    ]
    for label, group in groups(runs):
        for part, name in ((group & valid, label), (group & ~valid, f"{label}, beyond the law")):
            if part.any():
                rms = np.sqrt(np.mean(error[part] ** 2, axis=0)) * _UNITS
                inside = np.mean(np.abs(error[part]) <= half[part])
                lines.append(
                    f"| {name} | {part.sum()} | {rms[0]:.2f} | {rms[1]:.2f} | {rms[2]:.2f} "
                    f"| {inside:.0%} |"
                )
    worst = np.argsort(-np.abs(error / found.scatter).max(axis=1))[:5]
    lines += ["", "Largest errors, predicted less measured:", ""]
    for i in worst:
        angle, rim = np.degrees(runs.angle[i]), runs.rim[i] * 1e3
        parts = ", ".join(
            f"{label.replace(' [', f' {value:+.1f} [')}"
            for label, value in zip(_LABELS, error[i] * _UNITS, strict=True)
        )
        lines.append(
            f"- {runs.wheel[i]}, {angle:.0f} deg, rim {rim:.0f} mm/s at "
            f"{runs.travel[i] * 1e3:.0f} mm/s: {parts}"
        )
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
            centre[:, j] * _UNITS[j],
            runs.measured[:, j] * _UNITS[j],
            xerr=half[:, j] * _UNITS[j],
            fmt="none",
            ecolor="0.85",
            zorder=0,
        )
        for name, mark in zip(sorted(set(runs.wheel)), _MARKS, strict=False):
            own = np.array([wheel == name for wheel in runs.wheel])
            points = axis.scatter(
                centre[own, j] * _UNITS[j],
                runs.measured[own, j] * _UNITS[j],
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
                    (error[part, j] * _UNITS[j])[order],
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
