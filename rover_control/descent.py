"""The descent as a service to operators: what the controller of the hanging rover needs around it.

Pure. Nothing is driven before a stop was asked for, and nothing any more after a release. While
there is something to be done, sensors that fall silent, or a winch that somebody else moves, holds
or stops, end in a hold with the reason: it goes on when that is asked for. Each picture is told
with what the camera says of it, as soon as that is known.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.machine import FLYWHEEL, SMEAR, WALL_DISTANCE, WHEEL_LEFT, WINCH_DRUM
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, Level, WrenchSample
from msg_schemas.transition import Transition
from rover_control.attitude import FlywheelReaction, WheelReaction
from rover_control.descent_profile import SUBJECT, DescentPhase, Stop
from rover_control.hanging_controller import (
    ActuatorCommands,
    Exposure,
    HangingController,
    HangingControllerParameters,
    WinchRequest,
)
from rover_control.pointing import SUBJECT as POINTING
from rover_control.winch_link import FREE, HOLD, WinchLink, WinchLinkParameters

_NO_COMMANDS = ActuatorCommands(None, None, None, None, None)
RELEASED = "released"
"""The word for what is driven by nobody here, beside the words of the phases."""

_NANO = 1e9
_NO_JUMP = frozenset({"", "standby", "fault"})
_CLEAR_FRACTION = 0.2  # part of its travel, so near to whose middle the nut is clear


@dataclass(frozen=True)
class DescentParameters:
    """Limits of stops, timeouts of sensors and camera."""

    min_depth: float = parameter(1.6, "m", "least depth of a stop, as length at the drum", 0.1, 1e3)
    max_depth: float = parameter(
        48.0, "m", "largest depth of a stop: depth of the floor less the rover's height", 0.1, 1e3
    )
    sensor_timeout_steps: int = parameter(
        25,
        "-",
        "consecutive steps without a fresh sensor reading after which the sensor is lost",
        1,
        10000,
    )
    max_gyro_delay: float = parameter(
        0.1,
        "s",
        "largest delay from the gyro's sample to a step; a later one does not drive the rotors",
        0.02,
        5.0,
    )
    gyro_delay_recovery: float = parameter(
        2.0, "s", "time without such a delay before the rotors follow again", 0.0, 60.0
    )
    screw_lead: float = parameter(
        2.0e-3, "m", "lead of the jump motor's screw, per turn", 1e-4, 0.1
    )
    nut_unloaded_position: float = parameter(
        2.0e-3,
        "m",
        "largest nut position at which it bears no spring and may be driven clear",
        0.0,
        0.1,
    )
    nut_speed: float = parameter(0.01, "m/s", "speed at which the nut is driven clear", 1e-3, 0.5)
    nut_timeout: float = parameter(20.0, "s", "time within which the nut must be clear", 1.0, 600.0)
    exposure_latency: float = parameter(
        0.1, "s", "time from the command of a picture to the end of its exposure", 0.0, 10.0
    )
    camera_timeout: float = parameter(
        1.0,
        "s",
        "longest wait for the camera's report before a picture is published without it",
        0.0,
        60.0,
    )

    def __post_init__(self) -> None:
        """Refuse limits that leave no room."""
        if self.min_depth >= self.max_depth:
            msg = f"min_depth is {self.min_depth:g} m, it must be less than max_depth, "
            raise ParameterError(msg + f"{self.max_depth:g} m")


@dataclass(frozen=True)
class DescentSettings:
    """All parameters of a descent."""

    descent: DescentParameters = field(default_factory=DescentParameters)
    link: WinchLinkParameters = field(default_factory=WinchLinkParameters)
    hanging_controller: HangingControllerParameters = field(
        default_factory=HangingControllerParameters
    )


class Observation(NamedTuple):
    """A picture with what the camera says of it."""

    number: int  # since the start, from 1
    exposure: Exposure
    smear: float  # [px]; NaN = the camera was not heard
    wall_distance: float  # [m]; NaN = the camera was not heard


class DescentCommands(NamedTuple):
    """What to send now; None = nothing."""

    wheel_rate: float | None = None  # of the left wheel [rad/s]
    flywheel_torque: float | None = None  # [N m]
    winch: WinchRequest | None = None  # to be renewed
    trim: float | None = None  # [m/s]
    nut: float | None = None  # that the jump motor's nut is to go to [m]


class Descent:
    """The controller with its supervision.

    Args:
        settings: all parameters.
    """

    def __init__(self, settings: DescentSettings) -> None:
        self.settings = settings
        self.length = math.nan
        self.screw = math.nan  # angle of the flywheel's screw [rad]
        self._is_retuned = False  # other parameters wait for the release
        self._pictures = 0
        self._pending: deque[Observation] = deque()
        self._completed: list[Observation] = []
        self._changes: list[Transition] = []
        self._jump = ""
        self._mode = ""
        self._commanded_wheel_rate = 0.0  # as sent last [rad/s]
        self._measured_wheel_rate = 0.0  # by its encoder [rad/s]
        self._stepped_ns = 0
        self._clearing_since: float | None = None  # that the nut is driven clear [s]
        self._imu_ns = 0  # the newest reading's stamp
        self._reset(0.0)

    def _reset(self, heading: float) -> None:
        settings = self.settings
        self._is_retuned = False
        self.controller = HangingController(settings.hanging_controller)
        self.controller.heading = heading
        self.controller.on_winch_mode(self._mode)
        self.link = WinchLink(settings.link, settings.hanging_controller.profile.depth_tolerance)
        self.link.on_mode(self._mode, -math.inf)
        self.is_engaged = False
        self._winch_is_released = True  # the winch is left to others
        self._silent_steps = 0
        self._fresh_since = -math.inf  # all sensors, after one of them was silent [s]
        self._late_until = -math.inf  # the rotors do not follow [s]
        self._is_late = False
        self._rotors_coast = False  # no command is sent to the rotors
        self._wheel_is_ramping = False  # the wheel is brought to where it should be gently
        self.interruption = ""  # why the descent is held, where nobody has asked for that

    # --- what is known ---------------------------------------------------------------------------

    @property
    def phase(self) -> str:
        """The word of the contract for what is done."""
        return self.controller.profile.phase.value if self.is_engaged else RELEASED

    @property
    def stops_left(self) -> int:
        """Stops that wait behind the present one."""
        return len(self.controller.profile.stops)

    @property
    def is_busy(self) -> bool:
        """Whether something is being done that a lost sensor or winch would spoil."""
        profile = self.controller.profile
        held = profile.phase is DescentPhase.HOLDING
        return self.is_engaged and not profile.is_idle and not held

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics that are silent, and the winch's mode where it was never told."""
        silent = self.controller.waiting_for(now_ns)
        return silent if self._mode else (*silent, topics.WINCH_MODE)

    def take_changes(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._changes = self._changes, []
        return taken + self.controller.take_changes()

    def take_observations(self) -> list[Observation]:
        """Return the pictures that are complete since the last call, and forget them."""
        taken, self._completed = self._completed, []
        return taken

    # --- sensors ---------------------------------------------------------------------------------

    def on_drum(self, sample: JointSample, now_ns: int) -> None:
        """Take the state of drum and brake."""
        self.length = sample.joints[WINCH_DRUM].position
        self.controller.on_drum(sample, now_ns)

    def on_wheels(self, sample: JointSample, now_ns: int) -> None:
        """Take the wheels' rates."""
        self._measured_wheel_rate = sample.joints[WHEEL_LEFT].velocity
        self.controller.on_wheels(sample, now_ns)

    def on_flywheel(self, sample: JointSample, now_ns: int) -> None:
        """Take angle and rate of the flywheel."""
        self.screw = sample.joints[FLYWHEEL].position
        self.controller.on_flywheel(sample, now_ns)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Take a reading of the IMU."""
        self._imu_ns = sample.stamp_ns or now_ns
        self.controller.on_imu(sample, now_ns)

    def on_winch_mode(self, mode: str, now_ns: int) -> None:
        """Take what the winch is doing."""
        self._mode = mode
        self.controller.on_winch_mode(mode)
        self.link.on_mode(mode, now_ns / _NANO)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Take the tension at the fairlead."""
        self.controller.on_load_cell(sample, now_ns)

    def on_jump(self, phase: str) -> None:
        """Take what the jump is doing: it needs the same motor."""
        self._jump = phase

    def on_camera(self, sample: JointSample) -> None:
        """Take what the camera tells of its last picture; what waited for it is complete."""
        self.controller.on_camera(sample)
        smear, wall = (sample.joints[name].position for name in (SMEAR, WALL_DISTANCE))
        ready = sample.stamp_ns - round(self.settings.descent.exposure_latency * _NANO)
        while self._pending and round(self._pending[0].exposure.time * _NANO) <= ready:
            done = self._pending.popleft()
            self._completed.append(done._replace(smear=smear, wall_distance=wall))

    # --- asked from outside ----------------------------------------------------------------------

    def request(self, stop: Stop, now_ns: int) -> None:
        """Add a stop; the first one takes the drives.

        Raises:
            Refusal: out of limits, the rover jumps, or what the controller refuses.
        """
        p = self.settings.descent
        if not p.min_depth <= stop.depth <= p.max_depth:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.OUT_OF_LIMITS,
                f"depth is {stop.depth!r} m, it must lie in {p.min_depth:g} .. {p.max_depth:g} m",
            )
        self._check_rotors(now_ns)
        with _refusals_as(topics.DESCENT_REQUEST):
            self.controller.request(stop, now_ns)
        self._engage("a stop is asked for")
        self._acquire_winch()

    def turn(self, angle: float, now_ns: int) -> None:
        """Turn about the plumb line by so much [rad], and hold the heading until another request.

        Raises:
            Refusal: stops are left, the rover jumps, or the heading cannot be reached or held.
        """
        self._check_rotors(now_ns)
        with _refusals_as(topics.DESCENT_REQUEST):
            self.controller.point(angle, now_ns)
        self._engage("a heading is asked for")

    @property
    def _lead_per_radian(self) -> float:
        """Way of the nut by the screw's angle [m/rad]."""
        return self.settings.descent.screw_lead / math.tau

    def _engage(self, reason: str) -> None:
        if not self.is_engaged:
            self.is_engaged = True
            self._clearing_since = None
            self.controller.resume_estimation()
            self._changes.append(Transition("descent_engaged", reason))

    def _check_rotors(self, now_ns: int) -> None:
        if self._jump not in _NO_JUMP:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the rover jumps ({self._jump}), its motor is needed",
            )
        nut = self.screw * self._lead_per_radian
        most = self.settings.descent.nut_unloaded_position
        if self.settings.hanging_controller.uses_rotors and nut > most:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the nut stands at {nut:.4g} m and may bear the spring, it must stand at most at "
                f"{most:g} m; {topics.JUMP_ABORT} lets the spring down",
            )
        self._check_sensors(topics.DESCENT_REQUEST, now_ns)

    def hold(self, now_ns: int) -> str:
        """Come to rest where it is.

        Raises:
            Refusal: nothing is under way.
        """
        self._check_engaged(topics.DESCENT_HOLD)
        return self.controller.hold(now_ns)

    def resume(self, now_ns: int) -> str:
        """Go on after a hold.

        Raises:
            Refusal: nothing is held, a sensor is silent, or the winch is not free.
        """
        self._check_engaged(topics.DESCENT_RESUME)
        self._check_sensors(topics.DESCENT_RESUME, now_ns)
        if self._mode not in FREE:
            raise Refusal(
                topics.DESCENT_RESUME,
                RefusalCode.NOT_ARMED,
                f"the winch is in {self._mode or 'no known mode'}, it must hold",
            )
        with _refusals_as(topics.DESCENT_RESUME):
            done = self.controller.resume(now_ns)
        self._acquire_winch()
        return done

    def abort(self, now_ns: int) -> str:
        """Forget what was to be done and stay; a heading is let go."""
        self.interruption = ""
        self.controller.pointing.stop()
        return self.controller.abort(now_ns)

    def release(self) -> str:
        """Give the drives back.

        Raises:
            Refusal: stops are left.
        """
        if self.is_engaged and not self.controller.profile.is_idle:
            raise Refusal(
                topics.DESCENT_RELEASE,
                RefusalCode.WRONG_PHASE,
                f"the descent is in {self.phase}; {topics.DESCENT_ABORT} forgets what is left",
            )
        if self.is_engaged:
            self._disengage("asked for")
        return "winch, wheels and flywheel are free"

    def retune(self, settings: DescentSettings) -> None:
        """Go by other parameters: at once where nothing is driven, else after the release."""
        self.settings = settings
        self._is_retuned = True
        if not self.is_engaged:
            self._reset(self.controller.heading)

    def _check_engaged(self, subject: str) -> None:
        if not self.is_engaged:
            raise Refusal(subject, RefusalCode.WRONG_PHASE, "no descent is under way")

    def _check_sensors(self, subject: str, now_ns: int) -> None:
        silent = self.waiting_for(now_ns)
        if silent:
            raise Refusal(subject, RefusalCode.STALE, f"{', '.join(silent)} not heard")
        left = self.settings.hanging_controller.profile.estimator_settling_time - (
            now_ns / _NANO - self._fresh_since
        )
        if left > 0.0:
            text = f"a sensor was silent, the swing is known again in {left:.1f} s"
            raise Refusal(subject, RefusalCode.STALE, text)

    def _acquire_winch(self) -> None:
        """Use the winch again; where others have moved it, there it is now."""
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

    def _disengage(self, reason: str) -> None:
        controller = self.controller
        controller.pointing.stop()
        self._changes += controller.take_changes()
        if self._is_retuned:
            self._reset(controller.heading)
        else:
            # The rotors begin from rest; whether the rover hangs is nobody's concern here any more.
            p = controller.parameters
            controller.wheels = WheelReaction(p.hanging, p.rotors, p.design)
            controller.flywheel = FlywheelReaction(p.hanging, p.rotors, p.design)
            controller.pause_estimation()
            self.is_engaged = False
            self.interruption = ""
        self._changes.append(Transition(f"descent_{RELEASED}", reason))

    # --- stepped by time -------------------------------------------------------------------------

    def step(self, now_ns: int) -> DescentCommands:
        """Advance to now; returns what is to be sent."""
        now = now_ns / _NANO
        h, self._stepped_ns = (now_ns - self._stepped_ns) / _NANO, now_ns
        while (
            self._pending
            and now - self._pending[0].exposure.time > self.settings.descent.camera_timeout
        ):
            self._completed.append(self._pending.popleft())
        if not self.is_engaged:
            # A winch that still comes to rest is asked to go on with that.
            request, _ = self._winch(_NO_COMMANDS, now)
            return DescentCommands(*self._spin_down(h), request)
        self._check_sensor_timeout(now_ns)
        commands = self.controller.step(now_ns)
        if commands.exposure is not None:
            self._pictures += 1
            nan = math.nan
            self._pending.append(Observation(self._pictures, commands.exposure, nan, nan))
        nut = self._clear_nut(now) if self.settings.hanging_controller.uses_rotors else None
        rotors = self._rotors(commands if nut is None else _NO_COMMANDS, h, now)
        return DescentCommands(*rotors, *self._winch(commands, now), nut)

    def halt(self) -> DescentCommands:
        """What to send last, when nobody steps any more."""
        if not self.is_engaged:
            return DescentCommands()
        uses = self.settings.hanging_controller.uses_rotors
        stops = not self._winch_is_released and self._mode == "length"
        request = WinchRequest(self.length, 0.0) if stops and math.isfinite(self.length) else None
        off = 0.0 if uses else None
        self.controller.abort(self._stepped_ns)
        self._disengage("the node stops")
        self._release_winch()
        return DescentCommands(off, off, request)

    def _check_sensor_timeout(self, now_ns: int) -> None:
        silent = self.controller.waiting_for(now_ns)
        # By steps and not by time: one that comes late finds what was said meanwhile still unread.
        self._silent_steps = self._silent_steps + 1 if silent else 0
        if silent:
            self._fresh_since = now_ns / _NANO
        if self._silent_steps < self.settings.descent.sensor_timeout_steps:
            return
        reason = f"{', '.join(silent)} not heard"
        if self.is_busy:
            self._interrupt(reason, now_ns)
        elif self.controller.pointing.is_active:
            self.controller.pointing.stop()
            self._changes.append(Transition("pointing_ended", reason, Level.WARN))

    def _clear_nut(self, now: float) -> float | None:
        """Where the nut is to go to, so that its motor is a reaction wheel; None = it is clear."""
        rotors = self.settings.hanging_controller.rotors
        away = abs(self.screw - rotors.screw_travel_centre)
        if self._clearing_since is None and not away > rotors.screw_travel:
            return None
        if self._clearing_since is None:
            self._clearing_since = now
            self._changes.append(Transition("nut_clearing", "the nut is driven clear of the latch"))
        if away < _CLEAR_FRACTION * rotors.screw_travel:
            self._clearing_since = None
            self._changes.append(Transition("nut_clear", "the jump motor is a reaction wheel"))
            return None
        if self.is_busy and now - self._clearing_since > self.settings.descent.nut_timeout:
            self._clearing_since = now
            self._interrupt("the nut does not come clear of the latch", round(now * _NANO))
        return rotors.screw_travel_centre * self._lead_per_radian

    def _rotors(
        self, commands: ActuatorCommands, h: float, now: float
    ) -> tuple[float | None, float | None]:
        """The rotors' commands; one that comes late would feed the tilt instead of damping it."""
        rate, torque = commands.wheel_rate, commands.flywheel_torque
        if rate is None or torque is None:
            self._rotors_coast = True
            return None, None
        if self._rotors_coast:
            # Without commands the wheel has come to another rate, and is taken up from there.
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
            text = f"the gyro's reading is {delay:.2g} s old, the rotors do not follow it"
            self._changes.append(Transition("rotors_late", text, Level.WARN))
        elif late and not self._is_late:
            self._changes.append(Transition("rotors_follow", "the gyro is heard in time again"))
            self._wheel_is_ramping = True
        if self._is_late:
            return self._commanded_wheel_rate, 0.0
        if self._wheel_is_ramping:
            change = self.settings.hanging_controller.rotors.wheel_acceleration * h
            way = rate - self._commanded_wheel_rate
            self._wheel_is_ramping = abs(way) > change
            rate = self._commanded_wheel_rate + min(max(way, -change), change)
        self._commanded_wheel_rate = rate
        return rate, torque

    def _winch(
        self, commands: ActuatorCommands, now: float
    ) -> tuple[WinchRequest | None, float | None]:
        if self._winch_is_released:
            return None, None
        profile = self.controller.profile
        if not self.is_busy:
            # Whoever has the winch after a release moves it as soon as it holds.
            released = not self.is_engaged and self._mode == HOLD
            if released or self.link.is_at_rest(now) or self._mode not in FREE:
                self._release_winch()
                return None, None
            return self.link.step(commands.winch, self.length, now), None
        if self._silent_steps:
            return None, None
        fault = self.link.fault(self.length, now)
        if fault:
            self._interrupt(fault, round(now * _NANO))
            return None, None
        moves = profile.phase is DescentPhase.TRAVELLING
        trims = commands.trim is not None
        request = self.link.step(commands.winch, self.length, now, moves=moves, trims=trims)
        return request, commands.trim

    def _interrupt(self, reason: str, now_ns: int) -> None:
        self._changes += self.controller.take_changes()
        self.controller.hold(now_ns)
        self._release_winch()
        self.interruption = reason
        self._changes.append(Transition("descent_interrupted", reason, Level.WARN))

    def _spin_down(self, h: float) -> tuple[float | None, float | None]:
        """After a release the left wheel is brought to rest gently; the flywheel coasts."""
        rate = self._commanded_wheel_rate
        if rate == 0.0:
            return None, None
        change = self.settings.hanging_controller.rotors.wheel_acceleration * min(max(h, 0.0), 0.1)
        self._commanded_wheel_rate = math.copysign(max(abs(rate) - change, 0.0), rate)
        return self._commanded_wheel_rate, 0.0


@contextmanager
def _refusals_as(subject: str) -> Iterator[None]:
    """What the controller refuses is refused by the topic or service that asked for it."""
    try:
        yield
    except Refusal as refusal:
        named = subject if refusal.subject in (SUBJECT, POINTING) else refusal.subject
        raise Refusal(named, refusal.code, refusal.reason) from None
