"""Descent service: supervision of the hanging controller. Pure.

It drives nothing before the first stop and after a release. While a stop is in progress, a sensor
timeout, or a winch that another node moves, holds or stops, interrupts the descent: it holds with a
reason until `DescentRequests.resume`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, EventReport
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase, WinchMode
from msg_schemas.samples import ImuSample, JointSample
from rover_control.coordination.winch_link import FREE, WinchLink, WinchRequest
from rover_control.hanging.descent_settings import DescentSettings
from rover_control.hanging.hanging_controller import (
    NO_COMMANDS,
    ActuatorCommands,
    HangingController,
)
from rover_control.hanging.nut_clearing import NutClearing
from rover_control.hanging.observations import ObservationQueue
from rover_control.hanging.rotor_supervisor import RotorSupervisor
from rover_control.hanging.tether_turn import TetherTurn

_NANO = 1e9


class DescentCommands(NamedTuple):
    """Commands to send; None = nothing."""

    wheel_rate: float | None = None  # of the left wheel [rad/s]
    flywheel_torque: float | None = None  # [N m]
    winch: WinchRequest | None = None  # to be renewed
    trim: float | None = None  # [m/s]
    nut: float | None = None  # position setpoint of the jump motor's nut [m]


class DescentController:
    """Supervises the hanging controller: engagement, interruptions, and the use of the winch.

    Args:
        settings: all parameters.

    Attributes:
        controller: of the hanging rover.
        rotors: supervision of the rotors' commands.
        nut: drives the nut clear.
        observations: pictures with the camera's reports.
        link: client of the winch.
        is_engaged: the drives are used.
        interruption: reason of a hold without a request; empty = none.
        sensors_since: time since which no sensor has timed out [s].
    """

    def __init__(self, settings: DescentSettings) -> None:
        self.settings = settings
        self._changes: list[EventReport] = []  # shared with the parts, which add theirs in order
        self.rotors = RotorSupervisor(settings, self._changes)
        self.nut = NutClearing(settings, self._changes)
        self.observations = ObservationQueue(settings.descent)
        self._stepped_ns = 0
        self._reset(None, mode="")

    def _reset(self, turn: TetherTurn | None, mode: str) -> None:
        settings = self.settings
        self._is_retuned = False  # new parameters wait for the release
        self.controller = HangingController(settings.hanging_controller)
        if turn is not None:
            self.controller.turn.angle, self.controller.turn.twist = turn.angle, turn.twist
        self.controller.on_winch_mode(mode)
        self.link = WinchLink(settings.link, settings.hanging_controller.profile.depth_tolerance)
        self.link.on_mode(mode, -math.inf)
        self.rotors.reset()
        self.is_engaged = False
        self.interruption = ""
        self.sensors_since = -math.inf
        self._silent_steps = 0
        self._winch_is_released = True  # no request is sent to the winch

    # --- state -----------------------------------------------------------------------------------

    @property
    def phase(self) -> str:
        """Phase; value of the contract. The motors are released when the wheels have stopped."""
        if self.is_engaged:
            return self.controller.profile.phase.value
        stands = self.rotors.wheel_rate == 0.0
        return DescentPhase.RELEASED if stands else DescentPhase.STANDBY

    @property
    def distance(self) -> float:
        """Length left to the present stop [m]; NaN without one."""
        stop = self.controller.profile.stop
        return math.nan if stop is None else abs(stop.depth - self.controller.length)

    @property
    def is_busy(self) -> bool:
        """Whether an activity is in progress that needs sensors and winch."""
        profile = self.controller.profile
        held = profile.phase is DescentPhase.HOLDING
        return self.is_engaged and not profile.is_idle and not held

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics that have timed out, and the winch's mode if it was never received."""
        missing = self.controller.waiting_for(now_ns)
        return missing if self.link.mode else (*missing, topics.WINCH_MODE)

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call, and clear them."""
        taken = self._changes + self.controller.take_changes()
        self._changes.clear()
        return taken

    # --- sensors that several parts use ----------------------------------------------------------

    def on_wheels(self, sample: JointSample, now_ns: int) -> None:
        """Update with the wheel rates."""
        self.rotors.on_wheels(sample)
        self.controller.on_wheels(sample, now_ns)

    def on_flywheel(self, sample: JointSample, now_ns: int) -> None:
        """Update with angle and rate of the flywheel."""
        self.nut.screw = sample.joints[machine.FLYWHEEL].position
        self.controller.on_flywheel(sample, now_ns)

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Update with an IMU sample."""
        self.rotors.on_imu(sample, now_ns)
        self.controller.on_imu(sample, now_ns)

    def on_winch_mode(self, mode: str, now_ns: int) -> None:
        """Update with the mode of the winch."""
        self.controller.on_winch_mode(mode)
        self.link.on_mode(mode, now_ns / _NANO)

    def on_camera(self, sample: JointSample) -> None:
        """Update with the camera's report on its last picture."""
        self.controller.on_camera(sample)
        self.observations.on_camera(sample)

    # --- engagement ------------------------------------------------------------------------------

    def engage(self, reason: str) -> None:
        """Use the drives."""
        if not self.is_engaged:
            self.is_engaged = True
            self.nut.restart()
            self.controller.resume_estimation()
            self._changes.append(EventReport(DescentEvent.ENGAGED, reason))

    def disengage(self, text: str, reason: Reason) -> None:
        """Use the drives no more; parameters that wait for this apply."""
        controller = self.controller
        self._changes.extend(controller.take_changes())
        if self._is_retuned:
            self._reset(controller.turn, self.link.mode)
        else:
            controller.release()
            self.is_engaged = False
            self.interruption = ""
        self._changes.append(EventReport(DescentEvent.RELEASED, text, reason=reason))

    def retune(self, settings: DescentSettings) -> None:
        """Apply other parameters: at once if nothing is driven, else after the release."""
        self.settings = self.rotors.settings = self.nut.settings = settings
        self.observations.parameters = settings.descent
        self._is_retuned = True
        if not self.is_engaged:
            self._reset(self.controller.turn, self.link.mode)

    def acquire_winch(self) -> None:
        """Use the winch again, from its present length if another node has moved it."""
        self.interruption = ""
        if not self._winch_is_released:
            return
        self._winch_is_released = False
        profile, length = self.controller.profile, self.controller.length
        if not abs(length - profile.length_setpoint) <= profile.parameters.depth_tolerance:
            profile.length_setpoint = math.nan

    def _release_winch(self) -> None:
        self._winch_is_released = True
        self.link.clear()

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> DescentCommands:
        """Advance to now; returns the commands to send."""
        now = now_ns / _NANO
        h, self._stepped_ns = (now_ns - self._stepped_ns) / _NANO, now_ns
        self.observations.expire(now)
        if not self.is_engaged:
            # Renew the request of a winch that still comes to rest.
            request, _ = self._winch(NO_COMMANDS, now)
            return DescentCommands(*self.rotors.spin_down(h, now), request)
        self._check_sensor_timeout(now_ns)
        commands = self.controller.step(now_ns)
        if commands.exposure is not None:
            self.observations.add(commands.exposure)
        is_handed_over = self.rotors.motors.may_command(now)
        drives = self.settings.hanging_controller.uses_rotors and is_handed_over
        nut = self.nut.step(now) if drives else None
        overdue = self.nut.overdue(now) if nut is not None and self.is_busy else ""
        if overdue:
            self._interrupt(overdue, now_ns, Reason.TIME_LIMIT)
        if drives and nut is None:
            rate, torque = self.rotors.step(commands, h, now)
        else:
            rate, torque = self.rotors.spin_down(h, now)
        return DescentCommands(
            rate, torque if nut is None else None, *self._winch(commands, now), nut
        )

    def halt(self) -> DescentCommands:
        """Stop, and return the last commands to send."""
        if not self.is_engaged:
            return DescentCommands()
        length = self.controller.length
        uses = self.settings.hanging_controller.uses_rotors
        stops = not self._winch_is_released and self.link.mode == WinchMode.LENGTH
        request = WinchRequest(length, 0.0) if stops and math.isfinite(length) else None
        off = 0.0 if uses else None
        self.controller.abort(self._stepped_ns)
        self.disengage("the node stops", Reason.SHUTDOWN)
        self.rotors.wheel_rate = 0.0
        self._release_winch()
        return DescentCommands(off, off, request)

    def _check_sensor_timeout(self, now_ns: int) -> None:
        missing = self.controller.waiting_for(now_ns)
        # Count steps instead of time: a late step finds its sensor samples still queued.
        self._silent_steps = self._silent_steps + 1 if missing else 0
        if missing:
            self.sensors_since = now_ns / _NANO
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

    def _winch(
        self, commands: ActuatorCommands, now: float
    ) -> tuple[WinchRequest | None, float | None]:
        if self._winch_is_released:
            return None, None
        profile, length = self.controller.profile, self.controller.length
        if not self.is_busy:
            # After a release another node may move the winch as soon as it holds.
            released = not self.is_engaged and self.link.mode == WinchMode.HOLD
            if released or self.link.is_at_rest(now) or self.link.mode not in FREE:
                self._release_winch()
                return None, None
            return self.link.step(commands.winch, length, now), None
        if self._silent_steps:
            return None, None
        fault = self.link.fault(length, now)
        if fault is not None:
            self._interrupt(fault.text, round(now * _NANO), fault.reason)
            return None, None
        moves = profile.phase is DescentPhase.TRAVELLING
        trims = commands.trim is not None
        request = self.link.step(commands.winch, length, now, moves=moves, trims=trims)
        return request, commands.trim

    def _interrupt(self, reason: str, now_ns: int, cause: Reason) -> None:
        self._changes.extend(self.controller.take_changes())
        self.controller.hold(now_ns, cause)
        self._release_winch()
        self.interruption = reason
        self._changes.append(EventReport(DescentEvent.INTERRUPTED, reason, reason=cause))
