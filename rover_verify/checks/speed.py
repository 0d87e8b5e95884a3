"""Speed relative to the peer, over the number of elements, of the spatial plant, and start time.

Single thread and CPU time; the start is wall time.
"""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path

from msg_schemas import topics
from msg_schemas.health import Health, read_health
from msg_schemas.phases import HealthState
from rover_verify.bench import bench, bench_spatial, exudyn_peer
from rover_verify.bench.bench_cases import BenchCase, cases
from rover_verify.bench.bench_mission import cpu_time
from rover_verify.bench.bench_row import Row
from rover_verify.checks import CheckBatch, Measured, NotPossible
from rover_verify.harness import open_harness

_REPETITIONS = 5


@cache
def _row(name: str, elements: int) -> Row:
    found: list[BenchCase] = [c for c in cases() if c.name == name and c.elements == elements]
    (row,) = bench.run_bench(found, _REPETITIONS, costs=False, quiet=True)
    return row


def over_peer(_batch: CheckBatch, name: str, elements: int) -> Measured:
    """Speed relative to Exudyn in a case of the bench."""
    if exudyn_peer.load() is None:
        raise NotPossible("Exudyn is not installed: pip install exudyn")
    row = _row(name, elements)
    keys = ("rtf", "error_m", "setting", "peer_rtf", "peer_error_m", "peer_setting")
    details = {key: row[key] for key in keys}
    return Measured(row["ratio"], f"{name}, n = {elements}, at matched tip error", details)


def linear_cost(_batch: CheckBatch) -> Measured:
    """Cost of a step at n = 200 relative to that at n = 20."""
    rows = bench.measure_costs(_REPETITIONS, lambda _text: None)
    details = {
        f"n = {row['n']}, {key}": row[key]
        for row in rows
        for key in ("microseconds_per_step", "iterations_per_step", "share_of_core_peak")
    }
    note = "undamped pendulum at 1 ms, tolerance 1e-8"
    return Measured(rows[-1]["cost_over_first"], note, details)


# --------------------------------------------------------------------------------- spatial plant


@cache
def _resting() -> list[Row]:
    return bench_spatial.measure_rest(_REPETITIONS, lambda _text: None)


def _numbers(row: Row) -> dict[str, float | str]:
    return {key: value for key, value in row.items() if isinstance(value, float)}


def resting(_batch: CheckBatch, elements: int) -> Measured:
    """Real-time factor at rest on rubble."""
    (row,) = [row for row in _resting() if row["n"] == elements]
    return Measured(
        row["rtf"], "all models on, ticks of 10 ms, best of the repetitions", _numbers(row)
    )


def spatial_worst(_batch: CheckBatch) -> Measured:
    """Real-time factor of the slowest 10 ms of a jump and its landing on rubble, n = 50."""
    row = bench_spatial.measure_worst(_REPETITIONS, lambda _text: None)
    return Measured(row["rtf"], "worst tick of a jump with its landing on rubble", _numbers(row))


# ---------------------------------------------------------------------------------------- start

_LONGEST_START = 300.0  # [s]
_START = "floor_rubble"


def _ready_after(folder: Path, cache_folder: Path) -> tuple[float, float]:
    """Wall time from the start of sim_node until it reports readiness [s], and its CPU time."""
    with open_harness(folder) as harness:
        observer = harness.observer()
        began = time.monotonic()
        process = harness.processes.start(
            "rover_sim.node.sim_node",
            {"scenario": _START, "model": "spatial"},
            extra_environment={"NUMBA_CACHE_DIR": str(cache_folder)},
        )
        ready = Health("sim_node", HealthState.READY)
        observer.listen(topics.DIAGNOSTICS).wait(
            lambda sample: any(read_health(each) == ready for each in sample.statuses),
            timeout=_LONGEST_START,
        )
        return time.monotonic() - began, cpu_time(process.pid)


def start_cold(batch: CheckBatch) -> Measured:
    """Time to readiness with an empty compilation cache [s]."""
    spent, cpu = _ready_after(batch.folder, batch.folder / "cache")
    note = "sim_node with the spatial plant, standing on rubble, empty cache"
    return Measured(spent, note, {"CPU time of all its processes [s]": cpu})


def start_warm(batch: CheckBatch) -> Measured:
    """Median time to readiness with a filled compilation cache [s]."""
    cache_folder = batch.folder / "cache"
    first, _ = _ready_after(batch.folder, cache_folder)
    again = sorted(_ready_after(batch.folder, cache_folder) for _ in range(3))
    details: dict[str, float | str] = {"first start, cold [s]": first}
    for k, (spent, cpu) in enumerate(again):
        details[f"start {k + 2} [s]"] = spent
        details[f"start {k + 2}, CPU time [s]"] = cpu
    return Measured(again[1][0], "the same, after a start that compiled", details)
