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
from rover_control.mission_interlocks import Act
from rover_control.mission_plan import MissionPlan
from rover_control.mission_route import Leg, LegKind
from rover_control.observed_state import ObservedState

ANSWER = 3.0
"""In which a node shows that it does what it was asked [s]."""
_RENEWAL = 0.25  # of a length that is gone to while it is renewed [s]
_NEAR = 0.03  # at a length [m]
_LATCHED = 0.5  # within which the phase is heard of a descent that has ended a stop [s]
_STEADY = 2.0  # for so long the floor carries the rover, or the tether, before that is believed [s]
_THERE = 0.1  # at a depth where what is left of the swing does not keep the mission [m]
_PATIENCE = {LegKind.ASCEND: 60.0, LegKind.CALM: 240.0}
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
    """Longest times of one trial of a leg."""

    look_limit: float = parameter(900.0, "s", "for a stop with pictures", 10.0, 1e5)
    turn_limit: float = parameter(300.0, "s", "for a turn about the plumb line", 10.0, 1e5)
    approach_limit: float = parameter(900.0, "s", "for the approach to the floor", 10.0, 1e5)
    calm_limit: float = parameter(600.0, "s", "to take the swing of a rescue away", 10.0, 1e5)
    land_limit: float = parameter(300.0, "s", "for the landing", 10.0, 1e5)
    visit_limit: float = parameter(900.0, "s", "for the way to a waypoint", 10.0, 1e5)
    hop_limit: float = parameter(120.0, "s", "for slack and jump at a waypoint", 10.0, 1e5)
    return_limit: float = parameter(900.0, "s", "for the way back below the fairlead", 10.0, 1e5)
    lift_limit: float = parameter(600.0, "s", "to come off the floor", 10.0, 1e5)
    ascend_limit: float = parameter(2400.0, "s", "for the ascent", 10.0, 1e5)
    stow_limit: float = parameter(60.0, "s", "to give the drives back", 10.0, 1e5)
    jump_limit: float = parameter(60.0, "s", "for slack and jump", 5.0, 1e4)

    def of(self, kind: LegKind) -> float:
        """Longest time [s] of a trial."""
        limit: float = getattr(self, f"{kind}_limit")
        return limit


class Ask(NamedTuple):
    """A request on a topic, or the call of a service where it has no sample."""

    name: str
    sample: Sample | None = None


class Wish(NamedTuple):
    """What a leg wants to ask for, where the interlocks let it."""

    act: Act
    ask: Ask
    pause: float = ANSWER  # before it is asked again [s]
    reels: bool = False  # the winch moves for it, and is held where that is forbidden


class Verdict(Enum):
    """How a trial of a leg has ended."""

    DONE = auto()
    FAILED = auto()  # it may be tried again
    GIVEN_UP = auto()  # trying again is of no use
    TAKEN = auto()  # somebody else has taken over


class End(NamedTuple):
    """That a trial of a leg is over."""

    verdict: Verdict
    reason: str
    by_others: bool = False  # refused, or waited for; wherever the rover stands


