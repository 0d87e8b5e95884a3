"""Jumps against independent codes, and the assembled integrator against the redundant DAE."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from rover_sim import (
    PlanarPlant,
    PlanarState,
    PlantCommand,
    Scenario,
    jump,
    load_planar,
)
from rover_sim.physics.references.planar_dae import PlanarDae
from rover_sim.plants.run import run
from rover_verify.checks import CheckBatch, Measured, worst_of


class _Known(NamedTuple):
    """A jump with H [m] and dtheta [rad] from an independent code (Exudyn with Green's strain)."""

    scenario: str
    geometry: str
    slack: float
    theta0: float
    compression: float
    by_elements: dict[int, tuple[float, float]]


_HIGH, _STIFF = "paper_table1_high", "paper_table2_case1"
_KNOWN = (
    _Known("paper_table1_low", "-H", 1.0, 0.0, 0.2, {5: (0.3355, 0.0070), 20: (0.3353, 0.0109)}),
    _Known(_HIGH, "-H", 0.5, 0.0, 0.2, {5: (0.3359, -0.0186), 20: (0.3359, -0.0195)}),
    _Known(_HIGH, "+K", 2.0, 0.0, 0.2, {5: (0.3085, 0.6600), 20: (0.3084, 0.6615)}),
    _Known(_STIFF, "-H", 1.0, -10.0, 0.29, {5: (0.3262, 0.0022), 20: (0.3262, 0.0026)}),
    _Known(_STIFF, "+K", 2.0, 0.0, 0.2, {5: (0.1093, 1.6635), 20: (0.1090, 1.6660)}),
)

# Taut jump, converged in mesh and step by another code: H, dtheta, dx, flight time; and Body 1 (x,
# y, theta) at 0.3 s.
_TAUT = {
    "height": 0.20415, "attitude_variation": -0.17281, "travel": 0.38128, "flight_time": 0.41168,
}  # fmt: skip
_TAUT_AT_300_MS = (4.82477, -1.98151, -0.04219)

_DAE_DURATION = 0.2


def known(_batch: CheckBatch, metric: Literal["height", "attitude_variation"]) -> Measured:
    """Largest deviation of a metric [m, rad] from the independent code in its jumps."""
    details = {}
    for known in _KNOWN:
        for elements, (height, attitude) in known.by_elements.items():
            overrides = {
                "start.geometry": known.geometry,
                "start.slack": known.slack,
                "start.theta0": known.theta0,
                "take_off.compression": known.compression,
                "tether.elements": elements,
            }
            metrics = jump(PlanarPlant(load_planar(known.scenario, overrides)))
            name = f"{known.scenario} {known.geometry} s = {known.slack:g}, n = {elements}"
            expected = height if metric == "height" else attitude
            details[name] = getattr(metrics, metric) - expected
    return Measured.largest(details, f"{len(details)} jumps")


def taut(_batch: CheckBatch) -> Measured:
    """Largest deviation of the taut jump's metrics from the other code's, on three meshes."""
    details = {}
    for elements in (10, 20, 40):
        metrics = jump(PlanarPlant(load_planar("taut_jump", {"tether.elements": elements})))
        for name, expected in _TAUT.items():
            details[f"{name}, n = {elements}"] = getattr(metrics, name) - expected
    return Measured.largest(details, "lengths [m], angle [rad], time [s]")


def taut_path(_batch: CheckBatch) -> Measured:
    """Deviation of Body 1 at 0.3 s of the taut jump from the other code."""
    plant = PlanarPlant(load_planar("taut_jump", {"integration.h": 5e-4}))
    state = run(plant, plant.take_off(plant.initial_state()), 0.3).final
    difference = np.array([*state.G1, state.theta]) - np.array(_TAUT_AT_300_MS)
    names = ("x [m]", "y [m]", "theta [rad]")
    details = {name: float(value) for name, value in zip(names, difference, strict=True)}
    return Measured.largest(details, "n = 20")


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
    return load_planar(_HIGH, overrides)


def _difference_from_dae(scenario: Scenario, steps: tuple[float, ...]) -> list[float]:
    """Largest difference [m, rad] of the assembled model at several steps from the DAE."""
    plant = PlanarPlant(scenario)
    start = plant.take_off(plant.initial_state())
    element = scenario.tether.length / scenario.tether.elements
    section = scenario.tether.section
    wave = math.sqrt(section.line_density / section.axial_stiffness)
    # Far below the bound that the axial wave sets for the explicit method: it must be exact here.
    h = _DAE_DURATION / math.ceil(_DAE_DURATION / min(2.5e-4, 0.03 * element * wave))
    count = round(_DAE_DURATION / h)
    assert scenario.rover is not None
    dae = PlanarDae(
        section, scenario.tether.length, scenario.tether.elements, scenario.rover, scenario.gravity
    )
    reference = dae.integrate(start, _DAE_DURATION, h, count)
    bodies = reference.bodies[-1]
    found = []
    for step in steps:
        fine = PlanarPlant(
            scenario.with_overrides({"integration.h": step, "integration.tolerance": 1e-12})
        )
        state: PlanarState
        state, _ = fine.step(start, PlantCommand(), _DAE_DURATION)
        ours = np.array([[*state.G1, state.theta], [*state.G2, state.theta]])
        of_nodes = np.abs(state.nodes[:, 0] - reference.nodes[-1, :, 0])
        found.append(float(max(np.max(of_nodes), np.max(np.abs(ours - bodies)))))
    return found


@worst_of("{runs} random slack jumps over 0.2 s, n = 3..6", 8)
def dae_difference(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest difference between assembled model and DAE over random jumps, h = 1/64 ms."""
    scenario = random_jump(
        generator,
        **{
            "tether.elements": int(generator.integers(3, 7)),
            "tether.axial_damping_time": float(generator.uniform(0.0, 2e-3)),
            "after_landing": "fly_on",
        },
    )
    (difference,) = _difference_from_dae(scenario, (1e-3 / 64,))
    yield f"n = {scenario.tether.elements}", difference


def dae_order(_batch: CheckBatch) -> Measured:
    """Smallest order at which the difference from the DAE falls with the step."""
    cases: dict[str, tuple[str, dict[str, object]]] = {
        "soft and slack": ("paper_table1_low", {"start.geometry": "+K", "start.slack": 2.0}),
        "taut": ("taut_jump", {"tether.elements": 8}),
    }
    orders = {}
    for name, (scenario, overrides) in cases.items():
        steps = (5e-4, 2.5e-4, 1.25e-4)
        differences = _difference_from_dae(load_planar(scenario, overrides), steps)
        for coarse, order in zip(differences, orders_of(differences), strict=False):
            orders[f"{name}, from {coarse:.1e} m"] = order
    return Measured(min(orders.values()), "two jumps over 0.2 s, h = 0.5 to 0.125 ms", orders)


def orders_of(errors: Sequence[float]) -> list[float]:
    """Order of convergence from each error to the next, where the step or the mesh is halved."""
    return [math.log2(coarse / fine) for coarse, fine in itertools.pairwise(errors)]


def _changes(solutions: Sequence[np.ndarray]) -> dict[str, float]:
    """Distance of each solution from the one before."""
    return {
        f"change {index} [m, rad]": float(np.linalg.norm(after - before))
        for index, (before, after) in enumerate(itertools.pairwise(solutions), 1)
    }


def order_in_time(_batch: CheckBatch) -> Measured:
    """Order of convergence of the taut jump in the time step."""
    ends = []
    for h in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        overrides = {"integration.h": h, "integration.tolerance": 1e-11}
        plant = PlanarPlant(load_planar("taut_jump", overrides))
        state, _ = plant.step(plant.take_off(plant.initial_state()), PlantCommand(), 0.3)
        ends.append(np.array([*state.G1, state.theta]))
    changes = _changes(ends)
    order = orders_of(list(changes.values()))[-1]
    return Measured(order, "taut jump, 0.3 s, h = 1 to 0.125 ms", changes)


def order_in_elements(_batch: CheckBatch) -> Measured:
    """Mean order of convergence of the free tether's fall in the number of elements."""
    tips = []
    for elements in (5, 10, 20, 40):
        plant = PlanarPlant(load_planar("tether_pendulum", {"tether.elements": elements}))
        state, _ = plant.step(plant.initial_state(), PlantCommand(), 0.8)
        tips.append(state.nodes[-1, 0])
    changes = _changes(tips)
    order = float(np.mean(orders_of(list(changes.values()))))
    return Measured(order, "undamped tether pendulum at 0.8 s, n = 5 to 40", changes)


def unrelaxed_scatter(_batch: CheckBatch) -> Measured:
    """Spurious axial energy of an unrelaxed catenary at n = 5 over that of the static tether."""
    stored = {}
    for shape in ("catenary", "static"):
        overrides = {
            "start.geometry": "-H",
            "start.slack": 3.5,
            "start.initial_shape": shape,
            "tether.elements": 5,
        }
        plant = PlanarPlant(load_planar(_STIFF, overrides))
        stored[shape] = plant.energies(plant.initial_state()).axial
    details = {f"axial energy, {shape} [J]": energy for shape, energy in stored.items()}
    return Measured(stored["catenary"], "-H, s = 3.5, 70 GPa, n = 5; the jump has 16.5 J", details)
