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
    JumpAssessment,
    LocomotionMode,
    LocomotionParameters,
    LocomotionSituation,
    choose,
    slack_value,
)
from rover_control.mission_interlocks import Action
from rover_control.mission_legs import (
    RESPONSE_TIMEOUT,
    Blackboard,
    LegEnd,
    LegResult,
    LegTask,
    MissionPhase,
    ProposedRequest,
    Request,
    event_value,
    joint_request,
    refusal_of,
)
from rover_control.mission_plan import MissionPlan
from rover_control.mission_route import Leg, LegKind
from rover_control.observed_state import ObservedState, Place

_SETTLE_TIME = 3.0  # after a jump [s]
_SLACK_TIME = 15.0  # in which slack is given [s]
_WINCH_REST_TIME = 1.0  # that a winch rests, before slack is given [s]
_SLACK_FRACTION = 0.8  # part of the slack asked for that is enough
_BY_HAND = "asked for"  # as drive_node says it
_PROGRESS = 0.1  # towards the goal, after which the rover is stuck elsewhere [m]
_DETOUR_LENGTH, _DETOUR_ANGLE = (
    0.6,
    0.8,
)  # way of a detour, and how far left of ahead each further one [m], [rad]


class _State(Enum):
    DRIVE = auto()
    PREDICT = auto()
    SLACKEN = auto()
    JUMP = auto()
    SETTLE = auto()


