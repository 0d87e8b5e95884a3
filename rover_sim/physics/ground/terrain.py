"""Geometry of the ground: floor, boulders, wall and rim of a hole, and the surrounding ground.

The world's origin is the fairlead; z points up. `depth_and_normal` gives the depth of a point in
the ground and the outward normal. A terrain is the union of

- a floor: a plane, level or sloping, with a gentle relief on a square patch (a height field of
  quadratic B-splines), and boulders on the same patch, spherical caps (module `boulders`);
- a hole: a surface of revolution about a vertical axis, given by its radius over depth, below a rim
  rounded to a quarter of a circle and the level ground around it. Where the radius increases with
  depth the wall overhangs. The fairlead is on the mother machine's boom over the hole, at the
  height `fairlead_height` above the ground and at `wall_distance` from the wall where the hole is
  narrowest; the hole's axis is on the +x side, the mother machine on the -x side.

Depth is the distance to the plane, to the sphere of a boulder or to the rim's circle; for relief
and wall it is the height, or the radial distance, times the cosine of the surface's inclination,
which is the distance to first order. Where two surfaces meet the larger depth is used, and a fillet
rounds the crease (polynomial smooth maximum), so depth and normal are continuous. A depth below
minus `CLEARANCE` is not exact: the point is clear by more than `CLEARANCE`.

Every surface is rock or regolith: the third result `rock` varies continuously from 0 (regolith:
floor and ground) to 1 (rock: boulders and wall).
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_sim.physics.ground.boulders import BoulderParameters, cap_radius, scatter, uniform
from rover_sim.physics.ground.terrain_parameters import (
    HoleParameters,
    ReliefParameters,
    TerrainParameters,
)
from rover_sim.physics.numerics.compiled import inner_with, kernel_with

Array = NDArray[np.float64]

# LLVM inlines queries: a call would pass the terrain's many numbers on the stack. They do not count
# references to the terrain's array (_nrt).
query = inner_with(forceinline=True)
query_from_python = kernel_with(forceinline=True)

CLEARANCE = 0.25  # depths above minus this are exact [m]
WALL_FILLET = 0.2  # fillet between floor and wall [m]
BOULDER_FILLET = 0.1  # fillet at a boulder's base, per diameter [-]
_MOST_CROSSED = 1e7  # cells that boulders cross, counted for each boulder
_CELL = 0.25  # side of the cells that boulders are sorted into [m]
_MARGIN = 0.3  # cells within this plus two fillets of a boulder list it [m]
_NEAR = CLEARANCE + 2.0 * WALL_FILLET  # surfaces farther than this are skipped [m]
_WALL_SPACING = 0.25  # spacing of the wall's table in depth [m]
_BARE = 1.0e-12  # a point of the floor that is no deeper has no boulder above it [m]
_RELIEF_QUANTUM = 1.0e-6  # resolution of the heights [m]


class BouldersError(ValueError):
    """Boulders that need too much memory."""


class Terrain(NamedTuple):
    """A terrain as compiled functions see it, made by `build_terrain`."""

    floor_height: float  # of the plane at x = y = 0 [m]
    slope_x: float  # dz/dx of the plane [-]
    slope_y: float  # dz/dy [-]
    floor_cosine: float  # cosine of the plane's inclination [-]
    floor_rock: float  # 1 if the floor is bare rock [-]
    bump: float  # largest height of relief and boulders above the plane [m]
    patch_x: float  # lower corner of the patch [m]
    patch_y: float
    patch_width: float  # side of the patch [m], 0: none
    relief_nodes: int  # along one side, with one ring outside the patch; 0: no relief
    relief_inverse: float  # 1 / spacing of the nodes [1/m]
    cells: int  # of the boulders' grid along one side; 0: no boulders
    has_hole: bool
    axis_x: float  # of the hole [m]
    inner_squared: float  # squared distance to the axis that is clear of the wall [m^2]
    ground_height: float  # of the ground around the hole [m]
    rim_radius: float  # radius of the rim's rounding [m]
    opening_radius: float  # of the hole just below the rim [m]
    wall_rows: int  # of the wall's table
    # One array holds the data of the queries, in this order:
    # wall: radius [m] and d radius/dz [-] over depth below the rim's rounding, (wall_rows, 2);
    # relief: the splines' heights above the plane [m], (relief_nodes, relief_nodes);
    # cells: start index of a cell's boulders in this array, (cells^2 + 1,);
    # boulders of the cells: x, y, z of the sphere's centre, radius, fillet [m], (entries, 5);
    # boulders: x, y, z of the base's centre, diameter, height [m], (n, 5).
    table: Array
    relief_at: int  # start indices of these parts
    cells_at: int
    boulders_at: int


def build_terrain(parameters: TerrainParameters, seed: int = 0) -> Terrain:
    """Build a terrain; equal seeds give equal terrains.

    Args:
        parameters: the terrain.
        seed: of relief and boulders, a whole number, not negative.
    """
    hole = parameters.hole
    floor_height = parameters.floor_height
    axis_x = 0.0
    if hole is not None:
        floor_height = -hole.fairlead_height - hole.depth
        axis_x = hole.narrowest - hole.wall_distance
    half = parameters.patch_half_width
    corner = (parameters.patch_centre[0] - half, parameters.patch_centre[1] - half)
    slope = (parameters.slope_x, parameters.slope_y)
    has_patch = parameters.relief is not None or parameters.boulders is not None

    relief, spacing = np.zeros((0, 0)), 1.0
    if parameters.relief is not None:
        relief, spacing = _relief(parameters.relief, seed, 2.0 * half)
    wall = np.zeros((0, 2)) if hole is None else _wall_table(hole)
    terrain = Terrain(
        floor_height=float(floor_height),
        slope_x=float(slope[0]),
        slope_y=float(slope[1]),
        floor_cosine=1.0 / math.sqrt(1.0 + slope[0] ** 2 + slope[1] ** 2),
        floor_rock=1.0 if parameters.floor_is_rock else 0.0,
        bump=float(np.max(relief, initial=0.0)),
        patch_x=float(corner[0]),
        patch_y=float(corner[1]),
        patch_width=2.0 * half if has_patch else 0.0,
        relief_nodes=len(relief),
        relief_inverse=1.0 / spacing,
        cells=0,
        has_hole=hole is not None,
        axis_x=float(axis_x),
        inner_squared=0.0 if hole is None else max(0.0, hole.narrowest - _NEAR) ** 2,
        ground_height=0.0 if hole is None else -float(hole.fairlead_height),
        rim_radius=1.0 if hole is None else float(hole.rim_radius),
        opening_radius=0.0 if hole is None else hole.diameter / 2.0,
        wall_rows=len(wall),
        table=np.concatenate([wall.ravel(), relief.ravel()]),
        relief_at=wall.size,
        cells_at=wall.size + relief.size,
        boulders_at=wall.size + relief.size,
    )
    if parameters.boulders is None:
        return terrain
    return _with_boulders(terrain, parameters, parameters.boulders, seed)


def _relief(parameters: ReliefParameters, seed: int, width: float) -> tuple[Array, float]:
    """Heights of the relief's nodes with one ring outside the patch, and their spacing."""
    cells = max(4, round(width / parameters.spacing))
    bits = np.random.PCG64([seed, 1])
    position = np.arange(cells + 1, dtype=np.float64)
    heights = np.zeros((cells + 1, cells + 1))
    amplitude = 1.0
    for octave in reversed(range(parameters.octaves)):
        stride = 2.0 ** (octave + 1)
        knots = int(cells / stride) + 2
        lattice = 2.0 * uniform(bits, knots * knots).reshape(knots, knots) - 1.0
        index = (position / stride).astype(np.int64)
        t = position / stride - index
        t = t * t * (3.0 - 2.0 * t)
        rows = lattice[index] * (1.0 - t)[:, None] + lattice[index + 1] * t[:, None]
        heights += amplitude * (rows[:, index] * (1.0 - t) + rows[:, index + 1] * t)
        amplitude *= parameters.roughness
    edge = np.clip((np.minimum(position, cells - position) - 1.0) / 4.0, 0.0, 1.0)
    edge = edge * edge * (3.0 - 2.0 * edge)
    heights *= edge[:, None] * edge[None, :]  # flat at the border, to join the plane
    rms = math.sqrt(float(np.mean(heights**2)))
    if rms > 0.0:
        heights *= parameters.rms / rms
    ringed = np.zeros((cells + 3, cells + 3))
    ringed[1:-1, 1:-1] = np.round(heights / _RELIEF_QUANTUM) * _RELIEF_QUANTUM
    return ringed, width / cells


