"""What a restarted mission takes over: within a run it goes on, a new run begins anew."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.phases import MissionPhase
from msg_schemas.samples import Sample, StatusSample, TextSample
from rover_launch.loop import component_class, make_plan, start_plan
from rover_launch.plan import HANGING_DEFAULTS
from rover_runtime.loop_host import LoopHost
from rover_runtime.loop_port import LoopPort
from rover_sim.node.mock_plant_node import MockPlantNode

PLAN = """\
about: one stop
stow: 4.8
looks: [{depth: 5.5}]
"""


class Run:
    """A run of the simulation with the mission's nodes."""

    def __init__(self, folder: Path) -> None:
        plan, self._checkpoint = folder / "plan.yaml", folder / "checkpoint.json"
        plan.write_text(PLAN)
        self.host = LoopHost()
        self.phase, self.events = "", list[str]()
        self.host.exchange.listen(self._on_phase, topics.MISSION_PHASE)
        self.host.exchange.listen(self._on_events, topics.EVENTS)
        merged = json.loads(HANGING_DEFAULTS["overrides"]) | {"tether.length": 5.0}
        given = {"scenario": "marius_hills", "overrides": json.dumps(merged), "plant": "mock"}
        nodes = ("winch_node", "descent_node", "mission_node")
        changed = {"mission_node": {"plan": str(plan), "checkpoint": str(self._checkpoint)}}
        self.parameters = start_plan(self.host, make_plan(nodes, HANGING_DEFAULTS, given), changed)
        self.host.run(1.0)
        self.call(topics.WINCH_REARM)

    def _on_phase(self, _topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, TextSample)
        self.phase = sample.text

    def _on_events(self, _topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, StatusSample)
        self.events += [each.name for each in sample.statuses]

    def call(self, service: str) -> bool:
        response = self.host.call(service)
        assert self.host.run(1.0, lambda: response.success is not None)
        return bool(response.success)

    def restart(self) -> None:
        self.host.kill("mission_node")
        self.events.clear()
        self.host.start(component_class("mission_node"), self.parameters["mission_node"])
        self.host.run(2.0)

    @property
    def is_active(self) -> bool:
        return self.phase == MissionPhase.LOOKING


@pytest.fixture
def active_run(tmp_path: Path) -> Run:
    run = Run(tmp_path)
    assert run.call(topics.MISSION_GO)
    run.host.run(3.0)
    assert run.is_active
    return run


@pytest.mark.parametrize("held", [False, True])
def test_a_new_run_never_inherits_a_mission(tmp_path: Path, active_run: Run, held: bool):
    if held:
        assert active_run.call(topics.MISSION_HOLD)
        active_run.host.run(2.0)
    fresh = Run(tmp_path)
    fresh.host.run(active_run.host.now_ns() * 1e-9)  # also once its clock is ahead
    assert fresh.phase == MissionPhase.STANDBY
    assert MissionEvent.CHECKPOINT_DISCARDED in fresh.events
    assert fresh.call(topics.MISSION_GO)
    fresh.restart()
    assert fresh.is_active


def test_a_restart_within_a_run_resumes(active_run: Run):
    active_run.restart()
    assert active_run.is_active
    assert MissionEvent.CHECKPOINT_DISCARDED not in active_run.events


@pytest.mark.parametrize("ticks", [0, 5, 30])
@pytest.mark.parametrize(("service", "phase"), [
    (topics.MISSION_ABORT, MissionPhase.ABORTED), (topics.MISSION_HOLD, MissionPhase.HOLDING),
])  # fmt: skip
def test_an_operator_s_command_is_obeyed_right_after_a_restart(
    active_run: Run, service: str, phase: MissionPhase, ticks: int
):
    active_run.host.kill("mission_node")
    active_run.host.start(component_class("mission_node"), active_run.parameters["mission_node"])
    for _ in range(ticks):
        active_run.host.tick()
    assert active_run.call(service)
    active_run.host.run(3.0)
    assert active_run.phase == phase


def test_hardware_resumes_only_by_an_operator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(LoopPort, "is_simulated", False, raising=False)
    monkeypatch.setattr(MockPlantNode, "configuration", lambda _: {})
    run = Run(tmp_path)
    assert run.call(topics.MISSION_GO)
    run.host.run(3.0)
    run.restart()
    assert run.phase == MissionPhase.HOLDING
    assert MissionEvent.INTERRUPTED in run.events
    assert run.call(topics.MISSION_RESUME)
    assert run.is_active


def test_a_mission_on_hardware_takes_nothing_over_from_a_simulation(
    tmp_path: Path, active_run: Run, monkeypatch: pytest.MonkeyPatch
):
    active_run.host.kill("mission_node")
    monkeypatch.setattr(LoopPort, "is_simulated", False, raising=False)
    monkeypatch.setattr(MockPlantNode, "configuration", lambda _: {})
    assert Run(tmp_path).phase == MissionPhase.STANDBY


@pytest.mark.parametrize("damage", [
    lambda text: text.replace('"leg": ', '"leg": -', 1),
    lambda text: "[" * 200_000,
    lambda text: text[: len(text) // 2],
    lambda text: text.partition("\n")[2],
    lambda text: "",
], ids=["one character", "nested", "cut", "without checksum", "empty"])  # fmt: skip
def test_a_damaged_checkpoint_is_reported_and_the_mission_starts_anew(
    active_run: Run, tmp_path: Path, damage: Callable[[str], str]
):
    file = tmp_path / "checkpoint.json"
    text = file.read_text()
    assert damage(text) != text
    file.write_text(damage(text))
    active_run.restart()
    assert active_run.phase == MissionPhase.STANDBY
    assert MissionEvent.CHECKPOINT_DISCARDED in active_run.events
