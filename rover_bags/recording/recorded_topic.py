"""A topic that a recorder receives."""

from __future__ import annotations

from collections.abc import Callable
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
    publishers_now: Callable[[], int]
    waits: bool = False  # with its subscription until somebody publishes
    subscription: Any = None
    compared: int = 0  # publishers when type and QoS were compared with theirs
    received: bool = False
    sent_ns: int = 0  # when the last message that did not arrive in a batch was sent
    _on_topic: SequenceMonitor = field(default_factory=SequenceMonitor)
    _in_batches: SequenceMonitor = field(default_factory=SequenceMonitor)

    def lost_on_topic(self, number: int) -> int:
        """Return the number of messages lost before this one of the topic; 0 = it has no number."""
        return self._on_topic.gap_before(number, self.publishers_now) if number else 0

    def lost_in_batches(self, number: int) -> int:
        """Return the number of messages lost before this one of a batch.

        Batches number their messages apart from the topic. What its subscription receives is not
        lost.
        """
        gap = self._in_batches.gap_before(number, self.publishers_now)
        return gap if self.subscription is None else 0
