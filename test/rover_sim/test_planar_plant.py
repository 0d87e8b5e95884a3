"""The planar plant implements the protocol of plants."""

import doctest
import math
import threading
import time

import numpy as np
import pytest

import rover_sim
from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from rover_sim import (
    Event,
    FlywheelCommand,
    JumpMotorCommand,
    Outcome,
    PlanarPlant,
    PlantCommand,
    StaticsError,
    WheelRateCommand,
    WinchCommand,
    jump,
    jump_many,
    load_planar,
    load_scenario,
    run,
)

IDLE = PlantCommand()


def plant_of(name: str = "taut_jump", /, **overrides: object) -> PlanarPlant:
    return PlanarPlant(load_scenario(name, {k.replace("__", "."): v for k, v in overrides.items()}))


def test_the_example_of_the_package_runs() -> None:
    assert doctest.testmod(rover_sim).failed == 0


def test_starts_held_at_rest_in_equilibrium() -> None:
    plant = plant_of()
    state = plant.initial_state()
    assert state.phase is PlantPhase.HELD
    after, result = plant.step(state, IDLE, 0.1)
    assert after.time == 0.1
    assert after.phase is PlantPhase.HELD
    assert np.abs(after.nodes - state.nodes).max() < 1e-7
    assert np.array_equal(after.G1, state.G1)
    assert result.outcome is Outcome.CONVERGED
    assert result.events == ()
    assert result.constraint_drift < 1e-12
    assert after.nodes[-1, 0] - after.G1 == pytest.approx([-0.15, -0.05])


def test_a_step_is_pure_and_repeatable() -> None:
    plant = plant_of()
    state = plant.take_off(plant.initial_state())
    nodes = state.nodes.copy()
    first, _ = plant.step(state, IDLE, 0.05)
    second, _ = plant.step(state, IDLE, 0.05)
    assert np.array_equal(state.nodes, nodes)
    assert state.time == 0.0
    assert np.array_equal(first.nodes, second.nodes)
    assert np.array_equal(first.node_rates, second.node_rates)
    assert (first.theta, first.omega, first.s) == (second.theta, second.omega, second.s)
    with pytest.raises(ValueError, match="read-only"):
        state.nodes[0, 0, 0] = 1.0


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 0.0123, 0.0305])
def test_ticks_of_any_length_end_on_time_and_nearly_at_the_same_place(dt: float) -> None:
    plant = plant_of()
    start = plant.take_off(plant.initial_state())
    whole, _ = plant.step(start, IDLE, 0.1)
    parts = run(plant, start, 0.1, tick=dt).final
    assert parts.time == pytest.approx(0.1, abs=1e-12)
    assert np.abs(whole.G1 - parts.G1).max() < 2e-7
    assert whole.theta == pytest.approx(parts.theta, abs=3e-6)


@pytest.mark.parametrize("dt", [0.0, -0.01, math.nan, math.inf])
def test_bad_ticks_are_refused(dt: float) -> None:
    plant = plant_of()
    with pytest.raises(ValueError, match="dt"):
        plant.step(plant.initial_state(), IDLE, dt)


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (PlantCommand(jump=JumpMotorCommand(math.nan, 0.1)), "compression"),
        (PlantCommand(jump=JumpMotorCommand(-0.1, 0.1)), "compression"),
        (PlantCommand(jump=JumpMotorCommand(0.1, 0.0)), "rate"),
        (PlantCommand(jump=JumpMotorCommand(0.1, math.inf)), "rate"),
        (PlantCommand(jump=JumpMotorCommand(0.1, 0.1, max_force=80.0)), "max_force"),
        (PlantCommand(jump=FlywheelCommand(0.1)), "flywheel"),
        (PlantCommand(winch=WinchCommand(1.0, 0.1)), "winch"),
        (PlantCommand(wheel=WheelRateCommand(1.0)), "wheel"),
    ],
)
def test_bad_commands_are_refused_and_nothing_moves(command: PlantCommand, name: str) -> None:
    plant = plant_of()
    state = plant.initial_state()
    with pytest.raises(ValueError, match=name):
        plant.step(state, command, 0.01)
    assert state.time == 0.0


# -------------------------------------------------------------------------------- the jump


def test_the_drive_compresses_at_its_rate_and_trips_the_latch_inside_a_tick() -> None:
    plant = plant_of("paper_table1_high", integration__h=1e-3)
    state = plant.initial_state()
    command = PlantCommand(jump=JumpMotorCommand(compression=0.2, rate=0.05))
    state, result = plant.step(state, command, 1.0)
    assert state.compression == pytest.approx(0.05)
    assert state.phase is PlantPhase.HELD
    state, result = plant.step(state, IDLE, 0.5)
    assert state.compression == pytest.approx(0.05)
    state, result = plant.step(state, command, 2.95)
    assert state.compression == pytest.approx(0.1975)
    assert result.events == ()
    state, result = plant.step(state, command, 0.1)
    assert [event.name for event in result.events] == [PlantEvent.TAKE_OFF]
    assert result.events[0].time == pytest.approx(4.5, abs=1e-9)
    assert result.events[0].values["speed"] == pytest.approx(0.2 * math.sqrt(824 / 5))
    assert state.phase is PlantPhase.FLIGHT
    assert state.compression == 0.0
    assert state.time == pytest.approx(4.55)


