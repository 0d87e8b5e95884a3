"""`mother_rover verify`: measure every requirement that has a check, and report all of them.

Results are stored as they come: the same command resumes a stopped run, as long as runs, seed and
source code are the same. Checks with many long runs store each run.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import importlib
import inspect
import json
import math
import os
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import yaml
from tqdm import tqdm

from msg_schemas.number_arguments import finite_number, positive, seed
from msg_schemas.regular_files import writing_problem
from rover_launch.parameter_files import config_folder
from rover_verify.checks import CheckBatch, Measured, NotPossible, SetsNotGiven
from rover_verify.checks.suite_tests import run_tests
from rover_verify.requirements import matrix_page
from rover_verify.requirements.requirements import CHECKS_PACKAGE, Requirement, load_requirements

_ROOT = Path(__file__).resolve().parents[2]
# All packages, and the tests of a source tree: each may change a result.
SOURCES = (
    "msg_schemas", "operator_console", "rover_actions", "rover_bags", "rover_cli", "rover_control",
    "rover_estimation", "rover_hil", "rover_launch", "rover_runtime", "rover_sim", "rover_studies",
    "rover_validation", "rover_verify", "rover_view", "test", "tether_winch",
)  # fmt: skip
SETS_VARIABLE = "MOTHER_ROVER_SETS"
"""Environment variable that names the folder of measured sets."""
_OPEN_RUNS = 2
"""Runs of an open row that is not named on the command line."""


@dataclass(frozen=True)
class RowResult:
    """The result of one requirement.

    Attributes:
        state: PASS, FAIL, ERROR (the check raised), NOT RUN (not possible here), OPEN.
        measured: measured value, or None.
        passed: whether the value is within the limit.
        seconds: duration of the check.
        note: explanation of the value, or the reason why there is none.
        details: further values.
    """

    state: str
    measured: float | None
    passed: bool
    seconds: float = 0.0
    note: str = ""
    details: Mapping[str, float | str] | None = None


def find_check(name: str) -> Callable[[CheckBatch], Measured]:
    """Return the check named ``module.function`` or ``module.function(argument, ...)``.

    Raises:
        LookupError: there is no such function, or it takes other arguments.
    """
    path, _, given = name.removesuffix(")").partition("(")
    module_name, _, function = path.partition(".")
    arguments = yaml.safe_load(f"[{given}]")
    try:
        module = importlib.import_module(f"{CHECKS_PACKAGE}.{module_name}")
        check: Callable[..., Measured] = getattr(module, function)
        inspect.signature(check).bind(None, *arguments)
    except (ModuleNotFoundError, AttributeError, TypeError) as error:
        raise LookupError(f"there is no check {name}: {error}") from error
    return functools.wraps(check)(lambda batch: check(batch, *arguments))


def measure(row: Requirement, batch: CheckBatch) -> RowResult:
    """Run the check of a row, or its tests, and compare the value with the limit."""
    if not row.is_verified:
        return RowResult("OPEN", None, passed=False, note="no check exists yet")
    began = time.monotonic()
    try:
        measured = (
            find_check(row.check)(batch)
            if row.check is not None
            else run_tests(row.tests, batch, row.quantity, row.limit.worst)
        )
    except SetsNotGiven as reason:
        return RowResult("OPEN", None, passed=False, note=str(reason))
    except NotPossible as reason:
        return RowResult("NOT RUN", None, passed=False, note=str(reason))
    except Exception as error:  # noqa: BLE001 - one broken check must not hide the others
        trace = "".join(traceback.format_exception(error))
        (batch.folder / "error.txt").write_text(trace, encoding="utf-8")
        note = f"{type(error).__name__}: {str(error).strip()[:300]}"
        return RowResult("ERROR", None, passed=False, seconds=time.monotonic() - began, note=note)
    value = float(measured.value)
    passed = bool(row.limit.holds(value))
    state = "PASS" if passed else "FAIL"
    if row.status == "open":
        state = "OPEN"
    details = {
        name: detail if isinstance(detail, str) else float(detail)
        for name, detail in measured.details.items()
    }
    seconds = time.monotonic() - began
    if not math.isfinite(value):
        note = f"measured {value}; {measured.note}"
        state = "OPEN" if row.status == "open" else "FAIL"
        return RowResult(state, None, passed=False, seconds=seconds, note=note, details=details)
    return RowResult(state, value, passed, seconds, measured.note, details)


class Store:
    """Results on disk, one file per row, valid for one combination of runs, seed and source.

    Only named open rows are measured with all runs. Results of one folder of measured sets are not
    those of another.
    """

    def __init__(self, batch: CheckBatch, source: str, named: Collection[str] = ()) -> None:
        self._folder = batch.folder
        self._named = named
        self._key = {
            "runs": batch.runs,
            "seed": batch.seed,
            "source": source,
            "sets": str(batch.sets),
            "hours": batch.hours,
        }
        self._folder.mkdir(parents=True, exist_ok=True)

    def get(self, row: Requirement) -> RowResult | None:
        """Return the stored result of a row under the same conditions, or None if it failed."""
        try:
            content = json.loads(self._path(row).read_text(encoding="utf-8"))
        except (FileNotFoundError, json.JSONDecodeError):
            return None
        if content.get("key") != self._key_of(row) or content["result"]["measured"] is None:
            return None
        result = RowResult(**content["result"])
        return None if result.state == "FAIL" else result

    def put(self, row: Requirement, result: RowResult) -> None:
        """Store a result atomically."""
        content = {"key": self._key_of(row), "result": asdict(result)}
        partial = self._path(row).with_suffix(".partial")
        partial.write_text(json.dumps(content, indent=1), encoding="utf-8")
        partial.replace(self._path(row))

    def _key_of(self, row: Requirement) -> dict[str, object]:
        named = row.id in self._named
        limit = str(row.limit)
        verified_by = {"check": row.check, "tests": list(row.tests), "quantity": row.quantity}
        return {**self._key, **verified_by, "limit": limit, "status": row.status, "named": named}

    def _path(self, row: Requirement) -> Path:
        return self._folder / f"{row.id}.json"


def source_digest() -> str:
    """Return a digest of the suite's source code, tests and shipped parameters."""
    digest = hashlib.sha256()
    for folder in (*(_ROOT / name for name in SOURCES), config_folder()):
        for path in sorted(folder.rglob("*")):
            is_source = path.is_file() and "__pycache__" not in path.parts
            if is_source and path.name != "requirements.yaml":
                digest.update(str(path.relative_to(folder.parent)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def verify(
    rows: Sequence[Requirement],
    batch: CheckBatch,
    *,
    fresh: bool = False,
    quiet: bool = False,
    named: Collection[str] = (),
) -> list[RowResult]:
    """Measure the rows in their order; stored results are reused unless `fresh`.

    Args:
        rows: rows that need measured sets are open without a folder of such.
        batch: how they are measured; its folder is that of the results.
        fresh: whether stored results are discarded.
        quiet: no progress bar.
        named: open rows with these identifiers are measured with all runs, others with few.
    """
    source = source_digest()
    folder = batch.folder / "verification"
    store = Store(replace(batch, folder=folder / "results"), source, named)
    keep = (folder / "kept" / source).resolve()
    if fresh:
        shutil.rmtree(keep, ignore_errors=True)
    results: list[RowResult] = []
    with tqdm(total=len(rows), disable=quiet, unit="row", dynamic_ncols=True, leave=False) as bar:
        for row in rows:
            bar.set_description(row.id)
            kept = None if fresh else store.get(row)
            is_short = row.status == "open" and row.id not in named
            count = min(batch.runs, _OPEN_RUNS) if is_short else batch.runs
            own = replace(batch, runs=count, kept=keep, folder=folder / "scratch" / row.id)
            result = kept if kept is not None else _measure_row(row, own, bar)
            if kept is None and row.is_verified:
                store.put(row, result)
            results.append(result)
            if row.is_verified:
                bar.write(_line(row, result, kept=kept is not None), file=sys.stdout)
                sys.stdout.flush()
            bar.update()
    return results


def _measure_row(row: Requirement, batch: CheckBatch, bar: Any) -> RowResult:
    folder = batch.folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)

    def progress(done: int, total: int) -> None:
        bar.set_postfix_str(f"{done}/{total}", refresh=False)
        bar.refresh()

    result = measure(row, replace(batch, folder=folder.resolve(), progress=progress))
    bar.set_postfix_str("")
    if result.state in {"PASS", "OPEN"}:
        shutil.rmtree(folder, ignore_errors=True)
    return result


def _line(row: Requirement, result: RowResult, *, kept: bool) -> str:
    value = "-" if result.measured is None else f"{result.measured:.6g} {row.limit.unit}"
    time_taken = "kept" if kept else f"{result.seconds:.1f} s"
    return (
        f"{result.state:8}{row.id:22}{value:>18}   required {row.limit!s:<16} {time_taken:>8}  "
        f"{result.note}"
    )


def report(rows: Sequence[Requirement], results: Sequence[RowResult]) -> list[dict[str, object]]:
    """Return rows and results as plain values for verification.json."""
    return [
        {
            "id": row.id,
            "area": row.area,
            "statement": row.statement,
            "required": str(row.limit),
            "measured": result.measured,
            "unit": row.limit.unit,
            "pass": result.passed,
            "state": result.state,
            "status": row.status,
            "milestone": row.milestone,
            "method": row.method,
            "command": row.command,
            "seconds": round(result.seconds, 3),
            "note": result.note or row.note,
            "details": dict(result.details or {}),
        }
        for row, result in zip(rows, results, strict=True)
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Measure every requirement that has a check and report all of them. Results are stored "
        "as they come: the same command resumes a stopped run while runs, seed and source are the "
        "same."
    )
    parser.epilog = (
        "Exit codes: 0 every required row passed, 1 one failed or its check broke, 130 interrupted."
    )
    parser.add_argument(
        "--runs", type=positive, default=20, metavar="N",
        help="random runs of each batch (default: %(default)d; open requirements: 2 unless named)",
    )  # fmt: skip
    add = parser.add_argument
    add("--seed", type=seed, default=1, metavar="N", help="random seed (default: %(default)d)")
    add("--only", nargs="+", action="extend", metavar="ID", help="only rows that begin with ID")
    add("--list", action="store_true", help="list the requirements and end")
    add(
        "--hours",
        type=finite_number(0.01, 1000.0),
        default=1.0,
        metavar="H",
        help="simulated time of the missions flown for endurance (default: %(default)g)",
    )
    add("--sets", type=Path, default=os.environ.get(SETS_VARIABLE) or None, metavar="DIR",
        help="folder of measured sets, as `validate summary` reads it (default: the environment's "
             f"{SETS_VARIABLE}; rows that need it are open without)")  # fmt: skip
    add("--fresh", action="store_true", help="discard kept results and measure again")
    add("--out", type=Path, default=Path("out"), metavar="DIR",
        help="folder of the results (default: %(default)s)")  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Verify; return 1 if a required row failed or its check raised an error."""
    rows = load_requirements()
    if options.only:
        rows = [row for row in rows if any(row.id.startswith(name) for name in options.only)]
        if not rows:
            options.usage_error(
                f"--only: no requirement begins with {' or '.join(options.only)}; see --list"
            )
    if options.list:
        for row in rows:
            print(f"{row.id:22}{row.status:10}{row.limit!s:20}{row.statement}")
        return 0
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        options.usage_error(f"--out: {writing_problem(error, options.out)}")
    # Restrict discovery to this machine, and check message types.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    try:
        sets = None if options.sets is None else options.sets.resolve()
        results = verify(
            rows,
            CheckBatch(options.runs, options.seed, options.out, sets=sets, hours=options.hours),
            fresh=options.fresh,
            quiet=not sys.stderr.isatty(),
            named=options.only or (),
        )
    except KeyboardInterrupt:
        print("\nstopped; repeat the command to continue", file=sys.stderr)
        return 130
    content = report(rows, results)
    path = options.out / "verification.json"
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    html = options.out / "verification.html"
    html.write_text(matrix_page.render(content, options.runs, options.seed), encoding="utf-8")
    counts = {
        state: sum(result.state == state for result in results) for state in matrix_page.STATES
    }
    print(", ".join(f"{count} {state}" for state, count in counts.items() if count))
    print(f"Written: {path}, {html}")
    return 1 if counts["FAIL"] or counts["ERROR"] else 0
