"""``mother_rover sweep``: runs a plan of many simulations on all cores or a cluster, resumably.

    mother_rover sweep plan.yaml --out out/my_sweep

After a kill, an interruption or a power failure, the same command continues the sweep.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from enum import IntEnum
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from tqdm import tqdm

from msg_schemas.number_arguments import positive
from msg_schemas.package import package_version
from rover_sim import (
    RunError,
    ScenarioError,
    SettlingError,
    StaticsError,
    available_cores,
    parse_override,
)
from rover_studies.sweep.experiments import EXPERIMENTS, Value, results_of
from rover_studies.sweep.rare_event_sweep import follow_rounds, rare_event_lines, rare_event_numbers
from rover_studies.sweep.sweep_plan import SweepPlan, SweepPlanError, load_plan
from rover_studies.sweep.sweep_store import REASON, STATUS, StoreError, SweepStore, write_csv
from rover_studies.sweep.sweep_workers import Workers, WorkersError, dask_cluster, local_processes

DONE: Final = "done"
FAILED: Final = "failed"
REFUSED: Final = "refused"
_SHORTEST_BATCH: Final = 0.5
_LONGEST_BATCH: Final = 10.0
_TARGET_BATCHES: Final = 1000
"""Target number of batches; a batch takes between `_SHORTEST_BATCH` and `_LONGEST_BATCH` [s]."""
_WAITING_PER_WORKER: Final = 2


class SweepExitCode(IntEnum):
    """Exit codes of ``sweep``."""

    DONE = 0
    REFUSED = 2
    STOPPED = 3
    INTERRUPTED = 130


class Stopped(RuntimeError):
    """The workers ended before the sweep was complete; completed runs are kept."""


# --- one batch, in a worker -----------------------------------------------------------------------


@cache
def _plan_of(text: str) -> SweepPlan:
    return SweepPlan(json.loads(text))


def run_batch(plan_text: str, numbers: Sequence[int]) -> tuple[list[dict[str, Value]], float]:
    """Simulate some runs of a plan.

    Args:
        plan_text: the plan's content as JSON.
        numbers: of the runs.

    Returns:
        A row for each run, and the total time [s].
    """
    plan = _plan_of(plan_text)
    begin = time.perf_counter()
    return [run_one(plan, number) for number in numbers], time.perf_counter() - begin


def run_one(plan: SweepPlan, number: int) -> dict[str, Value]:
    """Simulate one run of a plan; a failure becomes its status and reason."""
    one = plan.run(number)
    row = plan.row(one)
    results: dict[str, Value] = dict.fromkeys(plan.experiment.columns)
    status, reason = DONE, None
    try:
        scenario = plan.scenario_of(one)
        found = plan.experiment.perform(scenario, one.seed, plan.settings)
        results = results_of(plan.experiment, found)
    except ScenarioError as error:
        status, reason = REFUSED, str(error)
    except (StaticsError, SettlingError, RunError) as error:
        status, reason = FAILED, str(error)
    return {**row, STATUS: status, REASON: reason, **results}


# --- all of them ----------------------------------------------------------------------------------

ProgressCallback = Callable[[Sequence[Mapping[str, Value]]], None]


def run_sweep(
    plan: SweepPlan, store: SweepStore, workers: Workers, on_rows: ProgressCallback
) -> None:
    """Simulate the missing runs and store their rows.

    Args:
        plan: the plan.
        store: of the rows.
        workers: that simulate.
        on_rows: called with the rows of each batch after they are stored.

    Raises:
        Stopped: the workers ended.
        StoreError: writing failed.
        OSError: a run of a local process met it.
    """
    text = json.dumps(plan.content)
    missing = store.missing()
    waiting: set[Future[tuple[list[dict[str, Value]], float]]] = set()
    each: float | None = None  # time of one run [s]
    batch_time = _SHORTEST_BATCH
    try:
        while True:
            while len(waiting) < workers.count * _WAITING_PER_WORKER:
                left = plan.count - store.done
                # Batches shrink near the end, so that all workers end at the same time.
                fair = max(1, left // (workers.count * _WAITING_PER_WORKER * 2))
                size = 1 if each is None else min(max(1, round(batch_time / each)), fair)
                numbers = list(islice(missing, size))
                if not numbers:
                    break
                waiting.add(workers.executor.submit(run_batch, text, numbers))
            if not waiting:
                return
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                rows, seconds = future.result()
                store.add(rows)
                on_rows(rows)
                latest = max(seconds, 1e-6) / len(rows)
                # The first run of a worker includes loading the compiled code: an upper bound.
                each = latest if each is None else min(0.5 * (each + latest), 2.0 * each)
                total = each * plan.count / workers.count
                batch_time = min(max(total / _TARGET_BATCHES, _SHORTEST_BATCH), _LONGEST_BATCH)
    except BrokenExecutor as error:
        raise Stopped("a worker process died (killed, or out of memory)") from error
    except StoreError:
        raise
    except Exception as error:
        if workers.of_cluster and _is_of_cluster(error):
            raise Stopped(f"the cluster failed: {error}") from error
        raise
    finally:
        for future in waiting:
            future.cancel()


def _is_of_cluster(error: Exception) -> bool:
    return type(error).__module__.partition(".")[0] in {"distributed", "dask"} or isinstance(
        error, OSError
    )


@contextlib.contextmanager
def workers_of(plan: SweepPlan, scheduler: str | None, count: int | None) -> Iterator[Workers]:
    """Provide workers: those of a cluster, or local processes."""
    scenarios = plan.scenarios.values()
    if scheduler is not None:
        with dask_cluster(scheduler, scenarios) as workers:
            yield workers
    else:
        with local_processes(count or available_cores(), scenarios) as workers:
            yield workers


def sweep(
    plan: SweepPlan,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    show_progress: bool = True,
) -> SweepStore:
    """Run a plan to its end, or continue one.

    Args:
        plan: the plan.
        folder: of the results; a sweep of the same plan in it is continued.
        workers: number of processes; default: one per core.
        scheduler: address of a dask.distributed scheduler to use instead.
        show_progress: whether to show a progress bar.

    Returns:
        The store with the results, to be closed by the caller.

    Raises:
        StoreError: the folder cannot be used, or writing failed.
        WorkersError: there are no workers.
        OSError: a run of a local process met it.
        Stopped: the workers ended before the sweep was complete; the same call continues it.
    """
    store = SweepStore(folder, plan, package_version())
    try:
        plan = _expected(plan, store)
        if store.done < plan.count:
            with (
                tqdm(
                    initial=store.done,
                    total=plan.count,
                    unit=" runs",
                    desc=f"{plan.name}, compiling",
                    smoothing=0.05,
                    mininterval=0.2 if sys.stderr.isatty() else 10.0,
                    disable=not show_progress,
                    dynamic_ncols=True,
                ) as bar,
                workers_of(plan, scheduler, workers) as crew,
            ):
                failures: Counter[str] = Counter()

                def show(rows: Sequence[Mapping[str, Value]]) -> None:
                    bar.set_description(plan.name, refresh=False)
                    failures.update(str(row[STATUS]) for row in rows if row[STATUS] != DONE)
                    if failures:
                        bar.set_postfix(failures, refresh=False)
                    bar.update(len(rows))

                while store.done < plan.count:
                    bar.total = plan.count
                    run_sweep(plan, store, crew, show)
                    plan = _expected(plan, store)
        store.finish()
    except BaseException:
        store.close()
        raise
    return store


def _expected(plan: SweepPlan, store: SweepStore) -> SweepPlan:
    """Return the plan with the next round of a rare event, which the store is to expect."""
    if plan.rare_event is not None:
        plan, _ = follow_rounds(plan, store.table())
        store.extend(plan)
    return plan


# --- summary --------------------------------------------------------------------------------------


def summary(plan: SweepPlan, table: Any) -> dict[str, Any]:
    """Return the numbers of runs by status and reason, and the distribution of each result."""
    statuses = Counter(table.column(STATUS).to_pylist())
    reasons = Counter(
        str(reason).partition(": ")[0] for reason in table.column(REASON).to_pylist() if reason
    )
    numbers: dict[str, Any] = {
        "plan": plan.name,
        "fingerprint": plan.fingerprint,
        "seed": plan.seed,
        "runs": table.num_rows,
        "statuses": dict(statuses),
        "reasons": dict(reasons.most_common(20)),
    }
    if plan.rare_event is not None:
        return {**numbers, "rare_event": rare_event_numbers(plan, table)}
    return {**numbers, "results": _distributions(plan, table)}


def _distributions(plan: SweepPlan, table: Any) -> dict[str, dict[str, float]]:
    results = {}
    for name, kind in plan.experiment.columns.items():
        if kind not in {float, int}:
            continue
        values = np.array(
            [value for value in table.column(name).to_pylist() if value is not None], dtype=float
        )
        if len(values):
            five, half, ninety_five = np.percentile(values, (5.0, 50.0, 95.0))
            results[name] = {
                "count": len(values),
                "mean": float(values.mean()),
                "deviation": float(values.std(ddof=1)) if len(values) > 1 else 0.0,
                "min": float(values.min()),
                "p05": float(five),
                "median": float(half),
                "p95": float(ninety_five),
                "max": float(values.max()),
            }
    return results


def as_text(numbers: Mapping[str, Any]) -> str:
    """Format a summary for a terminal."""
    counts = ", ".join(f"{count} {status}" for status, count in numbers["statuses"].items())
    lines = [f"{numbers['plan']}: {numbers['runs']} runs ({counts}), seed {numbers['seed']}"]
    lines += [f"  {count:8d} x {reason}" for reason, count in numbers["reasons"].items()]
    columns = ("mean", "deviation", "min", "p05", "median", "p95", "max")
    if "rare_event" in numbers:
        return "\n".join([*lines, *rare_event_lines(numbers["rare_event"])])
    if numbers["results"]:
        lines.append(" " * 26 + "".join(f"{name:>13s}" for name in columns))
    for name, row in numbers["results"].items():
        lines.append(f"  {name:24s}" + "".join(f"{row[column]:13.5g}" for column in columns))
    return "\n".join(lines)


# --- the executable -------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    experiments = "\n".join(
        f"  {name}: {one.about}; settings: "
        + ", ".join(f"{key} = {s.default:g} {s.unit}" for key, s in one.settings.items())
        for name, one in EXPERIMENTS.items()
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = (
        "Run a plan of many simulations: a grid over any values of any scenario, Monte Carlo\n"
        "draws, or both. Uses all cores, or a dask.distributed cluster; resumes after a kill;\n"
        "writes results.parquet and summary.json. Or estimate the probability of a rare event in\n"
        "adaptive rounds of runs (docs/study.md)."
    )
    parser.epilog = (
        "a plan:\n"
        "  scenario: paper_table1_high\n"
        "  experiment: jump\n"
        "  seed: 1\n"
        "  runs: 100                      # for each point of the grid\n"
        "  set: {tether.elements: 10}\n"
        "  grid: {start.geometry: [-H, +K], start.slack: {from: 0.6, to: 3.4, count: 15}}\n"
        "  random: {start.theta0: {normal: [0, 5], within: [-15, 15]},\n"
        "           rover.spring_rate: {factor: {uniform: [0.95, 1.05]}}}\n"
        "distributions: uniform, log_uniform, normal, integers, choice\n\n"
        "in place of runs and grid:\n"
        "  rare_event: {quantity: peak_tension_N, above: 400, relative_error: 0.2,\n"
        "               max_runs: 10000, method: importance_sampling}   # or monte_carlo\n\n"
        f"experiments:\n{experiments}\n\n"
        "exit codes: 0 complete (failed runs are results too), 2 refused, 3 stopped "
        "early, 130 interrupted; after 3 and 130 the same command resumes"
    )
    add = parser.add_argument
    add("plan", type=Path, help="the plan, a YAML file")
    add(
        "--out", type=Path, metavar="DIR", help="folder of the results (default: out/<plan's name>)"
    )
    add("--workers", type=positive, metavar="N", help="number of processes (default: one per core)")
    add("--scheduler", metavar="ADDRESS", help="a dask.distributed scheduler, tcp://host:8786")
    add("--runs", type=int, metavar="N", help="replaces the plan's")
    add("--seed", type=int, metavar="N", help="replaces the plan's")
    add(
        "--set", action="append", default=[], metavar="PATH=VALUE",
        help="a value of all runs, in addition to the plan's",
    )  # fmt: skip
    add("--csv", action="store_true", help="also write results.csv")
    add("--json", action="store_true", help="print the summary as JSON")
    add("--dry-run", action="store_true", help="check the plan, print its extent, and end")


def _plan(options: argparse.Namespace) -> SweepPlan:
    changes: dict[str, Any] = {
        key: getattr(options, key) for key in ("runs", "seed") if getattr(options, key) is not None
    }
    if options.set:
        changes["set"] = dict(parse_override(assignment) for assignment in options.set)
    return load_plan(options.plan, changes)


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`SweepExitCode`."""
    try:
        plan = _plan(options)
    except (SweepPlanError, ScenarioError) as error:
        return _fail(error)
    if options.dry_run:
        print(_outline(plan))
        return SweepExitCode.DONE
    folder = options.out or Path("out") / plan.name
    begin = time.monotonic()
    try:
        store = sweep(plan, folder, workers=options.workers, scheduler=options.scheduler)
    except (OSError, WorkersError) as error:
        return _fail(error)
    except Stopped as error:
        _fail(f"{error}; completed runs are kept in {folder}; repeat the command to continue")
        return SweepExitCode.STOPPED
    except KeyboardInterrupt:
        _fail(f"interrupted; completed runs are kept in {folder}; repeat the command to continue")
        return SweepExitCode.INTERRUPTED
    try:
        table = store.table()
        numbers = summary(plan, table)
        text = json.dumps(numbers, indent=2)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
        if options.csv:
            write_csv(table, folder / "results.csv")
    finally:
        store.close()
    print(text if options.json else as_text(numbers))
    took = time.monotonic() - begin
    print(f"\n{took:.1f} s; results in {folder}", file=sys.stderr)
    return SweepExitCode.DONE


def _outline(plan: SweepPlan) -> str:
    event = plan.rare_event
    extent = f"{plan.count} runs = {plan.points} points of the grid x {plan.runs_per_point}"
    if event is not None:
        extent = f"probability of {event} from at most {event.max_runs} runs by {event.method}"
    lines = [f"{plan.name}: {extent}, seed {plan.seed}, experiment {plan.content['experiment']}"]
    lines += [f"  {axis.name}: {len(axis.points)} values" for axis in plan.axes]
    lines += [f"  {draw.path}: random" for draw in plan.draws]
    first = plan.run(0)
    values = yaml.safe_dump(dict(first.overrides), default_flow_style=True, width=10_000).strip()
    lines.append(f"  first run: {first.scenario} with {values}")
    return "\n".join(lines)


def _fail(error: object) -> int:
    print(f"mother_rover sweep: {error}", file=sys.stderr)
    return SweepExitCode.REFUSED
