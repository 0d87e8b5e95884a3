"""The ``jump_node`` executable: jumps on request, through the jump motor."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from msg_schemas import topics
from msg_schemas.node import ContractNode
from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from msg_schemas.samples import (
    ImuSample,
    JointSample,
    JointValue,
    Level,
    Status,
    TextSample,
)
from msg_schemas.table import JUMP_SCREW, JUMP_STROKE
from rover_control.jump_sequence import JumpParameters, JumpPhase, JumpSequence, Sensors


@dataclass(frozen=True)
class JumpNodeParameters:
    """How often the node acts."""

    command_rate: float = parameter(
        20.0, "Hz", "how often the sequence is stepped and the jump motor told", 5.0, 200.0,
        read_only=True,
    )  # fmt: skip


class JumpNode(ContractNode):
    """Jumps on request: compresses the spring, follows take-off, flight and landing."""

    NAME = "jump_node"
    PARAMETERS = (JumpNodeParameters, JumpParameters)

    def setup(self) -> None:
        """Open topics and services."""
        self._sensors = Sensors()
        self._sequence = JumpSequence(self.parameters_of(JumpParameters))
        self._command_outlet = self.publisher(topics.JUMP_MOTOR_COMMAND)
        self._phase_outlet = self.publisher(topics.JUMP_PHASE)
        self.subscribe(topics.CONTACT, self._on_contact)
        self.subscribe(topics.JUMP_MOTOR_STATE, self._on_jump_motor)
        self.subscribe(topics.IMU, self._on_imu)
        self.subscribe(topics.JUMP_REQUEST, self._on_request)
        self.serve(topics.JUMP_ABORT, self._on_abort)

    def start(self) -> None:
        """Stand by."""
        self._sensors = Sensors()
        self._sequence = JumpSequence(self.parameters_of(JumpParameters))
        self._phase_outlet.send(TextSample(self._sequence.phase))
        self.every(1.0 / self.parameters_of(JumpNodeParameters).command_rate, self._step)

    def parameters_changed(self) -> None:
        """Take new limits; a jump that runs keeps to them at once."""
        if self.active:
            self._sequence.parameters = self.parameters_of(JumpParameters)

    def clock_jumped(self) -> None:
        """Start over: what was timed means nothing any more."""
        if self.active:
            self._sensors = Sensors()
            self._sequence.clock_jumped(self.now_ns())
            self._tell_transitions()

    def waiting_for(self) -> tuple[str, ...]:
        """The sensors that are silent: a jump is refused until they are heard."""
        return self._sequence.waiting_for(self._sensors, self.now_ns())

    def health(self) -> tuple[Status, ...]:
        """The phase; a fault is an error."""
        if not self.active:
            return ()
        phase = self._sequence.phase
        level = Level.ERROR if phase is JumpPhase.FAULT else Level.OK
        return (Status(f"{self.NAME}: sequence", phase.value, level, self.NAME),)

    def _on_contact(self, sample: JointSample) -> None:
        self._sensors = self._sensors.with_contact(sample, self.now_ns())

    def _on_jump_motor(self, sample: JointSample) -> None:
        self._sensors = self._sensors.with_jump_motor(sample, self.now_ns())

    def _on_imu(self, sample: ImuSample) -> None:
        self._sensors = self._sensors.with_imu(sample, self.now_ns())

    def _on_request(self, sample: JointSample) -> None:
        stroke, speed, _ = sample.joints[JUMP_STROKE]
        self._sequence.request(stroke, speed, self._sensors, self.now_ns())
        self._step()

    def _on_abort(self) -> tuple[bool, str]:
        done = self._sequence.abort(self._sensors, self.now_ns())
        self._step()
        return True, done

    def _step(self) -> None:
        now_ns = self.now_ns()
        command = self._sequence.step(self._sensors, now_ns)
        if command is not None:
            self._command_outlet.send(JointSample(now_ns, {JUMP_SCREW: JointValue(*command)}))
        self._tell_transitions()

    def _tell_transitions(self) -> None:
        for change in self._sequence.take_transitions():
            self._phase_outlet.send(TextSample(change.phase.value))
            name = f"jump_{change.phase.value}"
            self.event(name, change.reason, change.level, change.values)
            if change.level is not Level.OK:
                self.report(Status(f"{self.NAME}: {name}", change.reason, change.level, self.NAME))


def main() -> int:
    """Run the node."""
    return run(JumpNode)


if __name__ == "__main__":
    sys.exit(main())
