"""Winch of the mother machine: modes, requests and faults. Pure.

Inputs are sensor samples and requests; each time step returns the command to the drive.

========  ====================================================================================
disarmed  brake closed; armed by service only
hold      coming to rest, then brake closed; entered when a motion ends
length    to a length by an S-curve; ends in hold at the length, at a touchdown or snag, or when a
          request that needs renewal is not renewed
rate      at a rate, while its request is renewed
tension   holds a tension at the fairlead, while its request is renewed
slack     gives slack beyond the taut length and keeps it, or takes it up
relax     pays out until the tether carries little more than its own weight
stop      brake closed at once; armed by service only
fault     as stop, with a fault code and reason
========  ====================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from msg_schemas import topics
from msg_schemas.events import EventReport, WinchEvent
from msg_schemas.faults import Reason, WinchFault
from msg_schemas.machine import (
    MAX_LENGTH,
    MAX_PAYOUT_RATE,
    MAX_TENSION,
    PAYOUT,
    REFERENCE,
    STRETCHED,
    TENSION,
    TETHER_OUT,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_MOTOR,
)
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, WrenchSample
from tether_winch.drum_model import DrumModel
from tether_winch.estimates import PayoutEstimate, TensionEstimate, TensionSource
from tether_winch.fault_monitor import FaultInputs, FaultMonitor
from tether_winch.load_monitor import LoadMonitor
from tether_winch.requests import JUMPING, AcceptedRequest, RequestContext, RequestInterpreter
from tether_winch.servo import (
    REST,
    BrakePhase,
    GoalKind,
    SensedState,
    ServoCommand,
    ServoGoal,
    WinchServo,
    quick_stop,
)
from tether_winch.thermal import MotorThermalModel
from tether_winch.winch_events import alarm_event, mode_event
from tether_winch.winch_parameters import WinchParameters

_NANO = 1e9
_OPEN = 0.5  # brake position above which the brake is open
_MOVING = 0.02  # rate above which the drum moves [m/s]
_LATE_STEP = 0.05  # step interval above which a step is late [s]
_MIN_STEPS = 3  # servo steps after which a motion has begun
_MAX_STOP_TIME = 1.5  # longest quick stop; then the brake closes [s]
_RENEWAL_TOLERANCE = 0.1  # relative change of tension or rate that counts as a renewal
_MIN_MOTION_TIME = 0.05  # shortest motion [s]
_MIN_RENEWED_MOTION_TIME = 0.3  # shortest motion of a renewed request; a trim may follow [s]
_TRIM_TIMEOUT = 0.5  # time without renewal after which a trim ends [s]
_RENEWED_MODES = (WinchMode.RATE, WinchMode.TENSION)
_STOPS_AT_TOUCHDOWN = (WinchMode.LENGTH, WinchMode.RATE)


class WinchController:
    """Controller of one winch."""

    def __init__(self, parameters: WinchParameters) -> None:
        self.parameters = parameters
        self.mode = WinchMode.DISARMED
        self.fault: WinchFault | None = None
        self.fault_reason = ""
        self.drum = DrumModel(parameters.drum)
        self.servo = WinchServo(parameters.servo, self.drum)
        self._interpreter = RequestInterpreter(
            parameters.requests, parameters.servo, parameters.load.touchdown_threshold
        )
        self.goal = REST
        self._in_mode_since = 0.0
        self._servo_steps = 0  # servo steps in this mode
        self._renewed_at = 0.0
        self._requires_renewal = False  # the length request must be renewed
        self._trimmed_at: float | None = None
        self._jump = ""
        self._jump_since = 0.0
        self._taut_length: float | None = None  # payout at which the tether was last taut [m]
        self._tension_reached_since: float | None = None
        self._is_giving_slack = False
        self._transitions: list[EventReport] = []
        self._begin_sensing()

    def _begin_sensing(self) -> None:
        p = self.parameters
        self.payout = PayoutEstimate(p.estimates)
        self.tension = TensionEstimate(p.estimates, self.drum)
        self.load = LoadMonitor(p.load)
        self.heat = MotorThermalModel(
            p.drum.motor_continuous_torque, p.drum.motor_torque, p.drum.motor_thermal_time
        )
        self._fault_monitor = FaultMonitor(p.faults)
        self._brake_is_open = False
        self._motor_torque = 0.0
        self._last_step: float | None = None
        self._step_delay = 0.0  # delay of the last step [s]
        self._alarms: dict[str, bool] = {}

    def take_transitions(self) -> list[EventReport]:
        """Return the transitions since the last call, and clear them."""
        taken, self._transitions = self._transitions, []
        return taken

    # --- sensors ---------------------------------------------------------------------------------

    def on_drum(self, sample: JointSample, now_ns: int) -> None:
        """Update with the state of drum and brake."""
        length, rate, _ = sample.joints[WINCH_DRUM]
        is_open = sample.joints[WINCH_BRAKE].position >= _OPEN
        now = now_ns / _NANO
        moves = max(abs(rate), abs(self.payout.rate)) > _MOVING
        if self._brake_is_open and not is_open and moves:
            self.load.on_braking(now)
        self._brake_is_open = is_open
        taken = sample.stamp_ns / _NANO if sample.stamp_ns else now
        self.payout.update(length, rate, taken, now)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Update with the tether force at the fairlead."""
        self.tension.on_load_cell(math.hypot(*sample.force), now_ns / _NANO)

    def on_currents(self, sample: JointSample, now_ns: int) -> None:
        """Update with the motor currents; uses the winch motor's."""
        current = sample.joints[WINCH_MOTOR].effort
        self._motor_torque = current * self.parameters.drum.torque_constant
        self.tension.on_motor(current, self.payout, self._brake_is_open, now_ns / _NANO)

    def on_sensor_timeout(self, reason: str) -> None:
        """Invalidate tension and load; the sensors timed out by another clock."""
        self.tension.invalidate(reason)
        self.load.invalidate()

    def retune(self, parameters: WinchParameters) -> None:
        """Apply other parameters at once; a motion continues within the new limits."""
        self.parameters = parameters
        self.drum = DrumModel(parameters.drum)
        self.servo.retune(parameters.servo, self.drum)
        self.payout.parameters = parameters.estimates
        self.tension.retune(parameters.estimates, self.drum)
        self.load.parameters = parameters.load
        self._fault_monitor.parameters = parameters.faults
        self._interpreter = RequestInterpreter(
            parameters.requests, parameters.servo, parameters.load.touchdown_threshold
        )

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics of the sensors that have timed out; without them no motion starts."""
        now = now_ns / _NANO
        silent = []
        if self.payout.age(now) > self.parameters.estimates.encoder_timeout:
            silent.append(topics.WINCH_STATE)
        if self.tension.cell_fault:
            silent.append(topics.LOAD_CELL)
        return tuple(silent)

    def on_jump(self, phase: str, now_ns: int) -> None:
        """Update with the phase of the jump; reeling in is inhibited during a jump."""
        was = self._jump
        self._jump, self._jump_since = phase, now_ns / _NANO
        self._set_goal(self.goal)
        # Hooking its latch again, the rover is at rest.
        at_rest = was == JumpPhase.LANDED and phase in (JumpPhase.HOOKING, JumpPhase.STANDBY)
        if self.mode is WinchMode.SLACK and at_rest:
            self._tension_reached_since = None
            taking = self._interpreter.take_up(
                0.0, self._request_context(now_ns), "the rover has landed"
            )
            self._accept(taking, now_ns / _NANO, Reason.LANDED)

    # --- state -----------------------------------------------------------------------------------

    @property
    def is_jumping(self) -> bool:
        """Whether a jump in progress is reported."""
        return self._jump in JUMPING

    @property
    def alarms(self) -> Mapping[str, bool]:
        """State of the alarms: touchdown, slack, snag and over-tension."""
        return self.load.alarms

    def tension_now(self, now_ns: int) -> tuple[float, TensionSource]:
        """Tension [N] and its source; NaN where no source is valid."""
        value, source = self.tension.value(now_ns / _NANO)
        if source is TensionSource.MOTOR and self.parameters.faults.load_cell_required:
            return math.nan, TensionSource.NONE
        return value, source

    def estimate(self, now_ns: int) -> JointSample | None:
        """Sample of `winch/estimate`; None before the first drum state.

        Without a valid tension, the stretched length assumes the mean load.
        """
        if not self.payout.is_known:
            return None
        tension, source = self.tension_now(now_ns)
        known = source is not TensionSource.NONE
        length, rate = max(self.payout.length_at(now_ns / _NANO), 0.0), self.payout.rate
        weight = self.drum.hanging_weight(length)
        stretched = self.drum.stretched(length, tension if known else weight + self.load.mean)
        aim = self.servo.reference
        values = {
            PAYOUT: JointValue(length, rate, 0.0),
            STRETCHED: JointValue(stretched, rate * stretched / length if length else rate, 0.0),
            TENSION: JointValue(float(known), 0.0, max(tension, 0.0) if known else 0.0),
            TETHER_OUT: JointValue(self.parameters.drum.line_density * length, 0.0, weight),
            REFERENCE: JointValue(
                min(max(aim.length, 0.0), MAX_LENGTH),
                min(max(aim.rate, -MAX_PAYOUT_RATE), MAX_PAYOUT_RATE),
                min(self.servo.tension_setpoint, MAX_TENSION),
            ),
        }
        return JointSample(now_ns, values)

    # --- requests --------------------------------------------------------------------------------

    def request(self, sample: JointSample, now_ns: int) -> bool:
        """Start a motion; the joint's name selects its mode.

        Returns:
            Whether it continues the present motion.

        Raises:
            Refusal: not armed, out of limits, not allowed in this state, or the payout is unknown.
        """
        ((name, value),) = sample.joints.items()
        now = now_ns / _NANO
        self._check_armed()
        unknown = self.payout.fault(now)
        if unknown:
            reason = f"{unknown}, the payout is unknown"
            raise Refusal(topics.WINCH_REQUEST, RefusalCode.STALE, reason)
        accepted = self._interpreter.interpret(name, value, self._request_context(now_ns))
        self._tension_reached_since = None
        renews = self._accept(accepted, now, Reason.REQUESTED)
        self._is_giving_slack = self.mode is WinchMode.SLACK and self.goal.pays_out
        self._renewed_at = now
        self._requires_renewal = accepted.is_renewed
        return renews

    def hold(self, now_ns: int) -> str:
        """Come to rest smoothly and close the brake.

        Raises:
            Refusal: not armed.
        """
        self._check_armed(topics.WINCH_HOLD)
        now = now_ns / _NANO
        self._enter(WinchMode.HOLD, "hold requested", REST, now, Reason.REQUESTED)
        return "coming to rest"

    def relax(self, now_ns: int) -> str:
        """Pay out slowly until the tether carries little more than its own weight.

        Raises:
            Refusal: not armed, the tension is unknown, or the rover hangs.
        """
        self._check_armed(topics.WINCH_RELAX)
        accepted = self._interpreter.relax(self._request_context(now_ns))
        self._accept(accepted, now_ns / _NANO, Reason.REQUESTED)
        return "relaxing"

    def stop(self, reason: str, now_ns: int, cause: Reason = Reason.REQUESTED) -> None:
        """Close the brake at once and switch the motor off; never refused."""
        if self.mode is not WinchMode.FAULT:
            self._enter(WinchMode.STOP, reason, REST, now_ns / _NANO, cause)

    def rearm(self, now_ns: int) -> str:
        """Arm after the start, a stop or a fault.

        Raises:
            Refusal: a fault is still present.
        """
        if self.mode.is_armed:
            return f"already armed, in {self.mode}"
        now = now_ns / _NANO
        self.tension.mismatch = ""
        self.payout.drift = 0.0
        self._fault_monitor.reset()
        found = self._fault_monitor.check(self._fault_inputs(now_ns), now)
        if found is not None:
            raise Refusal(topics.WINCH_REARM, RefusalCode.NOT_ARMED, found[1])
        self.fault, self.fault_reason = None, ""
        self._enter(WinchMode.HOLD, f"armed, previously in {self.mode}", REST, now, Reason.ARMED)
        return "armed"

    def trim(self, rate: float, now_ns: int) -> None:
        """Add a rate [m/s] to a length or rate request until the trim times out.

        Raises:
            Refusal: in another mode.
        """
        if self.mode not in (WinchMode.LENGTH, WinchMode.RATE):
            raise Refusal(
                topics.WINCH_TRIM,
                RefusalCode.WRONG_PHASE,
                f"the winch is in {self.mode}, a trim requires {WinchMode.LENGTH} or "
                f"{WinchMode.RATE}",
            )
        self._trimmed_at = now_ns / _NANO
        self.servo.trim(rate)

    def clock_jumped(self, now_ns: int) -> None:
        """Reset the estimates and latch a fault: all times are invalid."""
        mean = self.load.mean
        self._begin_sensing()
        self.load.mean = mean
        self._trimmed_at = None
        self._jump_since = self._in_mode_since = now_ns / _NANO
        self.latch(WinchFault.CLOCK_JUMP, "the clock has jumped", now_ns)

    def latch(self, fault: WinchFault, reason: str, now_ns: int) -> None:
        """Latch a fault: close the brake until the winch is armed again."""
        if not self.mode.is_armed:
            return
        values = {"fault": fault.value, "length": self.payout.length, "rate": self.payout.rate}
        goal = quick_stop(self.goal)
        self.fault, self.fault_reason = fault, reason
        expired = fault is WinchFault.COMMAND_TIMEOUT
        cause = Reason.RENEWAL_TIMEOUT if expired else Reason.FAULT
        self._enter(WinchMode.FAULT, f"{fault}: {reason}", goal, now_ns / _NANO, cause, values)

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> ServoCommand | None:
        """Advance to now; returns the command to the drive, None before the first drum state."""
        now = now_ns / _NANO
        h = 0.0 if self._last_step is None else now - self._last_step
        self._last_step = now
        # After a stall of this process the clock is ahead of the queued sensor samples.
        self._step_delay = h if h > _LATE_STEP else 0.0
        if not self.payout.is_known:
            return None
        self._sense(now_ns, h)
        late = self.parameters.faults.max_step_delay
        if h > late and not self.servo.is_at_rest:
            reason = f"a control step came after {h:.3g} s, the limit is {late:g} s"
            self.latch(WinchFault.NODE_LATE, reason, now_ns)
        found = self._fault_monitor.check(self._fault_inputs(now_ns), now)
        if found is not None:
            self._on_fault(*found, now_ns)
        self._step_mode(now_ns)
        return self._drive(now_ns, min(h, late))

    def _sense(self, now_ns: int, h: float) -> None:
        now = now_ns / _NANO
        self.tension.step(self.payout, now - self._step_delay)
        tension, _ = self.tension_now(now_ns)
        own, length = self._own_weight(), self.payout.length
        bounce_period = self.drum.bounce_period(length, self.load.mean)
        self.load.step(tension, own, self.payout.rate, bounce_period, now)
        # A NaN compares as false.
        if tension - own > 0.5 * self.parameters.requests.take_up_tension:
            self._taut_length = length
        self.heat.step(self._motor_torque, h)
        values = {"tension": tension, "length": self.payout.length, "load_mean": self.load.mean}
        for name, is_on in self.load.alarms.items():
            if is_on is not self._alarms.get(name, False):
                self._transitions.append(alarm_event(name, is_on=is_on, values=values))
        self._alarms = dict(self.load.alarms)

    def _on_fault(self, fault: WinchFault, reason: str, now_ns: int) -> None:
        """Latch a fault; during a quick stop it replaces the fault and closes the brake."""
        if self.mode is not WinchMode.FAULT:
            self.latch(fault, reason, now_ns)
        elif self.fault is not None and self.fault.stops_before_braking:
            self.fault, self.fault_reason = fault, reason

    def _step_mode(self, now_ns: int) -> None:
        now, p = now_ns / _NANO, self.parameters
        if self.is_jumping and now - self._jump_since > p.requests.jump_timeout:
            self._jump = ""
            self._set_goal(self.goal)
        if self._trimmed_at is not None and now - self._trimmed_at > _TRIM_TIMEOUT:
            self._trimmed_at = None
            self.servo.trim(None)
        if self.mode in _RENEWED_MODES and now - self._renewed_at > p.faults.command_timeout:
            reason = (
                f"the {self.mode} request was not renewed within {p.faults.command_timeout:g} s"
            )
            self.latch(WinchFault.COMMAND_TIMEOUT, reason, now_ns)
        elif self._renewal_timed_out(now):
            goal = quick_stop(self.goal)
            reason = (
                f"the request for {self.goal.length:g} m was not renewed; stopping at "
                f"{self.payout.length:.4g} m"
            )
            self._enter(WinchMode.HOLD, reason, goal, now, Reason.RENEWAL_TIMEOUT)
        elif self.mode in _STOPS_AT_TOUCHDOWN and self.load.is_supported and self._pays_out():
            goal = quick_stop(self.goal)
            reason = f"touchdown at {self.payout.length:.4g} m"
            self._enter(WinchMode.HOLD, reason, goal, now, Reason.TOUCHDOWN)
        elif self.load.is_snagged and not self.servo.is_at_rest and self._reels_in():
            if self.mode.is_armed and self.mode is not WinchMode.HOLD:
                goal = quick_stop(self.goal)
                reason = f"snag at {self.payout.length:.4g} m"
                self._enter(WinchMode.HOLD, reason, goal, now, Reason.SNAG)
        elif self.mode is WinchMode.LENGTH and self._is_complete(now):
            text = f"at {self.payout.length:.4g} m"
            self._enter(WinchMode.HOLD, text, REST, now, Reason.COMPLETED)
        elif self.mode is WinchMode.SLACK and self.goal.pays_out:
            if self._is_giving_slack and self._is_complete(now):
                self._report_slack()
        elif self.mode in (WinchMode.RELAX, WinchMode.SLACK):
            self._end_by_tension(now_ns)

    def _report_slack(self) -> None:
        self._is_giving_slack = False
        length = self.payout.length
        slack = 0.0 if self._taut_length is None else max(length - self._taut_length, 0.0)
        text = f"{slack:.3g} m of slack at {length:.4g} m"
        values = {"length": length, "slack": slack}
        event = EventReport(WinchEvent.SLACK_REACHED, text, values, Reason.COMPLETED)
        self._transitions.append(event)

    def _end_by_tension(self, now_ns: int) -> None:
        """End a relaxation or a slack take-up when the tension reaches its setpoint."""
        tension, _ = self.tension_now(now_ns)
        setpoint = self.goal.tension
        slackening = self.mode is WinchMode.RELAX
        beyond = tension <= setpoint if slackening else tension >= 0.9 * setpoint
        now = now_ns / _NANO
        if not beyond:
            self._tension_reached_since = None
        elif self._tension_reached_since is None:
            self._tension_reached_since = now
        elif now - self._tension_reached_since > 0.2:
            self._tension_reached_since = None
            if not slackening:
                self._report_slack()
            done = "relaxed" if slackening else "slack taken up"
            self._enter(WinchMode.HOLD, f"{done}: {tension:.3g} N", REST, now, Reason.COMPLETED)

    def _is_complete(self, now: float) -> bool:
        # Time alone does not suffice: a stalled node would end a motion that has not begun.
        # A controller that trims reacts to the mode, so its first trim comes later.
        least = _MIN_RENEWED_MOTION_TIME if self._requires_renewal else _MIN_MOTION_TIME
        begun = self._servo_steps >= _MIN_STEPS and now - self._in_mode_since > least
        return begun and self._trimmed_at is None and self.servo.is_at_rest

    def _renewal_timed_out(self, now: float) -> bool:
        """Whether a length request that needs renewal was not renewed in time."""
        return (
            self._requires_renewal
            and self.mode is WinchMode.LENGTH
            and now - self._renewed_at > self.parameters.faults.command_timeout
            and self.servo.motion.rate != 0.0
        )

    def _pays_out(self) -> bool:
        goal = self.goal
        # The rate of a length goal is a limit for both directions.
        is_length = goal.kind is GoalKind.LENGTH
        nearly = self.parameters.servo.length_tolerance
        demand = goal.length - self.payout.length > nearly if is_length else goal.rate > 0.0
        return self.servo.reference.rate > 0.0 or demand

    def _reels_in(self) -> bool:
        """Whether the motion pulls at a snag; paying out frees the rover."""
        return self.servo.reference.rate < 0.0 or not self._pays_out()

    def _drive(self, now_ns: int, h: float) -> ServoCommand:
        tension, _ = self.tension_now(now_ns)
        sensed = SensedState(
            self.payout.length_at(now_ns / _NANO),
            self.payout.rate,
            tension,
            0.0 if self.load.is_supported else self.load.mean,
            self.drum.tension_of(-self._motor_torque, self.payout.length),
            self._brake_is_open,
        )
        slows = (
            self.mode is WinchMode.FAULT
            and self.fault is not None
            and self.fault.stops_before_braking
            and now_ns / _NANO - self._in_mode_since < _MAX_STOP_TIME
            and not self.servo.is_at_rest
        )
        if not self.mode.is_armed and not slows:
            return self.servo.emergency_stop(sensed)
        self._servo_steps += 1
        return self.servo.step(sensed, self._allowed_tension(), h)

    # --- helpers ---------------------------------------------------------------------------------

    def _check_armed(self, subject: str = topics.WINCH_REQUEST) -> None:
        if self.mode.is_armed:
            return
        why = f", {self.fault}: {self.fault_reason}" if self.fault is not None else ""
        raise Refusal(
            subject,
            RefusalCode.NOT_ARMED,
            f"the winch is in {self.mode}{why}; {topics.WINCH_REARM} arms it",
        )

    def _request_context(self, now_ns: int) -> RequestContext:
        tension, _ = self.tension_now(now_ns)
        length = self.payout.length
        return RequestContext(
            length,
            length if self._taut_length is None else self._taut_length,
            tension,
            self._tension_fault(),
            self._own_weight(),
            self.load.mean,
            self.load.is_supported,
            self._jump if self.is_jumping else "",
        )

    def _accept(self, accepted: AcceptedRequest, now: float, cause: Reason) -> bool:
        return self._enter(accepted.mode, accepted.reason, accepted.goal, now, cause)

    def _fault_inputs(self, now_ns: int) -> FaultInputs:
        now, servo = now_ns / _NANO, self.parameters.servo
        tension, _ = self.tension_now(now_ns)
        opening = self.servo.phase is BrakePhase.OPENING
        return FaultInputs(
            self.payout.fault(now - self._step_delay),
            tension,
            self._tension_fault(),
            self.load.state,
            self.payout.length,
            self.payout.rate,
            not self.servo.is_at_rest,
            self.servo.is_lagging,
            self.servo.time_in_phase if opening else 0.0,
            self.servo.feed_forward,
            self._allowed_tension(),
            (servo.shortest_length, servo.longest_length),
            servo.largest_rate + servo.trim_rate,
            self.goal.kind is not GoalKind.REST,
        )

    def _allowed_tension(self) -> float:
        return self.drum.tension_of(self.heat.allowed, self.payout.length)

    def _own_weight(self) -> float:
        return self.drum.hanging_weight(self.payout.length)

    def _tension_fault(self) -> str:
        return self.tension.mismatch or self.tension.cell_fault

    def _set_goal(self, goal: ServoGoal) -> None:
        """Set the servo's goal; reeling in is inhibited during a jump."""
        self.goal = goal
        allowed = replace(goal, reels_in=False) if self.is_jumping else goal
        if allowed != self.servo.goal:
            self.servo.set_goal(allowed)

    def _enter(
        self,
        mode: WinchMode,
        reason: str,
        goal: ServoGoal,
        now: float,
        cause: Reason,
        values: Mapping[str, object] | None = None,
    ) -> bool:
        """Enter a mode; returns whether the goal merely renews the present one."""
        # Renewals may differ a little, as a tension follows the paid-out weight. An ascent's rate
        # follows the swing: a motion to the same length goes on, whatever its rate.
        before = self.goal
        rate = before.rate if mode is WinchMode.LENGTH else goal.rate
        same = replace(goal, tension=before.tension, rate=rate) == before
        little = abs(goal.tension - before.tension) <= _RENEWAL_TOLERANCE * before.tension
        little &= abs(rate - before.rate) <= _RENEWAL_TOLERANCE * abs(before.rate)
        renewed = mode is self.mode and same and little
        self._set_goal(goal)
        if renewed:
            return True
        if mode not in (WinchMode.LENGTH, WinchMode.RATE):
            self._trimmed_at = None
            self.servo.trim(None)
        self.mode = mode
        self._in_mode_since = now
        self._servo_steps = 0
        event_values = {"length": self.payout.length, **(values or {})}
        self._transitions.append(mode_event(mode, reason, cause, event_values))
        return False
