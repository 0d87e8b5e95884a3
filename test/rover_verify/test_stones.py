"""Passage of the demonstration's stones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rover_sim import load_spatial
from rover_sim.physics.ground.terrain import boulder_list
from rover_verify.demo.mission_show import OVERRIDES, SCENARIO
from rover_verify.demo.stones import STONES, StonePassage, passage

PLACE = load_spatial(SCENARIO, OVERRIDES)
RADIUS = 0.16  # of a wheel with its grousers [m]
HOMEWARD = -90.0  # [deg]


def top() -> float:
    boulders = boulder_list(PLACE.environment.build())
    placed = boulders[np.isin(boulders[:, 0], [stone["x"] for stone in STONES])]
    assert len(placed) == len(STONES)
    return float(np.max(placed[:, 2] + placed[:, 4]))


def passed(*clearances: float, x: float = 0.0, heading: float = HOMEWARD) -> StonePassage:
    """Level flights along the heading, with the wheels' lowest points above the stones' tops."""
    y = np.linspace(1.5, 0.2, 27)
    if heading > 0.0:
        y = y[::-1]
    flights = [
        np.column_stack([np.full(27, x), y, np.full(27, top() + RADIUS + clearance)])
        for clearance in clearances
    ]
    positions = np.concatenate(flights)
    turned = Rotation.from_euler("z", heading, degrees=True).as_matrix()
    return passage(PLACE, positions, np.broadcast_to(turned, (len(positions), 3, 3)))


@pytest.mark.parametrize("clearance", [0.12, -0.01])
def test_the_clearance_is_that_of_the_left_wheel_above_the_tops(clearance: float):
    found = passed(clearance)
    assert found.height == pytest.approx(0.04)
    assert found.clearance == pytest.approx(clearance, abs=1e-9)


@pytest.mark.parametrize(("x", "heading"), [(0.3, HOMEWARD), (-0.2, HOMEWARD), (0.0, 90.0)])
def test_another_path_does_not_pass_the_stones(x: float, heading: float):
    assert math.isnan(passed(0.1, x=x, heading=heading).clearance)


def test_a_rover_that_hangs_above_the_stones_does_not_pass_them():
    assert passed(40.0, 0.12, 6.0).clearance == pytest.approx(0.12, abs=1e-9)
    assert math.isnan(passed(40.0, 6.0).clearance)
