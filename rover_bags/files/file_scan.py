"""The base of scans of one file, whatever its format."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from rover_bags.files.records import Damage, DeclaredTopic, RecordedMessage


class FileScan(ABC):
    """One pass over one file of a bag.

    Iterate over it for the messages; the attributes are complete after the iteration.

    Attributes:
        path: The file.
        closed: Whether the recorder closed it, so that nothing is cut off.
        damage: Damaged parts, which were skipped.
        unverified: Yielded messages without a checksum, by topic.
        metadata: Metadata records with their names, in recorded order.
        attachments: Number of attachments, which are not read.
        expected: Messages by topic as counted by the file's index; None without an index.
        done: Number of bytes that have been read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.closed = True
        self.damage: list[Damage] = []
        self.unverified: Counter[str] = Counter()
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.attachments = 0
        self.expected: dict[str, int] | None = None
        self.done = 0
        self._topics: dict[int, DeclaredTopic] = {}

    @property
    def declared_topics(self) -> list[DeclaredTopic]:
        """Every topic declared in the file."""
        return list(self._topics.values())

    @abstractmethod
    def __iter__(self) -> Iterator[RecordedMessage]:
        """Yield the messages in the order of the file."""
