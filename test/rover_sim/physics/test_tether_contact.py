"""The tether on the ground: weight, friction, energy balance, tangent, boulders and rim."""

import math
from typing import Any

import grounded_march
import numpy as np
import pytest
from grounded_march import GroundedTether
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_schemas.fields import SMALLEST_SIZE
from rover_sim.physics.ground import tether_contact
from rover_sim.physics.ground.boulders import BoulderParameters
from rover_sim.physics.ground.terrain import Terrain, build_terrain
from rover_sim.physics.ground.terrain_parameters import (
    HoleParameters,
    ReliefParameters,
    TerrainParameters,
)
from rover_sim.physics.ground.tether_contact import TetherContactParameters
from rover_sim.physics.tether.tether import make_tether
from rover_sim.physics.tether.tether_section import TetherSection

LUNAR = 1.62
ARAMID = TetherSection(2e4, 1e-4, 5e-3, axial_damping_time=0.015, bending_damping_time=0.05)
FLOOR = build_terrain(TerrainParameters(floor_height=0.0))
RUBBLE = build_terrain(
    TerrainParameters(
        floor_height=0.0, patch_half_width=6.0,
        relief=ReliefParameters(), boulders=BoulderParameters(density=3.0, largest=1.0),
    ),
    seed=5,
)  # fmt: skip


def lying(
    terrain: Terrain, height: float = 0.0, length: float = 4.0, elements: int = 8,
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0), **options: Any,
) -> GroundedTether:  # fmt: skip
    """A straight tether through (0, 0, height), at rest."""
    cable = make_tether(ARAMID, length, elements, (0.0, 0.0, -LUNAR))
    d = np.array(direction)
    nodes = np.zeros((elements + 1, 2, 3))
    nodes[:, 0] = (0.0, 0.0, height) + np.linspace(-length / 2, length / 2, elements + 1)[
        :, None
    ] * d
    nodes[:, 1] = d
    return GroundedTether(cable, terrain, nodes, **options)


@pytest.mark.parametrize("rock", [False, True])
def test_it_comes_to_rest_on_the_floor_with_its_weight(rock: bool):
    terrain = build_terrain(TerrainParameters(floor_height=-0.7, floor_is_rock=rock))
    # More damping than usual, as little bounces last.
    tether = lying(terrain, height=-0.6, parameters=TetherContactParameters(damping=2.0))
    tether.run(8.0, 2e-3)
    log = tether.log
    assert log[grounded_march.NORMAL] == pytest.approx(4.0 * 5e-3 * LUNAR, rel=1e-4)
    assert log[grounded_march.TOUCHING] == 16
    stiffness = 1e5 if rock else 2e4
    depth = (5e-3 * LUNAR / stiffness) ** (2.0 / 3.0)
    # At the points the load is a metre's; at the nodes between them the tether hardly bends.
    assert -0.7 - tether.places[:, 2] == pytest.approx(np.full(9, depth), rel=0.05)
    assert np.abs(tether.v[:3]).max() < 1e-4


def slope(degrees: float, elements: int = 8, **options: Any) -> tuple[GroundedTether, np.ndarray]:
    """A straight tether down a slope at its static depth."""
    alpha = math.radians(degrees)
    terrain = build_terrain(TerrainParameters(floor_height=0.0, slope_x=-math.tan(alpha)))
    d = np.array([math.cos(alpha), 0.0, -math.sin(alpha)])
    depth = (5e-3 * LUNAR * math.cos(alpha) / 2e4) ** (2.0 / 3.0)
    tether = lying(terrain, elements=elements, direction=tuple(d), **options)
    n = elements + 1
    tether.q[:3, :n] -= depth * np.array([math.sin(alpha), 0.0, math.cos(alpha)])[:, None]
    return tether, d


def test_anchors_hold_it_on_a_slope_for_a_minute():
    tether, d = slope(15.0)
    start = tether.places
    tether.run(1.0, 2e-3)
    settled = tether.places
    tether.run(59.0, 2e-3)
    assert np.abs((tether.places - start) @ d).max() < 1e-3
    # Once settled it does not creep at all.
    assert np.abs(tether.places - settled).max() < 1e-6


