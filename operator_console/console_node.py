"""The node `operator_console`: serves the operators' web page."""

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
from msg_schemas.parameters import parameter
from msg_schemas.refusal import RefusalCode
from operator_console.bag_shelf import BagShelf
from operator_console.commands import COMMANDS, OperatorCommand
from operator_console.deadman import DeadmanCommands
from operator_console.operator_link import OperatorLink
from operator_console.page_access import open_access
from operator_console.page_state import PAGE_TOPICS, JournalEntry, PageState, ValueHistory, frame
from operator_console.scene import DEFAULT_MACHINE
from operator_console.server import Content, Server, ServerSettings
from rover_runtime.ros.node import RosComponent
from rover_runtime.ros.process import run

_PARALLEL_COMMANDS: Final = 4  # commands that wait for their answers
_HISTORY_PERIOD: Final = 0.5  # [s]
_ANSWER_TIMEOUT: Final = 5.0  # [s]


@dataclass(frozen=True)
class ConsoleParameters:
    """Address, access and content of the page."""

    address: str = parameter(
        "127.0.0.1", "-", "address to listen on; one that other machines reach needs a token",
        read_only=True,
    )  # fmt: skip
    port: int = parameter(
        8642, "-", "port to listen on; 0 = any free one, see the log", 0, 65535, read_only=True
    )
    view_only: bool = parameter(False, "-", "accept no commands", read_only=True)
    token_file: str = parameter(
        "", "-", "file with the operator's token, readable by its owner alone; empty = no token",
        read_only=True,
    )  # fmt: skip
    viewer_token_file: str = parameter(
        "", "-", "file with the viewers' token; empty = no viewers", read_only=True
    )
    host_names: str = parameter(
        "", "-", "host names of this server, separated by blanks", read_only=True
    )
    certificate_file: str = parameter(
        "", "-", "certificate file for https; empty = http", read_only=True
    )
    key_file: str = parameter("", "-", "private key file of the certificate", read_only=True)
    bag_folder: str = parameter(
        "", "-", "folder of the replayable bags; empty = no replay", read_only=True
    )
    frame_rate: float = parameter(
        10.0, "Hz", "rate of frames to the page, by wall clock", 4.0, 30.0,
        read_only=True,
    )  # fmt: skip
    history: float = parameter(
        900.0, "s", "past that a newly opened page shows", 10.0, 900.0,
        read_only=True,
    )  # fmt: skip


