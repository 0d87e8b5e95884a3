"""What a process in lockstep takes from the others, and what it logs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from msg_schemas import topics
from msg_schemas.samples import Level
from rover_runtime.component import Component, ExitCode
from rover_runtime.ros import lockstep
from rover_runtime.ros.lockstep import LockstepCarrier

pytestmark = pytest.mark.ros

PROCESSES = {"mock_plant": ("mock_plant",), "nodes": ("jump_node",)}


class JumpNode(Component):
    """A component in the process of the test."""

    NAME = "jump_node"


class Carried:
    """A carrier, the wall clock, and what it has logged."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self.lines: list[str] = []
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        self.carrier = LockstepCarrier(PROCESSES, "nodes", 1, "", "token")
        self.node = Mock()
        monkeypatch.setattr(self.carrier, "_open_shared", lambda _node: None)
        self.component = self.carrier.add(self.node, JumpNode, {}, self._log)

    def _log(self, _level: Level, text: str) -> None:
        self.lines.append(text)

    def receive(self, **changes: Any) -> None:
        self.carrier._on_alive(sign_of_life(**changes))


@pytest.fixture
def carried(monkeypatch: pytest.MonkeyPatch) -> Iterator[Carried]:
    made = Carried(monkeypatch)
    yield made
    made.carrier.host.worker.close()


def sign_of_life(**changes: Any) -> Any:
    content = {
        "process": "mock_plant", "token": "a", "node": "mock_plant", "has_source": True,
        "is_ready": True, "is_member": False, "leaves": False, "publishes": {},
        "subscribes": [], "serves": [],
    }  # fmt: skip
    return serialize_message(String(data=json.dumps(content | changes)))


def test_a_computation_that_time_waits_for_is_logged_with_its_duration(
    carried: Carried, monkeypatch: pytest.MonkeyPatch
):
    computing = True
    monkeypatch.setattr(carried.carrier.process, "computing", lambda: ("jump_node",) * computing)
    for at, late in ((110, 0), (112, 1), (116, 1), (117, 1), (122, 1), (123, 0), (127, 1)):
        carried.now, computing = float(at), bool(late)
        carried.carrier._log_waiting()
    assert [line.split(" for ")[1] for line in carried.lines] == ["6 s", "12 s"]


def test_the_source_of_time_logs_whom_it_waits_for(
    carried: Carried, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(type(carried.carrier.host), "has_source", True)
    for _ in range(8):
        carried.carrier._log_waiting()
        carried.now += 1.0
    assert carried.lines == ["simulated time has waited for 6 s for mock_plant to join"]
    carried.receive(has_source=False)
    carried.now += 6.0
    carried.carrier._log_waiting()
    assert len(carried.lines) == 1


@pytest.mark.parametrize("changes", [
    {"publishes": {topics.WINCH_STATE: float("inf")}}, {"publishes": []},
    {"publishes": {"a": None}}, {"subscribes": 3}, {"serves": None},
])  # fmt: skip
def test_what_is_no_sign_of_life_is_refused(carried: Carried, changes: dict[str, Any]):
    with pytest.raises(ValueError, match="is no sign of life"):
        carried.receive(**changes)
    carried.receive(node=["a"], token={})
    assert carried.carrier._peers["mock_plant"].node == "['a']"


def test_a_name_in_use_is_not_taken_over(carried: Carried):
    for token, later, expected in (("a", 0.2, "a"), ("b", 0.5, "a"), ("b", 0.0, "b")):
        carried.receive(token=token)
        carried.now += later
        assert carried.carrier._peers["mock_plant"].token == expected
    carried.receive(token="b", leaves=True)
    carried.receive(token="c")
    assert carried.carrier._peers["mock_plant"].token == "c"


def test_a_second_process_of_a_name_ends(carried: Carried):
    for _ in range(10):
        carried.receive(process="nodes", token="token", is_member=True)  # its own
        carried.receive(process="nodes", token="other", is_member=False)
    assert carried.component.exit_code is None
    for _ in range(2 * lockstep._NAMESAKE_SIGNS):
        carried.receive(process="nodes", token="other", is_member=True)
    assert carried.component.exit_code is ExitCode.BAD_CONFIGURATION
    (line,) = carried.lines
    assert "another process nodes runs in lockstep already" in line


def test_messages_from_outside_are_received_once_their_node_has_ended(carried: Carried):
    topic = topics.WINCH_STATE
    carried.receive(publishes={topic: 1})
    carried.carrier._subscribers[topic] = carried.node
    carried.node.count_publishers.return_value = 1
    carried.carrier.process.members = {"nodes": 0, "mock_plant": 0}
    carried.carrier._look_outside()
    assert not carried.carrier.is_watched(topic)
    carried.carrier.process.members = {"nodes": 0}
    carried.carrier._look_outside()
    assert carried.carrier.is_watched(topic)
