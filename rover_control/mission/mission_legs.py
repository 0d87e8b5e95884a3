"""Leg tasks of the hanging rover: requests and completion criteria. Pure.

A task depends only on the observed state, so that it can start at any time: after a hold, after a
restart of the mission, or after a failed trial.

=========  ==================================================================================
look       stop of the descent controller with pictures
turn       heading of the descent controller
approach   stop without pictures
damp       stop in a recovery; ends after a time limit whatever the residual swing
land       the winch pays out until touchdown
lift       the winch reels in until the rover hangs
ascend     stop at the stow
stow       the descent controller releases winch and wheels
=========  ==================================================================================

The tasks on the floor are in `mission_floor`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.commands import CommandRecord, CommandState, read_command
from msg_schemas.events import NodeEvent, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.parameters import parameter
from msg_schemas.phases import DescentPhase, MissionPhase
from msg_schemas.samples import JointSample, JointValue, Sample, Status
from rover_control.mission.mission_interlocks import RequestedAction
from rover_control.mission.mission_plan import MissionPlan
from rover_control.mission.mission_route import Leg, LegKind
from rover_control.mission.observed_state import ObservedState

RESPONSE_TIMEOUT = 3.0
"""Time in which a node must respond to a request [s]."""
_RENEWAL_PERIOD = 0.25  # of a renewed length request [s]
_LATCH_DELAY = 0.5  # delay until the phase of a finished stop has been received [s]
_CONFIRM_TIME = 2.0  # time before a change between standing and hanging counts [s]
_DEPTH_TOLERANCE = 0.1  # tolerance of a depth at which residual swing is accepted [m]
_DAMPING_TIME = {LegKind.ASCEND: 60.0, LegKind.DAMP: 120.0}
"""Time for damping after the depth was reached [s]."""


@dataclass(frozen=True)
class LegLimits:
    """Time limits of one trial of a leg."""

    look_timeout: float = parameter(1400.0, "s", "stop with pictures", 10.0, 1e5)
    turn_timeout: float = parameter(300.0, "s", "turn about the plumb line", 10.0, 1e5)
    approach_timeout: float = parameter(900.0, "s", "approach to the floor", 10.0, 1e5)
    damp_timeout: float = parameter(600.0, "s", "damping of the swing in a recovery", 10.0, 1e5)
    land_timeout: float = parameter(300.0, "s", "landing", 10.0, 1e5)
    visit_timeout: float = parameter(900.0, "s", "drive to a waypoint", 10.0, 1e5)
    jump_timeout: float = parameter(120.0, "s", "slack and jump at a waypoint", 10.0, 1e5)
    return_timeout: float = parameter(900.0, "s", "drive back below the fairlead", 10.0, 1e5)
    lift_timeout: float = parameter(600.0, "s", "lift off the floor", 10.0, 1e5)
    ascend_timeout: float = parameter(2400.0, "s", "ascent", 10.0, 1e5)
    stow_timeout: float = parameter(60.0, "s", "release of the actuators at the stow", 10.0, 1e5)
    stuck_jump_timeout: float = parameter(60.0, "s", "slack and jump where stuck", 5.0, 1e4)

    def of(self, kind: LegKind) -> float:
        """Time limit [s] of a trial."""
        limit: float = getattr(self, f"{kind}_timeout")
        return limit


class LegRequest(NamedTuple):
    """A request on a topic, or a service call if it has no sample."""

    name: str
    sample: Sample | None = None


class ProposedRequest(NamedTuple):
    """A request that a task proposes, subject to the interlocks."""

    action: RequestedAction
    request: LegRequest
    period: float = RESPONSE_TIMEOUT  # least time before it is repeated [s]
    moves_winch: bool = False  # the winch moves for it, and is held if the request is forbidden


class LegResult(Enum):
    """Result of a trial of a leg."""

    DONE = auto()
    FAILED = auto()  # another trial is possible
    ABANDONED = auto()  # another trial is useless
    OVERRIDDEN = auto()  # another command source has taken over


class LegEnd(NamedTuple):
    """End of a trial of a leg."""

    result: LegResult
    reason: str
    is_external: bool = False  # caused by another node, wherever the rover stands


@dataclass
class Blackboard:
    """Data shared between legs; saved in the checkpoint.

    Attributes:
        floor_length: tether length at touchdown [m]; NaN = no touchdown yet.
        initial_heading: heading of the descent controller at the start of the mission [rad].
        pictures: number taken.
        jumps: number performed.
    """

    floor_length: float = math.nan
    initial_heading: float = math.nan
    pictures: int = 0
    jumps: int = 0


class LegTask(ABC):
    """One trial of a leg.

    Args:
        leg: the leg.
        plan: of the mission.
        blackboard: data shared between legs.
        now: time [s].
    """

    phase: MissionPhase

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        self.leg = leg
        self.plan = plan
        self.blackboard = blackboard
        self.started = now
        self.requested_at: float | None = None  # time of the last request of this task [s]

    def on_sent(self, request: LegRequest, now: float) -> None:
        """Record that a request of this task was sent."""
        if request.sample is not None:
            self.requested_at = now

    @abstractmethod
    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Propose the next request, or report the end; None = wait."""

    def _is_overdue(self, now: float) -> bool:
        """Whether the response to the last request is overdue."""
        return self.requested_at is not None and now - self.requested_at > RESPONSE_TIMEOUT


