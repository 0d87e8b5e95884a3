"""Read CSV files: cells by line, and numbers as spreadsheets and instruments write them."""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path
from typing import Final, TypeAlias

from msg_schemas.regular_files import LARGEST_TEXT, read_text

Row: TypeAlias = tuple[int, list[str]]
"""Line of a row in its file, and its cells."""

_OTHER_SEPARATORS: Final = ";\t|"
_MARK: Final = "\ufeff"
"""Byte order mark, with which spreadsheets begin a file."""
_NUMBER: Final = re.compile(
    r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?\s*", re.ASCII
)


class CsvError(ValueError):
    """A file that is no CSV table: file, line, and what would be right."""


def read_rows(path: Path, largest: int = LARGEST_TEXT) -> list[Row]:
    """Read the rows of a CSV file, first its header; empty lines are left out.

    Args:
        path: of the file.
        largest: size that is read [byte].

    Raises:
        CsvError: the file cannot be read as text, its cells are not separated by commas, or two
            columns have one name.
    """
    try:
        text = read_text(path, largest).removeprefix(_MARK)
    except OSError as error:
        raise CsvError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise CsvError(f"{path}: byte {error.start + 1} is no UTF-8; save it as UTF-8") from None
    reader = csv.reader(io.StringIO(text, newline=""))
    rows: list[Row] = []
    try:
        rows.extend((reader.line_num, cells) for cells in reader if cells)
    except csv.Error as error:
        raise CsvError(f"{path}, line {reader.line_num}: {error}") from None
    if rows:
        _check_header(path, *rows[0])
    return rows


def _check_header(path: Path, line: int, cells: list[str]) -> None:
    for separator in _OTHER_SEPARATORS:
        if len(cells) == 1 and separator in cells[0]:
            raise CsvError(
                f"{path}, line {line}: the cells are separated by {separator!r}: should be by ',', "
                "with '.' in numbers"
            )
    names = [cell.strip() for cell in cells]
    for name in names:
        if names.count(name) > 1:
            raise CsvError(f"{path}, line {line}: the column {name!r:.60} stands twice")


def number_of(cell: str) -> float:
    """Return the decimal number in a cell; NaN if it holds something else."""
    return float(cell) if _NUMBER.fullmatch(cell) else math.nan
