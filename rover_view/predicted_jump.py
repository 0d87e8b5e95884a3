"""How high and how far a jump is predicted to go, drawn where the rover stands."""

from __future__ import annotations

import math

from msg_schemas.machine import JUMP_HEIGHT, JUMP_RANGE, WORLD_FRAME
from msg_schemas.samples import Colour, DrawingSample, JointSample, OdometrySample, Shape, Vector

MARK: Colour = (0.55, 0.25, 0.85, 0.9)
RING: Colour = (0.55, 0.25, 0.85, 0.6)
_WIDTH = (0.02, 0.0, 0.0)  # [m]
_SIDES = 48


def predicted(prediction: JointSample, body1: OdometrySample, stamp_ns: int) -> DrawingSample:
    """The interval of 90 % of height, as a mark over the rover, and of range, as rings about it.

    Args:
        prediction: a sample of the jump's predictions; values, lower and upper ends.
        body1: where the rover stands.
        stamp_ns: of the drawing.
    """
    x, y, z = body1.position
    height, way = prediction.joints[JUMP_HEIGHT], prediction.joints[JUMP_RANGE]
    low, high = height.velocity, height.effort
    mark = Shape(
        "predicted_height", "line", WORLD_FRAME, MARK, _WIDTH, ((x, y, z + low), (x, y, z + high))
    )
    rings = tuple(
        Shape("predicted_range", "line", WORLD_FRAME, RING, _WIDTH, _ring(body1.position, radius))
        for radius in (way.velocity, way.effort)
        if radius > 0.0
    )
    return DrawingSample(stamp_ns, (mark, *rings))


def _ring(centre: Vector, radius: float) -> tuple[Vector, ...]:
    x, y, z = centre
    angles = [math.tau * side / _SIDES for side in range(_SIDES + 1)]
    return tuple((x + radius * math.cos(a), y + radius * math.sin(a), z) for a in angles)
