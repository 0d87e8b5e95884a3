"""What the robot description says of the machine's joints, and where its links then are."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.samples import IDENTITY, ZERO, OdometrySample, Quaternion, Vector
from msg_schemas.table import (
    BODY1_FRAME,
    BODY2_FRAME,
    CAMERA_FRAME,
    WHEEL_LEFT,
    WHEEL_RIGHT,
    WINCH_DRUM,
    WORLD_FRAME,
)


class DescriptionError(ValueError):
    """A robot description that is none: what is missing or wrong in it."""


class LinkFrame(NamedTuple):
    """A frame in its parent."""

    parent: str
    child: str
    position: Vector  # [m]
    orientation: Quaternion


@dataclass(frozen=True)
class RobotModel:
    """Joints of a robot description.

    Attributes:
        joints: by the name of the child's link, each at its zero.
        fixed: those of them that do not move.
        drum_radius: [m]; nan without a drum.
    """

    joints: Mapping[str, LinkFrame]
    fixed: tuple[LinkFrame, ...]
    drum_radius: float

    @classmethod
    def read(cls, description: str) -> RobotModel:
        """Read a robot description.

        Raises:
            DescriptionError: it is no URDF, or not that of our machine.
        """
        try:
            robot = ET.fromstring(description)
            joints = [(joint.get("type"), _placed(joint)) for joint in robot.iter("joint")]
            radii = [
                float(cylinder.attrib["radius"])
                for cylinder in robot.findall(
                    f"link[@name='{WINCH_DRUM}']/visual/geometry/cylinder"
                )
            ]
        except (ET.ParseError, KeyError, ValueError) as error:
            raise DescriptionError(f"the robot description is no URDF: {error!r}") from None
        by_child = {placed.child: placed for _, placed in joints}
        missing = {
            BODY1_FRAME,
            BODY2_FRAME,
            WHEEL_LEFT,
            WHEEL_RIGHT,
            CAMERA_FRAME,
        } - by_child.keys()
        if missing:
            raise DescriptionError(f"the robot description has no link {sorted(missing)[0]}")
        fixed = tuple(placed for kind, placed in joints if kind == "fixed")
        return cls(by_child, fixed, radii[0] if radii else math.nan)

    def bodies(self, body1: OdometrySample, body2: OdometrySample | None) -> list[LinkFrame]:
        """The bodies' frames; Body 2 is where the slider lets it be nearest to where it is told."""
        placed = [LinkFrame(WORLD_FRAME, BODY1_FRAME, body1.position, body1.orientation)]
        if body2 is not None:
            away = _minus(body2.position, body1.position)
            slide = turn(conjugate(body1.orientation), away)[2]
            placed.append(LinkFrame(BODY1_FRAME, BODY2_FRAME, (0.0, 0.0, slide), IDENTITY))
        return placed

    def wheels(self, left: float, right: float) -> list[LinkFrame]:
        """Frames of wheels that have turned by so much [rad]."""
        angles = ((WHEEL_LEFT, left), (WHEEL_RIGHT, right))
        return [self.joints[name]._replace(orientation=about_y(angle)) for name, angle in angles]

    def drum(self, length: float) -> list[LinkFrame]:
        """The drum's frame with so much paid out [m]; nothing without a drum."""
        if WINCH_DRUM not in self.joints or not self.drum_radius > 0.0:
            return []
        angle = math.remainder(length / self.drum_radius, 2.0 * math.pi)
        return [self.joints[WINCH_DRUM]._replace(orientation=about_y(angle))]


def _placed(joint: ET.Element) -> LinkFrame:
    parent, child = joint.find("parent"), joint.find("child")
    if parent is None or child is None:
        raise KeyError(f"joint {joint.get('name')} joins no two links")
    origin = joint.find("origin")
    place, turned = ZERO, ZERO
    if origin is not None:
        place, turned = _three(origin.get("xyz", "0 0 0")), _three(origin.get("rpy", "0 0 0"))
    return LinkFrame(parent.attrib["link"], child.attrib["link"], place, _quaternion(*turned))


def _three(text: str) -> Vector:
    x, y, z = (float(part) for part in text.split())
    return x, y, z


def _quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Of URDF's angles: about the fixed x, y and z axes, in turn."""
    return product(about_z(yaw), product(about_y(pitch), _about_x(roll)))


def _about_x(angle: float) -> Quaternion:
    return math.sin(0.5 * angle), 0.0, 0.0, math.cos(0.5 * angle)


def about_y(angle: float) -> Quaternion:
    """A turn about y [rad]."""
    return 0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle)


def about_z(angle: float) -> Quaternion:
    """A turn about z [rad]."""
    return 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)


def product(first: Quaternion, second: Quaternion) -> Quaternion:
    """The second rotation, then the first."""
    x0, y0, z0, w0 = first
    x1, y1, z1, w1 = second
    return (
        w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1,
        w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1,
        w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1,
        w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1,
    )


def conjugate(turned: Quaternion) -> Quaternion:
    """The rotation back."""
    x, y, z, w = turned
    return -x, -y, -z, w


def turn(turned: Quaternion, vector: Vector) -> Vector:
    """A vector, turned."""
    x, y, z, _ = product(product(turned, (*vector, 0.0)), conjugate(turned))
    return x, y, z


def plus(a: Vector, b: Vector) -> Vector:
    """The sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
