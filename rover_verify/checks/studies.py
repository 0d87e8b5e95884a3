"""Studies: speed, step and rare events of sweeps, and what the paper's study concludes."""

from __future__ import annotations

import time
from collections import Counter
from typing import Literal

import numpy as np

from rover_sim.physics.tether.ancf import Array
from rover_studies.paper.paper_plan import HEAVY, LIGHT, QUICK, Extent
from rover_studies.paper.whole_study import evaluate, make_runs
from rover_studies.sweep.rare_event_sweep import rare_event_numbers
from rover_studies.sweep.sweep import sweep
from rover_studies.sweep.sweep_plan import make_plan
from rover_studies.sweep.sweep_store import read_results
from rover_verify.bench.bench_sweep import STEPS, jumps, spatial_jumps
from rover_verify.checks import CheckBatch, Measured

_SCATTER_CLAIMS = ("height beyond 1.5", "scatter beyond 1.5")
_FINE = 0.00025  # step at which the height of a jump is converged [s]


def speed(batch: CheckBatch, plant: Literal["planar", "spatial"]) -> Measured:
    """Wall time of random jumps by two processes, their start included [s].

    The jumps are 10 000 planar ones at n = 10, or 2000 spatial ones at n = 20.
    """
    plan = jumps(10_000, batch.seed) if plant == "planar" else spatial_jumps(2_000, batch.seed)
    folder = batch.folder / plan.name
    begin = time.monotonic()
    sweep(plan, folder, workers=2, show_progress=False).close()
    spent = time.monotonic() - begin
    statuses = Counter(read_results(folder).column("status").to_pylist())
    details: dict[str, float | str] = {name: float(count) for name, count in statuses.items()}
    return Measured(spent, f"{plan.count / spent:.0f} jumps a second", details)


def step_error(batch: CheckBatch) -> Measured:
    """Largest error of the height of random spatial jumps at the longer step of the bench [m]."""
    fine, coarse = (_heights_and_travels(batch, h) for h in (_FINE, STEPS[-1]))
    errors = coarse - fine
    note = f"{batch.runs} jumps of {fine[:, 0].mean():.3f} m, {STEPS[-1]:g} s beside {_FINE:g} s"
    rms = np.sqrt(np.mean(errors**2, axis=0))
    details = {"RMS error of the height [m]": rms[0], "RMS error of the travel [m]": rms[1]}
    return Measured(float(np.max(np.abs(errors[:, 0]))), note, details)


def _heights_and_travels(batch: CheckBatch, h: float) -> Array:
    """Height and travel of random spatial jumps with a time step [m], (runs, 2)."""
    folder = batch.folder / f"{h:g}"
    sweep(spatial_jumps(batch.runs, batch.seed, h), folder, workers=2, show_progress=False).close()
    table = read_results(folder)
    return np.stack([table.column(name) for name in ("jump_height_m", "travel_m")], axis=1)


def rare(batch: CheckBatch) -> Measured:
    """Largest relative error at 95 % of three estimates of the same probability.

    It is that of a planar jump whose tether exceeds 6.5 N, about 1e-3.
    """
    errors = []
    details: dict[str, float | str] = {}
    for seed in range(batch.seed, batch.seed + 3):
        plan = make_plan(
            {
                "name": "overload",
                "scenario": "paper_table1_high",
                "seed": seed,
                "set": {
                    "tether.elements": 10,
                    "tether.axial_damping_time": 1e-3,
                    "start.geometry": "-K",
                },
                "random": {
                    "start.slack": {"uniform": [0.8, 1.6]},
                    "start.theta0": {"normal": [0.0, 4.0], "within": [-16.0, 16.0]},
                    "rover.spring_rate": {"factor": {"normal": [1.0, 0.03]}},
                    "take_off.compression": {"normal": [0.2, 0.01], "within": [0.15, 0.25]},
                },
                "rare_event": {
                    "quantity": "peak_tension_N",
                    "above": 6.5,
                    "relative_error": 0.2,
                    "max_runs": 10_000,
                },
            }
        )
        folder = batch.folder / str(seed)
        sweep(plan, folder, workers=2, show_progress=False).close()
        found = rare_event_numbers(plan, read_results(folder))
        known = found["probability"] is not None
        errors.append(found["high"] / found["probability"] - 1.0 if known else 1.0)
        details |= {
            f"{name} of seed {seed}": found[name] or 0.0 for name in ("probability", "runs")
        }
    return Measured(max(errors), "peak tension above 6.5 N", details)


def verdict(batch: CheckBatch) -> Measured:
    """How many conclusions about the scatter of figures 13 and 14 the study does not draw."""
    extent = Extent(QUICK.slacks, QUICK.elements, (HEAVY, LIGHT), QUICK.geometries)
    rows = make_runs(extent, batch.folder / "runs", workers=2, show_progress=False)
    cause, results = evaluate(rows, batch.folder / "study")
    missed = [words for words, holds in cause.conditions if not holds]
    missed += [v.summary for v in results if v.claim.name in _SCATTER_CLAIMS and not v.artefact]
    details: dict[str, float | str] = {v.claim.name: v.summary for v in results}
    details |= {f"missed {index}": words for index, words in enumerate(missed, 1)}
    conclusions = len(cause.conditions) + len(_SCATTER_CLAIMS)
    jumps = sum(len(table) for table in rows.values())
    return Measured(len(missed), f"of {conclusions} conclusions from {jumps} jumps", details)
