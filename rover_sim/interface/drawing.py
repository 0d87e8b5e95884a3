"""Shapes for visualization: tether, rover, contact forces and ground."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from msg_schemas import machine
from msg_schemas.samples import Colour, Quaternion, Shape, Vector
from rover_sim.physics.ground.boulders import cap_radius
from rover_sim.physics.ground.terrain import (
    Terrain,
    boulder_list,
    floor_height,
    wall_profile,
    wall_radius,
)
from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.ancf import Array
from rover_sim.scenarios.hardware import RoverSettings

TETHER_COLOUR: Final = (0.95, 0.75, 0.20, 1.0)
"""Colour of the tether at the nominal tension."""
SLACK_COLOUR: Final = (0.45, 0.60, 0.85, 1.0)
TIGHT_COLOUR: Final = (0.90, 0.15, 0.10, 1.0)
TIGHT: Final = 3.0
"""Ratio to the nominal tension from which the tether has `TIGHT_COLOUR`."""
FORCE_COLOUR: Final = (0.25, 0.75, 0.35, 1.0)
FLOOR_COLOUR: Final = (0.42, 0.41, 0.39, 1.0)
BOULDER_COLOUR: Final = (0.34, 0.32, 0.30, 1.0)
WALL_COLOUR: Final = (0.50, 0.47, 0.44, 0.35)  # translucent
BODY1_COLOUR: Final = (0.30, 0.45, 0.65, 1.0)
BODY2_COLOUR: Final = (0.80, 0.35, 0.25, 1.0)
WHEEL_COLOUR: Final = (0.35, 0.35, 0.38, 1.0)
_TETHER_WIDTH = 0.01
_POINTS_PER_ELEMENT = 4
_FORCE_SCALE = 0.02  # [m/N]
_FORCE_SIZE = (0.015, 0.03, 0.04)  # diameters of shaft and head, length of the head [m]
_BARE_FLOOR = 20.0  # side of the drawn floor without a patch [m]
_FLOOR_MESH = 0.5  # [m]
_WALL_SECTORS = 48
_WALL_MESH = 2.0  # over depth [m]
# Quaternion that turns a cylinder's axis from z to y.
_ALONG_Y = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def nominal_tension(mass: float, line_density: float, length: float, gravity: float) -> float:
    """Return the static tension at the upper end of a hanging tether [N]; 1 N without weight.

    Args:
        mass: at the lower end [kg].
        line_density: of the tether [kg/m].
        length: of the tether [m].
        gravity: [m/s^2].
    """
    return gravity * (mass + line_density * length) or 1.0


def tether_line(nodes: Array, arc_lengths: Array, tension: Array, nominal: float) -> Shape:
    """Return the tether as a line along its cubic elements, coloured by the tension.

    Args:
        nodes: positions and slopes in map, (n + 1, 2, 3).
        arc_lengths: undeformed, from the fairlead to the nodes [m], (n + 1,).
        tension: at the nodes [N], (n + 1,).
        nominal: tension of the hanging tether [N], see `nominal_tension`.
    """
    inside = np.arange(_POINTS_PER_ELEMENT) / _POINTS_PER_ELEMENT
    weights = ancf.shape_functions(inside, 1.0)
    lengths = np.diff(arc_lengths)[:, None]
    ends = np.stack([nodes[:-1, 0], lengths * nodes[:-1, 1], nodes[1:, 0], lengths * nodes[1:, 1]])
    points = np.einsum("pk,kei->epi", weights, ends).reshape(-1, 3)
    line = np.concatenate([points, nodes[-1:, 0]])
    along = np.arange(len(line)) / _POINTS_PER_ELEMENT
    loads = np.interp(along, np.arange(len(tension)), tension) / nominal
    return Shape(
        "tether",
        "line",
        machine.WORLD_FRAME,
        TETHER_COLOUR,
        (_TETHER_WIDTH, 0.0, 0.0),
        tuple(map(tuple, line.tolist())),
        colours=_tether_colours(loads),
    )


def _tether_colours(loads: Array) -> tuple[Colour, ...]:
    """Interpolate the tether's colours for ratios of the tension to the nominal tension, (k,)."""
    stops = (SLACK_COLOUR, TETHER_COLOUR, TIGHT_COLOUR)
    parts = [np.interp(loads, (0.0, 1.0, TIGHT), part) for part in zip(*stops, strict=True)]
    return tuple(map(tuple, np.stack(parts, axis=1).tolist()))


