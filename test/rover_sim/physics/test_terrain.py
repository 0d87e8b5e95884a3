import dataclasses
import hashlib
import math
from typing import Any

import numpy as np
import pytest
from numba import njit

from rover_sim.physics.ground.boulders import (
    BoulderParameters,
    BoulderPlace,
    cap_radius,
    diameter_at,
    scatter,
)
from rover_sim.physics.ground.terrain import (
    CLEARANCE,
    Terrain,
    boulder_list,
    build_terrain,
    depth_and_normal,
    floor_depth_and_normal,
    floor_height,
    floor_heights,
    wall_depth_and_normal,
    wall_profile,
    wall_radius,
)
from rover_sim.physics.ground.terrain_parameters import (
    MARE_INGENII,
    MARE_TRANQUILLITATIS,
    MARIUS_HILLS,
    HoleParameters,
    ReliefParameters,
    TerrainParameters,
)

HOLES = {
    "Marius Hills": MARIUS_HILLS,
    "Mare Tranquillitatis": MARE_TRANQUILLITATIS,
    "Mare Ingenii": MARE_INGENII,
}


def rubble(**changes: Any) -> BoulderParameters:
    return dataclasses.replace(BoulderParameters(density=2.0, exponent=1.8), **changes)


def rough_hole(hole: HoleParameters, seed: int = 5) -> Terrain:
    return build_terrain(
        TerrainParameters(hole=hole, boulders=rubble(), relief=ReliefParameters()), seed
    )


def shrunk(hole: HoleParameters) -> HoleParameters:
    """The same hole with its floor just below the rim, so that wall and floor lie close by."""
    return dataclasses.replace(hole, depth=8.0, profile=((3.0, -1.0), (5.0, 1.0)))


# -------------------------------------------------------------------- plane and slope


def test_a_plane_s_depth_is_the_height_below_it():
    terrain = build_terrain(TerrainParameters(floor_height=-4.0, floor_is_rock=True))
    assert depth_and_normal(terrain, 3.0, -2.0, -4.1) == pytest.approx((0.1, 0, 0, 1, 1))
    assert depth_and_normal(terrain, 3.0, -2.0, -3.8)[0] == pytest.approx(-0.2)
    assert depth_and_normal(terrain, 0.0, 0.0, 100.0)[0] < -CLEARANCE


def test_a_slope_s_depth_is_the_distance_to_it():
    slope = math.radians(15.0)
    terrain = build_terrain(TerrainParameters(floor_height=-1.0, slope_x=-math.tan(slope)))
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    along = np.array([math.cos(slope), 0.0, -math.sin(slope)])
    for depth in (-0.2, 0.0, 0.03):
        point = np.array([0.0, 0.0, -1.0]) + 7.0 * along - depth * normal
        found = depth_and_normal(terrain, *point)
        assert found[0] == pytest.approx(depth, abs=1e-12)
        np.testing.assert_allclose(found[1:4], normal, atol=1e-12)
        assert found[4] == 0.0


# ------------------------------------------------------------------------- boulders


def test_a_boulder_is_a_spherical_cap_of_rock():
    terrain = build_terrain(TerrainParameters(boulders=rubble(density=0.3)), seed=3)
    x, y, base, diameter, height = boulder_list(terrain)[0]
    assert base == -5.0
    assert height == pytest.approx(0.5 * diameter)
    top = depth_and_normal(terrain, x, y, base + height + 0.1)
    assert top == pytest.approx((-0.1, 0.0, 0.0, 1.0, 1.0), abs=1e-9)
    # half way up its flank, from the sphere's centre at the floor
    c = math.sqrt(0.5)
    r = 0.5 * diameter + 0.02
    flank = depth_and_normal(terrain, x - r * c, y, base + r * c)
    assert flank == pytest.approx((-0.02, -c, 0.0, c, 1.0), abs=1e-9)


def test_a_cap_has_the_given_diameter_and_height():
    diameter = np.array([0.1, 1.0, 3.0])
    for ratio in (0.2, 0.5):
        radius = cap_radius(diameter, ratio)
        height = ratio * diameter
        np.testing.assert_allclose(radius**2, (radius - height) ** 2 + (diameter / 2) ** 2)