def test_without_anchors_it_creeps():
    tether, d = slope(15.0, parameters=TetherContactParameters(anchor_stiffness=0.0))
    start = tether.places
    tether.run(10.0, 2e-3)
    moved = (tether.places - start) @ d
    # Regularised friction alone: mu N v/sqrt(v^2 + v_s^2) = m g sin(alpha).
    ratio = math.tan(math.radians(15.0)) / 0.6
    creep = 2e-3 * ratio / math.sqrt(1.0 - ratio**2)
    assert moved.mean() == pytest.approx(10.0 * creep, rel=0.05)


@pytest.mark.parametrize("degrees", [33.0, 40.0])
def test_it_slides_down_a_steep_slope(degrees: float):
    alpha = math.radians(degrees)
    tether, d = slope(degrees)
    tether.v[:3, :9] = d[:, None]
    tether.run(1.0, 1e-3)
    speeds = tether.v[:3, :9].T @ d
    mean = LUNAR * (math.sin(alpha) - 0.5 * math.cos(alpha))
    # mu is 0.5 but for (0.1 (v_st/v)^2), v_st = 0.05 m/s
    assert speeds.mean() - 1.0 == pytest.approx(mean, rel=2e-3)
    assert np.ptp(speeds) < 1e-3


@pytest.mark.parametrize("heights", [(0.05, 0.3), (0.2, 0.0)])
def test_on_a_floor_the_energy_balance_closes_to_rounding(heights: tuple[float, float]):
    tether = lying(FLOOR, height=heights[0], direction=(0.8, 0.0, 0.6) if heights[1] else (1, 0, 0))
    tether.q[2, :9] += 1.3
    tether.v[0, :9] = 0.5
    tether.v[1, :9] = 0.4 * np.linspace(0.0, 1.0, 9)
    start = tether.energy
    for _ in range(30):
        tether.run(0.1, 1e-3, tolerance=1e-13)
        assert tether.energy + tether.dissipated == pytest.approx(start, abs=2e-11 * start)
    log = tether.log
    assert log[grounded_march.GROUND_HEAT] > 0.1 * start
    assert log[grounded_march.LEAST_HEAT] > -1e-15
    assert tether.ground_energy == pytest.approx(log[grounded_march.CONTACT_ENERGY], abs=1e-12)


def test_without_damping_and_friction_it_bounces_for_ever():
    smooth = TetherContactParameters(
        damping=0.0, anchor_stiffness=0.0,
        rock_static_friction=0.0, rock_kinetic_friction=0.0,
        regolith_static_friction=0.0, regolith_kinetic_friction=0.0,
    )  # fmt: skip
    tether = lying(RUBBLE, height=1.0, parameters=smooth)
    tether.v[0, :9] = 0.3
    start = tether.energy
    tether.run(4.0, 1e-3)
    assert tether.log[grounded_march.DEEPEST] > 1e-3
    # Also on rubble: curved ground and changing stiffness are corrected.
    assert abs(tether.log[grounded_march.GROUND_HEAT]) < 1e-5 * start
    assert tether.energy + tether.dissipated == pytest.approx(start, rel=1e-8)


def forces(tether: GroundedTether, increment: np.ndarray, h: float) -> tuple[Any, Any]:
    """Blocks of the first element's tangent (12, 12) and residual (12,) that the ground adds."""
    tether.work.blocks[:] = 0.0
    tether.work.increment[:, :2] = increment
    tether_contact.begin_tether_contact(
        tether.terrain, tether.cable, h, tether.q, tether.v, tether.anchors, False, tether.contact
    )
    linearised = tether_contact.add_tether_contact(
        tether.terrain, tether.law, tether.cable, h, tether.anchors, tether.work, tether.contact
    )
    assert linearised == 0
    first, second = tether.work.blocks[1, 0], tether.work.blocks[1, 1]
    tangent = np.block(
        [[first[:6, :6].T, first[7:13, :6].T], [second[7:13, :6].T, second[:6, :6].T]]
    )
    return tangent, np.concatenate([first[6, :6], second[6, :6]])


