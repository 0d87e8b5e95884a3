"""Add forces and tangents at nodes and at points between them to the elements' equations."""

from typing import Any

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector
from rover_sim.physics.tether.ancf import Array


@inner
def hermite_weights(xi: float, length: float) -> tuple[float, float, float, float]:
    """S(xi) of an element, as four numbers; see `ancf.shape_functions`."""
    square = xi * xi
    cube = square * xi
    return (
        1.0 - 3.0 * square + 2.0 * cube,
        length * (xi - 2.0 * square + cube),
        3.0 * square - 2.0 * cube,
        length * (cube - square),
    )


@inner
def interpolated(weights: tuple[float, float, float, float], rows: Array, e: int) -> Vector:
    """S e of an element's point, from rows (6, width) of coordinates, rates or increments."""
    w = weights
    return (
        w[0] * rows[0, e] + w[1] * rows[3, e] + w[2] * rows[0, e + 1] + w[3] * rows[3, e + 1],
        w[0] * rows[1, e] + w[1] * rows[4, e] + w[2] * rows[1, e + 1] + w[3] * rows[4, e + 1],
        w[0] * rows[2, e] + w[1] * rows[5, e] + w[2] * rows[2, e + 1] + w[3] * rows[5, e + 1],
    )


@inner
def subtract_force(
    weights: tuple[float, float, float, float],
    e: int,
    force: Vector,
    tangent: Any,
    blocks: Array,
) -> None:
    """Subtract a force at a point and its symmetric tangent from an element's blocks.

    Args:
        weights: of the point, see `hermite_weights`.
        e: number of the element.
        force: [N].
        tangent: derivatives by the point's increment, (xx, xy, xz, yy, yz, zz) [N/m].
        blocks: see `block_elimination`.
    """
    columns = (
        (tangent[0], tangent[1], tangent[2]),
        (tangent[1], tangent[3], tangent[4]),
        (tangent[2], tangent[4], tangent[5]),
    )
    for side in range(2):
        position, slope = weights[2 * side], weights[2 * side + 1]
        other, other_slope = weights[2 - 2 * side], weights[3 - 2 * side]
        for r in range(3):
            blocks[e + 1, side, 6, r] -= position * force[r]
            blocks[e + 1, side, 6, 3 + r] -= slope * force[r]
        for c in range(3):
            for r in range(3):
                entry = columns[c][r]
                blocks[e + 1, side, c, r] -= position * position * entry
                blocks[e + 1, side, c, 3 + r] -= position * slope * entry
                blocks[e + 1, side, 3 + c, r] -= position * slope * entry
                blocks[e + 1, side, 3 + c, 3 + r] -= slope * slope * entry
                blocks[e + 1, side, 7 + c, r] -= position * other * entry
                blocks[e + 1, side, 7 + c, 3 + r] -= slope * other * entry
                blocks[e + 1, side, 10 + c, r] -= position * other_slope * entry
                blocks[e + 1, side, 10 + c, 3 + r] -= slope * other_slope * entry