def ended_record(events: Sequence[Status], subject: str) -> CommandRecord | None:
    """The record of the mission's last request on a topic, once it has ended."""
    for status in events:
        record = read_command(status)
        if record is not None and record.subject == subject and record.state.is_over:
            return record
    return None


def overridden(record: CommandRecord, what: str) -> LegEnd:
    """The end of a leg whose request another command source has stopped or replaced."""
    does = "holds" if record.reason is Reason.REQUESTED else "moves"
    return LegEnd(LegResult.OVERRIDDEN, f"another command source {does} the {what}")


def is_hold_of_winch(status: Status) -> bool:
    """Whether an event reports that the winch was held on request."""
    return status.name == WinchEvent.HOLD and status.values.get("reason") == Reason.REQUESTED


def has_restarted(events: Sequence[Status], node: str) -> bool:
    """Whether a node has started again, so that it knows no request of the mission."""
    return any(status.name == NodeEvent.ACTIVE and status.hardware_id == node for status in events)


def joint_request(name: str, position: float, velocity: float = 0.0) -> JointSample:
    """A request for one joint."""
    return JointSample(0, {name: JointValue(position, velocity, 0.0)})


# --- hanging -------------------------------------------------------------------------------------


class StopTask(LegTask):
    """Travels to a depth under descent control, with or without pictures."""

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self.phase = {
            LegKind.LOOK: MissionPhase.LOOKING,
            LegKind.APPROACH: MissionPhase.APPROACHING,
            LegKind.DAMP: MissionPhase.APPROACHING,
            LegKind.ASCEND: MissionPhase.ASCENDING,
        }[leg.kind]
        self._reached_at = math.inf  # first arrival at the depth; damping may leave it again [s]
        self._is_cleared = False  # of stops from an earlier command source
        self._was_interrupted = False

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Request the stop once and monitor it."""
        looks = self.leg.kind is LegKind.LOOK
        if not observed.descent:
            return None  # its phase is latched and will arrive
        if math.isnan(self.blackboard.initial_heading) and not math.isnan(observed.heading):
            self.blackboard.initial_heading = observed.heading
        record = ended_record(events, topics.DESCENT_REQUEST)
        if self.requested_at is not None and record is not None:
            end = self._on_record(record, observed)
            if end is not None:
                return end
        damping_time = _DAMPING_TIME.get(self.leg.kind, math.inf)
        if damping_time < math.inf and self.requested_at is not None:
            if abs(observed.length - self.leg.depth) < _DEPTH_TOLERANCE:
                self._reached_at = min(self._reached_at, now)
            if now - self._reached_at > damping_time:
                major, minor = map(math.degrees, observed.swing)
                swing = f"swinging by {major:.2f} x {abs(minor):.2f} deg"
                return LegEnd(LegResult.DONE, f"at {observed.length:.2f} m, {swing}")
        is_held = observed.descent == DescentPhase.HOLDING
        if is_held and self._was_interrupted and self.requested_at is not None:
            return ProposedRequest(RequestedAction.DESCEND, LegRequest(topics.DESCENT_RESUME))
        if not self._is_cleared and self.requested_at is None:
            if observed.descent_busy and now - self.started < _LATCH_DELAY:
                return None
            if observed.descent_busy or observed.descent == DescentPhase.HOLDING:
                return ProposedRequest(RequestedAction.DESCEND, LegRequest(topics.DESCENT_ABORT))
            self._is_cleared = True
        idle = observed.descent in ("", DescentPhase.RELEASED, DescentPhase.STANDBY)
        is_lost = (
            idle and self._is_overdue(now) and now - self._idle_since(observed) > RESPONSE_TIMEOUT
        )
        if self.requested_at is None or is_lost:
            joint = machine.OBSERVATION_STOP if looks else machine.PLAIN_STOP
            return ProposedRequest(
                RequestedAction.DESCEND,
                LegRequest(topics.DESCENT_REQUEST, joint_request(joint, self.leg.depth)),
            )
        return None

    def _idle_since(self, observed: ObservedState) -> float:
        # A descent that has just engaged first estimates the swing in standby.
        since = observed.since.get(topics.DESCENT_PHASE, -math.inf)
        return since + (30.0 if observed.descent == DescentPhase.STANDBY else 0.0)

    def _on_record(self, record: CommandRecord, observed: ObservedState) -> LegEnd | None:
        """Process the end of the request."""
        if record.state is CommandState.REFUSED:
            if observed.descent in (DescentPhase.RELEASED, DescentPhase.STANDBY):
                return LegEnd(LegResult.FAILED, record.text)
            if observed.descent == DescentPhase.HOLDING:
                # It was holding before the request: clear that first.
                self.requested_at, self._is_cleared = None, False
            return None
        if "pictures" in record.result:
            return self._ended(record)
        if record.reason is Reason.REQUESTED:
            return overridden(record, "descent")
        self._was_interrupted = True
        return None

    def _ended(self, record: CommandRecord) -> LegEnd:
        looks, pictures = self.leg.kind is LegKind.LOOK, record.number("pictures")
        if looks and pictures > 0.0:
            self.blackboard.pictures += round(pictures)
            return LegEnd(LegResult.DONE, record.text)
        if looks:
            return LegEnd(LegResult.ABANDONED, record.text)
        reached = record.state is CommandState.DONE
        return LegEnd(LegResult.DONE if reached else LegResult.FAILED, record.text)


class TurnTask(LegTask):
    """Turns to a heading about the plumb line."""

    phase = MissionPhase.TURNING

    def step(
        self,
        observed: ObservedState,
        events: Sequence[Status],
        now: float,  # noqa: ARG002 - no time limit of its own
    ) -> ProposedRequest | LegEnd | None:
        """Request the turn once; abandon it on a refusal."""
        if self.requested_at is None:
            if observed.descent_busy:
                return None
            request = LegRequest(
                topics.DESCENT_REQUEST, joint_request(machine.HEADING_TURN, self.leg.angle)
            )
            return ProposedRequest(RequestedAction.DESCEND, request)
        record = ended_record(events, topics.DESCENT_REQUEST)
        if record is None:
            return None
        if record.state is CommandState.SUPERSEDED and record.reason is Reason.REQUESTED:
            return overridden(record, "descent")
        is_done = record.state is CommandState.DONE
        return LegEnd(LegResult.DONE if is_done else LegResult.ABANDONED, record.text)


class WinchTask(LegTask):
    """Moves the winch by a length request that it renews until its record has ended."""

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Renew the request; at the end of its record check the rover."""
        record = ended_record(events, topics.WINCH_REQUEST)
        if record is not None and self.requested_at is not None:
            if record.state is CommandState.SUPERSEDED:
                return overridden(record, "winch")
            end = self._on_record(record, observed, now)
            if end is not None:
                return end
        # The previous user of the winch may still be stopping it.
        if self.requested_at is None and observed.winch_moving and not observed.descent_engaged:
            return None
        return self._move(observed, now)

    @abstractmethod
    def _on_record(
        self, record: CommandRecord, observed: ObservedState, now: float
    ) -> LegEnd | None:
        """Process the end of the request; None = request it again, or wait."""

    @abstractmethod
    def _move(self, observed: ObservedState, now: float) -> ProposedRequest | LegEnd | None:
        """Propose the next request, or report the end."""


