"""Bench of sweeps: planar jumps per second over the number of worker processes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rover_sim import available_cores
from rover_studies.sweep.sweep import run_sweep
from rover_studies.sweep.sweep_plan import SweepPlan, make_plan
from rover_studies.sweep.sweep_store import SweepStore
from rover_studies.sweep.sweep_workers import local_processes, package_version
from rover_verify.bench.bench_row import Row, bench_row

ELEMENTS: Final = 10
CASE: Final = "sweep of jumps"


def jumps(runs: int, seed: int = 1) -> SweepPlan:
    """A Monte Carlo plan of planar jumps: geometry, slack, tilt and spring at random."""
    return make_plan(
        {
            "name": "planar_jumps",
            "scenario": "paper_table1_high",
            "seed": seed,
            "runs": runs,
            "set": {"tether.elements": ELEMENTS},
            "random": {
                "start.geometry": {"choice": ["-H", "-K", "+K"]},
                "start.slack": {"uniform": [0.52, 3.5]},
                "start.theta0": {"normal": [0.0, 5.0], "within": [-15.0, 15.0]},
                "rover.spring_rate": {"factor": {"uniform": [0.95, 1.05]}},
            },
        }
    )


def timed_sweep(plan: SweepPlan, folder: Path, workers: int) -> float:
    """Wall time [s] of a plan's runs, without each worker's first batches.

    The first batches load (or compile) the code.

    Raises:
        ValueError: the plan has no runs beyond the first batches.
    """
    store = SweepStore(folder, plan, package_version())
    begin, first = 0.0, 0

    def on_rows(_rows: Sequence[Mapping[str, Any]]) -> None:
        nonlocal begin, first
        if not begin and store.done >= 2 * workers:
            begin, first = time.perf_counter(), store.done

    with local_processes(workers, plan.scenarios.values()) as crew:
        run_sweep(plan, store, crew, on_rows)
    spent = time.perf_counter() - begin
    counted = plan.count - first
    store.finish()
    store.close()
    if not (begin and counted):
        raise ValueError(f"{plan.count} runs are too few to time {workers} workers")
    return spent * plan.count / counted


def measure_scaling(runs: int) -> list[Row]:
    """One row for each number of workers: 1, 2, 4 ... up to the cores."""
    counts = [1]
    while counts[-1] * 2 <= available_cores():
        counts.append(counts[-1] * 2)
    rows: list[Row] = []
    first = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for workers in counts:
            spent = timed_sweep(jumps(runs), Path(folder) / str(workers), workers)
            first = first or spent
            rows.append(
                bench_row(
                    CASE,
                    ELEMENTS,
                    workers=workers,
                    runs=runs,
                    runs_per_second=runs / spent,
                    speed_over_one_worker=first / spent,
                    seconds_for_10000=1e4 * spent / runs,
                )
            )
    return rows


def table(rows: Sequence[Mapping[str, object]]) -> str:
    """The rows as text for a terminal."""
    lines = [
        f"sweep of planar jumps, n = {ELEMENTS}, wall time",
        f"{'workers':>8}{'runs/s':>10}{'over one':>10}{'10 000 runs [s]':>17}",
    ]
    lines += [
        f"{row['workers']!s:>8}{row['runs_per_second']:10.1f}{row['speed_over_one_worker']:10.2f}"
        f"{row['seconds_for_10000']:17.1f}"
        for row in rows
    ]
    return "\n".join(lines)
