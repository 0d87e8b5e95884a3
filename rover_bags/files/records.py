"""What every scan of a bag's file yields, whatever the file's format."""

from dataclasses import dataclass, field
from typing import NamedTuple


class Topic(NamedTuple):
    """One recorded topic as the bag announces it."""

    name: str
    type: str
    encoding: str
    schema: str
    schema_encoding: str
    qos: str
    type_hash: str


class Message(NamedTuple):
    """One recorded message, its bytes untouched; times in ns since 1970."""

    topic: Topic
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass(frozen=True)
class Damage:
    """A stretch of the file that was left out.

    Attributes:
        file: The file's name.
        offset: First byte.
        length: Bytes.
        reason: What is wrong with it.
        counts: Messages lost by topic, as the bag's index tells; empty where it does not.
        span_ns: Log time of the first and last message in it, as its header tells, or of the
            messages before and after it.
    """

    file: str
    offset: int
    length: int
    reason: str
    counts: dict[str, int] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None

    def words(self, start_ns: int) -> str:
        """What was left out and when, counted from the bag's first message [ns since 1970]."""
        place = f", byte {self.offset}" if self.offset or self.length else ""
        when = ""
        if self.span_ns is not None:
            begin, end = ((value - start_ns) * 1e-9 for value in self.span_ns)
            when = f", about {begin:.3f} s to {end:.3f} s after the first message"
        return f"{self.file}{place}: {self.reason}{when}; left out"
