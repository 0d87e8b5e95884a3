"""Parse and dispatch `mother_rover SUBCOMMAND ...`.

The parser knows the whole tree of subcommands, but only the arguments of the subcommand that the
words select, so that `--help` and shell completion import nothing else.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from importlib import metadata
from types import ModuleType
from typing import Any, NoReturn

import argcomplete

from msg_schemas.regular_files import file_problem
from rover_cli.subcommands import GROUPS, SUBCOMMANDS, Subcommand, find_subcommand
from rover_runtime.ros.arguments import split_ros_arguments
from rover_runtime.single_threaded import SINGLE_THREADED
from rover_runtime.stop_signals import stop_signals
from rover_runtime.text_output import discard, escape_unencodable

PROGRAM = "mother_rover"
USAGE_ERROR = MISSING_LIBRARY = 2
"""Exit code where the command cannot do its work: arguments, files or installation."""
STOPPED = 130
"""Exit code where a signal ends the command."""
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
    for variable, value in SINGLE_THREADED.items():
        os.environ.setdefault(variable, value)  # before a subcommand imports numpy
    escape_unencodable()
    words = list(sys.argv[1:] if arguments is None else arguments)
    selected = find_subcommand(_words_to_complete() or words)
    name = " ".join((PROGRAM, *(() if selected is None else selected.path)))
    try:
        with _interrupted_by_signals():
            return _run(words, selected)
    except KeyboardInterrupt as stop:
        print(f"\n{name}: stopped by {stop}", file=sys.stderr)
        return STOPPED
    except BrokenPipeError:
        discard(sys.stdout)
        return OUTPUT_CLOSED
    except OSError as error:
        print(f"{name}: {file_problem(error)}", file=sys.stderr)
        return USAGE_ERROR


def _run(words: Sequence[str], selected: Subcommand | None) -> int:
    """Parse the words and run the selected subcommand; return its exit code."""
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
    code: int = module.run(options)
    return code


@contextlib.contextmanager
def _interrupted_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt with the name of the first signal that asks to stop.

    Later ones are ignored while the command cleans up. A node installs handlers of its own.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _frame: object) -> None:
        for each in before:
            signal.signal(each, _ignore)
        raise KeyboardInterrupt(signal.Signals(number).name)

    before = {number: signal.getsignal(number) for number in stop_signals()}
    for each in before:
        signal.signal(each, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) in {stop, _ignore}:  # a node's handlers stay to its end
                signal.signal(number, handler)


def _ignore(_number: int, _frame: object) -> None:
    """Handle a repeated signal."""


def _words_to_complete() -> list[str]:
    """Return the words before the cursor, without the program, while the shell completes."""
    if "_ARGCOMPLETE" not in os.environ:
        return []
    line = os.environ.get("COMP_LINE", "")
    return line[: int(os.environ.get("COMP_POINT", len(line)))].split()[1:]
