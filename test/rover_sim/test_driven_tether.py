"""Driven ends and point masses of a scenario's tether: closed forms, energy, refusals, a node."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from documented import ROOT
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from msg_schemas import machine, topics
from rover_bags.reading.read import read_bag
from rover_cli.command_line import main
from rover_sim import (
    Energies,
    PlantCommand,
    ScenarioError,
    SpatialScenario,
    SpatialState,
    WinchCommand,
    build_plant,
    dump_scenario,
    load_scenario,
    load_spatial,
)

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness

Record = Callable[[str, object], None]
SHAKEN = ROOT / "docs" / "tutorials" / "shaken_tether.yaml"
DENSITY = 1.0e4 * math.pi * 3.45e-4**2  # of the scenario's tether [kg/m]
GRAVITY, LENGTH = 9.81, 5.0
HANGING = {
    "tether.elements": 8,
    "tether.axial_damping_time": 0.02,
    "start": {"kind": "hanging"},
}
ELASTIC = {"tether.bending_relaxation_ratio": 0.0}
STIFF = {"tether.youngs_modulus": 5.0e10, "tether.axial_damping_time": 0.005}
TICK = 0.02
NODE_TICK = 0.01  # of sim_node [s]


def table(duration: float, position: Any, after: float = 0.0, rows: int = 41) -> dict[str, Any]:
    """A table of a position [m] as a function of the time within a duration."""
    times = np.linspace(0.0, duration, rows).tolist()
    return {"rows": [[after + t, *map(float, position(t))] for t in times]}


def raised(height: float, duration: float) -> dict[str, Any]:
    """A smooth rise from rest to rest."""
    return table(
        duration, lambda t: (0.0, 0.0, 0.5 * height * (1.0 - math.cos(math.pi * t / duration)))
    )


def run(changes: dict[str, Any], duration: float) -> tuple[list[SpatialState], Energies]:
    """States after each tick, and the last energies."""
    plant = build_plant(load_spatial("spatial_pendulum", {**HANGING, **changes}))
    states = [plant.initial_state()]
    result = None
    for _ in range(round(duration / TICK)):
        state, result = plant.step(states[-1], PlantCommand(), TICK)
        states.append(state)
    assert result is not None
    return states, result.energies


@pytest.mark.parametrize(("mass", "height"), [(2.0, 0.4), (0.3, 0.6), (0.8, 0.2)])
def test_the_work_of_a_driven_root_raises_the_load(
    mass: float, height: float, record_property: Record
):
    states, energies = run({**STIFF, "tip": {"mass": mass}, "root": raised(height, 2.0)}, 3.0)
    work = states[-1].energy_balance["input_driven_ends"]
    error = abs(work / ((mass + DENSITY * LENGTH) * GRAVITY * height) - 1.0)
    record_property("error", error)
    assert error < 2e-3
    assert energies.input == pytest.approx(work)
    assert abs(energies.drift) < 1e-6 * work
    assert states[-1].nodes[0, 0] == pytest.approx([0.0, 0.0, height], abs=1e-5)
    assert states[-1].nodes[-1, 0, 2] - states[0].nodes[-1, 0, 2] == pytest.approx(height, abs=1e-4)


def test_a_shaken_pendulum_follows_its_equation():
    """A heavy mass on a light tether, shaken sideways by little: x'' = -g/l (x - u)."""
    rate = 1.1
    motion = table(4.0, lambda t: (0.02 * math.sin(rate * t) ** 2, 0.0, 0.0), rows=201)
    states, energies = run({"tip": {"mass": 20.0}, "root": motion}, 4.0)
    rows = np.array(motion["rows"])
    root = CubicSpline(rows[:, 0], rows[:, 1], bc_type="clamped")
    length = float(-states[0].nodes[-1, 0, 2])
    exact = solve_ivp(
        lambda t, y: (y[1], -GRAVITY / length * (y[0] - root(min(t, 4.0)))),
        (0.0, 4.0),
        (0.0, 0.0),
        rtol=1e-9,
        atol=1e-12,
    ).y[0, -1]
    assert abs(exact) > 0.005
    assert states[-1].nodes[-1, 0, 0] == pytest.approx(exact, abs=2e-4)
    assert abs(energies.drift) < 1e-6


def test_at_constant_speed_through_air_the_drag_lightens_the_root():
    """Drawn down along its axis with v, the tether pulls with its weight less c_t L v^2."""
    speed = 3.0
    ramp = table(4.0, lambda t: (0.0, 0.0, -speed * t), rows=9)
    air = {"diameter": 0.01, "density": 1.2, "axial_coefficient": 0.5}
    damped = {"tether.axial_damping_time": 0.1}
    plant = build_plant(
        load_spatial(
            "spatial_pendulum", {**HANGING, **damped, "environment.air": air, "root": ramp}
        )
    )
    state = plant.initial_state()
    for _ in range(100):
        state, result = plant.step(state, PlantCommand(), TICK)
    pull = plant.tension(state)[0]
    drag = 0.5 * math.pi * 1.2 * 0.5 * 0.01 * LENGTH * speed**2
    assert drag > 0.2
    assert pull == pytest.approx(DENSITY * LENGTH * GRAVITY - drag, abs=0.02)
    assert abs(result.energies.drift) < 1e-5


@pytest.mark.parametrize(
    ("mass", "direction"),
    [(2.0, [1.0, 0.0, 0.0]), (0.1, [0.5, -1.0, 0.3]), (0.7, [0.0, 1.0, -1.0])],
)
def test_a_mass_at_the_end_is_the_tip_s_mass(
    mass: float, direction: list[float], record_property: Record
):
    level = {"start": {"kind": "straight", "direction": direction}}
    at_end, energies = run({**level, "tether.masses": [{"position": 5.0, "mass": mass}]}, 0.6)
    as_tip, _ = run({**level, "tip": {"mass": mass}}, 0.6)
    record_property("distance", np.linalg.norm(at_end[-1].tip - as_tip[-1].tip))
    np.testing.assert_allclose(at_end[-1].nodes, as_tip[-1].nodes, atol=1e-9)
    assert energies.kinetic > 0.5


def test_masses_between_the_nodes_stretch_the_tether_above_them():
    masses = [{"position": 2.3, "mass": 1.0}, {"position": 5.0, "mass": 4.0}]
    start = {"start": {"kind": "straight", "direction": [0.0, 0.0, -1.0]}}
    states, energies = run({**STIFF, **start, "tether.masses": masses}, 3.0)
    rigidity = 5.0e10 * math.pi * 3.45e-4**2
    stretch = GRAVITY / rigidity * (5.0 * 2.3 + 4.0 * 2.7 + DENSITY * LENGTH**2 / 2.0)
    assert -states[-1].nodes[-1, 0, 2] - LENGTH == pytest.approx(stretch, rel=0.01)
    assert abs(energies.drift) < 1e-6


def test_a_driven_tip_moves_by_its_table():
    away = table(
        1.0, lambda t: (0.3 * math.sin(0.5 * math.pi * t) ** 2, 0.0, 0.5 * t * t * (3 - 2 * t))
    )
    states, energies = run({"tip": {"motion": away}}, 1.5)
    moved = states[-1].nodes[-1, 0] - states[0].nodes[-1, 0]
    assert moved == pytest.approx([0.3, 0.0, 0.5], abs=1e-4)
    assert states[-1].nodes[0, 0] == pytest.approx([0.0, 0.0, 0.0])
    assert np.abs(states[-1].node_rates[-1, 0]).max() < 1e-6
    assert abs(energies.drift) < 1e-5
    assert states[-1].energy_balance["input_driven_ends"] != 0.0


# ------------------------------------------------------------------- a drum on a driven fairlead


def hung(root: dict[str, Any], **changes: Any) -> Any:
    """A rover that hangs from a winch on a fairlead that is moved."""
    return load_spatial(
        "free_hang", {"tether.length": 6.0, "tether.max_length": 12.0, "root": root, **changes}
    )


def shaken() -> dict[str, Any]:
    """A smooth motion to and fro, that ends beside its start."""
    rate = math.pi / 1.5
    return table(
        3.0,
        lambda t: (0.2 * math.sin(rate * t) ** 2, 0.1 * t * t / 9.0, 0.1 * math.sin(rate * t) ** 2),
        rows=61,
    )


def test_a_braked_drum_on_a_driven_fairlead_is_a_driven_root():
    ends = []
    for winch in ({}, {"winch": None, "tether.max_length": None}):
        plant = build_plant(hung(shaken(), **winch))
        state = plant.initial_state()
        for _ in range(200):
            state, result = plant.step(state, PlantCommand(), TICK)
        assert plant.to_full_nodes(state)[0, 0] == pytest.approx([0.0, 0.1, 0.0], abs=1e-4)
        assert abs(result.energies.drift) < 2e-4
        ends.append((state, state.energy_balance["input_driven_ends"]))
    (drum, first), (pinned, second) = ends
    assert np.linalg.norm(pinned.G1_rate) > 0.02
    assert pytest.approx(pinned.G1, abs=5e-5) == drum.G1
    assert drum.omega == pytest.approx(pinned.omega, abs=1e-3)
    assert first == pytest.approx(second, rel=1e-3)


def test_a_rising_fairlead_pays_out_what_it_rises():
    """The rover stays in place while the drum pays out at the speed of the fairlead."""
    speed, mass = 0.4, 10.0
    rise = table(6.0, lambda t: (0.0, 0.0, speed * max(t - 1.0, 0.0) if t > 1.5 else 0.0), rows=7)
    plant = build_plant(hung(rise, **{"tether.axial_damping_time": 0.05}))
    state = plant.initial_state()
    for k in range(250):
        command = WinchCommand(12.0, rate=speed) if k >= 50 else None
        state, result = plant.step(state, PlantCommand(winch=command), TICK)
    nodes = plant.to_full_nodes(state)
    height = nodes[0, 0, 2]
    assert height > 1.0
    assert state.elements > 6
    assert -nodes[-1, 0, 2] + height == pytest.approx(state.length, abs=0.01)
    # what raises the fairlead carries the load, whose reaction does the work
    work = state.energy_balance["input_driven_ends"]
    assert work == pytest.approx(mass * 1.62 * height, rel=0.05)
    assert abs(result.energies.drift) < 0.02 * work


def test_a_run_continues_from_its_state_as_without_a_break():
    changes = {**HANGING, "tip": {"mass": 2.0}, "root": raised(0.4, 1.0)}
    plant = build_plant(load_spatial("spatial_pendulum", changes))
    once, _ = plant.step(plant.initial_state(), PlantCommand(), 0.5)
    other = build_plant(load_spatial("spatial_pendulum", changes))
    halves = other.initial_state()
    for _ in range(2):
        halves, _ = other.step(halves, PlantCommand(), 0.25)
    np.testing.assert_allclose(halves.nodes, once.nodes, atol=1e-6)


def heat_of(scenario: SpatialScenario, duration: float) -> float:
    """What has been dissipated after a duration [J]."""
    plant = build_plant(scenario)
    state, heat = plant.initial_state(), 0.0
    for _ in range(round(duration / NODE_TICK)):
        state, result = plant.step(state, PlantCommand(), NODE_TICK)
        heat = result.energies.dissipated
    return heat


# --------------------------------------------------------------------------------- scenarios


def test_a_table_is_read_beside_its_scenario_and_kept_in_it(tmp_path: Path):
    scenario = load_spatial(SHAKEN)
    assert scenario.root is not None
    assert scenario.root.rows[1] == (0.8, 0.1, 0.0, 0.0)
    copy = tmp_path / "copy.yaml"
    copy.write_text(dump_scenario(scenario), encoding="utf-8")
    assert load_scenario(copy) == scenario


@pytest.mark.parametrize(
    ("name", "changes", "named"),
    [
        ("floor_rubble", {"root": raised(0.1, 1.0)}, "root"),
        ("free_hang", {"tether.masses": [{"position": 1.0, "mass": 1.0}]}, "tether.masses"),
        ("spatial_pendulum", {"tip": {"mass": 1.0, "motion": raised(0.1, 1.0)}}, "tip.mass"),
        ("spatial_pendulum", {"tether.masses": [{"position": 5.1, "mass": 1.0}]}, "position"),
        ("spatial_pendulum", {"root": {"rows": [[0, 0, 0, 0]]}}, "root.rows"),
        ("spatial_pendulum", {"root": {"rows": [[0, 0, 0, 0], [0, 0, 0, 1]]}}, r"root.rows\[1\]"),
        ("spatial_pendulum", {"root": {"rows": [[0, 0, 0, 0], [1, 0, 0]]}}, r"root.rows\[1\]"),
        ("spatial_pendulum", {"root": {"rows": "up"}}, "root.rows"),
        ("free_hang", {"root": {"rows": [[-1, 0, 0, 0], [1, 0, 0, 1]]}}, r"root.rows\[0\].*time_s"),
    ],
)
def test_what_cannot_be_is_refused(name: str, changes: dict[str, Any], named: str):
    with pytest.raises(ScenarioError, match=named):
        load_spatial(name, changes)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "time,x,y,z\n0,0,0,0\n",
        "time_s,x_m,y_m,z_m\n0,0,0,zero\n",
        "time_s,x_m,y_m,z_m\n0,0,0,1_0\n1,0,0,0\n",
        None,
    ],
)
def test_a_damaged_table_is_refused_by_its_name(tmp_path: Path, text: str | None):
    scenario = tmp_path / "own.yaml"
    scenario.write_text("base: spatial_pendulum\nroot: {file: own.csv}\n", encoding="utf-8")
    if text is not None:
        (tmp_path / "own.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"own\.csv"):
        load_scenario(scenario)


def test_a_table_of_a_spreadsheet_is_read_and_its_bad_line_is_named(tmp_path: Path):
    scenario, table = tmp_path / "own.yaml", tmp_path / "own.csv"
    scenario.write_text("base: spatial_pendulum\nroot: {file: own.csv}\n", encoding="utf-8")
    table.write_text("time_s,x_m,y_m,z_m\r\n0,0,0,0\r\n\r\n1,0,0,0.5\r\n", encoding="utf-8-sig")
    root = load_spatial(str(scenario)).root
    assert root is not None
    assert root.rows == ((0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.5))
    table.write_text("time_s,x_m,y_m,z_m\n0,0,0,0\n\n1,0,0,up\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"own\.csv, line 4: '1,0,0,up'"):
        load_scenario(scenario)


# -------------------------------------------------------------------------------------- a node


@pytest.mark.ros
@pytest.mark.process
@pytest.mark.usefixtures("compiled_in_space")
def test_a_bag_shows_how_a_node_shakes_a_coiled_tether_that_relaxes_in_air(
    harness: NodeHarness, tmp_path: Path
):
    observer = harness.observer()
    energy = observer.listen(topics.TRUTH_ENERGY)
    folder, page = tmp_path / "shaken", tmp_path / "report"
    recorder = harness.processes.start("rover_bags.recording.record", None, "--output", str(folder))
    recorder.wait_for_output("recording into")
    # Slowly, so that the motion is not over before the observer is discovered.
    settings = {"scenario": str(SHAKEN), "real_time_factor": 0.5}
    node = harness.processes.start("rover_sim.node.sim_node", settings)
    observer.wait_until_ready("sim_node")
    energy.wait(lambda sample: sample.stamp_ns > 2_200_000_000)
    assert node.stop() == 0
    assert recorder.stop() == 0

    recorded = read_bag(folder)
    series = recorded.series(topics.TRUTH_ENERGY)
    assert series is not None
    last = {name: float(series.columns[f"{name}.position"][-1]) for name in machine.ENERGY_NAMES}
    assert last["driven_ends"] == pytest.approx(last["input"])
    assert last["driven_ends"] > 0.05
    assert 1e-3 < last["air_drag"] < last["dissipated"]
    assert last["bending"] > 1e-3
    bent = series.columns["bending.position"]
    assert np.ptp(bent) > 1e-3
    assert np.abs(series.columns["drift.position"]).max() < 1e-6 * last["driven_ends"]
    # as the plant itself computes it, and otherwise than without relaxation
    heat = float(np.interp(2.0, series.time, series.columns["dissipated.position"]))
    relaxing, elastic = (heat_of(load_spatial(SHAKEN, changes), 2.0) for changes in ({}, ELASTIC))
    assert heat == pytest.approx(relaxing, rel=2e-3)
    assert abs(relaxing - elastic) > 0.02 * relaxing

    assert main(["bag", "report", str(folder), "--out", str(page)]) == 0
    text = (page / "report.html").read_text(encoding="utf-8")
    for label in ("of input: driven ends", "of dissipated: air", "of stored: bending"):
        assert label in text