@dataclass
class Notes:
    """What the legs leave to those after them; kept over a restart.

    Attributes:
        floor: length at which the floor was touched [m]; NaN = not yet.
        turned_from: heading of the descent's controller where the mission began [rad].
        pictures: that were taken.
        jumps: that were flown.
    """

    floor: float = math.nan
    turned_from: float = math.nan
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

    def __init__(self, leg: Leg, plan: MissionPlan, notes: Notes, now: float) -> None:
        self.leg = leg
        self.plan = plan
        self.notes = notes
        self.begun = now
        self.asked: float | None = None  # when the leg's own request was sent last [s]

    def sent(self, ask: Ask, now: float) -> None:
        """What was wished has been asked for."""
        if ask.sample is not None:
            self.asked = now

    @abstractmethod
    def step(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        """What is wanted now, or how it has ended; None = nothing but to wait."""

    def _taken_by(self, news: Sequence[Status]) -> str:
        """Who holds the winch that this leg has moved; empty = nobody."""
        for event in news:
            held = event.name == "winch_hold" and event.message == "asked to hold"
            if held and self.asked is not None:
                return "somebody holds the winch"
        return ""

    def _unanswered(self, now: float) -> bool:
        """Whether what was asked for should have shown by now."""
        return self.asked is not None and now - self.asked > ANSWER


def refusal_of(news: Sequence[Status], topic: str) -> str:
    """Why a topic's taker has refused; empty = it did not."""
    for status in news:
        if status.name.endswith(f": refused {topic}"):
            return status.message
    return ""


def joint_of(name: str, position: float, velocity: float = 0.0) -> JointSample:
    """A request that is about one joint."""
    return JointSample(0, {name: JointValue(position, velocity, 0.0)})


def number_of(status: Status, name: str) -> float:
    """A value of an event; NaN where it has none."""
    try:
        return float(status.values[name])
    except (KeyError, ValueError):
        return math.nan


# --- hanging -------------------------------------------------------------------------------------


class Stop(LegTask):
    """A depth that the descent goes to, with pictures or without."""

    def __init__(self, leg: Leg, plan: MissionPlan, notes: Notes, now: float) -> None:
        super().__init__(leg, plan, notes, now)
        self.phase = {
            LegKind.LOOK: MissionPhase.LOOKING,
            LegKind.APPROACH: MissionPhase.APPROACHING,
            LegKind.CALM: MissionPhase.APPROACHING,
            LegKind.ASCEND: MissionPhase.ASCENDING,
        }[leg.kind]
        self._there_since = math.inf
        self._is_cleared = False  # of stops that somebody has left
        self._was_interrupted = False

    def step(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        """Ask for the stop once, and see that it goes on."""
        looks = self.leg.kind is LegKind.LOOK
        if not observed.descent:
            return None  # what it does is latched, and will be heard
        if math.isnan(self.notes.turned_from) and not math.isnan(observed.heading):
            self.notes.turned_from = observed.heading
        if self.asked is not None:
            for event in news:
                if event.name == "stop_ended" and number_of(event, "depth") == self.leg.depth:
                    return self._ended(event, looks)
                self._was_interrupted |= event.name == "descent_interrupted"
            refused = refusal_of(news, topics.DESCENT_REQUEST)
            if refused and observed.descent in ("released", "standby"):
                return End(Verdict.FAILED, refused)
            if refused and observed.descent == "holding":
                # It was held before it was asked: that is cleared first.
                self.asked, self._is_cleared = None, False
        patience = _PATIENCE.get(self.leg.kind, math.inf)
        if patience < math.inf and self.asked is not None:
            there = abs(observed.length - self.leg.depth) < _THERE
            self._there_since = min(self._there_since, now) if there else math.inf
            if now - self._there_since > patience:
                return End(Verdict.DONE, f"at {observed.length:.2f} m, still swinging")
        if observed.descent == "holding" and self.asked is not None:
            if not self._was_interrupted:
                return End(Verdict.TAKEN, "somebody holds the descent")
            return Wish(Act.DESCEND, Ask(topics.DESCENT_RESUME))
        if not self._is_cleared and self.asked is None:
            if observed.descent_busy and now - self.begun < _LATCHED:
                return None
            if observed.descent_busy or observed.descent == "holding":
                return Wish(Act.DESCEND, Ask(topics.DESCENT_ABORT))
            self._is_cleared = True
        idle = observed.descent in ("", "released", "standby")
        lost = idle and self._unanswered(now) and now - self._idle_since(observed) > ANSWER
        if self.asked is None or lost:
            joint = OBSERVATION_STOP if looks else PLAIN_STOP
            return Wish(Act.DESCEND, Ask(topics.DESCENT_REQUEST, joint_of(joint, self.leg.depth)))
        return None

    def _idle_since(self, observed: ObservedState) -> float:
        # A descent that has just engaged stands by to learn the swing first.
        since = observed.since.get(topics.DESCENT_PHASE, -math.inf)
        return since + (30.0 if observed.descent == "standby" else 0.0)

    def _ended(self, event: Status, looks: bool) -> End:
        pictures = number_of(event, "pictures")
        if looks and pictures > 0.0:
            self.notes.pictures += round(pictures)
            return End(Verdict.DONE, event.message)
        if looks:
            return End(Verdict.GIVEN_UP, event.message)
        reached = event.message == "reached"
        return End(Verdict.DONE if reached else Verdict.FAILED, event.message)


class Turn(LegTask):
    """A heading about the plumb line."""

    phase = MissionPhase.TURNING

    def step(
        self,
        observed: ObservedState,
        news: Sequence[Status],
        now: float,  # noqa: ARG002 - it goes by no time of its own
    ) -> Wish | End | None:
        """Ask once: what cannot be reached or held is refused, and then left."""
        if self.asked is None:
            if observed.descent_busy:
                return None
            ask = Ask(topics.DESCENT_REQUEST, joint_of(HEADING_TURN, self.leg.angle))
            return Wish(Act.DESCEND, ask)
        for event in news:
            if event.name == "pointing_reached":
                return End(Verdict.DONE, event.message)
            if event.name == "pointing_ended":
                return End(Verdict.GIVEN_UP, event.message)
        refused = refusal_of(news, topics.DESCENT_REQUEST)
        return End(Verdict.GIVEN_UP, refused) if refused else None


class Land(LegTask):
    """The winch pays out until the floor carries the rover."""

    phase = MissionPhase.LANDING

    def step(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        """Renew the length on the way."""
        if observed.stands:
            if now - observed.stands_since < _STEADY:
                return None
            self.notes.floor = observed.length
            observed.set_down(self._heading(observed))
            return End(Verdict.DONE, f"the floor carries the rover at {observed.length:.2f} m")
        taken = self._taken_by(news)
        if taken:
            return End(Verdict.TAKEN, taken)
        if observed.length > self.leg.depth - _NEAR and not observed.winch_moves:
            return End(Verdict.FAILED, f"no floor down to {observed.length:.2f} m")
        # Those who had the winch before may still bring it to rest.
        if self.asked is None and observed.winch_moves and not observed.descent_engaged:
            return None
        rate = self.plan.landing.rate if self.plan.landing is not None else 0.0
        return _length(Act.LOWER, self.leg.depth, rate)

    def _heading(self, observed: ObservedState) -> float:
        """In map, as far as the descent's gyro tells."""
        turned = observed.heading - self.notes.turned_from
        begun = math.radians(self.plan.heading)
        return math.remainder(begun + (0.0 if math.isnan(turned) else turned), math.tau)


class Lift(LegTask):
    """The winch reels in until the rover hangs; far from the plumb line it hauls it there first."""

    phase = MissionPhase.LIFTING

    def __init__(self, leg: Leg, plan: MissionPlan, notes: Notes, now: float) -> None:
        super().__init__(leg, plan, notes, now)
        self._goal = math.nan

    def step(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        """Renew the length on the way, which leads from where the floor was touched."""
        if math.isnan(self._goal):
            floor = self.notes.floor
            self._goal = (observed.length if math.isnan(floor) else floor) - self.plan.lift.height
        hangs = not observed.stands and now - observed.stands_since > _STEADY
        there = abs(observed.length - self._goal) < _NEAR and not observed.winch_moves
        if there and hangs:
            return End(Verdict.DONE, f"the rover hangs at {observed.length:.2f} m")
        if there and now - self.begun > 2.0 * _STEADY and observed.stands:
            return End(Verdict.FAILED, f"the rover is still carried at {observed.length:.2f} m")
        taken = self._taken_by(news)
        if taken:
            return End(Verdict.TAKEN, taken)
        lift = self.plan.lift
        hauls = (
            observed.place is None or math.hypot(observed.place.x, observed.place.y) > lift.radius
        )
        for event in news:
            # The winch holds by itself; what it hauls over rubble comes free again, or in time not.
            if event.name == "alarm_snag" and not hauls:
                return End(Verdict.FAILED, f"the tether is held: {event.message}")
        if there:
            return None
        rate = min(lift.rate, self.plan.rescue.rate) if hauls else lift.rate
        return _length(Act.LIFT, self._goal, rate)


class Hoist(LegTask):
    """An ascent by the winch alone, where the descent cannot: what swings then swings more."""

    phase = MissionPhase.ASCENDING

    def step(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        """Renew the length on the way."""
        taken = self._taken_by(news)
        if taken:
            return End(Verdict.TAKEN, taken)
        snag = next((event for event in news if event.name == "alarm_snag"), None)
        if snag is not None and now - self.begun > _STEADY:
            return End(Verdict.FAILED, f"the tether is held: {snag.message}")
        if abs(observed.length - self.leg.depth) < _NEAR and not observed.winch_moves:
            return End(Verdict.DONE, f"at {observed.length:.2f} m, by the winch alone")
        return _length(Act.LIFT, self.leg.depth, self.plan.lift.rate)


class Stow(LegTask):
    """The descent gives the drives back."""

    phase = MissionPhase.STOWING

    def step(
        self,
        observed: ObservedState,
        news: Sequence[Status],  # noqa: ARG002 - what is engaged says enough
        now: float,  # noqa: ARG002
    ) -> Wish | End | None:
        """Release what is engaged."""
        if not observed.descent_engaged and not observed.winch_moves:
            return End(Verdict.DONE, f"stowed at {observed.length:.2f} m")
        if not observed.descent_engaged:
            return None
        idle = observed.descent == "standby"
        service = topics.DESCENT_RELEASE if idle else topics.DESCENT_ABORT
        return Wish(Act.STOW, Ask(service))


def _length(act: Act, length: float, rate: float) -> Wish:
    ask = Ask(topics.WINCH_REQUEST, joint_of(WINCH_WHILE_RENEWED, length, rate))
    return Wish(act, ask, _RENEWAL, reels=True)
