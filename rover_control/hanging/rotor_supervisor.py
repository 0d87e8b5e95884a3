"""Supervision of the rotors' commands: from other controllers, over late samples, to rest. Pure.

Jump and drive use the same motors. A rotor that has coasted is commanded from its measured rate on.
While the gyro's samples are late the rotors do not follow them. After a release, and while another
controller uses the jump motor, the wheels ramp to rest.
"""

from __future__ import annotations

import math

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, EventReport
from msg_schemas.phases import JumpPhase
from msg_schemas.samples import ImuSample, JointSample
from rover_control.coordination.motor_handover import MotorHandover
from rover_control.hanging.descent_settings import DescentSettings
from rover_control.hanging.hanging_controller import ActuatorCommands

_NANO = 1e9
_NO_JUMP = frozenset({"", *(phase for phase in JumpPhase if phase.is_over)})


class RotorSupervisor:
    """Decides what of the hanging controller's commands the rotors' motors receive.

    Args:
        settings: of the descent.
        changes: list that receives the events.

    Attributes:
        motors: handover of the motors between the controllers.
        wheel_rate: last commanded rate of the left wheel [rad/s].
    """

    def __init__(self, settings: DescentSettings, changes: list[EventReport]) -> None:
        self.settings = settings
        self.motors = MotorHandover()
        self.wheel_rate = 0.0
        self._changes = changes
        self._jump = ""
        self._measured_wheel_rate = 0.0  # of the left wheel [rad/s]
        self._coasts = False  # no rotor command is sent
        self._imu_ns = 0  # stamp of the newest sample
        self.reset()

    def reset(self) -> None:
        """Follow the controller at once, as after a start."""
        self._late_until = -math.inf  # the rotors do not follow the gyro until then [s]
        self._is_late = False
        self._is_joining = False  # the wheel begins to follow its setpoint
        self._offset = 0.0  # of a joining wheel from its setpoint [rad/s]

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Update with an IMU sample."""
        self._imu_ns = sample.stamp_ns or now_ns

    def on_wheels(self, sample: JointSample) -> None:
        """Update with the wheel rates."""
        self._measured_wheel_rate = sample.joints[machine.WHEEL_LEFT].velocity

    def on_phase(self, topic: str, phase: str, now_ns: int) -> None:
        """Update with the phase of jump or drive, which use the same motors."""
        if topic == topics.JUMP_PHASE:
            self._jump = phase
        self.motors.on_phase(topic, phase, now_ns / _NANO)

    def conflict(self) -> str:
        """Which other controller uses the motors, and what to do; empty = none."""
        if self._jump not in _NO_JUMP:
            return f"a jump is in progress ({self._jump}) and uses the motor; wait for its end"
        if self.motors.is_used_by(topics.DRIVE_PHASE):
            return f"the rover is driving and uses the wheels; call {topics.DRIVE_STOP} first"
        return ""

    def step(
        self, commands: ActuatorCommands, h: float, now: float
    ) -> tuple[float | None, float | None]:
        """Return wheel rate [rad/s] and flywheel torque [N m] to send; None = nothing.

        A delayed command would excite the tilt instead of damping it.

        Args:
            commands: of the hanging controller.
            h: time since the last step [s].
            now: [s].
        """
        rate, torque = commands.wheel_rate, commands.flywheel_torque
        if rate is None or torque is None:
            self._coasts = True
            return None, None
        if self._coasts:
            # The wheel has coasted: continue from its measured rate.
            self.wheel_rate = self._measured_wheel_rate
            self._coasts, self._is_joining = False, True
        self._judge_delay(h, now)
        if self._is_late:
            return self.wheel_rate, 0.0
        self.wheel_rate = self._join(rate, h)
        return self.wheel_rate, torque

    def _join(self, setpoint: float, h: float) -> float:
        """Rate of a wheel that follows its setpoint at once, with an offset that ramps to zero.

        A ramp to the setpoint itself would not reach one that swings faster than the ramp.
        """
        if self._is_joining:
            self._offset, self._is_joining = self.wheel_rate - setpoint, False
        if self._offset == 0.0:
            return setpoint
        change = self.settings.hanging_controller.rotors.wheel_acceleration * h
        self._offset -= min(max(self._offset, -change), change)
        # No wheel is driven forward: the ratchet of the other one would engage.
        return min(setpoint + self._offset, max(self.wheel_rate, 0.0))

    def _judge_delay(self, h: float, now: float) -> None:
        p = self.settings.descent
        delay = max(now - self._imu_ns / _NANO, h)
        if delay > p.max_gyro_delay:
            self._late_until = now + p.gyro_delay_recovery
        was_late, self._is_late = self._is_late, now < self._late_until
        if self._is_late and not was_late:
            text = (
                f"the gyro sample is {delay:.2g} s old, the limit is {p.max_gyro_delay:g} s; the "
                "rotors do not follow it"
            )
            self._changes.append(EventReport(DescentEvent.ROTORS_SUSPENDED, text))
        elif was_late and not self._is_late:
            text = "the gyro samples are in time again"
            self._changes.append(EventReport(DescentEvent.ROTORS_RESUMED, text))
            self._is_joining = True

    def spin_down(self, h: float, now: float) -> tuple[float | None, float | None]:
        """Ramp the left wheel to rest without a setpoint; the flywheel coasts.

        The wheel also ramps while the jump motor is another's, as when the spring is let down: a
        drive that is left turning would stop by its command timeout, as a fault. A wheel that
        coasts or drives has no command to ramp down.

        Args:
            h: time since the last step [s].
            now: [s].

        Returns:
            Wheel rate [rad/s] and flywheel torque [N m]; None = nothing.
        """
        self._is_joining = True
        if self._coasts or self.motors.is_used_by(topics.DRIVE_PHASE):
            self.wheel_rate = 0.0
        rate = self.wheel_rate
        if rate == 0.0:
            return None, None
        change = self.settings.hanging_controller.rotors.wheel_acceleration * min(max(h, 0.0), 0.1)
        self.wheel_rate = math.copysign(max(abs(rate) - change, 0.0), rate)
        return self.wheel_rate, 0.0 if self.motors.may_command(now) else None