def _wall_table(hole: HoleParameters) -> Array:
    """Radius and d radius/dz of the wall, from below the rim's rounding to below the floor."""
    depth = np.arange(hole.rim_radius, hole.depth + 5.0 + _WALL_SPACING, _WALL_SPACING)
    opening = hole.diameter / 2.0
    knots = ((hole.rim_radius, 0.0), *hole.profile)
    radius = np.full(depth.size, opening)
    slope = np.zeros(depth.size)
    for (upper, wide0), (lower, wide1) in pairwise(knots):
        t = np.clip((depth - upper) / (lower - upper), 0.0, 1.0)
        radius += (wide1 - wide0) * t * t * (3.0 - 2.0 * t)
        slope -= (wide1 - wide0) * 6.0 * t * (1.0 - t) / (lower - upper)
    return np.column_stack([radius, slope])


def _with_boulders(
    terrain: Terrain, parameters: TerrainParameters, field: BoulderParameters, seed: int
) -> Terrain:
    """Add the boulders, sorted into the cells from which they can be in contact."""
    found = scatter(field, seed, parameters.patch_centre, parameters.patch_half_width)
    offset = np.abs(found[:, :2] - parameters.patch_centre).max(axis=1)
    reach = boulder_reach(found[:, 2])
    found = found[offset + reach < parameters.patch_half_width]  # whole inside the patch
    if parameters.hole is not None:
        to_axis = np.sqrt((found[:, 0] - terrain.axis_x) ** 2 + found[:, 1] ** 2)
        found = found[to_axis < wall_radius(terrain, terrain.floor_height)[0]]
    diameter = found[:, 2]
    radius = cap_radius(diameter, field.height_ratio)
    height = field.height_ratio * diameter
    fillet = BOULDER_FILLET * diameter
    base = np.array([floor_height(terrain, x, y) for x, y in found[:, :2].tolist()])
    spheres = np.column_stack([found[:, :2], base + height - radius, radius, fillet])
    cells = math.ceil(terrain.patch_width / _CELL)
    reach = boulder_reach(diameter)
    crossed = float(np.sum((2.0 * reach / _CELL + 1.0) ** 2))
    if crossed > _MOST_CROSSED:
        raise BouldersError(
            f"{len(found)} boulders on the patch cross {crossed:.3g} of its cells, at most"
            f" {_MOST_CROSSED:g} fit the memory; should be smaller, or fewer by density"
        )
    members: list[list[int]] = [[] for _ in range(cells * cells)]
    for k in range(len(found)):
        columns = _cell_range(found[k, 0] - terrain.patch_x, reach[k], cells)
        for j in _cell_range(found[k, 1] - terrain.patch_y, reach[k], cells):
            for i in columns:
                members[j * cells + i].append(k)
    entries = np.array([k for cell in members for k in cell], dtype=np.int64)
    start = terrain.cells_at + cells * cells + 1 + 5 * np.cumsum([0, *map(len, members)])
    top = height - radius + radius / terrain.floor_cosine + fillet
    return terrain._replace(
        cells=cells,
        table=np.concatenate(
            [
                terrain.table,
                start,
                spheres[entries].ravel(),
                np.column_stack([found[:, :2], base, diameter, height]).ravel(),
            ]
        ),
        boulders_at=int(start[-1]),
        bump=terrain.bump + float(np.max(top, initial=0.0)),
    )