def test_diameters_follow_the_power_law():
    field = BoulderParameters(density=20.0, exponent=2.5)
    found = scatter(field, 11, (0.0, 0.0), 20.0)
    count = len(found)
    assert count == 20 * 1600
    diameter = found[:, 2]
    assert diameter.min() >= 0.1 - 1e-9
    assert diameter.max() <= 3.0 + 1e-9
    assert np.all(np.diff(diameter) <= 0.0)
    cut = (3.0 / 0.1) ** -2.5
    for limit in (0.15, 0.3, 0.6):
        share = ((limit / 0.1) ** -2.5 - cut) / (1.0 - cut)
        scatter_of_count = math.sqrt(count * share * (1 - share))
        assert abs(np.sum(diameter >= limit) - count * share) < 4 * scatter_of_count, limit
    # even over the area: quarters hold a quarter each
    quarter = np.sum((found[:, 0] > 0) & (found[:, 1] > 0))
    assert abs(quarter - count / 4) < 4 * math.sqrt(count * 3 / 16)


def test_the_inverse_of_the_power_law_meets_its_ends():
    field = BoulderParameters()
    assert diameter_at(field, 0.0) == pytest.approx(0.1)
    assert diameter_at(field, 1.0 - 2.0**-53) == pytest.approx(3.0, rel=1e-6)


def test_a_seed_gives_the_same_field_everywhere():
    """The digests were taken once; they hold for every machine and every version of numpy."""
    field = scatter(BoulderParameters(density=1.0), 42, (1.0, -2.0), 10.0)
    assert field.shape == (400, 3)
    assert field[0].tolist() == pytest.approx(
        [4.053734697385105, 7.840840110561098, 1.749752], abs=1e-12
    )
    digest = hashlib.sha256(np.round(field / 1e-6).astype("<i8").tobytes()).hexdigest()
    assert digest[:16] == "3b6ab15a77f451e2"
    assert not np.array_equal(field, scatter(BoulderParameters(density=1.0), 43, (1.0, -2.0), 10.0))


def test_a_seed_gives_the_same_terrain():
    parameters = TerrainParameters(
        hole=MARIUS_HILLS, boulders=BoulderParameters(), relief=ReliefParameters()
    )
    first, second = build_terrain(parameters, 7), build_terrain(parameters, 7)
    np.testing.assert_array_equal(first.table, second.table)
    other = build_terrain(parameters, 8)
    assert not np.array_equal(boulder_list(first), boulder_list(other))


def test_the_landing_site_stays_clear():
    terrain = build_terrain(TerrainParameters(boulders=rubble(clear_radius=2.0)), 1)
    boulders = boulder_list(terrain)
    assert len(boulders) > 500
    assert np.min(np.hypot(boulders[:, 0], boulders[:, 1]) - 0.5 * boulders[:, 3]) >= 2.0


def test_placed_boulders_join_the_random_ones_also_within_the_clear_radius():
    stone = BoulderPlace(0.4, -0.2, 0.08)
    random = build_terrain(TerrainParameters(boulders=rubble(clear_radius=2.0)), 1)
    terrain = build_terrain(
        TerrainParameters(boulders=rubble(clear_radius=2.0, placed=(stone,))), 1
    )
    expected = np.vstack([boulder_list(random), [0.4, -0.2, -5.0, 0.08, 0.04]])
    np.testing.assert_allclose(np.sort(boulder_list(terrain), 0), np.sort(expected, 0))
    assert floor_heights(terrain, 0.4, -0.2) == pytest.approx(-4.96)
    assert depth_and_normal(terrain, 0.4, -0.2, -4.97)[0] == pytest.approx(0.01)


@pytest.mark.parametrize("diameter", [0.0, -0.1, math.nan])
def test_a_placed_boulder_without_size_is_refused(diameter: float):
    with pytest.raises(ValueError, match="diameter = "):
        BoulderPlace(0.0, 0.0, diameter)


def test_every_boulder_is_found_by_the_query():
    terrain = build_terrain(TerrainParameters(boulders=rubble(), relief=ReliefParameters()), 4)
    for x, y, base, _, height in boulder_list(terrain):
        assert depth_and_normal(terrain, x, y, base + height - 1e-3)[0] >= 1e-3 - 1e-9


