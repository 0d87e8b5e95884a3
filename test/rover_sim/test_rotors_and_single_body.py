"""Rotors with a prescribed momentum, a single body, and a slider off the centre: closed forms."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from msg_schemas import machine, topics
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue
from rover_sim import (
    FlywheelCommand,
    JumpMotorCommand,
    Outcome,
    PlantCommand,
    ScenarioError,
    SpatialPlant,
    build_plant,
    load_spatial,
    plain_state,
)
from rover_sim.interface.interface_factory import build_interface
from rover_sim.node.sim_loop import Simulation
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.rover import spatial_rover

TICK = 0.02
ACROSS, ALONG = 0.12, 0.08  # moments of inertia of a symmetric body [kg m^2]
IDLE_DRIVES = {
    "rover.jump_drive.inertia": 1.0e-12,
    "rover.wheel_drive.wheel_inertia": 1.0e-12,
    "rover.wheel_drive.motor_inertia": 0.0,
}


def body(changes: dict[str, Any], mass: float = 10.0) -> Any:
    """A scenario with a rover of one symmetric body, without winch."""
    return load_spatial(
        "free_hang",
        {
            **IDLE_DRIVES,
            "winch": None,
            "tether.max_length": None,
            "rover.m1": mass,
            "rover.m2": 0.0,
            "rover.inertia1": [ACROSS, ACROSS, ALONG],
            "tether.twist_stiffness": 0.0,
            **changes,
        },
    )


def free_body(rotors: list[dict[str, Any]], spin: tuple[float, float, float]) -> SpatialPlant:
    """A body that turns freely: its tether has neither weight nor stiffness."""
    return SpatialPlant(
        body(
            {
                "rover.rotors": rotors,
                "environment.gravity": 0.0,
                "rover.attachment": [0.0, 0.0, 0.0],
                "tether": {
                    "length": 0.5,
                    "elements": 2,
                    "element_length": None,
                    "max_length": None,
                    "axial_stiffness": 1.0e-16,
                    "bending_stiffness": 1.0e-18,
                    "line_density": 1.0e-16,
                    "twist_stiffness": 0.0,
                },
                "start": {
                    "kind": "straight",
                    "direction": [1.0, 0.0, 0.0],
                    "angular_velocity": spin,
                },
                "integration.tolerance": 1.0e-13,
            }
        )
    )


def test_a_body_with_a_rotor_precesses():
    """In body axes the rate across the rotor turns at ((C - A) w_z + h)/A: Euler's equations."""
    momentum, spin = 0.3, (0.2, 0.0, 0.5)
    plant = free_body([{"axis": [0.0, 0.0, 2.0], "momentum": momentum}], spin)
    state, duration = plant.initial_state(), 4.0
    angular = plant.initial_state().rotation @ _inside(state.omega, momentum)
    for _ in range(round(duration / TICK)):
        state, result = plant.step(state, PlantCommand(), TICK)
    angle = ((ALONG - ACROSS) * spin[2] + momentum) / ACROSS * duration
    turned = spin[0] * np.array([math.cos(angle), math.sin(angle)])
    assert state.omega[:2] == pytest.approx(turned, abs=2e-5)
    assert state.omega[2] == pytest.approx(spin[2], abs=1e-9)
    assert state.rotation @ _inside(state.omega, momentum) == pytest.approx(angular, abs=1e-8)
    assert abs(result.energies.drift) < 1e-9
    assert state.energy_balance["input_rotors"] == 0.0


def _inside(omega: np.ndarray, momentum: float) -> np.ndarray:
    """Angular momentum in body axes."""
    return np.asarray(np.array([ACROSS, ACROSS, ALONG]) * omega + [0.0, 0.0, momentum])


def test_a_driven_rotor_turns_the_body_and_its_work_is_an_input():
    rows = [[0.5, 0.0], [1.5, 0.2], [2.0, 0.1]]
    slow = {"axis": [0.0, 0.0, -1.0], "rows": [[1.0, 0.0], [2.0, 0.02]]}
    plant = free_body([{"axis": [0.0, 0.0, 1.0], "rows": rows}, slow], (0.0, 0.0, 0.3))
    state = plant.initial_state()
    for time, total in ((1.0, 0.1), (1.5, 0.2 - 0.01), (2.5, 0.1 - 0.02)):
        while state.time < time - 1e-9:
            state, result = plant.step(state, PlantCommand(), TICK)
        assert state.omega[2] == pytest.approx(0.3 - total / ALONG, abs=1e-6)
    change = 0.5 * ALONG * (state.omega[2] ** 2 - 0.3**2)
    assert state.energy_balance["input_rotors"] == pytest.approx(change, rel=1e-6)
    assert abs(result.energies.drift) < 1e-9


