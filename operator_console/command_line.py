"""The ``rover`` executable: the operators' commands at a terminal, without ``ros2``."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from enum import IntEnum
from typing import TYPE_CHECKING

import argcomplete

from msg_schemas import topics
from msg_schemas.fields import FieldError
from operator_console.commands import COMMANDS, MISSION, Command, Order
from operator_console.exchange import Outcome, Verdict

if TYPE_CHECKING:
    from operator_console.completion import Completion
    from operator_console.operator_link import OperatorLink, Sent

_ROS_ARGUMENTS = "--ros-args"
_ANSWER = 10.0  # [s]
_STATE = 2.0  # for what is told last of the machine [s]
_SETTLES = 15.0  # for what is brought to rest [s]
_SHOW, _WATCH = "status", "watch"


class Exit(IntEnum):
    """What the exit code says."""

    DONE = 0
    CRASH = 1
    BAD_ARGUMENTS = 2
    REFUSED = 3
    NOBODY = 4
    TIMED_OUT = 5
    ENDED_OTHERWISE = 6
    INTERRUPTED = 130


_EXITS = {
    Verdict.ACCEPTED: Exit.DONE,
    Verdict.REFUSED: Exit.REFUSED,
    Verdict.NOBODY: Exit.NOBODY,
    Verdict.NO_ANSWER: Exit.TIMED_OUT,
    Verdict.GIVEN_UP: Exit.INTERRUPTED,
}

_EPILOG = """\
exit codes:
    0  accepted; with --wait: done
    1  crashed
    2  bad arguments, nothing was sent
    3  refused; the reason is told
    4  nobody is there to take it
    5  no answer, or not done, in time; whether it goes on is told
    6  accepted, but ended otherwise than asked for
  130  Ctrl-C; what was begun is brought to rest first

Ctrl-C while an order is waited for sends what ends it safely (hold; for a jump abort), tells what
state that leaves, and ends; a second one ends at once. Without --wait the command ends when the
order is accepted, and the machine goes on.

