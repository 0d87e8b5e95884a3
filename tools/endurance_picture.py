"""Draw what the processes used during the missions flown for endurance, for the documents.

    mother_rover verify --only ENDURANCE --hours 12
    python tools/endurance_picture.py out docs/endurance.png

The first argument is the folder of the verification's results.
"""

from __future__ import annotations

import argparse
import math
import pickle
import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rover_verify.checks.endurance import Endured, UsageSample

HOUR = 3600.0  # [s]


def newest(folder: Path) -> Path:
    """Return the file of the last flight for endurance that was kept.

    Raises:
        FileNotFoundError: there is none.
    """
    found = sorted(
        folder.glob("verification/kept/*/endure_*.pickle"), key=lambda p: p.stat().st_mtime
    )
    if not found:
        raise FileNotFoundError(
            f"{folder} has no results of ENDURANCE rows: run `mother_rover verify`"
        )
    return found[-1]


def draw(endured: Endured) -> Figure:
    """Draw memory and handles of each process, and the sizes of log and bag, over time."""
    samples = endured.samples
    figure = Figure(figsize=(11.4, 6.4), layout="constrained")
    (memory, handles), (log, bag) = figure.subplots(2, 2, sharex=True)
    _draw_processes(memory, samples, "memory", "resident memory [MiB]")
    _draw_processes(handles, samples, "handles", "open file handles")
    memory.legend(fontsize=8, ncols=2)
    hours = [each.time / HOUR for each in samples]
    for axes, values, label in (
        (log, [each.log for each in samples], "printed text [MiB]"),
        (bag, [each.bag for each in samples], "bag [MiB]"),
    ):
        axes.plot(hours, values)
        axes.set_ylabel(label)
        axes.set_xlabel("simulated time [h]")
        axes.set_ylim(bottom=0.0)
    return figure


def _draw_processes(axes: Axes, samples: Sequence[UsageSample], quantity: str, label: str) -> None:
    names = sorted({name for each in samples for name in getattr(each, quantity)})
    for place, name in enumerate(names):
        values = [getattr(each, quantity).get(name, math.nan) for each in samples]
        # The lines become thinner, so that equal values are all seen.
        width = 1.5 + 0.6 * (len(names) - 1 - place)
        axes.plot([each.time / HOUR for each in samples], values, label=name, linewidth=width)
    axes.set_ylabel(label)
    axes.margins(y=0.1)
    axes.set_ylim(bottom=0.0)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture; returns an exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("results", type=Path, help="folder of the verification's results")
    parser.add_argument("picture", type=Path, help="file to write")
    options = parser.parse_args(arguments)
    draw(pickle.loads(newest(options.results).read_bytes())).savefig(options.picture, dpi=100)
    return 0


if __name__ == "__main__":
    sys.exit(main())
