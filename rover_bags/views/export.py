"""``mother_rover bag export``: the messages of a bag as Parquet or CSV, a file for each topic."""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import shutil
from collections.abc import Collection
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from msg_schemas.regular_files import writing_problem
from msg_schemas.table import CONTRACT_VERSION, TOPICS
from rover_bags.files.store import BagError
from rover_bags.reading.read import NOT_SERIES, Bag, Progress, TimeSeries, portions, read_bag
from rover_bags.views.bag_analysis import MAX_MESSAGES
from rover_bags.views.report import ProgressBars, ReportExitCode, beside, complain, refused

UNITS_FILE: Final = "units.json"
"""Beside CSV files: unit by topic and column."""
_PORTION: Final = 20_000  # messages of a topic in memory
_TEXT_COLUMNS: Final = frozenset({"name", "level", "hardware_id", "message", "values", "text"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add bag, topics, format and folder."""
    parser.description = (
        "Write the valid messages of a bag as tables, a file for each topic: their times, then the "
        "values by the contract's field paths. Each column of a Parquet file has its unit in the "
        f"metadata; CSV files have {UNITS_FILE} beside them."
    )
    parser.epilog = (
        "Exit codes: 0 written, 2 no readable bag or nothing to export, 3 the files cannot be "
        "written."
    )
    parser.add_argument("bag", type=Path, help="folder of the bag, or one of its files")
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help="contract topics (default: all)")
    parser.add_argument(
        "--format", choices=("parquet", "csv"), default="parquet", help="(default: parquet)"
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="FOLDER", help="new folder (default: BAG_export)"
    )
    parser.add_argument("--namespace", help="rover to export, if the bag holds several")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`ReportExitCode`."""
    path: Path = options.bag
    try:
        requested = _requested(options.topics)
        with ProgressBars(quiet=options.quiet) as bars:
            bag = read_bag(
                path,
                requested,
                namespace=options.namespace,
                max_messages=MAX_MESSAGES,
                progress=bars(path, "columns"),
            )
    except (BagError, ValueError) as error:
        return refused("export", error)
    absent = sorted(requested - bag.time_series.keys()) if options.topics else []
    if absent or not bag.time_series:
        what = ", ".join(absent) or "a topic that can be exported"
        complain("export", f"{path} holds no valid message of {what}")
    if not bag.time_series:
        return ReportExitCode.REFUSED
    folder, is_csv = options.out or beside(path, "_export"), options.format == "csv"
    try:
        with ProgressBars(quiet=options.quiet) as bars:
            written = export(bag, folder, csv=is_csv, progress=bars(path, "export"))
    except OSError as error:
        complain("export", writing_problem(error, folder))
        return ReportExitCode.NOT_WRITTEN
    for file, rows in written.items():
        print(f"{rows:9d} rows  {file}")
    rejected = sum(bag.rejected.values())
    if rejected or bag.damage:
        text = f"left out: {rejected} invalid messages, {len(bag.damage)} damaged parts of the bag"
        complain("export", f"{text}; `bag report` lists them")
    return ReportExitCode.OK


def _requested(names: Collection[str]) -> set[str]:
    """Contract topics by their names, with or without a leading slash.

    Raises:
        ValueError: there is no such topic.
    """
    by_name = {name.strip("/"): name for name in TOPICS}
    unknown = sorted({name.strip("/") for name in names} - by_name.keys())
    if unknown:
        msg = f"{', '.join(unknown)}: no topic of the contract; docs/contract.md lists them"
        raise ValueError(msg)
    return {by_name[name.strip("/")] for name in names} or set(TOPICS) - NOT_SERIES


def export(
    bag: Bag, folder: Path, *, csv: bool = False, progress: Progress | None = None
) -> dict[Path, int]:
    """Write the time series of a bag as files, and return the number of rows of each.

    Args:
        bag: with the time series to write, thinned or not; they are read again in full.
        folder: new, or empty.
        csv: CSV files in place of Parquet.
        progress: called with the number of bytes read.

    Raises:
        OSError: the folder holds something, or a file cannot be written; none is left then.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise OSError(errno.ENOTEMPTY, "it holds files", str(folder))
    try:
        return _write_tables(bag, folder, csv=csv, progress=progress)
    except BaseException:
        for each in folder.iterdir():  # what is left by an unfinished export
            shutil.rmtree(each) if each.is_dir() else each.unlink()
        if is_new:
            folder.rmdir()
        raise


def _write_tables(
    bag: Bag, folder: Path, *, csv: bool, progress: Progress | None
) -> dict[Path, int]:
    written: dict[Path, int] = {}
    with contextlib.ExitStack() as stack:
        files: dict[str, tuple[Path, pa.Schema, Any]] = {}
        for name, series in bag.time_series.items():
            file = folder / f"{name.strip('/')}.{'csv' if csv else 'parquet'}"
            file.parent.mkdir(parents=True, exist_ok=True)
            schema = _schema(series, csv=csv)
            writer = pyarrow.csv.CSVWriter if csv else pq.ParquetWriter
            files[name] = file, schema, stack.enter_context(writer(file, schema))
            written[file] = 0
        for portion in portions(bag, bag.time_series, _PORTION, progress=progress):
            file, schema, writer = files[portion.topic]
            table = _table(portion, schema)
            writer.write_table(table)
            written[file] += table.num_rows
    if csv:
        units = {name: dict(series.units) for name, series in bag.time_series.items()}
        (folder / UNITS_FILE).write_text(json.dumps(units, indent=1))
    return written


def _schema(series: TimeSeries, *, csv: bool) -> pa.Schema:
    """Columns of a topic with their units; CSV has no lists, so the nodes of a tether are text."""
    units = series.units
    fields = []
    for name in series.table():
        if name.endswith("_ns"):
            kind = pa.int64()
        elif name in _TEXT_COLUMNS:
            kind = pa.string()
        elif name.startswith("nodes."):
            kind = pa.string() if csv else pa.list_(pa.float64())
        else:
            kind = pa.float64()
        unit = units.get(name)
        fields.append(pa.field(name, kind, metadata=None if unit is None else {"unit": unit}))
    about = {"topic": series.topic, "name": series.full_name, "contract": str(CONTRACT_VERSION)}
    return pa.schema(fields, metadata=about)


def _table(series: TimeSeries, schema: pa.Schema) -> pa.Table:
    """A portion as a table; a value that its messages lack is null."""
    columns = series.table()
    count = len(columns["time"])
    return pa.table(
        [
            pa.array(_texts(columns.get(each.name, [None] * count), each), each.type)
            for each in schema
        ],
        schema=schema,
    )


def _texts(values: Any, column: pa.Field) -> Any:
    """Numbers of a tether's nodes as text, where the column is text."""
    if column.name.startswith("nodes.") and column.type == pa.string():
        return [" ".join(map(str, shape.tolist())) for shape in values]
    return values