def contact_force(name: str, place: ArrayLike, force: ArrayLike) -> Shape:
    """Return a force of the ground as an arrow to its point of application, 20 mm/N."""
    to = np.asarray(place, dtype=np.float64)
    tail = to - _FORCE_SCALE * np.asarray(force, dtype=np.float64)
    points = (as_vector(tail), as_vector(to))
    return Shape(name, "arrow", machine.WORLD_FRAME, FORCE_COLOUR, _FORCE_SIZE, points)


def ground(terrain: Terrain) -> tuple[Shape, ...]:
    """Return floor, boulders and the wall of the hole with its rim and the surrounding ground."""
    shapes = [_floor(terrain)]
    for x, y, z, diameter, height in boulder_list(terrain).tolist():
        radius = float(cap_radius(np.array(diameter), height / diameter))
        size = (2.0 * radius, 2.0 * radius, 2.0 * radius)
        centre = (x, y, z + height - radius)
        shapes.append(
            Shape("boulders", "sphere", machine.WORLD_FRAME, BOULDER_COLOUR, size, (), centre)
        )
    if terrain.has_hole:
        shapes.append(_wall(terrain))
    return tuple(shapes)


def bare_floor(height: float) -> Shape:
    """Return a square of level floor below the fairlead, at a height in map [m]."""
    ends = np.array([-0.5, 0.5]) * _BARE_FLOOR
    grid = np.array([[(x, y, height) for y in ends.tolist()] for x in ends.tolist()])
    return _triangles("floor", FLOOR_COLOUR, _meshes(grid))


def _floor(terrain: Terrain) -> Shape:
    """Return the patch, and the plane around it within the hole."""
    corner, width = (terrain.patch_x, terrain.patch_y), terrain.patch_width
    if width == 0.0:
        corner, width = (-0.5 * _BARE_FLOOR, -0.5 * _BARE_FLOOR), _BARE_FLOOR
    cells = [_cells(terrain, corner, width, max(1, round(width / _FLOOR_MESH)))]
    if terrain.has_hole:
        # Square cells around the patch, of a size that divides the patch's side.
        side = width / max(1, round(width / _WALL_MESH))
        rings = math.ceil(2.0 * wall_radius(terrain, terrain.floor_height)[0] / side)
        start = (corner[0] - rings * side, corner[1] - rings * side)
        plane = width + 2.0 * rings * side
        around = _cells(terrain, start, plane, round(plane / side))
        middle = around[:, [0, 2], :2].mean(axis=1)
        beside = np.abs(middle - np.add(corner, 0.5 * width)).max(axis=1) > 0.5 * width
        cells.append(around[beside])
    found = np.concatenate(cells)
    if terrain.has_hole:
        middle = found[:, [0, 2]].mean(axis=1)
        reach = [wall_radius(terrain, z)[0] for z in middle[:, 2].tolist()]
        found = found[np.hypot(middle[:, 0] - terrain.axis_x, middle[:, 1]) < reach]
    return _triangles("floor", FLOOR_COLOUR, found)


def _cells(terrain: Terrain, corner: tuple[float, float], width: float, count: int) -> Array:
    """Return the corners of the cells of a square of floor, in order, (count^2, 4, 3)."""
    x, y = (start + np.linspace(0.0, width, count + 1) for start in corner)
    return _meshes(
        np.array([[(a, b, floor_height(terrain, a, b)) for b in y.tolist()] for a in x.tolist()])
    )


