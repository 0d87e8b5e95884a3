"""Markers of the images taken of the wall, from the descent's observations."""

from __future__ import annotations

import math

from msg_schemas import machine
from msg_schemas.samples import Colour, DrawingSample, JointSample, Shape
from rover_view.robot_model import RobotModel, about_z, plus, product, rotate

STEADY: Colour = (0.20, 0.75, 0.35, 0.8)
SMEARED: Colour = (0.85, 0.25, 0.15, 0.8)
UNKNOWN: Colour = (0.60, 0.60, 0.60, 0.8)
BLURRED = 2.0
"""Smear from which an image is drawn as smeared [px]; up to ``machine.SHARP_SMEAR`` as steady."""
_SIZE = (0.02, 0.6, 0.6)  # of a marker [m]


class ObservedWall:
    """The images taken so far.

    The rover is assumed vertically below the fairlead. Headings are the gyro's since the start,
    where base_link's x is assumed along the x of map.
    """

    def __init__(self) -> None:
        self._shapes: list[Shape] = []

    def add(self, observation: JointSample, model: RobotModel) -> bool:
        """Add an image; False without a wall in range.

        Args:
            observation: a sample of the descent's observations.
            model: with the camera's frame.
        """
        joints = observation.joints
        if (
            machine.WALL_DISTANCE not in joints
            or joints[machine.WALL_DISTANCE].position >= machine.NO_WALL
        ):
            return False
        heading = about_z(joints[machine.HEADING].position)
        camera = model.joints[machine.CAMERA_FRAME]
        attachment = (
            model.joints[machine.TETHER_FRAME].position
            if machine.TETHER_FRAME in model.joints
            else 3 * (0.0,)
        )
        ray = rotate(camera.orientation, (joints[machine.WALL_DISTANCE].position, 0.0, 0.0))
        x, y, z = rotate(heading, plus(camera.position, ray))
        self._shapes.append(
            Shape(
                "observed_wall",
                "box",
                machine.WORLD_FRAME,
                _colour(joints[machine.SMEAR].position if machine.SMEAR in joints else math.nan),
                _SIZE,
                (),
                (x, y, z - joints[machine.DEPTH].position - attachment[2]),
                product(heading, camera.orientation),
            )
        )
        return True

    def drawing(self, stamp_ns: int) -> DrawingSample:
        """Return the markers of all images."""
        return DrawingSample(stamp_ns, tuple(self._shapes))


def _colour(smear: float) -> Colour:
    if math.isnan(smear):
        return UNKNOWN
    sharp = machine.SHARP_SMEAR
    share = min(max((smear - sharp) / (BLURRED - sharp), 0.0), 1.0)
    red, green, blue, alpha = (a + share * (b - a) for a, b in zip(STEADY, SMEARED, strict=True))
    return red, green, blue, alpha
