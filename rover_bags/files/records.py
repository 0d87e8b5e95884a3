"""Records that scans of all file formats yield."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

ALL_TIMES: Final = (0, (1 << 64) - 1)
"""First and last log time that a file can hold [ns since 1970]."""

LAST_NS: Final = (1 << 63) - 1
"""Last time that time series, SQLite and ROS can hold [ns since 1970], in the year 2262."""
CDR: Final = "cdr"
"""Encoding of ROS 2's messages."""


class DeclaredTopic(NamedTuple):
    """One recorded topic, as declared in the bag."""

    name: str
    type: str
    encoding: str
    schema: str
    schema_encoding: str
    qos: str
    type_hash: str


class RecordedMessage(NamedTuple):
    """One recorded message, serialised; times in ns since 1970."""

    topic: DeclaredTopic
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class Damage:
    """A damaged part of a file, which was skipped.

    Attributes:
        file: Name of the file.
        offset: First byte.
        length: Number of bytes.
        reason: Description of the damage.
        counts: Lost messages by topic, from the bag's index; empty if unknown.
        span_ns: Log times of the first and last message in it, from its header, or of the messages
            before and after it.
    """

    file: str
    offset: int
    length: int
    reason: str
    counts: dict[str, int] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None

    def describe(self, start_ns: int) -> str:
        """Describe the damage; times count from the bag's first message [ns since 1970]."""
        place = f", byte {self.offset}" if self.offset or self.length else ""
        when = ""
        if self.span_ns is not None:
            begin, end = ((value - start_ns) * 1e-9 for value in self.span_ns)
            when = f", about {begin:.3f} s to {end:.3f} s after the first message"
        return f"{self.file}{place}: {self.reason}{when}; skipped"
