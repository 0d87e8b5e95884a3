"""A scenario's tether with natural curvature: rest shapes, energy, twist, payout, saved states."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.special import fresnel

from rover_sim import (
    PlantCommand,
    ScenarioError,
    SpatialPlant,
    SpatialState,
    StepResult,
    WinchCommand,
    build_plant,
    load_spatial,
    plain_state,
)

Record = Callable[[str, object], None]
TICK = 0.01
STIFFNESS, DENSITY = 0.01, 0.05
WIRE = {
    "axial_stiffness": 500.0,
    "bending_stiffness": STIFFNESS,
    "line_density": DENSITY,
    "axial_damping_time": 0.005,
    "bending_damping_time": 0.05,
    "twist_stiffness": 0.008,
}


def uniform(first: float, second: float) -> dict[str, Any]:
    """The section of a natural curvature that is the same along the tether."""
    return {"rows": [[0.0, first, second]]}


def wire(curvature: dict[str, Any], length: float, elements: int, **changes: Any) -> Any:
    """A scenario of a wire that is pinned at its root."""
    tether = {**WIRE, "length": length, "elements": elements, "natural_curvature": curvature}
    return load_spatial(
        "free_hang",
        {
            "rover": None,
            "winch": None,
            "tether": tether,
            "start": {"kind": "hanging", "settling_time": 200.0},
            **changes,
        },
    )


def hanging_rover(**changes: Any) -> Any:
    """A rover on a short coiled tether with a winch."""
    return load_spatial(
        "free_hang",
        {
            "tether.length": 4.0,
            "tether.max_length": 8.0,
            "tether.element_length": 0.2,
            "tether.bending_stiffness": 5.0e-3,
            "tether.twist_stiffness": 4.0e-3,
            "tether.natural_curvature": uniform(1.0, 0.5),
            "winch.min_length": 1.0,
            **changes,
        },
    )


def run(
    plant: SpatialPlant, state: SpatialState, duration: float, command: PlantCommand | None = None
) -> tuple[SpatialState, StepResult]:
    """The state after a duration, and the last result."""
    result = None
    for _ in range(round(duration / TICK)):
        state, result = plant.step(state, command or PlantCommand(), TICK)
        assert not state.phase.final
    assert result is not None
    return state, result


def distances(state: SpatialState) -> Any:
    """Distances between all nodes [m]."""
    return np.linalg.norm(state.nodes[:, None, 0] - state.nodes[None, :, 0], axis=2)


@pytest.mark.parametrize("curvature", [(2.0, 0.0), (1.2, -1.6), (-0.5, 0.3)])
def test_without_weight_a_coiled_tether_rests_on_a_circle(
    curvature: tuple[float, float], record_property: Record
):
    length, elements, size = 1.5, 15, math.hypot(*curvature)
    scenario = wire(uniform(*curvature), length, elements, **{"environment.gravity": 0.0})
    plant = build_plant(scenario)
    state = plant.initial_state()
    arcs = np.linspace(0.0, length, elements + 1)
    chords = 2.0 / size * np.abs(np.sin(0.5 * size * (arcs[:, None] - arcs[None, :])))
    error = np.abs(distances(state) - chords).max()
    record_property("error", error / length)
    assert error < 2e-4
    parts = plant.energies(state)
    straight = 0.5 * STIFFNESS * size**2 * length
    assert parts.bending + parts.twist < 1e-4 * straight


@pytest.mark.parametrize(("a", "b", "turn"), [(-1.0, 4.0 / 1.5, 0.0), (0.5, 1.0, 1.2)])
def test_without_weight_a_tether_rests_on_the_clothoid_of_its_curvature(
    a: float, b: float, turn: float, record_property: Record
):
    """Curvature k(s) = a + b s turns the tether by a s + b s^2/2: Fresnel's integrals."""
    length, elements = 1.5, 30
    rows = [
        [place, size * math.cos(turn), size * math.sin(turn)]
        for place, size in ((0.0, a), (length, a + b * length))
    ]
    scenario = wire({"rows": rows}, length, elements, **{"environment.gravity": 0.0})
    state = build_plant(scenario).initial_state()
    size = math.sqrt(b / math.pi)
    arcs = np.linspace(0.0, length, elements + 1)
    sine, cosine = fresnel(size * (arcs + a / b))
    shape = np.stack([cosine, sine], axis=1) / size
    expected = np.linalg.norm(shape[:, None] - shape[None, :], axis=2)
    error = np.abs(distances(state) - expected).max()
    record_property("error", error / length)
    assert error < 2e-4
    assert expected[0, -1] < 0.9 * length