def test_the_latch_holds_at_the_setpoint_until_it_is_commanded_to_trip() -> None:
    plant = plant_of("paper_table1_high")
    held = PlantCommand(jump=JumpMotorCommand(compression=0.1, rate=0.2, trips=False))
    state, result = plant.step(plant.initial_state(), held, 1.0)
    assert (state.compression, state.phase, result.events) == (0.1, PlantPhase.HELD, ())
    trips = PlantCommand(jump=JumpMotorCommand(compression=0.1, rate=0.2))
    state, result = plant.step(state, trips, 0.01)
    assert [event.name for event in result.events] == [PlantEvent.TAKE_OFF]
    assert result.events[0].time == pytest.approx(1.0, abs=1e-9)


def test_a_commanded_jump_is_the_same_as_a_direct_one() -> None:
    plant = plant_of("paper_table1_high", start__geometry="+K", start__slack=2.0)
    direct = jump(plant)
    command = PlantCommand(jump=JumpMotorCommand(compression=0.2, rate=0.5))
    state = plant.initial_state()
    events: list[Event] = []
    for _ in range(200):
        sent = command if state.phase is PlantPhase.HELD else IDLE
        state, result = plant.step(state, sent, 0.0073)
        events += result.events
    assert [event.name for event in events] == [
        PlantEvent.TAKE_OFF,
        PlantEvent.APEX,
        PlantEvent.TOUCHDOWN,
    ]
    assert events[0].time == pytest.approx(0.4, abs=1e-9)
    touchdown = events[2].values
    assert touchdown["height"] == pytest.approx(direct.height, abs=1e-5)
    assert touchdown["attitude_variation"] == pytest.approx(direct.attitude_variation, abs=1e-3)
    assert touchdown["flight_time"] == pytest.approx(direct.flight_time, abs=1e-4)
    assert events[1].values["height"] == touchdown["height"]
    assert abs(plant.energies(state).drift) < 1e-6


def test_the_drive_may_go_back_without_a_jump() -> None:
    plant = plant_of("paper_table1_high")
    state, _ = plant.step(plant.initial_state(), PlantCommand(jump=JumpMotorCommand(0.2, 0.1)), 1.0)
    assert state.compression == pytest.approx(0.1)
    state, result = plant.step(state, PlantCommand(jump=JumpMotorCommand(0.0, 0.1)), 2.0)
    assert state.compression == 0.0
    assert state.phase is PlantPhase.HELD
    assert result.events == ()


def test_landing_stops_the_rover_where_it_came_down_and_it_can_jump_again() -> None:
    plant = plant_of("paper_table1_high")
    first = run(plant, plant.take_off(plant.initial_state()), 2.0, until="touchdown").final
    assert first.phase is PlantPhase.LANDED
    assert first.G1[1] == pytest.approx(first.take_off.G1[1], abs=1e-12)
    assert first.omega == 0.0
    assert first.G1_rate.tolist() == [0.0, 0.0]
    later, _ = plant.step(first, IDLE, 0.2)
    assert np.array_equal(later.G1, first.G1)
    assert later.theta == first.theta
    assert abs(plant.energies(later).drift) < 1e-6
    second = run(plant, plant.take_off(later), 2.0, until="touchdown")
    touchdown = second.event("touchdown")
    assert touchdown is not None
    assert touchdown.values["height"] == pytest.approx(0.33, abs=0.02)
    assert abs(second.energy_drift) < 1e-6


def test_a_start_without_the_requested_shape_is_refused_as_statics() -> None:
    start = {"start.chord": 1e-15, "start.initial_shape": "arc"}
    plant = PlanarPlant(load_planar("taut_jump", start))
    with pytest.raises(StaticsError, match="taut_jump: no initial shape: distance"):
        plant.initial_state()


def test_flying_on_after_landing_passes_through_the_starting_height() -> None:
    plant = plant_of("paper_table1_high", after_landing="fly_on")
    history = run(plant, plant.take_off(plant.initial_state()), 0.7)
    assert history.final.phase is PlantPhase.FLIGHT
    assert history.final.G1[1] < history.final.take_off.G1[1] - 0.1
    assert [event.name for event in history.events] == [PlantEvent.APEX, PlantEvent.TOUCHDOWN]


