"""What the commands of the validation refuse, and how they say it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import wraps
from typing import Final, TypeAlias

OK: Final = 0
REFUSED: Final = 2
LARGEST_SET: Final = 1 << 26
"""Size of the largest file of measurements [byte]."""

Command: TypeAlias = Callable[[argparse.Namespace], int]


class SetError(Exception):
    """A file that cannot be used: file, line or entry, value, and what would be right."""


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
