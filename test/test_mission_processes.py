"""Processes of launch files, started as those say, in a namespace, with the mock plant."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import architecture
import pytest

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, PlantEvent
from msg_schemas.phases import JumpPhase
from rover_launch.plan import arguments_of, plan

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer

pytestmark = [pytest.mark.ros, pytest.mark.process]

ROOT = Path(__file__).parents[1]
NAMESPACE = "rover7"
OWN_CLOCK = {topics.CLOCK: topics.CLOCK.strip("/")}
MOCK = {"plant": "mock", "namespace": NAMESPACE}


def start(harness: NodeHarness, *controllers: str, **given: str) -> Observer:
    """Start what a launch file with these controllers starts; returns who hears it when ready."""
    arguments = arguments_of(controllers, str(ROOT / "config"), {})
    values = {each.name: each.default for each in arguments} | MOCK | given
    modules = architecture.executables(ROOT)
    observer = harness.observer(NAMESPACE, OWN_CLOCK)
    for each in plan(controllers, values).started:
        files = [part for file in each.files for part in ("--params-file", file)]
        harness.processes.start(
            modules[each.executable].partition(":")[0],
            each.parameters,
            *each.arguments,
            "--ros-args",
            *files,
            "--",
            namespace=NAMESPACE,
            remap=OWN_CLOCK,
        )
    for name in controllers:
        observer.wait_until_ready(name)
    return observer


def test_a_jump_of_the_mock_plant_goes_through_its_phases(harness: NodeHarness):
    observer = start(harness, "jump_node", overrides='{"tether.length": 51.0}')
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY)
    since = len(observer.listen(topics.JUMP_PHASE))
    observer.send_joint(topics.JUMP_REQUEST, machine.JUMP_STROKE, 0.1, 0.1, stamp_ns=0)
    observer.wait_for_event(PlantEvent.APEX)
    observer.wait_for_text(topics.JUMP_PHASE, JumpPhase.STANDBY, since=since)
    phases = [sample.text for sample in observer.listen(topics.JUMP_PHASE).samples[since:]]
    assert phases == ["compressing", "settling", "releasing", "flight", "landed", "standby"]


def test_winch_and_descent_control_the_mock_plant_s_rover(harness: NodeHarness):
    observer = start(harness, "winch_node", "descent_node")
    drum = observer.listen(topics.WINCH_STATE)
    assert observer.call(topics.WINCH_REARM).success
    observer.send_joint(topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, 10.03, 0.0, stamp_ns=0)
    drum.wait(lambda sample: sample.joints[machine.WINCH_DRUM].position > 10.02)
    observer.send_joint(topics.DESCENT_REQUEST, machine.PLAIN_STOP, 10.5, 0.0, stamp_ns=0)
    observer.wait_for_event(DescentEvent.STOP_ACCEPTED)
