"""A node that does next to nothing: the shell of every node, to be tested from outside."""

import contextlib
import os
import resource
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msg_schemas import machine, topics
from msg_schemas.events import EventName, EventReport
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level, TextSample
from rover_runtime.component import Component
from rover_runtime.ros.process import run

_NOBODY = 65534


@dataclass(frozen=True)
class ShellNodeParameters:
    """One parameter of each kind."""

    rate: float = parameter(10.0, "Hz", "how often it speaks", 1.0, 100.0)
    count: int = parameter(3, "-", "how many", 1, 9, read_only=True)
    trouble: str = parameter(
        "none",
        "-",
        "what goes wrong",
        choices=("none", "value", "bug", "slow", "timer", "no_rights", "stuck"),
    )


class ShellEvent(EventName):
    """Events of this node."""

    MODE = "mode", Level.OK, "the winch's mode has changed", "mode"
    CHANGED = "changed", Level.OK, "parameters have changed", "now"
    CLOCK_JUMPED = "clock_jumped", Level.OK, "the clock has jumped"


class ShellNode(Component):
    """Says back what it is commanded."""

    NAME = "shell_node"
    PARAMETERS = (ShellNodeParameters,)

    def setup(self) -> None:
        trouble = self.parameters_of(ShellNodeParameters).trouble
        self._state = self.publisher(topics.JUMP_MOTOR_STATE)
        self.subscribe(topics.JUMP_MOTOR_COMMAND, self._on_command)
        self.subscribe(topics.WINCH_MODE, self._on_mode)
        self.serve(topics.JUMP_ABORT, self._on_abort)
        self.serve(topics.SIM_PAUSE, self._on_pause)
        if trouble == "value":
            raise ValueError("the setup found a wrong value")
        if trouble == "bug":
            raise RuntimeError("the setup has a bug")
        if trouble == "stuck":
            type(self).END_TIMEOUT = 5.0
        if trouble == "slow":
            print("setting up", flush=True)
            while True:
                self.check_shutdown()
                threading.Event().wait(0.02)

    def configuration(self) -> Mapping[str, Any]:
        # The last call before the activation: what follows imports no file of this user.
        if self.parameters_of(ShellNodeParameters).trouble == "no_rights" and os.geteuid() == 0:
            resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
            os.seteuid(_NOBODY)
        return {}

    def start(self) -> None:
        self.every(1.0 / self.parameters_of(ShellNodeParameters).rate, self._on_timer)

    def release(self) -> None:
        if self.parameters_of(ShellNodeParameters).trouble == "stuck":
            threading.Event().wait()

    def parameters_changed(self) -> None:
        values = {"now": self.now_ns()}
        self.event(EventReport(ShellEvent.CHANGED, "parameters changed", values))

    def clock_jumped(self) -> None:
        self.event(EventReport(ShellEvent.CLOCK_JUMPED, "the clock jumped"))

    def _on_timer(self) -> None:
        if self.parameters_of(ShellNodeParameters).trouble == "timer":
            raise RuntimeError("the timer has a bug")
        self._state.send(
            JointSample(self.now_ns(), {machine.JUMP_SCREW: JointValue(0.0, 0.0, 1.0)})
        )

    def _on_mode(self, sample: TextSample) -> None:
        self.event(EventReport(ShellEvent.MODE, "the mode has changed", {"mode": sample.text}))

    def _on_command(self, sample: JointSample) -> None:
        value = sample.joints[machine.JUMP_SCREW]
        if value.position > 0.3:
            reason = "only up to 0.3 m today"
            raise Refusal(topics.JUMP_MOTOR_COMMAND, RefusalCode.WRONG_PHASE, reason)
        self._state.send(JointSample(sample.stamp_ns, {machine.JUMP_SCREW: value}))

    def _on_abort(self) -> tuple[bool, str]:
        raise Refusal(topics.JUMP_ABORT, RefusalCode.WRONG_PHASE, "nothing to abort")

    def _on_pause(self, pause: bool) -> tuple[bool, str]:
        return True, f"pause is {pause}"


def _participants() -> int:
    """Participants of the middleware whose threads live."""
    count = 0
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it may end meanwhile
            count += (task / "comm").read_text().startswith("dds.ev")
    return count


if __name__ == "__main__":
    code = run(ShellNode)
    print(f"{_participants()} participants are left")
    sys.exit(code)
