"""Jumps of the spatial plant's rover from a compressed spring."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from rover_sim import (
    RunError,
    ScenarioError,
    SpatialPlant,
    SpatialScenario,
    load_spatial,
    spatial_jump,
)
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.scenarios.hardware import jump_height

COMPRESSION = 0.12


def standing(**changes: Any) -> SpatialScenario:
    """A rover on a level floor below the fairlead, with slack tether."""
    return load_spatial(
        "floor_rubble",
        {
            "environment.relief": None,
            "environment.boulders": None,
            "tether.length": 6.0,
            "tether.element_length": 0.5,
            "start.position": [1.0, 0.0],
            "start.compression": COMPRESSION,
            **changes,
        },
    )


@pytest.fixture(scope="module")
def plant() -> SpatialPlant:
    """A plant with the rover ready to jump."""
    return SpatialPlant(standing())


def test_the_start_is_at_rest_with_the_spring_held_by_the_latch(plant: SpatialPlant):
    state = plant.initial_state()
    assert state.latch is Latch.ENGAGED
    rover = plant.scenario.rover
    assert rover is not None
    assert rover.slider.free_length - state.s == pytest.approx(COMPRESSION)
    energies = plant.energies(state)
    assert energies.spring == pytest.approx(
        0.5 * rover.slider.spring_rate * COMPRESSION**2, rel=0.05
    )
    assert energies.drift == pytest.approx(0.0, abs=1e-12)
    assert np.array_equal(state.node_rates, np.zeros_like(state.node_rates))


def test_the_height_is_that_of_the_springs_energy(plant: SpatialPlant):
    rover = plant.scenario.rover
    assert rover is not None
    metrics = spatial_jump(plant)
    lossless = jump_height(rover, plant.scenario.gravity, COMPRESSION)
    # Friction and the lifted tether take a part; Body 1 swings against Body 2 on the slider.
    assert metrics.height == pytest.approx(lossless, rel=0.1)
    # Up and down in vacuum; Body 2 rises on its slider before the take-off.
    ballistic = 2.0 * math.sqrt(2.0 * metrics.height / plant.scenario.gravity)
    assert metrics.flight_time == pytest.approx(ballistic, rel=0.1)
    assert metrics.tilt < 0.2
    assert metrics.travel < 0.1
    assert abs(metrics.energy_drift) < 1e-3 * 0.5 * rover.slider.spring_rate * COMPRESSION**2
    assert 0.0 < metrics.clearance < 0.1  # when the wheels touch the floor


def test_a_plant_of_another_start_is_bit_for_bit_the_plant_of_its_scenario(plant: SpatialPlant):
    changes = {"start.compression": 0.1, "start.tilt": [1.0, -2.0, 0.0]}
    other = standing(**changes)
    assert spatial_jump(plant.with_scenario(other)) == spatial_jump(SpatialPlant(other))
    # The first plant keeps its start.
    assert plant.scenario.start.compression == COMPRESSION


def test_a_plant_of_a_start_elsewhere_settles_there(plant: SpatialPlant):
    elsewhere = dataclasses.replace(plant.scenario.start, position=(1.5, 0.2))
    other = dataclasses.replace(plant.scenario, start=elsewhere)
    state = plant.with_scenario(other).initial_state()
    assert state.G1[:2] == pytest.approx([1.5, 0.2], abs=0.05)


def test_a_plant_of_another_machine_shares_nothing(plant: SpatialPlant):
    heavier = plant.scenario.with_overrides({"rover.m2": 3.0})
    with pytest.raises(ScenarioError, match="rover"):
        plant.with_scenario(heavier)


def test_a_tilt_turns_the_ready_rover_about_body_1(plant: SpatialPlant):
    start = dataclasses.replace(plant.scenario.start, tilt=(0.0, 6.0, 0.0))  # z towards x
    tilted = dataclasses.replace(plant.scenario, start=start)
    state, ready = plant.initial_state(), plant.with_scenario(tilted).initial_state()
    assert state.rotation.T @ ready.rotation[:, 2] == pytest.approx(
        [math.sin(math.radians(6.0)), 0.0, math.cos(math.radians(6.0))], abs=1e-9
    )
    assert ready.tilt_from(state) == pytest.approx(math.radians(6.0), rel=1e-6)
    assert np.array_equal(ready.G1, state.G1)
    rover = plant.scenario.rover
    assert rover is not None
    assert ready.tip == pytest.approx(ready.G1 + ready.rotation @ np.array(rover.attachment))


def test_the_clearance_shows_a_boulder_under_the_body():
    """The body hangs 5 to 6 cm above the floor between its wheels; rubble comes nearer."""
    level = spatial_jump(SpatialPlant(standing())).clearance
    rough = standing(
        **{
            "environment.boulders": {
                "density": 8.0, "smallest": 0.1, "largest": 0.3, "exponent": 2.5,
                "height_ratio": 0.4, "clear_radius": 0.2,
            },
            "environment.seed": 3,
            "start.residual_speed": 0.05,
        }
    )  # fmt: skip
    assert spatial_jump(SpatialPlant(rough)).clearance < level - 0.005


@pytest.mark.parametrize(
    ("changes", "path"),
    [
        ({"start.compression": 0.5}, "start.compression"),
        ({"start.compression": -0.1}, "start.compression"),
        ({"start.compression": math.nan}, "start.compression"),
        ({"start.compression": 0.0, "start.tilt": [0.0, 1.0, 0.0]}, "start.tilt"),
    ],
)
def test_invalid_starts_are_refused(changes: dict[str, Any], path: str):
    with pytest.raises(ScenarioError) as refused:
        standing(**changes)
    assert refused.value.path == path


def test_without_a_compressed_spring_nothing_jumps():
    with pytest.raises(ScenarioError, match="compression"):
        spatial_jump(SpatialPlant(standing(**{"start.compression": 0.0})))


def test_a_flight_longer_than_allowed_is_an_error(plant: SpatialPlant):
    with pytest.raises(RunError, match=r"no landing within 0\.3 s"):
        spatial_jump(plant, max_flight_time=0.3)
