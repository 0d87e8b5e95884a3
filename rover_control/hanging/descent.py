"""Descent service: supervision of the hanging controller. Pure.

It drives nothing before the first stop and after a release. While a stop is in progress, a sensor
timeout, or a winch that another node moves, holds or stops, interrupts the descent: it holds with a
reason until `resume`. Each picture is published with the camera's report once that is received.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import DescentEvent, EventReport
from msg_schemas.faults import Reason
from msg_schemas.machine import FLYWHEEL, SMEAR, WALL_DISTANCE, WHEEL_LEFT, WINCH_DRUM
from msg_schemas.phases import DescentPhase, JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, WrenchSample
from rover_control.coordination.motor_handover import MotorHandover
from rover_control.coordination.winch_link import FREE, WinchLink, WinchLinkParameters, WinchRequest
from rover_control.hanging.attitude import FlywheelReaction, WheelReaction
from rover_control.hanging.descent_parameters import DescentParameters
from rover_control.hanging.descent_profile import SUBJECT, DescentStop
from rover_control.hanging.hanging_controller import (
    NO_COMMANDS,
    ActuatorCommands,
    Exposure,
    HangingController,
    HangingControllerParameters,
)
from rover_control.hanging.pointing import SUBJECT as POINTING

_NANO = 1e9
_NO_JUMP = frozenset({"", *(phase for phase in JumpPhase if phase.is_over)})
_CLEAR_FRACTION = 0.2  # fraction of the travel about its middle in which the nut is clear


@dataclass(frozen=True)
class DescentSettings:
    """All parameters of a descent."""

    descent: DescentParameters = field(default_factory=DescentParameters)
    link: WinchLinkParameters = field(default_factory=WinchLinkParameters)
    hanging_controller: HangingControllerParameters = field(
        default_factory=HangingControllerParameters
    )


class Observation(NamedTuple):
    """A picture with the camera's report."""

    number: int  # since the start, from 1
    exposure: Exposure
    smear: float  # [px]; NaN = no report
    wall_distance: float  # [m]; NaN = no report


class DescentCommands(NamedTuple):
    """Commands to send; None = nothing."""

    wheel_rate: float | None = None  # of the left wheel [rad/s]
    flywheel_torque: float | None = None  # [N m]
    winch: WinchRequest | None = None  # to be renewed
    trim: float | None = None  # [m/s]
    nut: float | None = None  # position setpoint of the jump motor's nut [m]


