"""JointState messages that may violate the contract."""

from __future__ import annotations

from dataclasses import dataclass

from msg_schemas.layouts import LAYOUTS
from msg_schemas.samples import JointSample

_LAYOUT = LAYOUTS["sensor_msgs/msg/JointState"]
PARTS = ("position", "velocity", "effort")


@dataclass
class JointMessage:
    """Content of a JointState message.

    Attributes:
        stamp_ns, frame_id: its header.
        name, position, velocity, effort: its arrays.
    """

    stamp_ns: int
    frame_id: str
    name: list[str]
    position: list[float]
    velocity: list[float]
    effort: list[float]

    @classmethod
    def of(cls, sample: JointSample, frame_id: str = "") -> JointMessage:
        """Return the message of a sample."""
        columns = ([getattr(v, part) for v in sample.joints.values()] for part in PARTS)
        return cls(sample.stamp_ns, frame_id, list(sample.joints), *columns)

    def serialized(self) -> bytes:
        """Return its bytes."""
        return _LAYOUT.serialize(list(vars(self).values()))
