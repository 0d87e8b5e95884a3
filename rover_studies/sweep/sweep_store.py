"""Folder of a sweep, with crash-safe storage of completed runs.

While a sweep runs, each batch of rows becomes a Parquet file below ``parts/``. It is written under
another name, synchronised to the disk and then renamed, so it is complete or absent. Rows are
identified by the number of their run, so a sweep that was killed continues with the missing runs.
At the end the parts are merged to ``results.parquet`` in the order of the runs.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Final

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from msg_schemas.regular_files import writing_problem
from rover_studies.sweep.experiments import Value
from rover_studies.sweep.sweep_plan import SweepPlan

PLAN_FILE: Final = "plan.json"
RESULTS_FILE: Final = "results.parquet"
PARTS_FOLDER: Final = "parts"
_LOCK_FILE: Final = ".lock"
_UNFINISHED: Final = ".unfinished"
_KINDS: Final[Mapping[type, Any]] = {
    float: pa.float64(),
    int: pa.int64(),
    str: pa.string(),
    bool: pa.bool_(),
}
_UNITS: Final = frozenset({"m", "rad", "s", "N", "J"})
STATUS: Final = "status"
REASON: Final = "reason"


class StoreError(OSError):
    """A folder that cannot hold or continue a sweep; the message has the reason and the remedy."""


def schema_of(plan: SweepPlan) -> Any:
    """Return the columns of the results: number, seed, parameters, status, reason, results."""
    fields = [pa.field("run", pa.int64()), pa.field("seed", pa.int64())]
    fields += [pa.field(path, _KINDS[_kind_of(plan, path)]) for path in plan.parameters]
    fields += [pa.field(STATUS, pa.string()), pa.field(REASON, pa.string())]
    fields += [
        pa.field(name, _KINDS[kind], metadata=_unit_of(name, kind))
        for name, kind in plan.experiment.columns.items()
    ]
    return pa.schema(fields, metadata={"plan": json.dumps(plan.content)})


def _unit_of(column: str, kind: type) -> dict[str, str] | None:
    """Return the metadata of a result: the unit that its name ends with, or that it has none."""
    if kind is not float:
        return None
    unit = column.rpartition("_")[2]
    return {"unit": unit if unit in _UNITS else "-"}


def _kind_of(plan: SweepPlan, path: str) -> type:
    """Return the type of a parameter's column: the common type of its values, else text."""
    draw = next((draw for draw in plan.draws if draw.path == path), None)
    if draw is not None and draw.kind != "choice":
        return int if draw.kind == "integers" and not draw.factor else float
    values = draw.numbers if draw is not None else plan.values_of(path)
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return float
    return next(iter(kinds)) if len(kinds) == 1 and kinds <= set(_KINDS) else str


