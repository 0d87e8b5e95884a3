"""The spatial plant's energy balance with drives on the ground, and its jumps from rock."""

from __future__ import annotations

import itertools

import pytest

from msg_schemas.events import PlantEvent
from rover_sim import (
    Event,
    JumpMotorCommand,
    PlantCommand,
    SpatialPlant,
    SpatialState,
    WheelRateCommand,
    WinchCommand,
    load_spatial,
)
from rover_sim.physics.integrators import integrator_memory

BARE_ROCK = {
    "environment.relief": None,
    "environment.boulders": None,
    "environment.floor": {"height": -4.0, "material": "rock"},
    "start.position": [1.5, 0.0],
    "tether.length": 8.0,
}


@pytest.mark.parametrize("rate", [3.0, -3.0])  # straight ahead, and turning
def test_driving_and_braking_on_rock_conserve_energy(rate: float):
    plant = SpatialPlant(load_spatial("floor_rubble", BARE_ROCK))
    state = plant.initial_state()
    state, _ = plant.step(state, PlantCommand(wheel=WheelRateCommand(rate)), 1.0)
    state, result = plant.step(state, PlantCommand(wheel=WheelRateCommand(0.0)), 1.0)
    given = state.energy_balance["input_wheel_motor"]
    assert given > 1.0
    assert abs(result.energies.drift) < 2e-3 * given


@pytest.mark.parametrize("h", [2e-3, 1e-3, 2.5e-4])
def test_landings_on_rock_conserve_energy(h: float):
    plant = SpatialPlant(load_spatial("floor_rubble", {**BARE_ROCK, "integration.h": h}))
    state, released = plant.initial_state(), False
    largest, impact = 0.0, 0.0
    for _ in range(350):
        command = PlantCommand() if released else PlantCommand(jump=JumpMotorCommand(0.15, 0.06))
        state, result = plant.step(state, command, 0.02)
        largest = max(largest, abs(result.energies.drift))
        for event in result.events:
            released = released or event.name is PlantEvent.LATCH_RELEASED
            if released and event.name is PlantEvent.TOUCHDOWN:
                speed = event.values["speed"]
                impact = max(impact, 0.5 * plant.scenario.tip_mass * speed * speed)
    assert impact > 2.0
    assert largest < 1e-3 * impact


def height_of_a_jump(stroke: float, h: float) -> float:
    """Height that a jump from rock reaches [m]."""
    plant = SpatialPlant(load_spatial("floor_rubble", {**BARE_ROCK, "integration.h": h}))
    state, released = plant.initial_state(), False
    for _ in range(450):
        command = PlantCommand() if released else PlantCommand(jump=JumpMotorCommand(stroke, 0.06))
        state, result = plant.step(state, command, 0.02)
        for event in result.events:
            released = released or event.name is PlantEvent.LATCH_RELEASED
            if released and event.name is PlantEvent.APEX:
                return event.values["height"]
    raise AssertionError("no apex")


@pytest.mark.parametrize("stroke", [0.08, 0.1, 0.12])
def test_small_jumps_from_rock_hardly_depend_on_the_step(stroke: float):
    # Without damping of the rock, Body 1 oscillates on it while the spring expands.
    assert height_of_a_jump(stroke, 1e-3) == pytest.approx(
        height_of_a_jump(stroke, 2.5e-4), rel=0.01
    )


FLAT = {"environment.relief": None, "environment.boulders": None}


@pytest.mark.parametrize(
    ("overrides", "work", "drift"),
    [
        # A nut that oscillates on Body 2 with 8 rad in a step.
        ({"rover.m2": 0.5, "integration.h": 4e-3}, 14.45, 5e-3),
        ({"integration.h": 2e-3}, 13.53, 5e-3),
        ({}, 13.53, 5e-3),
    ],
)
def test_a_jump_and_its_landing_conserve_energy(
    overrides: dict[str, object], work: float, drift: float
):
    plant = SpatialPlant(load_spatial("floor_rubble", {**FLAT, **overrides}))
    state, released = plant.initial_state(), False
    largest = 0.0
    for _ in range(120):
        command = PlantCommand() if released else PlantCommand(jump=JumpMotorCommand(0.15, 0.06))
        state, result = plant.step(state, command, 0.05)
        largest = max(largest, abs(result.energies.drift))
        released = released or any(
            event.name is PlantEvent.LATCH_RELEASED for event in result.events
        )
    assert released
    assert state.energy_balance["input_jump_motor"] == pytest.approx(work, rel=5e-3)
    assert largest < drift


