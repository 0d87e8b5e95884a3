"""The ``descent_node`` executable: descends, takes pictures and ascends on request."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import partial

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, EventReport
from msg_schemas.faults import Reason
from msg_schemas.parameters import parameter
from msg_schemas.samples import (
    ImuSample,
    JointSample,
    JointValue,
    Level,
    Status,
    TextSample,
    WrenchSample,
)
from rover_control.coordination.winch_link import WinchLinkParameters
from rover_control.hanging.attitude import RotorParameters
from rover_control.hanging.descent import DescentCommands, DescentController
from rover_control.hanging.descent_parameters import DescentParameters
from rover_control.hanging.descent_report import observation_sample, state_sample
from rover_control.hanging.descent_requests import DescentRequests
from rover_control.hanging.descent_settings import DescentSettings
from rover_control.hanging.descent_stop import DescentStop
from rover_control.hanging.hanging_controller import HangingControllerParameters
from rover_runtime.component import Component, parts_of

_STOPS = (machine.OBSERVATION_STOP, machine.PLAIN_STOP)
_STOP_ENDS = (DescentEvent.STOP_COMPLETED, DescentEvent.STOP_FAILED, DescentEvent.STOP_ABORTED)
_TURN_ENDS = (
    DescentEvent.POINTING_REACHED,
    DescentEvent.POINTING_RELEASED,
    DescentEvent.POINTING_LOST,
)
_NUT_FORCE = 50.0  # force limit; clear of the latch the nut bears no load [N]


@dataclass(frozen=True)
class DescentNodeParameters:
    """Rates of the node, and its actuators."""

    command_rate: float = parameter(
        50.0, "Hz", "rate of control steps and drive commands", 20.0, 100.0,
        read_only=True,
    )  # fmt: skip
    state_rate: float = parameter(
        10.0, "Hz", "publishing rate of the estimates", 0.1, 50.0, read_only=True
    )
    uses_winch: bool = parameter(True, "-", "damp the swing by trimming the winch")
    uses_rotors: bool = parameter(True, "-", "use wheels and flywheel as reaction wheels")


class DescentNode(Component):
    """Moves the hanging rover from stop to stop, and images the wall from a steady rover."""

    NAME = "descent_node"
    PARAMETERS = (
        DescentNodeParameters,
        DescentParameters,
        WinchLinkParameters,
        *parts_of(HangingControllerParameters).values(),
    )

    def setup(self) -> None:
        """Open topics and services."""
        self._wheel_publisher = self.publisher(topics.WHEEL_COMMAND)
        self._flywheel_publisher = self.publisher(topics.FLYWHEEL_COMMAND)
        self._nut_publisher = self.publisher(topics.JUMP_MOTOR_COMMAND)
        self._winch_publisher = self.publisher(topics.WINCH_REQUEST)
        self._trim_publisher = self.publisher(topics.WINCH_TRIM)
        self._phase_publisher = self.publisher(topics.DESCENT_PHASE)
        self._state_publisher = self.publisher(topics.DESCENT_STATE)
        self._observation_publisher = self.publisher(topics.DESCENT_OBSERVATION)
        self._last_phases: dict[str, str] = {}
        self._begin()
        self.subscribe(topics.IMU, self._on_imu)
        self.subscribe(topics.WINCH_STATE, self._on_drum)
        self.subscribe(topics.WHEEL_STATE, self._on_wheels)
        self.subscribe(topics.FLYWHEEL_STATE, self._on_flywheel)
        self.subscribe(topics.LOAD_CELL, self._on_load_cell)
        self.subscribe(topics.CAMERA, self._on_camera)
        self.subscribe(topics.WINCH_MODE, self._on_winch_mode)
        self.subscribe(topics.JUMP_PHASE, partial(self._on_phase, topics.JUMP_PHASE))
        self.subscribe(topics.DRIVE_PHASE, partial(self._on_phase, topics.DRIVE_PHASE))
        self.serve(topics.DESCENT_HOLD, self._on_hold)
        self.serve(topics.DESCENT_RESUME, self._on_resume)
        self.serve(topics.DESCENT_ABORT, self._on_abort)
        self.serve(topics.DESCENT_RELEASE, self._on_release)
        self.subscribe(topics.DESCENT_REQUEST, self._on_request)

    @property
    def descent(self) -> DescentController:
        """Descent with its controller; another one after a jump of the clock."""
        return self._descent

    def start(self) -> None:
        """Drive nothing until a stop is requested."""
        self._begin()
        rates = self.parameters_of(DescentNodeParameters)
        self.every(1.0 / rates.command_rate, self._step)
        self.every(1.0 / rates.state_rate, self._publish_state)

    def stop(self) -> None:
        """Stop the winch, and switch the rotors' motors off."""
        self._send(self._descent.halt(), machine.WINCH_TO_LENGTH)
        self._publish_changes()

    def parameters_changed(self) -> None:
        """Apply new parameters: at once if nothing is driven, else after the release."""
        self._descent.retune(self._settings())

    def clock_jumped(self) -> None:
        """Stop and restart: all times are invalid."""
        self._send(self._descent.halt(), machine.WINCH_TO_LENGTH)
        self._publish_changes()
        mode = self._descent.link.mode
        self._begin()
        # Latched topics are not sent again.
        self._descent.on_winch_mode(mode, self.now_ns())
        for topic, phase in self._last_phases.items():
            self._descent.rotors.on_phase(topic, phase, self.now_ns())

    def waiting_for(self) -> tuple[str, ...]:
        """Sensors that have timed out; stops are refused without them."""
        return self._descent.waiting_for(self.now_ns())

    def health(self) -> tuple[Status, ...]:
        """Status of the phase, and of attitude axes in saturation."""
        if not self.active:
            return ()
        descent = self._descent
        axes = (descent.controller.wheels.axis, descent.controller.flywheel.axis)
        saturated = [axis.saturation for axis in axes if axis.saturation]
        level = Level.WARN if descent.interruption else Level.OK
        text = descent.phase + (f": {descent.interruption}" if descent.interruption else "")
        return (
            Status(f"{self.NAME}: descent", text, level, self.NAME),
            Status(
                f"{self.NAME}: attitude",
                "; ".join(saturated) or "within its budgets",
                Level.WARN if saturated else Level.OK,
                self.NAME,
            ),
        )

    # --- inputs ----------------------------------------------------------------------------------

    def _on_imu(self, sample: ImuSample) -> None:
        self._descent.on_imu(sample, self.now_ns())

    def _on_drum(self, sample: JointSample) -> None:
        self._descent.controller.on_drum(sample, self.now_ns())

    def _on_wheels(self, sample: JointSample) -> None:
        self._descent.on_wheels(sample, self.now_ns())

    def _on_flywheel(self, sample: JointSample) -> None:
        self._descent.on_flywheel(sample, self.now_ns())

    def _on_load_cell(self, sample: WrenchSample) -> None:
        self._descent.controller.on_load_cell(sample, self.now_ns())

    def _on_camera(self, sample: JointSample) -> None:
        self._descent.on_camera(sample)

    def _on_winch_mode(self, sample: TextSample) -> None:
        self._descent.on_winch_mode(sample.text, self.now_ns())

    def _on_phase(self, topic: str, sample: TextSample) -> None:
        self._last_phases[topic] = sample.text
        self._descent.rotors.on_phase(topic, sample.text, self.now_ns())

    def _on_request(self, sample: JointSample) -> None:
        ((name, (amount, rate, _)),) = sample.joints.items()
        if name == machine.HEADING_TURN:
            self._requests.turn(amount, self.now_ns())
            self.commands.begin()
        else:
            stop = DescentStop(depth=amount, observes=name == machine.OBSERVATION_STOP, rate=rate)
            self._requests.add_stop(stop, self.now_ns())
            self.commands.begin(queues=True)
            what = "an observation" if stop.observes else "a stop"
            values = {"depth": amount, "stops": len(self._descent.controller.profile.stops)}
            text = f"{what} at {amount:g} m"
            self.event(EventReport(DescentEvent.STOP_ACCEPTED, text, values))
        self._publish_changes()

    def _on_hold(self) -> tuple[bool, str]:
        return self._done(self._requests.hold(self.now_ns()))

    def _on_resume(self) -> tuple[bool, str]:
        answer = self._requests.resume(self.now_ns())
        self.commands.resume()
        return self._done(answer)

    def _on_abort(self) -> tuple[bool, str]:
        answer = self._done(self._requests.abort(self.now_ns()))
        self.commands.discard(Reason.REQUESTED, "aborted")
        return answer

    def _on_release(self) -> tuple[bool, str]:
        return self._done(self._requests.release())

    def _done(self, answer: str) -> tuple[bool, str]:
        self._step()
        return True, answer

    # --- outputs ---------------------------------------------------------------------------------

    def _begin(self) -> None:
        self._descent = DescentController(self._settings())
        self._requests = DescentRequests(self._descent)
        self._published_phase = ""
        self._publish_changes()

    def _settings(self) -> DescentSettings:
        own = self.parameters_of(DescentNodeParameters)
        settings = self.parameters_of(DescentSettings)
        hanging_controller = replace(
            settings.hanging_controller, uses_winch=own.uses_winch, uses_rotors=own.uses_rotors
        )
        return replace(settings, hanging_controller=hanging_controller)

    def _step(self) -> None:
        self._send(self._descent.step(self.now_ns()), machine.WINCH_WHILE_RENEWED)
        self._publish_changes()
        self.commands.progress(self._descent.phase, self._descent.distance)

    def _send(self, commands: DescentCommands, winch_joint: str) -> None:
        now_ns = self.now_ns()
        if commands.wheel_rate is not None:
            torque = self.parameters_of(RotorParameters).wheel_torque
            value = JointValue(0.0, commands.wheel_rate, torque)
            self._wheel_publisher.send(JointSample(now_ns, {machine.WHEEL_DRIVE: value}))
        if commands.flywheel_torque is not None:
            value = JointValue(effort=commands.flywheel_torque)
            self._flywheel_publisher.send(JointSample(now_ns, {machine.FLYWHEEL: value}))
        if commands.nut is not None:
            speed = self.parameters_of(DescentParameters).nut_speed
            value = JointValue(commands.nut, speed, _NUT_FORCE)
            self._nut_publisher.send(JointSample(now_ns, {machine.JUMP_SCREW: value}))
        if commands.winch is not None:
            value = JointValue(commands.winch.length, commands.winch.rate, 0.0)
            self._winch_publisher.send(JointSample(now_ns, {winch_joint: value}))
        if commands.trim is not None:
            value = JointValue(velocity=commands.trim)
            self._trim_publisher.send(JointSample(now_ns, {machine.WINCH_DRUM: value}))

    def _publish_changes(self) -> None:
        descent = self._descent
        for change in descent.take_changes():
            self.event(change, diagnoses=True)
            self._end_commands(change)
        if descent.phase != self._published_phase:
            self._published_phase = descent.phase
            self._phase_publisher.send(TextSample(descent.phase))
        for observation in descent.observations.take():
            self._observation_publisher.send(observation_sample(observation))

    def _end_commands(self, change: EventReport) -> None:
        reason = change.reason or Reason.COMPLETED
        if change.name in _STOP_ENDS:
            self.end_command(change, *_STOPS)
        elif change.name in _TURN_ENDS:
            self.end_command(change, machine.HEADING_TURN)
        elif change.name in (DescentEvent.INTERRUPTED, DescentEvent.HOLDING):
            self.end_command(change, machine.HEADING_TURN)
            self.commands.hold(reason, change.message)
        elif change.name is DescentEvent.RELEASED:
            self.commands.discard(reason, change.message)

    def _publish_state(self) -> None:
        sample = state_sample(self._descent, self.now_ns())
        if sample is not None:
            self._state_publisher.send(sample)


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(DescentNode)


if __name__ == "__main__":
    sys.exit(main())
