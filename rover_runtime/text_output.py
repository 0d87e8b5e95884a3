"""The output of programs: its reader may end, its disk be full, its encoding lack characters."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
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
