"""Batches: what a node sends on its streams, in few messages, for those who receive all of it.

A recorder and an operators' page receive every stream of every node. One message of the middleware
costs as much as the samples of many ticks, so nodes also send their streams in batches. A batch
holds the messages as they are on their topics: same bytes, times of sending, and numbers.
"""

from __future__ import annotations

import itertools
import struct
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from msg_schemas.access import OF_ALL_NODES
from msg_schemas.specifications import Intent
from msg_schemas.table import TOPICS

STREAMS = frozenset(
    name
    for name, row in TOPICS.items()
    if row.rate is not None
    and row.intent in {Intent.SENSOR, Intent.STATE, Intent.CLOCK, Intent.COMMAND}
) - frozenset(OF_ALL_NODES.publishes)
"""Topics that are sent in batches: the periodic ones but those of all nodes."""

PERIOD = 0.1
"""Wall time after which a node sends what it has added since the last batch [s]."""

_MAX_SIZE = 32_000  # of a batch: well below the largest datagram [byte]
_OVERHEAD = 24  # of a message in a batch [byte]
_HEAD = struct.Struct("<II")  # number of messages, length of the topics' names
_ENTRY = struct.Struct("<HIQI")  # topic, number, time of sending [ns], length


class Entry(NamedTuple):
    """A message in a batch.

    Attributes:
        topic: full name.
        number: of the message on its topic, from 1, as its node counts them.
        sent_ns: time of sending [ns since 1970].
        data: serialized message.
    """

    topic: str
    number: int
    sent_ns: int
    data: bytes


def to_bytes(entries: Sequence[Entry]) -> bytes:
    """Return a batch: the topics' names, a table, then the messages."""
    numbers: dict[str, int] = {}
    table = [
        _ENTRY.pack(numbers.setdefault(topic, len(numbers)), number, sent_ns, len(data))
        for topic, number, sent_ns, data in entries
    ]
    names = "\n".join(numbers).encode()
    head = _HEAD.pack(len(entries), len(names))
    return b"".join((head, names, *table, *(each.data for each in entries)))


def from_bytes(batch: bytes) -> list[Entry]:
    """Return the messages of a batch in the order of sending.

    Raises:
        ValueError: the bytes are none.
    """
    try:
        count, length = _HEAD.unpack_from(batch)
        begin = _HEAD.size + length
        names = batch[_HEAD.size : begin].decode().split("\n")
        first = begin + count * _ENTRY.size
        table = list(_ENTRY.iter_unpack(batch[begin:first]))
        ends = list(itertools.accumulate((each[3] for each in table), initial=first))
        entries = [
            Entry(names[topic], number, sent_ns, batch[start:end])
            for (topic, number, sent_ns, _), (start, end) in zip(
                table, itertools.pairwise(ends), strict=True
            )
        ]
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        msg = f"{len(batch)} bytes are no batch: {error}"
        raise ValueError(msg) from error
    if len(entries) != count or ends[-1] != len(batch):
        msg = f"a batch of {count} messages should have {ends[-1]} bytes, it has {len(batch)}"
        raise ValueError(msg)
    return entries


class Batch:
    """Collects the messages of a node's streams, and sends them together; for any thread.

    Args:
        send: sends the bytes of a batch.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._lock = threading.Lock()
        self._numbers: Counter[str] = Counter()
        self._entries: list[Entry] = []
        self._size = 0

    def add(self, topic: str, sent_ns: int, data: bytes) -> None:
        """Add a message that is sent on a topic, and send the batch if it is full.

        Args:
            topic: full name.
            sent_ns: time just before it is sent on its topic [ns since 1970].
            data: serialized message.
        """
        with self._lock:
            self._numbers[topic] += 1
            self._entries.append(Entry(topic, self._numbers[topic], sent_ns, data))
            self._size += len(data) + _OVERHEAD
            if self._size >= _MAX_SIZE:
                self._flush()

    def flush(self) -> None:
        """Send what has been added."""
        with self._lock:
            self._flush()

    def _flush(self) -> None:
        if self._entries:
            entries, self._entries, self._size = self._entries, [], 0
            self._send(to_bytes(entries))
