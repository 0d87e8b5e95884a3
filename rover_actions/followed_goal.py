"""A goal of an action: the command that it becomes, and the record that ends it. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from msg_schemas import machine
from msg_schemas.access import Act, node_that, nodes_that
from msg_schemas.actions import ActionSpecification
from msg_schemas.commands import CommandRecord, CommandState, split_name
from msg_schemas.samples import JointSample, JointValue, PoseSample, Sample

UNANSWERED = 5.0
"""Time without a record after which a goal has failed [s]."""

_LAG_NS = 100_000_000  # of a node's clock behind the caller's [ns]


def _descend(goal: Any, _stamp_ns: int) -> Sample:
    joint = machine.OBSERVATION_STOP if goal.observe else machine.PLAIN_STOP
    return JointSample(0, {joint: JointValue(goal.depth, goal.rate)})


def _turn(goal: Any, _stamp_ns: int) -> Sample:
    return JointSample(0, {machine.HEADING_TURN: JointValue(goal.angle)})


def _drive(goal: Any, stamp_ns: int) -> Sample:
    position = (goal.position.x, goal.position.y, goal.position.z)
    if not goal.with_heading:
        return PoseSample(stamp_ns, position)
    half = 0.5 * goal.heading
    sine, cosine = (math.sin(half), math.cos(half)) if math.isfinite(half) else (math.nan, math.nan)
    return PoseSample(stamp_ns, position, (0.0, 0.0, sine, cosine))


def _jump(goal: Any, _stamp_ns: int) -> Sample:
    return JointSample(0, {machine.JUMP_STROKE: JointValue(goal.stroke, goal.speed)})


REQUESTS: Mapping[str, Callable[[Any, int], Sample]] = {
    "descend": _descend,
    "turn": _turn,
    "drive": _drive,
    "jump": _jump,
}
"""Makes the request of a goal, stamped [ns] where the topic has a frame; a mission's is a call."""


def executing_node(action: ActionSpecification) -> str:
    """Return the node that executes an action's goals."""
    if action.name in REQUESTS:
        return nodes_that(Act.SUBSCRIBE, action.command)[0]
    return node_that(Act.SERVE, action.command)


@dataclass(frozen=True)
class GoalEnd:
    """How a goal ended.

    Attributes:
        state: last state of its record.
        reason: code of a refusal, or why it ended.
        text: the same for people.
        values: of the event that ended it.
    """

    state: CommandState
    reason: str
    text: str
    values: Mapping[str, str] = field(default_factory=dict)


class FollowedGoal:
    """Finds the record of a goal's command, and follows it.

    Args:
        action: of the goal.
        name: sender and identifier that the request carries, as in its `frame_id`; a request in a
            frame has the stamp only. Empty: of a call.
        after_ns: time of the call by the clock [ns].
        known: keys of the records before the call.

    Attributes:
        record: the latest record; None until the node has answered.
        end: how it ended; None while it goes on.
    """

    def __init__(
        self,
        action: ActionSpecification,
        name: str = "",
        after_ns: int = 0,
        known: Collection[tuple[str, str, str, str, int]] = (),
    ) -> None:
        self.action = action
        self.node = executing_node(action)
        self._name = split_name(name) if name else None
        self._after_ns = after_ns
        self._known = frozenset(known)
        self.record: CommandRecord | None = None
        self.end: GoalEnd | None = None

    def on_record(self, record: CommandRecord) -> bool:
        """Process a record of any command; returns whether it is a change of this goal's."""
        if self.end is not None or not self._is_own(record):
            return False
        self.record = record
        if record.state.is_over:
            reason = "" if record.reason is None else record.reason.value
            self.end = GoalEnd(record.state, reason, record.text, record.result)
        return True

    def _is_own(self, record: CommandRecord) -> bool:
        if record.node != self.node or record.subject != self.action.command:
            return False
        if self.record is not None:
            return record.key == self.record.key
        if self._name is not None:
            return (record.sender, record.identifier) == self._name
        return record.key not in self._known and record.taken_ns >= self._after_ns - _LAG_NS

    def fail(self, state: CommandState, reason: str, text: str) -> None:
        """End the goal without its record."""
        if self.end is None:
            self.end = GoalEnd(state, reason, text)
