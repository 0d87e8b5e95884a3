"""Contact geometry of a wheel and the ground: deepest points in the floor and in rocks.

A wheel is a thin disc of radius r (the rim, without grousers) about an axle. It has separate
contacts with the floor and with up to two rocks (boulders, wall), each at its deepest point: a
wheel that drives against a boulder has two contacts at once, as has one wedged between two
boulders. Each contact is a smooth function of the motion, which the union would not be.
"""

import math
from typing import NamedTuple

from rover_sim.physics.ground.contact import NO_VECTOR
from rover_sim.physics.ground.terrain import (
    Terrain,
    cell_boulders,
    floor_depth_and_normal,
    wall_depth_and_normal,
)
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector


class WheelContactGeometry(NamedTuple):
    """The deepest point of a wheel in a surface."""

    depth: float  # [m], above -0.1 m only if a surface is that near
    normal: Vector  # n, of the surface
    forward: Vector  # t, rolling direction of the wheel on the surface
    arm: Vector  # from the wheel's centre to the point [m]


_CLEAR = -1.0  # depth where nothing is near [m]
NO_ROCK = 0.0
"""Key of no rock."""
_WALL_KEY = -1.0
_KEY_OFFSET = 1.0e4  # makes boulders' keys differ from NO_ROCK and _WALL_KEY [m]


@inner
def _forward(axle: Vector, normal: Vector) -> Vector:
    """Unit vector a x n / |a x n|; zero for a wheel lying flat on the ground."""
    x = axle[1] * normal[2] - axle[2] * normal[1]
    y = axle[2] * normal[0] - axle[0] * normal[2]
    z = axle[0] * normal[1] - axle[1] * normal[0]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1.0e-9:
        return NO_VECTOR
    return x / length, y / length, z / length


@inner
def _arm(axle: Vector, radius: float, towards: Vector) -> Vector:
    """Vector from the centre to the rim's farthest point in a direction; zero along the axle."""
    along = axle[0] * towards[0] + axle[1] * towards[1] + axle[2] * towards[2]
    x = towards[0] - along * axle[0]
    y = towards[1] - along * axle[1]
    z = towards[2] - along * axle[2]
    length = math.sqrt(x * x + y * y + z * z)
    scale = radius / length if length > 1.0e-9 else 0.0
    return scale * x, scale * y, scale * z


@inner
def wheel_on_floor(
    terrain: Terrain, centre: Vector, axle: Vector, radius: float
) -> WheelContactGeometry:
    """Deepest point of a wheel in the floor, without boulders and wall.

    Args:
        terrain: the ground.
        centre: of the wheel [m].
        axle: unit vector, to the wheel's left.
        radius: r [m].
    """
    x, y, z = centre
    depth, nx, ny, nz = floor_depth_and_normal(terrain, x, y, z)
    if depth < -radius - 0.1:
        return WheelContactGeometry(depth + radius, (nx, ny, nz), NO_VECTOR, NO_VECTOR)
    arm = _arm(axle, radius, (-nx, -ny, -nz))
    depth, nx, ny, nz = floor_depth_and_normal(terrain, x + arm[0], y + arm[1], z + arm[2])
    normal = (nx, ny, nz)
    return WheelContactGeometry(depth, normal, _forward(axle, normal), arm)


@inner
def _disc_in_boulder(
    terrain: Terrain, k: int, centre: Vector, axle: Vector, radius: float
) -> tuple[float, Vector, Vector]:
    """Depth [m], normal and arm of the disc's deepest point in the boulder at k in the table."""
    table = terrain.table
    dx, dy, dz = table[k] - centre[0], table[k + 1] - centre[1], table[k + 2] - centre[2]
    # the disc's nearest point to the sphere's centre: at the rim, or inside it
    along = dx * axle[0] + dy * axle[1] + dz * axle[2]
    px, py, pz = dx - along * axle[0], dy - along * axle[1], dz - along * axle[2]
    length = math.sqrt(px * px + py * py + pz * pz)
    scale = radius / length if length > radius else 1.0
    px, py, pz = scale * px, scale * py, scale * pz
    ox, oy, oz = px - dx, py - dy, pz - dz
    distance = math.sqrt(ox * ox + oy * oy + oz * oz)
    if distance <= 1.0e-9:
        return _CLEAR, (0.0, 0.0, 1.0), NO_VECTOR
    return table[k + 3] - distance, (ox / distance, oy / distance, oz / distance), (px, py, pz)


