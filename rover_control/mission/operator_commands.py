"""Commands of an operator to a mission: what is executed, and why the rest is refused. Pure."""

from __future__ import annotations

import math

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import MissionPhase
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.mission.mission_legs import Blackboard, LegResult
from rover_control.mission.mission_route import LegKind
from rover_control.mission.mission_supervisor import Mission
from rover_control.mission.observed_state import Place

_NANO = 1e9
_MANDATORY = (LegKind.LIFT, LegKind.ASCEND, LegKind.STOW)


class OperatorCommands:
    """Executes or refuses each command to a mission.

    Args:
        mission: that executes them.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission = mission

    def go(self, now_ns: int) -> str:
        """Begin the mission; after an abort, the return.

        Raises:
            Refusal: a mission is active or held, or the winch estimate is stale.
        """
        mission, now = self.mission, now_ns / _NANO
        if mission.is_active or mission.idle_phase is MissionPhase.HOLDING:
            service = topics.MISSION_RESUME if not mission.is_active else topics.MISSION_ABORT
            raise _refused(
                topics.MISSION_GO, f"a mission is in phase {mission.phase}; use {service}"
            )
        self._check_winch(topics.MISSION_GO, now)
        observed, route = mission.observed, mission.route
        on_floor = observed.on_floor
        if mission.idle_phase is MissionPhase.ABORTED:
            route.begin_home(on_floor=on_floor)
            text = "return from " + ("the floor" if on_floor else f"{observed.length:.2f} m")
        else:
            route.begin(on_floor=on_floor)
            mission.record, mission.blackboard = [], Blackboard()
            if not on_floor:
                observed.place = None
            elif observed.place is None:
                landed = Place(0.0, 0.0, math.radians(mission.plan.heading))
                observed.place = observed.reported_place or landed
            text = f"{len(route.legs)} legs" + (", beginning on the floor" if on_floor else "")
        mission.emit(MissionEvent.STARTED, text)
        mission.failed_trials = 0
        mission.begin_trial(now, text)
        return text

    def hold(self, _now_ns: int) -> str:
        """Bring everything to rest; the leg can be resumed.

        Raises:
            Refusal: no mission is active.
        """
        mission = self.mission
        if not mission.is_active:
            if mission.idle_phase in (MissionPhase.HOLDING, MissionPhase.ABORTED):
                mission.rest.begin()
                return f"already {mission.idle_phase}"
            raise _refused(topics.MISSION_HOLD, "no mission is active")
        mission.stop(MissionEvent.HOLDING, Reason.REQUESTED, "hold requested")
        return "coming to rest"

    def resume(self, now_ns: int) -> str:
        """Restart the held leg.

        Raises:
            Refusal: no leg is held, or the winch estimate is stale.
        """
        mission, now = self.mission, now_ns / _NANO
        if (
            mission.is_active
            or mission.idle_phase is not MissionPhase.HOLDING
            or mission.leg is None
        ):
            raise _refused(
                topics.MISSION_RESUME, f"the mission is in phase {mission.phase}, no leg is held"
            )
        self._check_winch(topics.MISSION_RESUME, now)
        mission.failed_trials = 0
        mission.begin_trial(now, f"resumed with {mission.leg.name}")
        return f"resuming with {mission.leg.name}"

    def skip(self, now_ns: int) -> str:
        """Skip the present leg.

        Raises:
            Refusal: no leg is active or held, or the rover could not return without it.
        """
        mission, leg = self.mission, self.mission.leg
        held = mission.idle_phase is MissionPhase.HOLDING
        if leg is None or not (mission.is_active or held):
            raise _refused(topics.MISSION_SKIP, "no leg is active or held")
        if leg.kind in _MANDATORY:
            raise _refused(
                topics.MISSION_SKIP, f"{leg.name} is part of the return and cannot be skipped"
            )
        if leg.kind is LegKind.RETURN and not mission.observed.is_within(mission.plan.lift.radius):
            radius = mission.plan.lift.radius
            text = f"the rover must be within {radius:g} m of the plumb line"
            raise _refused(topics.MISSION_SKIP, f"{text} to be lifted; otherwise it swings")
        was_active, now = mission.is_active, now_ns / _NANO
        mission.record_leg(
            leg, LegResult.ABANDONED, "skipped by the operator", MissionEvent.LEG_SKIPPED
        )
        mission.advance(leg)
        following = mission.leg
        assert following is not None  # the last legs cannot be skipped
        if was_active:
            mission.begin_trial(now, f"{leg.name} is skipped")
        return f"next is {following.name}"

    def abort(self, _now_ns: int) -> str:
        """Bring everything to rest and discard the plan; `go` leads home. Always accepted."""
        mission = self.mission
        if mission.idle_phase is MissionPhase.STANDBY and not mission.is_active:
            return "no mission is active"
        mission.stop(MissionEvent.ABORTED, Reason.REQUESTED, "abort requested")
        return f"coming to rest; call {topics.MISSION_GO} to return"

    def _check_winch(self, subject: str, now: float) -> None:
        observed = self.mission.observed
        if observed.is_stale(topics.WINCH_ESTIMATE, now) or not observed.winch:
            raise Refusal(
                subject, RefusalCode.STALE, f"{topics.WINCH_ESTIMATE} is missing or stale"
            )


def _refused(subject: str, reason: str) -> Refusal:
    return Refusal(subject, RefusalCode.WRONG_PHASE, reason)
