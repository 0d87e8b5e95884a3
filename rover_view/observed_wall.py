"""Where on the wall pictures were taken, out of what the descent tells of each."""

from __future__ import annotations

import math

from msg_schemas.samples import Colour, DrawingSample, JointSample, Shape
from msg_schemas.table import (
    CAMERA_FRAME,
    DEPTH,
    HEADING,
    SMEAR,
    TETHER_FRAME,
    WALL_DISTANCE,
    WORLD_FRAME,
)
from rover_view.robot_model import RobotModel, about_z, plus, product, turn

STEADY: Colour = (0.20, 0.75, 0.35, 0.8)
SMEARED: Colour = (0.85, 0.25, 0.15, 0.8)
UNKNOWN: Colour = (0.60, 0.60, 0.60, 0.8)
SHARP, BLURRED = 0.5, 2.0
"""Smear up to which a picture is drawn as steady, and from which as smeared [px]."""
_NONE_SEEN = 1000.0  # what the range finder tells then [m]
_SIZE = (0.02, 0.6, 0.6)  # of what is drawn [m]


class ObservedWall:
    """The pictures so far.

    The rover hangs straight below the fairlead when it takes one. The gyro tells headings since the
    start, when base_link's x is taken to lie along the x of map.
    """

    def __init__(self) -> None:
        self._shapes: list[Shape] = []

    def add(self, picture: JointSample, machine: RobotModel) -> bool:
        """Take a picture; False where the range finder saw no wall.

        Args:
            picture: a sample of the descent's observations.
            machine: where its camera is.
        """
        joints = picture.joints
        if WALL_DISTANCE not in joints or joints[WALL_DISTANCE].position >= _NONE_SEEN:
            return False
        heading = about_z(joints[HEADING].position)
        camera = machine.joints[CAMERA_FRAME]
        attachment = (
            machine.joints[TETHER_FRAME].position if TETHER_FRAME in machine.joints else 3 * (0.0,)
        )
        look = turn(camera.orientation, (joints[WALL_DISTANCE].position, 0.0, 0.0))
        x, y, z = turn(heading, plus(camera.position, look))
        self._shapes.append(
            Shape(
                "observed_wall",
                "box",
                WORLD_FRAME,
                _colour(joints[SMEAR].position if SMEAR in joints else math.nan),
                _SIZE,
                (),
                (x, y, z - joints[DEPTH].position - attachment[2]),
                product(heading, camera.orientation),
            )
        )
        return True

    def drawing(self, stamp_ns: int) -> DrawingSample:
        """All pictures."""
        return DrawingSample(stamp_ns, tuple(self._shapes))


def _colour(smear: float) -> Colour:
    if math.isnan(smear):
        return UNKNOWN
    share = min(max((smear - SHARP) / (BLURRED - SHARP), 0.0), 1.0)
    red, green, blue, alpha = (a + share * (b - a) for a, b in zip(STEADY, SMEARED, strict=True))
    return red, green, blue, alpha
