"""``jump_node``: makes the rover jump, on request."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import partial

from msg_schemas import machine, topics
from msg_schemas.commands import CommandState, read_command
from msg_schemas.events import JumpEvent
from msg_schemas.parameters import parameter
from msg_schemas.phases import JumpPhase
from msg_schemas.samples import (
    ImuSample,
    JointSample,
    JointValue,
    Level,
    PoseEstimateSample,
    Status,
    StatusSample,
    TextSample,
    WrenchSample,
)
from rover_control.jump.jump_controller import JumpController, JumpSettings
from rover_control.jump.jump_report import flown_sample, prediction_sample
from rover_control.prediction.jump_prediction import (
    JumpPrediction,
    PredictionParameters,
    PredictionRequest,
)
from rover_control.prediction.prediction_work import load_model, predict_jump
from rover_runtime.component import Component, parts_of
from rover_runtime.port import Work
from rover_runtime.worker_process import WorkFailed

_ENDS = frozenset(
    {
        JumpEvent.PREDICTED,
        JumpEvent.REJECTED,
        JumpEvent.NOT_STARTED,
        JumpEvent.NO_TAKE_OFF,
        JumpEvent.ABORTED,
        JumpEvent.CANCELLED,
        JumpEvent.FAILED,
        JumpEvent.FAULT,
        JumpEvent.STANDBY,
        JumpEvent.RESET,
    }
)
"""Events that end a command."""
_COURSE = (
    JumpPhase.PREDICTING,
    JumpPhase.GIVING_SLACK,
    JumpPhase.COMPRESSING,
    JumpPhase.SETTLING,
    JumpPhase.RELEASING,
    JumpPhase.FLIGHT,
    JumpPhase.LANDED,
    JumpPhase.HOOKING,
)


@dataclass(frozen=True)
class JumpNodeParameters:
    """Rate of the node, and duration of a prediction."""

    command_rate: float = parameter(
        20.0, "Hz", "rate of the sequence and of the jump motor commands", 5.0, 200.0,
        read_only=True,
    )  # fmt: skip
    prediction_duration: float = parameter(
        2.0, "s", "simulated time of a prediction where simulated time waits", 0.0, 60.0,
        read_only=True,
    )  # fmt: skip


class JumpNode(Component):
    """ROS node of the jump controller."""

    NAME = "jump_node"
    PARAMETERS = (JumpNodeParameters, *parts_of(JumpSettings).values())

    def setup(self) -> None:
        """Create publishers, subscriptions and services."""
        self._begin()
        self._command_publisher = self.publisher(topics.JUMP_MOTOR_COMMAND)
        self._phase_publisher = self.publisher(topics.JUMP_PHASE)
        self._flown_publisher = self.publisher(topics.JUMP_FLOWN)
        self._prediction_publisher = self.publisher(topics.JUMP_PREDICTION)
        self._winch_publisher = self.publisher(topics.WINCH_REQUEST)
        self.subscribe(topics.CONTACT, self._on_contact)
        self.subscribe(topics.JUMP_MOTOR_STATE, self._on_jump_motor)
        self.subscribe(topics.IMU, self._on_imu)
        self.subscribe(topics.ROVER_LOAD_CELL, self._on_load_cell)
        self.subscribe(topics.POSE, self._on_pose)
        self.subscribe(topics.DRIVE_STATE, self._on_drive_state)
        self.subscribe(topics.WINCH_ESTIMATE, self._on_winch_estimate)
        self.subscribe(topics.DESCENT_PHASE, self._on_descent)
        self.subscribe(topics.COMMANDS, self._on_commands, depth=200)
        self.subscribe(topics.JUMP_REQUEST, self._on_request)
        self.serve(topics.JUMP_ABORT, self._on_abort)

    def start(self) -> None:
        """Start in standby."""
        self._begin()
        self._phase_publisher.send(TextSample(self._jump.phase))
        own = self.parameters_of(JumpNodeParameters)
        self.every(1.0 / own.command_rate, self._step)
        self._load_model()

    def parameters_changed(self) -> None:
        """Apply new parameters at once, also to a running jump; keeps the spring estimate."""
        self._jump.retune(self.parameters_of(JumpSettings))

    def clock_jumped(self) -> None:
        """Restart the controller: all its times are invalid."""
        self._jump.start_over(self.now_ns())
        self._publish_changes()

    def waiting_for(self) -> tuple[str, ...]:
        """Stale sensors, without which jumps are refused, and the model while it is loaded."""
        stale = self._jump.waiting_for(self.now_ns())
        is_loaded = self._loading is not None and self._loading.done()
        return stale if is_loaded else (*stale, "the prediction model")

    def health(self) -> tuple[Status, ...]:
        """Phase; ERROR in a fault."""
        if not self.active:
            return ()
        phase = self._jump.phase
        level = Level.ERROR if phase is JumpPhase.FAULT else Level.OK
        return (Status(f"{self.NAME}: sequence", phase.value, level, self.NAME),)

    def _begin(self) -> None:
        self._jump = JumpController(self.parameters_of(JumpSettings))
        self._loading: Work[None] | None = None  # of the model
        self._slack_requested_ns = 0
        self._running: tuple[PredictionRequest, Work[JumpPrediction]] | None = None

    # --- inputs ----------------------------------------------------------------------------------

    def _on_contact(self, sample: JointSample) -> None:
        self._jump.on_contact(sample, self.now_ns())

    def _on_jump_motor(self, sample: JointSample) -> None:
        self._jump.on_jump_motor(sample, self.now_ns())

    def _on_imu(self, sample: ImuSample) -> None:
        self._jump.on_imu(sample, self.now_ns())

    def _on_load_cell(self, sample: WrenchSample) -> None:
        self._jump.on_load_cell(sample, self.now_ns())

    def _on_pose(self, sample: PoseEstimateSample) -> None:
        self._jump.on_pose(sample)

    def _on_drive_state(self, sample: JointSample) -> None:
        self._jump.on_drive_state(sample)

    def _on_winch_estimate(self, sample: JointSample) -> None:
        self._jump.on_winch_estimate(sample)

    def _on_descent(self, sample: TextSample) -> None:
        self._jump.on_descent(sample.text, self.now_ns())

    def _on_commands(self, sample: StatusSample) -> None:
        """Process the end of the own request for slack, which its stamp identifies."""
        own = topics.WINCH_REQUEST, self.full_name, str(self._slack_requested_ns)
        for record in filter(None, map(read_command, sample.statuses)):
            if (record.subject, record.sender, record.identifier) == own and record.state.is_over:
                is_given = record.state is CommandState.DONE
                self._jump.on_slack_ended(record.text, is_given=is_given)

    def _on_request(self, sample: JointSample) -> None:
        self._jump.request(sample, self.now_ns())
        self.commands.begin()
        self._step()

    def _on_abort(self) -> tuple[bool, str]:
        done = self._jump.abort(self.now_ns())
        self._step()
        return True, done

    # --- outputs ---------------------------------------------------------------------------------

    def _step(self) -> None:
        now_ns = self.now_ns()
        self._predict(now_ns)
        command = self._jump.step(now_ns)
        if command is not None:
            joints = {
                machine.JUMP_SCREW: JointValue(command.compression, command.rate, command.force),
                machine.JUMP_LATCH: JointValue(float(command.trips)),
            }
            self._command_publisher.send(JointSample(now_ns, joints))
        self._publish_changes()
        phase = self._jump.phase
        left = len(_COURSE) - _COURSE.index(phase) if phase in _COURSE else math.nan
        self.commands.progress(phase.value, left)

    def _predict(self, now_ns: int) -> None:
        """Start a requested prediction and deliver a finished one."""
        parameters = self.parameters_of(PredictionParameters)
        prediction_request = self._jump.take_prediction_request()
        if prediction_request is not None:
            predict = partial(predict_jump, parameters, prediction_request, self._jump.spring)
            duration = self.parameters_of(JumpNodeParameters).prediction_duration
            self._running = (prediction_request, self.work(duration, predict))
        if self._running is not None and self._running[1].done():
            prediction_request, work = self._running
            self._running = None
            try:
                prediction = work.result()
            except WorkFailed as failure:
                self._jump.on_prediction_failed(prediction_request, str(failure))
                self._load_model()  # its process may have died
            else:
                self._prediction_publisher.send(prediction_sample(prediction, now_ns))
                self._jump.on_prediction(prediction_request, prediction, now_ns)
        slack = self._jump.take_slack_request()
        if slack is not None:
            self._slack_requested_ns = now_ns
            self._winch_publisher.send(
                JointSample(now_ns, {machine.WINCH_SLACK: JointValue(slack)})
            )

    def _load_model(self) -> None:
        load = partial(load_model, self.parameters_of(PredictionParameters))
        self._loading = self.work(0.0, load)

    def _publish_changes(self) -> None:
        for change in self._jump.take_transitions():
            self._phase_publisher.send(TextSample(change.phase.value))
            self.event(change.event, diagnoses=True)
            if change.event.name in _ENDS:
                self.end_command(change.event)
        for record in self._jump.take_records():
            self._flown_publisher.send(flown_sample(record))


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(JumpNode)


if __name__ == "__main__":
    sys.exit(main())
