"""Typed samples: the content of messages, without ROS.

Controllers, plants and bag tools exchange samples; only codecs turn them into
messages. Stamps are integer nanoseconds of the publisher's clock (0 = not
stamped). All quantities are SI; vectors are (x, y, z), quaternions
(x, y, z, w), axes REP-103.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Colour = tuple[float, float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)

TETHER_COLUMNS = ("x", "y", "z", "tx", "ty", "tz", "tension")


class Sample(Protocol):
    """Interface of every sample for the checks of the contract."""

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield (field path, value) for every number that the sample carries."""
        ...


class _Vectors:
    """A sample whose numbers are the components of its vectors and quaternions."""

    _VECTORS: ClassVar[tuple[str, ...]]

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield the components of the vectors and quaternions."""
        for name in self._VECTORS:
            yield from _components(name, getattr(self, name))


def _components(prefix: str, value: Vector | Quaternion) -> Iterator[tuple[str, float]]:
    axes = "xyz" if len(value) == 3 else "xyzw"
    for axis, component in zip(axes, value, strict=True):
        yield f"{prefix}.{axis}", component


class JointValue(NamedTuple):
    """One joint's three numbers; the topic's specification has their units."""

    position: float = 0.0
    velocity: float = 0.0
    effort: float = 0.0


@dataclass(frozen=True)
class JointSample:
    """Actuators, switches and other named scalars: one value triple per name."""

    stamp_ns: int
    joints: Mapping[str, JointValue]

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield ``<joint>.position``, ``<joint>.velocity``, ``<joint>.effort``."""
        for name, value in self.joints.items():
            yield f"{name}.position", value.position
            yield f"{name}.velocity", value.velocity
            yield f"{name}.effort", value.effort


@dataclass(frozen=True)
class OdometrySample(_Vectors):
    """Pose of a body in the world and its twist in the body's own frame (REP-147 style).

    Attributes:
        pose_covariance: of x, y, z and the rotations about the world's axes, 6 x 6 values by rows;
            empty = unknown.
    """

    stamp_ns: int
    position: Vector
    orientation: Quaternion
    linear: Vector
    angular: Vector
    pose_covariance: tuple[float, ...] = ()

    _VECTORS = ("position", "orientation", "linear", "angular")


NO_ORIENTATION: Quaternion = (0.0, 0.0, 0.0, 0.0)
"""Orientation of a pose that leaves it open."""


@dataclass(frozen=True)
class PoseSample(_Vectors):
    """Actual or requested pose; `NO_ORIENTATION` leaves the orientation open."""

    stamp_ns: int
    position: Vector
    orientation: Quaternion = NO_ORIENTATION

    _VECTORS = ("position", "orientation")


@dataclass(frozen=True)
class PoseEstimateSample(_Vectors):
    """Pose with its covariance.

    Attributes:
        pose_covariance: of x, y, z and the rotations about the axes of the frame, 6 x 6 values by
            rows; empty = not given.
    """

    stamp_ns: int
    position: Vector
    orientation: Quaternion = NO_ORIENTATION
    pose_covariance: tuple[float, ...] = ()

    _VECTORS = ("position", "orientation")

    @property
    def heading(self) -> float:
        """Rotation about z [rad]."""
        x, y, z, w = self.orientation
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def is_known(self) -> bool:
        """Whether the pose was given: the heading has a standard deviation below 1 rad."""
        return bool(self.pose_covariance) and self.pose_covariance[-1] < 1.0


@dataclass(frozen=True)
class PathSample:
    """Poses of a path, in their order."""

    stamp_ns: int
    poses: tuple[PoseSample, ...]

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield the components of every pose."""
        for pose in self.poses:
            yield from pose.scalars()


@dataclass(frozen=True)
class TwistSample(_Vectors):
    """Velocity and angular velocity of a body in its own frame."""

    stamp_ns: int
    linear: Vector
    angular: Vector

    _VECTORS = ("linear", "angular")


@dataclass(frozen=True)
class ImuSample(_Vectors):
    """Angular rate and specific force in the sensor's frame; no orientation."""

    stamp_ns: int
    angular_velocity: Vector
    linear_acceleration: Vector

    _VECTORS = ("angular_velocity", "linear_acceleration")