class LandTask(WinchTask):
    """Lands: the winch pays out until touchdown."""

    phase = MissionPhase.LANDING
    _has_landed = False  # the winch has reported touchdown

    def _on_record(
        self,
        record: CommandRecord,
        observed: ObservedState,
        now: float,  # noqa: ARG002 - the alarm confirms the touchdown
    ) -> LegEnd | None:
        # A rover that stands already lets the winch refuse a payout.
        stands = record.state is CommandState.REFUSED and observed.on_floor
        self._has_landed |= record.reason is Reason.TOUCHDOWN or stands
        if record.state is CommandState.DONE:
            return LegEnd(LegResult.FAILED, f"no touchdown down to {observed.length:.2f} m")
        return None

    def _move(self, observed: ObservedState, now: float) -> ProposedRequest | LegEnd | None:
        if self._has_landed and observed.on_floor:
            if now - observed.on_floor_since < _CONFIRM_TIME:
                return None
            self.blackboard.floor_length = observed.length
            observed.set_down(self._heading(observed))
            return LegEnd(LegResult.DONE, f"touchdown at {observed.length:.2f} m")
        rate = self.plan.landing.rate if self.plan.landing is not None else 0.0
        return _length(RequestedAction.LOWER, self.leg.depth, rate)

    def _heading(self, observed: ObservedState) -> float:
        """Heading in map [rad], from the descent controller's gyro."""
        turned = observed.heading - self.blackboard.initial_heading
        initial = math.radians(self.plan.heading)
        return math.remainder(initial + (0.0 if math.isnan(turned) else turned), math.tau)


