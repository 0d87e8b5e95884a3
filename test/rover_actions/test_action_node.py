"""Actions over DDS: goals of a plain client become commands; their records become the results."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from msg_schemas import machine, topics
from msg_schemas.actions import ACTIONS, INTERFACES
from msg_schemas.commands import CommandState
from msg_schemas.phases import MissionPhase
from rover_launch.plan import ACTIONS as ACTIONS_ARGUMENT
from rover_launch.plan import HANGING_DEFAULTS, MOCK

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer
    from rover_verify.harness.launching import Launched

pytestmark = [pytest.mark.ros, pytest.mark.process]

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
START = 8.0  # [m]
NODES = ("winch_node", "descent_node", "drive_node", "jump_node", "mission_node")


class Client:
    """A client of all actions, whose node spins in the thread of the test.

    In another thread an answer may arrive before rclpy expects it.
    """

    def __init__(self, observer: Observer) -> None:
        import rclpy
        from rclpy.action.client import ActionClient
        from rclpy.executors import SingleThreadedExecutor

        from rover_runtime.ros.interface_packages import load_interfaces

        self.observer = observer
        context = observer.node.context
        self._node = rclpy.create_node("client", context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self.types = load_interfaces(INTERFACES, "action", print)
        self._clients = {
            name: ActionClient(self._node, getattr(self.types, name.capitalize()), name)
            for name in ACTIONS
        }
        self.feedback: list[Any] = []

    def send(self, name: str, **values: object) -> Any:
        """Send a goal and return its handle."""
        client = self._clients[name]
        assert client.wait_for_server(20.0)
        goal = getattr(self.types, name.capitalize()).Goal(**values)
        handle = self.done(client.send_goal_async(goal, feedback_callback=self._on_feedback))
        assert handle.accepted
        return handle

    def _on_feedback(self, message: Any) -> None:
        self.feedback.append(message.feedback)

    def done(self, future: Any, timeout: float = 120.0) -> Any:
        """Spin until a future is done, and return its result."""
        self._executor.spin_until_future_complete(future, timeout)
        assert future.done(), "no answer"
        return future.result()

    def ended(self, handle: Any) -> tuple[int, Any]:
        """Return status and result of a goal at its end."""
        answer = self.done(handle.get_result_async())
        return answer.status, answer.result

    def close(self) -> None:
        for client in self._clients.values():
            client.destroy()
        self._executor.shutdown()
        self._node.destroy_node()


def launch(harness: NodeHarness, nodes: Sequence[str], **given: str) -> Launched:
    """Launch the mock machine with nodes and actions, and arm its winch."""
    from rover_runtime.ros.interface_packages import load_interfaces
    from rover_verify.harness.launching import Launched, arm_winch

    # The first time it takes longer than a node may take to be ready.
    load_interfaces(INTERFACES, "action", print)
    overrides = json.loads(HANGING_DEFAULTS["overrides"]) | {"tether.length": START}
    arguments = {
        "plant": MOCK,
        "overrides": json.dumps(overrides),
        "frames": "false",
        ACTIONS_ARGUMENT: "true",
    }
    launched = Launched(harness, nodes, arguments | given)
    shown = (topics.WINCH_STATE, topics.WINCH_MODE, topics.MISSION_PHASE, topics.CLOCK)
    for name in (*shown, topics.COMMANDS):
        launched.observer.listen(name)
    launched.wait_until_ready()
    arm_winch(launched.observer)
    return launched


@pytest.fixture(scope="module")
def client(shared_harness: NodeHarness) -> Iterator[Client]:
    """The mock machine with all controllers in lockstep, armed, and a client of its actions."""
    made = Client(launch(shared_harness, NODES, real_time_factor="4").observer)
    yield made
    made.close()


def resting_length(client: Client) -> float:
    """Length [m] at which the drum stands with its brake closed, after a result has arrived.

    A result may overtake the states that precede it.
    """
    states = client.observer.listen(topics.WINCH_STATE)
    at_rest = states.wait(
        lambda s: (
            s.joints[machine.WINCH_DRUM].velocity == 0.0 == s.joints[machine.WINCH_BRAKE].position
        ),
        len(states),
    )
    return float(at_rest.joints[machine.WINCH_DRUM].position)


def test_a_descent_reports_its_course_and_ends_with_its_record(client: Client):
    from action_msgs.msg import GoalStatus

    handle = client.send("descend", depth=START + 0.6, rate=0.1)
    status, result = client.ended(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED, result
    assert (result.state, result.reason) == ("done", "completed")
    assert client.feedback
    assert all(each.text for each in client.feedback)
    progress = [each.progress for each in client.feedback if each.progress >= 0.0]
    assert progress == sorted(progress)
    assert resting_length(client) == pytest.approx(START + 0.6, abs=0.1)
    record = client.observer.wait_for_command(topics.DESCENT_REQUEST, CommandState.DONE)
    assert record.sender == "/action_node"
    assert {each.key: each.value for each in result.values} == dict(record.result)


def test_a_cancel_holds_the_rover(client: Client):
    from action_msgs.msg import GoalStatus

    handle = client.send("descend", depth=START + 8.0, rate=0.1)
    states = client.observer.listen(topics.WINCH_STATE)
    states.wait(lambda s: s.joints[machine.WINCH_DRUM].velocity > 0.05, len(states))
    assert client.done(handle.cancel_goal_async()).goals_canceling
    status, result = client.ended(handle)
    assert status == GoalStatus.STATUS_CANCELED, result
    assert result.state == "superseded"
    assert resting_length(client) < START + 7.0
    # The held stop can be resumed; until then, or an abort, others are refused.
    status, result = client.ended(client.send("descend", depth=START + 1.0))
    assert (result.state, result.reason) == ("refused", "wrong_phase")
    assert "resume it first" in result.text
    assert client.observer.call(topics.DESCENT_ABORT).success


def test_the_tutorials_lower_the_rover(client: Client, shared_harness: NodeHarness):
    before = client.observer.listen(topics.WINCH_STATE).last.joints[machine.WINCH_DRUM].position
    for number, name in enumerate(("lower_by_action", "lower_by_topics")):
        depth = before + 0.3 * (number + 1)
        process = shared_harness.processes.start(
            name, None, str(depth), extra_environment={"PYTHONPATH": str(TUTORIALS)}
        )
        assert process.wait() == 0, process.output
        assert "done: depth reached" in process.output
        assert resting_length(client) == pytest.approx(depth, abs=0.1)


def test_a_cancelled_tutorial_holds(client: Client, shared_harness: NodeHarness):
    states = client.observer.listen(topics.WINCH_STATE)
    depth = states.last.joints[machine.WINCH_DRUM].position + 8.0
    process = shared_harness.processes.start(
        "lower_by_action", None, str(depth), extra_environment={"PYTHONPATH": str(TUTORIALS)}
    )
    states.wait(lambda s: s.joints[machine.WINCH_DRUM].velocity > 0.02, len(states))
    process.send_to_group(signal.SIGINT)
    assert process.wait() == 0, process.output
    assert "superseded: " in process.output
    assert resting_length(client) < depth - 1.0
    assert client.observer.call(topics.DESCENT_ABORT).success


@pytest.mark.parametrize(
    ("name", "values", "reason", "text"),
    [
        ("descend", {"depth": 1.0e6}, "out_of_limits", "position is 1000000.0 m"),
        ("descend", {"depth": float("nan")}, "not_finite", "nan"),
        ("turn", {"angle": 9.0}, "out_of_limits", "9.0 rad"),
        ("jump", {"stroke": 0.1}, "wrong_phase", ""),
        ("drive", {}, "wrong_phase", ""),
        ("drive", {"with_heading": True, "heading": float("inf")}, "not_finite", ""),
    ],
)
def test_a_refused_goal_states_the_reason(
    client: Client, name: str, values: dict[str, object], reason: str, text: str
):
    from action_msgs.msg import GoalStatus

    status, result = client.ended(client.send(name, **values))
    assert status == GoalStatus.STATUS_ABORTED
    assert (result.state, result.reason) == ("refused", reason), result
    assert text in result.text
    assert result.text


def test_a_mission_that_is_held_and_aborted_ends_its_goal(client: Client):
    from action_msgs.msg import GoalStatus

    observer = client.observer
    handle = client.send("mission")
    observer.wait_for_command(topics.MISSION_GO, CommandState.RUNNING)
    observer.wait_for_time(observer.time_ns() + 2_000_000_000)
    assert client.done(handle.cancel_goal_async()).goals_canceling
    observer.wait_for_text(topics.MISSION_PHASE, MissionPhase.HOLDING)
    assert observer.call(topics.MISSION_ABORT).success
    status, result = client.ended(handle)
    assert status == GoalStatus.STATUS_CANCELED, result
    assert result.state == "superseded"


def test_each_of_two_goals_has_the_record_of_its_own_call(client: Client):
    first, second = client.send("mission"), client.send("mission")
    status, result = client.ended(second)
    assert (result.state, result.reason) == ("refused", "wrong_phase")
    client.observer.wait_for_command(topics.MISSION_GO, CommandState.RUNNING)
    assert client.observer.call(topics.MISSION_ABORT).success
    status, result = client.ended(first)
    assert result.state == "superseded", (status, result)


def test_a_client_gets_the_result_of_a_goal_whose_action_server_ends(harness: NodeHarness):
    launched = launch(harness, ("winch_node", "descent_node"), composed="false")
    client = Client(launched.observer)
    answer = client.send("descend", depth=START + 8.0).get_result_async()
    client.observer.wait_for_command(topics.DESCENT_REQUEST, CommandState.RUNNING)
    launched.processes["action_node"].send(signal.SIGTERM)
    assert client.done(answer).result.reason == "shutdown"
    client.close()


def test_it_ends_cleanly_before_it_is_configured(harness: NodeHarness):
    observer = harness.observer()
    process = harness.processes.start("rover_actions.action_node", {"autostart": False})
    observer.wait_for_status(topics.DIAGNOSTICS, lambda s: s.hardware_id == "action_node")
    assert process.stop() == 0, process.output


def test_a_goal_ends_when_its_node_has_gone(harness: NodeHarness):
    """Last: the nodes of this test are its own."""
    from action_msgs.msg import GoalStatus

    launched = launch(harness, ("winch_node", "descent_node"), composed="false")
    client = Client(launched.observer)
    # Nobody flies missions here.
    status, result = client.ended(client.send("mission"))
    assert status == GoalStatus.STATUS_ABORTED
    assert (result.state, result.reason) == ("refused", "not_active")
    assert result.text == "mission_node does not run"
    handle = client.send("descend", depth=START + 8.0)
    launched.observer.wait_for_command(topics.DESCENT_REQUEST, CommandState.RUNNING)
    launched.processes["descent_node"].stop(signal.SIGKILL)
    status, result = client.ended(handle)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.state == "failed"
    assert result.text == "descent_node does not run any more"
    client.close()


def test_without_a_compiler_it_reports_that_once_and_goes_on(harness: NodeHarness, tmp_path: Path):
    bare = {"PATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    observer = harness.observer()
    process = harness.processes.start("rover_actions.action_node", extra_environment=bare)
    observer.wait_until_ready("action_node")
    assert process.output.count("no actions: mother_rover_interfaces cannot be built") == 1
    assert "install gcc and g++" in process.output
    assert process.stop() == 0