# --------------------------------------------------------------------------- relief


def test_relief_has_the_given_rms_height_and_joins_the_plane():
    parameters = TerrainParameters(
        relief=ReliefParameters(rms=0.05), slope_x=0.1, patch_half_width=20.0
    )
    terrain = build_terrain(parameters, 2)
    line = np.linspace(-20.0, 20.0, 161)
    plane = -5.0 + 0.1 * line
    heights = floor_heights(terrain, line, line[:, None]) - plane
    assert np.sqrt(np.mean(heights**2)) == pytest.approx(0.05, rel=0.25)
    for edge in (-20.0, 20.0):
        for side in (-1e-6, 1e-6):
            depth, *normal = floor_depth_and_normal(terrain, edge + side, 3.0, -5.0 + 0.1 * edge)
            assert depth == pytest.approx(0.0, abs=1e-6)
            np.testing.assert_allclose(normal, [-0.0995037, 0.0, 0.9950372], atol=1e-5)


# ------------------------------------------------------------- wall, rim, overhang


@pytest.mark.parametrize(
    ("name", "across", "depth", "overhangs_from"),
    [
        ("Marius Hills", (58.0, 65.0), 50.0, 24.0),
        ("Mare Tranquillitatis", (88.0, 100.0), 105.0, 40.0),
        ("Mare Ingenii", (120.0, 130.0), 60.0, 25.0),
    ],
)
def test_the_known_pits_have_their_dimensions(
    name: str, across: tuple[float, float], depth: float, overhangs_from: float
):
    hole = HOLES[name]
    terrain = build_terrain(TerrainParameters(hole=hole))
    profile = wall_profile(terrain)
    ground = -hole.fairlead_height
    assert terrain.floor_height == pytest.approx(ground - depth)
    upper = profile[profile[:, 1] > ground - overhangs_from - 0.3]
    wall = upper[upper[:, 1] <= ground - hole.rim_radius + 1e-9]
    assert 2 * wall[:, 0].min() >= across[0] - 0.1
    assert 2 * wall[:, 0].max() <= across[1] + 0.1
    below = profile[profile[:, 1] < ground - overhangs_from]
    assert np.all(np.diff(below[:, 0]) >= -1e-9)
    assert below[-1, 0] - wall[:, 0].min() > 5.0  # the floor extends under the neck


@pytest.mark.parametrize("name", HOLES)
@pytest.mark.parametrize("distance", [1.5, 6.0])
def test_the_plumb_line_hangs_at_its_distance_from_the_wall(name: str, distance: float):
    hole = dataclasses.replace(HOLES[name], wall_distance=distance)
    terrain = build_terrain(TerrainParameters(hole=hole))
    nearest = math.inf
    for z in np.arange(terrain.floor_height + 1.0, -0.1, 0.5):
        assert depth_and_normal(terrain, 0.0, 0.0, z)[0] < 0.0
        if z < -hole.fairlead_height - hole.rim_radius:
            to_wall = wall_radius(terrain, z)[0] - terrain.axis_x
            nearest = min(nearest, to_wall)
            assert depth_and_normal(terrain, -to_wall - 0.02, 0.0, z)[0] > 0.0
            assert depth_and_normal(terrain, -to_wall + 0.02, 0.0, z)[0] < 0.0
    assert nearest == pytest.approx(distance, abs=1e-6)


def test_the_wall_pushes_towards_the_axis_and_down_where_it_overhangs():
    terrain = build_terrain(TerrainParameters(hole=MARE_TRANQUILLITATIS))
    for angle in np.linspace(0.0, 2 * math.pi, 7):
        radius, slope = wall_radius(terrain, -31.0)
        assert slope == pytest.approx(0.0, abs=1e-12)
        x, y = math.cos(angle), math.sin(angle)
        depth, nx, ny, nz, rock = depth_and_normal(
            terrain, terrain.axis_x + (radius + 0.05) * x, (radius + 0.05) * y, -31.0
        )
        assert depth == pytest.approx(0.05, abs=1e-9)
        np.testing.assert_allclose((nx, ny, nz), (-x, -y, 0.0), atol=1e-9)
        assert rock == 1.0
        radius, slope = wall_radius(terrain, -47.0)
        assert slope < -0.5  # wider below
        _, nx, ny, nz, _ = depth_and_normal(terrain, terrain.axis_x + radius * x, radius * y, -47.0)
        assert nz < -0.4
        assert nx * x + ny * y < -0.5


