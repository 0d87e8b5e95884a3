"""The source paper's whole study of the tethered jump: its runs, and what they tell."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from rover_studies.paper_claims import Verdict, verdicts
from rover_studies.paper_curves import Attribution, attribution, convergence, curves_of
from rover_studies.paper_page import conclusion, page, write_tables
from rover_studies.paper_plan import HALVED, JUMPS, NUDGED, QUICK, WHOLE, Extent, plans
from rover_studies.sweep import Stopped, sweep
from rover_studies.sweep_store import STATUS, StoreError
from rover_studies.workers import WorkersError, package_version

DONE, REFUSED, STOPPED, INTERRUPTED = 0, 2, 3, 130
_RUNS: Final = "runs"

Rows = list[dict[str, Any]]


def make_runs(
    extent: Extent, folder: Path, *, workers: int | None = None, show_progress: bool = True
) -> dict[str, Rows]:
    """Make the jumps of the study, or go on with those that are missing.

    Args:
        extent: how much of it.
        folder: each sweep gets a folder in it.
        workers: processes; by default one for each core.
        show_progress: whether progress bars are drawn.

    Returns:
        Rows of results by sweep.

    Raises:
        StoreError, WorkersError, Stopped: as the sweep does.
    """
    rows: dict[str, Rows] = {}
    for name, plan in plans(extent).items():
        store = sweep(plan, folder / name, workers=workers, show_progress=show_progress)
        rows[name] = store.table().to_pylist()
        store.close()
    return rows


def evaluate(rows: dict[str, Rows], folder: Path) -> tuple[Attribution, list[Verdict]]:
    """Find what the runs tell, and write report and tables into a folder."""
    curves = curves_of(rows[JUMPS], rows.get(NUDGED, ()), rows.get(HALVED, ()))
    cause, told, converged = attribution(curves), verdicts(curves), convergence(curves)
    every = [row for table in rows.values() for row in table]
    landed = sum(row[STATUS] == "done" for row in every)
    about = (
        f"{len(every)} jumps ({landed} landed), planar plant of mother_rover {package_version()}."
        " Parameters are the paper's Tables 1 and 2 and, where it gives none, the scenarios'."
    )
    folder.mkdir(parents=True, exist_ok=True)
    text = page(curves, cause, told, converged, about)
    (folder / "report.html").write_text(text, encoding="utf-8")
    write_tables(folder, curves, cause, told, converged)
    summary = {
        "conclusion": conclusion(cause),
        "mesh_is_the_cause": cause.mesh_is_the_cause,
        "findings": [{"words": words, "holds": holds} for words, holds in cause.findings],
        "verdicts": {verdict.claim.name: verdict.words for verdict in told},
        "runs": len(every),
        "landed": landed,
    }
    (folder / "study.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return cause, told


def as_text(cause: Attribution, told: Sequence[Verdict]) -> str:
    """The study for a terminal."""
    lines = [conclusion(cause), ""]
    lines += [f"  {'yes' if holds else 'NO ':3s}  {words}" for words, holds in cause.findings]
    lines += ["", "verdicts:"]
    lines += [
        f"  figure {verdict.claim.figures}  {verdict.claim.name:22s} {verdict.words}"
        for verdict in told
    ]
    return "\n".join(lines)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Reproduce the paper's study: figures 11 to 16 over the slack value, for each geometry, "
        "starting shape and mesh, with convergence and energy evidence and a verdict on each "
        "claim, as one HTML report and CSV tables."
    )
    parser.epilog = (
        "Exit codes: 0 done, 2 bad input, 3 stopped early, 130 interrupted; after 3 and 130 the "
        "same command resumes."
    )
    parser.add_argument("--out", type=Path, default=Path("out/study"), metavar="DIR",
                        help="folder of the results (default: %(default)s)")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="fewer slack values and meshes")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: all cores)")


def run(options: argparse.Namespace) -> int:
    """Make the study; return the exit code."""
    if options.workers is not None and options.workers < 1:
        return _complain(f"--workers is {options.workers}, it should be at least 1", REFUSED)
    extent = QUICK if options.quick else WHOLE
    # Either extent keeps runs of its own, so that one does not stand in the other's way.
    runs = options.out / _RUNS / ("quick" if options.quick else "whole")
    try:
        rows = make_runs(extent, runs, workers=options.workers)
        cause, told = evaluate(rows, options.out)
    except (StoreError, WorkersError, OSError) as error:
        return _complain(error, REFUSED)
    except Stopped as error:
        return _complain(f"{error}; what is done is kept, the same command goes on", STOPPED)
    except KeyboardInterrupt:
        return _complain("interrupted; the same command goes on", INTERRUPTED)
    print(as_text(cause, told))
    print(f"\nreport and tables: {options.out / 'report.html'}", file=sys.stderr)
    return DONE


def _complain(error: object, status: int) -> int:
    print(f"mother_rover study all: {error}", file=sys.stderr)
    return status
