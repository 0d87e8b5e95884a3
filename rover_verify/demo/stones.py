"""Row of stones on the path of the demonstration, and the clearance with which the rover jumps it.

The wheels do not climb the stones. The left wheel stands against them before the jump; its flight
carries it from one side of the row to the other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_sim import SpatialScenario
from rover_sim.physics.ground.terrain import boulder_list

Floats = NDArray[np.float64]

STONES: tuple[Mapping[str, float], ...] = (
    {"x": 0.16, "y": 0.300, "diameter": 0.08},
    {"x": 0.22, "y": 0.297, "diameter": 0.08},
    {"x": 0.28, "y": 0.303, "diameter": 0.08},
)
"""Boulders of the scenario, in map [m]; the rover comes from larger y."""

_HANGING = 1.0  # clearance beyond which the rover hangs on its tether [m]


class StonePassage(NamedTuple):
    """How the left wheel passed the row of stones."""

    height: float  # of the stones above the floor [m]
    clearance: float  # of the wheel above their tops, as its axle passes them [m]; nan = it did not


def passage(scenario: SpatialScenario, positions: Floats, rotations: Floats) -> StonePassage:
    """Find the last passage of the left wheel over the row, towards smaller y, near the floor.

    Args:
        scenario: of the run, with the stones.
        positions: of base_link at successive times, true [m], (n, 3).
        rotations: of base_link, (n, 3, 3).
    """
    rover = scenario.rover
    assert rover is not None
    wheels = rover.wheels
    assert wheels is not None
    hub = np.array([wheels.axle_x, 0.5 * wheels.track_width, wheels.axle_z])
    path = positions + rotations @ hub
    lowest = path[:, 2] - wheels.radius - wheels.grouser_height
    stones = _stones(scenario)
    row = float(np.mean(stones[:, 1]))
    left, right = np.min(stones[:, 0] - stones[:, 3]), np.max(stones[:, 0] + stones[:, 3])
    passes = np.flatnonzero((path[:-1, 1] >= row) & (path[1:, 1] < row))
    passes = passes[(path[passes, 0] >= left) & (path[passes, 0] <= right)]
    before, after = path[passes, 1] - row, path[passes + 1, 1] - row
    share = before / (before - after)
    at = (1.0 - share) * lowest[passes] + share * lowest[passes + 1]
    clearances = at - np.max(stones[:, 2] + stones[:, 4])
    jumped = clearances[clearances < _HANGING]
    clearance = float(jumped[-1]) if jumped.size else math.nan
    return StonePassage(float(np.max(stones[:, 4])), clearance)


def _stones(scenario: SpatialScenario) -> Floats:
    """Rows of `boulder_list` of the stones."""
    boulders = boulder_list(scenario.environment.build())
    places = [(stone["x"], stone["y"]) for stone in STONES]
    return np.array([row for row in boulders if tuple(row[:2].tolist()) in places])