@dataclass(frozen=True)
class WrenchSample(_Vectors):
    """Force and torque, in the frame named by the topic."""

    stamp_ns: int
    force: Vector
    torque: Vector = ZERO

    _VECTORS = ("force", "torque")


@dataclass(frozen=True)
class TetherSample:
    """The tether's nodes from the fairlead to the rover.

    Attributes:
        nodes: shape (n + 1, 7), columns ``TETHER_COLUMNS``: position [m], slope
            dr/ds [-], axial tension [N].
    """

    stamp_ns: int
    nodes: NDArray[np.float64]

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield each column's minimum and maximum, which suffice for the checks."""
        for column, name in enumerate(TETHER_COLUMNS):
            values = self.nodes[:, column]
            yield name, float(np.min(values))
            yield name, float(np.max(values))


@dataclass(frozen=True)
class TextSample:
    """A word or a JSON text."""

    text: str

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield nothing: a text has no numbers."""
        return iter(())


@dataclass(frozen=True)
class ClockSample:
    """Simulated time."""

    stamp_ns: int

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield the time in seconds."""
        yield "clock", self.stamp_ns * 1e-9


class Level(IntEnum):
    """Severity of a status, as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """Health of a part, or one event: name, severity, message and values."""

    name: str
    message: str
    level: Level = Level.OK
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class StatusSample:
    """Statuses of one instant."""

    stamp_ns: int
    statuses: tuple[Status, ...]

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield nothing: the values of a status are texts."""
        return iter(())


class Shape(NamedTuple):
    """One thing to draw.

    ``kind`` is ``line`` (points, the width in ``size``), ``arrow`` (from the first point to the
    second; diameters of shaft and head, length of the head), ``triangles`` (three points each),
    ``box`` (pose, size along its axes), ``sphere`` (pose, diameters) or ``cylinder`` (pose, two
    diameters and the height along its z). Points of a line may have ``colours`` of their own.
    """

    namespace: str
    kind: str
    frame: str
    colour: Colour
    size: Vector
    points: tuple[Vector, ...] = ()
    position: Vector = ZERO
    orientation: Quaternion = IDENTITY
    colours: tuple[Colour, ...] = ()


@dataclass(frozen=True)
class DrawingSample:
    """Shapes for a viewer such as RViz."""

    stamp_ns: int
    shapes: tuple[Shape, ...]

    def scalars(self) -> Iterator[tuple[str, float]]:
        """Yield every coordinate."""
        for shape in self.shapes:
            for point in (*shape.points, shape.position, shape.size):
                yield from _components("drawing", point)


SAMPLE_TYPES: Mapping[str, type[Sample]] = MappingProxyType(
    {
        "diagnostic_msgs/msg/DiagnosticArray": StatusSample,
        "geometry_msgs/msg/PoseStamped": PoseSample,
        "geometry_msgs/msg/PoseWithCovarianceStamped": PoseEstimateSample,
        "geometry_msgs/msg/TwistStamped": TwistSample,
        "geometry_msgs/msg/WrenchStamped": WrenchSample,
        "nav_msgs/msg/Odometry": OdometrySample,
        "nav_msgs/msg/Path": PathSample,
        "rosgraph_msgs/msg/Clock": ClockSample,
        "sensor_msgs/msg/Imu": ImuSample,
        "sensor_msgs/msg/JointState": JointSample,
        "sensor_msgs/msg/PointCloud2": TetherSample,
        "std_msgs/msg/String": TextSample,
        "visualization_msgs/msg/MarkerArray": DrawingSample,
    }
)
"""Class of the samples by the type of their messages."""
