import dataclasses
import math

import numpy as np
import pytest

from rover_sim.physics.ground.boulders import BoulderParameters
from rover_sim.physics.ground.terrain import (
    Terrain,
    boulder_list,
    build_terrain,
    depth_and_normal,
    floor_depth_and_normal,
    wall_radius,
)
from rover_sim.physics.ground.terrain_parameters import (
    MARE_TRANQUILLITATIS,
    ReliefParameters,
    TerrainParameters,
)
from rover_sim.physics.ground.wheel_ground_geometry import (
    NO_ROCK,
    WheelContactGeometry,
    deepest_rocks,
    wheel_on_floor,
    wheel_on_rock,
)
from rover_sim.physics.numerics.vectors import Vector

RADIUS = 0.15
LEFT = (0.0, 1.0, 0.0)
FLAT = build_terrain(TerrainParameters(floor_height=0.0))


def rim_depths(terrain: Terrain, centre: np.ndarray, axle: Vector) -> np.ndarray:
    """Depth below floor and boulders all around a rim, by brute force."""
    a = np.array(axle)
    first = np.cross(a, [0.3, 0.2, 0.9])
    first /= np.linalg.norm(first)
    second = np.cross(a, first)
    angle = np.linspace(0.0, 2 * math.pi, 721)[:, None]
    points = centre + RADIUS * (np.cos(angle) * first + np.sin(angle) * second)
    return np.array([depth_and_normal(terrain, *point)[0] for point in points])


def in_rock(terrain: Terrain, centre: Vector, axle: Vector) -> WheelContactGeometry:
    """Contact in the rock that a disc is deepest in."""
    depth, rock, _, _ = deepest_rocks(terrain, centre, axle, RADIUS)
    found: WheelContactGeometry = wheel_on_rock(terrain, centre, axle, RADIUS, rock)
    assert found.depth == pytest.approx(depth, abs=1e-12)
    return found


def test_an_upright_wheel_touches_below_its_axle():
    found = wheel_on_floor(FLAT, (1.0, 2.0, 0.145), LEFT, RADIUS)
    assert found.depth == pytest.approx(0.005)
    np.testing.assert_allclose(found.normal, (0.0, 0.0, 1.0))
    np.testing.assert_allclose(found.forward, (1.0, 0.0, 0.0))
    np.testing.assert_allclose(found.arm, (0.0, 0.0, -RADIUS))


def test_a_leaning_wheel_touches_with_its_rim():
    lean = math.radians(30.0)
    axle = (0.0, math.cos(lean), math.sin(lean))
    found = wheel_on_floor(FLAT, (0.0, 0.0, 0.1), axle, RADIUS)
    assert found.depth == pytest.approx(RADIUS * math.cos(lean) - 0.1)
    np.testing.assert_allclose(found.arm, (0.0, RADIUS * math.sin(lean), -RADIUS * math.cos(lean)))
    np.testing.assert_allclose(found.forward, (1.0, 0.0, 0.0))


def test_a_wheel_that_lies_flat_has_no_forward():
    found = wheel_on_floor(FLAT, (0.0, 0.0, -0.01), (0.0, 0.0, 1.0), RADIUS)
    assert found.depth == pytest.approx(0.01)
    assert found.forward == (0.0, 0.0, 0.0)


def test_a_wheel_in_the_air_is_clear():
    assert wheel_on_floor(FLAT, (0.0, 0.0, 3.0), LEFT, RADIUS).depth == pytest.approx(-2.85)
    assert in_rock(FLAT, (0.0, 0.0, 0.1), LEFT).depth < -0.1


def test_relief_is_met_at_the_rim():
    terrain = build_terrain(TerrainParameters(floor_height=0.0, relief=ReliefParameters(rms=0.05)))
    rng = np.random.default_rng(1)
    for _ in range(50):
        x, y = rng.uniform(-10.0, 10.0, 2)
        height = -floor_depth_and_normal(terrain, x, y, 0.0)[0]
        centre = np.array([x, y, -height + RADIUS - 0.005])
        centre[2] = height + RADIUS - 0.005
        found = wheel_on_floor(terrain, tuple(centre), LEFT, RADIUS)
        assert found.depth == pytest.approx(rim_depths(terrain, centre, LEFT).max(), abs=2e-4)


