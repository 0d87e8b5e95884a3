"""What a mission does on the floor: ways that are driven, and jumps. Pure.

======  =====================================================================================
visit   the rover drives; stuck, it chooses between a way around and slack and a jump, and
        drives on
hop     it gets slack and jumps where it stands
return  as a visit, to below the fairlead
======  =====================================================================================

A rover that lies on its side, or hangs, neither drives nor jumps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto

from msg_schemas import topics
from msg_schemas.machine import JUMP_HEIGHT, JUMP_PREDICTION, JUMP_STROKE, WINCH_SLACK
from msg_schemas.samples import NO_ORIENTATION, JointSample, Level, PoseSample, Status
from rover_control.locomotion import (
    Choice,
    LocomotionParameters,
    Outlook,
    Surroundings,
    choose,
    slack_value,
)
from rover_control.locomotion import Way as Means
from rover_control.mission_interlocks import Act
from rover_control.mission_legs import (
    ANSWER,
    Ask,
    End,
    LegTask,
    MissionPhase,
    Notes,
    Verdict,
    Wish,
    joint_of,
    number_of,
    refusal_of,
)
from rover_control.mission_plan import MissionPlan
from rover_control.mission_route import Leg, LegKind
from rover_control.observed_state import ObservedState, Place

_SETTLES = 3.0  # after a jump [s]
_SLACKENS = 15.0  # in which slack is given [s]
_LED = 1.0  # that a winch rests, before slack is given [s]
_GIVEN = 0.8  # part of the slack asked for that is enough
_BY_HAND = "asked for"  # as drive_node says it
_PROGRESS = 0.1  # towards the goal, after which the rover is stuck elsewhere [m]
_ASIDE, _BEND = 0.6, 0.8  # way of a detour, and how far left of ahead each further one [m], [rad]


class _Stage(Enum):
    DRIVE = auto()
    PREDICT = auto()
    SLACKEN = auto()
    JUMP = auto()
    SETTLE = auto()


class Way(LegTask):
    """A way on the floor, driven, with detours and jumps where the rover is stuck.

    Attributes:
        locomotion: how it chooses between these.
    """

    locomotion = LocomotionParameters()

    def __init__(self, leg: Leg, plan: MissionPlan, notes: Notes, now: float) -> None:
        super().__init__(leg, plan, notes, now)
        self._returns = leg.kind is LegKind.RETURN
        self._stage = _Stage.DRIVE
        self._staged = now
        self._slack_from = math.nan
        self._jumps = 0  # on this way, all in all
        self._detours = 0
        self._stuck = self._jumped = 0  # times at this place, as `locomotion` counts them
        self._stuck_at = math.inf  # distance to the goal [m]
        self._cannot_turn = False  # where it was stuck last
        self._drove_on: Place | None = None  # from where, as it could not turn
        self._tried: Means | None = None  # last, at this place
        self._stroke = plan.jumps.stroke
        self._aside: Place | None = None  # where a detour leads by
        self._choices: list[Choice] = []
        self._left_ground = False
        self._taken = False  # drive_node was seen doing it

    @property
    def phase(self) -> MissionPhase:  # type: ignore[override]
        """Driving, choosing or jumping."""
        if self._stage is _Stage.PREDICT:
            return MissionPhase.CHOOSING
        if self._stage is not _Stage.DRIVE:
            return MissionPhase.JUMPING
        return MissionPhase.RETURNING if self._returns else MissionPhase.DRIVING

    def sent(self, ask: Ask, now: float) -> None:
        """Saying where the rover stands is no request to drive."""
        if ask.name != topics.DRIVE_START:
            super().sent(ask, now)

    def step(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        """Drive; or, stuck, choose: a detour, or slacken, jump and settle."""
        leaves = self._stage in (_Stage.JUMP, _Stage.SETTLE)
        if not leaves and observed.stands and observed.lies(now):
            text = f"the rover lies on its side, tilted by {math.degrees(observed.slope):.0f} deg"
            return End(Verdict.GIVEN_UP, text)
        if not leaves and observed.hangs(now, self._staged):
            return End(Verdict.GIVEN_UP, "the rover hangs: the tether has taken it off the floor")
        if self._stage is _Stage.DRIVE:
            return self._drive(observed, news, now)
        if self._stage is _Stage.PREDICT:
            return self._predict(observed, news, now)
        if self._stage is _Stage.SLACKEN:
            return self._slacken(observed, news, now)
        if self._stage is _Stage.JUMP:
            return self._jump(observed, news, now)
        if now - self._staged > _SETTLES and not observed.flies:
            return self._settled(now)
        return None

    def _settled(self, now: float) -> End | None:
        """The jump is over: on by wheels."""
        self._enter(_Stage.DRIVE, now)
        return None

    def _enter(self, stage: _Stage, now: float) -> None:
        self._stage, self._staged = stage, now
        self.asked = None
        self._taken = self._left_ground = False

    # --- driving ---------------------------------------------------------------------------------

    def _drive(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        if self._returns and self._is_home(observed) and not observed.drives:
            place = observed.place
            assert place is not None
            far = math.hypot(place.x, place.y)
            return End(Verdict.DONE, f"{far:.2f} m from the plumb line")
        if self.asked is not None:
            self._taken |= observed.drives
            for event in news:
                ended = self._judge(event, observed, now)
                if ended is not None or self._stage is not _Stage.DRIVE:
                    return ended
            refused = refusal_of(news, topics.DRIVE_GOAL)
            if refused:
                return End(Verdict.FAILED, refused, by_others=True)
        if observed.place is not None and not observed.knows_place:
            return Wish(Act.DRIVE, Ask(topics.DRIVE_START, _pose(observed.place)))
        lost = not observed.drives and (self._taken or self._unanswered(now))
        if lost and now - observed.since.get(topics.DRIVE_PHASE, now) > ANSWER:
            self.asked, self._taken = None, False
        if self.asked is None:
            return Wish(Act.DRIVE, Ask(topics.DRIVE_GOAL, self._goal()))
        return None

    def _judge(self, event: Status, observed: ObservedState, now: float) -> End | None:
        if event.name == "drive_done" and self._aside is not None:
            self._aside = None
            self._enter(_Stage.DRIVE, now)
            return None
        if event.name == "drive_done":
            return End(Verdict.DONE, event.message)
        if event.name == "drive_stopped" and event.message == _BY_HAND:
            return End(Verdict.TAKEN, "somebody stops the driving")
        if event.name == "drive_failed":
            return End(Verdict.FAILED, event.message)
        if event.name == "drive_stuck":
            self._count(observed)
            self._cannot_turn = number_of(event, "turning") > 0.0
            spent = self._jumps >= self.plan.jumps.most
            if spent and self._detours >= self.plan.jumps.detours:
                return End(Verdict.FAILED, event.message)
            predicts = self.locomotion.locomotion_rule == "risk" and not spent
            if predicts:
                self._enter(_Stage.PREDICT, now)
            else:
                return self._choose(None, observed, now)
        return None

    def _is_home(self, observed: ObservedState) -> bool:
        place = observed.place
        return place is not None and math.hypot(place.x, place.y) < 0.5 * self.plan.lift.radius

    def _goal(self) -> PoseSample:
        leg = self.leg
        if self._aside is not None:
            return PoseSample(0, (self._aside.x, self._aside.y, 0.0), NO_ORIENTATION)
        if math.isnan(leg.heading):
            return PoseSample(0, (leg.x, leg.y, 0.0), NO_ORIENTATION)
        return _pose(Place(leg.x, leg.y, leg.heading))

    # --- choosing --------------------------------------------------------------------------------

    def take_choices(self) -> list[Choice]:
        """Return what was chosen since the last call, and forget it."""
        taken, self._choices = self._choices, []
        return taken

    def _count(self, observed: ObservedState) -> None:
        """The rover is stuck: here again, or somewhere else."""
        self._aside = None
        place = observed.place
        left = math.inf if place is None else math.hypot(place.x - self.leg.x, place.y - self.leg.y)
        if left < self._stuck_at - _PROGRESS:
            self._stuck = self._jumped = 0
            self._tried = None
            self._stuck_at = left
        self._stuck += self._stuck == 0 or self._tried is Means.WHEELS
        self._jumped += self._tried is Means.JUMP

    def _predict(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        refused = refusal_of(news, topics.JUMP_REQUEST)
        if refused:
            return self._choose(Outlook(0.0, refused), observed, now)
        for event in news:
            if event.name == "jump_standby" and self.asked is not None:
                upright, stroke = number_of(event, "upright"), number_of(event, "stroke")
                if event.level is not Level.OK or math.isnan(upright):
                    return self._choose(Outlook(0.0, event.message), observed, now)
                self._stroke = stroke
                return self._choose(Outlook(upright, ""), observed, now)
        if self.asked is None or (observed.jump == "standby" and self._unanswered(now)):
            ask = Ask(topics.JUMP_REQUEST, joint_of(JUMP_PREDICTION, self.plan.jumps.clearance))
            return Wish(Act.SLACKEN, ask)  # nothing moves, but what stands in its way is the same
        return None

    def _choose(self, outlook: Outlook | None, observed: ObservedState, now: float) -> End | None:
        place = observed.place
        value = math.nan if place is None else slack_value(place.x, place.y, observed.drop)
        stiffness = self.locomotion.tether_stiffness
        stuck = 0 if self._may_drive_on(place) else self._stuck
        around = Surroundings(value, stiffness, observed.slope, stuck, self._jumped, outlook)
        choice = choose(self.locomotion, around)
        means = choice.way
        if means is Means.JUMP and self._jumps >= self.plan.jumps.most:
            means = Means.WHEELS
        elif means is Means.WHEELS and self._detours >= self.plan.jumps.detours:
            means = Means.JUMP
            if outlook is not None and outlook.refused:
                return End(Verdict.FAILED, f"no detour is left, and no jump: {outlook.refused}")
        if means is not choice.way:
            text = f"{choice.reason}; but of {choice.way} none is left"
            choice = choice._replace(way=means, reason=text)
        self._choices.append(choice)
        self._tried = means
        if means is Means.JUMP:
            self._enter(_Stage.SLACKEN, now)
            return None
        self._detours += 1
        if place is not None:
            bend = 0.0 if self._cannot_turn else _BEND * self._detours
            self._drove_on = place if self._cannot_turn else None
            towards = place.heading + bend
            x, y = place.x + _ASIDE * math.cos(towards), place.y + _ASIDE * math.sin(towards)
            self._aside = Place(x, y, math.nan)
        self._enter(_Stage.DRIVE, now)
        return None

    def _may_drive_on(self, place: Place | None) -> bool:
        """Whether the rover cannot turn here, and has not tried to drive on from here."""
        if place is None or not self._cannot_turn:
            return False
        tried = self._drove_on
        return tried is None or math.hypot(place.x - tried.x, place.y - tried.y) > 0.5 * _ASIDE

    # --- jumping ---------------------------------------------------------------------------------

    def _slacken(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        refused = refusal_of(news, topics.WINCH_REQUEST)
        if refused:
            return End(Verdict.FAILED, refused)
        # Who led the tether still brings it to rest.
        since = now - observed.since.get(topics.WINCH_MODE, -math.inf)
        if observed.winch_moves or since < _LED:
            return None
        if math.isnan(self._slack_from):
            self._slack_from = observed.length
        slack = self.plan.jumps.slack
        if self.asked is not None:
            waits = now - self.asked < _SLACKENS
            given = observed.length - self._slack_from > _GIVEN * slack
            # A mission that was killed since had it given: the winch counts from the taut length.
            if given or (not waits and observed.winch == "slack"):
                self._slack_from = math.nan
                self._enter(_Stage.JUMP, now)
                return None
            if waits:
                return None
        return Wish(Act.SLACKEN, Ask(topics.WINCH_REQUEST, joint_of(WINCH_SLACK, slack)))

    def _jump(
        self, observed: ObservedState, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        refused = refusal_of(news, topics.JUMP_REQUEST)
        if refused:
            return End(Verdict.FAILED, refused)
        for event in news:
            if event.name == "jump_landed" and event.level is not Level.OK:
                return End(Verdict.FAILED, event.message)
        if observed.jump == "fault" and self.asked is not None and self._left_ground:
            return End(Verdict.FAILED, "the jump ended in a fault")
        self._left_ground |= observed.flies
        if observed.jump == "letting_down" and self.asked is not None:
            return End(Verdict.FAILED, "the jump was broken off")
        if self._left_ground and observed.jump == "standby":
            self._jumps += 1
            self.notes.jumps += 1
            self._enter(_Stage.SETTLE, now)
            return None
        if self.asked is None or (observed.jump == "standby" and self._unanswered(now)):
            return Wish(Act.JUMP, Ask(topics.JUMP_REQUEST, self._leap()))
        return None

    def _leap(self) -> JointSample:
        """What is asked of the jump."""
        return joint_of(JUMP_STROKE, self._stroke)

    @property
    def jumping_for(self) -> float:
        """When slack and jump began [s]; infinite while it drives."""
        return math.inf if self._stage is _Stage.DRIVE else self._staged


class Hop(Way):
    """A jump where the rover stands, to see over the rubble."""

    def __init__(self, leg: Leg, plan: MissionPlan, notes: Notes, now: float) -> None:
        super().__init__(leg, plan, notes, now)
        self._enter(_Stage.SLACKEN, now)

    def _settled(self, now: float) -> End | None:  # noqa: ARG002 - nothing follows
        return End(Verdict.DONE, "flown")

    def _leap(self) -> JointSample:
        return joint_of(JUMP_HEIGHT, self.leg.height)


def _pose(place: Place) -> PoseSample:
    half = 0.5 * place.heading
    turned = (0.0, 0.0, math.sin(half), math.cos(half))
    return PoseSample(0, (place.x, place.y, 0.0), turned)
