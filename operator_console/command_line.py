"""The command `rover`: operators' commands at a terminal, without `ros2`."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

import argcomplete

from msg_schemas import topics
from msg_schemas.fields import FieldError
from msg_schemas.name_arguments import namespace
from msg_schemas.number_arguments import finite_number
from msg_schemas.regular_files import file_problem
from operator_console.commands import COMMANDS, MISSION, OperatorCommand, Order
from operator_console.exchange import Completion, OrderResult, OrderStatus, SentOrder
from rover_runtime.stop_signals import stop_signals
from rover_runtime.text_output import escape_unencodable, print_or_discard, write_or_discard

if TYPE_CHECKING:
    from rich.console import RenderableType

    from operator_console.operator_link import OperatorLink
    from operator_console.telemetry import Snapshot

_ROS_ARGUMENTS = "--ros-args"
_ANSWER_TIMEOUT = 10.0  # [s]
_STATE_TIMEOUT = 2.0  # for the state that is printed last [s]
_REST_TIMEOUT = 15.0  # [s]
_SHOW, _WATCH, _COMMANDS = "status", "watch", "commands"


class Exit(IntEnum):
    """Exit codes of `rover`."""

    DONE = 0
    CRASHED = 1
    BAD_ARGUMENTS = 2
    REFUSED = 3
    UNAVAILABLE = 4
    TIMED_OUT = 5
    NOT_DONE = 6
    INTERRUPTED = 130


_EXITS = {
    OrderStatus.ACCEPTED: Exit.DONE,
    OrderStatus.REFUSED: Exit.REFUSED,
    OrderStatus.UNAVAILABLE: Exit.UNAVAILABLE,
    OrderStatus.NO_ANSWER: Exit.TIMED_OUT,
    OrderStatus.CANCELLED: Exit.INTERRUPTED,
}

_EPILOG = """\
exit codes:
    0  accepted; with --wait: done
    1  crashed, or the output could not be written
    2  bad arguments; nothing was sent
    3  refused; the reason is printed
    4  no node available for the command
    5  no answer, or not done, within the timeout; the present state is printed
    6  accepted, but not done
  130  interrupted by a signal or the end of the output; the motion was stopped first

Ctrl-C, SIGTERM, a closed terminal or output that cannot be written while a command waits stops the
motion safely (hold; for a jump abort), prints the state and ends. A second Ctrl-C ends at once.
Without --wait the command ends when a node accepts it, and the machine continues.