def _wall(terrain: Terrain) -> Shape:
    outline = wall_profile(terrain)
    depth = np.cumsum(np.hypot(*np.diff(outline, axis=0, prepend=outline[:1]).T))
    at = np.linspace(0.0, depth[-1], max(2, round(depth[-1] / _WALL_MESH) + 1))
    radius, z = (np.interp(at, depth, values) for values in outline.T)
    angle = np.linspace(0.0, 2.0 * np.pi, _WALL_SECTORS + 1)
    grid = np.stack(
        [
            terrain.axis_x + np.outer(radius, np.cos(angle)),
            np.outer(radius, np.sin(angle)),
            np.repeat(z[:, None], angle.size, axis=1),
        ],
        axis=-1,
    )
    return _triangles("wall", WALL_COLOUR, _meshes(grid))


def _meshes(grid: Array) -> Array:
    """Return the corners of the cells of a surface through a grid of points, (rows, columns, 3)."""
    around = (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:])
    return np.stack(around, axis=2).reshape(-1, 4, 3)


def _triangles(name: str, colour: Colour, meshes: Array) -> Shape:
    corners = meshes[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    points = tuple(as_vector(point) for point in corners)
    return Shape(name, "triangles", machine.WORLD_FRAME, colour, (1.0, 1.0, 1.0), points)


def solid(
    name: str,
    kind: str,
    colour: tuple[float, float, float, float],
    size: Vector,
    place: ArrayLike,
    orientation: ArrayLike,
) -> Shape:
    """Return a box (size along its axes) or a cylinder (diameters, height along z) in map."""
    return Shape(
        name,
        kind,
        machine.WORLD_FRAME,
        colour,
        size,
        (),
        as_vector(place),
        as_quaternion(orientation),
    )


def rover_solids(
    rover: RoverSettings, centre1: Array, centre2: Array, rotation: Array, orientation: Array
) -> tuple[Shape, ...]:
    """Return the bodies and the wheels of a spatial rover.

    Args:
        rover: with the dimensions.
        centre1: centre of mass of Body 1 in map [m], (3,).
        centre2: of Body 2.
        rotation: of both, base_link to map, (3, 3).
        orientation: the same as a quaternion (x, y, z, w).
    """
    middle = centre1 + rotation @ np.array(rover.body1_centre)
    shapes = [
        solid(machine.BODY1_FRAME, "box", BODY1_COLOUR, rover.body1_size, middle, orientation)
    ]
    if not rover.is_single_body:
        shapes.append(
            solid(machine.BODY2_FRAME, "box", BODY2_COLOUR, rover.body2_size, centre2, orientation)
        )
    axle = _product(orientation, _ALONG_Y)
    diameter = 2.0 * rover.wheels.radius
    size = (diameter, diameter, rover.wheels.width)
    for name, place in (
        (machine.WHEEL_LEFT, rover.wheels.left),
        (machine.WHEEL_RIGHT, rover.wheels.right),
    ):
        hub = centre1 + rotation @ np.array(place)
        shapes.append(solid(name, "cylinder", WHEEL_COLOUR, size, hub, axle))
    return tuple(shapes)


def as_vector(values: ArrayLike) -> Vector:
    """Convert to three Python floats."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z)


def as_quaternion(values: ArrayLike) -> Quaternion:
    """Convert to four Python floats, (x, y, z, w)."""
    x, y, z, w = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z, w)


def _product(first: Array, second: tuple[float, float, float, float]) -> Array:
    """Return the product of two quaternions (x, y, z, w): the second rotation, then the first."""
    x0, y0, z0, w0 = first.tolist()
    x1, y1, z1, w1 = second
    return np.array(
        [
            w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1,
            w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1,
            w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1,
            w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1,
        ]
    )