class LiftTask(WinchTask):
    """Lifts the rover off the floor; far from the plumb line, hauls it there first.

    The goal lies `lift.height` above the length at touchdown, or above that at the start if it is
    shorter: the rover stands on higher ground. Without a touchdown the length at the start counts
    at first, whose tether may be slack, then the last one at which the rover stood. Where it still
    stands at the goal, the winch reels in by the same height again, up to the stow.
    """

    phase = MissionPhase.LIFTING

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self._goal = math.nan  # of the present request [m]
        self._lifted_at = math.inf  # end of the request [s]
        self._stood = math.nan  # last length at which the rover stood [m]

    def _hauls(self, observed: ObservedState) -> bool:
        place = observed.place
        return place is None or math.hypot(place.x, place.y) > self.plan.lift.radius

    def _on_record(
        self, record: CommandRecord, observed: ObservedState, now: float
    ) -> LegEnd | None:
        # Touchdown stops a payout: the goal of a rover that lies on the floor may be too long.
        if record.state is CommandState.DONE or record.reason is Reason.TOUCHDOWN:
            self._lifted_at = now
        # The winch stops at a snag by itself; hauling over rubble frees it, or the time limit
        # ends it.
        elif record.reason is Reason.SNAG and not self._hauls(observed):
            return LegEnd(LegResult.FAILED, f"the tether is snagged: {record.text}")
        return None

    def _move(self, observed: ObservedState, now: float) -> ProposedRequest | LegEnd | None:
        lift, stow = self.plan.lift, self.plan.stow
        if math.isnan(self._goal):
            floor = self.blackboard.floor_length
            stands_higher = observed.on_floor and observed.length < floor
            if math.isnan(floor) or stands_higher:
                floor = observed.length
            self._goal = max(floor - lift.height, stow)
        if observed.on_floor:
            self._stood = observed.length
        if math.isinf(self._lifted_at):
            rate = min(lift.rate, self.plan.recovery.rate) if self._hauls(observed) else lift.rate
            return _length(RequestedAction.LIFT, self._goal, rate)
        if now - max(observed.on_floor_since, self._lifted_at) < _CONFIRM_TIME:
            return None
        if not observed.on_floor:
            if math.isnan(self.blackboard.floor_length) and not math.isnan(self._stood):
                return self._lift_from(self._stood, observed)
            return self._hangs(observed)
        if self._goal - lift.height < stow:
            text = f"the rover still stands at {observed.length:.2f} m, the stow is at {stow:g} m"
            return LegEnd(LegResult.FAILED, text)
        self._goal -= lift.height
        self._lifted_at = math.inf
        return None

    def _lift_from(self, floor: float, observed: ObservedState) -> LegEnd | None:
        """Lift a rover that hangs to `lift.height` above a length at which it stood [m]."""
        goal = max(floor - self.plan.lift.height, self.plan.stow)
        if goal > self._goal - _DEPTH_TOLERANCE:
            return self._hangs(observed)
        self._goal, self._lifted_at = goal, math.inf
        return None

    def _hangs(self, observed: ObservedState) -> LegEnd:
        return LegEnd(LegResult.DONE, f"the rover hangs at {observed.length:.2f} m")


