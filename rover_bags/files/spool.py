"""The thread between a recorder's callbacks and its disk.

Callbacks hand over messages and return at once, however long the disk stalls. What waits is
bounded; what does not fit any more is dropped, counted by topic, and the counts go into the bag.

Nothing here needs ROS.
"""

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from rosbags.interfaces import Qos

from rover_bags.files.store import LOSSES_RECORD, BagError, BagSummary, BagWriter, TopicType, sealed

_LOSSES_PERIOD = 0.5
_GATHER = 0.05
_IDLE = 1.0
_OVERHEAD = 200
"""Memory [byte] that a waiting message takes beyond its own bytes, roughly."""


@dataclass(frozen=True)
class Source:
    """A topic that messages come from.

    Attributes:
        name: Full topic name.
        kind: Message type.
        qos: What its publishers offer.
        first: Whether its messages go before all others of the first moments.
    """

    name: str
    kind: TopicType
    qos: tuple[Qos, ...] = ()
    first: bool = False


class Item(NamedTuple):
    """A message on its way to the disk; times in ns since 1970."""

    source: Source
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


class Continuity:
    """Tells from publishers' message counts how many messages of a topic did not arrive.

    The middleware says which number a publisher gave to a message, but not which publisher it
    was. So each count that goes on by one is one publisher's; a jump within as many counts as
    there are publishers is a loss.
    """

    def __init__(self) -> None:
        self._last: list[int] = []

    def gap_before(self, sequence: int, publishers: int) -> int:
        """Number of messages that should have come before this one and did not.

        Args:
            sequence: The publisher's count of the message, from 1.
            publishers: How many publishers the topic has now.
        """
        last = self._last
        if sequence - 1 in last:
            last[last.index(sequence - 1)] = sequence
            return 0
        behind = [value for value in last if value < sequence]
        if sequence == 1 or not behind or len(last) < publishers:
            last.append(sequence)
            del last[: -max(publishers, 1)]
            return 0
        nearest = max(behind)
        last[last.index(nearest)] = sequence
        return sequence - 1 - nearest


class Spool:
    """Takes messages from any thread and writes them from its own.

    For the first ``hold`` seconds after the first message everything waits, so that topics
    marked ``first`` come first in the file, whatever the order in which they were discovered;
    :meth:`release` ends that early.

    Args:
        writer: The bag; the spool closes it.
        limit: Bytes that may wait.
        hold: Longest wait [s] of the first messages.
        notes: Called in the writer's thread with the first message of each distinct content of
            a ``first`` topic; returns the metadata record to write, or None.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        limit: int = 64 << 20,
        hold: float = 0.4,
        notes: Callable[[bytes], tuple[str, dict[str, str]] | None] | None = None,
    ) -> None:
        self._writer = writer
        self._limit = limit
        self._hold = hold
        self._notes = notes
        self._noted: set[bytes] = set()
        self._queue: deque[Item] = deque()
        self._waiting = 0
        self._changed = threading.Condition()
        self._released_at: float | None = None
        self._stopping = False
        self._dropped: Counter[str] = Counter()
        self._missed: Counter[str] = Counter()
        self._losses_written: dict[str, int] = {}
        self._losses_at = 0.0
        self._channels: dict[str, int] = {}
        self._error: BagError | None = None
        self._custom: dict[str, str] = {}
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Hands over a message; False where it was dropped because too much waits already."""
        size = len(item.data) + _OVERHEAD
        with self._changed:
            if self._error or self._stopping or self._waiting + size > self._limit:
                self._dropped[item.source.name] += 1
                return False
            if self._released_at is None:
                self._released_at = time.monotonic() + self._hold
                self._changed.notify()
            self._queue.append(item)
            self._waiting += size
        return True

    def release(self) -> None:
        """Ends the wait of the first messages."""
        with self._changed:
            self._released_at = 0.0
            self._changed.notify()

    def missed(self, topic: str, count: int) -> None:
        """Counts messages that were lost before they reached the recorder."""
        with self._changed:
            self._missed[topic] += count

    @property
    def error(self) -> BagError | None:
        """Why nothing more is written; None while all is well."""
        with self._changed:
            return self._error

    @property
    def waiting(self) -> int:
        """Bytes that wait for the disk."""
        with self._changed:
            return self._waiting

    @property
    def losses(self) -> tuple[dict[str, int], dict[str, int]]:
        """Messages by topic that were dropped here, and that were lost on their way here."""
        with self._changed:
            return dict(self._dropped), dict(self._missed)

    @property
    def summary(self) -> BagSummary:
        """What has been written so far."""
        return self._writer.summary

    def close(self, custom: dict[str, str] | None = None) -> BagSummary:
        """Writes what waits and closes the bag.

        Raises:
            BagError: The disk failed, now or before; the text says what is whole.
        """
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join()
        if self._error is None:
            self._write_losses(time.monotonic(), at_end=True)
        dropped, missed = self.losses
        return self._writer.close(
            {
                **(custom or {}),
                "dropped_by_recorder": json.dumps(dropped, sort_keys=True),
                "lost_in_transport": json.dumps(missed, sort_keys=True),
            }
        )

    # --- the writer's thread ----------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            batch, stopping = self._take()
            try:
                for item in batch:
                    self._write(item)
                now = time.monotonic()
                if now >= self._losses_at:
                    self._losses_at = now + _LOSSES_PERIOD
                    self._write_losses(now)
                self._writer.flush_if_due()
            except BagError as error:
                with self._changed:
                    self._error = error
                return
            if stopping:
                return

    def _take(self) -> tuple[list[Item], bool]:
        """Everything that waits, once there is something to do."""
        with self._changed:
            while not self._stopping:
                now = time.monotonic()
                if self._released_at is None:
                    self._changed.wait(_IDLE)
                elif now < self._released_at:
                    self._changed.wait(self._released_at - now)
                else:
                    # One wake-up for many messages: the period of the chunks bounds the delay.
                    self._changed.wait(min(self._writer.due, _GATHER))
                    if self._queue or self._writer.due == 0.0:
                        break
            batch = list(self._queue)
            self._queue.clear()
            self._waiting = 0
            stopping = self._stopping
        if not self._channels:
            batch.sort(key=lambda item: not item.source.first)
        return batch, stopping

    def _write(self, item: Item) -> None:
        source = item.source
        channel = self._channels.get(source.name)
        if channel is None:
            channel = self._writer.add_topic(source.name, source.kind, source.qos)
            self._channels[source.name] = channel
        if source.first and self._notes is not None and item.data not in self._noted:
            self._noted.add(item.data)
            note = self._notes(item.data)
            if note is not None:
                self._writer.add_metadata(*note)
        self._writer.write(channel, item.log_ns, item.publish_ns, item.data, item.sequence)

    def _write_losses(self, now: float, *, at_end: bool = False) -> None:
        dropped, missed = self.losses
        losses = Counter(dropped)
        losses.update(missed)
        if losses == self._losses_written and not (at_end and losses):
            return
        self._losses_at = now + _LOSSES_PERIOD
        self._losses_written = dict(losses)
        values = {
            "dropped_by_recorder": json.dumps(dropped, sort_keys=True),
            "lost_in_transport": json.dumps(missed, sort_keys=True),
        }
        self._writer.add_metadata(LOSSES_RECORD, sealed(values))