def test_a_single_body_swings_as_a_double_pendulum():
    length, below, mass, g = 2.0, 0.28, 10.0, 1.62
    plant = build_plant(
        body(
            {
                "tether.length": length,
                "tether.element_length": 0.5,
                "tether.line_density": 1.0e-5,
                "tether.bending_stiffness": 1.0e-7,
                "start": {"kind": "hanging", "swing_angle": 0.5},
            },
            mass,
        )
    )
    state = plant.initial_state()
    stretched = length + mass * g * length / 2.0e4
    inertia = np.array([[stretched, below], [mass * below * stretched, ACROSS + mass * below**2]])
    pull = np.diag([g, mass * g * below])
    system = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(inertia, pull), np.zeros((2, 2))]]
    )
    swing = math.radians(0.5)
    worst = 0.0
    for k in range(1, 201):
        state, result = plant.step(state, PlantCommand(), TICK)
        tether, tilt = (expm(system * (k * TICK)) @ [swing, swing, 0.0, 0.0])[:2]
        worst = max(worst, abs(state.G1[0] - stretched * tether - below * tilt))
    assert worst < 0.01 * swing * length
    assert state.s == pytest.approx(plant.scenario.rover.slider.free_length)
    assert abs(result.energies.drift) < 1e-6


def test_a_single_body_has_a_flywheel_and_cannot_jump():
    plant = build_plant(body({"rover.jump_drive.inertia": 1.0e-3}))
    state = plant.initial_state()
    with pytest.raises(ValueError, match="single body"):
        plant.step(state, PlantCommand(jump=JumpMotorCommand(0.1, 1.0)), TICK)
    after, _ = plant.step(state, PlantCommand(jump=FlywheelCommand(0.02)), 0.2)
    assert after.flywheel_rate > 1.0
    assert after.omega[0] < -1e-3
    assert plant.model.rover_contact.first_body2_corner == len(plant.model.rover_contact.corners)


def test_the_nut_of_a_single_body_turns_back_at_the_end_of_its_free_travel():
    plant = build_plant(load_spatial("free_hang", {"rover.m2": 0.0}))
    state, result = plant.step(plant.initial_state(), PlantCommand(jump=FlywheelCommand(0.05)), 3.0)
    assert state.latch is Latch.FREE
    assert result.forces.screw_hard_limit == 1
    state, result = plant.step(state, PlantCommand(jump=JumpMotorCommand(-0.03, 0.05)), 3.0)
    assert state.nut == pytest.approx(-0.03, abs=1e-4)
    assert result.outcome is Outcome.CONVERGED
    assert abs(result.energies.drift) < 1e-6


def test_a_command_to_compress_the_spring_of_a_single_body_is_refused():
    plant = build_plant(load_spatial("free_hang", {"rover.m2": 0.0}))
    simulation = Simulation(build_interface(plant, seed=1), TICK)
    for position, allowed in ((0.1, False), (-0.02, True)):
        joints = {
            machine.JUMP_SCREW: JointValue(position, 0.05, 200.0),
            machine.JUMP_LATCH: JointValue(1.0),
        }
        command = topics.JUMP_MOTOR_COMMAND, JointSample(0, joints)
        with contextlib.nullcontext() if allowed else pytest.raises(Refusal, match="stroke of 0 m"):
            simulation.accept_command(*command)
        assert simulation.tick().result.outcome is Outcome.CONVERGED


def test_a_single_body_does_not_start_ready_to_jump():
    with pytest.raises(ScenarioError, match="single body"):
        load_spatial("floor_rubble", {"rover.m2": 0.0, "start.compression": 0.1})


def test_a_rotor_continues_from_a_saved_state_and_settles_with_its_start():
    rows = [[0.0, 0.1], [1.0, 0.2]]
    rotor = {"axis": [0.0, 0.0, 1.0], "rows": rows}
    plant = build_plant(load_spatial("floor_rubble", {"rover.rotors": [rotor]}))
    state = plant.initial_state()
    assert state.body[spatial_rover.ROTORS + 2] == pytest.approx(0.1)
    state, _ = plant.step(state, PlantCommand(), 0.5)
    assert state.body[spatial_rover.ROTORS + 2] == pytest.approx(0.15)
    again, _ = plant.step(plant.restored_state(plain_state(state)), PlantCommand(), 0.5)
    onward, _ = plant.step(state, PlantCommand(), 0.5)
    assert plain_state(again) == plain_state(onward)


