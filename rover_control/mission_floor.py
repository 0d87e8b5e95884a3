"""What a mission does on the floor: ways that are driven, and jumps. Pure.

======  =====================================================================================
visit   the rover drives; stuck, it gets slack and jumps, and drives on
hop     it gets slack and jumps where it stands
return  as a visit, to below the fairlead
======  =====================================================================================
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto

from msg_schemas import topics
from msg_schemas.machine import JUMP_HEIGHT, JUMP_STROKE, WINCH_SLACK
from msg_schemas.samples import NO_ORIENTATION, JointSample, PoseSample, Status
from rover_control.mission_interlocks import Act
from rover_control.mission_legs import (
    ANSWER,
    Ask,
    Conduct,
    End,
    MissionPhase,
    Notes,
    Verdict,
    Wish,
    joint_of,
    refusal_of,
)
from rover_control.mission_plan import Leg, LegKind, MissionPlan
from rover_control.mission_sight import MissionSight, Place

_SETTLES = 3.0  # after a jump [s]
_SLACKENS = 15.0  # in which slack is given [s]
_LED = 1.0  # that a winch rests, before slack is given [s]
_GIVEN = 0.8  # part of the slack asked for that is enough
_BY_HAND = "asked for"  # as drive_node says it


class _Stage(Enum):
    DRIVE = auto()
    SLACKEN = auto()
    JUMP = auto()
    SETTLE = auto()


class Way(Conduct):
    """A way on the floor, driven, with jumps where the rover is stuck."""

    def __init__(self, leg: Leg, plan: MissionPlan, notes: Notes, now: float) -> None:
        super().__init__(leg, plan, notes, now)
        self._returns = leg.kind is LegKind.RETURN
        self._stage = _Stage.DRIVE
        self._staged = now
        self._slack_from = math.nan
        self._jumps = 0
        self._left_ground = False
        self._taken = False  # drive_node was seen doing it

    @property
    def phase(self) -> MissionPhase:  # type: ignore[override]
        """Driving or jumping."""
        if self._stage is not _Stage.DRIVE:
            return MissionPhase.JUMPING
        return MissionPhase.RETURNING if self._returns else MissionPhase.DRIVING

    def sent(self, ask: Ask, now: float) -> None:
        """Saying where the rover stands is no request to drive."""
        if ask.name != topics.DRIVE_START:
            super().sent(ask, now)

    def step(self, sight: MissionSight, news: Sequence[Status], now: float) -> Wish | End | None:
        """Drive; or, stuck, slacken, jump and settle."""
        if self._stage is _Stage.DRIVE:
            return self._drive(sight, news, now)
        if self._stage is _Stage.SLACKEN:
            return self._slacken(sight, news, now)
        if self._stage is _Stage.JUMP:
            return self._jump(sight, news, now)
        if now - self._staged > _SETTLES and not sight.flies:
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

    def _drive(self, sight: MissionSight, news: Sequence[Status], now: float) -> Wish | End | None:
        if self._returns and self._is_home(sight) and not sight.drives:
            place = sight.place
            assert place is not None
            far = math.hypot(place.x, place.y)
            return End(Verdict.DONE, f"{far:.2f} m from the plumb line")
        if self.asked is not None:
            self._taken |= sight.drives
            for event in news:
                ended = self._judge(event, now)
                if ended is not None or self._stage is not _Stage.DRIVE:
                    return ended
            refused = refusal_of(news, topics.DRIVE_GOAL)
            if refused:
                return End(Verdict.FAILED, refused)
        if sight.place is not None and not sight.knows_place:
            return Wish(Act.DRIVE, Ask(topics.DRIVE_START, _pose(sight.place)))
        lost = not sight.drives and (self._taken or self._unanswered(now))
        if lost and now - sight.since.get(topics.DRIVE_PHASE, now) > ANSWER:
            self.asked, self._taken = None, False
        if self.asked is None:
            return Wish(Act.DRIVE, Ask(topics.DRIVE_GOAL, self._goal()))
        return None

    def _judge(self, event: Status, now: float) -> End | None:
        if event.name == "drive_done":
            return End(Verdict.DONE, event.message)
        if event.name == "drive_stopped" and event.message == _BY_HAND:
            return End(Verdict.TAKEN, "somebody stops the driving")
        if event.name == "drive_failed":
            return End(Verdict.FAILED, event.message)
        if event.name == "drive_stuck":
            if self._jumps >= self.plan.jumps.most:
                return End(Verdict.FAILED, event.message)
            self._enter(_Stage.SLACKEN, now)
        return None

    def _is_home(self, sight: MissionSight) -> bool:
        place = sight.place
        return place is not None and math.hypot(place.x, place.y) < 0.5 * self.plan.lift.radius

    def _goal(self) -> PoseSample:
        leg = self.leg
        if math.isnan(leg.heading):
            return PoseSample(0, (leg.x, leg.y, 0.0), NO_ORIENTATION)
        return _pose(Place(leg.x, leg.y, leg.heading))

    # --- jumping ---------------------------------------------------------------------------------

    def _slacken(
        self, sight: MissionSight, news: Sequence[Status], now: float
    ) -> Wish | End | None:
        refused = refusal_of(news, topics.WINCH_REQUEST)
        if refused:
            return End(Verdict.FAILED, refused)
        # Who led the tether still brings it to rest.
        since = now - sight.since.get(topics.WINCH_MODE, -math.inf)
        if sight.winch_moves or since < _LED:
            return None
        if math.isnan(self._slack_from):
            self._slack_from = sight.length
        slack = self.plan.jumps.slack
        if sight.length - self._slack_from > _GIVEN * slack and self.asked is not None:
            self._slack_from = math.nan
            self._enter(_Stage.JUMP, now)
            return None
        if self.asked is not None and now - self.asked < _SLACKENS:
            return None
        return Wish(Act.SLACKEN, Ask(topics.WINCH_REQUEST, joint_of(WINCH_SLACK, slack)))

    def _jump(self, sight: MissionSight, news: Sequence[Status], now: float) -> Wish | End | None:
        refused = refusal_of(news, topics.JUMP_REQUEST)
        if refused:
            return End(Verdict.FAILED, refused)
        self._left_ground |= sight.flies
        if sight.jump == "letting_down" and self.asked is not None:
            return End(Verdict.FAILED, "the jump was broken off")
        if self._left_ground and sight.jump == "standby":
            self._jumps += 1
            self.notes.jumps += 1
            self._enter(_Stage.SETTLE, now)
            return None
        if self.asked is None or (sight.jump == "standby" and self._unanswered(now)):
            return Wish(Act.JUMP, Ask(topics.JUMP_REQUEST, self._leap()))
        return None

    def _leap(self) -> JointSample:
        """What is asked of the jump."""
        return joint_of(JUMP_STROKE, self.plan.jumps.stroke)

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
