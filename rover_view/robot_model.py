"""Link frames of the rover, from its robot description (URDF) and joint states."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import machine
from msg_schemas.samples import (
    IDENTITY,
    ZERO,
    OdometrySample,
    PoseEstimateSample,
    Quaternion,
    Vector,
)

_MOVING = ("continuous", "revolute", "prismatic")


class DescriptionError(ValueError):
    """An invalid robot description; the message has the reason."""


class LinkFrame(NamedTuple):
    """The frame of a link in its parent's."""

    parent: str
    child: str
    position: Vector = ZERO  # [m]
    orientation: Quaternion = IDENTITY

    def named(self, prefix: str) -> LinkFrame:
        """Return the frame with a prefix before both names."""
        return self._replace(parent=prefix + self.parent, child=prefix + self.child)

    def then(self, position: Vector, orientation: Quaternion) -> tuple[Vector, Quaternion]:
        """Return a pose that is given in the child in the parent."""
        turned = rotate(self.orientation, position)
        return plus(self.position, turned), product(self.orientation, orientation)


class MovingJoint(NamedTuple):
    """A joint that a position moves."""

    frame: LinkFrame  # at the position 0
    slides: bool
    axis: Vector


@dataclass(frozen=True)
class RobotModel:
    """Joint frames of a robot description.

    Attributes:
        joints: frame at the joint's zero position, by the name of the child link.
        fixed: frames of the fixed joints.
        moving: joints with a position, by their names.
        drum_radius: [m]; nan without a drum.
    """

    joints: Mapping[str, LinkFrame]
    fixed: tuple[LinkFrame, ...]
    moving: Mapping[str, MovingJoint]
    drum_radius: float

    @classmethod
    def read(cls, description: str) -> RobotModel:
        """Read a robot description.

        Raises:
            DescriptionError: it is not a URDF, or not of the rover.
        """
        try:
            robot = ET.fromstring(description)
            joints = [(joint, _frame_of(joint)) for joint in robot.iter("joint")]
            moving = {
                joint.attrib["name"]: MovingJoint(frame, kind == "prismatic", _axis_of(joint))
                for joint, frame in joints
                if (kind := joint.get("type")) in _MOVING
            }
            radii = [
                float(cylinder.attrib["radius"])
                for cylinder in robot.findall(
                    f"link[@name='{machine.WINCH_DRUM}']/collision/geometry/cylinder"
                )
            ]
        except (ET.ParseError, KeyError, ValueError) as error:
            raise DescriptionError(f"the robot description is not a URDF: {error!r}") from None
        by_child = {frame.child: frame for _, frame in joints}
        missing = {
            machine.BODY1_FRAME,
            machine.BODY2_FRAME,
            machine.WHEEL_LEFT,
            machine.WHEEL_RIGHT,
            machine.CAMERA_FRAME,
        } - by_child.keys()
        if missing:
            raise DescriptionError(f"the robot description has no link {sorted(missing)[0]}")
        fixed = tuple(frame for joint, frame in joints if joint.get("type") == "fixed")
        return cls(by_child, fixed, moving, radii[0] if radii else math.nan)

    def moved(self, positions: Mapping[str, float]) -> list[LinkFrame]:
        """Return the frames of the joints at given positions [rad or m]; others are left out."""
        return [
            self._at(self.moving[name], position)
            for name, position in positions.items()
            if name in self.moving
        ]

    @staticmethod
    def _at(joint: MovingJoint, position: float) -> LinkFrame:
        frame, (x, y, z) = joint.frame, joint.axis
        if joint.slides:
            step, turn = (x * position, y * position, z * position), IDENTITY
        else:
            angle = 0.5 * math.remainder(position, math.tau)
            s = math.sin(angle)
            step, turn = ZERO, (x * s, y * s, z * s, math.cos(angle))
        return LinkFrame(frame.parent, frame.child, *frame.then(step, turn))


def body_frames(body1: OdometrySample, body2: OdometrySample | None) -> list[LinkFrame]:
    """Return the true frames of the bodies; Body 2's is relative to Body 1's."""
    frames = [
        LinkFrame(machine.WORLD_FRAME, machine.TRUTH_BODY1_FRAME, body1.position, body1.orientation)
    ]
    if body2 is not None:
        offset = _minus(body2.position, body1.position)
        place = rotate(conjugate(body1.orientation), offset)
        frames.append(LinkFrame(machine.TRUTH_BODY1_FRAME, machine.TRUTH_BODY2_FRAME, place))
    return frames


def estimated_frames(odometry: OdometrySample, pose: PoseEstimateSample) -> list[LinkFrame]:
    """Return odom in map, such that base_link gets the pose, and base_link in odom.

    Args:
        odometry: pose of base_link in odom.
        pose: of base_link in map, at the same time.
    """
    turn = product(pose.orientation, conjugate(odometry.orientation))
    origin = _minus(pose.position, rotate(turn, odometry.position))
    return [
        LinkFrame(machine.WORLD_FRAME, machine.ODOM_FRAME, origin, turn),
        LinkFrame(machine.ODOM_FRAME, machine.BODY1_FRAME, odometry.position, odometry.orientation),
    ]


def _axis_of(joint: ET.Element) -> Vector:
    axis = joint.find("axis")
    x, y, z = (1.0, 0.0, 0.0) if axis is None else _vector_of(axis.attrib["xyz"])
    length = math.hypot(x, y, z)
    if not 0.0 < length < math.inf:
        raise ValueError(f"the axis of joint {joint.get('name')} has the length {length:g}")
    return x / length, y / length, z / length


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
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"{text!r} should be three finite numbers")
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
