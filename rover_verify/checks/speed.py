"""Speed against the peer and over the number of elements; single thread, CPU time."""

from __future__ import annotations

from functools import cache

from rover_verify import bench, exudyn_peer
from rover_verify.bench_cases import Case, cases
from rover_verify.checks import Batch, Measured, NotPossible

_REPETITIONS = 5


@cache
def _row(name: str, elements: int) -> bench.Row:
    found: list[Case] = [c for c in cases() if c.name == name and c.elements == elements]
    (row,) = bench.run_bench(found, _REPETITIONS, costs=False, quiet=True)
    return row


def _ratio(name: str, elements: int) -> Measured:
    if exudyn_peer.load() is None:
        raise NotPossible("Exudyn is not installed: pip install exudyn")
    row = _row(name, elements)
    keys = (
        "rtf", "error_m", "setting", "peer_rtf", "peer_error_m", "peer_setting", "ratio_at_1_ms",
    )  # fmt: skip
    ratio = row["ratio"]
    assert isinstance(ratio, float)
    details = {key: value if isinstance(value := row[key], float) else str(value) for key in keys}
    return Measured(ratio, f"{name}, n = {elements}, at matched tip error", details)


def pendulum_20(_batch: Batch) -> Measured:
    """Speed over Exudyn's, pendulum, n = 20."""
    return _ratio("pendulum, 1 s", 20)


def whip_100(_batch: Batch) -> Measured:
    """Speed over Exudyn's, pendulum through the whip, n = 100."""
    return _ratio("pendulum, 2 s", 100)


def jump_20(_batch: Batch) -> Measured:
    """Speed over Exudyn's, tethered jump, n = 20."""
    return _ratio("jump", 20)


def linear_cost(_batch: Batch) -> Measured:
    """Cost of a step at n = 200 over that at n = 20."""
    rows = bench.measure_costs(_REPETITIONS, lambda _text: None)
    details: dict[str, float | str] = {}
    for row in rows:
        for key in ("microseconds_per_step", "iterations_per_step", "share_of_core_peak"):
            value = row[key]
            assert isinstance(value, float)
            details[f"n = {row['n']}, {key}"] = value
    last = rows[-1]["cost_over_first"]
    assert isinstance(last, float)
    return Measured(last, "undamped pendulum at 1 ms, tolerance 1e-8", details)