def test_events_are_located_to_better_than_the_step() -> None:
    """A nearly free rover: apex and touchdown of a parabola, at coarse time steps."""
    weightless: dict[str, object] = {
        "tether__youngs_modulus": None,
        "tether__radius": None,
        "tether__density": None,
        "tether__axial_stiffness": 1e-3,
        "tether__bending_stiffness": 1e-10,
        "tether__line_density": 1e-9,
        "tether__axial_damping_time": 0.0,
        "start__chord": 2.0,
    }
    plant = plant_of(integration__h=0.01, **weightless)
    history = run(plant, plant.take_off(plant.initial_state()), 1.0, tick=0.05)
    apex, touchdown = history.event("apex"), history.event("touchdown")
    assert apex is not None
    assert touchdown is not None
    assert apex.time == pytest.approx(2.0 / 9.81, abs=1e-7)
    assert apex.values["height"] == pytest.approx(2.0**2 / 2 / 9.81, abs=1e-7)
    assert touchdown.time == pytest.approx(4.0 / 9.81, abs=1e-7)


def test_event_instants_converge_with_the_time_step() -> None:
    def instants(h: float) -> np.ndarray:
        plant = plant_of(integration__h=h, integration__tolerance=1e-12)
        history = run(plant, plant.take_off(plant.initial_state()), 0.5)
        return np.array([history.event(name).time for name in ("apex", "touchdown")])  # type: ignore[union-attr]

    coarse, fine = instants(1e-3), instants(2.5e-4)
    assert coarse == pytest.approx(fine, abs=1e-6)


def test_broken_tether_is_an_event_and_an_end() -> None:
    limit = 0.5 * jump(plant_of()).peak_tension
    assert limit > 1.0
    plant = plant_of(tether__breaking_load=limit)
    history = run(plant, plant.take_off(plant.initial_state()), 1.0)
    assert history.final.phase is PlantPhase.TETHER_BROKEN
    assert history.results[-1].outcome is Outcome.TETHER_BROKEN
    event = history.events[-1]
    assert event.name == PlantEvent.TETHER_BROKEN
    assert event.values["tension"] > limit
    assert all(result.peak_tension <= limit for result in history.results[:-1])
    again, result = plant.step(history.final, IDLE, 0.1)
    assert again is history.final
    assert result.outcome is Outcome.TETHER_BROKEN


def test_take_off_needs_a_rover_on_the_ground() -> None:
    plant = plant_of()
    flying = plant.take_off(plant.initial_state())
    with pytest.raises(ValueError, match="flight"):
        plant.take_off(flying)
    bare = plant_of("tether_pendulum")
    with pytest.raises(ValueError, match="free"):
        bare.take_off(bare.initial_state())


def test_the_input_of_a_take_off_is_the_energy_of_bodies_and_tether_tip() -> None:
    plant = plant_of("paper_table1_high")
    state = plant.take_off(plant.initial_state())
    energies = plant.energies(state)
    assert energies.input == pytest.approx(0.5 * 824 * 0.2**2, rel=1e-3)
    assert energies.drift == pytest.approx(0.0, abs=1e-12)
    assert energies.kinetic == pytest.approx(energies.input)


# --------------------------------------------------------------------------------- tensions


def test_tension_of_the_hanging_tether_is_its_weight() -> None:
    plant = plant_of("tether_with_weight", start__direction=-90.0, tip__mass=2.0)
    section = plant.section
    state = plant.initial_state()
    damped = PlanarPlant(
        load_scenario(
            "tether_with_weight",
            {
                "start.direction": -90.0,
                "tip.mass": 2.0,
                "tether.axial_damping_time": 0.05,
                "tether.bending_damping_time": 0.0,
            },
        )
    )
    state = run(damped, state, 4.0, tick=0.5).final
    tension = plant.tension(state)
    x = np.linspace(0.0, plant.scenario.tether.length, tension.size)
    below = 2.0 + section.line_density * (plant.scenario.tether.length - x)
    assert tension == pytest.approx(below * plant.scenario.gravity, rel=2e-4)


# ------------------------------------------------------------------------- speed of the rest


def test_a_step_releases_the_interpreters_lock() -> None:
    plant = plant_of("tether_pendulum", tether__elements=50)
    state = plant.initial_state()
    plant.step(state, IDLE, 0.01)
    beats: list[float] = []
    stop = threading.Event()

    def beat() -> None:
        while not stop.is_set():
            beats.append(time.monotonic())
            stop.wait(0.001)

    other = threading.Thread(target=beat)
    other.start()
    begin = time.monotonic()
    plant.step(state, IDLE, 3.0)
    end = time.monotonic()
    stop.set()
    other.join()
    assert sum(begin < beat < end for beat in beats) > 5


def test_jumps_do_not_depend_on_the_number_of_threads() -> None:
    scenarios = [
        load_planar("paper_table1_high", {"start.slack": slack, "tether.breaking_load": load})
        for slack, load in ((0.6, 1e3), (1.0, 1e3), (2.0, 0.1))
    ]
    one, two = jump_many(scenarios), jump_many(scenarios, workers=2)
    assert one[:2] == two[:2]
    assert one[0] == jump(PlanarPlant(scenarios[0]))
    assert isinstance(one[2], rover_sim.RunError)
    assert "tether_broken" in str(two[2])
