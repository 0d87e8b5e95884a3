"""Mission supervisor: executes a plan leg by leg through requests to the other nodes. Pure.

It commands no motor. Its phases:

===========  ================================================================================
standby      no mission; `go` begins
(of a leg)   looking, turning, approaching, landing, driving, choosing, jumping, returning,
             lifting, ascending, stowing: the present leg's activity
holding      at rest, on request or because a leg cannot continue; `resume` restarts the leg,
             `skip` omits it
aborted      at rest, the plan is discarded; `go` leads home from the present position
===========  ================================================================================

Each trial of a leg has a time limit. A failed leg is tried again; after `max_trials` the mission
skips it or holds, see `_HOLDS_AFTER_LAST_TRIAL`. On the floor the winch helps first: it hauls the
rover below the fairlead, sets it down there for another trial, or takes it home. Requests that an
interlock forbids are not sent. Every transition is reported as an event with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import EventReport, MissionEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import MissionPhase, WinchMode
from rover_control.mission.mission_floor import DriveTask, JumpTask
from rover_control.mission.mission_interlocks import Condition, remedy, violated_interlock
from rover_control.mission.mission_legs import (
    RESPONSE_TIMEOUT,
    Blackboard,
    LandTask,
    LegEnd,
    LegRequest,
    LegResult,
    LegTask,
    LiftTask,
    ProposedRequest,
    StopTask,
    StowTask,
    TurnTask,
    WinchAscentTask,
    is_hold_of_winch,
)
from rover_control.mission.mission_parameters import MissionSettings
from rover_control.mission.mission_plan import MissionPlan
from rover_control.mission.mission_route import Leg, LegKind, Route
from rover_control.mission.observed_state import ObservedState
from rover_control.mission.request_timer import RequestTimer
from rover_control.mission.rest_sequence import RestSequence

_NANO = 1e9
_STANDING_TIME = 2.0  # after which a rover that came down again stands [s]
_HOLDS_AFTER_LAST_TRIAL = frozenset(
    {LegKind.LAND, LegKind.RETURN, LegKind.LIFT, LegKind.ASCEND, LegKind.STOW}
)
_TASKS: Mapping[LegKind, type[LegTask]] = {
    LegKind.LOOK: StopTask,
    LegKind.TURN: TurnTask,
    LegKind.APPROACH: StopTask,
    LegKind.DAMP: StopTask,
    LegKind.LAND: LandTask,
    LegKind.VISIT: DriveTask,
    LegKind.JUMP: JumpTask,
    LegKind.RETURN: DriveTask,
    LegKind.LIFT: LiftTask,
    LegKind.ASCEND: StopTask,
    LegKind.STOW: StowTask,
}
_HANGING = (LegKind.LOOK, LegKind.APPROACH, LegKind.DAMP, LegKind.ASCEND)


class LegRecord(NamedTuple):
    """A finished leg."""

    leg: str
    result: LegResult
    reason: str


class Mission:
    """Supervisor of one mission.

    Args:
        plan: legs and limits of the mission.
        settings: parameters.

    Attributes:
        observed: state of all nodes.
        timer: of the requests to the nodes.
        rest: brings everything to rest while no leg is active.
        route: legs of the mission, and the present one.
        record: finished legs.
        blackboard: data shared between legs.
        reason: of the present phase.
        waiting_on: what the leg is waiting for; empty = nothing.
        failed_trials: of the present leg.
        idle_phase: phase while no leg is active.
    """

    def __init__(self, plan: MissionPlan, settings: MissionSettings | None = None) -> None:
        self.plan = plan
        self.settings = settings or MissionSettings()
        self._changes: list[EventReport] = []  # shared with the sequence of a stop
        self.observed = ObservedState(self.settings.mission.node_timeout)
        self.timer = RequestTimer()
        self.rest = RestSequence(self.observed, self.timer, self._changes)
        self.route = Route(plan)
        self.record: list[LegRecord] = []
        self.blackboard = Blackboard()
        self.reason = ""
        self.waiting_on = ""
        self.failed_trials = 0
        self._lifts_again = 0  # since the last leg that is no lift
        self._rearms = 0
        self._task: LegTask | None = None
        self.idle_phase = MissionPhase.STANDBY
        self._retry_at = -math.inf  # start of the next trial [s]
        self._held_at = -math.inf  # last time that the mission itself held the winch [s]
        self._published_phase: MissionPhase | None = None

    # --- state -----------------------------------------------------------------------------------

    @property
    def phase(self) -> MissionPhase:
        """Present phase."""
        return self.idle_phase if self._task is None else self._task.phase

    @property
    def is_active(self) -> bool:
        """Whether a leg is active."""
        return self._task is not None

    @property
    def leg(self) -> Leg | None:
        """The active or next leg; None = no leg remains."""
        return self.route.leg

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call and clear them."""
        taken = list(self._changes)
        self._changes.clear()
        return taken

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> tuple[LegRequest, ...]:
        """Advance to a time [ns] and return the requests to send."""
        now = now_ns / _NANO
        events = self.observed.take_events()
        requests: tuple[LegRequest, ...] = ()
        if self._task is None:
            requests = self.rest.step(self.idle_phase, now)
        elif now - self._held_at > RESPONSE_TIMEOUT and any(map(is_hold_of_winch, events)):
            text = "another command source holds the winch"
            self.stop(MissionEvent.INTERRUPTED, Reason.TAKEN_OVER, text)
        elif now >= self._retry_at:
            outcome = self._check_timeout(now) or self._task.step(self.observed, events, now)
            self._publish_choices()
            if isinstance(outcome, LegEnd):
                self._on_leg_end(outcome, now)
            elif isinstance(outcome, ProposedRequest):
                requests = self._allowed(outcome, now)
            else:
                self.waiting_on = ""
        if LegRequest(topics.WINCH_HOLD) in requests:
            self._held_at = now
        self._publish_phase()
        return requests

    def _check_timeout(self, now: float) -> LegEnd | None:
        task = self._task
        assert task is not None
        limits = self.settings.limits
        limit = limits.of(task.leg.kind)
        waiting = f", waiting: {self.waiting_on}" if self.waiting_on else ""
        if now - task.started > limit:
            text = f"not finished within {limit:g} s{waiting}"
            return LegEnd(LegResult.FAILED, text, is_external=bool(waiting))
        if isinstance(task, DriveTask) and now - task.jump_started > limits.stuck_jump_timeout:
            return LegEnd(
                LegResult.FAILED, f"no jump within {limits.stuck_jump_timeout:g} s{waiting}"
            )
        return None

    def _allowed(self, proposal: ProposedRequest, now: float) -> tuple[LegRequest, ...]:
        """Apply the interlocks: the proposed request, one that clears its interlock, or none."""
        assert self._task is not None
        condition = violated_interlock(proposal.action, self.observed, now)
        self._publish_waiting("" if condition is None else condition.value)
        if condition is None:
            if not self.timer.is_due(proposal.request.name, proposal.period, now):
                return ()
            self._task.on_sent(proposal.request, now)
            return (proposal.request,)
        if proposal.moves_winch and self.observed.winch == WinchMode.LENGTH:
            self._task.requested_at = None  # the record of the held request does not end the leg
            return self.timer.call(topics.WINCH_HOLD, now)
        if condition is Condition.STOPPED:
            self.stop(MissionEvent.INTERRUPTED, Reason.FAULT, condition.value)
            return ()
        if condition is Condition.STANDING and self._lift_again(now):
            return ()
        service = remedy(condition, self.observed)
        if not service:
            return ()
        if service == topics.WINCH_REARM and self._rearms >= self.settings.mission.max_rearms:
            text = f"{condition.value} after {self._rearms} re-arms in this leg"
            self.stop(MissionEvent.INTERRUPTED, Reason.FAULT, text)
            return ()
        called = self.timer.call(service, now)
        self._rearms += service == topics.WINCH_REARM and bool(called)
        return called

    # --- legs ------------------------------------------------------------------------------------

    def begin_trial(self, now: float, reason: str) -> None:
        """Begin a trial of the present leg."""
        leg = self.leg
        assert leg is not None
        max_trials = self.settings.mission.max_trials
        is_last = self.failed_trials > 0 and self.failed_trials == max_trials - 1
        is_short = self.observed.length <= self.plan.lift.winch_only_length
        winch_only = leg.kind is LegKind.ASCEND and is_last and is_short
        kind = WinchAscentTask if winch_only else _TASKS[leg.kind]
        self._task = kind(leg, self.plan, self.blackboard, now)
        if isinstance(self._task, DriveTask):
            self._task.locomotion = self.settings.locomotion
        if self.failed_trials == 0:
            self._rearms = 0
        self._retry_at = -math.inf
        self.timer.clear()
        self.waiting_on = ""
        self.reason = reason
        values = {"leg": leg.name, "number": self.route.number, "of": len(self.route.legs)}
        self.emit(MissionEvent.LEG_STARTED, f"{leg.name}: {reason}", values=values)

    def _on_leg_end(self, end: LegEnd, now: float) -> None:
        """Handle the end of a trial: another trial, a recovery, the next leg, or hold."""
        leg = self.leg
        assert leg is not None
        if end.result is LegResult.OVERRIDDEN:
            self.stop(MissionEvent.INTERRUPTED, Reason.TAKEN_OVER, end.reason)
            return
        has_failed = end.result is LegResult.FAILED
        if has_failed and self._try_again(leg, end, now):
            return
        if end.result is not LegResult.DONE and self._recover(leg, end, now):
            return
        self.record_leg(leg, end.result, end.reason)
        if has_failed and leg.kind in _HOLDS_AFTER_LAST_TRIAL:
            continues = leg.kind is LegKind.RETURN and self.observed.is_within(
                self.plan.lift.radius
            )
            if not continues:
                self.stop(MissionEvent.BLOCKED, Reason.FAULT, f"{leg.name}: {end.reason}")
                return
        self.advance(leg)
        if self.leg is None:
            self._complete(end.reason)
        else:
            self.begin_trial(now, f"after {leg.name}: {end.reason}")

    def _try_again(self, leg: Leg, end: LegEnd, now: float) -> bool:
        """Begin another trial of a failed leg; False after the last one."""
        p = self.settings.mission
        self.failed_trials += 1
        self.emit(
            MissionEvent.TRIAL_FAILED,
            f"{leg.name}: {end.reason}",
            values={"failed_trials": self.failed_trials},
        )
        if self.failed_trials >= p.max_trials:
            return False
        self.begin_trial(
            now, f"trial {self.failed_trials + 1} of {p.max_trials} after: {end.reason}"
        )
        # Without a delay, all trials fail before the timeout of a missing node expires.
        self._retry_at = now + (p.retry_delay if leg.kind in _HANGING else p.node_timeout)
        return True

    def _lift_again(self, now: float) -> bool:
        """Go back to the lift if the lifted rover has come down to the floor again.

        Returns:
            False if no lift precedes, it was repeated too often, or the rover may only knock.
        """
        stands = now - self.observed.on_floor_since > _STANDING_TIME
        may_repeat = self._lifts_again < self.settings.mission.max_trials - 1
        leg = self.leg
        if leg is None or not (stands and may_repeat and self.route.back_to_lift()):
            return False
        self._lifts_again += 1
        self.failed_trials = 0
        reason = f"{leg.name}: {Condition.STANDING.value}"
        values = {"failed_trials": self._lifts_again}
        self.emit(MissionEvent.TRIAL_FAILED, reason, values=values)
        self.begin_trial(now, reason)
        return True

    def _complete(self, reason: str) -> None:
        """End the mission after its last leg."""
        self._task = None
        self.idle_phase = MissionPhase.STANDBY
        self.route.rewind()
        self.reason = reason
        missed = [done.leg for done in self.record if done.result is not LegResult.DONE]
        text = f"{len(self.record)} legs" + (f", not done: {', '.join(missed)}" if missed else "")
        values = {
            "pictures": self.blackboard.pictures,
            "jumps": self.blackboard.jumps,
            "missed": len(missed),
        }
        self.emit(MissionEvent.COMPLETED, text, values=values)

    def _recover(self, leg: Leg, end: LegEnd, now: float) -> bool:
        """Start a recovery by the winch; False if none is possible."""
        max_count, reason = self.plan.recovery.max_count, end.reason
        if max_count == 0 or not self.observed.is_within(self.plan.recovery.radius):
            return False
        may_try_again = self.plan.landing is not None and self.route.recoveries < max_count
        if leg.kind is LegKind.RETURN:
            self.record_leg(leg, LegResult.DONE, f"completed by the winch: {reason}")
            self.advance(leg)
            if self.plan.landing is not None:
                self.route.insert_recovery()
        elif leg.kind is LegKind.VISIT and may_try_again and not end.is_external:
            values = {"leg": leg.name, "number": self.route.recoveries + 1, "of": max_count}
            self.route.insert_recovery()
            self.failed_trials = 0
            self.emit(MissionEvent.RECOVERY_STARTED, f"{leg.name}: {reason}", values=values)
        else:
            return False
        self.begin_trial(now, reason)
        return True

    def advance(self, leg: Leg) -> None:
        """Go on to the next leg; skip those for which a leg that was not completed is needed."""
        self.route.advance()
        self.failed_trials = 0
        if leg.kind is not LegKind.LIFT:
            self._lifts_again = 0
        if self.record[-1].result is LegResult.DONE:
            return
        if leg.kind is LegKind.LAND:
            self.route.leave_floor()
        following = self.leg
        if following is not None and following.kind is LegKind.JUMP:  # at that waypoint
            self.record_leg(following, LegResult.ABANDONED, f"{leg.name} was not reached")
            self.route.advance()

    def record_leg(
        self, leg: Leg, result: LegResult, reason: str, name: MissionEvent | None = None
    ) -> None:
        """Record a finished leg and report it; by default by the event of its result."""
        self.record.append(LegRecord(leg.name, result, reason))
        completed = result is LegResult.DONE
        default = MissionEvent.LEG_COMPLETED if completed else MissionEvent.LEG_FAILED
        self.emit(name or default, f"{leg.name}: {reason}", values={"leg": leg.name})

    def stop(self, name: MissionEvent, cause: Reason, reason: str) -> None:
        """End the trial, and bring everything to rest.

        Args:
            name: of the event; an abort discards the plan, after any other the leg is held.
            cause: machine-readable reason.
            reason: as text.
        """
        self._task = None
        aborts = name is MissionEvent.ABORTED
        self.idle_phase = MissionPhase.ABORTED if aborts else MissionPhase.HOLDING
        self.rest.begin()
        self.timer.clear()
        self._publish_waiting("")
        self.reason = reason
        where = f" in {self.leg.name}" if self.leg is not None else ""
        self.emit(name, f"{reason}{where}", cause)

    # --- events ----------------------------------------------------------------------------------

    def _publish_choices(self) -> None:
        """Report the choices between wheels and jump."""
        if not isinstance(self._task, DriveTask):
            return
        for choice in self._task.take_choices():
            values = {
                "mode": choice.mode.value,
                "rule": self.settings.locomotion.locomotion_rule,
                "wheels_risk": choice.wheels_risk,
                "jump_risk": choice.jump_risk,
            }
            self.emit(
                MissionEvent.LOCOMOTION_CHOSEN, f"{choice.mode}: {choice.reason}", values=values
            )

    def _publish_waiting(self, reason: str) -> None:
        if reason and reason != self.waiting_on:
            self.emit(MissionEvent.WAITING, reason)
        self.waiting_on = reason

    def _publish_phase(self) -> None:
        phase = self.phase
        if phase is self._published_phase:
            return
        self._published_phase = phase
        leg = "" if self.leg is None or not self.is_active else f"{self.leg.name}: "
        text = f"{phase}: {leg}{self.reason}"
        self.emit(MissionEvent.PHASE_CHANGED, text, values={"phase": phase.value})

    def emit(
        self,
        name: MissionEvent,
        text: str,
        reason: Reason | None = None,
        values: Mapping[str, object] | None = None,
    ) -> None:
        """Report a transition."""
        self._changes.append(EventReport(name, text, values or {}, reason))
