"""Shapes to look at: the tether as a line, the rover's bodies and wheels."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from msg_schemas.samples import Quaternion, Shape, Vector
from msg_schemas.table import WORLD_FRAME
from rover_sim.physics import ancf
from rover_sim.physics.ancf import Array

TETHER_COLOUR: Final = (0.95, 0.75, 0.20, 1.0)
BODY1_COLOUR: Final = (0.30, 0.45, 0.65, 1.0)
BODY2_COLOUR: Final = (0.80, 0.35, 0.25, 1.0)
WHEEL_COLOUR: Final = (0.35, 0.35, 0.38, 1.0)
_TETHER_WIDTH = 0.01
_POINTS_PER_ELEMENT = 4


def tether_line(nodes: Array, arc_lengths: Array) -> Shape:
    """The tether as a line through its nodes, along its cubics.

    Args:
        nodes: positions and slopes in map, (n + 1, 2, 3).
        arc_lengths: undeformed, from the fairlead to the nodes [m], (n + 1,).
    """
    inside = np.arange(_POINTS_PER_ELEMENT) / _POINTS_PER_ELEMENT
    weights = ancf.shape_functions(inside, 1.0)
    lengths = np.diff(arc_lengths)[:, None]
    ends = np.stack([nodes[:-1, 0], lengths * nodes[:-1, 1], nodes[1:, 0], lengths * nodes[1:, 1]])
    points = np.einsum("pk,kei->epi", weights, ends).reshape(-1, 3)
    line = np.concatenate([points, nodes[-1:, 0]])
    return Shape(
        "tether",
        "line",
        WORLD_FRAME,
        TETHER_COLOUR,
        (_TETHER_WIDTH, 0.0, 0.0),
        tuple(as_vector(point) for point in line),
    )


def solid(
    name: str,
    kind: str,
    colour: tuple[float, float, float, float],
    size: Vector,
    place: ArrayLike,
    orientation: ArrayLike,
) -> Shape:
    """A box (size along its axes) or a cylinder (diameters, then height along z) in map."""
    return Shape(
        name, kind, WORLD_FRAME, colour, size, (), as_vector(place), as_quaternion(orientation)
    )


def as_vector(values: ArrayLike) -> Vector:
    """Three plain floats."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z)


def as_quaternion(values: ArrayLike) -> Quaternion:
    """Four plain floats, (x, y, z, w)."""
    x, y, z, w = np.asarray(values, dtype=np.float64).tolist()
    return (x, y, z, w)
