"""Parse and dispatch `mother_rover SUBCOMMAND ...`.

The parser knows the whole tree of subcommands, but only the arguments of the subcommand that the
words select, so that `--help` and shell completion import nothing else.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from importlib import metadata
from types import ModuleType
from typing import Any, NoReturn

import argcomplete

from msg_schemas.regular_files import file_problem
from rover_cli.subcommands import GROUPS, SUBCOMMANDS, Subcommand, find_subcommand
from rover_runtime.ros.arguments import split_ros_arguments

PROGRAM = "mother_rover"
USAGE_ERROR = MISSING_LIBRARY = 2
"""Exit code where the command cannot do its work: arguments, files or installation."""
OUTPUT_CLOSED = 141
"""Exit code where the reader of the output ends first, as for a process that SIGPIPE ends."""

_EPILOG = """`mother_rover SUBCOMMAND --help` lists arguments and exit codes. Operators use `rover`.
Shell completion: eval "$(register-python-argcomplete mother_rover rover)"
"""


class Parser(argparse.ArgumentParser):
    """A parser that accepts no abbreviations and reports an error in one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """End the process with exit code 2."""
        self.exit(USAGE_ERROR, f"{self.prog}: {message} (see {self.prog} --help)\n")


def make_parser(
    selected: Subcommand | None = None, module: ModuleType | None = None
) -> argparse.ArgumentParser:
    """Return the parser of the whole tree, with the arguments of the selected subcommand.

    Args:
        selected: the subcommand, None for the tree alone.
        module: the module that implements it.
    """
    parser = Parser(
        prog=PROGRAM,
        description="Simulate, test and analyse a tethered rover and its mother machine.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {_version()}")
    levels: dict[tuple[str, ...], argparse._SubParsersAction[Parser]] = {
        (): parser.add_subparsers(metavar="SUBCOMMAND", required=True)
    }
    for group, summary in GROUPS.items():
        own = levels[group[:-1]].add_parser(group[-1], help=summary, description=_sentence(summary))
        levels[group] = own.add_subparsers(metavar="SUBCOMMAND", required=True)
    for subcommand in SUBCOMMANDS:
        group, name = subcommand.path[:-1], subcommand.path[-1]
        leaf = levels[group].add_parser(
            name, help=subcommand.summary, description=_sentence(subcommand.summary)
        )
        if subcommand is selected and module is not None:
            leaf.set_defaults(usage_error=leaf.error)
            module.add_arguments(leaf)
    return parser


def _sentence(summary: str) -> str:
    return f"{summary[0].upper()}{summary[1:]}."


def _version() -> str:
    try:
        return metadata.version(PROGRAM)
    except metadata.PackageNotFoundError:
        return "(not installed)"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the subcommand that the arguments select; return its exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    selected = find_subcommand(_words_to_complete() or words)
    module = None
    if selected is not None:
        try:
            module = importlib.import_module(selected.module)
        except ModuleNotFoundError as error:
            name = " ".join((PROGRAM, *selected.path))
            print(f"{name}: install the Python library {error.name} first", file=sys.stderr)
            return MISSING_LIBRARY
    parser = make_parser(selected, module)
    argcomplete.autocomplete(parser)
    ros: list[str] = []
    if selected is not None and selected.is_node:
        words, ros = split_ros_arguments(words)
    if module is not None and hasattr(module, "normalize_arguments"):
        words = module.normalize_arguments(words)
    options, unknown = parser.parse_known_args(words, argparse.Namespace(ros_arguments=ros))
    if unknown:
        options.usage_error(f"unrecognized arguments: {' '.join(unknown)}")
    assert module is not None, "the parser requires a subcommand"
    assert selected is not None
    try:
        code: int = module.run(options)
    except BrokenPipeError:
        # The reader of the output has ended; nothing is left to flush at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OUTPUT_CLOSED
    except OSError as error:
        name = " ".join((PROGRAM, *selected.path))
        print(f"{name}: {file_problem(error)}", file=sys.stderr)
        return USAGE_ERROR
    return code


def _words_to_complete() -> list[str]:
    """Return the words before the cursor, without the program, while the shell completes."""
    if "_ARGCOMPLETE" not in os.environ:
        return []
    line = os.environ.get("COMP_LINE", "")
    return line[: int(os.environ.get("COMP_POINT", len(line)))].split()[1:]