class OperatorConsole(RosComponent):
    """Serves a page that shows the machine, accepts operators' commands and replays bags."""

    NAME = "operator_console"
    PARAMETERS = (ConsoleParameters,)

    _server: Server | None = None

    def setup(self) -> None:
        """Subscribe to the machine and listen for browsers."""
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
            raise ValueError(f"bag_folder {given.bag_folder!r} is not a folder")
        self._state_lock = threading.Lock()
        self._page_state = PageState()
        self._history = ValueHistory(given.history, _HISTORY_PERIOD)
        # Commands that move something may wait for each other; those that stop never wait for them.
        self._workers = {
            moves: ThreadPoolExecutor(_PARALLEL_COMMANDS, f"console-commands-{moves}")
            for moves in (True, False)
        }
        server = Server(
            ServerSettings(
                given.address, given.port, access, BagShelf(folder),
                given.certificate_file, given.key_file,
            ),
            self._on_command,
            self._history_content,
        )  # fmt: skip
        server.latch("commands", {"commands": command_rows()})
        server.latch("machine", {"machine": dict(DEFAULT_MACHINE)})
        self._link = OperatorLink(self.ros, self.NAME, self._on_sample)
        self._deadman = DeadmanCommands(self._link.renew)
        self._link.subscribe(*PAGE_TOPICS)
        self._link.prepare()
        self._server = server
        server.start()
        self.ros.get_logger().info(f"the page is at {server.address}")

    def start(self) -> None:
        """Publish frames to the pages."""
        rate = self.parameters_of(ConsoleParameters).frame_rate
        self.every(1.0 / rate, self._publish_frame, by_wall_clock=True)

    def release(self) -> None:
        """Close the server and the link."""
        if self._server is None:
            return
        self._server.stop()
        self._server = None
        for workers in self._workers.values():
            workers.shutdown(wait=False, cancel_futures=True)
        self._link.close()

    # --- state of the machine --------------------------------------------------------------------

    def _machine_time(self) -> float:
        """Machine time [s]: simulated time if there is a clock, else wall-clock time."""
        clock_ns = self._page_state.clock_ns
        return time.time() if clock_ns is None else clock_ns * 1e-9

    def _on_sample(self, topic: str, sample: Any) -> None:
        with self._state_lock:
            new_entries = self._page_state.on_sample(
                topic, sample, time.monotonic(), self._machine_time()
            )
        server = self._server
        if server is not None and topic == topics.PLACE:
            server.latch("place", {"place": self._page_state.place})
        elif server is not None and topic == topics.CONFIG and self._page_state.machine is not None:
            server.latch("machine", {"machine": self._page_state.machine})
        self._publish_journal(new_entries)

    def _publish_frame(self) -> None:
        snapshot = self._link.snapshot()
        with self._state_lock:
            if snapshot.is_clock_over:
                self._page_state.clock_ns = None
            made = frame(snapshot, self._page_state, time.monotonic(), self._machine_time())
            self._history.add(made)
        if self._server is not None:
            self._server.send("frame", made, may_drop=True)

    def _publish_journal(self, new_entries: list[JournalEntry]) -> None:
        if new_entries and self._server is not None:
            self._server.send("journal", {"entries": [entry.as_dict() for entry in new_entries]})

    def _history_content(self) -> Content:
        with self._state_lock:
            return {
                "frames": self._history.frames(),
                "journal": [entry.as_dict() for entry in self._page_state.journal],
            }

    # --- commands --------------------------------------------------------------------------------

    def _on_command(self, request: Content) -> Future[Content]:
        command = COMMANDS.get(request["command"])
        if "renew" in request:
            # Answer at once: a renewal does not block, and a late one is useless.
            renewed: Future[Content] = Future()
            # On stale data the press ends, and with its renewals the motion.
            if why := self._obstacle(command):
                self._deadman.end(str(request["renew"]))
                renewed.set_result({"done": False, "status": "ended", "reason": why})
                return renewed
            reply = self._deadman.renew(str(request["renew"]))
            renewed.set_result({"done": reply.is_done, "status": "ended", "reason": reply.reason})
            return renewed
        moves = command is not None and command.moves
        return self._workers[moves].submit(self._execute, request)

    def _obstacle(self, command: OperatorCommand | None) -> str:
        """Why a command may not move the machine now; empty = it may, or it moves nothing."""
        if command is None or not command.moves:
            return ""
        return self._link.snapshot().obstacle(command.nodes)

    def _execute(self, request: Content) -> Content:
        name, given = request["command"], request.get("arguments") or {}
        if name not in COMMANDS or not isinstance(given, Mapping):
            return refusal(f"unknown command {str(name)[:40]!r}")
        try:
            order = COMMANDS[name].order(given)
        except FieldError as error:
            return refusal(str(error))
        if why := self._obstacle(order.command):
            return refusal(f"nothing may move on stale data: {why}", RefusalCode.STALE)
        sent = self._link.send(order, _ANSWER_TIMEOUT, self.shutdown_requested)
        outcome = sent.outcome
        reply = f"{outcome.status.value}: {outcome.reason}"
        if outcome.code:
            reply = f"{reply} [{outcome.code}]"
        with self._state_lock:
            level = "ok" if outcome.is_accepted else "warn"
            entry = JournalEntry(self._machine_time(), level, "this console", order.text, reply)
            self._page_state.journal.append(entry)
        self._publish_journal([entry])
        needs_renewal = outcome.is_accepted and renewal_rate_of(order.command) > 0.0
        key = {"press": self._deadman.begin(sent)} if needs_renewal else {}
        return {
            **key,
            "done": outcome.is_accepted,
            "status": outcome.status.value,
            "reason": outcome.reason,
            "code": outcome.code,
            "by": outcome.by,
            "order": order.text,
        }


def refusal(reason: str, code: str = "") -> Content:
    """Answer to a command that is not sent."""
    return {"done": False, "status": "refusal", "reason": reason, "code": code, "by": "console"}


def renewal_rate_of(command: OperatorCommand) -> float:
    """Rate at which a command must be repeated [Hz]; 0 = it is sent once."""
    return 0.0 if command.request is None else command.request.renewal_rate


def command_rows() -> list[dict[str, Any]]:
    """The commands as the page shows them."""
    return [
        {
            "name": command.name,
            "about": command.about,
            "group": command.group,
            "moves": command.moves,
            "renewal_rate": renewal_rate_of(command),
            "arguments": _arguments(command),
        }
        for command in COMMANDS.values()
    ]


def _arguments(command: OperatorCommand) -> list[dict[str, Any]]:
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
