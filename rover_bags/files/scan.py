"""Scan all files of a bag, intact or damaged, as one sequence of messages.

Supports MCAP and SQLite, split files, compression by chunk, message or file, and bags with or
without a valid ``metadata.yaml``. Unreadable parts are reported with the number and time of lost
messages, as far as the bag shows them.
"""

import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from heapq import merge
from itertools import chain
from pathlib import Path
from typing import Any, Final

import zstandard

from msg_schemas.regular_files import open_regular
from rover_bags.files.decompression import unpack_file, unpack_zstd
from rover_bags.files.file_scan import FileScan
from rover_bags.files.folder import (
    ZSTD_SUFFIX,
    ScanError,
    bag_files,
    is_one_recording,
    is_sqlite,
    metadata_problem,
    missing_files,
    stored_metadata,
)
from rover_bags.files.mcap_scan import McapScan
from rover_bags.files.records import ALL_TIMES, Damage, DeclaredTopic, RecordedMessage
from rover_bags.files.sqlite_scan import SqliteScan

_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""Never the start of a CDR message, whose first byte is 0."""
_LARGEST_MESSAGE: Final = 1 << 28


def _log_ns(message: RecordedMessage) -> int:
    return message.log_ns


class CompressedScan(FileScan):
    """Scan of a file compressed as a whole; it is decompressed into a temporary folder."""

    def __init__(self, path: Path, within: tuple[int, int] = ALL_TIMES) -> None:
        super().__init__(path)
        self._within = within

    def __iter__(self) -> Iterator[RecordedMessage]:
        with tempfile.TemporaryDirectory(prefix="mother_rover_") as folder:
            plain = Path(folder) / self.path.name.removesuffix(ZSTD_SUFFIX)
            problem = self._decompress(plain)
            inner = _plain_scan(plain, self._within)
            # Share the list, so that metadata are visible during the scan.
            self.metadata = inner.metadata
            try:
                yield from inner
                self.done = self.path.stat().st_size
            except ScanError as error:
                why = str(error).replace(str(plain), str(self.path))
                raise ScanError(f"{problem}; {why}" if problem else why) from None
            self.closed = inner.closed and not problem
            cut = Damage(self.path.name, plain.stat().st_size, 0, problem) if problem else None
            self.damage = [*([cut] if cut else []), *inner.damage]
            self.unverified, self.attachments = inner.unverified, inner.attachments
            self.expected = inner.expected
            self._topics = dict(enumerate(inner.declared_topics))

    def _decompress(self, plain: Path) -> str:
        """Decompress as much as possible; return the reason of an early end, or ""."""
        try:
            stream = open_regular(self.path)
        except OSError as error:
            raise ScanError(f"cannot read {self.path}: {error.strerror}") from error
        with stream as packed, plain.open("wb") as target:
            problem = unpack_file(packed, os.fstat(packed.fileno()).st_size, target)
        return f"{self.path.name} {problem}" if problem else ""


def _plain_scan(path: Path, within: tuple[int, int] = ALL_TIMES) -> FileScan:
    return SqliteScan(path) if is_sqlite(path) else McapScan(path, within)


class BagScan:
    """One pass over all files of a bag, in their order; those of several recordings by log time.

    Iterate over it for the messages; the attributes are complete after the iteration.

    Args:
        path: The bag's folder, or one file of a bag.
        within: First and last log time [ns since 1970]; messages before and after may be left out.

    Attributes:
        files: Scans of the files.
        information: Contents of ``metadata.yaml``; None if it is missing or damaged.
        counts: Yielded messages by topic.

    Raises:
        ScanError: There is no bag.
    """

    def __init__(self, path: Path, within: tuple[int, int] = ALL_TIMES) -> None:
        self.path = path
        self.information = stored_metadata(path)
        self.files: list[FileScan] = [
            CompressedScan(file, within)
            if file.name.endswith(ZSTD_SUFFIX)
            else _plain_scan(file, within)
            for file in bag_files(path)
        ]
        self.counts: Counter[str] = Counter()
        self._bag_damage = [self._missing(name) for name in missing_files(path, self.information)]

    def __iter__(self) -> Iterator[RecordedMessage]:
        counts = self.counts
        counts.clear()
        files = [self._messages_of(file) for file in self.files]
        is_one = is_one_recording([file.path for file in self.files])
        # Several recordings may be of the same time, or named in another order.
        messages = chain.from_iterable(files) if is_one else merge(*files, key=_log_ns)
        for message in messages:
            counts[message.topic.name] += 1
            yield message

    def _messages_of(self, file: FileScan) -> Iterator[RecordedMessage]:
        try:
            for message in file:
                whole: RecordedMessage | None = message
                if message.data.startswith(_ZSTD_MAGIC):
                    whole = self._decompressed(file, message)
                if whole is not None:
                    yield whole
        except ScanError as error:
            if len(self.files) == 1:
                raise
            self._bag_damage.append(Damage(file.path.name, 0, 0, str(error)))

    def _decompressed(self, file: FileScan, message: RecordedMessage) -> RecordedMessage | None:
        """The message that the recorder compressed by itself; None if it is damaged."""
        try:
            data = unpack_zstd(message.data, _LARGEST_MESSAGE)
        except (zstandard.ZstdError, MemoryError):
            why = "a compressed message cannot be decompressed"
            span = (message.log_ns, message.log_ns)
            lost = {message.topic.name: 1}
            self._bag_damage.append(Damage(file.path.name, 0, 0, why, lost, span))
            return None
        return message._replace(data=data)

    def _missing(self, name: str) -> Damage:
        """Damage record of a missing file, with its time and message count if known."""
        files = (self.information or {}).get("files")
        row: Any = next(
            (
                row
                for row in (files if isinstance(files, list) else [])
                if isinstance(row, dict) and row.get("path") == name
            ),
            {},
        )
        reason, span = "the file is missing", None
        try:
            first = int(row["starting_time"]["nanoseconds_since_epoch"])
            span = (first, first + int(row["duration"]["nanoseconds"]))
            reason += f", with {int(row['message_count'])} messages"
        except (KeyError, TypeError, ValueError, OverflowError):
            pass
        return Damage(name, 0, 0, reason, {}, span)

    @property
    def size(self) -> int:
        """Size of all files [byte]."""
        return sum(file.path.stat().st_size for file in self.files)

    @property
    def done(self) -> int:
        """Number of bytes that have been read."""
        return sum(file.done for file in self.files)

    @property
    def closed(self) -> bool:
        """Whether the recorder closed every file."""
        return all(file.closed for file in self.files)

    @property
    def damage(self) -> list[Damage]:
        """All damaged or missing parts."""
        return [*self._bag_damage, *(item for file in self.files for item in file.damage)]

    def defects(self, start_ns: int) -> list[str]:
        """Describe what is missing or damaged in the files.

        Args:
            start_ns: Log time of the bag's first message [ns since 1970].
        """
        found = []
        if not self.closed:
            found.append(
                "the bag is not closed: its recorder was killed or a file was cut, and later "
                "messages are missing"
            )
        if why := metadata_problem(self.path):
            found.append(
                f"metadata.yaml is {why}: missing files after the last one cannot be detected"
            )
        return [*found, *(item.describe(start_ns) for item in self.damage)]

    @property
    def unverified(self) -> Counter[str]:
        """Messages without a checksum, by topic."""
        return sum((file.unverified for file in self.files), Counter())

    @property
    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Metadata records in recorded order."""
        return [item for file in self.files for item in file.metadata]

    @property
    def declared_topics(self) -> list[DeclaredTopic]:
        """Every topic declared in the files."""
        return list(dict.fromkeys(topic for file in self.files for topic in file.declared_topics))

    @property
    def expected(self) -> dict[str, int] | None:
        """Messages by topic as counted by the bag: its files' indexes, or else ``metadata.yaml``.

        None if neither exists.
        """
        if not self._bag_damage and all(file.expected is not None for file in self.files):
            total: Counter[str] = Counter()
            for file in self.files:
                total.update(file.expected or {})
            return dict(total)
        return self._described()

    def _described(self) -> dict[str, int] | None:
        """Messages by topic according to ``metadata.yaml``, which has 0 if it was not closed."""
        if self.information is None or self.path.is_file():
            return None
        try:
            counts = {
                str(row["topic_metadata"]["name"]): int(row["message_count"])
                for row in self.information["topics_with_message_count"]
            }
        except (KeyError, TypeError, ValueError, OverflowError):
            return None
        return counts if sum(counts.values()) else None

    @property
    def lost(self) -> dict[str, int]:
        """Messages by topic that the bag counts and that were not yielded."""
        expected = self.expected
        missing: Counter[str] = Counter()
        if expected is None:
            for item in self.damage:
                missing.update(item.counts)
        else:
            missing.update(expected)
            missing.subtract(self.counts)
        return {topic: count for topic, count in missing.items() if count > 0}
