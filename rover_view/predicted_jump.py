"""Markers of a jump's predicted height and range, at the rover's position."""

from __future__ import annotations

import math

from msg_schemas import machine
from msg_schemas.samples import (
    Colour,
    DrawingSample,
    JointSample,
    PoseEstimateSample,
    Shape,
    Vector,
)

MARK: Colour = (0.55, 0.25, 0.85, 0.9)
RING: Colour = (0.55, 0.25, 0.85, 0.6)
_WIDTH = (0.02, 0.0, 0.0)  # [m]
_SIDES = 48


def prediction_markers(
    prediction: JointSample, pose: PoseEstimateSample, stamp_ns: int
) -> DrawingSample:
    """Draw the 90 % interval of the height as a line above the rover, of the range as two rings.

    Args:
        prediction: a sample of the jump's predictions: values, lower and upper bounds.
        pose: of the rover.
        stamp_ns: of the drawing.
    """
    x, y, z = pose.position
    height, distance = prediction.joints[machine.JUMP_HEIGHT], prediction.joints[machine.JUMP_RANGE]
    low, high = height.velocity, height.effort
    mark = Shape(
        "predicted_height",
        "line",
        machine.WORLD_FRAME,
        MARK,
        _WIDTH,
        ((x, y, z + low), (x, y, z + high)),
    )
    rings = tuple(
        Shape(
            "predicted_range",
            "line",
            machine.WORLD_FRAME,
            RING,
            _WIDTH,
            _ring(pose.position, radius),
        )
        for radius in (distance.velocity, distance.effort)
        if radius > 0.0
    )
    return DrawingSample(stamp_ns, (mark, *rings))


def _ring(centre: Vector, radius: float) -> tuple[Vector, ...]:
    x, y, z = centre
    angles = [math.tau * side / _SIDES for side in range(_SIDES + 1)]
    return tuple((x + radius * math.cos(a), y + radius * math.sin(a), z) for a in angles)
