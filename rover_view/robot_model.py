"""Link frames of the rover, from its robot description (URDF) and joint states."""

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
    """An invalid robot description; the message has the reason."""


class LinkFrame(NamedTuple):
    """The frame of a link in its parent's."""

    parent: str
    child: str
    position: Vector  # [m]
    orientation: Quaternion


@dataclass(frozen=True)
class RobotModel:
    """Joint frames of a robot description.

    Attributes:
        joints: frame at the joint's zero position, by the name of the child link.
        fixed: frames of the fixed joints.
        drum_radius: [m]; nan without a drum.
    """

    joints: Mapping[str, LinkFrame]
    fixed: tuple[LinkFrame, ...]
    drum_radius: float

    @classmethod
    def read(cls, description: str) -> RobotModel:
        """Read a robot description.

        Raises:
            DescriptionError: it is not a URDF, or not of the rover.
        """
        try:
            robot = ET.fromstring(description)
            joints = [(joint.get("type"), _frame_of(joint)) for joint in robot.iter("joint")]
            radii = [
                float(cylinder.attrib["radius"])
                for cylinder in robot.findall(
                    f"link[@name='{WINCH_DRUM}']/visual/geometry/cylinder"
                )
            ]
        except (ET.ParseError, KeyError, ValueError) as error:
            raise DescriptionError(f"the robot description is not a URDF: {error!r}") from None
        by_child = {frame.child: frame for _, frame in joints}
        missing = {
            BODY1_FRAME,
            BODY2_FRAME,
            WHEEL_LEFT,
            WHEEL_RIGHT,
            CAMERA_FRAME,
        } - by_child.keys()
        if missing:
            raise DescriptionError(f"the robot description has no link {sorted(missing)[0]}")
        fixed = tuple(frame for kind, frame in joints if kind == "fixed")
        return cls(by_child, fixed, radii[0] if radii else math.nan)

    def bodies(self, body1: OdometrySample, body2: OdometrySample | None) -> list[LinkFrame]:
        """Return the bodies' frames; Body 2 is projected onto the slider's axis."""
        frames = [LinkFrame(WORLD_FRAME, BODY1_FRAME, body1.position, body1.orientation)]
        if body2 is not None:
            offset = _minus(body2.position, body1.position)
            slide = rotate(conjugate(body1.orientation), offset)[2]
            frames.append(LinkFrame(BODY1_FRAME, BODY2_FRAME, (0.0, 0.0, slide), IDENTITY))
        return frames

    def wheels(self, left: float, right: float) -> list[LinkFrame]:
        """Return the frames of the wheels at given angles [rad]."""
        angles = ((WHEEL_LEFT, left), (WHEEL_RIGHT, right))
        return [self.joints[name]._replace(orientation=about_y(angle)) for name, angle in angles]

    def drum(self, length: float) -> list[LinkFrame]:
        """Return the drum's frame at a payout [m]; empty without a drum."""
        if WINCH_DRUM not in self.joints or not self.drum_radius > 0.0:
            return []
        angle = math.remainder(length / self.drum_radius, 2.0 * math.pi)
        return [self.joints[WINCH_DRUM]._replace(orientation=about_y(angle))]


def _frame_of(joint: ET.Element) -> LinkFrame:
    parent, child = joint.find("parent"), joint.find("child")
    if parent is None or child is None:
        raise KeyError(f"joint {joint.get('name')} lacks a parent or child link")
    origin = joint.find("origin")
    position, angles = ZERO, ZERO
    if origin is not None:
        position = _vector_of(origin.get("xyz", "0 0 0"))
        angles = _vector_of(origin.get("rpy", "0 0 0"))
    return LinkFrame(parent.attrib["link"], child.attrib["link"], position, _quaternion(*angles))


def _vector_of(text: str) -> Vector:
    x, y, z = (float(part) for part in text.split())
    return x, y, z


def _quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of URDF's angles, about the fixed x, y and z axes in turn."""
    return product(about_z(yaw), product(about_y(pitch), _about_x(roll)))


def _about_x(angle: float) -> Quaternion:
    return math.sin(0.5 * angle), 0.0, 0.0, math.cos(0.5 * angle)


def about_y(angle: float) -> Quaternion:
    """Return a rotation about y [rad]."""
    return 0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle)


def about_z(angle: float) -> Quaternion:
    """Return a rotation about z [rad]."""
    return 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)


def product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the second rotation followed by the first."""
    x0, y0, z0, w0 = first
    x1, y1, z1, w1 = second
    return (
        w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1,
        w0 * y1 - x0 * z1 + y0 * w1 + z0 * x1,
        w0 * z1 + x0 * y1 - y0 * x1 + z0 * w1,
        w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1,
    )


def conjugate(rotation: Quaternion) -> Quaternion:
    """Return the inverse rotation."""
    x, y, z, w = rotation
    return -x, -y, -z, w


def rotate(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a rotated vector."""
    x, y, z, _ = product(product(rotation, (*vector, 0.0)), conjugate(rotation))
    return x, y, z


def plus(a: Vector, b: Vector) -> Vector:
    """Return the sum of two vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
