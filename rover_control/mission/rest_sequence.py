"""Sequence in which a held or aborted mission brings everything to rest. Pure."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.events import EventReport, MissionEvent
from msg_schemas.phases import DescentPhase, JumpPhase, MissionPhase
from rover_control.mission.mission_legs import LegRequest
from rover_control.mission.observed_state import ObservedState
from rover_control.mission.request_timer import RequestTimer


class RestSequence:
    """Stops whatever moves, one after the other; afterwards it sends no more requests.

    Args:
        observed: state of all nodes.
        timer: of the mission's requests.
        changes: list that receives the event of the rest.
    """

    def __init__(
        self, observed: ObservedState, timer: RequestTimer, changes: list[EventReport]
    ) -> None:
        self.observed = observed
        self.timer = timer
        self._changes = changes
        self._is_at_rest = True  # whether everything has come to rest since the last begin

    def begin(self) -> None:
        """Bring everything to rest from the next step on."""
        self._is_at_rest = False

    def step(self, phase: MissionPhase, now: float) -> tuple[LegRequest, ...]:
        """Return the requests to send at a time [s].

        Args:
            phase: of the mission: in an abort, the stops of the descent are dropped.
            now: [s].
        """
        if self._is_at_rest:
            return ()
        observed, call = self.observed, self.timer.call
        lets_down = observed.in_flight or observed.jump == JumpPhase.LETTING_DOWN
        if observed.spring_compressed and not lets_down:
            return call(topics.JUMP_ABORT, now)
        if observed.is_driving:
            return call(topics.DRIVE_STOP, now)
        aborts = phase is MissionPhase.ABORTED
        # A descent that is still on the way to its first stop is in standby.
        if observed.descent_busy or (aborts and observed.descent == DescentPhase.HOLDING):
            return call(topics.DESCENT_ABORT if aborts else topics.DESCENT_HOLD, now)
        if not observed.descent_engaged and observed.winch_moving:
            return call(topics.WINCH_HOLD, now)
        if not observed.spring_compressed and not observed.in_flight:
            self._is_at_rest = True
            self._changes.append(EventReport(MissionEvent.AT_REST, f"at rest, {phase}"))
        return ()
