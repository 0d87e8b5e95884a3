"""`mother_rover bench`: speed and error of the plant compared with Exudyn in one run.

Single thread, CPU time without warm-up, medians of repetitions in turn. Every case is compared at
matched tip error: both codes run over step sizes, tolerances and methods, with errors relative to
their own strongly refined solutions; then the peer's fastest setting within the case's accuracy is
compared with our fastest setting that is at least as accurate.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from msg_schemas.number_arguments import positive
from msg_schemas.regular_files import writing_problem
from rover_verify.bench import (
    bench_messages,
    bench_mission,
    bench_spatial,
    bench_sweep,
    core_peak,
    exudyn_peer,
)
from rover_verify.bench.bench_cases import (
    FLOWN,
    PEER_USUAL,
    BenchCase,
    Exudyn,
    Match,
    Ours,
    Survey,
    cases,
    match,
    ratios_along,
    survey,
    timed,
)
from rover_verify.bench.bench_row import Progress, Row, bench_row, text_table
from rover_verify.bench.trial import SAMPLE, BenchSetting

COST_ELEMENTS = (20, 50, 100, 200)
_COST_DURATION = 0.5
_SWEEP_RUNS = 2000
_MISSION_DURATION = 20.0  # of each measurement [s]


def measure_case(case: BenchCase, repetitions: int, progress: Progress) -> Row:
    """One row: both codes at matched error, and at the usual step of each."""
    ours = Ours(case)
    peer = Exudyn(case) if exudyn_peer.load() is not None else None
    own = survey(case, ours, lambda text: progress(f"ours {text}"))
    other = None if peer is None else survey(case, peer, lambda text: progress(f"Exudyn {text}"))
    pair = match(case, own, other)
    settings: list[tuple[Ours | Exudyn, BenchSetting]] = [
        (ours, pair.ours.setting),
        (ours, FLOWN),
    ]
    if peer is not None and pair.peer is not None:
        settings += [(peer, pair.peer.setting), (peer, PEER_USUAL)]

    runs = [partial(code.run, setting, case.duration) for code, setting in settings]
    times = timed(runs, repetitions, progress)
    return _row(case, pair, own, other, times)


def _row(
    case: BenchCase, pair: Match, own: Survey, other: Survey | None, times: Sequence[float]
) -> Row:
    rates = [case.duration / spent for spent in times]
    flown = own.at(FLOWN)
    row = bench_row(
        case.name,
        case.elements,
        rtf=rates[0],
        error_m=pair.ours.error,
        setting=str(pair.ours.setting),
        duration_s=case.duration,
        errors_compared_until_s=case.compared_until,
        target_error_m=case.accuracy,
        reference_change_m=own.reference_change,
        rtf_flown=rates[1],
        error_flown_m=None if flown is None else flown.error,
        iterations_per_step_flown=(
            None if flown is None else flown.iterations * FLOWN.h / case.duration
        ),
    )
    if other is None or pair.peer is None:
        return row
    along = [ratio for _, ratio in ratios_along(own, other, case.accuracy)]
    usual = other.at(PEER_USUAL)
    row |= {
        "peer": f"Exudyn {exudyn_peer.version()}, {pair.peer.setting.method}",
        "peer_rtf": rates[2],
        "peer_error_m": pair.peer.error,
        "peer_setting": str(pair.peer.setting),
        "peer_method": pair.peer.setting.method,
        "ratio": rates[0] / rates[2],
        "ours_no_less_accurate": pair.ours.error <= pair.peer.error,
        "ratio_lowest_at_any_error": min(along, default=None),
        "ratio_highest_at_any_error": max(along, default=None),
        "peer_reference_change_m": other.reference_change,
        "peer_rtf_usual": None if math.isnan(rates[3]) else rates[3],
        "peer_error_usual_m": None if usual is None else usual.error,
        "ratio_at_1_ms": None if math.isnan(rates[3]) else rates[1] / rates[3],
    }
    return row


def measure_costs(repetitions: int, progress: Progress) -> list[Row]:
    """Cost of one step over the number of elements, at the flown step and tolerance."""
    chosen = [
        BenchCase("cost per step", "tether_pendulum", (), n, _COST_DURATION, _COST_DURATION, 1e-3)
        for n in COST_ELEMENTS
    ]
    codes = [Ours(case) for case in chosen]
    runs = [partial(code.run, FLOWN, _COST_DURATION) for code in codes]
    iterations = [trial.iterations for run in runs if (trial := run()) is not None]
    times = timed(runs, repetitions, progress)
    steps = round(_COST_DURATION / FLOWN.h)
    peak = core_peak.peak_gflops()
    rows: list[Row] = []
    for case, spent, count in zip(chosen, times, iterations, strict=True):
        each = spent / (count * case.elements)
        rows.append(
            bench_row(
                case.name,
                case.elements,
                rtf=_COST_DURATION / spent,
                setting=str(FLOWN),
                microseconds_per_step=spent / steps * 1e6,
                cost_over_first=spent / times[0],
                iterations_per_step=count / steps,
                nanoseconds_per_element_and_iteration=each * 1e9,
                core_peak_gflops=peak,
                share_of_core_peak=core_peak.FLOPS_PER_ELEMENT_ITERATION / each * 1e-9 / peak,
            )
        )
    return rows


def run_bench(
    chosen: Sequence[BenchCase], repetitions: int, *, costs: bool = True, quiet: bool = False
) -> list[Row]:
    """Measure the given cases; shows progress as a bar, or one line per case if quiet."""
    rows: list[Row] = []
    total = len(chosen) + (1 if costs else 0)
    with tqdm(total=total, disable=quiet, unit="case", dynamic_ncols=True, leave=False) as bar:

        def progress(text: str) -> None:
            bar.set_postfix_str(text, refresh=True)

        for plant in {case.scenario: case.plant() for case in chosen}.values():
            plant.warm_up()
        for case in chosen:
            bar.set_description(f"{case.name}, n = {case.elements}")
            if quiet:
                print(f"{case.name}, n = {case.elements} ...", flush=True)
            rows.append(measure_case(case, repetitions, progress))
            bar.update()
        if costs:
            bar.set_description("cost per step")
            rows += measure_costs(repetitions, progress)
            bar.update()
    return rows


_MATCHED = (
    ("case", "case", ""), ("n", "n", ""),
    ("ours rtf", "rtf", ".1f"), ("error m", "error_m", ".1e"), ("setting", "setting", ""),
    ("peer rtf", "peer_rtf", ".2f"), ("error m", "peer_error_m", ".1e"),
    ("setting", "peer_setting", ""), ("method", "peer_method", ""), ("ratio", "ratio", ".1f"),
    ("at any error", "ratio_lowest_at_any_error", ".1f"),
    ("to", "ratio_highest_at_any_error", ".1f"),
)  # fmt: skip
_USUAL = (
    ("case", "case", ""), ("n", "n", ""),
    ("ours rtf", "rtf_flown", ".1f"), ("error m", "error_flown_m", ".1e"),
    ("iterations/step", "iterations_per_step_flown", ".2f"),
    ("peer rtf", "peer_rtf_usual", ".2f"), ("error m", "peer_error_usual_m", ".1e"),
    ("ratio", "ratio_at_1_ms", ".1f"),
)  # fmt: skip
_COSTS = (
    ("n", "n", ""), ("us/step", "microseconds_per_step", ".1f"),
    ("over the first", "cost_over_first", ".2f"),
    ("iterations/step", "iterations_per_step", ".2f"),
    ("ns/element/iteration", "nanoseconds_per_element_and_iteration", ".0f"),
    ("of core peak", "share_of_core_peak", ".1%"),
)  # fmt: skip


def table(rows: Sequence[Row]) -> str:
    """The rows as text for a terminal."""
    compared = [row for row in rows if row["error_m"] is not None]
    costs = [row for row in rows if "microseconds_per_step" in row]
    lines = [
        "matched tip error (settings: step, Newton tolerance); rtf = simulated s per CPU s",
        *text_table(_MATCHED, compared),
        "",
        f"both at 1 ms and their tight tolerance, {FLOWN.tolerance:g}",
        *text_table(_USUAL, compared),
    ]
    if costs:
        lines += [
            "",
            "our cost per step at 1 ms, pendulum",
            *text_table(_COSTS, costs),
            (
                f"core peak measured: {costs[0]['core_peak_gflops']:.0f} GFlop/s "
                f"(vectorised fused multiply-adds); about {core_peak.FLOPS_PER_ELEMENT_ITERATION} "
                "operations per element and iteration"
            ),
        ]
    return "\n".join(lines)


def notes(*, peer: bool) -> str:
    """Notes for the reader of the table."""
    first, last = cases()[0].compared_until, cases()[-1].compared_until
    lines = [
        "Errors: largest distance of the tether's tip from the code's own solution at 1/32 ms",
        f"(1/16 ms beyond n = 20), each {SAMPLE:g} s to {first:g} s (pendulum), {last:g} s (jump).",
        "Later the undamped pendulum is chaotic (it cracks like a whip): its 2 s runs are timed,",
        "but their paths are compared only before.",
        "At any error: the same comparison along the peer's whole Pareto front of cost and error.",
    ]
    if peer:
        lines += [
            "Exudyn: its C++ cable (strain |r'| - 1, no Python callbacks), fast build, one thread,",
            "sparse solver, modified Newton, generalised-alpha with spectral radius 0.9; velocity",
            f"Verlet with a spring of {exudyn_peer.PIN_STIFFNESS:g} N/m as pin where stable.",
        ]
    else:
        lines.append("Exudyn is not installed (pip install exudyn): no comparison with a peer.")
    return "\n".join(lines)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Measure the CPU time and the error of the plant side by side with Exudyn: one thread, "
        "medians of several repetitions, every case at matched tip error. Also the CPU time of "
        "sweeps, of messages and of a mission."
    )
    parser.add_argument("--out", type=Path, default=Path("out"), metavar="DIR",
                        help="folder of bench.json (default: %(default)s)")  # fmt: skip
    parser.add_argument("--repetitions", type=positive, default=5, metavar="N",
                        help="timings per case (default: %(default)d)")  # fmt: skip
    parser.add_argument(
        "--case", action="append", metavar="NAME", help="only cases whose name contains NAME"
    )
    parser.add_argument("--elements", type=positive, nargs="+", action="extend", metavar="N",
                        help="only these numbers of elements")  # fmt: skip


class _BenchPart(NamedTuple):
    """One part of the bench: measured when it is selected, then printed as a table."""

    name: str
    selected: bool
    measure: Callable[[], list[Row]]
    table: Callable[[list[Row]], str]


def _parts(options: argparse.Namespace, chosen: Sequence[BenchCase]) -> list[_BenchPart]:
    """The bench in the order in which it is measured and printed."""
    whole = not (options.case or options.elements)

    def named(name: str) -> bool:
        return whole or any(word in name for word in options.case or ())

    in_space = [name for name in (bench_spatial.RESTING, bench_spatial.WORST) if named(name)]
    repetitions = options.repetitions
    peer = exudyn_peer.load() is not None
    return [
        _BenchPart(
            "cases in the plane",
            whole or bool(chosen),
            lambda: run_bench(chosen, repetitions, costs=whole, quiet=not sys.stderr.isatty()),
            lambda rows: f"{table(rows)}\n\n{notes(peer=peer)}",
        ),
        _BenchPart(
            "spatial plant",
            bool(in_space),
            lambda: bench_spatial.measure(in_space, repetitions, lambda _text: None),
            bench_spatial.table,
        ),
        _BenchPart(
            bench_sweep.CASE,
            named(bench_sweep.CASE),
            lambda: bench_sweep.measure_scaling(_SWEEP_RUNS),
            bench_sweep.table,
        ),
        _BenchPart(
            bench_messages.CASE,
            named(bench_messages.CASE),
            lambda: bench_messages.measure(repetitions),
            bench_messages.table,
        ),
        _BenchPart(
            bench_mission.CASE,
            named(bench_mission.CASE),
            lambda: bench_mission.measure(_MISSION_DURATION),
            bench_mission.table,
        ),
    ]


def run(options: argparse.Namespace) -> int:
    """Run the bench; return 0 when every chosen case was measured."""
    chosen = [
        case
        for case in cases()
        if (not options.case or any(word in case.name for word in options.case))
        and (not options.elements or case.elements in options.elements)
    ]
    parts = [part for part in _parts(options, chosen) if part.selected]
    if not parts:
        names = {case.name for case in cases()} | {
            bench_spatial.RESTING, bench_spatial.WORST, bench_sweep.CASE, bench_messages.CASE,
            bench_mission.CASE,
        }  # fmt: skip
        options.usage_error(f"no such case; there are {'; '.join(sorted(names))}")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        options.usage_error(f"--out: {writing_problem(error, options.out)}")
    measured: list[tuple[_BenchPart, list[Row]]] = []
    for part in parts:
        print(f"{part.name} ...", file=sys.stderr)
        measured.append((part, part.measure()))
    rows = [row for _, found in measured for row in found]
    path = options.out / "bench.json"
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    for part, found in measured:
        print(part.table(found) + "\n")
    ratios = [row["ratio"] for row in rows if isinstance(row["ratio"], float)]
    if ratios:
        print(f"Median ratio over the cases: {statistics.median(ratios):.1f}")
    print(f"Written: {path}")
    return 0
