"""Bench of sweeps: jumps per second over the number of worker processes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from msg_schemas.package import package_version
from rover_sim import available_cores
from rover_studies.sweep.sweep import run_sweep
from rover_studies.sweep.sweep_plan import SweepPlan, make_plan
from rover_studies.sweep.sweep_store import SweepStore
from rover_studies.sweep.sweep_workers import local_processes
from rover_verify.bench.bench_row import Row, bench_row, text_table

ELEMENTS: Final = 10
SPATIAL_ELEMENTS: Final = 20
STEPS: Final = (0.001, 0.002)  # of spatial jumps: the scenario's, and a longer one [s]
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


def spatial_jumps(runs: int, seed: int = 1, h: float = STEPS[0]) -> SweepPlan:
    """A Monte Carlo plan of spatial jumps from one place: compression and tilt at random.

    Args:
        runs: number of jumps.
        seed: of the plan.
        h: time step [s].
    """
    return make_plan(
        {
            "name": "spatial_jumps",
            "scenario": "floor_rubble",
            "experiment": "spatial_jump",
            "seed": seed,
            "runs": runs,
            "set": {
                "tether.elements": SPATIAL_ELEMENTS,
                "tether.element_length": None,
                "integration.h": h,
            },
            "random": {
                "start.compression": {"normal": [0.12, 0.01], "within": [0.08, 0.16]},
                "start.tilt.0": {"normal": [0.0, 2.0], "within": [-8.0, 8.0]},
                "start.tilt.1": {"normal": [0.0, 2.0], "within": [-8.0, 8.0]},
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
    """Rows of planar jumps for each number of workers: 1, 2, 4 ... up to the cores; and of spatial.

    The spatial jumps take all workers; a fifth as many are run with each step.
    """
    counts = [1]
    while counts[-1] * 2 <= available_cores():
        counts.append(counts[-1] * 2)
    cases = [(jumps(runs), workers) for workers in counts]
    fewer = max(runs // 5, 4 * counts[-1])
    cases += [(spatial_jumps(fewer, h=h), counts[-1]) for h in STEPS]
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for plan, workers in cases:
            spent = timed_sweep(plan, Path(folder) / str(len(rows)), workers)
            rows.append(_row(plan, workers, plan.count / spent))
    return rows


def _row(plan: SweepPlan, workers: int, runs_per_second: float) -> Row:
    (scenario,) = plan.scenarios.values()
    return bench_row(
        CASE,
        ELEMENTS if scenario.model == "planar" else SPATIAL_ELEMENTS,
        plant=scenario.model,
        h=scenario.integration.h,
        workers=workers,
        runs_per_second=runs_per_second,
        seconds_for_10000=1e4 / runs_per_second,
    )


def table(rows: Sequence[Row]) -> str:
    """The rows as text for a terminal."""
    columns = (
        ("plant", "plant", ""), ("n", "n", ""), ("h [s]", "h", "g"), ("workers", "workers", ""),
        ("runs/s", "runs_per_second", ".1f"), ("10 000 runs [s]", "seconds_for_10000", ".1f"),
    )  # fmt: skip
    return "\n".join(["sweep of jumps, wall time", *text_table(columns, rows)])
