"""Distance from a point to the ground along a line, as a range finder measures it."""

import math

from rover_sim.physics.ground.terrain import Terrain, depth_and_normal
from rover_sim.physics.numerics.compiled import checked, checked_inner
from rover_sim.physics.numerics.vectors import Vector

_LONGEST_STEP = 0.2  # [m]; below terrain.CLEARANCE, within which depths are exact
_SHORTEST_STEP = 0.01
_BISECTIONS = 30


@checked_inner
def _depth_at(terrain: Terrain, origin: Vector, direction: Vector, distance: float) -> float:
    return depth_and_normal(
        terrain,
        origin[0] + distance * direction[0],
        origin[1] + distance * direction[1],
        origin[2] + distance * direction[2],
    )[0]


@checked
def distance_to_ground(terrain: Terrain, origin: Vector, direction: Vector, reach: float) -> float:
    """Distance [m] to the ground along a unit vector; inf beyond `reach`, 0 inside the ground.

    Ground that the line grazes by less than a centimetre may be missed.

    Args:
        terrain: the ground.
        origin: start of the line [m].
        direction: unit vector.
        reach: largest distance [m].
    """
    distance = 0.0
    depth = _depth_at(terrain, origin, direction, distance)
    if depth >= 0.0:
        return 0.0
    while distance < reach:
        step = min(max(-depth, _SHORTEST_STEP), _LONGEST_STEP, reach - distance)
        depth = _depth_at(terrain, origin, direction, distance + step)
        if depth >= 0.0:
            low, high = distance, distance + step
            for _ in range(_BISECTIONS):
                middle = 0.5 * (low + high)
                if _depth_at(terrain, origin, direction, middle) >= 0.0:
                    high = middle
                else:
                    low = middle
            return 0.5 * (low + high)
        distance += step
    return math.inf
