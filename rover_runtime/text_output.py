"""The output of programs: its reader may end, its disk be full, its encoding lack characters."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Collection, Sequence
from typing import TextIO


def escape_unencodable() -> None:
    """Let characters that the encoding of the standard output lacks be escaped."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def discard(stream: TextIO) -> None:
    """Discard what is printed on a stream from here on, and what could not be written."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def write_or_discard(write: Callable[[], object], stream: TextIO) -> OSError | None:
    """Write to a stream; on a failure discard what follows too, and return the failure."""
    try:
        write()
    except OSError as error:
        discard(stream)
        return error
    return None


def print_or_discard(text: str, stream: TextIO) -> OSError | None:
    """Print a line as ``write_or_discard`` does."""
    return write_or_discard(lambda: print(text, file=stream, flush=True), stream)


def text_table(rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> list[str]:
    """Return the lines of a table for a terminal.

    Args:
        rows: Cells of each row, as many in every row.
        left: Indices of the columns that are aligned to the left.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if column in left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines
