"""How the legs of a mission are done: what each asks for, and when it is over. Pure.

A leg goes by what is seen now, so that it can be begun again at any time: after a hold, after a
restart of the mission, or because the first trial failed.

=========  ==================================================================================
look       a stop of the descent with pictures
turn       a heading that the descent turns to
approach   a stop of the descent without pictures
calm       the same after a rescue, where what is left of the swing is no reason to go on
land       the winch pays out until the floor carries the rover
lift       the winch reels in until the rover hangs
ascend     a stop of the descent at the stow
stow       the descent gives winch and wheels back
=========  ==================================================================================

What is done on the floor stands in `mission_floor`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum, auto
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.machine import (
    HEADING_TURN,
    OBSERVATION_STOP,
    PLAIN_STOP,
    WINCH_WHILE_RENEWED,
)
from msg_schemas.parameters import parameter
from msg_schemas.samples import (
    JointSample,
    JointValue,
    Sample,
    Status,
)
from rover_control.mission_interlocks import Action
from rover_control.mission_plan import MissionPlan
from rover_control.mission_route import Leg, LegKind
from rover_control.observed_state import ObservedState

RESPONSE_TIMEOUT = 3.0
"""In which a node shows that it does what it was asked [s]."""
_RENEWAL_PERIOD = 0.25  # of a length that is gone to while it is renewed [s]
_LENGTH_TOLERANCE = 0.03  # at a length [m]
_LATCH_DELAY = 0.5  # within which the phase is heard of a descent that has ended a stop [s]
_CONFIRM_TIME = (
    2.0  # for so long the floor carries the rover, or the tether, before that is believed [s]
)
_DEPTH_TOLERANCE = 0.1  # at a depth where what is left of the swing does not keep the mission [m]
_DAMPING_TIME = {LegKind.ASCEND: 60.0, LegKind.DAMP: 240.0}
"""How long the swing is damped there [s]."""


class MissionPhase(StrEnum):
    """What the mission is doing; words of the contract."""

    STANDBY = "standby"
    LOOKING = "looking"
    TURNING = "turning"
    APPROACHING = "approaching"
    LANDING = "landing"
    DRIVING = "driving"
    CHOOSING = "choosing"
    JUMPING = "jumping"
    RETURNING = "returning"
    LIFTING = "lifting"
    ASCENDING = "ascending"
    STOWING = "stowing"
    HOLDING = "holding"
    ABORTED = "aborted"


@dataclass(frozen=True)
class LegLimits:
    """Time limits of one trial of a leg."""

    look_timeout: float = parameter(900.0, "s", "stop with pictures", 10.0, 1e5)
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
        """Time limit [s] of a trial of a leg."""
        limit: float = getattr(self, f"{kind}_timeout")
        return limit


class Request(NamedTuple):
    """A request on a topic, or the call of a service where it has no sample."""

    name: str
    sample: Sample | None = None


class ProposedRequest(NamedTuple):
    """What a leg wants to request for, where the interlocks let it."""

    action: Action
    request: Request
    pause: float = RESPONSE_TIMEOUT  # before it is asked again [s]
    moves_winch: bool = False  # the winch moves for it, and is held where that is forbidden


class LegResult(Enum):
    """How a trial of a leg has ended."""

    DONE = auto()
    FAILED = auto()  # it may be tried again
    ABANDONED = auto()  # trying again is of no use
    OVERRIDDEN = auto()  # somebody else has taken over


class LegEnd(NamedTuple):
    """That a trial of a leg is over."""

    result: LegResult
    reason: str
    is_external: bool = False  # refused, or waited for; wherever the rover stands


@dataclass
class Blackboard:
    """What the legs leave to those after them; kept over a restart.

    Attributes:
        floor: length at which the floor was touched [m]; NaN = not yet.
        turned_from: heading of the descent's controller where the mission began [rad].
        pictures: that were taken.
        jumps: that were flown.
    """

    floor_length: float = math.nan
    initial_heading: float = math.nan
    pictures: int = 0
    jumps: int = 0


class LegTask(ABC):
    """One trial of a leg.

    Args:
        leg: what is to be done.
        plan: of the whole mission.
        notes: of the legs before, and for those after.
        now: [s].
    """

    phase: MissionPhase

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        self.leg = leg
        self.plan = plan
        self.blackboard = blackboard
        self.started = now
        self.requested_at: float | None = None  # when the leg's own request was sent last [s]

    def on_sent(self, request: Request, now: float) -> None:
        """What was wished has been asked for."""
        if request.sample is not None:
            self.requested_at = now

    @abstractmethod
    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """What is wanted now, or how it has ended; None = nothing but to wait."""

    def _override_of(self, events: Sequence[Status]) -> str:
        """Who holds the winch that this leg has moved; empty = nobody."""
        for event in events:
            held = event.name == "winch_hold" and event.message == "asked to hold"
            if held and self.requested_at is not None:
                return "somebody holds the winch"
        return ""

    def _is_overdue(self, now: float) -> bool:
        """Whether what was asked for should have shown by now."""
        return self.requested_at is not None and now - self.requested_at > RESPONSE_TIMEOUT


def refusal_of(events: Sequence[Status], topic: str) -> str:
    """Why a topic's taker has refused; empty = it did not."""
    for status in events:
        if status.name.endswith(f": refused {topic}"):
            return status.message
    return ""


def joint_request(name: str, position: float, velocity: float = 0.0) -> JointSample:
    """A request that is about one joint."""
    return JointSample(0, {name: JointValue(position, velocity, 0.0)})


def event_value(status: Status, name: str) -> float:
    """A value of an event; NaN where it has none."""
    try:
        return float(status.values[name])
    except (KeyError, ValueError):
        return math.nan


# --- hanging -------------------------------------------------------------------------------------


class StopTask(LegTask):
    """A depth that the descent goes to, with pictures or without."""

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self.phase = {
            LegKind.LOOK: MissionPhase.LOOKING,
            LegKind.APPROACH: MissionPhase.APPROACHING,
            LegKind.DAMP: MissionPhase.APPROACHING,
            LegKind.ASCEND: MissionPhase.ASCENDING,
        }[leg.kind]
        self._there_since = math.inf
        self._is_cleared = False  # of stops that somebody has left
        self._was_interrupted = False

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Ask for the stop once, and see that it goes on."""
        looks = self.leg.kind is LegKind.LOOK
        if not observed.descent:
            return None  # what it does is latched, and will be heard
        if math.isnan(self.blackboard.initial_heading) and not math.isnan(observed.heading):
            self.blackboard.initial_heading = observed.heading
        if self.requested_at is not None:
            for event in events:
                if event.name == "stop_ended" and event_value(event, "depth") == self.leg.depth:
                    return self._ended(event, looks)
                self._was_interrupted |= event.name == "descent_interrupted"
            refused = refusal_of(events, topics.DESCENT_REQUEST)
            if refused and observed.descent in ("released", "standby"):
                return LegEnd(LegResult.FAILED, refused)
            if refused and observed.descent == "holding":
                # It was held before it was asked: that is cleared first.
                self.requested_at, self._is_cleared = None, False
        patience = _DAMPING_TIME.get(self.leg.kind, math.inf)
        if patience < math.inf and self.requested_at is not None:
            there = abs(observed.length - self.leg.depth) < _DEPTH_TOLERANCE
            self._there_since = min(self._there_since, now) if there else math.inf
            if now - self._there_since > patience:
                return LegEnd(LegResult.DONE, f"at {observed.length:.2f} m, still swinging")
        if observed.descent == "holding" and self.requested_at is not None:
            if not self._was_interrupted:
                return LegEnd(LegResult.OVERRIDDEN, "somebody holds the descent")
            return ProposedRequest(Action.DESCEND, Request(topics.DESCENT_RESUME))
        if not self._is_cleared and self.requested_at is None:
            if observed.descent_busy and now - self.started < _LATCH_DELAY:
                return None
            if observed.descent_busy or observed.descent == "holding":
                return ProposedRequest(Action.DESCEND, Request(topics.DESCENT_ABORT))
            self._is_cleared = True
        idle = observed.descent in ("", "released", "standby")
        lost = (
            idle and self._is_overdue(now) and now - self._idle_since(observed) > RESPONSE_TIMEOUT
        )
        if self.requested_at is None or lost:
            joint = OBSERVATION_STOP if looks else PLAIN_STOP
            return ProposedRequest(
                Action.DESCEND,
                Request(topics.DESCENT_REQUEST, joint_request(joint, self.leg.depth)),
            )
        return None

    def _idle_since(self, observed: ObservedState) -> float:
        # A descent that has just engaged stands by to learn the swing first.
        since = observed.since.get(topics.DESCENT_PHASE, -math.inf)
        return since + (30.0 if observed.descent == "standby" else 0.0)

    def _ended(self, event: Status, looks: bool) -> LegEnd:
        pictures = event_value(event, "pictures")
        if looks and pictures > 0.0:
            self.blackboard.pictures += round(pictures)
            return LegEnd(LegResult.DONE, event.message)
        if looks:
            return LegEnd(LegResult.ABANDONED, event.message)
        reached = event.message == "reached"
        return LegEnd(LegResult.DONE if reached else LegResult.FAILED, event.message)


class TurnTask(LegTask):
    """A heading about the plumb line."""

    phase = MissionPhase.TURNING

    def step(
        self,
        observed: ObservedState,
        events: Sequence[Status],
        now: float,  # noqa: ARG002 - it goes by no time of its own
    ) -> ProposedRequest | LegEnd | None:
        """Ask once: what cannot be reached or held is refused, and then left."""
        if self.requested_at is None:
            if observed.descent_busy:
                return None
            request = Request(topics.DESCENT_REQUEST, joint_request(HEADING_TURN, self.leg.angle))
            return ProposedRequest(Action.DESCEND, request)
        for event in events:
            if event.name == "pointing_reached":
                return LegEnd(LegResult.DONE, event.message)
            if event.name == "pointing_ended":
                return LegEnd(LegResult.ABANDONED, event.message)
        refused = refusal_of(events, topics.DESCENT_REQUEST)
        return LegEnd(LegResult.ABANDONED, refused) if refused else None


class LandTask(LegTask):
    """The winch pays out until the floor carries the rover."""

    phase = MissionPhase.LANDING

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Renew the length on the way."""
        if observed.on_floor:
            if now - observed.on_floor_since < _CONFIRM_TIME:
                return None
            self.blackboard.floor_length = observed.length
            observed.set_down(self._heading(observed))
            return LegEnd(LegResult.DONE, f"the floor carries the rover at {observed.length:.2f} m")
        taken = self._override_of(events)
        if taken:
            return LegEnd(LegResult.OVERRIDDEN, taken)
        if observed.length > self.leg.depth - _LENGTH_TOLERANCE and not observed.winch_moving:
            return LegEnd(LegResult.FAILED, f"no floor down to {observed.length:.2f} m")
        # Those who had the winch before may still bring it to rest.
        if self.requested_at is None and observed.winch_moving and not observed.descent_engaged:
            return None
        rate = self.plan.landing.rate if self.plan.landing is not None else 0.0
        return _length(Action.LOWER, self.leg.depth, rate)

    def _heading(self, observed: ObservedState) -> float:
        """In map, as far as the descent's gyro tells."""
        turned = observed.heading - self.blackboard.initial_heading
        initial = math.radians(self.plan.heading)
        return math.remainder(initial + (0.0 if math.isnan(turned) else turned), math.tau)


