"""A session of the documents, played command by command on the mock plant, over DDS.

What a sourced ROS 2 would start is started as its launch file says, a `topic pub` sends its message
when so many listen, a `topic echo` hears something, a `service call` succeeds, and what is typed to
`rover` ends well. Simulated time passes slowly, so that a busy machine loses nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import architecture
import ros2_commands
from documented import ROOT, Command
from ros2_commands import Call, Echo, Launch, Publish

from msg_schemas import qos, topics
from msg_schemas.commands import CommandState
from msg_schemas.message_types import message_class
from rover_verify.harness.launching import start_processes, wait_until_ready

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

ASKER = "the document"
FACTOR = 0.4
# The way down would take half a minute.
NEAR_THE_FLOOR = "{tether.length: 7.1}"
# A machine that is busy elsewhere must not brake the winch.
PATIENT: dict[str, dict[str, object]] = {
    "winch_node": {"max_step_delay": 5.0, "command_timeout": 30.0}
}
NEVER_ENDS = {"watch"}
# On a busy machine sensors may seem old for a moment: an order refused for it is given again, and a
# descent that is held for it is resumed first.
OLD, HELD, TRIALS = "[stale]", "resume it first", 5
# Nothing damps a swing of the mock plant, which has no mechanics: a descent is taken there and does
# not end, so what is to wait for that does not, and what is refused until then is left out.
UNTIL_ITS_END, AFTER_ITS_END = "--wait", {"release"}
MODULES = architecture.nodes(ROOT)


@dataclass
class Session:
    """One operator, in one domain."""

    harness: NodeHarness
    observer: Observer = field(init=False)
    started: dict[str, Process] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.observer = self.harness.observer()

    def do(self, command: Command) -> None:
        """Carry a command out, to its end if it has one."""
        if command.program == "rover":
            self.order(command.words[1:])
        elif command.program == "ros2":
            self.ros2(command)
        else:
            self.start(command.words[2:] if command.words[0] == "mother_rover" else command.words)

    # --- what is typed to `rover` -----------------------------------------------------------------

    def order(self, words: Sequence[str]) -> None:
        if words[0] in AFTER_ITS_END:
            return
        given = [word for word in words if word != UNTIL_ITS_END]
        for _ in range(TRIALS):
            process = self.harness.processes.start("operator_console.command_line", None, *given)
            if words[0] in NEVER_ENDS:
                process.wait_for_output("depth")
                process.stop()
                return
            code = process.wait()
            if code == 0 or not (OLD in process.output or HELD in process.output):
                break
            if HELD in process.output:
                self.observer.call(topics.DESCENT_RESUME)
        assert code == 0, process.output

    # --- what is typed to a shell -----------------------------------------------------------------

    def start(self, words: Sequence[str]) -> None:
        """A node: one of ours, or a script of the tutorials."""
        script = words[0] == "python3"
        at = 1 if script else 0
        if "--help" in words:
            return
        _, parameters = ros2_commands.split_ros_arguments(words[at:])
        name = Path(words[at]).stem
        if name == "mock_plant":
            parameters = parameters | {"real_time_factor": FACTOR, "overrides": NEAR_THE_FLOOR}
        if "scenario" in parameters:
            parameters = parameters | {"scenario": str(ROOT / str(parameters["scenario"]))}
        parameters = parameters | PATIENT.get(name, {})
        module = name if script else MODULES[name]
        extra = {"PYTHONPATH": f"{ROOT / 'docs' / 'tutorials'}:{ROOT}"} if script else None
        begun = self.harness.processes.start(module, parameters, extra_environment=extra)
        self.started[name] = begun
        self.observer.wait_until_ready(name)

    # --- what is typed to `ros2` ------------------------------------------------------------------

    def ros2(self, command: Command) -> None:
        meant = ros2_commands.read(command.words)
        if isinstance(meant, Launch):
            self.launch(meant)
        elif isinstance(meant, Publish):
            listeners = command.words[command.words.index("-w") + 1] if "-w" in command.words else 1
            self.publish(meant, int(listeners))
        elif isinstance(meant, Call):
            data = meant.values.get("data")
            answer = self.observer.call(meant.row.name, data)
            assert answer.success, f"{command}: {answer.message}"
        elif isinstance(meant, Echo):
            self.observer.listen(meant.row.name).wait()
        else:
            raise AssertionError(f"{command} is not for a session")

    def launch(self, meant: Launch) -> None:
        planned = meant.plan(plant="mock", real_time_factor=str(FACTOR))
        changed: dict[str, dict[str, object]] = {**PATIENT, "mission_node": {"checkpoint": "none"}}
        begun = start_processes(self.harness, planned, changed)
        for each, process in zip(planned.started, begun, strict=True):
            self.started[each.executable] = process
        for each in planned.started:
            wait_until_ready(self.observer, each)

    def publish(self, meant: Publish, listeners: int) -> None:
        """Send it under a name, which the record of the node that has taken it repeats."""
        message = meant.message()
        message.header.frame_id = message.header.frame_id or ASKER
        kind = message_class(meant.row.message)
        publisher: Any = self.observer.node.create_publisher(
            kind, meant.row.name, qos.profile(meant.row.intent)
        )
        self.observer.wait_until(
            lambda: publisher.get_subscription_count() >= listeners, f"{listeners} do not listen"
        )
        since = len(self.observer.listen(topics.COMMANDS))
        publisher.publish(message)
        sender = "" if meant.row.frame else ASKER
        taken = self.observer.wait_for_command(meant.row.name, sender=sender, since=since)
        assert taken.state is not CommandState.REFUSED, taken