def test_a_latch_that_is_already_due_to_trip_loses_the_nut_s_energy_as_heat():
    plant = SpatialPlant(load_spatial("floor_rubble", {**FLAT, "start.compression": 0.2}))
    state = plant.initial_state()
    rover = plant.scenario.rover
    assert rover is not None
    stored = 0.5 * (rover.slider.spring_rate * 0.2) ** 2 / rover.slider.nut_stiffness
    after, result = plant.step(state, PlantCommand(jump=JumpMotorCommand(0.2, 0.05)), 1e-5)
    assert [event.name for event in result.events] == [PlantEvent.LATCH_RELEASED]
    assert after.energy_balance["heat_slider"] == pytest.approx(stored, rel=1e-2)
    assert abs(result.energies.drift) < 1e-2 * stored


def test_a_rover_that_is_lifted_slowly_takes_no_heat_from_the_soil():
    plant = SpatialPlant(
        load_spatial("floor_rubble", {**FLAT, "start.position": [0.5, 0.0], "tether.length": 5.5})
    )
    state = plant.initial_state()
    reel_in = PlantCommand(winch=WinchCommand(0.0, -0.05, feed_forward=20.0))
    heats = []
    for _ in range(400):
        state, result = plant.step(state, reel_in, 0.05)
        heats.append(state.energy_balance["heat_rover_on_ground"])
        if result.forces.left_wheel + result.forces.right_wheel == 0.0:
            break
    else:
        raise AssertionError("the wheels are still on the ground")
    assert all(after > before - 1e-5 for before, after in itertools.pairwise(heats))
    assert abs(result.energies.drift) < 2e-3


def events_of(plant: SpatialPlant, state: SpatialState, command: PlantCommand) -> list[Event]:
    events: list[Event] = []
    for _ in range(20):
        state, result = plant.step(state, command, 0.02)
        events.extend(result.events)
    return events


def test_an_energy_balance_that_does_not_close_is_reported_once():
    plant = SpatialPlant(load_spatial("free_hang", {"start.swing_angle": 20.0}))
    state = plant.initial_state()
    assert not events_of(plant, state, PlantCommand())
    memory = state.memory.copy()
    memory[integrator_memory.INITIAL_ENERGY] -= 0.5
    [event] = events_of(plant, state.replaced(memory=memory), PlantCommand())
    assert event.name is PlantEvent.ENERGY_DRIFT
    assert event.values["drift"] == pytest.approx(0.5, abs=1e-3)
    assert 0.0 < event.values["turnover"] < 50.0


@pytest.mark.parametrize("h", [1e-3, 4e-3])
@pytest.mark.parametrize("inertia", [2e-3, 1e-4, 1e-6])
def test_a_free_drum_lets_the_rover_fall_as_its_inertia_has_it(inertia: float, h: float):
    # The light ones are much lighter than the rover on a stiff tether: J/R^2 from 0.8 kg to 0.4 g.
    radius = 0.05
    free = {"coulomb": 0.0, "breakaway": 0.0, "stribeck_rate": 1.0, "viscous": 0.0}
    overrides = {
        "winch.radius": radius,
        "winch.drum_inertia": inertia,
        "winch.motor_inertia": 0.0,
        "winch.motor.max_torque": 1e-9,
        "winch.friction": free,
        "winch.release_delay": 0.0,
        "integration.h": h,
    }
    plant = SpatialPlant(load_spatial("free_hang", overrides))
    state = plant.initial_state()
    start, drift = state.G1[2], 0.0
    for _ in range(50):
        state, result = plant.step(state, PlantCommand(winch=WinchCommand(20.0, 0.0)), 0.02)
        drift = max(drift, abs(result.energies.drift))
    scenario = plant.scenario
    fall = scenario.gravity / (1.0 + inertia / (scenario.tip_mass * radius**2))
    assert start - state.G1[2] == pytest.approx(0.5 * fall, rel=0.02)
    assert drift < 1e-5 * result.energies.kinetic


FAST_PAYOUT = PlantCommand(winch=WinchCommand(length=40.0, rate=3.0))


@pytest.mark.parametrize("element_length", [1.0, 0.25])
def test_a_tether_that_buckles_balances_its_energy_and_reports_no_push(element_length: float):
    plant = SpatialPlant(load_spatial("free_hang", {"tether.element_length": element_length}))
    state = plant.initial_state()
    events: list[Event] = []
    for _ in range(30):
        state, result = plant.step(state, FAST_PAYOUT, 0.02)
        events.extend(result.events)
    assert not events
    assert abs(result.energies.drift) < 1e-2 * state.energy_balance["input_winch_motor"]


def test_a_coarse_tether_that_does_not_buckle_reports_its_push_once():
    plant = SpatialPlant(load_spatial("free_hang", {"tether.buckling": False}))
    state = plant.initial_state()
    slow = PlantCommand(winch=WinchCommand(length=40.0, rate=0.01))
    assert not events_of(plant, state, slow)
    [event] = events_of(plant, state, FAST_PAYOUT)
    rover = plant.scenario.rover
    assert rover is not None
    weight = rover.mass * plant.scenario.gravity
    assert event.name is PlantEvent.TETHER_PUSH
    assert event.values["push"] > event.values["limit"] == pytest.approx(0.25 * weight, rel=1e-3)
