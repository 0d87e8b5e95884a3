"""The mother machine's winch: modes, requests with their refusals, and faults. Pure.

It is told what sensors and operators say, and stepped by time; it returns what the drive is to do.

========  ====================================================================================
disarmed  brake closed; armed by service only
hold      brake closed, or about to be, by itself when a motion has ended
length    to a length by an S-curve; ends in hold, or at a touchdown or snag, or where a request
          that is to be renewed is not
rate      at a rate, renewed by its request
tension   holds a tension at the fairlead, renewed by its request
slack     gives slack beyond the taut length and then keeps it, or takes it up
relax     pays out until the tether carries little more than itself
stop      brake closed at once; armed by service only
fault     the same, with its reason
========  ====================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from msg_schemas import topics
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
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level, WrenchSample
from msg_schemas.transition import Transition
from tether_winch.drum_model import DrumModel, DrumParameters
from tether_winch.estimates import (
    EstimateParameters,
    PayoutEstimate,
    TensionEstimate,
    TensionSource,
)
from tether_winch.guard import Fault, Guard, GuardParameters, Watched
from tether_winch.load_watch import LoadParameters, LoadState, LoadWatch
from tether_winch.requests import Accepted, Mode, RequestJudge, RequestParameters, Situation
from tether_winch.servo import (
    REST,
    BrakePhase,
    DriveCommand,
    Goal,
    GoalKind,
    Sensed,
    ServoParameters,
    WinchServo,
    at_rest_quickly,
)
from tether_winch.thermal import MotorHeat

_NANO = 1e9
_OPEN = 0.5  # a brake's position from here on means released
_MOVING = 0.02  # from this rate on the drum moves [m/s]
_JUMPING = frozenset({"compressing", "settling", "releasing", "flight", "landed"})
_STALL = 0.05  # a step that comes later than this after the last one comes late [s]
_BEGINNING = 3  # steps after which a motion that has something to do has begun
_QUICK_LIMIT = 1.5  # longest stop before the brake closes in any case [s]
_LITTLE = 0.1  # part of a held tension, or of a way's rate, by which a renewal may differ
_SHORTEST = 0.05  # a motion, before it is over [s]
_TRIM_AWAITED = 0.3  # the same, of one that is renewed [s]
_TRIM_TIMEOUT = 0.5  # a trim not renewed for longer has ended [s]


_RENEWED = (Mode.RATE, Mode.TENSION)
_STOPS_AT_TOUCHDOWN = (Mode.LENGTH, Mode.RATE)


@dataclass(frozen=True)
class WinchParameters:
    """All that the winch is told of itself."""

    drum: DrumParameters = field(default_factory=DrumParameters)
    estimates: EstimateParameters = field(default_factory=EstimateParameters)
    load: LoadParameters = field(default_factory=LoadParameters)
    servo: ServoParameters = field(default_factory=ServoParameters)
    guard: GuardParameters = field(default_factory=GuardParameters)
    requests: RequestParameters = field(default_factory=RequestParameters)


class Winch:
    """One winch.

    Args:
        parameters: all of them.
    """

    def __init__(self, parameters: WinchParameters) -> None:
        self.parameters = parameters
        self.mode = Mode.DISARMED
        self.fault: Fault | None = None
        self.fault_reason = ""
        self.drum = DrumModel(parameters.drum)
        self.servo = WinchServo(parameters.servo, self.drum)
        self._judge = RequestJudge(
            parameters.requests, parameters.servo, parameters.load.touchdown_threshold
        )
        self._goal = REST
        self._in_mode_since = 0.0
        self._driven = 0  # steps of the servo since the mode began
        self._renewed = 0.0
        self._is_renewed = False  # the length is gone to only while its request is renewed
        self._trimmed: float | None = None
        self._jump = ""
        self._jump_since = 0.0
        self._taut: float | None = None  # length at which the tether was last taut [m]
        self._tight_since: float | None = None
        self._transitions: list[Transition] = []
        self._begin_sensing()

    def _begin_sensing(self) -> None:
        p = self.parameters
        self.payout = PayoutEstimate(p.estimates)
        self.tension = TensionEstimate(p.estimates, self.drum)
        self.load = LoadWatch(p.load)
        self.heat = MotorHeat(
            p.drum.motor_continuous_torque, p.drum.motor_torque, p.drum.motor_thermal_time
        )
        self._guard = Guard(p.guard)
        self._brake_is_open = False
        self._torque = 0.0
        self._last: float | None = None
        self._late = 0.0  # by which the last step came too late [s]
        self._alarms: dict[str, bool] = {}

    def take_transitions(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._transitions = self._transitions, []
        return taken

    # --- sensors ---------------------------------------------------------------------------------

    def on_drum(self, sample: JointSample, now_ns: int) -> None:
        """Take the state of drum and brake."""
        length, rate, _ = sample.joints[WINCH_DRUM]
        is_open = sample.joints[WINCH_BRAKE].position >= _OPEN
        now = now_ns / _NANO
        moves = max(abs(rate), abs(self.payout.rate)) > _MOVING
        if self._brake_is_open and not is_open and moves:
            self.load.note_braking(now)
        self._brake_is_open = is_open
        taken = sample.stamp_ns / _NANO if sample.stamp_ns else now
        self.payout.hear(length, rate, taken, now)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Take the pull of the tether at the fairlead."""
        self.tension.on_cell(math.hypot(*sample.force), now_ns / _NANO)

    def on_currents(self, sample: JointSample, now_ns: int) -> None:
        """Take the motors' currents; the winch's counts."""
        current = sample.joints[WINCH_MOTOR].effort
        self._torque = current * self.parameters.drum.torque_constant
        self.tension.on_motor(current, self.payout, self._brake_is_open, now_ns / _NANO)

    def note_silence(self, reason: str) -> None:
        """The sensors are silent by another clock than the controller's: nothing is known."""
        self.tension.lose(reason)
        self.load.lose()

    def retune(self, parameters: WinchParameters) -> None:
        """Go by other parameters at once; what moves goes on within the new limits."""
        self.parameters = parameters
        self.drum = DrumModel(parameters.drum)
        self.servo.retune(parameters.servo, self.drum)
        self.payout.parameters = parameters.estimates
        self.tension.retune(parameters.estimates, self.drum)
        self.load.parameters = parameters.load
        self._guard.parameters = parameters.guard
        self._judge = RequestJudge(
            parameters.requests, parameters.servo, parameters.load.touchdown_threshold
        )

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics of the sensors that are silent: nothing is moved without them."""
        now = now_ns / _NANO
        silent = []
        if self.payout.silence(now) > self.parameters.estimates.encoder_timeout:
            silent.append(topics.WINCH_STATE)
        if self.tension.cell_fault:
            silent.append(topics.LOAD_CELL)
        return tuple(silent)

    def on_jump(self, phase: str, now_ns: int) -> None:
        """Take the phase of the jump: nothing is reeled in while the rover jumps."""
        was = self._jump
        self._jump, self._jump_since = phase, now_ns / _NANO
        self._set_goal(self._goal)
        if self.mode is Mode.SLACK and was == "landed" and phase == "standby":
            self._tight_since = None
            taking = self._judge.take_up(0.0, self._situation(now_ns), "the rover has landed")
            self._accept(taking, now_ns / _NANO)

    # --- what is known ---------------------------------------------------------------------------

    @property
    def is_jumping(self) -> bool:
        """Whether a jump is under way, as far as it was told."""
        return self._jump in _JUMPING

    @property
    def alarms(self) -> Mapping[str, bool]:
        """Touchdown, slack, snag and over-tension, each whether it is so."""
        return self.load.alarms

    def tension_now(self, now_ns: int) -> tuple[float, TensionSource]:
        """Tension [N] that the winch goes by, and its source; NaN where none is valid."""
        value, source = self.tension.value(now_ns / _NANO)
        if source is TensionSource.MOTOR and self.parameters.guard.load_cell_required:
            return math.nan, TensionSource.NONE
        return value, source

    def estimate(self, now_ns: int) -> JointSample | None:
        """What is made of encoder, current and load cell, as `winch/estimate` tells it.

        None before the drum has spoken. Where no tension is valid, the stretched length is that
        under what hangs.
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
                min(self.servo.aimed_tension, MAX_TENSION),
            ),
        }
        return JointSample(now_ns, values)

    # --- asked from outside ----------------------------------------------------------------------

    def request(self, sample: JointSample, now_ns: int) -> None:
        """Take a request for a motion; the joint's name is its mode.

        Raises:
            Refusal: not armed, out of limits, not now, or the winch's own state is not known.
        """
        ((name, value),) = sample.joints.items()
        now = now_ns / _NANO
        self._check_armed()
        unknown = self.payout.fault(now)
        if unknown:
            reason = f"{unknown}, so where the drum stands is not known"
            raise Refusal(topics.WINCH_REQUEST, RefusalCode.STALE, reason)
        accepted = self._judge.judge(name, value, self._situation(now_ns))
        self._tight_since = None
        self._accept(accepted, now)
        self._renewed = now
        self._is_renewed = accepted.is_renewed

    def hold(self, now_ns: int) -> str:
        """Come to rest smoothly and close the brake.

        Raises:
            Refusal: not armed.
        """
        self._check_armed(topics.WINCH_HOLD)
        self._enter(Mode.HOLD, "asked to hold", replace(REST), now_ns / _NANO)
        return "coming to rest"

    def relax(self, now_ns: int) -> str:
        """Pay out slowly until the tether carries little more than itself.

        Raises:
            Refusal: not armed, the tension is not known, or the rover hangs.
        """
        self._check_armed(topics.WINCH_RELAX)
        self._accept(self._judge.relax(self._situation(now_ns)), now_ns / _NANO)
        return "letting the pull down"

    def stop(self, reason: str, now_ns: int) -> None:
        """Close the brake at once, motor off; always done."""
        if self.mode is not Mode.FAULT:
            self._enter(Mode.STOP, reason, REST, now_ns / _NANO, Level.WARN)

    def rearm(self, now_ns: int) -> str:
        """Arm after the start, a stop or a fault.

        Raises:
            Refusal: what caused the fault is still there.
        """
        if self.mode.is_armed:
            return f"already armed, in {self.mode}"
        now = now_ns / _NANO
        self.tension.mismatch = ""
        self.payout.drift = 0.0
        self._guard.forget()
        found = self._guard.find(self._watched(now_ns), now)
        if found is not None:
            raise Refusal(topics.WINCH_REARM, RefusalCode.NOT_ARMED, found[1])
        self.fault, self.fault_reason = None, ""
        self._enter(Mode.HOLD, f"armed, was in {self.mode}", REST, now)
        return "armed"

    def trim(self, rate: float, now_ns: int) -> None:
        """Add a rate [m/s] to that of a length or rate request, for a short while.

        Raises:
            Refusal: in another mode.
        """
        if self.mode not in (Mode.LENGTH, Mode.RATE):
            raise Refusal(
                topics.WINCH_TRIM,
                RefusalCode.WRONG_PHASE,
                f"the winch is in {self.mode}, a trim adds to {Mode.LENGTH} or {Mode.RATE}",
            )
        self._trimmed = now_ns / _NANO
        self.servo.trim(rate)

    def clock_jumped(self, now_ns: int) -> None:
        """The clock has jumped: nothing that was timed by it can be trusted."""
        mean = self.load.mean
        self._begin_sensing()
        self.load.mean = mean
        self._trimmed = None
        self._jump_since = self._in_mode_since = now_ns / _NANO
        self.latch(Fault.CLOCK_JUMP, "the clock has jumped", now_ns)

    def latch(self, fault: Fault, reason: str, now_ns: int) -> None:
        """Brake and stay braked, for a reason."""
        if not self.mode.is_armed:
            return
        values = {"fault": fault.value, "length": self.payout.length, "rate": self.payout.rate}
        goal = at_rest_quickly(self._goal)
        self.fault, self.fault_reason = fault, reason
        self._enter(Mode.FAULT, f"{fault}: {reason}", goal, now_ns / _NANO, Level.ERROR, values)

    # --- stepped by time -------------------------------------------------------------------------

    def step(self, now_ns: int) -> DriveCommand | None:
        """Advance to now; returns what the drive is told, None before the drum has spoken."""
        now = now_ns / _NANO
        h = 0.0 if self._last is None else now - self._last
        self._last = now
        # After a stall of its own the time is known before what the sensors said meanwhile.
        self._late = h if h > _STALL else 0.0
        if not self.payout.is_known:
            return None
        self._sense(now_ns, h)
        late = self.parameters.guard.max_step_delay
        if h > late and not self.servo.rests:
            reason = f"the controller was late by {h:.3g} s, at most {late:g} s is right"
            self.latch(Fault.NODE_LATE, reason, now_ns)
        found = self._guard.find(self._watched(now_ns), now)
        if found is not None:
            self._on_fault(*found, now_ns)
        self._follow_mode(now_ns)
        return self._drive(now_ns, min(h, late))

    def _sense(self, now_ns: int, h: float) -> None:
        now = now_ns / _NANO
        self.tension.step(self.payout, now - self._late)
        tension, _ = self.tension_now(now_ns)
        own = self._own_weight()
        self.load.step(
            tension,
            own,
            self.payout.rate,
            self.drum.bounce_period(self.payout.length, self.load.mean),
            now,
        )
        if not math.isnan(tension):
            light = 0.5 * self.parameters.requests.take_up_tension
            if tension - own > light:
                self._taut = self.payout.length
        self.heat.step(self._torque, h)
        for name, is_on in self.load.alarms.items():
            if is_on is not self._alarms.get(name, False):
                self._publish_alarm(name, is_on, tension)
        self._alarms = dict(self.load.alarms)

    def _on_fault(self, fault: Fault, reason: str, now_ns: int) -> None:
        """Latch a fault; one that comes while the drum is still slowing down ends that."""
        if self.mode is not Mode.FAULT:
            self.latch(fault, reason, now_ns)
        elif self.fault is not None and self.fault.comes_to_rest_first:
            self.fault, self.fault_reason = fault, reason

    def _follow_mode(self, now_ns: int) -> None:
        now, p = now_ns / _NANO, self.parameters
        if self.is_jumping and now - self._jump_since > p.requests.jump_timeout:
            self._jump = ""
            self._set_goal(self._goal)
        if self._trimmed is not None and now - self._trimmed > _TRIM_TIMEOUT:
            self._trimmed = None
            self.servo.trim(None)
        if self.mode in _RENEWED and now - self._renewed > p.guard.command_timeout:
            reason = f"the {self.mode} request was not renewed within {p.guard.command_timeout:g} s"
            self.latch(Fault.COMMAND_TIMEOUT, reason, now_ns)
        elif self._is_forgotten(now):
            goal = at_rest_quickly(self._goal)
            reason = (
                f"who asked for {self._goal.length:g} m is silent, at {self.payout.length:.4g} m"
            )
            self._enter(Mode.HOLD, reason, goal, now, Level.WARN)
        elif self.mode in _STOPS_AT_TOUCHDOWN and self.load.is_supported and self._pays_out():
            goal = at_rest_quickly(self._goal)
            self._enter(Mode.HOLD, f"touchdown at {self.payout.length:.4g} m", goal, now)
        elif self.load.is_snagged and not self.servo.rests and self._reels_in():
            if self.mode.is_armed and self.mode is not Mode.HOLD:
                goal = at_rest_quickly(self._goal)
                reason = f"snag at {self.payout.length:.4g} m"
                self._enter(Mode.HOLD, reason, goal, now, Level.WARN)
        elif self.mode is Mode.LENGTH and self._has_ended(now):
            self._enter(Mode.HOLD, f"at {self.payout.length:.4g} m", REST, now)
        elif self.mode is Mode.RELAX or (self.mode is Mode.SLACK and not self._goal.pays_out):
            self._end_by_tension(now_ns)

    def _end_by_tension(self, now_ns: int) -> None:
        """Relaxing and taking up end when the tension has come there."""
        tension, _ = self.tension_now(now_ns)
        sought = self._goal.tension
        slackening = self.mode is Mode.RELAX
        beyond = tension <= sought if slackening else tension >= 0.9 * sought
        now = now_ns / _NANO
        if not beyond:
            self._tight_since = None
        elif self._tight_since is None:
            self._tight_since = now
        elif now - self._tight_since > 0.2:
            self._tight_since = None
            done = "relaxed" if slackening else "the slack is taken up"
            self._enter(Mode.HOLD, f"{done}: {tension:.3g} N", REST, now)

    def _has_ended(self, now: float) -> bool:
        # By time alone a stalled node would take a motion that has not begun for one that is over.
        # A controller that would trim hears of the motion first, and its trim comes after that.
        least = _TRIM_AWAITED if self._is_renewed else _SHORTEST
        begun = self._driven >= _BEGINNING and now - self._in_mode_since > least
        return begun and self._trimmed is None and self.servo.rests

    def _is_forgotten(self, now: float) -> bool:
        """Whether a length is gone to for somebody who does not renew the request any more."""
        return (
            self._is_renewed
            and self.mode is Mode.LENGTH
            and now - self._renewed > self.parameters.guard.command_timeout
            and self.servo.motion.rate != 0.0
        )

    def _pays_out(self) -> bool:
        goal = self._goal
        # Of a length's goal the rate is a largest one, whichever way it leads.
        is_length = goal.kind is GoalKind.LENGTH
        wants = goal.length > self.payout.length if is_length else goal.rate > 0.0
        return self.servo.reference.rate > 0.0 or wants

    def _reels_in(self) -> bool:
        """Whether what holds the rover is pulled at; paying out lets it come free."""
        return self.servo.reference.rate < 0.0 or not self._pays_out()

    def _drive(self, now_ns: int, h: float) -> DriveCommand:
        tension, _ = self.tension_now(now_ns)
        sensed = Sensed(
            self.payout.length_at(now_ns / _NANO),
            self.payout.rate,
            tension,
            0.0 if self.load.is_supported else self.load.mean,
            self.drum.tension_of(-self._torque, self.payout.length),
            self._brake_is_open,
        )
        slows = (
            self.mode is Mode.FAULT
            and self.fault is not None
            and self.fault.comes_to_rest_first
            and now_ns / _NANO - self._in_mode_since < _QUICK_LIMIT
            and not self.servo.rests
        )
        if not self.mode.is_armed and not slows:
            return self.servo.close_at_once(sensed)
        self._driven += 1
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

    def _situation(self, now_ns: int) -> Situation:
        tension, _ = self.tension_now(now_ns)
        length = self.payout.length
        return Situation(
            length,
            length if self._taut is None else self._taut,
            tension,
            self._tension_fault(),
            self._own_weight(),
            self.load.mean,
            self.load.is_supported,
            self._jump if self.is_jumping else "",
        )

    def _accept(self, accepted: Accepted, now: float) -> None:
        self._enter(accepted.mode, accepted.reason, accepted.goal, now)

    def _watched(self, now_ns: int) -> Watched:
        now, servo = now_ns / _NANO, self.parameters.servo
        tension, _ = self.tension_now(now_ns)
        opening = self.servo.phase is BrakePhase.OPENING
        return Watched(
            self.payout.fault(now - self._late),
            tension,
            self._tension_fault(),
            self.load.state,
            self.payout.length,
            self.payout.rate,
            not self.servo.rests,
            self.servo.waits,
            self.servo.time_in_phase if opening else 0.0,
            self.servo.feed_forward,
            self._allowed_tension(),
            (servo.shortest_length, servo.longest_length),
            servo.largest_rate + servo.trim_rate,
            self._goal.kind is not GoalKind.REST,
        )

    def _allowed_tension(self) -> float:
        return self.drum.tension_of(self.heat.allowed, self.payout.length)

    def _own_weight(self) -> float:
        return self.drum.hanging_weight(self.payout.length)

    def _tension_fault(self) -> str:
        return self.tension.mismatch or self.tension.cell_fault

    def _set_goal(self, goal: Goal) -> None:
        """Aim at a goal; while the rover jumps nothing is reeled in."""
        self._goal = goal
        told = replace(goal, reels_in=False) if self.is_jumping else goal
        if told != self.servo.goal:
            self.servo.aim(told)

    def _enter(
        self,
        mode: Mode,
        reason: str,
        goal: Goal,
        now: float,
        level: Level = Level.OK,
        values: Mapping[str, object] | None = None,
    ) -> None:
        # Who leads a tether renews with the weight that is out now, and who goes up slows down as
        # the tether gets short: each time a little other.
        before = self._goal
        rate = before.rate if mode is Mode.LENGTH else goal.rate
        same = replace(goal, tension=before.tension, rate=rate) == before
        little = abs(goal.tension - before.tension) <= _LITTLE * before.tension
        little &= abs(goal.rate - before.rate) <= _LITTLE * abs(before.rate)
        renewed = mode is self.mode and same and little
        self._set_goal(goal)
        if renewed:
            return
        if mode not in (Mode.LENGTH, Mode.RATE):
            self._trimmed = None
            self.servo.trim(None)
        self.mode = mode
        self._in_mode_since = now
        self._driven = 0
        told = {"length": self.payout.length, **(values or {})}
        self._transitions.append(Transition(f"winch_{mode}", reason, level, told))

    def _publish_alarm(self, name: str, is_on: bool, tension: float) -> None:
        values = {"tension": tension, "length": self.payout.length, "load_mean": self.load.mean}
        if is_on:
            level = Level.ERROR if name == LoadState.OVER_TENSION else Level.WARN
            level = Level.OK if name in (LoadState.TOUCHDOWN, LoadState.SLACK) else level
            reason = f"tension {tension:.4g} N at {self.payout.length:.4g} m"
            self._transitions.append(Transition(f"alarm_{name}", reason, level, values))
        else:
            reason = f"tension {tension:.4g} N"
            self._transitions.append(Transition(f"alarm_{name}_ended", reason, values=values))