class LiftTask(LegTask):
    """The winch reels in until the rover hangs; far from the plumb line it hauls it there first."""

    phase = MissionPhase.LIFTING

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self._goal = math.nan

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Renew the length on the way, which leads from where the floor was touched."""
        if math.isnan(self._goal):
            floor = self.blackboard.floor_length
            self._goal = (observed.length if math.isnan(floor) else floor) - self.plan.lift.height
        hangs = not observed.on_floor and now - observed.on_floor_since > _CONFIRM_TIME
        there = abs(observed.length - self._goal) < _LENGTH_TOLERANCE and not observed.winch_moving
        if there and hangs:
            return LegEnd(LegResult.DONE, f"the rover hangs at {observed.length:.2f} m")
        if there and now - self.started > 2.0 * _CONFIRM_TIME and observed.on_floor:
            return LegEnd(
                LegResult.FAILED, f"the rover is still carried at {observed.length:.2f} m"
            )
        taken = self._override_of(events)
        if taken:
            return LegEnd(LegResult.OVERRIDDEN, taken)
        lift = self.plan.lift
        hauls = (
            observed.place is None or math.hypot(observed.place.x, observed.place.y) > lift.radius
        )
        for event in events:
            # The winch holds by itself; what it hauls over rubble comes free again, or in time not.
            if event.name == "alarm_snag" and not hauls:
                return LegEnd(LegResult.FAILED, f"the tether is held: {event.message}")
        if there:
            return None
        rate = min(lift.rate, self.plan.recovery.rate) if hauls else lift.rate
        return _length(Action.LIFT, self._goal, rate)


class WinchAscentTask(LegTask):
    """An ascent by the winch alone, where the descent cannot: what swings then swings more."""

    phase = MissionPhase.ASCENDING

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Renew the length on the way."""
        taken = self._override_of(events)
        if taken:
            return LegEnd(LegResult.OVERRIDDEN, taken)
        snag = next((event for event in events if event.name == "alarm_snag"), None)
        if snag is not None and now - self.started > _CONFIRM_TIME:
            return LegEnd(LegResult.FAILED, f"the tether is held: {snag.message}")
        if abs(observed.length - self.leg.depth) < _LENGTH_TOLERANCE and not observed.winch_moving:
            return LegEnd(LegResult.DONE, f"at {observed.length:.2f} m, by the winch alone")
        return _length(Action.LIFT, self.leg.depth, self.plan.lift.rate)


class StowTask(LegTask):
    """The descent gives the drives back."""

    phase = MissionPhase.STOWING

    def step(
        self,
        observed: ObservedState,
        events: Sequence[Status],  # noqa: ARG002 - what is engaged says enough
        now: float,  # noqa: ARG002
    ) -> ProposedRequest | LegEnd | None:
        """Release what is engaged."""
        if not observed.descent_engaged and not observed.winch_moving:
            return LegEnd(LegResult.DONE, f"stowed at {observed.length:.2f} m")
        if not observed.descent_engaged:
            return None
        idle = observed.descent == "standby"
        service = topics.DESCENT_RELEASE if idle else topics.DESCENT_ABORT
        return ProposedRequest(Action.STOW, Request(service))


def _length(action: Action, length: float, rate: float) -> ProposedRequest:
    request = Request(topics.WINCH_REQUEST, joint_request(WINCH_WHILE_RENEWED, length, rate))
    return ProposedRequest(action, request, _RENEWAL_PERIOD, moves_winch=True)