@pytest.mark.parametrize("torsion", [2.5, -2.5])
def test_without_weight_a_tether_rests_on_the_helix_of_its_curvature(torsion: float):
    """In a frame without twist the curvature of a helix turns about it at the helix's torsion."""
    length, elements, size = 1.5, 40, 2.0
    places = np.linspace(0.0, length, 121)
    turns = torsion * places
    rows = np.stack([places, size * np.cos(turns), size * np.sin(turns)], axis=1).tolist()
    scenario = wire({"rows": rows}, length, elements, **{"environment.gravity": 0.0})
    state = build_plant(scenario).initial_state()
    arcs = np.linspace(0.0, length, elements + 1)
    rate = math.hypot(size, torsion)
    helix = np.stack(
        [
            size / rate**2 * np.cos(rate * arcs),
            size / rate**2 * np.sin(rate * arcs),
            torsion / rate * arcs,
        ],
        axis=1,
    )
    expected = np.linalg.norm(helix[:, None] - helix[None, :], axis=2)
    assert distances(state) == pytest.approx(expected, abs=1e-3)
    nodes = state.nodes[:, 0]
    edges = [nodes[k] - nodes[0] for k in (elements // 3, 2 * elements // 3, elements)]
    own, given = (
        np.linalg.det(edges),
        np.linalg.det([helix[k] - helix[0] for k in (elements // 3, 2 * elements // 3, elements)]),
    )
    assert own == pytest.approx(given, rel=0.02)  # wound to the same side


def test_a_heavy_tether_with_a_small_curvature_hangs_as_a_beam():
    """EI u'' = T u with slope u and tension T; u' = k at both ends, which bear no moment."""
    length, elements, mass, g = 1.0, 40, 0.05, 1.62
    k1, k2 = 0.04, 0.03
    scenario = wire(uniform(k1, k2), length, elements, tip={"mass": mass})
    state = build_plant(scenario).initial_state()
    arcs = np.linspace(0.0, length, elements + 1)

    def tension(s: Any) -> Any:
        return mass * g + DENSITY * g * (length - s)

    beam = solve_bvp(
        lambda s, y: np.stack([y[1], y[2], tension(s) / STIFFNESS * y[1]]),
        lambda a, b: np.array([a[0], a[2] - 1.0, b[2] - 1.0]),
        arcs,
        np.zeros((3, elements + 1)),
        tol=1e-8,
    )
    shape = beam.sol(arcs)[0]
    largest = np.abs(shape).max()
    assert largest > 0.02
    assert np.abs(state.nodes[:, 0, 0] - k1 * shape).max() < 1e-2 * k1 * largest
    assert np.abs(state.nodes[:, 0, 1] + k2 * shape).max() < 1e-2 * k1 * largest


def test_a_coiled_tether_settles_before_its_ends_move():
    moved = {"rows": [[0.0, 0.0, 0.0, 0.0], [1.0, 0.1, 0.0, 0.0]]}
    plant = build_plant(wire(uniform(1.0, 0.0), 1.0, 10, root=moved, tip={"motion": moved}))
    still = plant.initial_state()
    assert still.nodes[0, 0] == pytest.approx([0.0, 0.0, 0.0])
    assert still.nodes[-1, 0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-3)
    state, _ = run(plant, still, 1.5)
    assert state.nodes[0, 0] == pytest.approx([0.1, 0.0, 0.0], abs=1e-5)
    assert state.nodes[-1, 0] - still.nodes[-1, 0] == pytest.approx([0.1, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize(
    "curvature",
    [uniform(1.5, 0.0), {"rows": [[0.0, 2.0, 0.0], [0.7, -1.0, 2.0], [1.5, 0.0, -2.0]]}],
)
def test_energy_is_conserved_in_motion(curvature: dict[str, Any], record_property: Record):
    """Without damping only the relaxing twist dissipates, the less the shorter the step."""
    heats = []
    for h in (1.0e-3, 0.5e-3):
        scenario = wire(
            curvature,
            1.5,
            15,
            **{
                "start": {"kind": "straight", "direction": [1.0, 1.0, 0.0]},
                "tether.axial_damping_time": 0.0,
                "tether.bending_damping_time": 0.0,
                "integration.h": h,
            },
        )
        plant = build_plant(scenario)
        _, result = run(plant, plant.initial_state(), 1.0)
        turnover = abs(result.energies.gravity)
        assert turnover > 0.02
        assert result.energies.bending + result.energies.twist > 1e-3
        record_property("residual", abs(result.energies.drift) / turnover)
        assert abs(result.energies.drift) < 1e-6 * turnover
        heats.append(result.energies.dissipated)
        assert 0.0 <= heats[-1] < 0.03 * turnover
    assert heats[1] < 0.8 * heats[0]


def test_a_tether_that_was_coiled_uncoils_by_creep():
    """Free of load B kappa + B1 (kappa - k_v) = 0, so kappa fades with the time tau (B + B1)/B.

    A tether rests on a circle of 2 1/m, wholly relaxed; then its natural curvature is gone. It
    springs to B1/(B + B1) of the curvature at once.
    """
    length, elements, size, ratio, time = 1.5, 15, 2.0, 1.5, 8.0
    changes = {
        "environment.gravity": 0.0,
        "tether.bending_relaxation_ratio": ratio,
        "tether.bending_relaxation_time": time,
        "tether.bending_damping_time": 0.3,
    }
    state = build_plant(wire(uniform(size, 0.0), length, elements, **changes)).initial_state()
    assert distances(state)[0, -1] == pytest.approx(math.sin(0.5 * size * length), abs=1e-3)
    plant = build_plant(wire(uniform(0.0, 0.0), length, elements, **changes))
    fading = time * (1.0 + ratio)

    def curvature_of(state: SpatialState) -> float:
        """From the angle between the ends' slopes."""
        first, last = state.nodes[0, 1], state.nodes[-1, 1]
        return (
            math.atan2(float(np.linalg.norm(np.cross(first, last))), float(first @ last)) / length
        )

    state, _ = run(plant, state, 10.0)
    early = curvature_of(state)
    share = ratio / (1.0 + ratio)
    assert early == pytest.approx(size * share * math.exp(-10.0 / fading), rel=0.02)
    state, _ = run(plant, state, 8.0)
    assert curvature_of(state) / early == pytest.approx(math.exp(-8.0 / fading), rel=5e-3)


def test_relaxation_dissipates_what_the_energy_balance_loses():
    scenario = wire(
        {"rows": [[0.0, 2.0, 0.0], [0.7, -1.0, 2.0], [1.5, 0.0, -2.0]]},
        1.5,
        15,
        **{
            "start": {"kind": "straight", "direction": [1.0, 1.0, 0.0]},
            "tether.axial_damping_time": 0.0,
            "tether.bending_damping_time": 0.0,
            "tether.bending_relaxation_ratio": 1.0,
            "tether.bending_relaxation_time": 0.2,
        },
    )
    plant = build_plant(scenario)
    state, heat = plant.initial_state(), 0.0
    for _ in range(100):
        state, result = plant.step(state, PlantCommand(), TICK)
        assert result.energies.dissipated >= heat
        heat = result.energies.dissipated
    turnover = abs(result.energies.gravity)
    assert abs(result.energies.drift) < 1e-6 * turnover
    assert heat > 0.01 * turnover


def test_a_relaxing_tether_continues_from_a_saved_state_bit_by_bit():
    scenario = wire(
        uniform(1.0, 0.5),
        1.0,
        8,
        **{
            "start": {"kind": "straight", "direction": [0.3, 0.0, -1.0]},
            "tether.bending_relaxation_ratio": 1.0,
        },
    )
    plant = build_plant(scenario)
    middle, _ = run(plant, plant.initial_state(), 0.5)
    assert np.abs(middle.frames[4:]).max() > 0.05
    saved = json.loads(json.dumps(plain_state(middle)))
    other = build_plant(scenario)
    after, _ = run(plant, middle, 0.5)
    again, _ = run(other, other.restored_state(saved), 0.5)
    assert plain_state(again) == plain_state(after)


def test_a_scenario_that_is_turned_moves_turned():
    """The fairlead's frame begins with x: a turn of the scenario turns the curvature in it."""
    angle = 0.7
    turn = np.array(
        [
            [math.cos(angle), -math.sin(angle), 0.0],
            [math.sin(angle), math.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    places = []
    for matrix in (np.eye(3), turn):
        k = matrix @ np.array([1.0, -0.5, 0.0])
        scenario = hanging_rover(
            **{
                "tether.natural_curvature": uniform(float(k[0]), float(-k[1])),
                "start": {
                    "kind": "straight",
                    "direction": (matrix @ np.array([0.4, 0.1, -1.0])).tolist(),
                    "tip_velocity": (matrix @ np.array([0.0, 0.3, 0.0])).tolist(),
                    "attitude": [0.0, 0.0, 0.0 if matrix is not turn else angle],
                },
            }
        )
        plant = build_plant(scenario)
        state, _ = run(plant, plant.initial_state(), 1.0)
        places.append(state.nodes[:, 0] @ matrix)
        places.append(state.G1 @ matrix)
    np.testing.assert_allclose(places[2], places[0], atol=1e-7)
    np.testing.assert_allclose(places[3], places[1], atol=1e-7)


@pytest.mark.parametrize("friction", [math.inf, 2.0e-4])
def test_a_tether_that_is_hardly_coiled_twists_as_a_spring(friction: float):
    states = []
    for curvature in (0.0, 1e-6):
        scenario = hanging_rover(
            **{
                "tether.natural_curvature": uniform(curvature, 0.0),
                "tether.swivel_friction": friction,
                "start": {"kind": "straight", "direction": [0.0, 0.0, -1.0]},
            }
        )
        plant = build_plant(scenario)
        start = plant.unsettled_state()
        nodes = plant.to_full_nodes(start)
        state = plant.state_at(nodes, twist=1.0)
        states.append(run(plant, state, 8.0))
    (straight, first), (coiled, second) = states
    assert straight.twist < 0.97
    assert coiled.twist == pytest.approx(straight.twist, abs=2e-3)
    assert coiled.omega == pytest.approx(straight.omega, abs=1e-4)
    assert second.energies.twist == pytest.approx(first.energies.twist, rel=5e-3)
    slip = straight.energy_balance["heat_swivel"]
    assert (slip > 1e-5) == math.isfinite(friction)
    assert coiled.energy_balance["heat_swivel"] == pytest.approx(slip, rel=0.02, abs=1e-12)


UNEVEN = {"rows": [[0.0, 2.0, 0.0], [2.0, 0.0, 2.0], [4.1, -2.0, 0.0], [6.0, 1.0, 0.5]]}


@pytest.mark.parametrize("curvature", [uniform(1.0, 0.5), UNEVEN])
def test_energy_balances_while_a_coiled_tether_is_paid_out_and_reeled_in(
    curvature: dict[str, Any],
):
    scenario = hanging_rover(
        **{
            "tether.swivel_friction": math.inf,
            "tether.natural_curvature": curvature,
            "start.residual_speed": 1e-5,
        }
    )
    plant = build_plant(scenario)
    start = plant.initial_state()
    longest, result = run(plant, start, 6.0, PlantCommand(winch=WinchCommand(7.0, rate=0.5)))
    work = abs(longest.energy_balance["input_winch_motor"])
    assert abs(result.energies.drift) < 1e-3 * work
    assert longest.elements > start.elements + 12
    state, result = run(plant, longest, 6.0, PlantCommand(winch=WinchCommand(4.0, rate=-0.5)))
    assert state.elements < longest.elements - 12
    assert abs(result.energies.drift) < 4e-3 * work
    directors, slopes = state.frames[:3].T, state.nodes[:, 1]
    assert np.linalg.norm(directors, axis=1) == pytest.approx(1.0)
    across = np.sum(directors * slopes, axis=1)
    assert np.abs(across).max() < 1e-9


def test_a_run_continues_from_a_saved_state_bit_by_bit():
    scenario = hanging_rover(start={"kind": "straight", "direction": [0.3, 0.0, -1.0]})
    plant = build_plant(scenario)
    paying = PlantCommand(winch=WinchCommand(7.0, rate=0.5))
    middle, _ = run(plant, plant.initial_state(), 0.7, paying)
    saved = json.loads(json.dumps(plain_state(middle)))
    other = build_plant(scenario)
    after, _ = run(plant, middle, 0.7, paying)
    again, _ = run(other, other.restored_state(saved), 0.7, paying)
    assert plain_state(again) == plain_state(after)
    del saved["frames"][0][0]
    with pytest.raises(ScenarioError, match="frames"):
        other.restored_state(saved)


def test_a_file_gives_the_curvature_along_the_tether(tmp_path: Path):
    table = tmp_path / "coil.csv"
    table.write_text(
        "position_m,curvature_1_per_m,curvature_2_per_m\n1,0.5,0\n2,0,1\n", encoding="utf-8"
    )
    scenario = tmp_path / "own.yaml"
    scenario.write_text(
        "base: free_hang\n"
        "tether: {element_length: 0.5, twist_stiffness: 0.001,"
        " natural_curvature: {file: coil.csv}}\n",
        encoding="utf-8",
    )
    tether = load_spatial(scenario).tether
    assert tether.natural_curvature is not None
    along = tether.natural_curvature.at(np.array([0.0, 1.5, 9.0]))
    assert along[0] == pytest.approx([0.5, 0.25, 0.0])
    assert along[1] == pytest.approx([0.0, 0.5, 1.0])
    table.write_text("position_m,k1,k2\n1,0.5,0\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"coil\.csv.*position_m, curvature_1_per_m"):
        load_spatial(scenario)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"tether.twist_stiffness": 0.0}, "twist_stiffness"),
        ({"tether.natural_curvature": uniform(2.0, 2.0)}, r"rows = 2\.82\d*: bends an element"),
        ({"tether.natural_curvature": {"rows": []}}, "at least 1"),
        ({"tether.natural_curvature": {"rows": [[0.0, 1.0]]}}, r"rows\[0\]"),
        ({"tether.natural_curvature": {"rows": [[0, 0, 10**400]]}}, r"rows\[0\].*finite"),
        ({"tether.natural_curvature": {"rows": [[8.5, 1.0, 0.0]]}}, r"8\.5.* whole length 8 m"),
        (
            {"tether.natural_curvature": {"rows": [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]}},
            r"position_m should be above 1",
        ),
        ({"start.swing_angle": 2.0}, "swing_angle"),
        ({"start.payout_rate": 0.1}, "payout_rate"),
        ({"tether.natural_curvature": None, "start.settling_time": 5.0}, "settling_time"),
        ({"tether.bending_relaxation_ratio": 0.5}, "bending_relaxation_ratio.*with a winch"),
        ({"tether.bending_relaxation_time": 0.0}, "bending_relaxation_time"),
    ],
)
def test_what_a_coiled_tether_cannot_have_is_refused(changes: dict[str, Any], named: str):
    with pytest.raises(ScenarioError, match=named):
        hanging_rover(**changes)
