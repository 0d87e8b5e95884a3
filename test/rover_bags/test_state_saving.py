"""The state of a running plant, saved by the command, starts another one."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from msg_schemas import topics
from msg_schemas.events import NodeEvent
from rover_bags.recording.state_saving import SaveExitCode

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

pytestmark = [pytest.mark.ros, pytest.mark.process, pytest.mark.usefixtures("compiled")]

PENDULUM = {"scenario": "tether_pendulum", "real_time_factor": 1.0}
CLOCK = {topics.CLOCK: topics.CLOCK.strip("/")}


def started(harness: NodeHarness, name: str, **parameters: object) -> tuple[Process, Observer]:
    """Start a simulation in a namespace of its own."""
    process = harness.processes.start(
        "rover_sim.node.sim_node", {**PENDULUM, **parameters}, namespace=name, remap=CLOCK
    )
    observer = harness.observer(name, CLOCK)
    observer.listen(topics.CLOCK)
    observer.listen(topics.TRUTH_STATE)
    observer.wait_for_event(NodeEvent.ACTIVE)
    return process, observer


def save(harness: NodeHarness, *arguments: str) -> Process:
    process = harness.processes.start("rover_cli", None, "state", "save", *arguments)
    process.wait()
    return process


def stepped(observer: Observer, stamp_ns: int, ticks: int) -> object:
    """Step a paused simulation and return its state."""
    for _ in range(ticks):
        assert observer.call(topics.SIM_STEP).success
    sample = observer.listen(topics.TRUTH_STATE).wait(
        lambda sample: json.loads(sample.text)["stamp_ns"] == stamp_ns + ticks * 10_000_000
    )
    return json.loads(sample.text)["state"]


def test_a_flight_continues_bit_by_bit_from_the_state_saved_while_paused(
    harness: NodeHarness, tmp_path: Path
):
    _, one = started(harness, "/one")
    one.wait_for_time(300_000_000)
    assert one.call(topics.SIM_PAUSE, True).success
    file = tmp_path / "state.json"
    saved = save(harness, str(file), "--namespace", "/one")
    assert saved.wait() == SaveExitCode.SAVED, saved.output
    stamp_ns = json.loads(file.read_text())["stamp_ns"]
    assert stamp_ns >= 300_000_000
    assert f"state at {stamp_ns * 1e-9:.3f} s of simulated time" in saved.output
    _, two = started(harness, "/two", start_state=str(file), start_paused=True)
    assert stepped(one, stamp_ns, 30) == stepped(two, 0, 30)
    configuration = two.listen(topics.CONFIG).wait(lambda s: "scenario" in json.loads(s.text))
    assert json.loads(configuration.text)["start_state"] == json.loads(file.read_text())["state"]
    # A reset goes back to it.
    assert two.call(topics.SIM_RESET).success
    assert stepped(two, 0, 0) == json.loads(file.read_text())["state"]
    again = save(harness, str(file), "--namespace", "/one")
    assert again.wait() == SaveExitCode.NOT_WRITTEN
    assert "exists: name a new file" in again.output


def test_without_a_plant_nothing_is_saved(harness: NodeHarness, tmp_path: Path):
    file = tmp_path / "state.json"
    process = save(harness, str(file), "--timeout", "1")
    assert process.wait() == SaveExitCode.NO_PLANT
    assert "no simulated plant in the namespace / has published truth/state" in process.output
    assert not file.exists()


def test_a_plant_does_not_start_from_the_state_of_another_scenario(
    harness: NodeHarness, tmp_path: Path
):
    file = tmp_path / "state.json"
    file.write_text("{}")
    processes = itertools.chain.from_iterable(
        (harness.processes.start(f"rover_sim.node.{node}", {"start_state": str(file)}),)
        for node in ("sim_node", "mock_plant_node")
    )
    for process in processes:
        assert process.wait() == 2
        assert f"{file}: format = null: should be 'mother_rover plant state 1'" in process.output