@pytest.mark.parametrize("degrees", [0.0, 20.0])
@pytest.mark.parametrize("moving", [0.0, 0.3])
def test_tangent_is_the_residuals_derivative(degrees: float, moving: float):
    h = 1e-3
    tether, d = slope(degrees, elements=1)
    tether.anchors[:] = 5e-5 * d
    rng = np.random.default_rng(2)
    increment = 3e-6 * rng.standard_normal((6, 2)) + moving * h * np.concatenate([d, d])[:, None]
    tether.v[:3, :2] = moving * d[:, None]
    tangent, residual = forces(tether, increment, h)
    assert np.abs(residual).max() > 1e-3
    numeric = np.zeros((12, 12))
    step = 1e-9
    for k in range(12):
        sides = []
        for sign in (1.0, -1.0):
            moved = increment.copy()
            moved[k % 6, k // 6] += sign * step
            sides.append(forces(tether, moved, h)[1])
        numeric[:, k] = (sides[0] - sides[1]) / (2.0 * step)
    np.testing.assert_allclose(tangent, numeric, atol=2e-5 * np.abs(tangent).max())


def test_the_force_is_distributed_by_the_shape_functions():
    tether, _ = slope(0.0, elements=1)
    _, residual = forces(tether, np.zeros((6, 2)), 1e-3)
    # A level load of w per metre: (w l/2, w l^2/12, w l/2, -w l^2/12), with the sign of a force
    # on the left-hand side.
    w, length = 5e-3 * LUNAR, 4.0
    expected = [-w * length / 2, -w * length**2 / 12, -w * length / 2, w * length**2 / 12]
    assert residual[[2, 5, 8, 11]] == pytest.approx(expected, rel=1e-9)


def test_over_a_boulder_it_rests_on_top():
    boulder = BoulderParameters(density=1.0, smallest=0.8, largest=1.0)
    terrain = build_terrain(
        TerrainParameters(floor_height=0.0, patch_half_width=3.0, boulders=boulder), seed=1
    )
    x, y, _, diameter, height = terrain.table[terrain.boulders_at :].reshape(-1, 5)[0]
    tether = lying(terrain, height=height + 0.05, length=4.0, elements=24)
    tether.q[0, :25] += x
    tether.q[1, :25] += y
    tether.run(6.0, 1e-3, tolerance=1e-9)
    over = np.hypot(tether.places[:, 0] - x, tether.places[:, 1] - y) < 0.15 * diameter
    assert tether.places[over, 2].min() > 0.8 * height
    assert tether.log[grounded_march.DEEPEST] < 0.01
    settled = tether.places
    tether.run(4.0, 1e-3, tolerance=1e-9)
    assert np.abs(tether.places - settled).max() < 1e-3


def test_over_the_rim_friction_carries_part_of_the_weight():
    hole = HoleParameters(diameter=40.0, depth=30.0, wall_distance=3.0, fairlead_height=1.0)
    terrain = build_terrain(TerrainParameters(hole=hole))
    # From the ground around, over the rim (a quarter of a circle of radius 1 m), down the wall.
    edge = terrain.axis_x - 20.0
    n, length, back = 60, 9.0, 3.0
    s = np.linspace(0.0, length, n + 1)
    quarter = 0.5 * math.pi
    angle = np.clip(s - back, 0.0, quarter)
    nodes = np.zeros((n + 1, 2, 3))
    nodes[:, 0, 0] = edge - 1.0 + np.minimum(s, back) - back + np.sin(angle)
    nodes[:, 0, 2] = -1.0 - 1.0 + np.cos(angle) - np.maximum(s - back - quarter, 0.0)
    nodes[:, 1, 0], nodes[:, 1, 2] = np.cos(angle), -np.sin(angle)
    cable = make_tether(TetherSection(2e4, 1e-4, 5e-3, 0.05, 0.05), length, n, (0.0, 0.0, -LUNAR))
    tether = GroundedTether(cable, terrain, nodes, held=(0,), mass=2.0)
    tether.run(3.0, 1e-3, tolerance=1e-9)
    below, before = tether.work.tension[n - 2], tether.work.tension[8]
    assert below == pytest.approx((2.0 + 5e-3 * 4.0) * LUNAR, rel=0.05)
    # Capstan: by at most exp(mu pi/2), mu from 0.5 to 0.6; the tether behind the rim adds friction.
    assert 1.0 < below / before < math.exp(0.6 * quarter) * 1.1
    assert tether.log[grounded_march.DEEPEST] < 0.01


def test_newton_converges_on_rubble():
    tether = lying(RUBBLE, height=1.0, length=8.0, elements=24)
    tether.run(4.0, 1e-3, tolerance=1e-7)
    log = tether.log
    assert log[grounded_march.TOUCHING] > 20
    assert log[grounded_march.HALVINGS] < 0.005 * log[grounded_march.STEPS]
    assert log[grounded_march.ITERATIONS] < 3.5 * log[grounded_march.STEPS]


def test_points_far_from_the_ground_are_skipped():
    tether = lying(RUBBLE, height=5.0)
    found = tether_contact.begin_tether_contact(
        RUBBLE, tether.cable, 1e-3, tether.q, tether.v, tether.anchors, False, tether.contact
    )
    assert found == 0
    tether.q[2, :9] -= 4.97 - float(tether.places[0, 2] - 5.0)
    tether.v[2, :9] = -400.0
    found = tether_contact.begin_tether_contact(
        FLOOR, tether.cable, 1e-3, tether.q, tether.v, tether.anchors, False, tether.contact
    )
    assert found == 16


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.floats(0.0, 3.0), spin=st.floats(-3.0, 3.0), height=st.floats(0.3, 1.0),
    stiffness=st.floats(1e3, 1e6), damping=st.just(0.0) | st.floats(SMALLEST_SIZE, 2.0),
    friction=st.just(0.0) | st.floats(SMALLEST_SIZE, 1.0), anchor=st.sampled_from([0.0, 50.0, 2e3]),
)  # fmt: skip
def test_thrown_on_rubble_it_never_gains_energy(
    seed: int, speed: float, spin: float, height: float,
    stiffness: float, damping: float, friction: float, anchor: float,
):  # fmt: skip
    rng = np.random.default_rng(seed)
    parameters = TetherContactParameters(
        rock_stiffness=stiffness, damping=damping, rock_static_friction=1.2 * friction,
        rock_kinetic_friction=friction, anchor_stiffness=anchor,
    )  # fmt: skip
    tether = lying(RUBBLE, height=height, length=3.0, elements=6, parameters=parameters)
    tether.q[:2, :7] += rng.uniform(-2.0, 2.0, 2)[:, None]
    direction = rng.standard_normal(3)
    tether.v[:3, :7] = speed * (direction / np.linalg.norm(direction))[:, None]
    tether.v[1, :7] += spin * np.linspace(-1.0, 1.0, 7)
    start = last = tether.energy
    rounding = 1e-10  # of a step solved to the tolerance, where hardly any energy is there [J]
    for _ in range(20):
        tether.run(0.02, 1e-3)
        assert np.isfinite(tether.q).all()
        energy = tether.energy
        assert energy < last + 1e-9 * start + rounding
        assert energy + tether.dissipated == pytest.approx(start, abs=1e-7 * start + rounding)
        last = energy
    # Of single steps, each solved to a tolerance: without damping and friction they make no heat.
    assert tether.log[grounded_march.LEAST_HEAT] > -1e-6 * start - rounding


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("rock_stiffness", 0.0), ("regolith_stiffness", math.nan), ("anchor_stiffness", -1.0),
        ("rock_static_friction", 0.1), ("slip_speed", 0.0), ("damping", math.inf),
    ],
)  # fmt: skip
def test_bad_parameters_are_refused(name: str, value: float):
    with pytest.raises(ValueError, match=f"{name} = "):
        TetherContactParameters(**{name: value})
