"""No message from outside ends a process: what rclpy or the lockstep cannot read is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String, UInt8MultiArray

from msg_schemas import topics
from msg_schemas.refusal import read_refusal
from rover_runtime.lockstep import Release, Report
from rover_runtime.remote import Sent
from rover_runtime.ros.lockstep import ALIVE, RELEASES

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

    Running = tuple[Process, Observer]

pytestmark = [pytest.mark.ros, pytest.mark.process]

NODE = "shell_node"
PLANT = "mock_plant"
LOCKSTEP = {"use_sim_time": True, "lockstep": f"{PLANT},{NODE}"}


def start(harness: NodeHarness, parameters: dict[str, Any]) -> Iterator[Running]:
    process = harness.processes.start(NODE, parameters)
    plant = None
    if parameters is LOCKSTEP:
        shared = {"lockstep": LOCKSTEP["lockstep"]}
        plant = harness.processes.start("rover_sim.node.mock_plant_node", shared)
    observer = harness.observer()
    assert observer.state_of(NODE) == "active"
    yield process, observer
    assert process.stop() == 0
    assert "Traceback" not in process.output
    assert plant is None or plant.stop() == 0
    observer.close()


@pytest.fixture(
    scope="module",
    params=[{}, {"use_sim_time": True}, LOCKSTEP],
    ids=["time of day", "simulated time", "lockstep"],
)
def running(shared_harness: NodeHarness, request: pytest.FixtureRequest):
    yield from start(shared_harness, request.param)


def parameter(kind: int) -> Parameter:
    return Parameter(name="rate", value=ParameterValue(type=kind))


@pytest.mark.parametrize("kind", [10, 77, 255])
def test_a_parameter_of_an_unknown_type_is_refused(running: Running, kind: int):
    process, observer = running
    request = SetParameters.Request(parameters=[parameter(kind)])
    answer = observer.request(SetParameters, f"{NODE}/set_parameters", request)
    assert not [each for each in answer.results if each.successful]
    process.wait_for_output(f"refused {NODE}/set_parameters: .*{kind} is not a valid")
    atomically = SetParametersAtomically.Request(parameters=[parameter(kind)])
    name = f"{NODE}/set_parameters_atomically"
    assert not observer.request(SetParametersAtomically, name, atomically).result.successful


@pytest.mark.parametrize("transition", [0, 2, 60, 250])
def test_an_unknown_transition_is_refused(running: Running, transition: int):
    process, observer = running
    request = ChangeState.Request(transition=Transition(id=transition))
    assert not observer.request(ChangeState, f"{NODE}/change_state", request).success
    process.wait_for_output(f"refused /{NODE}/change_state")
    assert observer.state_of(NODE) == "active"


@pytest.mark.parametrize("seconds", [-1, -(2**31)])
def test_a_time_before_zero_is_refused(running: Running, seconds: int):
    process, observer = running
    publisher = observer.node.create_publisher(Clock, topics.CLOCK, 1)
    if not observer.get_parameter(NODE, "use_sim_time"):
        return
    message = Clock()
    message.clock.sec = seconds

    def is_refused() -> bool:
        publisher.publish(message)
        assert process.is_running, process.output
        return f"refused {topics.CLOCK}" in process.output

    observer.wait_until(is_refused, f"{topics.CLOCK} was not refused")
    assert observer.state_of(NODE) == "active"


def release(report: bytes) -> bytes:
    return Release(0, 0, {NODE: 0, PLANT: 0}, {PLANT: report}).to_bytes()


BAD_SIGNS = [
    "", "{", "[]", "7", '"mock_plant"', "[" * 3000, '{"process": {}}', '{"process": "mock_plant"}',
    json.dumps({"process": PLANT, "publishes": {"a": []}, "subscribes": 1, "serves": 2}),
]  # fmt: skip
BAD_RELEASES = [
    b"", b"\5", b"\xff" * 20, b"\2\0\0\0[]", b"\2\0\0\0{}", b'\x11\0\0\0[[1],{},["a"],[3]]',
    release(b"\2\0\0\0[]"),
    release(Report(PLANT, 0, [(Sent("no_topic", PLANT, 0, 1), b"")]).to_bytes()),
]  # fmt: skip
BAD_BYTES = [b"\0\1\0\0\5\0\0\0\xff\xfe\xfd\xfc\0", b"\0\1\0\0\xff\xff\xff\x7f"]
BAD_LOCKSTEP = [
    *((String, ALIVE, String(data=text)) for text in BAD_SIGNS),
    *((String, ALIVE, data) for data in BAD_BYTES),
    *((UInt8MultiArray, RELEASES, UInt8MultiArray(data=data)) for data in BAD_RELEASES),
]


def reasons(observer: Observer, topic: str) -> set[str]:
    """Why messages of a topic were refused so far."""
    samples = observer.listen(topics.DIAGNOSTICS).samples
    refusals = [read_refusal(status) for sample in samples for status in sample.statuses]
    return {
        each.reason.rpartition("the last one: ")[2]
        for each in refusals
        if each is not None and (each.subject, each.code) == (topic, "malformed")
    }


def is_refused_anew(observer: Observer, publisher: Any, message: Any, known: set[str]) -> bool:
    publisher.publish(message)  # again each time, as a release may be lost
    return reasons(observer, publisher.topic_name.lstrip("/")) > known


def test_what_is_no_message_of_the_lockstep_is_refused(harness: NodeHarness):
    for process, observer in start(harness, LOCKSTEP):
        # None is destroyed: the observer's executor, in another thread, may be waiting for it.
        publishers = {
            topic: observer.node.create_publisher(kind, topic, 10)
            for kind, topic in {(kind, topic) for kind, topic, _ in BAD_LOCKSTEP}
        }
        for _, topic, message in BAD_LOCKSTEP:
            publisher = publishers[topic]
            known = reasons(observer, topic)
            refused = partial(is_refused_anew, observer, publisher, message, known)
            observer.wait_until(refused, f"{topic}: {message} is not refused")
            assert process.is_running
