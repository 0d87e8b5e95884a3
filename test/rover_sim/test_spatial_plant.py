"""The spatial plant's Python interface: comparison with the planar plant, and initial states."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msg_schemas.phases import PlantPhase
from rover_sim import (
    PlanarPlant,
    PlantCommand,
    Scenario,
    ScenarioError,
    SettlingError,
    SpatialPlant,
    WheelRateCommand,
    WinchCommand,
    load_planar,
    load_spatial,
)
from rover_sim.physics.rover import rep103
from rover_sim.physics.tether.starting_shapes import arc_nodes
from rover_sim.plants.spatial_start import quaternion_of
from rover_verify.checks import Check, CheckBatch, spatial_body, spatial_snatch, spatial_tether
from rover_verify.checks.planar import random_jump
from rover_verify.checks.spatial_cases import (
    IDEAL_WINCH,
    make_plant,
    spatial_twin,
    taken_off,
    twin_state,
)

PENDULUM = {"tip": {"mass": 10.0}, "rover": None, "integration.tolerance": 1e-9}


def jump_of(seed: int) -> Scenario:
    """A random jump without landing; the taut jump for a negative number."""
    fixed = {"after_landing": "fly_on", "integration.h": 2.5e-4, "integration.tolerance": 1e-12}
    if seed < 0:
        return load_planar("taut_jump", fixed)
    draw = np.random.default_rng(seed)
    damping = float(10.0 ** draw.uniform(-4.0, -2.0))
    return random_jump(draw, **fixed, **{"tether.axial_damping_time": damping})


@pytest.mark.parametrize("seed", range(-4, 6))
def test_a_jump_in_a_vertical_plane_is_the_planar_jump(
    seed: int, record_property: Callable[[str, object], None]
):
    azimuth = seed * 1.1 if seed >= 0 else (-1 - seed) * 0.9
    planar = PlanarPlant(jump_of(seed))
    plant, end = spatial_twin(planar.scenario), taken_off(planar)
    state = twin_state(plant, end, azimuth)
    east = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    rover = plant.scenario.rover
    assert rover is not None
    for _ in range(4):
        end, _ = planar.step(end, PlantCommand(), 0.1)
        state, result = plant.step(state, PlantCommand(), 0.1)
        places = np.array([state.tip, state.G1, state.centre2(rover)])
        error = np.abs(places @ east - np.array([end.nodes[-1, 0], end.G1, end.G2])[:, 0]).max()
        error = max(error, np.abs(places[:, 2] - [end.nodes[-1, 0, 1], end.G1[1], end.G2[1]]).max())
        if azimuth == 0.0:
            turn = rep103.planar_angle(state.orientation) - end.theta
            error = max(error, abs(math.remainder(turn, math.tau)))
        record_property("error", error)
        assert error < 1e-8
        if seed < 0:  # a taut tether does not magnify rounding
            across = np.concatenate([state.nodes[:, 0], places]) @ [-east[1], east[0], 0.0]
            record_property("distance", np.abs(across).max())
            assert np.abs(across).max() < 1e-11
    assert abs(result.energies.drift) < 1e-6


def test_a_rate_servo_holds_its_setpoint_at_the_longest_step_that_is_accepted():
    plant = make_plant({"integration.h": 0.02})
    state = plant.initial_state()
    for _ in range(10):
        state, _ = plant.step(state, PlantCommand(wheel=WheelRateCommand(1.0)), 0.2)
        if state.time > 0.7:
            assert state.wheel_rates[0] == pytest.approx(1.0, abs=0.03)


def test_state_at_reproduces_a_state():
    plant = make_plant({"start.swing_angle": 20.0, "start.tilt": [1.0, 2.0, 3.0]})
    expected = plant.initial_state()
    rates = np.concatenate([[[np.zeros(3), expected.fairlead_slope[1]]], expected.node_rates])
    state = plant.state_at(
        plant.to_full_nodes(expected), rates, orientation=expected.orientation, slide=expected.s
    )
    for name in ("nodes", "node_rates", "fairlead_slope", "body"):
        np.testing.assert_allclose(getattr(state, name), getattr(expected, name), atol=1e-12)
    assert plant.energies(state).stored == pytest.approx(plant.energies(expected).stored)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"nodes": np.zeros((3, 2, 3))}, "shape"),
        ({"orientation": (0.0, 0.0, 0.0, 2.0)}, "norm"),
        ({"angular_velocity": (0.0, math.nan, 0.0)}, "finite"),
        ({"slide": math.inf}, "finite"),
    ],
)
def test_invalid_poses_are_refused(change: dict[str, Any], reason: str):
    plant = make_plant({})
    nodes = plant.to_full_nodes(plant.initial_state())
    with pytest.raises(ValueError, match=reason):
        plant.state_at(**{"nodes": nodes, **change})


def test_a_tether_that_does_not_start_at_the_fairlead_is_refused():
    plant = make_plant({})
    nodes = plant.to_full_nodes(plant.initial_state()).copy()
    nodes[0, 0, 0] = 0.1
    with pytest.raises(ValueError, match="fairlead"):
        plant.state_at(nodes)


@pytest.mark.parametrize("rate", [0.3, -0.3])
def test_a_winch_that_turns_at_the_start_pays_out_at_that_rate(rate: float):
    plant = make_plant(PENDULUM, {"start.payout_rate": rate})
    state = plant.initial_state()
    assert plant.payout_rate(state) == pytest.approx(rate)
    assert not state.braked
    assert state.node_rates[-1, 0, 2] == pytest.approx(-rate, rel=1e-2)
    energies = plant.energies(state)
    inertia = plant.model.drum.inertia
    assert energies.rotors == pytest.approx(0.5 * inertia * (rate / 0.05) ** 2)
    assert energies.drift == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("rate", [0.3, -0.3])
def test_a_tether_that_is_paid_out_has_the_tension_of_one_at_rest(rate: float):
    soft = {"tether.axial_damping_time": 0.02}
    at_rest = make_plant(PENDULUM, soft)
    plant = make_plant(PENDULUM, soft, {"start.payout_rate": rate})
    expected = at_rest.tension(at_rest.initial_state())
    # A tether of constant stretch has no strain-rate damping; otherwise there would be 100 N.
    np.testing.assert_allclose(plant.tension(plant.initial_state()), expected, rtol=0.02)


def test_a_rover_that_swings_on_its_tether_has_no_flight():
    plant = SpatialPlant(load_spatial("free_hang", {"start.swing_rate": 10.0}))
    state, heights = plant.initial_state(), []
    for _ in range(80):
        state, result = plant.step(state, PlantCommand(), 0.1)
        heights.append(state.G1[2])
        assert not result.events
    assert max(heights) > max(heights[0], heights[-1]) + 0.01  # it passed a highest point


def test_without_a_winch_a_payout_rate_at_the_start_is_refused():
    overrides = {"winch": None, "tether.max_length": None, "start.payout_rate": 0.1}
    with pytest.raises(ScenarioError, match="without a winch"):
        load_spatial("free_hang", overrides)


@pytest.mark.parametrize(
    ("check", "limit"),
    [
        (spatial_body.conical, 1e-6),
        (spatial_body.spherical, 1e-5),
        (partial(spatial_body.gyrostat, quantity="energy"), 1e-10),
        (partial(spatial_body.gyrostat, quantity="momentum"), 1e-12),
        (spatial_body.swung_body, 5e-5),
        (spatial_body.coning, 1e-2),
        (spatial_tether.lengthening, 5e-4),
        (spatial_tether.stiff_cable, 3e-3),
        (spatial_tether.vertical_tension, 1e-2),
        (spatial_snatch.coarse_snatch, 2e-2),
        (spatial_snatch.push, 1.2),
        (spatial_snatch.tightening, 5e-2),
    ],
)
@pytest.mark.slow
def test_spatial_motion_agrees_with_closed_forms(check: Check, limit: float, tmp_path: Path):
    assert check(CheckBatch(1, 3, tmp_path)).value < limit


@pytest.mark.parametrize("rate", [0.5, -0.5])
def test_the_energy_balance_includes_the_stretch_of_the_tether_paid_out(rate: float):
    length = 3.0 if rate > 0.0 else 13.0
    soft = {"axial_stiffness": 2e3, "bending_stiffness": 1e-4, "line_density": 5e-3}
    damped = {"axial_damping_time": 0.02, "bending_damping_time": 0.05}
    plant = make_plant(
        PENDULUM,
        IDEAL_WINCH,
        {"tether": {"length": length, "max_length": 20.0, "element_length": 1.0, **soft, **damped}},
        {"start.payout_rate": rate},
    )
    command = PlantCommand(winch=WinchCommand(length, rate, feed_forward=16.2))
    state, result = plant.step(plant.initial_state(), command, 20.0)
    assert state.length == pytest.approx(length + 20.0 * rate, abs=1e-3)
    # 16.2 N along 10 m, at a stretch of 0.8 %: otherwise 1.3 J would be missing.
    assert abs(result.energies.drift) < 0.02


@pytest.mark.parametrize("seed", [3, 5])
def test_a_rover_on_the_ground_below_the_fairlead_settles_with_a_slack_tether(seed: int):
    # The loop is nearly free to rotate about the vertical: it settles slowly.
    start = {"position": [0.0, 0.0], "settling_time": 150.0}
    changes = {
        "environment.seed": seed,
        "environment.floor": {"height": -5.0},
        "start": {"kind": "grounded", "heading": 0.0, **start},
        "tether.length": 5.2,
        "tether.element_length": 0.9,
        "integration.h": 2e-3,
    }
    plant = SpatialPlant(load_spatial("floor_rubble", changes))
    began = plant.initial_state()
    np.testing.assert_allclose(began.G1[:2], 0.0, atol=0.03)
    after, _ = plant.step(began, PlantCommand(), 1.0)
    moved = np.linalg.norm(after.nodes[:, 0] - began.nodes[:, 0], axis=1)
    assert float(moved.max()) < 1e-4


def test_a_rover_that_rolls_down_its_slope_is_refused_unless_a_residual_speed_is_allowed():
    changes: dict[str, Any] = {
        "environment.relief": None,
        "environment.boulders": None,
        "environment.floor": {"height": -6.0, "slope": 9.0, "downhill": 0.0},
        "start": {
            "kind": "grounded",
            "position": [1.0, 0.0],
            "heading": 0.0,
            "settling_time": 30.0,
        },
        "tether.length": 7.0,
        "integration.h": 2e-3,
    }
    with pytest.raises(SettlingError, match="still moving"):
        SpatialPlant(load_spatial("floor_rubble", changes)).initial_state()
    changes["start"]["residual_speed"] = 0.1
    began = SpatialPlant(load_spatial("floor_rubble", changes)).initial_state()
    assert began.phase is PlantPhase.GROUNDED
    assert not began.G1_rate.any()


@pytest.mark.parametrize(
    "changes",
    [
        {"tether.length": 4.7},  # the attachment is above the floor, and the wheels are below
        {"tether.length": 8.0},
        {"tether.length": 5.1, "rover": None, "tip": {"mass": 1.0}},
        {"tether.length": 4.6, "environment.floor.slope": 20.0, "start.swing_angle": -30.0},
        {"start": {"kind": "straight", "direction": [0.0, 0.0, -1.0]}, "tether.length": 4.7},
    ],
)
def test_a_start_that_would_be_in_the_ground_is_refused(changes: dict[str, object]):
    floor = {"height": -5.0, "material": "rock"}
    scenario = load_spatial("free_hang", {"environment.floor": floor, **changes})
    with pytest.raises(ScenarioError, match=r"tether\.length = .*: makes the start reach into"):
        SpatialPlant(scenario).initial_state()
    higher = scenario.with_overrides({"environment.floor.height": -9.0})
    assert not SpatialPlant(higher).initial_state().phase.final


def test_a_straight_start_may_rest_on_the_ground():
    start = {"kind": "straight", "direction": [0.0, 0.0, -1.0]}
    changes = {"environment.floor": {"height": -5.0}, "start": start, "tether.length": 4.58}
    plant = SpatialPlant(load_spatial("free_hang", changes))  # the wheels are 2 cm deep
    assert not plant.initial_state().phase.final


@pytest.mark.parametrize(
    ("start", "named"),
    [
        ({"kind": "hanging", "swing_angle": 60.0, "swing_heading": 180.0}, "tether.length"),
        ({"kind": "straight", "direction": [-1.0, 0.0, -1.0]}, "tether.length"),
        ({"kind": "grounded", "position": [-20.0, 0.0]}, "start.position"),
    ],
)
def test_a_start_in_the_wall_of_a_hole_is_refused(start: dict[str, object], named: str):
    length = {"tether.length": 60.0} if start["kind"] == "grounded" else {}
    plant = SpatialPlant(load_spatial("marius_hills", {"start": start, **length}))
    with pytest.raises(ScenarioError, match=named):
        plant.initial_state()


@pytest.mark.parametrize("rate", [-10.0, 10.0])
def test_a_winch_may_wind_several_elements_in_a_step(rate: float):
    motor = {"max_torque": 1e3, "stall_torque": 1e3, "no_load_rate": 1e5}
    changes = {"integration.h": 0.02, "tether.element_length": 0.05, "start.payout_rate": rate}
    plant = SpatialPlant(load_spatial("free_hang", {**changes, "winch.motor": motor}))
    state, command = plant.initial_state(), PlantCommand(winch=WinchCommand(0.0, rate))
    for _ in range(50):
        state, result = plant.step(state, command, 0.02)
    assert state.length == pytest.approx(20.0 + rate, abs=0.02)
    exit_length = state.length - 0.05 * state.elements
    assert 0.024 < exit_length < 0.076
    assert abs(result.energies.drift) < 1e-3 * result.energies.dissipated


def test_a_remainder_of_a_tick_is_halved_as_often_as_a_whole_step():
    ground = {"height": -3.0, "material": "rock"}
    straight = {"kind": "straight", "direction": [1.0, 0.0, 0.0]}
    own = {"environment.floor": ground, "start": straight, "winch": None, "tether.max_length": None}
    mesh = {"tether.length": 5.0, "tether.element_length": 0.5}
    plant = SpatialPlant(load_spatial("free_hang", {**own, **mesh}))
    nodes = arc_nodes(np.zeros(3), np.array([2.0, 0.3, -2.2]), 10, 5.0, np.array([0.0, 1.0, 0.0]))
    rates, tip_rate = np.zeros_like(nodes), np.array([0.5, 1.0, -4.4])
    rates[:, 0], rates[:, 1] = np.linspace(0.0, 1.0, 11)[:, None] * tip_rate, tip_rate / 5.0
    w, x, y, z = quaternion_of(np.radians([110.0, 15.0, 0.0]))
    state = plant.state_at(nodes, rates, orientation=(x, y, z, w))
    while state.time < 0.2 and not state.phase.final:
        state, _ = plant.step(state, PlantCommand(), 0.01)
    assert state.phase is not PlantPhase.DIVERGED


def test_settling_that_hardly_advances_is_refused_in_seconds():
    stiff = load_spatial("floor_rubble", {"environment.wheel.anchor_stiffness": 1e30})
    with pytest.raises(SettlingError, match="fewer than 100 a step; give a stiffness"):
        SpatialPlant(stiff).initial_state()