@pytest.fixture(scope="module")
def rubble() -> Terrain:
    return build_terrain(
        TerrainParameters(
            floor_height=0.0, boulders=BoulderParameters(density=0.5, smallest=0.3, largest=1.0)
        ),
        2,
    )


def touching(
    terrain: Terrain, axle: Vector, side: np.ndarray
) -> tuple[np.ndarray, WheelContactGeometry]:
    """A wheel 5 mm deep in the largest boulder, which is on the given side."""
    x, y, _, diameter, _ = boulder_list(terrain)[0]
    distance = 0.5 * diameter + RADIUS - 0.005
    centre = np.array([x, y, 0.0]) - distance * side
    return centre, in_rock(terrain, tuple(centre), axle)


@pytest.mark.parametrize("degrees", [20.0, 45.0, 80.0])
def test_a_boulder_ahead_is_touched_by_the_rim(rubble: Terrain, degrees: float):
    angle = math.radians(degrees)
    side = np.array([math.cos(angle), 0.0, -math.sin(angle)])
    centre, found = touching(rubble, LEFT, side)
    assert found.depth == pytest.approx(0.005, abs=1e-9)
    np.testing.assert_allclose(found.normal, -side, atol=1e-9)
    np.testing.assert_allclose(found.arm, RADIUS * side, atol=1e-9)
    np.testing.assert_allclose(found.forward, (math.sin(angle), 0.0, math.cos(angle)), atol=1e-9)
    if degrees > 30.0:  # away from the foot's fillet
        assert found.depth == pytest.approx(rim_depths(rubble, centre, LEFT).max(), abs=1e-5)


def test_a_boulder_beside_the_wheel_is_touched_by_the_disc(rubble: Terrain):
    x, y, _, diameter, _ = boulder_list(rubble)[0]
    centre = (x, y - 0.5 * diameter + 0.003, 0.2)
    found = in_rock(rubble, centre, LEFT)
    gap = math.hypot(0.5 * diameter - 0.003, 0.2 - RADIUS)
    assert found.depth == pytest.approx(0.5 * diameter - gap, abs=1e-9)
    assert found.normal[1] < -0.9


def test_the_two_deepest_boulders_are_found_and_none_is_missed(rubble: Terrain):
    rng = np.random.default_rng(5)
    boulders = boulder_list(rubble)
    hits = pairs = 0
    for _ in range(3000):
        k = rng.integers(len(boulders))
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2])
        direction /= np.linalg.norm(direction)
        reach = 0.5 * boulders[k, 3] + rng.uniform(0.0, RADIUS)
        centre = np.array([*boulders[k, :2], 0.0]) + reach * direction
        axle = rng.normal(size=3)
        axle /= np.linalg.norm(axle)
        to = np.column_stack([boulders[:, :2], np.zeros(len(boulders))]) - centre
        flat = to - np.outer(to @ axle, axle)
        length = np.linalg.norm(flat, axis=1, keepdims=True)
        points = flat * np.minimum(1.0, RADIUS / length)
        depths = np.sort(0.5 * boulders[:, 3] - np.linalg.norm(points - to, axis=1))
        deepest = depths[-1]
        found = in_rock(rubble, tuple(centre), tuple(axle))
        if deepest > -0.05:
            hits += 1
            assert found.depth == pytest.approx(deepest, abs=1e-9)
        else:
            assert found.depth < -0.05 + 1e-9
        first, rock, second, other = deepest_rocks(rubble, tuple(centre), tuple(axle), RADIUS)
        if depths[-2] > -0.05:
            pairs += 1
            assert second == pytest.approx(depths[-2], abs=1e-9)
            assert other not in (rock, NO_ROCK)
            assert first >= second
    assert hits > 1000
    assert pairs > 20


def test_the_wall_is_met_with_the_rim():
    hole = dataclasses.replace(MARE_TRANQUILLITATIS, wall_distance=2.0)
    terrain = build_terrain(TerrainParameters(hole=hole))
    z = -31.0
    x = terrain.axis_x - wall_radius(terrain, z)[0] + RADIUS - 0.004
    found = in_rock(terrain, (x, 0.0, z), LEFT)
    assert found.depth == pytest.approx(0.004, abs=1e-9)
    np.testing.assert_allclose(found.normal, (1.0, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(found.arm, (-RADIUS, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(found.forward, (0.0, 0.0, -1.0), atol=1e-9)
    assert in_rock(terrain, (x + 1.0, 0.0, z), LEFT).depth < -0.1
