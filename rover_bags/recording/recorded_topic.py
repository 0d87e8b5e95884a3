"""A topic that a recorder receives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rover_bags.files.write_queue import SequenceMonitor, Source

if TYPE_CHECKING:
    from rclpy.qos import QoSProfile


@dataclass
class RecordedTopic:
    """A topic that is being recorded.

    Without a subscription it is received in batches, or nobody publishes it yet.
    """

    source: Source
    profile: QoSProfile
    waits: bool = False  # with its subscription until somebody publishes
    subscription: Any = None
    publishers: int = 1
    compared: int = 0  # publishers when type and QoS were compared with theirs
    sequence_monitor: SequenceMonitor = field(default_factory=SequenceMonitor)
    received: bool = False
    sent_ns: int = 0  # when the last message that did not arrive in a batch was sent