def test_the_rim_is_a_quarter_circle_from_ground_to_wall():
    hole = dataclasses.replace(MARIUS_HILLS, rim_radius=2.0)
    terrain = build_terrain(TerrainParameters(hole=hole))
    centre = np.array([hole.diameter / 2 + 2.0, -1.0 - 2.0])
    for angle in np.linspace(0.0, math.pi / 2, 9):
        out = np.array([-math.sin(angle), math.cos(angle)])
        distance, z = centre + 1.9 * out
        depth, nx, ny, nz, rock = depth_and_normal(terrain, terrain.axis_x + distance, 0.0, z)
        assert depth == pytest.approx(0.1, abs=1e-3)
        np.testing.assert_allclose((nx, ny, nz), (out[0], 0.0, out[1]), atol=1e-3)
        assert rock == pytest.approx(math.sin(angle) ** 2, abs=1e-3)
    far = depth_and_normal(terrain, terrain.axis_x - hole.diameter, 0.0, -1.1)
    assert far == pytest.approx((0.1, 0.0, 0.0, 1.0, 0.0), abs=1e-9)


# ------------------------------------------------------------------- the union as a whole


@pytest.mark.parametrize(
    "terrain",
    [
        build_terrain(TerrainParameters(boulders=rubble(), relief=ReliefParameters()), 6),
        build_terrain(TerrainParameters(boulders=rubble(height_ratio=0.3), slope_x=0.2), 6),
        rough_hole(shrunk(MARIUS_HILLS)),
    ],
    ids=["rubble", "rubble on a slope", "hole"],
)
def test_depth_and_normal_are_continuous_and_belong_together(terrain: Terrain):
    """Along lines just below and above the ground: no jump, unit normals, n along -grad d."""
    rng = np.random.default_rng(1)
    step = 2e-4
    seen = 0
    for _ in range(60):
        start = np.array([*rng.uniform(-10.0, 10.0, 2), 0.0])
        angle = rng.uniform(0.0, 2 * math.pi)
        direction = np.array([math.cos(angle), math.sin(angle), rng.uniform(-0.5, 0.5)])
        start[2] = floor_height(terrain, start[0], start[1]) + rng.uniform(-0.1, 0.6)
        direction /= np.linalg.norm(direction)
        points = start + step * np.arange(2000)[:, None] * direction
        values = np.array([depth_and_normal(terrain, *point) for point in points])
        np.testing.assert_allclose(np.linalg.norm(values[:, 1:4], axis=1), 1.0, atol=1e-9)
        assert values[:, 4].min() >= 0.0
        assert values[:, 4].max() <= 1.0
        near = np.flatnonzero(np.abs(values[:, 0]) < 0.02)
        near = near[near < len(values) - 1]
        if not len(near):
            continue
        jumps = np.abs(np.diff(values, axis=0))[near]
        assert jumps[:, 0].max() <= 1.5 * step
        # the sharpest curvature is that of the fillet of the smallest boulder, 10 mm
        assert jumps[:, 1:].max() < 0.1
        for point, value in zip(points[near[::40]], values[near[::40]], strict=True):
            gradient = np.array(
                [
                    depth_and_normal(terrain, *(point + d))[0]
                    - depth_and_normal(terrain, *(point - d))[0]
                    for d in 1e-6 * np.eye(3)
                ]
            )
            gradient /= 2e-6
            size = np.linalg.norm(gradient)
            # in the fillet between two surfaces at a right angle the gradient falls to 0.71
            assert 0.65 < size < 1.03
            assert -gradient @ value[1:4] / size > 0.999
            seen += 1
    assert seen > 200


