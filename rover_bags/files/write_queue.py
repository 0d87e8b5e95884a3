"""Bounded queue between a recorder and its disk, with a writer thread.

The recorder hands over messages without blocking, however long the disk stalls. Messages that
exceed the limit are dropped and counted by topic; the counts are written into the bag. Nothing here
needs ROS.
"""

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from rosbags.interfaces import Qos

from rover_bags.files.store import (
    LOSSES_RECORD,
    BagError,
    BagSummary,
    BagWriter,
    TopicType,
    with_checksum,
)

_LOSSES_PERIOD = 0.5
_BATCH_PERIOD = 0.05
_IDLE = 1.0
_OVERHEAD = 200
"""Approximate memory overhead of a queued message [byte]."""


@dataclass(frozen=True)
class Source:
    """A recorded topic.

    Attributes:
        name: Full topic name.
        kind: Message type.
        qos: QoS profiles offered by its publishers.
        first: Whether its messages precede all others at the start of the file.
    """

    name: str
    kind: TopicType
    qos: tuple[Qos, ...] = ()
    first: bool = False


class Item(NamedTuple):
    """A message to write; times in ns since 1970."""

    source: Source
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


class SequenceMonitor:
    """Counts the lost messages of a topic from its publishers' sequence numbers.

    The middleware reports a message's sequence number but not its publisher. A number that
    continues a known sequence belongs to it. If all publishers have a sequence, any other number is
    a gap in the nearest sequence below it.
    """

    def __init__(self) -> None:
        self._last: list[int] = []

    def gap_before(self, sequence: int, publishers_now: Callable[[], int]) -> int:
        """Return the number of messages lost before this one.

        Args:
            sequence: Sequence number of the message, from 1.
            publishers_now: returns the current number of publishers of the topic; asked where the
                number continues no sequence, as the first message of a new one may be any.
        """
        last = self._last
        if sequence - 1 in last:
            last[last.index(sequence - 1)] = sequence
            return 0
        publishers = publishers_now()
        behind = [value for value in last if value < sequence]
        if sequence == 1 or not behind or len(last) < publishers:
            last.append(sequence)
            del last[: -max(publishers, 1)]
            return 0
        nearest = max(behind)
        last[last.index(nearest)] = sequence
        return sequence - 1 - nearest


class WriteQueue:
    """Accepts messages from any thread and writes them in its own.

    Writing starts ``hold`` seconds after the first message, so that topics marked ``first`` precede
    all others in the file, in whatever order they were discovered; :meth:`release` starts it early.

    Args:
        writer: Writer of the bag; the queue closes it.
        limit: Largest size of the queue [byte].
        hold: Delay of the first write [s].
        metadata_of: Called in the writer thread with each distinct message of a ``first`` topic;
            returns the metadata record to write, or None.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        limit: int = 64 << 20,
        hold: float = 0.4,
        metadata_of: Callable[[bytes], tuple[str, dict[str, str]] | None] | None = None,
    ) -> None:
        self._writer = writer
        self._limit = limit
        self._hold = hold
        self._metadata_of = metadata_of
        self._described: set[bytes] = set()
        self._queue: deque[Item] = deque()
        self._waiting = 0
        self._changed = threading.Condition()
        self._released_at: float | None = None
        self._stopping = False
        self._accepted: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._lost: Counter[str] = Counter()
        self._losses_written: dict[str, int] = {}
        self._losses_at = 0.0
        self._channels: dict[str, int] = {}
        self._error: BagError | None = None
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Queue a message; return False if it was dropped because the queue is full."""
        size = len(item.data) + _OVERHEAD
        with self._changed:
            if self._error or self._stopping or self._waiting + size > self._limit:
                self._dropped[item.source.name] += 1
                return False
            if self._released_at is None:
                self._released_at = time.monotonic() + self._hold
                self._changed.notify()
            self._queue.append(item)
            self._accepted[item.source.name] += 1
            self._waiting += size
        return True

    def release(self) -> None:
        """Start writing now."""
        with self._changed:
            self._released_at = 0.0
            self._changed.notify()

    def count_lost(self, topic: str, count: int) -> None:
        """Count messages that were lost before they reached the recorder."""
        with self._changed:
            self._lost[topic] += count

    @property
    def error(self) -> BagError | None:
        """The error that stopped the writer, or None."""
        with self._changed:
            return self._error

    @property
    def waiting(self) -> int:
        """Size of the queued messages [byte]."""
        with self._changed:
            return self._waiting

    @property
    def losses(self) -> tuple[dict[str, int], dict[str, int]]:
        """Messages dropped by the recorder and messages lost in transport, by topic."""
        with self._changed:
            return dict(self._dropped), dict(self._lost)

    @property
    def summary(self) -> BagSummary:
        """Summary of the bag so far."""
        return self._writer.summary

    def close(self, custom: dict[str, str] | None = None) -> BagSummary:
        """Write the queued messages and close the bag.

        Raises:
            BagError: The disk failed; the message states what is recoverable.
        """
        with self._changed:
            self._stopping = True
            self._changed.notify()
        self._thread.join()
        self._write_losses(time.monotonic(), at_end=True)
        dropped, lost = self.losses
        try:
            return self._writer.close(
                {
                    **(custom or {}),
                    "dropped_by_recorder": json.dumps(dropped, sort_keys=True),
                    "lost_in_transport": json.dumps(lost, sort_keys=True),
                }
            )
        except BagError:
            with self._changed:
                self._count_unwritten()
            raise

    # --- writer thread ----------------------------------------------------------------------------

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
            except Exception as error:  # noqa: BLE001 - without this thread nothing is recorded
                with self._changed:
                    self._error = (
                        error
                        if isinstance(error, BagError)
                        else BagError(f"the recording ended: {error!r}")
                    )
                    self._queue.clear()
                    self._waiting = 0
                    self._count_unwritten()
                return
            if stopping:
                return

    def _count_unwritten(self) -> None:
        """Count accepted messages that the bag will not hold as dropped."""
        written = Counter(self._writer.summary.counts)
        self._dropped += self._accepted - written
        self._accepted = written

    def _take(self) -> tuple[list[Item], bool]:
        """Wait for work; return the queued messages and whether to stop."""
        with self._changed:
            while not self._stopping:
                now = time.monotonic()
                if self._released_at is None:
                    self._changed.wait(_IDLE)
                elif now < self._released_at:
                    self._changed.wait(self._released_at - now)
                else:
                    # Wake up once for many messages; the chunk period bounds the delay.
                    self._changed.wait(min(self._writer.due, _BATCH_PERIOD))
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
        if source.first and self._metadata_of is not None and item.data not in self._described:
            self._described.add(item.data)
            record = self._metadata_of(item.data)
            if record is not None:
                self._writer.add_metadata(*record)
        self._writer.write(channel, item.log_ns, item.publish_ns, item.data, item.sequence)

    def _write_losses(self, now: float, *, at_end: bool = False) -> None:
        dropped, lost = self.losses
        losses = Counter(dropped)
        losses.update(lost)
        if losses == self._losses_written and not (at_end and losses):
            return
        self._losses_at = now + _LOSSES_PERIOD
        self._losses_written = dict(losses)
        values = {
            "dropped_by_recorder": json.dumps(dropped, sort_keys=True),
            "lost_in_transport": json.dumps(lost, sort_keys=True),
        }
        self._writer.add_metadata(LOSSES_RECORD, with_checksum(values))
