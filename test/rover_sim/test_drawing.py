"""Drawings: tether coloured by tension, contact forces, and ground."""

from __future__ import annotations

import math

import numpy as np
import pytest

from msg_schemas.samples import Shape
from rover_sim import load_spatial
from rover_sim.interface.drawing import (
    SLACK_COLOUR,
    TETHER_COLOUR,
    TIGHT_COLOUR,
    contact_force,
    ground,
    nominal_tension,
    tether_line,
)
from rover_sim.physics.ground.terrain import boulder_list, floor_height, wall_radius

STRAIGHT = np.array([[[0.0, 0.0, -z], [0.0, 0.0, -1.0]] for z in (0.0, 1.0, 2.0)])
ARCS = np.array([0.0, 1.0, 2.0])


def corners(shape: Shape) -> np.ndarray:
    assert shape.kind == "triangles"
    return np.array(shape.points).reshape(-1, 3, 3)


def test_the_tether_is_coloured_by_its_tension():
    line = tether_line(STRAIGHT, ARCS, np.array([30.0, 10.0, -1.0]), 10.0)
    assert len(line.colours) == len(line.points)
    at = {round(-z, 6): colour for (_, _, z), colour in zip(line.points, line.colours, strict=True)}
    assert at[0.0] == pytest.approx(TIGHT_COLOUR)
    assert at[1.0] == pytest.approx(TETHER_COLOUR)
    assert at[2.0] == pytest.approx(SLACK_COLOUR)
    halfway = np.mean([TIGHT_COLOUR, TETHER_COLOUR], axis=0)
    assert at[0.5] == pytest.approx(tuple(halfway))


def test_the_nominal_tension_is_the_weight_below():
    assert nominal_tension(10.0, 5e-3, 40.0, 1.62) == pytest.approx(16.524)
    assert nominal_tension(10.0, 5e-3, 40.0, 0.0) == 1.0


def test_a_force_is_an_arrow_to_its_point_of_application():
    arrow = contact_force("force", (1.0, 2.0, 3.0), (0.0, 0.0, 10.0))
    assert arrow.points[1] == (1.0, 2.0, 3.0)
    assert arrow.points[0] == pytest.approx((1.0, 2.0, 2.8))


def test_floor_and_boulders_are_those_of_the_terrain():
    terrain = load_spatial("floor_rubble").environment.build()
    shapes = ground(terrain)
    floor = next(shape for shape in shapes if shape.namespace == "floor")
    for x, y, z in corners(floor).reshape(-1, 3)[::101]:
        assert z == pytest.approx(floor_height(terrain, x, y), abs=1e-12)
    boulders = [shape for shape in shapes if shape.namespace == "boulders"]
    known = boulder_list(terrain)
    assert len(boulders) == len(known) > 10
    for shape, (x, y, z, diameter, height) in zip(boulders, known, strict=True):
        radius = 0.5 * shape.size[0]
        assert shape.position[:2] == pytest.approx((x, y))
        assert shape.position[2] + radius == pytest.approx(z + height)
        footprint = radius**2 - (z - shape.position[2]) ** 2  # squared radius at the floor
        assert math.sqrt(footprint) == pytest.approx(0.5 * diameter)
    assert not any(shape.namespace == "wall" for shape in shapes)


def test_the_wall_of_a_hole_is_where_the_rover_would_touch_it():
    terrain = load_spatial("marius_hills").environment.build()
    wall = next(shape for shape in ground(terrain) if shape.namespace == "wall")
    x, y, z = corners(wall).reshape(-1, 3).T
    distance = np.hypot(x - terrain.axis_x, y)
    below = z < terrain.ground_height - terrain.rim_radius - 0.01
    assert below.sum() > 1000
    expected = [wall_radius(terrain, float(depth))[0] for depth in z[below]]
    assert distance[below] == pytest.approx(expected, abs=0.02)
    assert z.min() < terrain.floor_height + 0.5
    assert z.max() == pytest.approx(terrain.ground_height)
    normals = np.cross(*np.diff(corners(wall), axis=1).transpose(1, 0, 2))
    assert np.linalg.norm(normals, axis=1).min() > 0.0


def test_the_floor_fills_the_hole_and_no_more():
    terrain = load_spatial("marius_hills").environment.build()
    floor = corners(next(shape for shape in ground(terrain) if shape.namespace == "floor"))
    radius = wall_radius(terrain, terrain.floor_height)[0]
    distance = np.hypot(floor[:, :, 0] - terrain.axis_x, floor[:, :, 1])
    assert distance.max() < radius + 2.0
    sides = np.diff(floor[:, :, :2], axis=1)
    areas = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    assert areas.sum() == pytest.approx(math.pi * radius**2, rel=0.02)
