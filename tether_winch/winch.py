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

from collections.abc import Mapping

from msg_schemas import topics
from msg_schemas.events import EventReport, WinchEvent
from msg_schemas.faults import Reason, WinchFault
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample
from tether_winch.drum_model import DrumModel
from tether_winch.fault_monitor import FaultInputs, FaultMonitor
from tether_winch.present_motion import PresentMotion
from tether_winch.requests import AcceptedRequest, RequestContext, RequestInterpreter
from tether_winch.servo import (
    REST,
    BrakePhase,
    GoalKind,
    ServoCommand,
    ServoGoal,
    WinchServo,
    quick_stop,
)
from tether_winch.winch_events import mode_event
from tether_winch.winch_parameters import WinchParameters
from tether_winch.winch_sensing import WinchSensing

_NANO = 1e9
_LATE_STEP = 0.05  # step interval above which a step is late [s]
_MAX_STOP_TIME = 1.5  # longest quick stop; then the brake closes [s]
_TRANSPORT_TIME = 0.3  # for which a renewal may be on its way, when its motion is held [s]
_RENEWED_MODES = (WinchMode.RATE, WinchMode.TENSION)
_STOPS_AT_TOUCHDOWN = (WinchMode.LENGTH, WinchMode.RATE)


class WinchController:
    """Controller of one winch.

    Attributes:
        mode: of the winch.
        fault: latched; None = none.
        fault_reason: why.
        sensing: estimates of payout, tension and load.
        motion: the present motion.
        servo: executes it.
    """

    def __init__(self, parameters: WinchParameters) -> None:
        self.parameters = parameters
        self.mode = WinchMode.DISARMED
        self.fault: WinchFault | None = None
        self.fault_reason = ""
        self.drum = DrumModel(parameters.drum)
        self.sensing = WinchSensing(parameters, self.drum)
        self.servo = WinchServo(parameters.servo, self.drum)
        self.motion = PresentMotion(self.servo)
        self._interpreter = _interpreter(parameters)
        self._fault_monitor = FaultMonitor(parameters.faults)
        self._tension_reached_since: float | None = None
        self._is_giving_slack = False
        self._transitions: list[EventReport] = []
        self._last_step: float | None = None
        self._step_delay = 0.0  # delay of the last step [s]

    def take_transitions(self) -> list[EventReport]:
        """Return the transitions since the last call, and clear them."""
        taken, self._transitions = self._transitions, []
        return taken

    def retune(self, parameters: WinchParameters) -> None:
        """Apply other parameters at once; a motion continues within the new limits."""
        self.parameters = parameters
        self.drum = DrumModel(parameters.drum)
        self.servo.retune(parameters.servo, self.drum)
        self.sensing.retune(parameters, self.drum)
        self._fault_monitor.parameters = parameters.faults
        self._interpreter = _interpreter(parameters)

    def on_jump(self, phase: str, now_ns: int) -> None:
        """Update with the phase of the jump; reeling in is inhibited during a jump."""
        was = self.motion.on_jump(phase, now_ns / _NANO)
        # Hooking its latch again, the rover is at rest.
        at_rest = was == JumpPhase.LANDED and phase in (JumpPhase.HOOKING, JumpPhase.STANDBY)
        if self.mode is WinchMode.SLACK and at_rest:
            self._tension_reached_since = None
            taking = self._interpreter.take_up(
                0.0, self._request_context(now_ns), "the rover has landed"
            )
            self._accept(taking, now_ns / _NANO, Reason.LANDED)

    # --- requests --------------------------------------------------------------------------------

    def request(self, sample: JointSample, now_ns: int) -> bool:
        """Start a motion; the joint's name selects its mode.

        Returns:
            Whether it continues the present motion.

        Raises:
            Refusal: not armed, out of limits, not allowed in this state, the payout is unknown, or
                a renewal of a motion that was held just now.
        """
        ((name, value),) = sample.joints.items()
        now = now_ns / _NANO
        self._check_armed()
        unknown = self.sensing.payout.fault(now)
        if unknown:
            reason = f"{unknown}, the payout is unknown"
            raise Refusal(topics.WINCH_REQUEST, RefusalCode.STALE, reason)
        accepted = self._interpreter.interpret(name, value, self._request_context(now_ns))
        self._check_hold(accepted, now)
        self._tension_reached_since = None
        renews = self._accept(accepted, now, Reason.REQUESTED)
        self._is_giving_slack = self.mode is WinchMode.SLACK and self.motion.goal.pays_out
        self.motion.renew(now, requires_renewal=accepted.is_renewed)
        return renews

    def hold(self, now_ns: int) -> str:
        """Come to rest smoothly and close the brake.

        Raises:
            Refusal: not armed.
        """
        self._check_armed(topics.WINCH_HOLD)
        now = now_ns / _NANO
        if self.mode is not WinchMode.HOLD:
            self.motion.hold(now)
        if self._enter(WinchMode.HOLD, "hold requested", REST, now, Reason.REQUESTED):
            # Reported at rest too: a mission that waits meanwhile must learn that it was stopped.
            self._report("hold requested", Reason.REQUESTED)
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
        if self.mode is WinchMode.FAULT:
            self.motion.aim(REST)  # it may still slow down
        else:
            self._enter(WinchMode.STOP, reason, REST, now_ns / _NANO, cause)

    def rearm(self, now_ns: int) -> str:
        """Arm after the start, a stop or a fault.

        Raises:
            Refusal: a fault is still present.
        """
        if self.mode.is_armed:
            return f"already armed, in {self.mode}"
        now = now_ns / _NANO
        self.sensing.tension.mismatch = ""
        self.sensing.payout.drift = 0.0
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
        self.motion.trim(rate, now_ns / _NANO)

    def clock_jumped(self, now_ns: int) -> None:
        """Reset the estimates and latch a fault: all times are invalid."""
        self.sensing.restart()
        self._fault_monitor.reset()
        self._last_step, self._step_delay = None, 0.0
        self.motion.clock_jumped(now_ns / _NANO)
        self.latch(WinchFault.CLOCK_JUMP, "the clock has jumped", now_ns)

    def latch(self, fault: WinchFault, reason: str, now_ns: int) -> None:
        """Latch a fault: close the brake until the winch is armed again."""
        if not self.mode.is_armed:
            return
        payout = self.sensing.payout
        values = {"fault": fault.value, "length": payout.length, "rate": payout.rate}
        goal = quick_stop(self.motion.goal)
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
        if not self.sensing.payout.is_known:
            return None
        self._transitions += self.sensing.step(now_ns, h, self._step_delay)
        late = self.parameters.faults.max_step_delay
        if h > late and not self.servo.is_at_rest:
            reason = f"a control step came after {h:.3g} s, the limit is {late:g} s"
            self.latch(WinchFault.NODE_LATE, reason, now_ns)
        found = self._fault_monitor.check(self._fault_inputs(now_ns), now)
        if found is not None:
            self._on_fault(*found, now_ns)
        self._step_mode(now_ns)
        return self._drive(now_ns, min(h, late))

    def _on_fault(self, fault: WinchFault, reason: str, now_ns: int) -> None:
        """Latch a fault; during a quick stop it replaces the fault and closes the brake."""
        if self.mode is not WinchMode.FAULT:
            self.latch(fault, reason, now_ns)
        elif self.fault is not None and self.fault.stops_before_braking:
            self.fault, self.fault_reason = fault, reason

    def _step_mode(self, now_ns: int) -> None:
        now, p = now_ns / _NANO, self.parameters
        motion, length = self.motion, self.sensing.payout.length
        motion.step(now, p.requests.jump_timeout)
        timeout, tolerance = p.faults.command_timeout, p.servo.length_tolerance
        is_unrenewed = motion.is_unrenewed(now, timeout)
        if self.mode in _RENEWED_MODES and is_unrenewed:
            reason = f"the {self.mode} request was not renewed within {timeout:g} s"
            self.latch(WinchFault.COMMAND_TIMEOUT, reason, now_ns)
        elif self._lacks_renewal and is_unrenewed:
            reason = (
                f"the request for {motion.goal.length:g} m was not renewed; stopping at "
                f"{length:.4g} m"
            )
            self._stop_moving(reason, now, Reason.RENEWAL_TIMEOUT)
        elif self._stops_at_touchdown and motion.pays_out(length, tolerance):
            self._stop_moving(f"touchdown at {length:.4g} m", now, Reason.TOUCHDOWN)
        elif self._stops_at_snag and motion.reels_in(length, tolerance):
            if self.mode.is_armed and self.mode is not WinchMode.HOLD:
                self._stop_moving(f"snag at {length:.4g} m", now, Reason.SNAG)
        elif self.mode is WinchMode.LENGTH and motion.is_complete(now):
            self._enter(WinchMode.HOLD, f"at {length:.4g} m", REST, now, Reason.COMPLETED)
        elif self.mode is WinchMode.SLACK and motion.goal.pays_out:
            if self._is_giving_slack and motion.is_complete(now):
                self._report_slack()
        elif self.mode in (WinchMode.RELAX, WinchMode.SLACK):
            self._end_by_tension(now_ns)

    @property
    def _lacks_renewal(self) -> bool:
        """Whether a length request is to be renewed while it moves."""
        is_moving = self.servo.motion.rate != 0.0
        return self.motion.requires_renewal and self.mode is WinchMode.LENGTH and is_moving

    @property
    def _stops_at_touchdown(self) -> bool:
        return self.mode in _STOPS_AT_TOUCHDOWN and self.sensing.load.is_supported

    @property
    def _stops_at_snag(self) -> bool:
        return self.sensing.load.is_snagged and not self.servo.is_at_rest

    def _stop_moving(self, reason: str, now: float, cause: Reason) -> None:
        self._enter(WinchMode.HOLD, reason, quick_stop(self.motion.goal), now, cause)

    def _report_slack(self) -> None:
        self._is_giving_slack = False
        length, taut = self.sensing.payout.length, self.sensing.taut_length
        slack = 0.0 if taut is None else max(length - taut, 0.0)
        text = f"{slack:.3g} m of slack at {length:.4g} m"
        values = {"length": length, "slack": slack}
        event = EventReport(WinchEvent.SLACK_REACHED, text, values, Reason.COMPLETED)
        self._transitions.append(event)

    def _end_by_tension(self, now_ns: int) -> None:
        """End a relaxation or a slack take-up when the tension reaches its setpoint."""
        tension, _ = self.sensing.tension_now(now_ns)
        setpoint = self.motion.goal.tension
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

    def _drive(self, now_ns: int, h: float) -> ServoCommand:
        sensed = self.sensing.state(now_ns)
        slows = (
            self.mode is WinchMode.FAULT
            and self.fault is not None
            and self.fault.stops_before_braking
            and self.motion.goal.quick
            and self.motion.age(now_ns / _NANO) < _MAX_STOP_TIME
            and not self.servo.is_at_rest
        )
        if not self.mode.is_armed and not slows:
            return self.servo.emergency_stop(sensed)
        self.motion.steps += 1
        return self.servo.step(sensed, self.sensing.allowed_tension, h)

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

    def _check_hold(self, accepted: AcceptedRequest, now: float) -> None:
        """Refuse a renewal that was on its way when the motion was held."""
        is_renewal = accepted.is_renewed or accepted.mode in _RENEWED_MODES
        age = self.motion.held_for(accepted.goal, now)
        if is_renewal and age < _TRANSPORT_TIME:
            raise Refusal(
                topics.WINCH_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"this motion was held {age:.2g} s ago, it can be requested again after "
                f"{_TRANSPORT_TIME:g} s",
            )

    def _request_context(self, now_ns: int) -> RequestContext:
        sensing = self.sensing
        tension, _ = sensing.tension_now(now_ns)
        length = sensing.payout.length
        return RequestContext(
            length,
            length if sensing.taut_length is None else sensing.taut_length,
            tension,
            sensing.tension_fault,
            sensing.own_weight,
            sensing.load.mean,
            sensing.load.is_supported,
            self.motion.jump,
        )

    def _accept(self, accepted: AcceptedRequest, now: float, cause: Reason) -> bool:
        return self._enter(accepted.mode, accepted.reason, accepted.goal, now, cause)

    def _fault_inputs(self, now_ns: int) -> FaultInputs:
        now, servo, sensing = now_ns / _NANO, self.parameters.servo, self.sensing
        tension, _ = sensing.tension_now(now_ns)
        opening = self.servo.phase is BrakePhase.OPENING
        return FaultInputs(
            sensing.payout.fault(now - self._step_delay),
            tension,
            sensing.tension_fault,
            sensing.load.state,
            sensing.payout.length,
            sensing.payout.rate,
            not self.servo.is_at_rest,
            self.servo.is_lagging,
            self.servo.time_in_phase if opening else 0.0,
            self.servo.feed_forward,
            sensing.allowed_tension,
            (servo.shortest_length, servo.longest_length),
            servo.largest_rate + servo.trim_rate,
            self.motion.goal.kind is not GoalKind.REST,
        )

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
        is_length = mode is WinchMode.LENGTH
        renewed = mode is self.mode and self.motion.continues(goal, at_any_rate=is_length)
        self.motion.aim(goal)
        if renewed:
            return True
        if mode not in (WinchMode.LENGTH, WinchMode.RATE):
            self.motion.end_trim()
        self.mode = mode
        self.motion.begin(now)
        self._report(reason, cause, values)
        return False

    def _report(
        self, reason: str, cause: Reason, values: Mapping[str, object] | None = None
    ) -> None:
        event_values = {"length": self.sensing.payout.length, **(values or {})}
        self._transitions.append(mode_event(self.mode, reason, cause, event_values))


def _interpreter(p: WinchParameters) -> RequestInterpreter:
    return RequestInterpreter(p.requests, p.servo, p.load.touchdown_threshold)
