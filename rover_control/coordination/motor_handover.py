"""Handover of a motor between the controllers that may drive it. Pure.

The jump motor drives nut and flywheel, for `jump_node` and `descent_node`; `drive_node` and
`descent_node` drive the wheels. A drive refuses commands of another source until its owner's
commands have timed out. So a controller announces by its phase that it uses its motors, and in any
other phase sends no command. While another one uses a motor, and for `HANDOVER_TIME` after, it
sends none to this motor.
"""

from __future__ import annotations

import math

from msg_schemas import topics
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase
from msg_schemas.table import TOPICS

_TRANSPORT = 0.25  # longest time that a last command may be under way [s]
HANDOVER_TIME = _TRANSPORT + max(topic.stale.timeout for topic in TOPICS.values() if topic.owned)
"""From the phase by which a controller releases its motors to the first command of another [s]."""

_RELEASED = {
    topics.DESCENT_PHASE: frozenset({"", DescentPhase.RELEASED}),
    topics.DRIVE_PHASE: frozenset({"", *(phase for phase in DrivePhase if phase.is_over)}),
    topics.JUMP_PHASE: frozenset({"", *(phase for phase in JumpPhase if not phase.uses_motor)}),
}


class MotorHandover:
    """Whether the other controllers leave a motor to this one."""

    def __init__(self) -> None:
        self._phases: dict[str, str] = {}
        self._free_at = -math.inf  # [s]

    def on_phase(self, topic: str, phase: str, now: float) -> None:
        """Process the phase of another controller.

        Args:
            topic: of the phase.
            phase: its word; empty = unknown.
            now: time [s].
        """
        was_used = self.is_used_by(topic)
        self._phases[topic] = phase
        if was_used and not self.is_used_by(topic):
            self._free_at = now + HANDOVER_TIME

    def is_used_by(self, topic: str) -> bool:
        """Whether the controller that publishes its phase on a topic uses the motor."""
        return self._phases.get(topic, "") not in _RELEASED[topic]

    def may_command(self, now: float, claimed_at: float = math.inf) -> bool:
        """Whether this controller may command the motor at a time [s].

        Args:
            now: time [s].
            claimed_at: when it announced a use before which the others retreat [s].
        """
        is_free = now >= self._free_at and not any(map(self.is_used_by, self._phases))
        return is_free or now - claimed_at >= HANDOVER_TIME

    def clock_jumped(self) -> None:
        """Forget times, because the clock has gone back."""
        self._free_at = -math.inf
