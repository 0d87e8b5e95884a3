"""Laws of a tether without winch and rover: air, natural curvature, driven ends, point masses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.optimize import brentq
from scipy.special import fresnel

from rover_sim import PlantCommand, SpatialPlant, SpatialState, StepResult, load_spatial
from rover_sim.physics.tether.ancf import Array
from rover_verify.checks import worst_of

_TICK = 0.01  # [s]
_GRAVITY = 9.81  # [m/s^2]
_WIRE: Mapping[str, object] = {
    "axial_stiffness": 500.0,
    "bending_stiffness": 0.01,
    "line_density": 0.05,
    "axial_damping_time": 0.005,
    "bending_damping_time": 0.05,
    "twist_stiffness": 0.008,
}


def _plant(tether: Mapping[str, object], *parts: Mapping[str, object]) -> SpatialPlant:
    """A tether in space with a pinned root and a free tip, and overrides."""
    overrides: dict[str, object] = {
        "winch": None,
        "rover": None,
        "environment.gravity": _GRAVITY,
        "tether": {"contact": None, **_WIRE, **tether},
    }
    for part in parts:
        overrides.update(part)
    return SpatialPlant(load_spatial("free_hang", overrides))


def _run(
    plant: SpatialPlant, state: SpatialState, duration: float
) -> tuple[SpatialState, StepResult]:
    """State after a duration, and the last result."""
    result = None
    for _ in range(round(duration / _TICK)):
        state, result = plant.step(state, PlantCommand(), _TICK)
    assert result is not None
    return state, result


def _distances(places: Array) -> Array:
    return np.asarray(np.linalg.norm(places[:, None] - places[None, :], axis=2))


def _resting(curvature: list[list[float]], length: float, elements: int) -> Array:
    """Distances between the nodes of a weightless tether at rest [m]."""
    plant = _plant(
        {"length": length, "elements": elements, "natural_curvature": {"rows": curvature}},
        {
            "environment.gravity": 0.0,
            "start": {"kind": "hanging", "settling_time": 300.0, "residual_speed": 1e-6},
        },
    )
    return _distances(plant.initial_state().nodes[:, 0])


# --------------------------------------------------------------------------------- air


@worst_of("{runs} winds, speeds and headings at random", 3)
def wind(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Distance of the tip from where the drag of a wind balances the weight, over the length."""
    speed, heading = generator.uniform(2.0, 6.0), generator.uniform(-math.pi, math.pi)
    diameter, density, length = 0.01, 1.2, 3.0
    weight = 0.05 * _GRAVITY
    drag = 0.5 * density * diameter * 1.1 * speed**2
    angle = brentq(lambda a: weight * math.sin(a) - drag * math.cos(a) ** 2, 0.0, 0.5 * math.pi)
    across = [math.cos(heading), math.sin(heading), 0.0]
    direction = [math.sin(angle) * each for each in across[:2]] + [-math.cos(angle)]
    air = {
        "diameter": diameter,
        "density": density,
        "axial_coefficient": 0.0,
        "wind": [speed * each for each in across],
    }
    plant = _plant(
        {"length": length, "elements": 12, "axial_stiffness": 2e4, "bending_stiffness": 1e-4},
        {"environment.air": air, "start": {"kind": "straight", "direction": direction}},
    )
    state, _ = _run(plant, plant.initial_state(), 2.0)
    off = float(np.linalg.norm(state.nodes[-1, 0] - length * np.array(direction)))
    yield f"{speed:.2f} m/s, {math.degrees(angle):.0f} deg", off / length


# ------------------------------------------------------------------------- natural curvature