ROS arguments follow at the end, after --ros-args. ROS_DOMAIN_ID chooses the domain.
Completion of the shell: eval "$(register-python-argcomplete rover)"
"""

_HINTS = {"not_armed": "`rover arm` arms it", "nobody": "`rover status` shows who is there"}


# --- arguments -----------------------------------------------------------------------------------


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} should be a number above 0 and at most 1e6 s")
    return value


def _common() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    common.add_argument("--namespace", metavar="NS", help="of the machine, such as /mother1")
    common.add_argument(
        "--timeout", type=_positive, metavar="S",
        help=f"for the answer, {_ANSWER:g} unless given; with --wait also for the end, any "
        "unless given",
    )  # fmt: skip
    common.add_argument("--json", action="store_true", help="print JSON, one object a line")
    return common


def make_parser() -> argparse.ArgumentParser:
    """The parser, made of the table of commands."""
    common = _common()
    parser = argparse.ArgumentParser(
        prog="rover",
        description="Sees and drives the tethered rover and its mother machine.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        parents=[common],
    )
    kinds = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    show = kinds.add_parser(_SHOW, parents=[common], help="what is known now")
    show.description = "Shows what is known now, with the age of what is stale."
    watch = kinds.add_parser(_WATCH, parents=[common], help="the same, live, until Ctrl-C")
    watch.description = "Shows what is known, live; lines where the output is no terminal."
    watch.add_argument("--period", type=_positive, default=1.0, metavar="S", help="default 1")
    own = [name.removeprefix(f"{MISSION}-") for name in COMMANDS if name.startswith(MISSION)]
    mission = kinds.add_parser(MISSION, help=f"a whole mission: {', '.join(own)}")
    acts = mission.add_subparsers(metavar="ACT", required=True)
    for command in COMMANDS.values():
        _add_command(acts if command.name.startswith(MISSION) else kinds, command, common)
    return parser


def _add_command(kinds: argparse._SubParsersAction[argparse.ArgumentParser],
                 command: Command, common: argparse.ArgumentParser) -> None:  # fmt: skip
    own = kinds.add_parser(
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
    if command.request is not None and command.request.renew:
        own.add_argument(
            "--for", dest="duration", type=_positive, metavar="S", default=math.inf,
            help="for so long, then hold; until Ctrl-C unless given",
        )  # fmt: skip
    else:
        own.add_argument("--wait", action="store_true", help="until it is done")


def _numbers_apart(arguments: Sequence[str]) -> list[str]:
    """Write numbers such as -1e-2, which argparse takes for options, so that it does not."""
    told = []
    for text in arguments:
        try:
            float(text)
        except ValueError:
            told.append(text)
        else:
            told.append(f" {text}" if text.startswith("-") else text)
    return told


# --- doing ---------------------------------------------------------------------------------------


class Terminal:
    """What is printed, as text for people or as JSON for programs."""

    def __init__(self, as_json: bool) -> None:
        self.as_json = as_json

    def say(self, line: str) -> None:
        """Tell how it goes; a program is told what came of it alone."""
        if not self.as_json:
            print(line, flush=True)

    def complain(self, line: str) -> None:
        """Tell what is wrong."""
        print(f"rover: {line}", file=sys.stderr, flush=True)

    def result(self, content: Mapping[str, object]) -> None:
        """Tell a program."""
        if self.as_json:
            print(json.dumps(content), flush=True)


class Session:
    """One command of an operator at a terminal.

    Args:
        options: as they were given.
        stop: set by Ctrl-C, or by SIGTERM.
    """

    def __init__(self, options: argparse.Namespace, stop: threading.Event) -> None:
        self._options = options
        self._stop = stop
        self._terminal = Terminal(getattr(options, "json", False))
        self._timeout: float | None = getattr(options, "timeout", None)
        self._answer = _ANSWER if self._timeout is None else self._timeout

    # --- orders ----------------------------------------------------------------------------------

    def order(self, link: OperatorLink, command: Command, given: Mapping[str, object]) -> Exit:
        """Send an order, and wait for what was wished to be waited for."""
        given = link.fill_in(command, given, self._answer, self._stop.is_set)
        try:
            order = command.order(given)
        except FieldError as error:
            self._terminal.complain(f"{command.name}: {error}; it was not told, please give it")
            return Exit.NOBODY
        sent = link.send(order, self._answer, self._stop.is_set)
        outcome = sent.outcome
        self._terminal.say(outcome_line(order, outcome))
        if outcome.verdict is Verdict.GIVEN_UP:
            return self._interrupted(link, sent)
        exit_code = _EXITS[outcome.verdict]
        ending: Completion | None = None
        if outcome.is_accepted and self._is_followed(command):
            exit_code, ending = self._follow(link, sent)
        self._hint(outcome)
        self._terminal.result(_as_json(order, outcome, ending, exit_code))
        return exit_code

    def _is_followed(self, command: Command) -> bool:
        return getattr(self._options, "wait", False) or _is_renewed(command)

    def _follow(self, link: OperatorLink, sent: Sent) -> tuple[Exit, Completion | None]:
        if _is_renewed(sent.order.command):
            return self._renew(link, sent)
        limit = math.inf if self._timeout is None else self._timeout
        ending = link.follow(sent, limit, self._stop.is_set, self._publish_on)
        if ending is None and self._stop.is_set():
            return self._interrupted(link, sent), None
        if ending is None:
            self._terminal.say(f"not done within {limit:g} s, it goes on; {self._state(link)}")
            return Exit.TIMED_OUT, None
        self._terminal.say(f"{'done' if ending.is_done else 'NOT done'}: {ending.reason}")
        return (Exit.DONE if ending.is_done else Exit.ENDED_OTHERWISE), ending

    def _renew(self, link: OperatorLink, sent: Sent) -> tuple[Exit, Completion | None]:
        duration: float = self._options.duration
        told = "until Ctrl-C" if math.isinf(duration) else f"for {duration:g} s"
        self._terminal.say(f"renewed {told}, then hold")
        ending = link.follow(sent, duration, self._stop.is_set, self._publish_on)
        if ending is not None:
            self._terminal.say(f"NOT done: {ending.reason}")
            return Exit.ENDED_OTHERWISE, ending
        rests = self._bring_to_rest(link, sent)
        return (Exit.DONE if rests else Exit.TIMED_OUT), None

    def _interrupted(self, link: OperatorLink, sent: Sent) -> Exit:
        """End halfway what was begun, and tell where that leaves the machine."""
        was_sent = sent.exchange is not None or bool(sent.outcome.parts)
        if not was_sent and not sent.outcome.is_accepted:
            self._terminal.say("interrupted")
        else:
            self._bring_to_rest(link, sent)
        return Exit.INTERRUPTED

    def _bring_to_rest(self, link: OperatorLink, sent: Sent) -> bool:
        undo = link.undo(sent.order, self._answer)
        if undo is None:
            self._terminal.say(f"interrupted, nothing is to be ended; {self._state(link)}")
            return True
        self._terminal.say(outcome_line(undo.order, undo.outcome))
        if not undo.outcome.is_accepted:
            self._terminal.complain(f"it may still move; {self._state(link)}")
            return False
        rests = link.follow(undo, _SETTLES) is not None
        told = "at rest" if rests else f"not at rest within {_SETTLES:g} s"
        self._terminal.say(f"{told}; {self._state(link)}")
        return rests

    def _publish_on(self, line: str) -> None:
        self._terminal.say(f"  {line}")

    def _state(self, link: OperatorLink) -> str:
        from operator_console.views import status_line  # noqa: PLC0415

        link.listen_to_all()
        link.wait_until(
            lambda known: known.depth is not None and bool(known.word(topics.WINCH_MODE)), _STATE
        )
        return status_line(link.snapshot())

    def _hint(self, outcome: Outcome) -> None:
        hint = _HINTS.get(outcome.code, "")
        if outcome.verdict is Verdict.NOBODY:
            hint = _HINTS["nobody"]
        elif outcome.verdict is Verdict.NO_ANSWER:
            hint = "it may have been taken; `rover hold` brings everything to rest"
        if hint:
            self._terminal.say(f"  {hint}")

    # --- seeing ----------------------------------------------------------------------------------

    def status(self, link: OperatorLink) -> Exit:
        """Show what is known, once."""
        if not self._listen(link):
            return Exit.INTERRUPTED if self._stop.is_set() else Exit.NOBODY
        now = link.snapshot()
        self._terminal.result(now.as_dict())
        if not self._terminal.as_json:
            from rich.console import Console  # noqa: PLC0415

            from operator_console.views import status_view  # noqa: PLC0415

            Console(highlight=False).print(status_view(now))
        return Exit.DONE

    def watch(self, link: OperatorLink) -> Exit:
        """Show what is known until Ctrl-C."""
        if not self._listen(link):
            return Exit.INTERRUPTED if self._stop.is_set() else Exit.NOBODY
        from rich.console import Console  # noqa: PLC0415
        from rich.live import Live  # noqa: PLC0415

        from operator_console.views import status_line, status_view  # noqa: PLC0415

        period = self._options.period
        console = Console(highlight=False)
        if self._terminal.as_json or not console.is_terminal:
            while not self._stop.is_set():
                now = link.snapshot()
                self._terminal.result(now.as_dict())
                self._terminal.say(status_line(now))
                self._stop.wait(period)
            return Exit.DONE
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while not self._stop.is_set():
                live.update(status_view(link.snapshot()), refresh=True)
                self._stop.wait(period)
        return Exit.DONE

    def _listen(self, link: OperatorLink) -> bool:
        """Wait until all who are there have told their health, which they do each second."""
        heard = link.meet_everyone(self._answer, self._stop.is_set)
        if not heard and not self._stop.is_set():
            where = getattr(self._options, "namespace", "") or "/"
            self._terminal.complain(f"nobody is heard in the namespace {where}")
        return heard


def outcome_line(order: Order, outcome: Outcome) -> str:
    """What became of an order, in a line."""
    code = f" [{outcome.code}]" if outcome.code else ""
    verdict = outcome.verdict.value
    if outcome.is_accepted:
        reason = "" if outcome.reason == verdict else f": {outcome.reason}"
        return f"{order.text}: accepted by {outcome.by}{reason}"
    return f"{order.text}: {verdict}: {outcome.reason}{code}"


def _is_renewed(command: Command) -> bool:
    return command.request is not None and command.request.renew > 0.0


def _as_json(
    order: Order, outcome: Outcome, ending: Completion | None, exit_code: Exit
) -> dict[str, object]:
    return {
        "order": order.command.name,
        "arguments": dict(order.values),
        **asdict(outcome),
        "ending": None if ending is None else asdict(ending),
        "exit_code": int(exit_code),
    }


# --- the executable ------------------------------------------------------------------------------


def checked_arguments(command: Command, options: argparse.Namespace) -> dict[str, object]:
    """The command's arguments; those that a node's parameter may stand for need not be there.

    Raises:
        FieldError: one is not what the command takes.
    """
    names = [argument.name for argument in command.arguments]
    texts = {name: getattr(options, name, None) for name in names}
    given = {name: text.strip() for name, text in texts.items() if text is not None}
    stand_in = {
        argument.name: command.rule(argument).minimum
        for argument in command.arguments
        if argument.parameter is not None
    }
    command.order({**stand_in, **given})  # refused before anything is sent
    return dict(given)


def _heed_signals(stop: threading.Event) -> None:
    def on_signal(*_: object) -> None:
        if stop.is_set():
            sys.stderr.write("\nrover: ended at once; what was begun may go on\n")
            sys.stderr.flush()
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.raise_signal(signal.SIGINT)
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable; returns an ``Exit``."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    at = given.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in given else len(given)
    parser = make_parser()
    argcomplete.autocomplete(parser)
    options = parser.parse_args(_numbers_apart(given[:at]))
    command = COMMANDS.get(options.command)
    values: dict[str, object] = {}
    if command is not None:
        try:
            values = checked_arguments(command, options)
        except FieldError as error:
            print(f"rover {command.name}: {error}", file=sys.stderr)
            return Exit.BAD_ARGUMENTS
    stop = threading.Event()
    _heed_signals(stop)
    session = Session(options, stop)
    act: Callable[[OperatorLink], Exit] = {_SHOW: session.status, _WATCH: session.watch}.get(
        options.command, lambda link: session.order(link, COMMANDS[options.command], values)
    )
    from operator_console.operator_link import open_link  # noqa: PLC0415 - not needed for --help

    try:
        with open_link("rover", getattr(options, "namespace", ""), given[at:]) as link:
            return act(link)
    except BrokenPipeError:  # who read the output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.CRASH
    except (RuntimeError, ValueError) as error:  # what rclpy's own errors have in common
        print(f"rover: ROS does not take this: {str(error).splitlines()[0]}", file=sys.stderr)
        return Exit.BAD_ARGUMENTS


if __name__ == "__main__":
    sys.exit(main())