class DescentController:
    """Hanging controller with its supervision."""

    def __init__(self, settings: DescentSettings) -> None:
        self.settings = settings
        self.length = math.nan
        self.screw = math.nan  # screw angle [rad]
        self._is_retuned = False  # new parameters wait for the release
        self._pictures = 0
        self._pending: deque[Observation] = deque()
        self._completed: list[Observation] = []
        self._changes: list[EventReport] = []
        self._jump = ""
        self._motors = MotorHandover()
        self._mode = ""
        self._commanded_wheel_rate = 0.0  # of the left wheel [rad/s]
        self._measured_wheel_rate = 0.0  # of the left wheel [rad/s]
        self._stepped_ns = 0
        self._clearing_since: float | None = None  # start of driving the nut clear [s]
        self._imu_ns = 0  # stamp of the newest sample
        self._reset(0.0)

    def _reset(self, twist: float) -> None:
        settings = self.settings
        self._is_retuned = False
        self.controller = HangingController(settings.hanging_controller)
        self.controller.twist = twist
        self.controller.on_winch_mode(self._mode)
        self.link = WinchLink(settings.link, settings.hanging_controller.profile.depth_tolerance)
        self.link.on_mode(self._mode, -math.inf)
        self.is_engaged = False
        self._winch_is_released = True  # no request is sent to the winch
        self._silent_steps = 0
        self._fresh_since = -math.inf  # all sensors, after a timeout [s]
        self._late_until = -math.inf  # the rotors do not follow the gyro until then [s]
        self._is_late = False
        self._rotors_coast = False  # no rotor command is sent
        self._wheel_is_ramping = False  # the wheel ramps to its setpoint
        self.interruption = ""  # reason of a hold without a request

    # --- state -----------------------------------------------------------------------------------

    @property
    def phase(self) -> str:
        """Phase; value of the contract. The motors are released when the wheels have stopped."""
        if self.is_engaged:
            return self.controller.profile.phase.value
        stands = self._commanded_wheel_rate == 0.0
        return DescentPhase.RELEASED if stands else DescentPhase.STANDBY

    @property
    def stops_left(self) -> int:
        """Number of stops after the present one."""
        return len(self.controller.profile.stops)

    @property
    def distance(self) -> float:
        """Length left to the present stop [m]; NaN without one."""
        stop = self.controller.profile.stop
        return math.nan if stop is None else abs(stop.depth - self.length)

    @property
    def is_busy(self) -> bool:
        """Whether an activity is in progress that needs sensors and winch."""
        profile = self.controller.profile
        held = profile.phase is DescentPhase.HOLDING
        return self.is_engaged and not profile.is_idle and not held

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics that have timed out, and the winch's mode if it was never received."""
        missing = self.controller.waiting_for(now_ns)
        return missing if self._mode else (*missing, topics.WINCH_MODE)

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call, and clear them."""
        taken, self._changes = self._changes, []
        return taken + self.controller.take_changes()

    def take_observations(self) -> list[Observation]:
        """Return the pictures completed since the last call, and clear them."""
        taken, self._completed = self._completed, []
        return taken

    # --- sensors ---------------------------------------------------------------------------------

    def on_drum(self, sample: JointSample, now_ns: int) -> None:
        """Update with the state of drum and brake."""
        self.length = sample.joints[WINCH_DRUM].position
        self.controller.on_drum(sample, now_ns)

    def on_wheels(self, sample: JointSample, now_ns: int) -> None:
        """Update with the wheel rates."""
        self._measured_wheel_rate = sample.joints[WHEEL_LEFT].velocity
        self.controller.on_wheels(sample, now_ns)

    def on_flywheel(self, sample: JointSample, now_ns: int) -> None:
        """Update with angle and rate of the flywheel."""
        self.screw = sample.joints[FLYWHEEL].position
        self.controller.on_flywheel(sample, now_ns)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Update with an IMU sample."""
        self._imu_ns = sample.stamp_ns or now_ns
        self.controller.on_imu(sample, now_ns)

    def on_winch_mode(self, mode: str, now_ns: int) -> None:
        """Update with the mode of the winch."""
        self._mode = mode
        self.controller.on_winch_mode(mode)
        self.link.on_mode(mode, now_ns / _NANO)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Update with the tension at the fairlead."""
        self.controller.on_load_cell(sample, now_ns)

    def on_phase(self, topic: str, phase: str, now_ns: int) -> None:
        """Update with the phase of jump or drive, which use the same motors."""
        if topic == topics.JUMP_PHASE:
            self._jump = phase
        self._motors.on_phase(topic, phase, now_ns / _NANO)

    def on_camera(self, sample: JointSample) -> None:
        """Complete the pictures that the camera's report covers."""
        self.controller.on_camera(sample)
        smear, wall = (sample.joints[name].position for name in (SMEAR, WALL_DISTANCE))
        ready = sample.stamp_ns - round(self.settings.descent.exposure_latency * _NANO)
        while self._pending and round(self._pending[0].exposure.time * _NANO) <= ready:
            done = self._pending.popleft()
            self._completed.append(done._replace(smear=smear, wall_distance=wall))

    # --- requests --------------------------------------------------------------------------------

    def request(self, stop: DescentStop, now_ns: int) -> None:
        """Add a stop; the first one engages the drives.

        Raises:
            Refusal: out of limits, during a jump or drive, or the controller refuses.
        """
        p = self.settings.descent
        if not p.min_depth <= stop.depth <= p.max_depth:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.OUT_OF_LIMITS,
                f"depth is {stop.depth!r} m, it must be {p.min_depth:g} .. {p.max_depth:g} m",
            )
        self._check_rotors(now_ns)
        with _refusals_as(topics.DESCENT_REQUEST):
            self.controller.request(stop, now_ns)
        self._engage("stop requested")
        self._acquire_winch()

    def turn(self, angle: float, now_ns: int) -> None:
        """Turn about the plumb line by an angle [rad], and hold the heading until another request.

        Raises:
            Refusal: stops are left, during a jump or drive, or the heading cannot be reached or
                held.
        """
        self._check_rotors(now_ns)
        with _refusals_as(topics.DESCENT_REQUEST):
            self.controller.point(angle, now_ns)
        self._engage("heading requested")

    @property
    def _lead_per_radian(self) -> float:
        """Lead of the screw [m/rad]."""
        return self.settings.descent.screw_lead / math.tau

    def _engage(self, reason: str) -> None:
        if not self.is_engaged:
            self.is_engaged = True
            self._clearing_since = None
            self.controller.resume_estimation()
            self._changes.append(EventReport(DescentEvent.ENGAGED, reason))

    def _check_rotors(self, now_ns: int) -> None:
        if self._jump not in _NO_JUMP:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"a jump is in progress ({self._jump}) and uses the motor; wait for its end",
            )
        if self._motors.is_used_by(topics.DRIVE_PHASE):
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the rover is driving and uses the wheels; call {topics.DRIVE_STOP} first",
            )
        nut = self.screw * self._lead_per_radian
        most = self.settings.descent.nut_unloaded_position
        if self.settings.hanging_controller.uses_rotors and nut > most:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the nut is at {nut:.4g} m and may bear the spring, the limit is {most:g} m; "
                f"{topics.JUMP_ABORT} relaxes the spring",
            )
        self._check_sensors(topics.DESCENT_REQUEST, now_ns)

    def hold(self, now_ns: int) -> str:
        """Hold the present length.

        Raises:
            Refusal: the descent is released.
        """
        self._check_engaged(topics.DESCENT_HOLD)
        return self.controller.hold(now_ns)

    def resume(self, now_ns: int) -> str:
        """Continue after a hold.

        Raises:
            Refusal: not held, a sensor has timed out, or the winch is in another mode.
        """
        self._check_engaged(topics.DESCENT_RESUME)
        self._check_sensors(topics.DESCENT_RESUME, now_ns)
        if self._mode not in FREE:
            raise Refusal(
                topics.DESCENT_RESUME,
                RefusalCode.NOT_ARMED,
                f"the winch is in {self._mode or 'no known mode'}, it must be in hold",
            )
        with _refusals_as(topics.DESCENT_RESUME):
            done = self.controller.resume(now_ns)
        self._acquire_winch()
        return done

    def abort(self, now_ns: int) -> str:
        """Drop all stops, stay, and release the heading."""
        self.interruption = ""
        self.controller.pointing.stop()
        return self.controller.abort(now_ns)

    def release(self) -> str:
        """Release the drives.

        Raises:
            Refusal: stops are left.
        """
        if self.is_engaged and not self.controller.profile.is_idle:
            raise Refusal(
                topics.DESCENT_RELEASE,
                RefusalCode.WRONG_PHASE,
                f"the descent is in {self.phase}; {topics.DESCENT_ABORT} drops the remaining stops",
            )
        if self.is_engaged:
            self._disengage("release requested", Reason.REQUESTED)
        return "winch, wheels and flywheel released"

    def retune(self, settings: DescentSettings) -> None:
        """Apply other parameters: at once if nothing is driven, else after the release."""
        self.settings = settings
        self._is_retuned = True
        if not self.is_engaged:
            self._reset(self.controller.twist)

    def _check_engaged(self, subject: str) -> None:
        if not self.is_engaged:
            raise Refusal(subject, RefusalCode.WRONG_PHASE, "no descent is in progress")

    def _check_sensors(self, subject: str, now_ns: int) -> None:
        missing = self.waiting_for(now_ns)
        if missing:
            raise Refusal(subject, RefusalCode.STALE, f"{', '.join(missing)} timed out")
        left = self.settings.hanging_controller.profile.estimator_settling_time - (
            now_ns / _NANO - self._fresh_since
        )
        if left > 0.0:
            text = f"a sensor had timed out, the swing estimate settles in {left:.1f} s"
            raise Refusal(subject, RefusalCode.STALE, text)

    def _acquire_winch(self) -> None:
        """Use the winch again, from its present length if another node has moved it."""
        self.interruption = ""
        if not self._winch_is_released:
            return
        self._winch_is_released = False
        profile = self.controller.profile
        if not abs(self.length - profile.length_setpoint) <= profile.parameters.depth_tolerance:
            profile.length_setpoint = math.nan

    def _release_winch(self) -> None:
        self._winch_is_released = True
        self.link.clear()

    def _disengage(self, text: str, reason: Reason) -> None:
        controller = self.controller
        if self._rotors_coast:
            self._commanded_wheel_rate = 0.0
        controller.pointing.stop()
        self._changes += controller.take_changes()
        if self._is_retuned:
            self._reset(controller.twist)
        else:
            # The rotors restart from rest; the rover may be set down from here on.
            p = controller.parameters
            controller.wheels = WheelReaction(p.hanging, p.rotors, p.design)
            controller.flywheel = FlywheelReaction(p.hanging, p.rotors, p.design)
            controller.pause_estimation()
            self.is_engaged = False
            self.interruption = ""
        self._changes.append(EventReport(DescentEvent.RELEASED, text, reason=reason))

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> DescentCommands:
        """Advance to now; returns the commands to send."""
        now = now_ns / _NANO
        h, self._stepped_ns = (now_ns - self._stepped_ns) / _NANO, now_ns
        while (
            self._pending
            and now - self._pending[0].exposure.time > self.settings.descent.camera_timeout
        ):
            self._completed.append(self._pending.popleft())
        if not self.is_engaged:
            # Renew the request of a winch that still comes to rest.
            request, _ = self._winch(NO_COMMANDS, now)
            return DescentCommands(*self._spin_down(h, now), request)
        self._check_sensor_timeout(now_ns)
        commands = self.controller.step(now_ns)
        if commands.exposure is not None:
            self._pictures += 1
            nan = math.nan
            self._pending.append(Observation(self._pictures, commands.exposure, nan, nan))
        is_handed_over = self._motors.may_command(now)
        drives = self.settings.hanging_controller.uses_rotors and is_handed_over
        nut = self._clear_nut(now) if drives else None
        rotors = self._rotors(commands if drives and nut is None else NO_COMMANDS, h, now)
        return DescentCommands(*rotors, *self._winch(commands, now), nut)

    def halt(self) -> DescentCommands:
        """Stop, and return the last commands to send."""
        if not self.is_engaged:
            return DescentCommands()
        uses = self.settings.hanging_controller.uses_rotors
        stops = not self._winch_is_released and self._mode == WinchMode.LENGTH
        request = WinchRequest(self.length, 0.0) if stops and math.isfinite(self.length) else None
        off = 0.0 if uses else None
        self.controller.abort(self._stepped_ns)
        self._disengage("the node stops", Reason.SHUTDOWN)
        self._commanded_wheel_rate = 0.0
        self._release_winch()
        return DescentCommands(off, off, request)

    def _check_sensor_timeout(self, now_ns: int) -> None:
        missing = self.controller.waiting_for(now_ns)
        # Count steps instead of time: a late step finds its sensor samples still queued.
        self._silent_steps = self._silent_steps + 1 if missing else 0
        if missing:
            self._fresh_since = now_ns / _NANO
        if self._silent_steps < self.settings.descent.sensor_timeout_steps:
            return
        reason = f"{', '.join(missing)} timed out"
        if self.is_busy:
            self._interrupt(reason, now_ns, Reason.SENSOR_TIMEOUT)
        elif self.controller.pointing.is_active:
            self.controller.pointing.stop()
            self._changes.append(
                EventReport(DescentEvent.POINTING_LOST, reason, reason=Reason.SENSOR_TIMEOUT)
            )

    def _clear_nut(self, now: float) -> float | None:
        """Nut position that frees its motor as a reaction wheel; None = it is clear."""
        rotors = self.settings.hanging_controller.rotors
        away = abs(self.screw - rotors.screw_travel_centre)
        if self._clearing_since is None and not away > rotors.screw_travel:
            return None
        if self._clearing_since is None:
            self._clearing_since = now
            text = "driving the nut clear of the latch"
            self._changes.append(EventReport(DescentEvent.NUT_CLEARING_STARTED, text))
        if away < _CLEAR_FRACTION * rotors.screw_travel:
            self._clearing_since = None
            text = "the jump motor now is a reaction wheel"
            self._changes.append(EventReport(DescentEvent.NUT_CLEARING_COMPLETED, text))
            return None
        timeout = self.settings.descent.nut_timeout
        if self.is_busy and now - self._clearing_since > timeout:
            self._clearing_since = now
            text = f"the nut is not clear of the latch after {timeout:g} s"
            self._interrupt(text, round(now * _NANO), Reason.TIME_LIMIT)
        return rotors.screw_travel_centre * self._lead_per_radian

    def _rotors(
        self, commands: ActuatorCommands, h: float, now: float
    ) -> tuple[float | None, float | None]:
        """Rotor commands; a delayed one would excite the tilt instead of damping it."""
        rate, torque = commands.wheel_rate, commands.flywheel_torque
        if rate is None or torque is None:
            self._rotors_coast = True
            return None, None
        if self._rotors_coast:
            # The wheel has coasted: continue from its measured rate.
            self._commanded_wheel_rate, self._wheel_is_ramping, self._rotors_coast = (
                self._measured_wheel_rate,
                True,
                False,
            )
        p = self.settings.descent
        delay = max(now - self._imu_ns / _NANO, h)
        if delay > p.max_gyro_delay:
            self._late_until = now + p.gyro_delay_recovery
        late, self._is_late = self._is_late, now < self._late_until
        if self._is_late and not late:
            text = (
                f"the gyro sample is {delay:.2g} s old, the limit is {p.max_gyro_delay:g} s; the "
                "rotors do not follow it"
            )
            self._changes.append(EventReport(DescentEvent.ROTORS_SUSPENDED, text))
        elif late and not self._is_late:
            text = "the gyro samples are in time again"
            self._changes.append(EventReport(DescentEvent.ROTORS_RESUMED, text))
            self._wheel_is_ramping = True
        if self._is_late:
            return self._commanded_wheel_rate, 0.0
        if self._wheel_is_ramping:
            change = self.settings.hanging_controller.rotors.wheel_acceleration * h
            deviation = rate - self._commanded_wheel_rate
            self._wheel_is_ramping = abs(deviation) > change
            rate = self._commanded_wheel_rate + min(max(deviation, -change), change)
        self._commanded_wheel_rate = rate
        return rate, torque

    def _winch(
        self, commands: ActuatorCommands, now: float
    ) -> tuple[WinchRequest | None, float | None]:
        if self._winch_is_released:
            return None, None
        profile = self.controller.profile
        if not self.is_busy:
            # After a release another node may move the winch as soon as it holds.
            released = not self.is_engaged and self._mode == WinchMode.HOLD
            if released or self.link.is_at_rest(now) or self._mode not in FREE:
                self._release_winch()
                return None, None
            return self.link.step(commands.winch, self.length, now), None
        if self._silent_steps:
            return None, None
        fault = self.link.fault(self.length, now)
        if fault is not None:
            self._interrupt(fault.text, round(now * _NANO), fault.reason)
            return None, None
        moves = profile.phase is DescentPhase.TRAVELLING
        trims = commands.trim is not None
        request = self.link.step(commands.winch, self.length, now, moves=moves, trims=trims)
        return request, commands.trim

    def _interrupt(self, reason: str, now_ns: int, cause: Reason) -> None:
        self._changes += self.controller.take_changes()
        self.controller.hold(now_ns, cause)
        self._release_winch()
        self.interruption = reason
        self._changes.append(EventReport(DescentEvent.INTERRUPTED, reason, reason=cause))

    def _spin_down(self, h: float, now: float) -> tuple[float | None, float | None]:
        """After a release ramp the left wheel to rest; the flywheel coasts."""
        if not self._motors.may_command(now):
            self._commanded_wheel_rate = 0.0
        rate = self._commanded_wheel_rate
        if rate == 0.0:
            return None, None
        change = self.settings.hanging_controller.rotors.wheel_acceleration * min(max(h, 0.0), 0.1)
        self._commanded_wheel_rate = math.copysign(max(abs(rate) - change, 0.0), rate)
        return self._commanded_wheel_rate, 0.0


@contextmanager
def _refusals_as(subject: str) -> Iterator[None]:
    """Attribute refusals of the controller to the topic or service of the request."""
    try:
        yield
    except Refusal as refusal:
        named = subject if refusal.subject in (SUBJECT, POINTING) else refusal.subject
        raise Refusal(named, refusal.code, refusal.reason) from None