@pytest.mark.parametrize(
    ("rotor", "named"),
    [
        ({"axis": [0.0, 0.0, 0.0]}, "axis"),
        ({"axis": [0.0, 0.0, 1.0], "momentum": 1.0, "rows": [[0.0, 1.0]]}, "momentum"),
        ({"axis": [0.0, 0.0, 1.0], "rows": [[0.0, 1.0], [0.0, 2.0]]}, r"rows\[1\]"),
        ({"axis": [0.0, 0.0, 1.0], "rows": [[0.0]]}, r"rows\[0\]"),
    ],
)
def test_a_rotor_that_cannot_be_is_refused(rotor: dict[str, Any], named: str):
    with pytest.raises(ScenarioError, match=named):
        body({"rover.rotors": [rotor]})


# ------------------------------------------------------------- a slider off the centre of mass

OFFSET = (0.05, -0.03)


def test_a_slider_off_the_centre_turns_the_rover_as_its_momentum_has_it():
    """With the reduced mass u, the moment of inertia J and the offset o, the turn from s0 to s is

    sqrt(u) o/A [atan(sqrt(u) s/A)], A^2 = J + u o^2: the angular momentum stays zero.
    """
    offset, m1, m2 = 0.06, 6.0, 4.0
    plant = SpatialPlant(
        dataclasses.replace(
            free_body([], (0.0, 0.0, 0.0)).scenario,
            rover=load_spatial(
                "free_hang",
                {
                    **IDLE_DRIVES,
                    "rover.m1": m1,
                    "rover.m2": m2,
                    "rover.attachment": [0.0, 0.0, 0.0],
                    "rover.slider_offset": [offset, 0.0],
                },
            ).rover,
        )
    )
    rover = plant.scenario.rover
    assert rover is not None
    start = plant.initial_state()
    nodes = plant.to_full_nodes(start)
    state = plant.state_at(nodes, slide=0.1)
    reduced = m1 * m2 / (m1 + m2)
    reach = math.sqrt(rover.inertia[1] + reduced * offset**2)
    middle = rover.centre_of_mass(0.1)

    def swept(slide: float) -> float:
        return math.atan(math.sqrt(reduced) * slide / reach)

    largest = 0.0
    for _ in range(50):
        state, result = plant.step(state, PlantCommand(), TICK)
        pitch = math.atan2(float(state.rotation[0, 2]), float(state.rotation[2, 2]))
        turn = math.sqrt(reduced) * offset / reach * (swept(state.s) - swept(0.1))
        largest = max(largest, abs(turn))
        assert pitch == pytest.approx(turn, abs=2e-6)
        assert abs(result.energies.drift) < 1e-6
        centre = (m1 * state.G1 + m2 * state.centre2(rover)) / (m1 + m2)
        assert centre == pytest.approx(start.G1 + middle, abs=1e-6)
    assert largest > 0.02


def test_a_rover_with_its_slider_off_the_axis_hangs_tilted():
    plant = SpatialPlant(
        load_spatial("free_hang", {"rover.slider_offset": OFFSET, "rover.attachment": [0, 0, 0.2]})
    )
    rover = plant.scenario.rover
    assert rover is not None
    state = plant.initial_state()
    lever = rover.centre_of_mass(state.s) - np.array(rover.attachment)
    assert lever[:2] == pytest.approx(0.4 * np.array(OFFSET))
    assert state.rotation @ lever == pytest.approx([0.0, 0.0, -np.linalg.norm(lever)], abs=1e-9)
    before = state.G1
    state, result = plant.step(state, PlantCommand(), 1.0)
    assert pytest.approx(before, abs=1e-5) == state.G1
    assert abs(result.energies.drift) < 1e-6


def test_a_jump_with_the_slider_off_the_centre_lands_and_conserves_energy():
    straight, askew = (
        SpatialPlant(
            load_spatial(
                "floor_rubble",
                {
                    "environment.relief": None,
                    "environment.boulders": None,
                    "rover.slider_offset": offset,
                    "start.compression": 0.1,
                },
            )
        )
        for offset in ([0.0, 0.0], [-0.02, 0.02])
    )
    for plant, tilts in ((straight, False), (askew, True)):
        state, tilt = plant.initial_state(), 0.0
        for _ in range(40):
            state, result = plant.step(state, PlantCommand(JumpMotorCommand(0.1, 0.05)), 0.05)
            tilt = max(tilt, abs(float(state.rotation[2, 1])))
            assert abs(result.energies.drift) < 5e-3
        assert (tilt > 0.05) == tilts


def test_a_slider_offset_of_a_single_body_is_refused():
    with pytest.raises(ScenarioError, match=r"rover\.slider_offset"):
        body({"rover.slider_offset": [0.1, 0.0]})