def boulder_reach(diameter: ArrayLike) -> Array:
    """Distance [m] from a boulder's centre within which it must be listed."""
    return np.asarray((0.5 + 2.0 * BOULDER_FILLET) * np.asarray(diameter) + _MARGIN)


def _cell_range(middle: float, reach: float, cells: int) -> range:
    """Indices of the cells that lie within reach of a coordinate on the patch."""
    first = math.floor((middle - reach) / _CELL)
    last = math.floor((middle + reach) / _CELL)
    return range(max(first, 0), min(last, cells - 1) + 1)


@query
def _relief_at(terrain: Terrain, px: float, py: float) -> tuple[float, float, float]:
    """Relief's height [m] and slopes at a point of the patch: quadratic B-splines."""
    table = terrain.table
    stride = terrain.relief_nodes
    a = px * terrain.relief_inverse
    b = py * terrain.relief_inverse
    i = min(int(a + 0.5), stride - 3)
    j = min(int(b + 0.5), stride - 3)
    a -= i
    b -= j
    v0, v1, v2 = 0.5 * (0.5 - b) * (0.5 - b), 0.75 - b * b, 0.5 * (0.5 + b) * (0.5 + b)
    t0, t1, t2 = b - 0.5, -2.0 * b, b + 0.5
    height = 0.0
    slope_x = 0.0
    slope_y = 0.0
    at = terrain.relief_at + i * stride + j
    for u, s in (
        (0.5 * (0.5 - a) * (0.5 - a), a - 0.5),
        (0.75 - a * a, -2.0 * a),
        (0.5 * (0.5 + a) * (0.5 + a), a + 0.5),
    ):
        n0, n1, n2 = table[at], table[at + 1], table[at + 2]
        along = v0 * n0 + v1 * n1 + v2 * n2
        height += u * along
        slope_x += s * along
        slope_y += u * (t0 * n0 + t1 * n1 + t2 * n2)
        at += stride
    return height, slope_x * terrain.relief_inverse, slope_y * terrain.relief_inverse