def test_the_fillet_only_adds_ground():
    terrain = rough_hole(shrunk(MARE_INGENII))
    rng = np.random.default_rng(3)
    for _ in range(2000):
        angle = rng.uniform(-math.pi, math.pi)
        z = terrain.floor_height + rng.uniform(-0.1, 0.5)
        radius = wall_radius(terrain, z)[0] + rng.uniform(-0.4, 0.1)
        x, y = terrain.axis_x + radius * math.cos(angle), radius * math.sin(angle)
        depth = depth_and_normal(terrain, x, y, z)[0]
        floor = floor_depth_and_normal(terrain, x, y, z)[0]
        wall = wall_depth_and_normal(terrain, x, y, z)[0]
        assert depth >= max(floor, wall) - 1e-12


def test_floor_heights_lie_on_the_ground():
    terrain = build_terrain(TerrainParameters(boulders=rubble(), relief=ReliefParameters()), 9)
    x, y = np.linspace(-3.0, 3.0, 31), np.linspace(-2.0, 2.0, 21)
    heights = floor_heights(terrain, x, y[:, None])
    assert heights.shape == (21, 31)
    assert heights.max() > heights.min() + 0.05
    for j, i in np.ndindex(heights.shape):
        assert depth_and_normal(terrain, x[i], y[j], heights[j, i])[0] == pytest.approx(0, abs=1e-6)


def test_boulders_stay_inside_the_hole():
    terrain = rough_hole(dataclasses.replace(MARIUS_HILLS, wall_distance=0.5))
    boulders = boulder_list(terrain)
    distance = np.hypot(boulders[:, 0] - terrain.axis_x, boulders[:, 1])
    assert len(boulders) > 100
    assert distance.max() < wall_radius(terrain, terrain.floor_height)[0]


def test_a_query_is_compiled_code_that_takes_a_terrain():
    compiled: Any = njit

    @compiled
    def mean_depth(terrain: Terrain, count: int) -> float:
        total = 0.0
        for k in range(count):
            total += depth_and_normal(terrain, 0.1 * k, 0.0, -5.05)[0]
        return total / count

    assert mean_depth(build_terrain(TerrainParameters()), 100) == pytest.approx(0.05)


# ------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("kind", "change", "named"),
    [
        (BoulderParameters, {"density": -1.0}, "density = -1.0"),
        (BoulderParameters, {"smallest": 0.0}, "smallest = 0.0"),
        (BoulderParameters, {"largest": 0.05}, "largest = 0.05"),
        (BoulderParameters, {"height_ratio": 0.6}, "height_ratio = 0.6"),
        (BoulderParameters, {"exponent": math.nan}, "exponent = nan"),
        (ReliefParameters, {"rms": -0.1}, "rms = -0.1"),
        (ReliefParameters, {"octaves": 0}, "octaves = 0"),
        (ReliefParameters, {"spacing": 0.0}, "spacing = 0.0"),
        (ReliefParameters, {"roughness": 1.5}, "roughness = 1.5"),
        (HoleParameters, {"diameter": 0.0}, "diameter = 0.0"),
        (HoleParameters, {"profile": ((5.0, 1.0), (4.0, 1.0))}, "profile depth = 4.0"),
        (HoleParameters, {"profile": ((5.0, -40.0),)}, "profile widening = -40.0"),
        (HoleParameters, {"wall_distance": 40.0}, "wall_distance = 40.0"),
        (HoleParameters, {"rim_radius": 60.0}, "rim_radius = 60.0"),
        (TerrainParameters, {"slope_x": math.inf}, "slope_x = inf"),
        (TerrainParameters, {"patch_half_width": 0.0}, "patch_half_width = 0.0"),
        (TerrainParameters, {"patch_centre": (0.0, math.nan)}, "patch_centre"),
    ],
)
def test_impossible_terrains_are_refused(kind: type, change: dict[str, object], named: str):
    values = {"diameter": 60.0, "depth": 50.0} if kind is HoleParameters else {}
    with pytest.raises(ValueError, match=named):
        kind(**{**values, **change})


def test_a_floor_has_no_wall_to_draw():
    with pytest.raises(ValueError, match="no hole"):
        wall_profile(build_terrain(TerrainParameters()))
