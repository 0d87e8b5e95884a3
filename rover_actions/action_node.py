"""The ``action_node`` executable: offers actions, and executes their goals by commands.

It is a thin adapter. A goal becomes a request or a call of the contract, as an operator sends it;
the record of that command on `commands` becomes feedback and result. The nodes that execute it know
nothing of actions. In a lockstep it is no member: time does not wait for it, it follows the clock.
"""

from __future__ import annotations

import secrets
import sys
from functools import partial
from typing import Any

from diagnostic_msgs.msg import KeyValue
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.task import Future

from msg_schemas import topics
from msg_schemas.access import Act, check_access
from msg_schemas.actions import ACTIONS, INTERFACES, ActionSpecification
from msg_schemas.cdr import pack
from msg_schemas.commands import CommandRecord, CommandState, CommandTable, read_command
from msg_schemas.events import NodeEvent
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, PoseSample, Sample, StatusSample
from rover_actions.followed_goal import REQUESTS, UNANSWERED, FollowedGoal
from rover_runtime.component import Publisher
from rover_runtime.ros.interface_packages import InterfacesMissing, load_interfaces
from rover_runtime.ros.node import RosComponent
from rover_runtime.ros.process import run

NO_ACTIONS = "no actions: {}; topics and services work without them"
_CHECK_PERIOD = 0.1  # [s]
_LOOK_PERIOD = 2.0  # at the graph, for a node that has gone [s]
_STAMP_SPREAD_NS = 1_000_000  # so that requests of one tick have stamps of their own
_NANO = 1e9


class _Goal:
    """A goal that is executed: rclpy's handle, and the command that it became."""

    def __init__(self, handle: Any, followed: FollowedGoal, over: Any, since_ns: int) -> None:
        self.handle = handle
        self.followed = followed
        self.over = over  # future; set when it has ended
        self.since_ns = since_ns  # steady time of its arrival
        self.request: Sample | None = None  # that waits for its node
        self.identifier = ""


