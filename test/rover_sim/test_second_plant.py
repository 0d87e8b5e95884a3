"""Two plants with one clock would upset each other: the second one is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from msg_schemas import topics
from msg_schemas.events import NodeEvent

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Processes

pytestmark = [pytest.mark.ros, pytest.mark.process]

PLANT = "rover_sim.node.mock_plant_node"
SCENARIO = {"scenario": "free_hang"}


@pytest.mark.parametrize("namespace", ["", "second"])
def test_a_second_plant_with_the_same_clock_is_refused(harness: NodeHarness, namespace: str):
    first = harness.processes.start(PLANT, SCENARIO)
    observer = harness.observer()
    observer.wait_for_event(NodeEvent.ACTIVE)
    arguments = ("--ros-args", "-r", f"__ns:=/{namespace}") if namespace else ()
    second = harness.processes.start(PLANT, SCENARIO, *arguments)
    assert second.wait() == 2
    assert f"{topics.CLOCK} is published by" in second.output
    assert "Traceback" not in second.output
    received = len(observer.listen(topics.CLOCK))
    observer.listen(topics.CLOCK).wait(since=received)
    assert first.is_running


def test_a_second_plant_with_a_clock_of_its_own_runs(processes: Processes, harness: NodeHarness):
    processes.start(PLANT, SCENARIO)
    harness.observer().wait_for_event(NodeEvent.ACTIVE)
    arguments = ("--ros-args", "-r", "__ns:=/second", "-r", f"{topics.CLOCK}:=clock")
    second = processes.start(PLANT, SCENARIO, *arguments)
    second.wait_for_output("mock_plant is active")
    assert second.stop() == 0


def test_a_plant_that_is_started_again_runs(processes: Processes):
    for _ in range(2):
        plant = processes.start(PLANT, SCENARIO)
        plant.wait_for_output("mock_plant is active")
        plant.kill_group()
        assert plant.wait() != 0
