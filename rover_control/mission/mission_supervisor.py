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
skips it or holds, see `_AFTER_LAST_TRIAL`. On the floor the winch helps first: it hauls the rover
below the fairlead, sets it down there for another trial, or takes it home. Requests that an
interlock forbids are not sent. Every transition is reported as an event with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from enum import Enum, auto
from typing import Any, NamedTuple

from msg_schemas import topics
from msg_schemas.events import EventReport, MissionEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase, JumpPhase, MissionPhase, WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Sample
from rover_control.mission.mission_floor import DriveTask, JumpTask
from rover_control.mission.mission_interlocks import Condition, remedy, violated_interlock
from rover_control.mission.mission_legs import (
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
)
from rover_control.mission.mission_parameters import MissionSettings
from rover_control.mission.mission_plan import MissionPlan
from rover_control.mission.mission_route import Leg, LegKind, Route
from rover_control.mission.observed_state import ObservedState, Place

_NANO = 1e9
_SERVICE_PERIOD = 2.0  # least time between two calls of one service [s]
_STANDING_TIME = 2.0  # after which a rover that came down again stands [s]


class _AfterLastTrial(Enum):
    """What follows the last failed trial of a leg."""

    NEXT = auto()
    HOLD = auto()


_AFTER_LAST_TRIAL: Mapping[LegKind, _AfterLastTrial] = {
    LegKind.LOOK: _AfterLastTrial.NEXT,
    LegKind.TURN: _AfterLastTrial.NEXT,
    LegKind.APPROACH: _AfterLastTrial.NEXT,
    LegKind.DAMP: _AfterLastTrial.NEXT,
    LegKind.LAND: _AfterLastTrial.HOLD,
    LegKind.VISIT: _AfterLastTrial.NEXT,
    LegKind.JUMP: _AfterLastTrial.NEXT,
    LegKind.RETURN: _AfterLastTrial.HOLD,
    LegKind.LIFT: _AfterLastTrial.HOLD,
    LegKind.ASCEND: _AfterLastTrial.HOLD,
    LegKind.STOW: _AfterLastTrial.HOLD,
}
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
_MANDATORY = (LegKind.LIFT, LegKind.ASCEND, LegKind.STOW)


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
    """

    def __init__(self, plan: MissionPlan, settings: MissionSettings | None = None) -> None:
        self.plan = plan
        self.settings = settings or MissionSettings()
        self.observed = ObservedState(self.settings.mission.node_timeout)
        self.route = Route(plan)
        self.record: list[LegRecord] = []
        self.blackboard = Blackboard()
        self.reason = ""  # reason of the present phase
        self.waiting_on = ""  # what the leg is waiting for; empty = nothing
        self._failed_trials = 0
        self._lifts_again = 0  # since the last leg that is no lift
        self._rearms = 0
        self._task: LegTask | None = None
        self._idle_phase = MissionPhase.STANDBY  # phase while no leg is active
        self._is_at_rest = True  # whether everything has come to rest since the last hold
        self._retry_at = -math.inf  # start of the next trial [s]
        self._sent_at: dict[str, float] = {}  # time of the last request, by topic or service [s]
        self._published_phase: MissionPhase | None = None
        self._changes: list[EventReport] = []

    # --- state -----------------------------------------------------------------------------------

    @property
    def phase(self) -> MissionPhase:
        """Present phase."""
        return self._idle_phase if self._task is None else self._task.phase

    @property
    def is_active(self) -> bool:
        """Whether a leg is active."""
        return self._task is not None

    @property
    def leg(self) -> Leg | None:
        """The active or next leg; None = no leg remains."""
        return self.route.leg

    @property
    def failed_trials(self) -> int:
        """Failed trials of the present leg."""
        return self._failed_trials

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call and clear them."""
        taken, self._changes = self._changes, []
        return taken

    def receive(self, topic: str, sample: Sample, now_ns: int) -> None:
        """Process a sample on one of `observed_state.OBSERVED_TOPICS`."""
        self.observed.receive(topic, sample, now_ns)

    # --- operator commands -----------------------------------------------------------------------

    def go(self, now_ns: int) -> str:
        """Begin the mission; after an abort, the return.

        Raises:
            Refusal: a mission is active or held, or the winch estimate is stale.
        """
        now = now_ns / _NANO
        if self.is_active or self._idle_phase is MissionPhase.HOLDING:
            service = topics.MISSION_RESUME if not self.is_active else topics.MISSION_ABORT
            raise _refused(topics.MISSION_GO, f"a mission is in phase {self.phase}; use {service}")
        self._check_winch(topics.MISSION_GO, now)
        on_floor = self.observed.on_floor
        if self._idle_phase is MissionPhase.ABORTED:
            self.route.begin_home(on_floor=on_floor)
            text = "return from " + ("the floor" if on_floor else f"{self.observed.length:.2f} m")
        else:
            self.route.begin(on_floor=on_floor)
            self.record, self.blackboard = [], Blackboard()
            if not on_floor:
                self.observed.place = None
            elif self.observed.place is None:
                landed = Place(0.0, 0.0, math.radians(self.plan.heading))
                self.observed.place = self.observed.reported_place or landed
            text = f"{len(self.route.legs)} legs" + (", beginning on the floor" if on_floor else "")
        self._emit(MissionEvent.STARTED, text)
        self._failed_trials = 0
        self._begin(now, text)
        return text

    def hold(self, _now_ns: int) -> str:
        """Bring everything to rest; the leg can be resumed.

        Raises:
            Refusal: no mission is active.
        """
        if not self.is_active:
            if self._idle_phase in (MissionPhase.HOLDING, MissionPhase.ABORTED):
                self._is_at_rest = False
                return f"already {self._idle_phase}"
            raise _refused(topics.MISSION_HOLD, "no mission is active")
        self._stop(MissionEvent.HOLDING, Reason.REQUESTED, "hold requested")
        return "coming to rest"

    def resume(self, now_ns: int) -> str:
        """Restart the held leg.

        Raises:
            Refusal: no leg is held, or the winch estimate is stale.
        """
        now = now_ns / _NANO
        if self.is_active or self._idle_phase is not MissionPhase.HOLDING or self.leg is None:
            raise _refused(
                topics.MISSION_RESUME, f"the mission is in phase {self.phase}, no leg is held"
            )
        self._check_winch(topics.MISSION_RESUME, now)
        self._failed_trials = 0
        self._begin(now, f"resumed with {self.leg.name}")
        return f"resuming with {self.leg.name}"

    def skip(self, now_ns: int) -> str:
        """Skip the present leg.

        Raises:
            Refusal: no leg is active or held, or the rover could not return without it.
        """
        leg = self.leg
        held = self._idle_phase is MissionPhase.HOLDING
        if leg is None or not (self.is_active or held):
            raise _refused(topics.MISSION_SKIP, "no leg is active or held")
        if leg.kind in _MANDATORY:
            raise _refused(
                topics.MISSION_SKIP, f"{leg.name} is part of the return and cannot be skipped"
            )
        if leg.kind is LegKind.RETURN and not self._may_lift():
            radius = self.plan.lift.radius
            text = f"the rover must be within {radius:g} m of the plumb line"
            raise _refused(topics.MISSION_SKIP, f"{text} to be lifted; otherwise it swings")
        was_active, now = self.is_active, now_ns / _NANO
        self._record_leg(
            leg, LegResult.ABANDONED, "skipped by the operator", MissionEvent.LEG_SKIPPED
        )
        self._advance(leg)
        following = self.leg
        assert following is not None  # the last legs cannot be skipped
        if was_active:
            self._begin(now, f"{leg.name} is skipped")
        return f"next is {following.name}"

    def abort(self, _now_ns: int) -> str:
        """Bring everything to rest and discard the plan; `go` leads home. Always accepted."""
        if self._idle_phase is MissionPhase.STANDBY and not self.is_active:
            return "no mission is active"
        self._stop(MissionEvent.ABORTED, Reason.REQUESTED, "abort requested")
        return f"coming to rest; call {topics.MISSION_GO} to return"

    def _check_winch(self, subject: str, now: float) -> None:
        if self.observed.is_stale(topics.WINCH_ESTIMATE, now) or not self.observed.winch:
            raise Refusal(
                subject, RefusalCode.STALE, f"{topics.WINCH_ESTIMATE} is missing or stale"
            )

    def _may_lift(self) -> bool:
        return self._is_within(self.plan.lift.radius)

    def _is_within(self, radius: float) -> bool:
        """Whether the rover is known to be within a radius [m] of the plumb line."""
        place = self.observed.place
        return place is not None and math.hypot(place.x, place.y) <= radius

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> tuple[LegRequest, ...]:
        """Advance to a time [ns] and return the requests to send."""
        now = now_ns / _NANO
        events = self.observed.take_events()
        requests: tuple[LegRequest, ...] = ()
        if self._task is None:
            requests = self._bring_to_rest(now)
        elif now >= self._retry_at:
            outcome = self._check_timeout(now) or self._task.step(self.observed, events, now)
            self._publish_choices()
            if isinstance(outcome, LegEnd):
                self._on_leg_end(outcome, now)
            elif isinstance(outcome, ProposedRequest):
                requests = self._allowed(outcome, now)
            else:
                self.waiting_on = ""
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
        condition = violated_interlock(proposal.action, self.observed, now)
        self._publish_waiting("" if condition is None else condition.value)
        if condition is None:
            if not self._is_due(proposal.request.name, proposal.period, now):
                return ()
            assert self._task is not None
            self._task.on_sent(proposal.request, now)
            return (proposal.request,)
        if proposal.moves_winch and self.observed.winch == WinchMode.LENGTH:
            return self._call(topics.WINCH_HOLD, now)
        if condition is Condition.STOPPED:
            self._stop(MissionEvent.INTERRUPTED, Reason.FAULT, condition.value)
            return ()
        if condition is Condition.STANDING and self._lift_again(now):
            return ()
        service = remedy(condition, self.observed)
        if not service:
            return ()
        if service == topics.WINCH_REARM and self._rearms >= self.settings.mission.max_rearms:
            text = f"{condition.value} after {self._rearms} re-arms in this leg"
            self._stop(MissionEvent.INTERRUPTED, Reason.FAULT, text)
            return ()
        called = self._call(service, now)
        self._rearms += service == topics.WINCH_REARM and bool(called)
        return called

    def _bring_to_rest(self, now: float) -> tuple[LegRequest, ...]:
        """Stop whatever moves; afterwards send no more requests."""
        if self._is_at_rest:
            return ()
        observed = self.observed
        lets_down = observed.in_flight or observed.jump == JumpPhase.LETTING_DOWN
        if observed.spring_compressed and not lets_down:
            return self._call(topics.JUMP_ABORT, now)
        if observed.is_driving:
            return self._call(topics.DRIVE_STOP, now)
        aborts = self._idle_phase is MissionPhase.ABORTED
        # A descent that is still on the way to its first stop is in standby.
        if observed.descent_busy or (aborts and observed.descent == DescentPhase.HOLDING):
            return self._call(topics.DESCENT_ABORT if aborts else topics.DESCENT_HOLD, now)
        if not observed.descent_engaged and observed.winch_moving:
            return self._call(topics.WINCH_HOLD, now)
        if not observed.spring_compressed and not observed.in_flight:
            self._is_at_rest = True
            self._emit(MissionEvent.AT_REST, f"at rest, {self._idle_phase}")
        return ()

    def _call(self, service: str, now: float) -> tuple[LegRequest, ...]:
        return (LegRequest(service),) if self._is_due(service, _SERVICE_PERIOD, now) else ()

    def _is_due(self, name: str, period: float, now: float) -> bool:
        if now - self._sent_at.get(name, -math.inf) < period:
            return False
        self._sent_at[name] = now
        return True

    # --- legs ------------------------------------------------------------------------------------

    def _begin(self, now: float, reason: str) -> None:
        """Begin a trial of the present leg."""
        leg = self.leg
        assert leg is not None
        max_trials = self.settings.mission.max_trials
        is_last = self._failed_trials > 0 and self._failed_trials == max_trials - 1
        is_short = self.observed.length <= self.plan.lift.winch_only_length
        winch_only = leg.kind is LegKind.ASCEND and is_last and is_short
        kind = WinchAscentTask if winch_only else _TASKS[leg.kind]
        self._task = kind(leg, self.plan, self.blackboard, now)
        if isinstance(self._task, DriveTask):
            self._task.locomotion = self.settings.locomotion
        self._rearms = 0
        self._retry_at = -math.inf
        self._sent_at.clear()
        self.waiting_on = ""
        self.reason = reason
        values = {"leg": leg.name, "number": self.route.number, "of": len(self.route.legs)}
        self._emit(MissionEvent.LEG_STARTED, f"{leg.name}: {reason}", values=values)

    def _on_leg_end(self, end: LegEnd, now: float) -> None:
        """Handle the end of a trial: another trial, a recovery, the next leg, or hold."""
        leg = self.leg
        assert leg is not None
        if end.result is LegResult.OVERRIDDEN:
            self._stop(MissionEvent.INTERRUPTED, Reason.TAKEN_OVER, end.reason)
            return
        has_failed = end.result is LegResult.FAILED
        if has_failed and self._try_again(leg, end, now):
            return
        if end.result is not LegResult.DONE and self._recover(leg, end, now):
            return
        self._record_leg(leg, end.result, end.reason)
        if has_failed and _AFTER_LAST_TRIAL[leg.kind] is _AfterLastTrial.HOLD:
            continues = leg.kind is LegKind.RETURN and self._may_lift()
            if not continues:
                self._stop(MissionEvent.BLOCKED, Reason.FAULT, f"{leg.name}: {end.reason}")
                return
        self._advance(leg)
        if self.leg is None:
            self._complete(end.reason)
        else:
            self._begin(now, f"after {leg.name}: {end.reason}")

    def _try_again(self, leg: Leg, end: LegEnd, now: float) -> bool:
        """Begin another trial of a failed leg; False after the last one."""
        p = self.settings.mission
        self._failed_trials += 1
        self._emit(
            MissionEvent.TRIAL_FAILED,
            f"{leg.name}: {end.reason}",
            values={"failed_trials": self._failed_trials},
        )
        if self._failed_trials >= p.max_trials:
            return False
        self._begin(now, f"trial {self._failed_trials + 1} of {p.max_trials} after: {end.reason}")
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
        self._failed_trials = 0
        reason = f"{leg.name}: {Condition.STANDING.value}"
        values = {"failed_trials": self._lifts_again}
        self._emit(MissionEvent.TRIAL_FAILED, reason, values=values)
        self._begin(now, reason)
        return True

    def _complete(self, reason: str) -> None:
        """End the mission after its last leg."""
        self._task = None
        self._idle_phase = MissionPhase.STANDBY
        self.route.rewind()
        self.reason = reason
        missed = [done.leg for done in self.record if done.result is not LegResult.DONE]
        text = f"{len(self.record)} legs" + (f", not done: {', '.join(missed)}" if missed else "")
        values = {
            "pictures": self.blackboard.pictures,
            "jumps": self.blackboard.jumps,
            "missed": len(missed),
        }
        self._emit(MissionEvent.COMPLETED, text, values=values)

    def _recover(self, leg: Leg, end: LegEnd, now: float) -> bool:
        """Start a recovery by the winch; False if none is possible."""
        max_count, reason = self.plan.recovery.max_count, end.reason
        if max_count == 0 or not self._is_within(self.plan.recovery.radius):
            return False
        may_try_again = self.plan.landing is not None and self.route.recoveries < max_count
        if leg.kind is LegKind.RETURN:
            self._record_leg(leg, LegResult.DONE, f"completed by the winch: {reason}")
            self._advance(leg)
        elif leg.kind is LegKind.VISIT and may_try_again and not end.is_external:
            self.route.insert_recovery()
            self._failed_trials = 0
            values = {"leg": leg.name, "number": self.route.recoveries, "of": max_count}
            self._emit(MissionEvent.RECOVERY_STARTED, f"{leg.name}: {reason}", values=values)
        else:
            return False
        self._begin(now, reason)
        return True

    def _advance(self, leg: Leg) -> None:
        """Go on to the next leg; without a landing, skip the legs on the floor."""
        self.route.advance()
        self._failed_trials = 0
        if leg.kind is not LegKind.LIFT:
            self._lifts_again = 0
        if leg.kind is LegKind.LAND and self.record[-1].result is not LegResult.DONE:
            self.route.leave_floor()

    def _record_leg(
        self, leg: Leg, result: LegResult, reason: str, name: MissionEvent | None = None
    ) -> None:
        self.record.append(LegRecord(leg.name, result, reason))
        completed = result is LegResult.DONE
        default = MissionEvent.LEG_COMPLETED if completed else MissionEvent.LEG_FAILED
        self._emit(name or default, f"{leg.name}: {reason}", values={"leg": leg.name})

    def _stop(self, name: MissionEvent, cause: Reason, reason: str) -> None:
        self._task = None
        aborts = name is MissionEvent.ABORTED
        self._idle_phase = MissionPhase.ABORTED if aborts else MissionPhase.HOLDING
        self._is_at_rest = False
        self._sent_at.clear()
        self._publish_waiting("")
        self.reason = reason
        where = f" in {self.leg.name}" if self.leg is not None else ""
        self._emit(name, f"{reason}{where}", cause)

    # --- checkpoint ------------------------------------------------------------------------------

    def checkpoint(self, now_ns: int) -> dict[str, Any]:
        """State as JSON values, from which `restore` resumes."""
        blackboard = {name: _to_json(value) for name, value in asdict(self.blackboard).items()}
        place = self.observed.place
        return {
            "plan": self.plan.digest,
            "stamp_ns": now_ns,
            "phase": self.phase.value,
            "is_active": self.is_active,
            "route": self.route.checkpoint(),
            "failed_trials": self._failed_trials,
            "blackboard": blackboard,
            "place": None if place is None else [place.x, place.y, place.heading],
            "record": [[done.leg, done.result.name, done.reason] for done in self.record],
        }

    def restore(self, saved: Mapping[str, Any], now_ns: int, *, resumes: bool = True) -> None:
        """Restore from a checkpoint of the same plan and of an earlier time.

        Args:
            saved: the checkpoint.
            now_ns: present time [ns].
            resumes: whether an active mission goes on by itself after a short downtime.
        """
        age = (now_ns - int(saved["stamp_ns"])) / _NANO
        if saved["plan"] != self.plan.digest or age < 0.0:
            origin = "another plan" if age >= 0.0 else "another run: it lies ahead of the clock"
            self._emit(MissionEvent.CHECKPOINT_DISCARDED, f"the checkpoint is of {origin}")
            return
        phase = MissionPhase(saved["phase"])
        if phase is MissionPhase.STANDBY:
            return
        self.route.restore(saved["route"])
        self._failed_trials = int(saved["failed_trials"])
        self.blackboard = Blackboard(
            **{name: _from_json(value) for name, value in saved["blackboard"].items()}
        )
        self.record = [
            LegRecord(leg, LegResult[name], reason) for leg, name, reason in saved["record"]
        ]
        if saved["place"] is not None:
            self.observed.place = Place(*saved["place"])
        now = now_ns / _NANO
        if not saved["is_active"]:
            aborted = phase is MissionPhase.ABORTED
            name = MissionEvent.ABORTED if aborted else MissionEvent.HOLDING
            self._stop(name, Reason.RESTARTED, "restarted")
        elif resumes and age <= self.settings.mission.resume_window:
            self._begin(now, f"restarted after {age:.1f} s in the same run of the simulation")
        else:
            window = f", more than {self.settings.mission.resume_window:g} s" if resumes else ""
            text = f"restarted after {age:.0f} s{window}; call {topics.MISSION_RESUME} to resume"
            self._stop(MissionEvent.INTERRUPTED, Reason.RESTARTED, text)

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
            self._emit(
                MissionEvent.LOCOMOTION_CHOSEN, f"{choice.mode}: {choice.reason}", values=values
            )

    def _publish_waiting(self, reason: str) -> None:
        if reason and reason != self.waiting_on:
            self._emit(MissionEvent.WAITING, reason)
        self.waiting_on = reason

    def _publish_phase(self) -> None:
        phase = self.phase
        if phase is self._published_phase:
            return
        self._published_phase = phase
        leg = "" if self.leg is None or not self.is_active else f"{self.leg.name}: "
        text = f"{phase}: {leg}{self.reason}"
        self._emit(MissionEvent.PHASE_CHANGED, text, values={"phase": phase.value})

    def _emit(
        self,
        name: MissionEvent,
        text: str,
        reason: Reason | None = None,
        values: Mapping[str, object] | None = None,
    ) -> None:
        self._changes.append(EventReport(name, text, values or {}, reason))


def _to_json(value: float) -> float | None:
    return None if math.isnan(value) else value


def _from_json(value: Any) -> Any:
    return math.nan if value is None else value


def _refused(subject: str, reason: str) -> Refusal:
    return Refusal(subject, RefusalCode.WRONG_PHASE, reason)