class SweepStore:
    """A sweep's folder, locked by one process at a time.

    Args:
        folder: created if it does not exist.
        plan: of the sweep.
        version: of the package; a sweep has results of one version only.

    Raises:
        StoreError: the folder holds another sweep or something else, or is in use.
    """

    def __init__(self, folder: Path, plan: SweepPlan, version: str) -> None:
        self.folder = folder
        self._plan = plan
        self._count = plan.count
        self._schema = schema_of(plan)
        self._parts = folder / PARTS_FOLDER
        self._lock = self._locked()
        try:
            self._check_plan(version)
            self._done = self._read_completed()
        except BaseException:
            self.close()
            raise

    # --- the folder ------------------------------------------------------------------------------

    def _locked(self) -> IO[str]:
        try:
            fresh = not self.folder.exists() or not any(self.folder.iterdir())
            if not fresh and not (self.folder / PLAN_FILE).exists():
                raise StoreError(f"{self.folder} is not empty and has no sweep; use another folder")
            self._parts.mkdir(parents=True, exist_ok=True)
            lock = (self.folder / _LOCK_FILE).open("w", encoding="utf-8")
        except OSError as error:
            if isinstance(error, StoreError):
                raise
            raise StoreError(writing_problem(error, self.folder)) from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            lock.close()
            raise StoreError(f"another process is running the sweep in {self.folder}") from error
        return lock

    def _check_plan(self, version: str) -> None:
        file = self.folder / PLAN_FILE
        mine = {"package_version": version, "plan": dict(self._plan.content)}
        if not file.exists():
            _write_whole(file, json.dumps(mine, indent=2).encode())
            return
        try:
            theirs = json.loads(file.read_text(encoding="utf-8"))
            known = dict(theirs["plan"])
        except (ValueError, KeyError, TypeError) as error:
            raise StoreError(f"{file} is not a plan of a sweep; use another folder") from error
        # Compare after a JSON round trip, which converts tuples to lists.
        own = json.loads(json.dumps(mine["plan"]))
        differing = sorted(key for key in {*known, *own} if known.get(key) != own.get(key))
        if differing:
            raise StoreError(
                f"{self.folder} has a sweep of another plan: {', '.join(differing)} "
                "differ; use another folder, or remove this one"
            )
        if theirs.get("package_version") != version:
            raise StoreError(
                f"{self.folder} was started with version {theirs.get('package_version')} of the "
                f"package, this is {version}; use another folder, or remove this one"
            )

    def _read_completed(self) -> set[int]:
        for rest in [*self._parts.glob(f"*{_UNFINISHED}"), *self.folder.glob(f"*{_UNFINISHED}")]:
            rest.unlink()
        if (self.folder / RESULTS_FILE).exists():
            whole = read_results(self.folder)
            self._remove_parts()
            return set(range(whole.num_rows))
        done: set[int] = set()
        for part in self._part_files():
            try:
                # Whole, as damage may be in any column.
                table = _read(part)
                is_sound = table.schema == self._schema
            except (OSError, pa.ArrowException):
                is_sound = False
            if is_sound:
                done.update(table.column("run").to_pylist())
            else:
                # Its runs are repeated.
                part.rename(part.with_suffix(".damaged"))
        return done

    def _part_files(self) -> list[Path]:
        return sorted(self._parts.glob("*.parquet"))

    def _remove_parts(self) -> None:
        for part in self._part_files():
            part.unlink()
        with contextlib.suppress(OSError):
            self._parts.rmdir()

    # --- rows ------------------------------------------------------------------------------------

    @property
    def done(self) -> int:
        """Number of completed runs."""
        return len(self._done)

    @property
    def finished(self) -> bool:
        """Whether all runs are complete and merged to one file."""
        return (self.folder / RESULTS_FILE).exists()

    def extend(self, plan: SweepPlan) -> None:
        """Expect the runs of a plan that has more rounds."""
        self._count = plan.count

    def missing(self) -> Iterator[int]:
        """Return the numbers of the missing runs, ascending."""
        return (number for number in range(self._count) if number not in self._done)

    def add(self, rows: Sequence[Mapping[str, Value]]) -> None:
        """Store the rows of a batch.

        Raises:
            StoreError: writing failed.
        """
        numbers = {int(str(row["run"])) for row in rows}
        if numbers & self._done:
            raise AssertionError(f"runs {sorted(numbers & self._done)[:5]} are done already")
        table = pa.Table.from_pylist([self._fitting(row) for row in rows], schema=self._schema)
        self._write(table, self._parts / f"{min(numbers):09d}_{len(numbers)}.parquet")
        self._done |= numbers

    def _fitting(self, row: Mapping[str, Value]) -> dict[str, Value]:
        """Convert the values of a row to the types of the columns."""
        fitting = {}
        for field in self._schema:
            value = row[field.name]
            if value is not None and field.type == pa.string() and not isinstance(value, str):
                value = json.dumps(value)
            fitting[field.name] = value
        return fitting

    def finish(self) -> Path:
        """Merge the parts to one file in the order of the runs; returns its path."""
        target = self.folder / RESULTS_FILE
        if target.exists():
            return target
        if self.done != self._count:
            raise AssertionError(f"{self.done} of {self._count} runs are done")
        table = pa.concat_tables(_read(part) for part in self._part_files()).sort_by("run")
        if table.column("run").to_pylist() != list(range(self._count)):
            raise StoreError(
                f"{self._parts} has duplicate runs; remove {self.folder} and start again"
            )
        self._write(table, target)
        self._remove_parts()
        return target

    def table(self) -> Any:
        """Return the present results as a pyarrow table, in the order of the runs."""
        if self.finished:
            return read_results(self.folder)
        parts = [_read(part) for part in self._part_files()]
        whole = pa.concat_tables(parts) if parts else self._schema.empty_table()
        return whole.sort_by("run")

    def _write(self, table: Any, target: Path) -> None:
        unfinished = target.with_name(target.name + _UNFINISHED)
        try:
            pq.write_table(table, unfinished, compression="zstd", write_page_checksum=True)
            _commit(unfinished, target)
        except OSError as error:
            unfinished.unlink(missing_ok=True)
            raise StoreError(
                f"cannot write {target}: {error.strerror or error}; completed runs are kept; free "
                "disk space and repeat the command"
            ) from error

    def close(self) -> None:
        """Unlock the folder."""
        self._lock.close()


def _read(path: Path) -> Any:
    return pq.read_table(path, page_checksum_verification=True)


def _commit(unfinished: Path, target: Path) -> None:
    with unfinished.open("rb") as stream:
        os.fsync(stream.fileno())
    unfinished.replace(target)
    folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _write_whole(target: Path, content: bytes) -> None:
    unfinished = target.with_name(target.name + _UNFINISHED)
    unfinished.write_bytes(content)
    _commit(unfinished, target)


def read_results(folder: Path) -> Any:
    """Return the results of a finished sweep as a pyarrow table.

    Raises:
        StoreError: the sweep is not finished, or the file is damaged.
    """
    try:
        return _read(folder / RESULTS_FILE)
    except FileNotFoundError as error:
        raise StoreError(f"{folder} has no finished sweep ({RESULTS_FILE})") from error
    except (OSError, pa.ArrowException) as error:
        raise StoreError(
            f"{folder / RESULTS_FILE} is damaged: {error}; remove it and repeat the command"
        ) from error


def write_csv(table: Any, path: Path) -> None:
    """Write a table of results as CSV."""
    pyarrow.csv.write_csv(table, path)
