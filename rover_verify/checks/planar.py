"""Random motions of the planar plant: symmetry, conservation, robustness, and the redundant DAE."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from rover_sim import PlanarPlant, PlantCommand, Scenario, load_planar, load_scenario, run
from rover_sim.physics.references.planar_dae import PlanarDae
from rover_sim.physics.tether.starting_shapes import straight_nodes
from rover_sim.physics.tether.statics import nodal_forces
from rover_sim.physics.tether.tether_section import TetherSection
from rover_verify.checks import worst_of

_BEAM = TetherSection(axial_stiffness=1e6, bending_stiffness=1.0, line_density=1.0)
_DAE_DURATION = 0.2  # [s]


@worst_of("{runs} random positions, angles and meshes")
def rigid_rotation(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest nodal force of an unstretched tether at random angles, relative to EA."""
    angle = generator.uniform(-math.pi, math.pi)
    root = generator.uniform(-5.0, 5.0, 2)
    tip = root + np.array([math.cos(angle), math.sin(angle)])
    nodes = straight_nodes(root, tip, int(generator.integers(1, 40)), 1.0)
    force = nodal_forces(nodes, _BEAM, 1.0, (0.0, 0.0))
    yield f"{len(nodes) - 1} elements", float(np.max(np.abs(force))) / _BEAM.axial_stiffness


@worst_of("{runs} random weights, lengths and meshes over 1 s")
def mirror(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest difference of a weight's swing from the mirror image of the mirrored swing."""
    tilt = generator.uniform(5.0, 85.0)
    overrides = {
        "tip.mass": generator.uniform(0.05, 10.0),
        "tether.length": generator.uniform(1.0, 20.0),
        "tether.elements": int(generator.integers(2, 30)),
    }
    ends = []
    for sign in (1.0, -1.0):
        direction = {"start.direction": -90.0 + sign * tilt}
        plant = PlanarPlant(load_scenario("tether_with_weight", {**overrides, **direction}))
        final = run(plant, plant.initial_state(), 1.0, tick=0.5).final
        ends.append(final.nodes * np.array([sign, 1.0]))
    yield f"from {tilt:.1f} deg", float(np.max(np.abs(ends[0] - ends[1])))


def random_jump(generator: np.random.Generator, **fixed: object) -> Scenario:
    """A jump of the Table 1 rover at random: geometry, slack, mesh, stiffness, tilt, stroke."""
    geometry = str(generator.choice(["-H", "-K", "+K"]))
    # -H needs at least dh/df = 0.4899 for its tip to be in reach.
    low = 0.52 if geometry == "-H" else 0.1
    overrides = {
        "start.geometry": geometry,
        "start.slack": float(generator.uniform(low, 3.5)),
        "start.theta0": float(generator.uniform(-15.0, 15.0)),
        "tether.elements": int(generator.integers(3, 31)),
        "tether.youngs_modulus": float(10.0 ** generator.uniform(7.0, math.log10(5e8))),
        "take_off.compression": float(generator.uniform(0.05, 0.25)),
        "rover.m2": float(generator.uniform(0.2, 3.0)),
        **fixed,
    }
    return load_planar("paper_table1_high", overrides)


@worst_of("{runs} random jumps up to 0.5 GPa, 0.5 s at 1 ms")
def energy(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest change of the stored energy over random undamped flights, relative to the jump's."""
    scenario = random_jump(generator, **{"rover.slider_damping": 0.0, "after_landing": "fly_on"})
    plant = PlanarPlant(scenario)
    start = plant.take_off(plant.initial_state())
    flight = run(plant, start, 0.5, tick=0.05)
    stored = np.array([plant.energies(state).stored for state in flight.states])
    change = float(np.max(np.abs(stored - stored[0]))) / scenario.take_off_energy
    yield f"n = {scenario.tether.elements}", change


@worst_of("{runs} random slack jumps over 0.2 s, n = 3..6", 8)
def dae_difference(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest difference [m, rad] of the assembled model from the DAE, h = 1/64 ms."""
    scenario = random_jump(
        generator,
        **{
            "tether.elements": int(generator.integers(3, 7)),
            "tether.axial_damping_time": float(generator.uniform(0.0, 2e-3)),
            "after_landing": "fly_on",
            "integration.h": 1e-3 / 64,
            "integration.tolerance": 1e-12,
        },
    )
    plant, tether = PlanarPlant(scenario), scenario.tether
    start = plant.take_off(plant.initial_state())
    wave = math.sqrt(tether.section.line_density / tether.section.axial_stiffness)
    # Far below the bound that the axial wave sets for the explicit method: it must be exact here.
    count = math.ceil(_DAE_DURATION / min(2.5e-4, 0.03 * tether.length / tether.elements * wave))
    assert scenario.rover is not None
    dae = PlanarDae(
        tether.section, tether.length, tether.elements, scenario.rover, scenario.gravity
    )
    reference = dae.integrate(start, _DAE_DURATION, _DAE_DURATION / count, count)
    state, _ = plant.step(start, PlantCommand(), _DAE_DURATION)
    bodies = np.array([[*state.G1, state.theta], [*state.G2, state.theta]])
    of_nodes = np.abs(state.nodes[:, 0] - reference.nodes[-1, :, 0])
    of_bodies = np.abs(bodies - reference.bodies[-1])
    yield f"n = {tether.elements}", float(max(np.max(of_nodes), np.max(of_bodies)))
