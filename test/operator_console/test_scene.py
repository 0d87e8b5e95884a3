"""Sections of the place, sizes of the machine, geometry by truth or by payout."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest

from msg_schemas.samples import DrawingSample, OdometrySample, Shape, TetherSample
from operator_console.scene import (
    BY_PAYOUT,
    BY_TRUTH,
    DEFAULT_MACHINE,
    cut,
    geometry,
    machine_of,
    place_of,
)

GREY = (0.5, 0.5, 0.5, 1.0)


def tube(radius: float, low: float, high: float, sectors: int = 64) -> np.ndarray:
    """Triangles of an upright cylinder's wall."""
    angle = np.linspace(0.0, 2.0 * np.pi, sectors + 1)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    found = []
    for a, b in itertools.pairwise(ring):
        corners = [(*a, low), (*b, low), (*b, high), (*a, high)]
        found += [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
    return np.array(found)


def test_a_cylinder_is_cut_to_a_circle_and_to_two_lines():
    wall = tube(5.0, -30.0, 0.0)
    circle = cut(wall, 2, -12.0)
    assert np.hypot(circle[:, 0], circle[:, 1]) == pytest.approx(5.0, rel=2e-3)
    length = np.hypot(*(circle[:, 2:] - circle[:, :2]).T).sum()
    assert length == pytest.approx(2.0 * np.pi * 5.0, rel=1e-3)
    sides = cut(wall, 1, 1e-4)
    assert np.abs(sides[:, [0, 2]]) == pytest.approx(5.0, abs=1e-2)
    heights = np.abs(sides[:, 3] - sides[:, 1])
    assert heights[sides[:, 0] > 0].sum() == pytest.approx(30.0)
    assert heights[sides[:, 0] < 0].sum() == pytest.approx(30.0)
    assert cut(wall, 1, 6.0).shape == (0, 4)


def test_the_place_is_converted_to_plain_lines_and_spheres():
    points = tuple(map(tuple, tube(5.0, -30.0, 0.0).reshape(-1, 3).tolist()))
    wall = Shape("wall", "triangles", "map", GREY, (1.0, 1.0, 1.0), points)
    boulder = Shape("boulders", "sphere", "map", GREY, (2.0, 2.0, 2.0), (), (1.0, 2.0, -29.5))
    place = json.loads(json.dumps(place_of(DrawingSample(0, (wall, boulder)))))
    assert place["boulders"] == [[1.0, 2.0, -29.5, 1.0]]
    assert place["floor"] == []
    assert {abs(line[0]) for line in place["wall"]} == {5.0}
    assert [level["z"] for level in place["levels"]][:2] == [-29.5, -25.5]
    assert all(len(level["lines"]) >= 64 for level in place["levels"])


def test_a_place_without_a_wall_has_no_levels():
    assert place_of(DrawingSample(0, ()))["levels"] == []


def test_the_sizes_of_the_machine_come_from_the_configuration():
    scenario = {
        "rover": {"body1_size": [0.4, 0.3, 0.2], "wheels": {"radius": 0.2, "track_width": 0.3}},
        "name": "pit",
    }
    machine = machine_of(json.dumps({"scenario": scenario}))
    assert machine is not None
    assert machine["body1_size"] == [0.4, 0.3, 0.2]
    assert machine["body2_size"] == [0.24, 0.24, 0.08]
    assert machine["wheels"]["radius"] == 0.2
    assert machine["wheels"]["track_width"] == 0.3
    assert machine_of(json.dumps({"node": "/winch_node"})) is None


@pytest.mark.parametrize(
    "rover",
    [
        {"body1_size": [0.3, 0.1]},
        {"body1_size": ["a", 1.0, 2.0]},
        {"body1_size": [[1.0], 2.0, 3.0]},
        {"body1_size": [10**400, 2.0, 3.0]},
        {"wheels": {"radius": None}},
        {"wheels": {"radius": "text"}},
        {"wheels": {"radius": math.nan}},
        {"wheels": {"radius": 10**400}},
        {"wheels": [1.0]},
        [0.3],
    ],
)
def test_sizes_that_are_no_numbers_are_those_of_the_default_machine(rover: object):
    assert machine_of(json.dumps({"scenario": {"rover": rover}})) == DEFAULT_MACHINE


def test_truth_replaces_the_payout_and_keeps_both_ends():
    nodes = np.zeros((400, 7))
    nodes[:, 2] = -np.linspace(0.0, 12.0, 400)
    nodes[:, 6] = 16.0
    body = OdometrySample(0, (0.0, 0.0, -12.3), (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (0.0,) * 3)
    found = geometry(TetherSample(0, nodes), body, None, 12.0)
    assert found is not None
    assert found.source == BY_TRUTH
    assert found.tether[0] == (0.0, 0.0, 0.0, 16.0)
    assert found.tether[-1] == (0.0, 0.0, -12.0, 16.0)
    assert len(found.tether) <= 80
    assert found.body1 == (0.0, 0.0, -12.3, 0.0, 0.0, 0.0, 1.0)
    assert found.body2 is None


def test_without_truth_the_tether_is_a_line_as_long_as_the_payout():
    found = geometry(None, None, None, 23.4)
    assert found is not None
    assert found.source == BY_PAYOUT
    assert found.tether == ((0.0, 0.0, 0.0, None), (0.0, 0.0, -23.4, None))
    assert geometry(None, None, None, None) is None
