"""Rounds of a sweep for a rare event, from its stored results, and their summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rover_studies.sweep.rare_event import RareEventEstimate, advance
from rover_studies.sweep.sweep_plan import SweepPlan


def follow_rounds(plan: SweepPlan, table: Any) -> tuple[SweepPlan, RareEventEstimate | None]:
    """Return a plan with all rounds that its results define, and the estimate if these suffice.

    Args:
        plan: with a rare event.
        table: results so far, in the order of the runs.
    """
    event = plan.rare_event
    if event is None:
        raise AssertionError(f"the plan {plan.name} has no rare event")
    numbers = table.column("run").to_numpy()
    quantities = np.array(table.column(event.quantity).to_pylist(), dtype=float)
    while np.array_equal(numbers[: plan.count], np.arange(plan.count)):
        step = advance(event, plan.rounds, quantities[: plan.count], plan.seed)
        if isinstance(step, RareEventEstimate):
            return plan, step
        plan = plan.with_round(step)
    return plan, None


def rare_event_numbers(plan: SweepPlan, table: Any) -> dict[str, Any]:
    """Return the estimate from the results of a complete sweep, as plain values."""
    expanded, estimate = follow_rounds(plan, table)
    if estimate is None:
        raise AssertionError(f"the rounds of {plan.name} are not complete")
    numbers = {"event": str(plan.rare_event), **vars(estimate), "design_point": None}
    if estimate.design_run is not None:
        numbers["design_point"] = dict(expanded.run(estimate.design_run).overrides)
    return numbers


def rare_event_lines(numbers: Mapping[str, Any]) -> list[str]:
    """Format `rare_event_numbers` for a terminal."""
    counted = f"{numbers['counted_runs']} of {numbers['runs']} runs"
    nearest = "none has a result" if numbers["nearest"] is None else f"{numbers['nearest']:.6g}"
    lines = [f"  probability of {numbers['event']}: {numbers['outcome']}"]
    if numbers["probability"] is None:
        lines.append(f"    below {numbers['high']:.3g} (95 %); the nearest run: {nearest}")
    else:
        interval = f"{numbers['low']:.3g} to {numbers['high']:.3g}"
        lines.append(f"    {numbers['probability']:.4g}, {interval} (95 %), from {counted}")
    if numbers["levels"]:
        lines.append("    levels: " + ", ".join(f"{level:.6g}" for level in numbers["levels"]))
    if numbers["failed_probability"]:
        lines.append(f"    probability of no result: {numbers['failed_probability']:.3g}")
    lines.append(
        f"    a failing region apart from those found: below {numbers['unseen_limit']:.2g} (95 %)"
    )
    if numbers["design_point"] is not None:
        lines.append(f"    most probable failing run: {numbers['design_run']}")
        lines += [f"      {path} = {value}" for path, value in numbers["design_point"].items()]
    return lines
