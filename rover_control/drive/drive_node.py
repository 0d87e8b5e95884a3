"""``drive_node``: drives the rover on the floor, on request."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from msg_schemas import machine, topics
from msg_schemas.events import DriveEvent, EventReport
from msg_schemas.parameters import parameter
from msg_schemas.phases import DrivePhase
from msg_schemas.samples import (
    ImuSample,
    JointSample,
    JointValue,
    Level,
    PathSample,
    PoseEstimateSample,
    PoseSample,
    Status,
    TextSample,
    TwistSample,
)
from rover_control.drive.drive_controller import STEERING_TIMEOUT, DriveController, WheelCommands
from rover_control.drive.drive_report import odometry_sample, pose_sample, state_sample
from rover_control.drive.drive_requests import DriveRequests
from rover_control.drive.drive_settings import DriveSettings
from rover_runtime.component import Component, parts_of

_ENDS = (DriveEvent.COMPLETED, DriveEvent.STOPPED, DriveEvent.STUCK, DriveEvent.FAILED)
"""Events that end a command."""


@dataclass(frozen=True)
class DriveNodeParameters:
    """Rates of the node and the torque limit of the wheel motor."""

    command_rate: float = parameter(
        50.0, "Hz", "rate of the control loop and of the wheel commands", 10.0, 100.0,
        read_only=True,
    )  # fmt: skip
    odometry_rate: float = parameter(
        20.0, "Hz", "publishing rate of odometry and pose", 0.1, 100.0, read_only=True
    )
    state_rate: float = parameter(
        10.0, "Hz", "publishing rate of the drive state", 0.1, 50.0, read_only=True
    )
    wheel_torque: float = parameter(
        2.0, "N m", "torque limit sent with each wheel command", 0.1, 20.0
    )


class DriveNode(Component):
    """ROS node of the drive controller."""

    NAME = "drive_node"
    PARAMETERS = (DriveNodeParameters, *parts_of(DriveSettings).values())

    def setup(self) -> None:
        """Create publishers, subscriptions and services."""
        self._wheel_publisher = self.publisher(topics.WHEEL_COMMAND)
        self._winch_publisher = self.publisher(topics.WINCH_REQUEST)
        self._phase_publisher = self.publisher(topics.DRIVE_PHASE)
        self._state_publisher = self.publisher(topics.DRIVE_STATE)
        self._odometry_publisher = self.publisher(topics.ODOMETRY)
        self._pose_publisher = self.publisher(topics.POSE)
        self._begin()
        self.subscribe(topics.IMU, self._on_imu)
        self.subscribe(topics.WHEEL_STATE, self._on_wheels)
        self.subscribe(topics.MOTOR_CURRENTS, self._on_currents)
        self.subscribe(topics.CONTACT, self._on_contact)
        self.subscribe(topics.WINCH_ESTIMATE, self._on_winch_estimate)
        self.subscribe(topics.WINCH_MODE, self._on_winch_mode)
        self.subscribe(topics.JUMP_PHASE, self._on_jump)
        self.subscribe(topics.JUMP_FLOWN, self._on_flown)
        self.subscribe(topics.DESCENT_PHASE, self._on_descent)
        self.serve(topics.DRIVE_STOP, self._on_stop)
        self.subscribe(topics.DRIVE_START, self._on_start_pose)
        self.subscribe(topics.DRIVE_GOAL, self._on_goal)
        self.subscribe(topics.DRIVE_PATH, self._on_path)
        self.subscribe(topics.CMD_VEL, self._on_twist)

    def start(self) -> None:
        """Start the control loop; nothing moves until a request arrives."""
        self._begin()
        rates = self.parameters_of(DriveNodeParameters)
        self.every(1.0 / rates.command_rate, self._step)
        self.every(1.0 / rates.odometry_rate, self._publish_odometry)
        self.every(1.0 / rates.state_rate, self._publish_state)

    def stop(self) -> None:
        """Stop the wheels; the winch holds its tension until the request times out."""
        self._send(self._drive.halt())
        self._publish_changes()

    def parameters_changed(self) -> None:
        """Apply new parameters if the rover is at rest; keeps the pose."""
        if self._drive.wheels.is_driving:
            text = "the rover is driving: new parameters apply after the next start of the node"
            self.report(Status(f"{self.NAME}: parameters", text, Level.WARN, self.NAME))
            return
        before = self._drive
        self._begin()
        self._drive.continue_from(before)

    def clock_jumped(self) -> None:
        """Restart the controller at the present pose: all its times are invalid."""
        self._send(self._drive.halt())
        self._publish_changes()
        before = self._drive
        self._begin()
        self._drive.continue_from(before)

    def waiting_for(self) -> tuple[str, ...]:
        """Stale sensors; requests are refused until their samples arrive."""
        return self._drive.sensors.waiting_for(self.now_ns())

    def health(self) -> tuple[Status, ...]:
        """Phase, and why the last drive ended early."""
        if not self.active:
            return ()
        reason = self._end_reason
        level = Level.WARN if reason else Level.OK
        text = self._drive.wheels.phase.value + (f": {reason}" if reason else "")
        return (Status(f"{self.NAME}: drive", text, level, self.NAME),)

    # --- inputs ----------------------------------------------------------------------------------

    def _on_imu(self, sample: ImuSample) -> None:
        self._drive.sensors.on_imu(sample, self.now_ns())

    def _on_wheels(self, sample: JointSample) -> None:
        self._drive.sensors.on_wheels(sample, self.now_ns())

    def _on_currents(self, sample: JointSample) -> None:
        self._drive.sensors.on_currents(sample, self.now_ns())

    def _on_contact(self, sample: JointSample) -> None:
        self._drive.sensors.on_contact(sample, self.now_ns())

    def _on_winch_estimate(self, sample: JointSample) -> None:
        self._drive.sensors.on_winch_estimate(sample, self.now_ns())

    def _on_winch_mode(self, sample: TextSample) -> None:
        self._last_winch_mode = sample.text
        self._drive.tether.on_mode(sample.text)

    def _on_jump(self, sample: TextSample) -> None:
        self._last_jump_phase = sample.text
        self._drive.on_jump(sample.text)
        self._publish_changes()

    def _on_flown(self, sample: JointSample) -> None:
        self._drive.sensors.on_flown(sample)

    def _on_descent(self, sample: TextSample) -> None:
        self._last_descent_phase = sample.text
        self._drive.wheels.on_descent(sample.text, self.now_ns())

    def _on_start_pose(self, sample: PoseEstimateSample) -> None:
        self._requests.set_pose(sample)
        pose = self._drive.odometry.pose
        values = {"x": pose.x, "y": pose.y, "heading": pose.heading}
        text = f"at ({pose.x:.3f}, {pose.y:.3f}) m, heading {pose.heading:.3f} rad"
        self.event(EventReport(DriveEvent.POSE_SET, text, values))

    def _on_goal(self, sample: PoseSample) -> None:
        self._requests.go_to(sample, self.now_ns())
        self.commands.begin()
        self._publish_changes()

    def _on_path(self, sample: PathSample) -> None:
        self._requests.follow_path(sample, self.now_ns())
        self.commands.begin()
        self._publish_changes()

    def _on_twist(self, sample: TwistSample) -> None:
        before, was_driving = self._drive.wheels.phase, self._drive.wheels.is_driving
        self._requests.steer(sample, self.now_ns())
        if self._drive.wheels.phase is DrivePhase.STEERED:
            self.commands.begin(expiry=STEERING_TIMEOUT, renews=before is DrivePhase.STEERED)
        elif not was_driving:
            self.commands.drop()  # no speed is requested of a rover at rest
        self._publish_changes()

    def _on_stop(self) -> tuple[bool, str]:
        message = self._requests.stop(self.now_ns())
        self._publish_changes()
        return True, message

    # --- outputs ---------------------------------------------------------------------------------

    _last_winch_mode = _last_jump_phase = _last_descent_phase = ""

    def _begin(self) -> None:
        self._drive = DriveController(self.parameters_of(DriveSettings))
        self._requests = DriveRequests(self._drive)
        # Latched topics are not sent again.
        self._drive.tether.on_mode(self._last_winch_mode)
        self._drive.on_jump(self._last_jump_phase)
        self._drive.wheels.on_descent(self._last_descent_phase, self.now_ns())
        self._published_phase = self._end_reason = ""
        self._publish_changes()

    def _step(self) -> None:
        self._send(self._drive.step(self.now_ns()))
        self._publish_changes()
        self.commands.progress(distance=self._drive.distance)

    def _send(self, drives: WheelCommands) -> None:
        now_ns = self.now_ns()
        if drives.wheel_rate is not None:
            torque = self.parameters_of(DriveNodeParameters).wheel_torque
            value = JointValue(0.0, drives.wheel_rate, torque)
            self._wheel_publisher.send(JointSample(now_ns, {machine.WHEEL_DRIVE: value}))
        if drives.winch is not None:
            request = drives.winch
            value = JointValue(request.position, request.velocity, request.effort)
            self._winch_publisher.send(JointSample(now_ns, {request.joint: value}))

    def _publish_changes(self) -> None:
        for change in self._drive.follower.take_changes():
            self.event(change)
            self._end_reason = change.message if change.level is not Level.OK else ""
            if change.name in _ENDS:
                self.end_command(change)
        phase = self._drive.wheels.phase
        if phase.is_over and self._drive.wheels.is_commanded:
            return  # the phase releases the wheels
        if phase.value != self._published_phase:
            self._published_phase = phase.value
            self._phase_publisher.send(TextSample(phase.value))

    def _publish_odometry(self) -> None:
        now_ns = self.now_ns()
        self._odometry_publisher.send(odometry_sample(self._drive, now_ns))
        self._pose_publisher.send(pose_sample(self._drive, now_ns))

    def _publish_state(self) -> None:
        self._state_publisher.send(state_sample(self._drive, self.now_ns()))


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(DriveNode)


if __name__ == "__main__":
    sys.exit(main())
