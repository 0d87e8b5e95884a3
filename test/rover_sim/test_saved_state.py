"""Saved states: a plant continues from them bit by bit, and refuses what does not fit."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msg_schemas import topics
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import TextSample
from rover_sim import (
    STAMP,
    FlywheelCommand,
    JumpMotorCommand,
    PlantCommand,
    ScenarioError,
    SpatialPlant,
    WheelRateCommand,
    WinchCommand,
    build_interface,
    build_plant,
    load_scenario,
    load_spatial,
    plain_state,
    read_state,
    simulation_from,
    write_state,
)
from rover_sim.interface.mock_interface import MockInterface
from rover_sim.physics.integrators import integrator_memory, session
from rover_sim.plants.mock_plant import MockPlant

TICK = 0.01
HANG = load_spatial("free_hang", {"start.swing_angle": 2.0})
PLANAR = load_scenario("paper_table1_high", {"start.geometry": "+K", "start.slack": 2.0})


def lowered(index: int) -> PlantCommand:
    """Pay out, so that elements are split, and spin the flywheel."""
    return PlantCommand(
        winch=WinchCommand(20.0, rate=0.5 + 0.001 * index), jump=FlywheelCommand(0.02)
    )


def jumped(index: int) -> PlantCommand:
    return PlantCommand(jump=JumpMotorCommand(0.1, 1.0) if index < 20 else None)


def driven(index: int) -> PlantCommand:
    return PlantCommand(
        winch=WinchCommand(20.0, rate=0.1), wheel=WheelRateCommand(0.5 if index > 5 else 0.0)
    )


def written(plant: Any, state: Any, file: Path) -> Path:
    """Save a state, as a message of its topic holds it."""
    content = {STAMP: 0, "state": plain_state(state)}
    write_state(file, plant.scenario.to_mapping(), json.loads(json.dumps(content)))
    return file


@pytest.mark.parametrize(
    ("plant", "command", "ticks"),
    [
        pytest.param(build_plant(HANG), lowered, 250, id="spatial"),
        pytest.param(build_plant(PLANAR), jumped, 40, id="planar"),
        pytest.param(MockPlant(load_spatial("marius_hills")), driven, 40, id="mock"),
    ],
)
def test_a_saved_state_continues_bit_by_bit(
    plant: Any, command: Callable[[int], PlantCommand], ticks: int, tmp_path: Path
):
    state = plant.initial_state()
    for index in range(ticks):
        state, _ = plant.step(state, command(index), TICK)
    file = written(plant, state, tmp_path / "state.json")
    other = type(plant)(plant.scenario)
    resumed = other.restored_state(read_state(str(file), other.scenario))
    assert plain_state(resumed) == plain_state(state)
    for index in range(ticks, 2 * ticks):
        state, result = plant.step(state, command(index), TICK)
        resumed, found = other.step(resumed, command(index), TICK)
        assert found.energies == result.energies
    assert plain_state(resumed) == plain_state(state)
    assert state.time == pytest.approx(2 * ticks * TICK)


def test_a_settled_rover_on_the_ground_starts_without_settling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    plant = build_plant(load_spatial("slope_15deg"))
    state = plant.initial_state()
    file = written(plant, state, tmp_path / "state.json")
    other = SpatialPlant(plant.scenario)
    monkeypatch.setattr(other, "_settle", lambda _: pytest.fail("it settles"))
    values = read_state(str(file), other.scenario)
    simulation = simulation_from(build_interface(other, 1), TICK, values)
    assert simulation.phase is PlantPhase.GROUNDED
    simulation.tick()
    simulation.reset()
    assert plain_state(simulation.state) == plain_state(state)
    assert simulation.stamp_ns == 0


def test_a_state_is_published_as_it_is_saved():
    simulation = simulation_from(build_interface(build_plant(HANG), 1), TICK, None)
    simulation.tick()
    ((_, sample),) = simulation.interface.samples([topics.TRUTH_STATE])
    assert isinstance(sample, TextSample)
    content = json.loads(sample.text)
    assert content == {STAMP: 10_000_000, "state": plain_state(simulation.state)}


def changed(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda state: state.update(changes)


def with_vector(index: int, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(state: dict[str, Any]) -> None:
        state["vector"][index] = value

    return change


def with_node(value: Any) -> Callable[[dict[str, Any]], None]:
    def change(state: dict[str, Any]) -> None:
        state["rows"][0][3] = value

    return change


ELEMENTS = integrator_memory.ELEMENTS
LATCH = session.DRIVES.start
DRUM_LENGTH = LATCH + 8
X_OF_BODY = session.BODY.start


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (changed(phase="diverged"), "state.phase = 'diverged'.*hanging, grounded, flight"),
        (changed(phase="held"), "state.phase = 'held'"),
        (changed(phase=3), "state.phase = 3: should be one of"),
        (changed(vector=[]), r"shape of state.vector = \[0\]: should be \[\d+\]"),
        (changed(vector=None), "state.vector = null: should hold numbers"),
        (changed(vector=[[1.0], [1.0, 2.0]]), "state.vector.*same length"),
        (changed(rows=[[0.0] * 8] * 12), r"shape of state.rows = \[12, 8\]: should be \[12, 20\]"),
        (changed(tether_anchors=[]), "shape of state.tether_anchors"),
        (changed(speed=1.0), "state.speed = 1.0: no such key; known here: phase, vector"),
        (dict.clear, "state.phase = null: should be given"),
        (with_node(float("nan")), r"state.rows\[0\]\[3\] = nan: should be finite"),
        (with_node(-1e200), r"state.rows\[0\]\[3\] = -1e\+200: should be at most 1e\+30 in size"),
        (with_node("1"), "state.rows.*should hold numbers"),
        (with_node(10**400), "state.rows.*should hold numbers"),
        (with_vector(0, ".inf"), r"state.vector\[0\] = inf: should be finite"),
        (with_vector(40, float("-inf")), r"state.vector\[40\] = -inf: should be finite"),
        (with_vector(ELEMENTS, 400.0), "elements = 400: should be from 1 to 60"),
        (with_vector(ELEMENTS, 18.0), r"shape of state.rows = \[12, 20\]: should be \[12, 19\]"),
        (with_vector(X_OF_BODY, 1.0), "distance of tether and rover = .*should be below 0.0001 m"),
        (with_vector(X_OF_BODY + 3, 2.0), "norm of the orientation"),
        (with_vector(DRUM_LENGTH, 3.0), "length paid out = 3.0: should be that of 19 elements"),
        (with_vector(LATCH, 7.0), "latch = 7.0: should be one of 0 free"),
    ],
)
def test_a_damaged_state_is_refused(damage: Callable[[dict[str, Any]], None], message: str):
    plant = SpatialPlant(HANG)
    values = copy.deepcopy(plain_state(plant.initial_state()))
    assert plain_state(plant.restored_state(values)) == values
    damage(values)
    with pytest.raises(ScenarioError, match=message):
        plant.restored_state(values)


def test_the_latch_of_a_plant_without_a_rover_is_checked_too():
    plant = SpatialPlant(load_spatial("spatial_pendulum"))
    values = copy.deepcopy(plain_state(plant.initial_state()))
    values["vector"][LATCH] = -3.0
    with pytest.raises(ScenarioError, match=r"latch = -3.0: should be one of 0 free"):
        plant.restored_state(values)


def test_a_state_of_another_scenario_or_plant_is_refused(tmp_path: Path):
    plant = build_plant(HANG)
    file = str(written(plant, plant.initial_state(), tmp_path / "state.json"))
    for change, path in (
        ({"tether.element_length": 0.5}, "tether.element_length = 0.5: .*with 1.0"),
        ({"environment.gravity": 9.81}, "environment.gravity = 9.81"),
    ):
        with pytest.raises(ScenarioError, match=path):
            read_state(file, HANG.with_overrides(change))
    with pytest.raises(ScenarioError, match="model"):
        read_state(file, PLANAR)
    # Start, sensors and integration may differ.
    read_state(file, HANG.with_overrides({"start.swing_angle": 0.0, "integration.h": 5e-4}))
    with pytest.raises(ScenarioError, match=r"state.phase|state.vector = .*: no such key"):
        MockPlant(HANG).restored_state(read_state(file, HANG))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read: .*No such file"),
        (b"", "cannot be read"),
        (b"\xff", "cannot be read"),
        (b"[" * 100_000, "cannot be read"),
        (b"[]", "format = null: should be 'mother_rover plant state 1'"),
        (b'{"format": "mother_rover plant state 1"}', "should"),
        (b'{"format": "mother_rover plant state 1", "scenario": {"model": "x"}}', "model = 'x'"),
    ],
)
def test_a_file_that_holds_no_state_is_refused(content: bytes | None, message: str, tmp_path: Path):
    file = tmp_path / "state.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ScenarioError, match=message):
        read_state(str(file), HANG)


def test_a_file_is_not_overwritten(tmp_path: Path):
    plant = build_plant(HANG)
    file = written(plant, plant.initial_state(), tmp_path / "state.json")
    with pytest.raises(FileExistsError):
        written(plant, plant.initial_state(), file)


def test_a_simulation_with_the_mock_plant_starts_from_its_state(tmp_path: Path):
    scenario = load_spatial("marius_hills")
    plant = MockPlant(scenario)
    state = plant.initial_state()
    for _ in range(30):
        state, _ = plant.step(state, driven(0), TICK)
    values = read_state(str(written(plant, state, tmp_path / "state.json")), scenario)
    simulation = simulation_from(MockInterface(MockPlant(scenario)), TICK, values)
    assert simulation.state == state
    assert np.isclose(simulation.state.time, 0.3)
