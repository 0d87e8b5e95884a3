"""The ``operator_console`` executable: a web page for those who have neither RViz nor ROS."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from msg_schemas import topics
from msg_schemas.fields import FieldError
from msg_schemas.node import ContractNode
from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from operator_console.bag_shelf import BagShelf
from operator_console.commands import COMMANDS, Command
from operator_console.deadman import DeadmanCommands
from operator_console.operator_link import OperatorLink
from operator_console.page_access import open_access
from operator_console.page_state import SEEN, Entry, History, PageState, frame
from operator_console.scene import USUAL_MACHINE
from operator_console.server import Content, Server, ServerSettings

_AT_ONCE: Final = 4  # commands whose answers are waited for
_HISTORY_PERIOD: Final = 0.5  # [s]
_ANSWER_PATIENCE: Final = 5.0  # [s]


@dataclass(frozen=True)
class ConsoleParameters:
    """Where the page is served, to whom, and what it shows."""

    address: str = parameter(
        "127.0.0.1", "-", "to listen on; others than this machine's own need a token",
        read_only=True,
    )  # fmt: skip
    port: int = parameter(
        8642, "-", "to listen on; 0 = any that is free, the log tells it", 0, 65535, read_only=True
    )
    view_only: bool = parameter(False, "-", "take no commands from anybody", read_only=True)
    token_file: str = parameter(
        "", "-", "file with the operator's token, readable by its owner alone; empty = none",
        read_only=True,
    )  # fmt: skip
    viewer_token_file: str = parameter(
        "", "-", "file with the token of those who may only look; empty = none", read_only=True
    )
    host_names: str = parameter(
        "", "-", "further names under which browsers reach it, separated by blanks", read_only=True
    )
    certificate_file: str = parameter(
        "", "-", "certificate for https; empty = http", read_only=True
    )
    key_file: str = parameter("", "-", "the certificate's private key", read_only=True)
    bag_folder: str = parameter(
        "", "-", "folder whose bags can be replayed; empty = none", read_only=True
    )
    frame_rate: float = parameter(
        10.0, "Hz", "how often the page is told what is so, by wall clock", 1.0, 30.0,
        read_only=True,
    )  # fmt: skip
    history: float = parameter(
        900.0, "s", "what a page that is opened later sees of the past", 10.0, 7200.0,
        read_only=True,
    )  # fmt: skip


class OperatorConsole(ContractNode):
    """Serves a page that shows the machine, takes operators' commands and replays bags."""

    NAME = "operator_console"
    PARAMETERS = (ConsoleParameters,)

    _server: Server | None = None

    def setup(self) -> None:
        """Listen to the machine, and to browsers."""
        given = self.parameters_of(ConsoleParameters)
        access = open_access(
            given.address,
            given.token_file,
            given.viewer_token_file,
            given.view_only,
            tuple(given.host_names.split()),
        )
        folder = Path(given.bag_folder).expanduser() if given.bag_folder else None
        if folder is not None and not folder.is_dir():
            raise ValueError(f"bag_folder {given.bag_folder!r} is no folder")
        self._seeing = threading.Lock()
        self._page_state = PageState()
        self._history = History(given.history, _HISTORY_PERIOD)
        # What lets things move may have to wait for its like; what stops them never waits for it.
        self._workers = {
            moves: ThreadPoolExecutor(_AT_ONCE, f"console-commands-{moves}")
            for moves in (True, False)
        }
        server = Server(
            ServerSettings(
                given.address, given.port, access, BagShelf(folder),
                given.certificate_file, given.key_file,
            ),
            self._on_command,
            self._past,
        )  # fmt: skip
        server.keep("commands", {"commands": command_rows()})
        server.keep("machine", {"machine": dict(USUAL_MACHINE)})
        self._link = OperatorLink(self, self.NAME, self._on_sample)
        self._held = DeadmanCommands(self._link.renew)
        self._link.listen(*SEEN)
        self._link.prepare()
        self._server = server
        server.start()
        self.get_logger().info(f"the page is at {server.address}")

    def start(self) -> None:
        """Tell the page what is so, from now on."""
        rate = self.parameters_of(ConsoleParameters).frame_rate
        self.every(1.0 / rate, self._tell, by_wall_clock=True)

    def release(self) -> None:
        """Close the page."""
        if self._server is None:
            return
        self._server.stop()
        self._server = None
        for workers in self._workers.values():
            workers.shutdown(wait=False, cancel_futures=True)
        self._link.close()

    # --- what the machine says -------------------------------------------------------------------

    def _machine_time(self) -> float:
        """The machine's time [s]: simulated where a clock is heard."""
        clock_ns = self._page_state.clock_ns
        return time.time() if clock_ns is None else clock_ns * 1e-9

    def _on_sample(self, topic: str, sample: Any) -> None:
        with self._seeing:
            news = self._page_state.see(topic, sample, time.monotonic(), self._machine_time())
        server = self._server
        if server is not None and topic == topics.PLACE:
            server.keep("place", {"place": self._page_state.place})
        elif server is not None and topic == topics.CONFIG and self._page_state.machine is not None:
            server.keep("machine", {"machine": self._page_state.machine})
        self._publish_journal(news)

    def _tell(self) -> None:
        with self._seeing:
            made = frame(
                self._link.snapshot(), self._page_state, time.monotonic(), self._machine_time()
            )
            self._history.add(made)
        if self._server is not None:
            self._server.tell("frame", made, may_drop=True)

    def _publish_journal(self, news: list[Entry]) -> None:
        if news and self._server is not None:
            self._server.tell("journal", {"entries": [entry.as_dict() for entry in news]})

    def _past(self) -> Content:
        with self._seeing:
            return {
                "frames": self._history.frames(),
                "journal": [entry.as_dict() for entry in self._page_state.journal],
            }

    # --- what operators ask for ------------------------------------------------------------------

    def _on_command(self, asked: Content) -> Future[Content]:
        if "renews" in asked:
            # At once, as this waits for nothing, and late it would be of no use.
            renewed: Future[Content] = Future()
            told = self._held.renew(str(asked["renews"]))
            renewed.set_result({"done": told.is_done, "verdict": "ended", "reason": told.reason})
            return renewed
        command = COMMANDS.get(asked["command"])
        moves = command is not None and command.moves
        return self._workers[moves].submit(self._carry_out, asked)

    def _carry_out(self, asked: Content) -> Content:
        name, given = asked["command"], asked.get("arguments") or {}
        if name not in COMMANDS or not isinstance(given, Mapping):
            return refused(f"there is no command {str(name)[:40]!r}")
        try:
            order = COMMANDS[name].order(given)
        except FieldError as error:
            return refused(str(error))
        sent = self._link.send(order, _ANSWER_PATIENCE, self.shutdown_requested)
        outcome = sent.outcome
        told = f"{outcome.verdict.value}: {outcome.reason}"
        if outcome.code:
            told = f"{told} [{outcome.code}]"
        with self._seeing:
            level = "ok" if outcome.is_accepted else "warn"
            entry = Entry(self._machine_time(), level, "this console", order.text, told)
            self._page_state.journal.append(entry)
        self._publish_journal([entry])
        must_be_held = outcome.is_accepted and renewal_of(order.command) > 0.0
        held = {"held": self._held.begin(sent)} if must_be_held else {}
        return {
            **held,
            "done": outcome.is_accepted,
            "verdict": outcome.verdict.value,
            "reason": outcome.reason,
            "code": outcome.code,
            "by": outcome.by,
            "order": order.text,
        }


def refused(reason: str) -> Content:
    """The answer to what goes no further."""
    return {"done": False, "verdict": "refused", "reason": reason, "code": "", "by": "console"}


def renewal_of(command: Command) -> float:
    """How often a command must be said again [Hz]; 0 = once is enough."""
    return 0.0 if command.request is None else command.request.renew


def command_rows() -> list[dict[str, Any]]:
    """The operators' commands as the page shows them."""
    return [
        {
            "name": command.name,
            "about": command.about,
            "group": command.group,
            "moves": command.moves,
            "renew": renewal_of(command),
            "arguments": _arguments(command),
        }
        for command in COMMANDS.values()
    ]


def _arguments(command: Command) -> list[dict[str, Any]]:
    found = []
    for argument in command.arguments:
        rule = command.rule(argument)
        found.append({
            "name": argument.name,
            "about": argument.about,
            "required": argument.required,
            "unit": rule.unit,
            "minimum": rule.minimum,
            "maximum": rule.maximum,
        })  # fmt: skip
    return found


def main() -> int:
    """Run the node."""
    return run(OperatorConsole)


if __name__ == "__main__":
    sys.exit(main())