@worst_of("{runs} uniform curvatures at random", 3)
def circle(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Error of the nodes' distances on a circle, over the length."""
    length, elements = 1.5, 40
    size, angle = generator.uniform(0.5, 3.0), generator.uniform(-math.pi, math.pi)
    found = _resting([[0.0, size * math.cos(angle), size * math.sin(angle)]], length, elements)
    arcs = np.linspace(0.0, length, elements + 1)
    chords = 2.0 / size * np.abs(np.sin(0.5 * size * (arcs[:, None] - arcs[None, :])))
    yield f"{size:.2f} 1/m", float(np.abs(found - chords).max()) / length


@worst_of("{runs} linear curvatures at random", 3)
def clothoid(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Error of the nodes' distances where the curvature is linear along the tether."""
    length, elements = 1.5, 40
    start, slope = generator.uniform(-2.0, 1.0), generator.uniform(1.0, 3.0)
    angle = generator.uniform(-math.pi, math.pi)
    rows = [
        [place, size * math.cos(angle), size * math.sin(angle)]
        for place, size in ((0.0, start), (length, start + slope * length))
    ]
    found = _resting(rows, length, elements)
    scale = math.sqrt(slope / math.pi)
    sine, cosine = fresnel(scale * (np.linspace(0.0, length, elements + 1) + start / slope))
    shape = np.stack([cosine, sine], axis=1) / scale
    error = float(np.abs(found - _distances(shape)).max())
    yield f"{start:.2f} 1/m + {slope:.2f} 1/m2 s", error / length


@worst_of("{runs} falling tethers, curvatures along them at random", 3)
def coiled_motion(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Residual of the energy balance of a falling coiled tether, over the released energy."""
    rows = [[place, *generator.uniform(-2.0, 2.0, 2).tolist()] for place in (0.0, 0.7, 1.5)]
    plant = _plant(
        {
            "length": 1.5,
            "elements": 15,
            "natural_curvature": {"rows": rows},
            "axial_damping_time": 0.0,
            "bending_damping_time": 0.0,
        },
        {"start": {"kind": "straight", "direction": [1.0, 1.0, 0.0]}},
    )
    _, result = _run(plant, plant.initial_state(), 1.0)
    energies = result.energies
    yield f"{rows[1][1]:.2f} 1/m", abs(energies.drift) / abs(energies.gravity)


# ------------------------------------------------------------------ driven ends, point masses


@worst_of("{runs} loads and heights at random", 3)
def raised_load(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Relative error of the work of a driven root that raises tether and load."""
    mass, height = generator.uniform(0.2, 2.0), generator.uniform(0.2, 0.6)
    length, density, duration = 2.0, 0.05, 2.0
    times = np.linspace(0.0, duration, 41)
    rises = 0.5 * height * (1.0 - np.cos(math.pi * times / duration))
    rows = [
        [time, 0.0, 0.0, rise] for time, rise in zip(times.tolist(), rises.tolist(), strict=True)
    ]
    plant = _plant(
        {"length": length, "elements": 8, "axial_stiffness": 2e4, "axial_damping_time": 0.02},
        {"tip": {"mass": mass}, "root": {"rows": rows}},
    )
    _, result = _run(plant, plant.initial_state(), duration + 1.0)
    exact = (mass + density * length) * _GRAVITY * height
    yield f"{mass:.2f} kg by {height:.2f} m", abs(result.energies.driven_ends / exact - 1.0)


@worst_of("{runs} masses and directions at random", 3)
def carried_mass(_index: int, generator: np.random.Generator) -> Iterator[tuple[str, float]]:
    """Distance between the tips of a tether with a point mass at its end, and with such a tip."""
    mass = generator.uniform(0.1, 2.0)
    level = {"start": {"kind": "straight", "direction": generator.normal(size=3).tolist()}}
    places = []
    for tether, tip in (
        ({"masses": [{"position": 2.0, "mass": mass}]}, {}),
        ({}, {"tip": {"mass": mass}}),
    ):
        plant = _plant({"length": 2.0, "elements": 8, **tether}, level, tip)
        state, _ = _run(plant, plant.initial_state(), 0.5)
        places.append(state.tip)
    yield f"{mass:.2f} kg", float(np.linalg.norm(places[0] - places[1]))