class ActionNode(RosComponent):
    """Offers the actions of the contract."""

    NAME = "action_node"
    _servers: tuple[ActionServer, ...] = ()

    def setup(self) -> None:
        """Open topics and actions; without the interface package, log a warning and offer none."""
        self._goals: list[_Goal] = []
        self._known = CommandTable(200)
        self._looked_ns = 0
        try:
            self._types = load_interfaces(
                INTERFACES,
                "action",
                lambda text: self.port.log(Level.OK, text),
                self.check_shutdown,
            )
        except InterfacesMissing as error:
            self.port.log(Level.WARN, NO_ACTIONS.format(error))
            return
        self._publishers: dict[str, Publisher] = {
            name: self.publisher(ACTIONS[name].command) for name in REQUESTS
        }
        self.subscribe(topics.COMMANDS, self._on_commands, depth=200)
        self.subscribe(topics.EVENTS, self._on_events, depth=200)
        for action in ACTIONS.values():
            self._serve_action(action)

    def start(self) -> None:
        """Watch for nodes that do not answer, or have gone."""
        self.every(_CHECK_PERIOD, self._check, by_wall_clock=True)

    def stop(self) -> None:
        """End all goals; their commands go on."""
        for goal in tuple(self._goals):
            text = f"{self.NAME} stops; the command goes on"
            goal.followed.fail(CommandState.FAILED, Reason.SHUTDOWN.value, text)
            self._end(goal)

    def release(self) -> None:
        """Close the actions."""
        for server in self._servers:
            server.destroy()
        self._servers = ()

    # --- actions ---------------------------------------------------------------------------------

    def _serve_action(self, action: ActionSpecification) -> None:
        check_access(self.NAME, Act.EXECUTE, action.name)

        def answer_goal(_goal: Any) -> GoalResponse:
            return GoalResponse.ACCEPT if self.active else GoalResponse.REJECT

        def answer_cancel(_handle: Any) -> CancelResponse:
            return CancelResponse.ACCEPT if self._hold(action) else CancelResponse.REJECT

        server = ActionServer(
            self.ros,
            getattr(self._types, action.action.rpartition("/")[2]),
            action.name,
            execute_callback=partial(self._execute, action),
            goal_callback=answer_goal,
            cancel_callback=answer_cancel,
        )
        self._servers = (*self._servers, server)

    def _hold(self, action: ActionSpecification) -> bool:
        """Hold what the action does; returns whether the node is there."""

        def on_answer(success: bool, text: str) -> None:
            if not success:
                self.port.log(Level.WARN, f"{action.hold} has refused to cancel: {text}")

        return self.call_service(action.hold, on_answer)

    async def _execute(self, action: ActionSpecification, handle: Any) -> Any:
        """Send the command of a goal, and return the goal's result at its end."""
        result = getattr(self._types, action.action.rpartition("/")[2]).Result()
        goal = self._begin(action, handle, Future(executor=self.ros.executor))
        if goal.followed.end is None:
            self._goals.append(goal)
            await goal.over
        end = goal.followed.end
        assert end is not None
        if end.state is CommandState.DONE:
            handle.succeed()
        elif handle.is_cancel_requested and end.state is CommandState.SUPERSEDED:
            handle.canceled()
        else:
            handle.abort()
        result.state, result.reason, result.text = end.state.value, end.reason, end.text
        result.values = _key_values(end.values)
        return result

    def _begin(self, action: ActionSpecification, handle: Any, over: Any) -> _Goal:
        steady_ns = self.port.steady_ns()
        identifier = bytes(handle.goal_id.uuid).hex()[:8]
        if action.name not in REQUESTS:
            known = {record.key for record, _ in self._known}
            followed = FollowedGoal(action, "", self.now_ns(), known)
            goal = _Goal(handle, followed, over, steady_ns)
            if not self.call_service(action.command, lambda _success, _text: None):
                self._refuse(goal, RefusalCode.NOT_ACTIVE, f"{followed.node} does not run")
            return goal
        stamp_ns = self.now_ns() + secrets.randbelow(_STAMP_SPREAD_NS)
        sample = REQUESTS[action.name](handle.request, stamp_ns)
        is_in_frame = isinstance(sample, PoseSample)
        name = f"#{stamp_ns}" if is_in_frame else f"{self.full_name}#{identifier}"
        goal = _Goal(handle, FollowedGoal(action, name), over, steady_ns)
        goal.request, goal.identifier = sample, "" if is_in_frame else identifier
        try:
            pack(action.command, sample, "" if is_in_frame else name)
        except Refusal as refusal:
            self._refuse(goal, refusal.code, refusal.reason)
            return goal
        self._send(goal)
        return goal

    def _refuse(self, goal: _Goal, code: RefusalCode, text: str) -> None:
        goal.followed.fail(CommandState.REFUSED, code.value, text)

    def _send(self, goal: _Goal) -> None:
        """Send a request as soon as its node has discovered this one."""
        if goal.request is None:
            return
        publisher = self._publishers[goal.followed.action.name]
        if publisher.has_subscribers:
            publisher.send(goal.request, goal.identifier)
            goal.request = None

    # --- what becomes of the commands ------------------------------------------------------------

    def _on_commands(self, sample: StatusSample) -> None:
        for status in sample.statuses:
            record = read_command(status)
            if record is None:
                continue
            self._known.on_record(record, sample.stamp_ns)
            for goal in self._followers(record):
                if goal.followed.on_record(record):
                    self._report(goal)
                    break

    def _followers(self, record: CommandRecord) -> tuple[_Goal, ...]:
        """Return the goal of a record, or those that may find theirs in it."""
        records = ((goal, goal.followed.record) for goal in self._goals)
        owners = tuple(goal for goal, own in records if own is not None and own.key == record.key)
        return owners or tuple(self._goals)

    def _on_events(self, sample: StatusSample) -> None:
        for status in sample.statuses:
            if status.name != NodeEvent.ACTIVE:
                continue
            for goal in tuple(self._goals):
                followed = goal.followed
                if followed.node == status.hardware_id and followed.record is not None:
                    text = f"{followed.node} has started again"
                    followed.fail(CommandState.FAILED, Reason.RESTARTED.value, text)
                    self._end(goal)

    def _report(self, goal: _Goal) -> None:
        record = goal.followed.record
        assert record is not None
        if goal.followed.end is not None:
            self._end(goal)
            return
        kind = goal.followed.action.action.rpartition("/")[2]
        feedback = getattr(self._types, kind).Feedback()
        feedback.text = record.text or record.state.value
        feedback.progress = record.progress
        goal.handle.publish_feedback(feedback)

    def _end(self, goal: _Goal) -> None:
        self._goals.remove(goal)
        goal.over.set_result(None)

    def _check(self) -> None:
        now_ns = self.port.steady_ns()
        for goal in tuple(self._goals):
            self._send(goal)
            followed = goal.followed
            if followed.record is None and now_ns - goal.since_ns > UNANSWERED * _NANO:
                text = f"{followed.node} has not answered within {UNANSWERED:g} s: does it run?"
                followed.fail(CommandState.REFUSED, RefusalCode.NOT_ACTIVE.value, text)
                self._end(goal)
        if self._goals and now_ns - self._looked_ns > _LOOK_PERIOD * _NANO:
            self._looked_ns = now_ns
            self._end_lost_goals()

    def _end_lost_goals(self) -> None:
        """End the goals of nodes that have left the graph."""
        here = self.ros.get_namespace()
        there = set(self.ros.get_node_names_and_namespaces())
        for goal in tuple(self._goals):
            node = goal.followed.node
            if goal.followed.record is not None and (node, here) not in there:
                text = f"{node} does not run any more"
                goal.followed.fail(CommandState.FAILED, Reason.SHUTDOWN.value, text)
                self._end(goal)


def _key_values(values: Any) -> list[Any]:
    return [KeyValue(key=key, value=value) for key, value in values.items()]


def main() -> int:
    """Run the node."""
    return run(ActionNode)


if __name__ == "__main__":
    sys.exit(main())