class WinchAscentTask(WinchTask):
    """Ascends by the winch alone where the descent controller cannot; the swing is not damped."""

    phase = MissionPhase.ASCENDING

    def _on_record(
        self, record: CommandRecord, observed: ObservedState, now: float
    ) -> LegEnd | None:
        if record.state is CommandState.DONE:
            return LegEnd(LegResult.DONE, f"at {observed.length:.2f} m by the winch alone")
        if record.reason is Reason.SNAG and now - self.started > _CONFIRM_TIME:
            return LegEnd(LegResult.FAILED, f"the tether is snagged: {record.text}")
        return None

    def _move(self, observed: ObservedState, now: float) -> ProposedRequest | LegEnd | None:  # noqa: ARG002
        return _length(RequestedAction.LIFT, self.leg.depth, self.plan.lift.rate)


class StowTask(LegTask):
    """Releases the descent controller's actuators."""

    phase = MissionPhase.STOWING

    def step(
        self,
        observed: ObservedState,
        events: Sequence[Status],  # noqa: ARG002 - the phase of the descent suffices
        now: float,  # noqa: ARG002
    ) -> ProposedRequest | LegEnd | None:
        """Release an engaged descent controller."""
        if not observed.descent_engaged and not observed.winch_moving:
            return LegEnd(LegResult.DONE, f"stowed at {observed.length:.2f} m")
        if not observed.descent_engaged:
            return None
        idle = observed.descent == DescentPhase.STANDBY
        service = topics.DESCENT_RELEASE if idle else topics.DESCENT_ABORT
        return ProposedRequest(RequestedAction.STOW, LegRequest(service))


def _length(action: RequestedAction, length: float, rate: float) -> ProposedRequest:
    request = LegRequest(
        topics.WINCH_REQUEST, joint_request(machine.WINCH_WHILE_RENEWED, length, rate)
    )
    return ProposedRequest(action, request, _RENEWAL_PERIOD, moves_winch=True)
