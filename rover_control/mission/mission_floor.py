"""Leg tasks on the floor: driving, detours and jumps. Pure.

======  =====================================================================================
visit   drives to a waypoint; where stuck, chooses between a detour and a jump on a slack
        tether, then drives on
jump    gets slack and jumps in place
return  drives back below the fairlead, like visit
======  =====================================================================================

A rover that has rolled over or hangs neither drives nor jumps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto

from msg_schemas import machine, topics
from msg_schemas.commands import CommandRecord, CommandState
from msg_schemas.phases import JumpPhase, MissionPhase
from msg_schemas.samples import NO_ORIENTATION, JointSample, PoseEstimateSample, PoseSample, Status
from rover_control.mission.locomotion import (
    Choice,
    JumpAssessment,
    LocomotionMode,
    LocomotionParameters,
    LocomotionSituation,
    choose,
    slack_value,
)
from rover_control.mission.mission_interlocks import RequestedAction
from rover_control.mission.mission_legs import (
    RESPONSE_TIMEOUT,
    Blackboard,
    LegEnd,
    LegRequest,
    LegResult,
    LegTask,
    ProposedRequest,
    ended_record,
    has_restarted,
    joint_request,
    overridden,
)
from rover_control.mission.mission_plan import MissionPlan
from rover_control.mission.mission_route import Leg, LegKind
from rover_control.mission.observed_state import ObservedState, Place

_SETTLE_TIME = 3.0  # after a jump [s]
_SLACK_TIME = 15.0  # time after which slack is requested again [s]
_WINCH_REST_TIME = 1.0  # rest time of the winch before slack is requested [s]
_PROGRESS = 0.1  # progress towards the goal that counts as a new place [m]
_DETOUR_LENGTH = 0.6  # [m]
_DETOUR_ANGLE = 0.8  # additional left angle of each further detour [rad]


class _State(Enum):
    DRIVE = auto()
    PREDICT = auto()
    SLACKEN = auto()
    JUMP = auto()
    SETTLE = auto()


class DriveTask(LegTask):
    """Drives to a place on the floor, with detours and jumps where the rover is stuck.

    Attributes:
        locomotion: parameters of the choice between both.
    """

    locomotion = LocomotionParameters()

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self._returns = leg.kind is LegKind.RETURN
        self._state = _State.DRIVE
        self._entered = now
        self._jumps = 0  # in this task
        self._detours = 0
        self._stuck = self._jumped = 0  # at this place, as counted for `locomotion`
        self._stuck_at = math.inf  # distance to the goal [m]
        self._cannot_turn = False  # where it got stuck last
        self._straight_detour_from: Place | None = None  # start of the last straight detour
        self._last_mode: LocomotionMode | None = None  # last choice at this place
        self._stroke = plan.jumps.stroke
        self._detour_goal: Place | None = None  # goal of the present detour
        self._choices: list[Choice] = []
        self._is_confirmed = False  # whether the node has begun the request

    @property
    def phase(self) -> MissionPhase:  # type: ignore[override]
        """Driving, choosing or jumping."""
        if self._state is _State.PREDICT:
            return MissionPhase.CHOOSING
        if self._state is not _State.DRIVE:
            return MissionPhase.JUMPING
        return MissionPhase.RETURNING if self._returns else MissionPhase.DRIVING

    def on_sent(self, request: LegRequest, now: float) -> None:
        """A start pose is not a request to drive."""
        if request.name != topics.DRIVE_START:
            super().on_sent(request, now)

    def step(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        """Drive; where stuck, choose between a detour and slack, jump and settling."""
        is_jumping = self._state in (_State.JUMP, _State.SETTLE)
        if not is_jumping and observed.on_floor and observed.has_rolled_over(now):
            text = f"the rover has rolled over: tilt {math.degrees(observed.slope):.0f} deg"
            return LegEnd(LegResult.ABANDONED, text)
        if not is_jumping and observed.has_hung(now, self._entered):
            return LegEnd(LegResult.ABANDONED, "the tether has lifted the rover off the floor")
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
        """Continue driving after a jump."""
        self._enter(_State.DRIVE, now)
        return None

    def _enter(self, state: _State, now: float) -> None:
        self._state, self._entered = state, now
        self.requested_at = None
        self._is_confirmed = False

    # --- driving ---------------------------------------------------------------------------------

    def _drive(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        if self._returns and self._is_home(observed) and not observed.is_driving:
            place = observed.place
            assert place is not None
            distance = math.hypot(place.x, place.y)
            return LegEnd(LegResult.DONE, f"{distance:.2f} m from the plumb line")
        if self.requested_at is not None:
            self._is_confirmed |= observed.is_driving
            record = ended_record(events, topics.DRIVE_GOAL)
            if record is not None:
                return self._on_drive_end(record, observed, now)
        if observed.place is not None and not observed.place_agrees:
            goal = _pose(observed.place)
            given = PoseEstimateSample(0, goal.position, goal.orientation)
            return ProposedRequest(RequestedAction.DRIVE, LegRequest(topics.DRIVE_START, given))
        is_lost = not observed.is_driving and (self._is_confirmed or self._is_overdue(now))
        if is_lost and now - observed.since.get(topics.DRIVE_PHASE, now) > RESPONSE_TIMEOUT:
            self.requested_at, self._is_confirmed = None, False
        if self.requested_at is None:
            return ProposedRequest(
                RequestedAction.DRIVE, LegRequest(topics.DRIVE_GOAL, self._goal())
            )
        return None

    def _on_drive_end(
        self, record: CommandRecord, observed: ObservedState, now: float
    ) -> LegEnd | None:
        """Process the end of the drive."""
        if record.state is CommandState.DONE and self._detour_goal is not None:
            self._detour_goal = None
            self._enter(_State.DRIVE, now)
            return None
        if record.state is CommandState.DONE:
            return LegEnd(LegResult.DONE, record.text)
        if record.state is CommandState.REFUSED:
            return LegEnd(LegResult.FAILED, record.text, is_external=True)
        if record.state is CommandState.SUPERSEDED:
            return overridden(record, "rover")
        if "cause" not in record.result:  # it is not stuck
            return LegEnd(LegResult.FAILED, record.text)
        self._count_stuck(observed)
        self._cannot_turn = record.number("turning") > 0.0
        no_jump_left = self._jumps >= self.plan.jumps.max_jumps
        if no_jump_left and self._detours >= self.plan.jumps.max_detours:
            return LegEnd(LegResult.FAILED, record.text)
        if self.locomotion.locomotion_rule == "risk" and not no_jump_left:
            self._enter(_State.PREDICT, now)
            return None
        return self._choose(None, observed, now)

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
        """Return the choices since the last call and clear them."""
        choices, self._choices = self._choices, []
        return choices

    def _count_stuck(self, observed: ObservedState) -> None:
        """Count a wheel failure, at this place or at a new one."""
        self._detour_goal = None
        place = observed.place
        distance = (
            math.inf if place is None else math.hypot(place.x - self.leg.x, place.y - self.leg.y)
        )
        if distance < self._stuck_at - _PROGRESS:
            self._stuck = self._jumped = 0
            self._last_mode = None
            self._stuck_at = distance
        self._stuck += self._stuck == 0 or self._last_mode is LocomotionMode.WHEELS
        self._jumped += self._last_mode is LocomotionMode.JUMP

    def _predict(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        record = ended_record(events, topics.JUMP_REQUEST)
        if record is not None and self.requested_at is not None:
            if record.state is CommandState.SUPERSEDED:
                return overridden(record, "jump motor")
            upright = record.number("upright")
            if record.state is not CommandState.DONE or math.isnan(upright):
                return self._choose(JumpAssessment(0.0, record.text), observed, now)
            self._stroke = record.number("stroke")
            return self._choose(JumpAssessment(upright, ""), observed, now)
        if self.requested_at is None or (
            observed.jump == JumpPhase.STANDBY and self._is_overdue(now)
        ):
            request = LegRequest(
                topics.JUMP_REQUEST,
                joint_request(machine.JUMP_PREDICTION, self.plan.jumps.clearance),
            )
            # Nothing moves, but the same interlocks apply.
            return ProposedRequest(RequestedAction.SLACKEN, request)
        return None

    def _choose(
        self, assessment: JumpAssessment | None, observed: ObservedState, now: float
    ) -> LegEnd | None:
        place = observed.place
        value = math.nan if place is None else slack_value(place.x, place.y, observed.drop)
        stiffness = self.locomotion.tether_stiffness
        stuck = 0 if self._may_drive_on(place) else self._stuck
        situation = LocomotionSituation(
            value, stiffness, observed.slope, stuck, self._jumped, assessment
        )
        choice = choose(self.locomotion, situation)
        mode = choice.mode
        if mode is LocomotionMode.JUMP and self._jumps >= self.plan.jumps.max_jumps:
            mode = LocomotionMode.WHEELS
        elif mode is LocomotionMode.WHEELS and self._detours >= self.plan.jumps.max_detours:
            mode = LocomotionMode.JUMP
            if assessment is not None and assessment.rejection:
                return LegEnd(
                    LegResult.FAILED,
                    f"no detour left, and the jump is rejected: {assessment.rejection}",
                )
        if mode is not choice.mode:
            text = f"{choice.reason}; but no {choice.mode} left"
            choice = choice._replace(mode=mode, reason=text)
        self._choices.append(choice)
        self._last_mode = mode
        if mode is LocomotionMode.JUMP:
            self._enter(_State.SLACKEN, now)
            return None
        self._detours += 1
        if place is not None:
            angle = 0.0 if self._cannot_turn else _DETOUR_ANGLE * self._detours
            self._straight_detour_from = place if self._cannot_turn else None
            heading = place.heading + angle
            x = place.x + _DETOUR_LENGTH * math.cos(heading)
            y = place.y + _DETOUR_LENGTH * math.sin(heading)
            self._detour_goal = Place(x, y, math.nan)
        self._enter(_State.DRIVE, now)
        return None

    def _may_drive_on(self, place: Place | None) -> bool:
        """Whether the rover cannot turn here and has not tried a straight detour yet."""
        if place is None or not self._cannot_turn:
            return False
        start = self._straight_detour_from
        return (
            start is None or math.hypot(place.x - start.x, place.y - start.y) > 0.5 * _DETOUR_LENGTH
        )

    # --- jumping ---------------------------------------------------------------------------------

    def _slacken(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        record = ended_record(events, topics.WINCH_REQUEST)
        if record is not None and self.requested_at is not None:
            if record.state is CommandState.SUPERSEDED:
                return overridden(record, "winch")
            if record.state is not CommandState.DONE:
                return LegEnd(LegResult.FAILED, record.text)
            self._enter(_State.JUMP, now)
            return None
        # The node that controlled the tether may still be stopping the winch.
        since = now - observed.since.get(topics.WINCH_MODE, -math.inf)
        if observed.winch_moving or since < _WINCH_REST_TIME:
            return None
        # After a restart the slack may have been given already: the winch counts it from taut.
        if self.requested_at is not None and now - self.requested_at < _SLACK_TIME:
            return None
        slack = joint_request(machine.WINCH_SLACK, self.plan.jumps.slack)
        return ProposedRequest(RequestedAction.SLACKEN, LegRequest(topics.WINCH_REQUEST, slack))

    def _jump(
        self, observed: ObservedState, events: Sequence[Status], now: float
    ) -> ProposedRequest | LegEnd | None:
        record = ended_record(events, topics.JUMP_REQUEST)
        if record is not None and self.requested_at is not None:
            if record.state is CommandState.SUPERSEDED:
                return overridden(record, "jump motor")
            if record.state is not CommandState.DONE:
                return LegEnd(LegResult.FAILED, record.text)
            self._jumps += 1
            self.blackboard.jumps += 1
            self._enter(_State.SETTLE, now)
            return None
        if has_restarted(events, "jump_node"):
            self._is_confirmed = False
        is_taken = observed.jump not in ("", JumpPhase.STANDBY)
        self._is_confirmed |= is_taken and self.requested_at is not None
        is_lost = (
            observed.jump == JumpPhase.STANDBY and not self._is_confirmed and self._is_overdue(now)
        )
        if self.requested_at is None or is_lost:
            return ProposedRequest(
                RequestedAction.JUMP, LegRequest(topics.JUMP_REQUEST, self._jump_request())
            )
        return None

    def _jump_request(self) -> JointSample:
        """The request for the jump."""
        return joint_request(machine.JUMP_STROKE, self._stroke)

    @property
    def jump_started(self) -> float:
        """Start of the present jump attempt [s]; infinite while driving."""
        return math.inf if self._state is _State.DRIVE else self._entered


class JumpTask(DriveTask):
    """Jumps in place, for a view over the rubble."""

    def __init__(self, leg: Leg, plan: MissionPlan, blackboard: Blackboard, now: float) -> None:
        super().__init__(leg, plan, blackboard, now)
        self._enter(_State.SLACKEN, now)

    def _settled(self, now: float) -> LegEnd | None:  # noqa: ARG002 - no further step
        return LegEnd(LegResult.DONE, "jump completed")

    def _jump_request(self) -> JointSample:
        return joint_request(machine.JUMP_HEIGHT, self.leg.height)


def _pose(place: Place) -> PoseSample:
    half = 0.5 * place.heading
    turned = (0.0, 0.0, math.sin(half), math.cos(half))
    return PoseSample(0, (place.x, place.y, 0.0), turned)
