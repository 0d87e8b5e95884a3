"""What the commands of the validation refuse, and with which messages."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Final, TypeAlias

from msg_schemas.csv_reader import CsvError, Row, read_rows

OK: Final = 0
REFUSED: Final = 2
LARGEST_SET: Final = 1 << 26
"""Size of the largest file of measurements [byte]."""

Command: TypeAlias = Callable[[argparse.Namespace], int]


class SetError(Exception):
    """A file that cannot be used: file, line or entry, value, and what would be right."""


def read_table(path: Path) -> list[Row]:
    """Read the rows of a CSV file of measurements, first its header.

    Raises:
        SetError: it is no such file.
    """
    try:
        return read_rows(path, LARGEST_SET)
    except CsvError as error:
        raise SetError(str(error)) from None


def check_target(target: Path, measured: Path) -> None:
    """Refuse to write predictions in place of what was measured.

    Raises:
        SetError: both paths are of one file or folder.
    """
    if target.resolve() == measured.resolve():
        raise SetError(f"--out is {measured}, which predictions would replace: give another path")


def refusing(command: str) -> Callable[[Command], Command]:
    """Let a command of `mother_rover validate` print what it refuses, and return `REFUSED`."""

    def decorate(run: Command) -> Command:
        @wraps(run)
        def refuse(options: argparse.Namespace) -> int:
            try:
                return run(options)
            except SetError as error:
                print(f"mother_rover validate {command}: {error}", file=sys.stderr)
                return REFUSED

        return refuse

    return decorate