Give ROS arguments last, after --ros-args. ROS_DOMAIN_ID selects the domain.
Shell completion: eval "$(register-python-argcomplete mother_rover rover)"
"""

_OUTPUTS = (1, 2)
_REPETITION = 0.5  # a signal within this time of the first is the same request [s]

_HINTS = {
    "not_armed": "run `rover arm` first",
    "unavailable": "`rover status` lists the nodes that run",
}


# --- arguments -----------------------------------------------------------------------------------


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} should be a number above 0 and below 1e6 s")
    return value


def _common() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    common.add_argument(
        "--namespace",
        type=namespace,
        metavar="NS",
        help="namespace of the machine, such as /mother1",
    )
    common.add_argument(
        "--timeout", type=_positive, metavar="S",
        help=f"longest wait for the answer [s] (default {_ANSWER_TIMEOUT:g}); with --wait also for "
        "the end (default: no limit)",
    )  # fmt: skip
    common.add_argument("--json", action="store_true", help="print JSON, one object per line")
    return common


def make_parser() -> argparse.ArgumentParser:
    """The parser, built from the table of commands."""
    common = _common()
    parser = argparse.ArgumentParser(
        prog="rover",
        description="Show and command the tethered rover and its mother machine.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=[common],
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    show = commands.add_parser(_SHOW, parents=[common], help="show the present state")
    show.description = (
        "Show the present state, or the state in a bag; stale values are marked with their age."
    )
    show.add_argument(
        "--bag", type=Path, metavar="DIR", help="show the state in a recorded bag; needs no node"
    )
    show.add_argument(
        "--at", type=finite_number(0.0, 1e10), default=math.inf, metavar="S",
        help="time in the bag [s] (default: its end)",
    )  # fmt: skip
    watch = commands.add_parser(_WATCH, parents=[common], help="show the state live until Ctrl-C")
    watch.description = "Show the state live; one line per period where the output is no terminal."
    watch.add_argument(
        "--period",
        type=_positive,
        default=1.0,
        metavar="S",
        help="time between updates [s] (default 1)",
    )
    recent = commands.add_parser(
        _COMMANDS, parents=[common], help="list the last commands and what became of them"
    )
    recent.description = (
        "List the last commands that the nodes have taken, the last changed one last: time of "
        "taking, sender, content, state, reason, and time of the last change."
    )
    own = [name.removeprefix(f"{MISSION}-") for name in COMMANDS if name.startswith(MISSION)]
    mission = commands.add_parser(MISSION, help=f"command a whole mission: {', '.join(own)}")
    mission_commands = mission.add_subparsers(metavar="ACTION", required=True)
    for command in COMMANDS.values():
        _add_command(
            mission_commands if command.name.startswith(MISSION) else commands, command, common
        )
    return parser


def _add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser],
                 command: OperatorCommand, common: argparse.ArgumentParser) -> None:  # fmt: skip
    own = commands.add_parser(
        command.name.removeprefix(f"{MISSION}-"), parents=[common], help=command.about,
        description=f"{command.about[0].upper()}{command.about[1:]}.",
    )  # fmt: skip
    own.set_defaults(command=command.name)
    for argument in command.arguments:
        rule = command.rule(argument)
        about = f"{argument.about} ({rule.minimum:g} .. {rule.maximum:g} {rule.unit})"
        metavar = f"{argument.name.upper()}"
        if not argument.required:
            own.add_argument(f"--{argument.name}", metavar=rule.unit, help=about)
        elif argument.parameter is not None:
            own.add_argument(argument.name, metavar=metavar, nargs="?", help=about)
        else:
            own.add_argument(argument.name, metavar=metavar, help=about)
    if command.request is not None and command.request.renewal_rate:
        own.add_argument(
            "--for", dest="duration", type=_positive, metavar="S", default=math.inf,
            help="duration [s], then hold (default: until Ctrl-C)",
        )  # fmt: skip
    else:
        own.add_argument("--wait", action="store_true", help="wait until it is done")


def _protect_numbers(arguments: Sequence[str]) -> list[str]:
    """Put a blank before negative numbers: argparse reads -1e-2 as an option."""
    words = []
    for text in arguments:
        try:
            float(text)
        except ValueError:
            words.append(text)
        else:
            words.append(f" {text}" if text.startswith("-") else text)
    return words


# --- execution -----------------------------------------------------------------------------------


class Terminal:
    """Output as text for people or as JSON for programs.

    Args:
        as_json: whether it is for programs.
        stop: set where the output cannot be written, as its reader has ended or the disk is full.

    Attributes:
        is_lost: whether something could not be written.
    """

    def __init__(self, as_json: bool, stop: threading.Event) -> None:
        self.as_json = as_json
        self.is_lost = False
        self._stop = stop

    def line(self, line: str) -> None:
        """Print progress; omitted with --json."""
        if not self.as_json:
            self._note(print_or_discard(line, sys.stdout))

    def show(self, content: RenderableType) -> None:
        """Print a table; omitted with --json."""
        if not self.as_json:
            from rich.console import Console  # noqa: PLC0415

            console = Console(highlight=False)
            self._note(write_or_discard(lambda: console.print(content), sys.stdout))

    def error(self, line: str) -> None:
        """Print an error."""
        print_or_discard(f"rover: {line}", sys.stderr)

    def result(self, content: Mapping[str, object]) -> None:
        """Print the result with --json."""
        if self.as_json:
            self._note(print_or_discard(json.dumps(content), sys.stdout))

    def _note(self, failure: OSError | None) -> None:
        if failure is None:
            return
        self.is_lost = True
        self._stop.set()
        if not isinstance(failure, BrokenPipeError):
            self.error(f"the output cannot be written: {failure.strerror}")


class TerminalSession:
    """One command of an operator at a terminal.

    Args:
        options: parsed arguments.
        stop: set by a signal.
    """

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        self._options = options
        self._stop = stop
        self._terminal = Terminal(getattr(options, "json", False), stop)
        self._timeout: float | None = getattr(options, "timeout", None)
        self._answer = _ANSWER_TIMEOUT if self._timeout is None else self._timeout

    def exit_code(self, code: Exit) -> Exit:
        """The exit code of the program after an action with this one."""
        return Exit.CRASHED if code is Exit.DONE and self._terminal.is_lost else code

    # --- orders ----------------------------------------------------------------------------------

    def order(
        self, link: OperatorLink, command: OperatorCommand, given: Mapping[str, object]
    ) -> Exit:
        """Send an order and wait as the options require."""
        given = link.with_defaults(command, given, self._answer, self._stop.is_set)
        try:
            order = command.order(given)
        except FieldError as error:
            if self._stop.is_set():
                return Exit.INTERRUPTED
            self._terminal.error(
                f"{command.name}: {error}; no node reported the default, give the argument"
            )
            return Exit.UNAVAILABLE
        sent = link.send(order, self._answer, self._stop.is_set)
        outcome = sent.outcome
        self._terminal.line(outcome_line(order, outcome))
        is_open = outcome.status is OrderStatus.NO_ANSWER  # a node may still execute it
        if outcome.status is OrderStatus.CANCELLED or (is_open and self._stop.is_set()):
            return self._interrupted(link, sent)
        exit_code = _EXITS[outcome.status]
        completion: Completion | None = None
        if outcome.is_accepted and self._is_followed(command):
            exit_code, completion = self._follow(link, sent)
        self._hint(outcome)
        self._terminal.result(_as_json(order, outcome, completion, exit_code))
        return exit_code

    def _is_followed(self, command: OperatorCommand) -> bool:
        return getattr(self._options, "wait", False) or _is_renewed(command)

    def _follow(self, link: OperatorLink, sent: SentOrder) -> tuple[Exit, Completion | None]:
        if _is_renewed(sent.order.command):
            return self._renew(link, sent)
        limit = math.inf if self._timeout is None else self._timeout
        completion = link.follow(sent, limit, self._stop.is_set, self._print_event)
        if completion is None and self._stop.is_set():
            return self._interrupted(link, sent), None
        if completion is None:
            self._terminal.line(
                f"not done within {limit:g} s, the motion continues; {self._state(link)}"
            )
            return Exit.TIMED_OUT, None
        self._terminal.line(f"{'done' if completion.is_done else 'NOT done'}: {completion.reason}")
        return (Exit.DONE if completion.is_done else Exit.NOT_DONE), completion

    def _renew(self, link: OperatorLink, sent: SentOrder) -> tuple[Exit, Completion | None]:
        duration: float = self._options.duration
        limit = "until Ctrl-C" if math.isinf(duration) else f"for {duration:g} s"
        self._terminal.line(f"renewed {limit}, then hold")
        completion = link.follow(sent, duration, self._stop.is_set, self._print_event)
        if completion is not None:
            self._terminal.line(f"NOT done: {completion.reason}")
            return Exit.NOT_DONE, completion
        is_at_rest = self._bring_to_rest(link, sent)
        return (Exit.DONE if is_at_rest else Exit.TIMED_OUT), None

    def _interrupted(self, link: OperatorLink, sent: SentOrder) -> Exit:
        """Stop the motion and print the state."""
        was_sent = sent.exchange is not None or bool(sent.outcome.parts)
        if not was_sent and sent.outcome.status is OrderStatus.CANCELLED:
            self._terminal.line("interrupted")
        else:
            self._bring_to_rest(link, sent)
        return Exit.INTERRUPTED

    def _bring_to_rest(self, link: OperatorLink, sent: SentOrder) -> bool:
        undo = link.undo(sent.order, self._answer)
        if undo is None:
            self._terminal.line(f"interrupted, nothing was stopped; {self._state(link)}")
            return True
        self._terminal.line(outcome_line(undo.order, undo.outcome))
        if not undo.outcome.is_accepted:
            self._terminal.error(f"the machine may still move; {self._state(link)}")
            return False
        is_at_rest = link.follow(undo, _REST_TIMEOUT) is not None
        state = "at rest" if is_at_rest else f"not at rest within {_REST_TIMEOUT:g} s"
        self._terminal.line(f"{state}; {self._state(link)}")
        return is_at_rest

    def _print_event(self, line: str) -> None:
        self._terminal.line(f"  {line}")

    def _state(self, link: OperatorLink) -> str:
        from operator_console.views import status_line  # noqa: PLC0415

        link.subscribe_all()
        link.wait_until(
            lambda known: known.depth is not None and bool(known.text(topics.WINCH_MODE)),
            _STATE_TIMEOUT,
        )
        return status_line(link.snapshot())

    def _hint(self, outcome: OrderResult) -> None:
        hint = _HINTS.get(outcome.code, "")
        if outcome.status is OrderStatus.UNAVAILABLE:
            hint = _HINTS["unavailable"]
        elif outcome.status is OrderStatus.NO_ANSWER:
            hint = "a node may have accepted it; `rover hold` stops all motion"
        if hint:
            self._terminal.line(f"  {hint}")

    # --- state -----------------------------------------------------------------------------------

    def status(self, link: OperatorLink) -> Exit:
        """Print the state once."""
        if not self._connect(link):
            return Exit.INTERRUPTED if self._stop.is_set() else Exit.UNAVAILABLE
        self._show(link.snapshot())
        return Exit.DONE

    def recorded_status(self) -> Exit:
        """Print the state in a bag."""
        from operator_console.replay import read_state  # noqa: PLC0415

        namespace = getattr(self._options, "namespace", None)
        try:
            state = read_state(self._options.bag, self._options.at, namespace)
        except OSError as error:
            self._terminal.error(file_problem(error))
            return Exit.BAD_ARGUMENTS
        except ValueError as error:
            self._terminal.error(str(error))
            return Exit.BAD_ARGUMENTS
        self._show(state)
        return Exit.DONE

    def _show(self, now: Snapshot) -> None:
        from operator_console.views import status_view  # noqa: PLC0415

        self._terminal.result(now.as_dict())
        self._terminal.show(status_view(now))

    def commands(self, link: OperatorLink) -> Exit:
        """Print the last commands."""
        if not self._connect(link):
            return Exit.INTERRUPTED if self._stop.is_set() else Exit.UNAVAILABLE
        from operator_console.views import command_view  # noqa: PLC0415

        found = link.snapshot().commands
        self._terminal.result({"commands": [asdict(each) for each in found]})
        self._terminal.show(command_view(found) if found else "no command was taken")
        return Exit.DONE

    def watch(self, link: OperatorLink) -> Exit:
        """Print the state until Ctrl-C."""
        if not self._connect(link):
            return Exit.INTERRUPTED if self._stop.is_set() else Exit.UNAVAILABLE
        from rich.console import Console  # noqa: PLC0415
        from rich.live import Live  # noqa: PLC0415

        from operator_console.views import status_line, status_view  # noqa: PLC0415

        period = self._options.period
        console = Console(highlight=False)
        if self._terminal.as_json or not console.is_terminal:
            while not self._stop.is_set():
                now = link.snapshot()
                self._terminal.result(now.as_dict())
                self._terminal.line(status_line(now))
                self._stop.wait(period)
            return Exit.DONE
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not self._stop.is_set():
                live.update(status_view(link.snapshot()), refresh=True)
                self._stop.wait(period)
        return Exit.DONE

    def _connect(self, link: OperatorLink) -> bool:
        """Wait until every node has reported its health (1 Hz); return whether there is one."""
        found = link.wait_for_nodes(self._answer, self._stop.is_set)
        if not found and not self._stop.is_set():
            where = getattr(self._options, "namespace", "") or "/"
            self._terminal.error(f"no node runs in the namespace {where}")
        if found and (missing := link.unreported()):
            names = ", ".join(missing)
            self._terminal.error(f"incomplete: no health report has arrived of {names}")
        return found


def outcome_line(order: Order, outcome: OrderResult) -> str:
    """The result of an order in one line."""
    code = f" [{outcome.code}]" if outcome.code else ""
    status = outcome.status.value
    if outcome.is_accepted:
        reason = "" if outcome.reason == status else f": {outcome.reason}"
        return f"{order.text}: accepted by {outcome.by}{reason}"
    return f"{order.text}: {status}: {outcome.reason}{code}"


def _is_renewed(command: OperatorCommand) -> bool:
    return command.request is not None and command.request.renewal_rate > 0.0


def _as_json(
    order: Order, outcome: OrderResult, completion: Completion | None, exit_code: Exit
) -> dict[str, object]:
    return {
        "order": order.command.name,
        "arguments": dict(order.values),
        **asdict(outcome),
        "completion": None if completion is None else asdict(completion),
        "exit_code": int(exit_code),
    }


# --- entry point ------------------------------------------------------------------------------


def checked_arguments(command: OperatorCommand, options: argparse.Namespace) -> dict[str, object]:
    """Check a command's arguments; one whose default is a node's parameter may be missing.

    Raises:
        FieldError: the command does not accept an argument.
    """
    names = [argument.name for argument in command.arguments]
    texts = {name: getattr(options, name, None) for name in names}
    given = {name: text.strip() for name, text in texts.items() if text is not None}
    stand_in = {
        argument.name: command.rule(argument).minimum
        for argument in command.arguments
        if argument.parameter is not None
    }
    command.order({**stand_in, **given})  # refuses before anything is sent
    return dict(given)


def _handle_signals(stop: threading.Event) -> None:
    terminals = [each for each in _OUTPUTS if os.isatty(each)]
    first = math.inf  # steady time of the first signal [s]

    def on_signal(number: int, _frame: object) -> None:
        nonlocal first
        now = time.monotonic()
        first = min(first, now)
        if number == signal.SIGHUP:
            for each in terminals:  # a closed terminal must not keep the motion from being stopped
                os.dup2(os.open(os.devnull, os.O_WRONLY), each)
        elif now > first + _REPETITION:  # `timeout` and launchers signal process and group
            sys.stderr.write("\nrover: ended at once; a motion may continue\n")
            sys.stderr.flush()
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.raise_signal(signal.SIGINT)
        stop.set()

    for number in stop_signals():
        signal.signal(number, on_signal)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns an ``Exit``."""
    escape_unencodable()
    given = list(sys.argv[1:] if arguments is None else arguments)
    at = given.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in given else len(given)
    parser = make_parser()
    argcomplete.autocomplete(parser)
    options = parser.parse_args(_protect_numbers(given[:at]))
    command = COMMANDS.get(options.command)
    values: dict[str, object] = {}
    if options.command == _SHOW and options.bag is None and math.isfinite(options.at):
        parser.error("--at is a time in a bag: give --bag too")
    if command is not None:
        try:
            values = checked_arguments(command, options)
        except FieldError as error:
            print(f"rover {command.name}: {error}", file=sys.stderr)
            return Exit.BAD_ARGUMENTS
    stop = threading.Event()
    _handle_signals(stop)
    session = TerminalSession(options, stop)
    views = {_SHOW: session.status, _WATCH: session.watch, _COMMANDS: session.commands}
    action: Callable[[OperatorLink], Exit] = views.get(
        options.command, lambda link: session.order(link, COMMANDS[options.command], values)
    )
    if options.command == _SHOW and options.bag is not None:
        return session.exit_code(session.recorded_status())
    from operator_console.operator_link import LinkError, open_link  # noqa: PLC0415 - not for a bag

    try:
        with open_link("rover", getattr(options, "namespace", ""), given[at:]) as link:
            return session.exit_code(action(link))
    except LinkError as error:
        print(f"rover: {error}", file=sys.stderr)
        return Exit.BAD_ARGUMENTS


if __name__ == "__main__":
    sys.exit(main())
