"""The source paper's whole study of the tethered jump: runs, evaluation and report."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from msg_schemas.number_arguments import positive
from msg_schemas.package import package_version
from rover_studies.paper.paper_claims import Verdict, evaluate_claims
from rover_studies.paper.paper_curves import Attribution, attribution, convergence, curves_of
from rover_studies.paper.paper_page import conclusion, page, write_tables
from rover_studies.paper.paper_plan import HALVED, JUMPS, PERTURBED, QUICK, WHOLE, Extent, plans
from rover_studies.sweep.sweep import Stopped, sweep
from rover_studies.sweep.sweep_store import STATUS, StoreError
from rover_studies.sweep.sweep_workers import WorkersError

DONE, REFUSED, STOPPED, INTERRUPTED = 0, 2, 3, 130
_RUNS: Final = "runs"

Rows = list[dict[str, Any]]


def make_runs(
    extent: Extent, folder: Path, *, workers: int | None = None, show_progress: bool = True
) -> dict[str, Rows]:
    """Simulate the jumps of the study, or those that are missing.

    Args:
        extent: of the study.
        folder: of the sweeps' folders.
        workers: number of processes; default: one per core.
        show_progress: whether to show progress bars.

    Returns:
        Rows of results by sweep.

    Raises:
        StoreError, WorkersError, Stopped: from the sweep.
    """
    rows: dict[str, Rows] = {}
    for name, plan in plans(extent).items():
        store = sweep(plan, folder / name, workers=workers, show_progress=show_progress)
        rows[name] = store.table().to_pylist()
        store.close()
    return rows


def evaluate(rows: dict[str, Rows], folder: Path) -> tuple[Attribution, list[Verdict]]:
    """Evaluate the runs, and write report and tables to a folder."""
    curves = curves_of(rows[JUMPS], rows.get(PERTURBED, ()), rows.get(HALVED, ()))
    cause, verdicts, converged = attribution(curves), evaluate_claims(curves), convergence(curves)
    every = [row for table in rows.values() for row in table]
    landed = sum(row[STATUS] == "done" for row in every)
    about = (
        f"{len(every)} jumps ({landed} landed), planar plant of mother_rover {package_version()}."
        " Parameters are those of the paper's Tables 1 and 2, otherwise those of the scenarios."
    )
    folder.mkdir(parents=True, exist_ok=True)
    text = page(curves, cause, verdicts, converged, about)
    (folder / "report.html").write_text(text, encoding="utf-8")
    write_tables(folder, curves, cause, verdicts, converged)
    summary = {
        "conclusion": conclusion(cause),
        "mesh_is_the_cause": cause.mesh_is_the_cause,
        "conditions": [
            {"statement": statement, "holds": holds} for statement, holds in cause.conditions
        ],
        "verdicts": {verdict.claim.name: verdict.summary for verdict in verdicts},
        "runs": len(every),
        "landed": landed,
    }
    (folder / "study.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return cause, verdicts


def as_text(cause: Attribution, verdicts: Sequence[Verdict]) -> str:
    """Format the study for a terminal."""
    lines = [conclusion(cause), ""]
    lines += [f"  {'yes' if holds else 'NO ':3s}  {words}" for words, holds in cause.conditions]
    lines += ["", "verdicts:"]
    lines += [
        f"  figure {verdict.claim.figure}  {verdict.claim.name:22s} {verdict.summary}"
        for verdict in verdicts
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
    parser.add_argument(
        "--workers", type=positive, metavar="N", help="processes (default: all cores)"
    )


def run(options: argparse.Namespace) -> int:
    """Make the study; return the exit code."""
    extent = QUICK if options.quick else WHOLE
    # Each extent has its own runs, as the plans differ.
    runs = options.out / _RUNS / ("quick" if options.quick else "whole")
    try:
        rows = make_runs(extent, runs, workers=options.workers)
        cause, verdicts = evaluate(rows, options.out)
    except (StoreError, WorkersError, OSError) as error:
        return _fail(error, REFUSED)
    except Stopped as error:
        return _fail(f"{error}; completed runs are kept; repeat the command to continue", STOPPED)
    except KeyboardInterrupt:
        return _fail("interrupted; repeat the command to continue", INTERRUPTED)
    print(as_text(cause, verdicts))
    print(f"\nreport and tables: {options.out / 'report.html'}", file=sys.stderr)
    return DONE


def _fail(error: object, status: int) -> int:
    print(f"mother_rover study all: {error}", file=sys.stderr)
    return status