@query_from_python
def floor_height(terrain: Terrain, x: float, y: float) -> float:
    """Height of the floor without its boulders [m]."""
    height = terrain.floor_height + terrain.slope_x * x + terrain.slope_y * y
    px = x - terrain.patch_x
    py = y - terrain.patch_y
    width = terrain.patch_width
    if terrain.relief_nodes > 0 and 0.0 <= px < width and 0.0 <= py < width:
        height += _relief_at(terrain, px, py)[0]
    return height


@query
def floor_depth_and_normal(
    terrain: Terrain, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Depth [m] and unit normal of the floor alone, without boulders and wall."""
    above = z - terrain.floor_height - terrain.slope_x * x - terrain.slope_y * y
    px = x - terrain.patch_x
    py = y - terrain.patch_y
    width = terrain.patch_width
    if terrain.relief_nodes == 0 or not (0.0 <= px < width and 0.0 <= py < width):
        cosine = terrain.floor_cosine
        return -above * cosine, -terrain.slope_x * cosine, -terrain.slope_y * cosine, cosine
    height, slope_x, slope_y = _relief_at(terrain, px, py)
    slope_x += terrain.slope_x
    slope_y += terrain.slope_y
    cosine = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return (height - above) * cosine, -slope_x * cosine, -slope_y * cosine, cosine


@query
def cell_boulders(terrain: Terrain, x: float, y: float) -> tuple[int, int]:
    """Where in the table those boulders begin and end, by fives, that are near a point."""
    px = x - terrain.patch_x
    py = y - terrain.patch_y
    width = terrain.patch_width
    if terrain.cells == 0 or not (0.0 <= px < width and 0.0 <= py < width):
        return 0, 0
    cell = terrain.cells_at + int(py * (1.0 / _CELL)) * terrain.cells + int(px * (1.0 / _CELL))
    return int(terrain.table[cell]), int(terrain.table[cell + 1])


@query
def _floor(
    terrain: Terrain, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Depth, normal and rock of floor and boulders alone."""
    above = z - terrain.floor_height - terrain.slope_x * x - terrain.slope_y * y
    cosine = terrain.floor_cosine
    if above * cosine > terrain.bump + _NEAR:
        return terrain.bump - above * cosine, 0.0, 0.0, 1.0, terrain.floor_rock
    depth, nx, ny, nz = floor_depth_and_normal(terrain, x, y, z)
    rock = terrain.floor_rock
    table = terrain.table
    start, stop = cell_boulders(terrain, x, y)
    blended = False
    for k in range(start, stop, 5):
        dx, dy, dz = x - table[k], y - table[k + 1], z - table[k + 2]
        radius = table[k + 3]
        fillet = table[k + 4]
        reach = radius + fillet - depth
        distance = dx * dx + dy * dy + dz * dz
        if reach <= 0.0 or distance >= reach * reach:
            continue
        distance = max(math.sqrt(distance), 1.0e-9)
        excess = radius - distance - depth
        inverse = 1.0 / distance
        if excess >= fillet:
            depth += excess
            nx, ny, nz = dx * inverse, dy * inverse, dz * inverse
            rock = 1.0
            blended = False
            continue
        # smooth maximum: its weight goes from 0 to 1 as the excess goes from -fillet to fillet
        weight = 0.5 + 0.5 * excess / fillet
        depth += fillet * weight * weight
        nx += weight * (dx * inverse - nx)
        ny += weight * (dy * inverse - ny)
        nz += weight * (dz * inverse - nz)
        rock += weight * (1.0 - rock)
        blended = True
    if blended:
        inverse = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx *= inverse
        ny *= inverse
        nz *= inverse
    return depth, nx, ny, nz, rock


@query_from_python
def wall_radius(terrain: Terrain, z: float) -> tuple[float, float]:
    """Radius of the wall [m] at a height below the rim's rounding, and d radius/dz [-]."""
    table = terrain.table
    t = (terrain.ground_height - terrain.rim_radius - z) * (1.0 / _WALL_SPACING)
    i = min(max(int(t), 0), terrain.wall_rows - 2)
    t = min(max(t - i, 0.0), 1.0)
    r0, r1 = table[2 * i], table[2 * i + 2]
    s0, s1 = -table[2 * i + 1] * _WALL_SPACING, -table[2 * i + 3] * _WALL_SPACING
    t2 = t * t
    t3 = t2 * t
    rise = 3.0 * t2 - 2.0 * t3
    radius = r0 + (r1 - r0) * rise + s0 * (t - 2.0 * t2 + t3) + s1 * (t3 - t2)
    slope = (r1 - r0) * 6.0 * (t - t2) + s0 * (1.0 - 4.0 * t + 3.0 * t2) + s1 * (3.0 * t2 - 2.0 * t)
    return radius, -slope * (1.0 / _WALL_SPACING)


@query
def wall_depth_and_normal(
    terrain: Terrain, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Depth [m], unit normal and rock [-] of wall, rim and the ground around the hole alone."""
    dx = x - terrain.axis_x
    distance = math.sqrt(dx * dx + y * y)
    round_z = z - terrain.ground_height + terrain.rim_radius
    if round_z > 0.0:
        inward = terrain.opening_radius + terrain.rim_radius - distance
        if inward <= 0.0:
            return terrain.ground_height - z, 0.0, 0.0, 1.0, 0.0
        away = math.sqrt(inward * inward + round_z * round_z)
        cosine = inward / away
        outward = -cosine / max(distance, 1.0e-9)
        return (
            terrain.rim_radius - away,
            outward * dx,
            outward * y,
            round_z / away,
            cosine * cosine,
        )
    radius, slope = wall_radius(terrain, z)
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    outward = -cosine / max(distance, 1.0e-9)
    return (distance - radius) * cosine, outward * dx, outward * y, slope * cosine, 1.0


@query
def depth_and_normal(
    terrain: Terrain, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Depth of a point in the ground, outward normal, and material.

    Returns:
        Depth [m], positive inside the ground; three components of the outward unit normal; and
        the fraction of rock, 0 (regolith) to 1 (rock).
    """
    depth, nx, ny, nz, rock = _floor(terrain, x, y, z)
    if not terrain.has_hole:
        return depth, nx, ny, nz, rock
    if (x - terrain.axis_x) ** 2 + y * y < terrain.inner_squared:
        return depth, nx, ny, nz, rock
    wall, wx, wy, wz, wall_rock = wall_depth_and_normal(terrain, x, y, z)
    excess = wall - depth
    if excess >= WALL_FILLET:
        return wall, wx, wy, wz, wall_rock
    if excess <= -WALL_FILLET:
        return depth, nx, ny, nz, rock
    weight = 0.5 + (0.5 / WALL_FILLET) * excess
    nx += weight * (wx - nx)
    ny += weight * (wy - ny)
    nz += weight * (wz - nz)
    inverse = 1.0 / max(math.sqrt(nx * nx + ny * ny + nz * nz), 1.0e-9)
    return (
        depth + WALL_FILLET * weight * weight,
        nx * inverse,
        ny * inverse,
        nz * inverse,
        rock + weight * (wall_rock - rock),
    )


@query_from_python
def _fill_heights(terrain: Terrain, x: Array, y: Array, heights: Array) -> None:
    for i in range(x.size):
        low = floor_height(terrain, x[i], y[i])
        heights[i] = low
        if _floor(terrain, x[i], y[i], low)[0] <= _BARE:
            continue
        high = low + terrain.bump
        for _ in range(40):
            middle = 0.5 * (low + high)
            if _floor(terrain, x[i], y[i], middle)[0] > 0.0:
                low = middle
            else:
                high = middle
        heights[i] = 0.5 * (low + high)


def floor_heights(terrain: Terrain, x: ArrayLike, y: ArrayLike) -> Array:
    """Return heights z of the floor with its boulders at some points [m].

    Args:
        terrain: of the floor.
        x: of the points in map [m], of any shape.
        y: of the points [m], of a shape that fits x.
    """
    xs, ys = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    heights = np.empty(xs.size)
    _fill_heights(terrain, xs.ravel(), ys.ravel(), heights)
    return heights.reshape(xs.shape)


def boulder_list(terrain: Terrain) -> Array:
    """Boulders, largest first: x, y, z of the base's centre, diameter, height [m], (n, 5)."""
    return terrain.table[terrain.boulders_at :].reshape(-1, 5)


def wall_profile(terrain: Terrain, reach: float = 10.0) -> Array:
    """Profile of ground, rim and wall: distance from the hole's axis and z [m], (k, 2), downwards.

    Args:
        terrain: a terrain with a hole.
        reach: width of the ground around the rim [m].

    Raises:
        ValueError: the terrain has no hole.
    """
    if not terrain.has_hole:
        raise ValueError("this terrain has no hole")
    rim, opening, ground = terrain.rim_radius, terrain.opening_radius, terrain.ground_height
    angle = np.linspace(0.0, math.pi / 2.0, 25)
    arc = np.column_stack([opening + rim - rim * np.sin(angle), ground - rim + rim * np.cos(angle)])
    z = ground - rim - _WALL_SPACING * np.arange(terrain.wall_rows)
    radius = terrain.table[: 2 * terrain.wall_rows : 2]
    wall = np.column_stack([radius, z])[z >= terrain.floor_height]
    outer = [[opening + rim + reach, ground]]
    return np.concatenate([outer, arc, wall[1:]])
