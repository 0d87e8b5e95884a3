"""The tether alone: statics against closed forms, motion against independent codes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.optimize import fsolve

from rover_sim import PlanarPlant, load_scenario, run
from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.starting_shapes import straight_nodes
from rover_sim.physics.tether.statics import nodal_forces, static_equilibrium
from rover_sim.physics.tether.tether_section import TetherSection
from rover_verify.checks import CheckBatch, Measured, worst_of

_NO_GRAVITY = (0.0, 0.0)
_BEAM = TetherSection(axial_stiffness=1e6, bending_stiffness=1.0, line_density=1.0)
_TABLE_1_HIGH = TetherSection.round(0.5e9, 3.45e-4, 1e4)

# Tip-loaded elastica, P L^2 / EI -> w/L, u/L (Bisshopp and Drucker 1945, Q. Appl. Math. 3).
_ELASTICA = {1.0: (0.30172, 0.05643), 3.0: (0.60325, 0.25442), 10.0: (0.81061, 0.55500)}

# Free-falling flexible beam of 1.2 m, tip [m] at t [s], 32 elements of model L2/T1, another code.
_BEAM_TIPS = {0.3: (1.0743, -0.4414), 0.5: (0.363, -1.215), 0.6: (-0.364, -1.205)}

# Damped tether pendulum, tip [m] at t [s], 80 elements, another code.
_PENDULUM_TIPS = {
    0.5: (4.55926, -1.22625),
    1.0: (0.74461, -4.94796),
    1.5: (-4.17137, -2.62582),
    2.0: (-4.60765, -1.02601),
}

# Sag of 5 m between (0, 0) and (4, 1): closed form with elastic stretch.
_SAG_HORIZONTAL, _SAG_ENDS = 0.0651011, (0.0949152, 0.1315753)


@worst_of("{runs} random positions, angles and meshes")
def rigid_rotation(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Largest nodal force of an unstretched tether at random angles, relative to EA."""
    angle = generator.uniform(-math.pi, math.pi)
    root = generator.uniform(-5.0, 5.0, 2)
    tip = root + np.array([math.cos(angle), math.sin(angle)])
    nodes = straight_nodes(root, tip, int(generator.integers(1, 40)), 1.0)
    force = nodal_forces(nodes, _BEAM, 1.0, _NO_GRAVITY)
    yield f"{len(nodes) - 1} elements", float(np.max(np.abs(force))) / _BEAM.axial_stiffness


def closed_circle(_batch: CheckBatch) -> Measured:
    """Gap between root and tip under the end moment 2 pi EI / L."""
    nodes = static_equilibrium(
        _BEAM, 1.0, 32, _NO_GRAVITY, (0.0, 0.0), root_slope=(1.0, 0.0), tip_moment=2.0 * math.pi
    )
    diameter = float(nodes[16, 0, 1])
    return Measured(
        float(np.linalg.norm(nodes[-1, 0])),
        "32 elements, L = 1 m",
        {"diameter [m]": diameter, "diameter of the circle [m]": 1.0 / math.pi},
    )


def elastica(_batch: CheckBatch) -> Measured:
    """Largest deviation from the tip-loaded elastica, relative to the length."""
    details = {}
    for load, (deflection, shortening) in _ELASTICA.items():
        tip = static_equilibrium(
            _BEAM, 1.0, 32, _NO_GRAVITY, (0.0, 0.0), root_slope=(1.0, 0.0), tip_force=(0.0, -load)
        )[-1, 0]
        off = max(abs(-tip[1] - deflection), abs(1.0 - tip[0] - shortening))
        details[f"P L^2/EI = {load:g}"] = float(off)
    return Measured.largest(details, "32 elements, three loads")


def sag(_batch: CheckBatch) -> Measured:
    """Largest relative deviation of forces and lowest point from the elastic catenary."""
    gravity = (0.0, -9.81)
    nodes = static_equilibrium(_TABLE_1_HIGH, 5.0, 20, gravity, (0.0, 0.0), (4.0, 1.0))
    support = nodal_forces(nodes, _TABLE_1_HIGH, 5.0, gravity)
    first, last = support[0, 0], support[-1, 0]
    deviations = {
        "horizontal force": abs(float(last[0])) / _SAG_HORIZONTAL - 1.0,
        "tension at the lower end": float(np.linalg.norm(first)) / _SAG_ENDS[0] - 1.0,
        "tension at the upper end": float(np.linalg.norm(last)) / _SAG_ENDS[1] - 1.0,
    }
    return Measured.largest(deviations, "5 m between (0, 0) and (4, 1) m, 20 elements")


def sag_shape(_batch: CheckBatch) -> Measured:
    """Largest distance of a node from the elastic catenary, which has no bending stiffness."""
    span, rise, length, elements = 4.0, 1.0, 5.0, 20
    nodes = static_equilibrium(
        _TABLE_1_HIGH, length, elements, (0.0, -9.81), (0.0, 0.0), (span, rise)
    )
    weight, stiffness = _TABLE_1_HIGH.line_density * 9.81, _TABLE_1_HIGH.axial_stiffness

    def position(s: ancf.Array, across: float, up: float) -> ancf.Array:
        """Closed form by arc length from the tension's components at the root (Irvine 1981)."""
        vertical = up + weight * s
        x = across * s / stiffness
        x = x + across / weight * (np.arcsinh(vertical / across) - math.asinh(up / across))
        y = s * (up + weight * s / 2.0) / stiffness
        y = y + (np.hypot(across, vertical) - math.hypot(across, up)) / weight
        return np.stack([x, y], axis=-1)

    def miss(unknown: ancf.Array) -> ancf.Array:
        end = position(np.array(length), float(unknown[0]), float(unknown[1]))
        return np.asarray(end - np.array([span, rise]))

    across, up = fsolve(miss, [_SAG_HORIZONTAL, -weight * length / 3.0], xtol=1e-13)
    chain = position(np.linspace(0.0, length, elements + 1), float(across), float(up))
    distance = np.linalg.norm(nodes[:, 0] - chain, axis=1)
    lowest = chain[np.argmin(chain[:, 1])]
    return Measured(
        float(np.max(distance)),
        f"{elements} elements",
        {
            "lowest node of the chain, y [m]": float(lowest[1]),
            "horizontal force [N]": float(across),
        },
    )


def _tip_deviation(plant: PlanarPlant, tips: dict[float, tuple[float, float]]) -> Measured:
    state, details = plant.initial_state(), {}
    for time, expected in tips.items():
        state = run(plant, state, time - state.time).final
        off = float(np.linalg.norm(state.nodes[-1, 0] - np.array(expected)))
        details[f"tip at {time:g} s [m]"] = off
    return Measured.largest(details, f"n = {plant.scenario.tether.elements}")


def flexible_beam(_batch: CheckBatch) -> Measured:
    """Largest distance of the falling beam's tip from the independent code's."""
    scenario = load_scenario("flexible_beam", {"integration.h": 2.5e-4})
    return _tip_deviation(PlanarPlant(scenario), _BEAM_TIPS)


def damped_pendulum(_batch: CheckBatch) -> Measured:
    """Largest distance of the damped tether's tip from the independent code's, through the whip."""
    overrides = {"tether.elements": 80, "integration.h": 5e-4}
    scenario = load_scenario("tether_pendulum_damped", overrides)
    return _tip_deviation(PlanarPlant(scenario), _PENDULUM_TIPS)


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