class DriveTask(LegTask):
    """A way on the floor, driven, with detours and jumps where the rover is stuck.

    Attributes:
        locomotion: how it chooses between these.
    """

    locomotion = LocomotionParameters()

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self._returns = leg.kind is LegKind.RETURN
        self._state = _State.DRIVE
        self._entered = now
        self._slack_start = math.nan
        self._jumps = 0  # on this way, all in all
        self._detours = 0
        self._stuck = self._jumped = 0  # times at this place, as `locomotion` counts them
        self._stuck_at = math.inf  # distance to the goal [m]
        self._cannot_turn = False  # where it was stuck last
        self._straight_detour_from: Place | None = None  # from where, as it could not turn
        self._last_mode: LocomotionMode | None = None  # last, at this place
        self._stroke = plan.jumps.stroke
        self._detour_goal: Place | None = None  # where a detour leads by
        self._choices: list[Choice] = []
        self._left_ground = False
        self._taken = False  # drive_node was seen doing it

    @property
    def phase(self) -> MissionPhase:  # type: ignore[override]
        """Driving, choosing or jumping."""
        if self._state is _State.PREDICT:
            return MissionPhase.CHOOSING
        if self._state is not _State.DRIVE:
            return MissionPhase.JUMPING
        return MissionPhase.RETURNING if self._returns else MissionPhase.DRIVING

    def on_sent(self, request: Request, now: float) -> None:
        """Saying where the rover stands is no request to drive."""
        if request.name != topics.DRIVE_START:
            super().on_sent(request, now)

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Drive; or, stuck, choose: a detour, or slacken, jump and settle."""
        is_jumping = self._state in (_State.JUMP, _State.SETTLE)
        if not is_jumping and observed.on_floor and observed.has_rolled_over(now):
            text = f"the rover lies on its side, tilted by {math.degrees(observed.slope):.0f} deg"
            return LegEnd(LegResult.ABANDONED, text)
        if not is_jumping and observed.has_hung(now, self._entered):
            return LegEnd(
                LegResult.ABANDONED, "the rover hangs: the tether has taken it off the floor"
            )
        if self._state is _State.DRIVE:
            return self._drive(observed, events, now)
        if self._state is _State.PREDICT:
            return self._predict(observed, events, now)
        if self._state is _State.SLACKEN:
            return self._slacken(observed, events, now)
        if self._state is _State.JUMP:
            return self._jump(observed, events, now)
        if now - self._entered > _SETTLE_TIME and not observed.in_flight:
            return self._settled(now)
        return None

    def _settled(self, now: float) -> LegEnd | None:
        """The jump is over: on by wheels."""
        self._enter(_State.DRIVE, now)
        return None

    def _enter(self, state: _State, now: float) -> None:
        self._state, self._entered = state, now
        self.requested_at = None
        self._taken = self._left_ground = False

    # --- driving ---------------------------------------------------------------------------------

    def _drive(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        if self._returns and self._is_home(observed) and not observed.is_driving:
            place = observed.place
            assert place is not None
            far = math.hypot(place.x, place.y)
            return LegEnd(LegResult.DONE, f"{far:.2f} m from the plumb line")
        if self.requested_at is not None:
            self._taken |= observed.is_driving
            for event in events:
                ended = self._on_drive_event(event, observed, now)
                if ended is not None or self._state is not _State.DRIVE:
                    return ended
            refused = refusal_of(events, topics.DRIVE_GOAL)
            if refused:
                return LegEnd(LegResult.FAILED, refused, is_external=True)
        if observed.place is not None and not observed.place_agrees:
            return ProposedRequest(Action.DRIVE, Request(topics.DRIVE_START, _pose(observed.place)))
        lost = not observed.is_driving and (self._taken or self._is_overdue(now))
        if lost and now - observed.since.get(topics.DRIVE_PHASE, now) > RESPONSE_TIMEOUT:
            self.requested_at, self._taken = None, False
        if self.requested_at is None:
            return ProposedRequest(Action.DRIVE, Request(topics.DRIVE_GOAL, self._goal()))
        return None

    def _on_drive_event(self, event: Status, observed: ObservedState, now: float) -> LegEnd | None:
        if event.name == "drive_done" and self._detour_goal is not None:
            self._detour_goal = None
            self._enter(_State.DRIVE, now)
            return None
        if event.name == "drive_done":
            return LegEnd(LegResult.DONE, event.message)
        if event.name == "drive_stopped" and event.message == _BY_HAND:
            return LegEnd(LegResult.OVERRIDDEN, "somebody stops the driving")
        if event.name == "drive_failed":
            return LegEnd(LegResult.FAILED, event.message)
        if event.name == "drive_stuck":
            self._count_stuck(observed)
            self._cannot_turn = event_value(event, "turning") > 0.0
            no_jump_left = self._jumps >= self.plan.jumps.max_jumps
            if no_jump_left and self._detours >= self.plan.jumps.max_detours:
                return LegEnd(LegResult.FAILED, event.message)
            predicts = self.locomotion.locomotion_rule == "risk" and not no_jump_left
            if predicts:
                self._enter(_State.PREDICT, now)
            else:
                return self._choose(None, observed, now)
        return None

    def _is_home(self, observed: ObservedState) -> bool:
        place = observed.place
        return place is not None and math.hypot(place.x, place.y) < 0.5 * self.plan.lift.radius

    def _goal(self) -> PoseSample:
        leg = self.leg
        if self._detour_goal is not None:
            return PoseSample(0, (self._detour_goal.x, self._detour_goal.y, 0.0), NO_ORIENTATION)
        if math.isnan(leg.heading):
            return PoseSample(0, (leg.x, leg.y, 0.0), NO_ORIENTATION)
        return _pose(Place(leg.x, leg.y, leg.heading))

    # --- choosing --------------------------------------------------------------------------------

    def take_choices(self) -> list[Choice]:
        """Return what was chosen since the last call, and forget it."""
        taken, self._choices = self._choices, []
        return taken

    def _count_stuck(self, observed: ObservedState) -> None:
        """The rover is stuck: here again, or somewhere else."""
        self._detour_goal = None
        place = observed.place
        left = math.inf if place is None else math.hypot(place.x - self.leg.x, place.y - self.leg.y)
        if left < self._stuck_at - _PROGRESS:
            self._stuck = self._jumped = 0
            self._last_mode = None
            self._stuck_at = left
        self._stuck += self._stuck == 0 or self._last_mode is LocomotionMode.WHEELS
        self._jumped += self._last_mode is LocomotionMode.JUMP

    def _predict(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        refused = refusal_of(events, topics.JUMP_REQUEST)
        if refused:
            return self._choose(JumpAssessment(0.0, refused), observed, now)
        for event in events:
            if event.name == "jump_standby" and self.requested_at is not None:
                upright, stroke = event_value(event, "upright"), event_value(event, "stroke")
                if event.level is not Level.OK or math.isnan(upright):
                    return self._choose(JumpAssessment(0.0, event.message), observed, now)
                self._stroke = stroke
                return self._choose(JumpAssessment(upright, ""), observed, now)
        if self.requested_at is None or (observed.jump == "standby" and self._is_overdue(now)):
            request = Request(
                topics.JUMP_REQUEST, joint_request(JUMP_PREDICTION, self.plan.jumps.clearance)
            )
            return ProposedRequest(
                Action.SLACKEN, request
            )  # nothing moves, but what stands in its way is the same
        return None

    def _choose(
        self, assessment: JumpAssessment | None, observed: ObservedState, now: float
    ) -> LegEnd | None:
        place = observed.place
        value = math.nan if place is None else slack_value(place.x, place.y, observed.drop)
        stiffness = self.locomotion.tether_stiffness
        stuck = 0 if self._may_drive_on(place) else self._stuck
        around = LocomotionSituation(
            value, stiffness, observed.slope, stuck, self._jumped, assessment
        )
        choice = choose(self.locomotion, around)
        mode = choice.mode
        if mode is LocomotionMode.JUMP and self._jumps >= self.plan.jumps.max_jumps:
            mode = LocomotionMode.WHEELS
        elif mode is LocomotionMode.WHEELS and self._detours >= self.plan.jumps.max_detours:
            mode = LocomotionMode.JUMP
            if assessment is not None and assessment.refused:
                return LegEnd(
                    LegResult.FAILED, f"no detour is left, and no jump: {assessment.refused}"
                )
        if mode is not choice.mode:
            text = f"{choice.reason}; but of {choice.mode} none is left"
            choice = choice._replace(mode=mode, reason=text)
        self._choices.append(choice)
        self._last_mode = mode
        if mode is LocomotionMode.JUMP:
            self._enter(_State.SLACKEN, now)
            return None
        self._detours += 1
        if place is not None:
            bend = 0.0 if self._cannot_turn else _DETOUR_ANGLE * self._detours
            self._straight_detour_from = place if self._cannot_turn else None
            towards = place.heading + bend
            x, y = (
                place.x + _DETOUR_LENGTH * math.cos(towards),
                place.y + _DETOUR_LENGTH * math.sin(towards),
            )
            self._detour_goal = Place(x, y, math.nan)
        self._enter(_State.DRIVE, now)
        return None

    def _may_drive_on(self, place: Place | None) -> bool:
        """Whether the rover cannot turn here, and has not tried to drive on from here."""
        if place is None or not self._cannot_turn:
            return False
        tried = self._straight_detour_from
        return (
            tried is None or math.hypot(place.x - tried.x, place.y - tried.y) > 0.5 * _DETOUR_LENGTH
        )

    # --- jumping ---------------------------------------------------------------------------------

    def _slacken(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        refused = refusal_of(events, topics.WINCH_REQUEST)
        if refused:
            return LegEnd(LegResult.FAILED, refused)
        # Who led the tether still brings it to rest.
        since = now - observed.since.get(topics.WINCH_MODE, -math.inf)
        if observed.winch_moving or since < _WINCH_REST_TIME:
            return None
        if math.isnan(self._slack_start):
            self._slack_start = observed.length
        slack = self.plan.jumps.slack
        if self.requested_at is not None:
            waits = now - self.requested_at < _SLACK_TIME
            given = observed.length - self._slack_start > _SLACK_FRACTION * slack
            # A mission that was killed since had it given: the winch counts from the taut length.
            if given or (not waits and observed.winch == "slack"):
                self._slack_start = math.nan
                self._enter(_State.JUMP, now)
                return None
            if waits:
                return None
        return ProposedRequest(
            Action.SLACKEN, Request(topics.WINCH_REQUEST, joint_request(WINCH_SLACK, slack))
        )

    def _jump(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        refused = refusal_of(events, topics.JUMP_REQUEST)
        if refused:
            return LegEnd(LegResult.FAILED, refused)
        for event in events:
            if event.name == "jump_landed" and event.level is not Level.OK:
                return LegEnd(LegResult.FAILED, event.message)
        if observed.jump == "fault" and self.requested_at is not None and self._left_ground:
            return LegEnd(LegResult.FAILED, "the jump ended in a fault")
        self._left_ground |= observed.in_flight
        if observed.jump == "letting_down" and self.requested_at is not None:
            return LegEnd(LegResult.FAILED, "the jump was broken off")
        if self._left_ground and observed.jump == "standby":
            self._jumps += 1
            self.blackboard.jumps += 1
            self._enter(_State.SETTLE, now)
            return None
        if self.requested_at is None or (observed.jump == "standby" and self._is_overdue(now)):
            return ProposedRequest(Action.JUMP, Request(topics.JUMP_REQUEST, self._jump_request()))
        return None

    def _jump_request(self) -> JointSample:
        """What is asked of the jump."""
        return joint_request(JUMP_STROKE, self._stroke)

    @property
    def jump_started(self) -> float:
        """When slack and jump began [s]; infinite while it drives."""
        return math.inf if self._state is _State.DRIVE else self._entered


class JumpTask(DriveTask):
    """A jump where the rover stands, to see over the rubble."""

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self._enter(_State.SLACKEN, now)

    def _settled(self, now: float) -> LegEnd | None:  # noqa: ARG002 - nothing follows
        return LegEnd(LegResult.DONE, "flown")

    def _jump_request(self) -> JointSample:
        return joint_request(JUMP_HEIGHT, self.leg.height)


def _pose(place: Place) -> PoseSample:
    half = 0.5 * place.heading
    turned = (0.0, 0.0, math.sin(half), math.cos(half))
    return PoseSample(0, (place.x, place.y, 0.0), turned)