@inner
def _wheel_in_wall(
    terrain: Terrain, centre: Vector, axle: Vector, radius: float
) -> tuple[float, Vector, Vector]:
    """Depth [m], normal and arm of the deepest point in the hole's wall, rim or ground around."""
    x, y, z = centre
    clear = (_CLEAR, (0.0, 0.0, 1.0), NO_VECTOR)
    reach = math.sqrt(terrain.inner_squared) - radius
    if not terrain.has_hole or (x - terrain.axis_x) ** 2 + y * y <= max(reach, 0.0) ** 2:
        return clear
    wall, wx, wy, wz, _ = wall_depth_and_normal(terrain, x, y, z)
    if wall + radius <= -0.1:
        return clear
    arm = _arm(axle, radius, (-wx, -wy, -wz))
    wall, wx, wy, wz, _ = wall_depth_and_normal(terrain, x + arm[0], y + arm[1], z + arm[2])
    return wall, (wx, wy, wz), arm


@inner
def _boulder_key(terrain: Terrain, k: int) -> float:
    """Key of a boulder, the same in every cell's list: its centre's x plus an offset."""
    return _KEY_OFFSET + terrain.table[k]


@inner
def deepest_rocks(
    terrain: Terrain, centre: Vector, axle: Vector, radius: float
) -> tuple[float, float, float, float]:
    """The two rocks that a disc is deepest in.

    Boulders are exact spheres here, without the fillet at their base; they are found by wheels of
    radius up to 0.3 m. The arguments are those of `wheel_on_floor`.

    Returns:
        Depth [m] and key of the deepest rock and of the next. Rocks farther than 0.1 m may be
        omitted; without a rock the key is `NO_ROCK`.
    """
    x, y, z = centre
    first, second = _CLEAR, _CLEAR
    key1, key2 = NO_ROCK, NO_ROCK
    table = terrain.table
    start, stop = cell_boulders(terrain, x, y)
    for k in range(start, stop, 5):
        dx, dy, dz = table[k] - x, table[k + 1] - y, table[k + 2] - z
        reach = table[k + 3] + radius - max(second, -0.1)
        if dx * dx + dy * dy + dz * dz >= reach * reach:
            continue
        depth = _disc_in_boulder(terrain, k, centre, axle, radius)[0]
        if depth > first:
            second, key2 = first, key1
            first, key1 = depth, _boulder_key(terrain, k)
        elif depth > second:
            second, key2 = depth, _boulder_key(terrain, k)
    depth = _wheel_in_wall(terrain, centre, axle, radius)[0]
    if depth > first:
        second, key2 = first, key1
        first, key1 = depth, _WALL_KEY
    elif depth > second:
        second, key2 = depth, _WALL_KEY
    return first, key1, second, key2


@inner
def wheel_on_rock(
    terrain: Terrain, centre: Vector, axle: Vector, radius: float, rock: float
) -> WheelContactGeometry:
    """Deepest point of a wheel in one rock.

    Args:
        terrain: the ground.
        centre: of the wheel [m].
        axle: unit vector, to the wheel's left.
        radius: r [m].
        rock: key from `deepest_rocks`.
    """
    depth, normal, arm = _CLEAR, (0.0, 0.0, 1.0), NO_VECTOR
    if rock == _WALL_KEY:
        depth, normal, arm = _wheel_in_wall(terrain, centre, axle, radius)
    elif rock != NO_ROCK:
        start, stop = cell_boulders(terrain, centre[0], centre[1])
        for k in range(start, stop, 5):
            if _boulder_key(terrain, k) == rock:
                depth, normal, arm = _disc_in_boulder(terrain, k, centre, axle, radius)
    return WheelContactGeometry(depth, normal, _forward(axle, normal), arm)
