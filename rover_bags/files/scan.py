"""Walks all files of a bag, of whatever kind and in whatever state, as one sequence of messages.

MCAP and SQLite files, split or not, compressed chunk by chunk, message by message or file by file,
with or without a sound ``metadata.yaml``. What cannot be read is named, with the messages lost and
their time as far as anything in the bag tells them.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Protocol

import zstandard

from rover_bags.files.folder import (
    PACKED,
    ScanError,
    bag_files,
    is_sqlite,
    missing_files,
    stored_metadata,
    without_description,
)
from rover_bags.files.mcap_scan import McapScan
from rover_bags.files.records import Damage, Message, Topic
from rover_bags.files.sqlite_scan import SqliteScan

_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
"""No CDR message begins so: its first byte is 0."""
_LARGEST_MESSAGE: Final = 1 << 30
_BLOCK: Final = 1 << 20


class FileScan(Protocol):
    """What the scan of one file offers; see `McapScan` for the attributes."""

    path: Path
    closed: bool
    damage: list[Damage]
    unverified: Counter[str]
    metadata: list[tuple[str, dict[str, str]]]
    foreign: int
    expected: dict[str, int] | None
    done: int

    @property
    def announced(self) -> list[Topic]:
        """Every topic that the file describes."""

    def __iter__(self) -> Iterator[Message]: ...


class PackedScan:
    """A file that was compressed as a whole; it is unpacked into a scratch folder to be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.closed = True
        self.damage: list[Damage] = []
        self.unverified: Counter[str] = Counter()
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.foreign = 0
        self.expected: dict[str, int] | None = None
        self.announced: list[Topic] = []
        self.done = 0

    def __iter__(self) -> Iterator[Message]:
        with tempfile.TemporaryDirectory(prefix="mother_rover_") as folder:
            plain = Path(folder) / self.path.name.removesuffix(PACKED)
            trouble = self._unpack(plain)
            inner = _plain_scan(plain)
            # One list for both: what the inner scan finds is seen while it walks.
            self.metadata = inner.metadata
            try:
                yield from inner
                self.done = self.path.stat().st_size
            except ScanError as error:
                why = str(error).replace(str(plain), str(self.path))
                raise ScanError(f"{trouble}; {why}" if trouble else why) from None
            self.closed = inner.closed and not trouble
            cut = Damage(self.path.name, plain.stat().st_size, 0, trouble) if trouble else None
            self.damage = [*([cut] if cut else []), *inner.damage]
            self.unverified, self.foreign = inner.unverified, inner.foreign
            self.expected, self.announced = inner.expected, inner.announced

    def _unpack(self, plain: Path) -> str:
        """Unpacks as much as can be; returns what stopped it, or nothing."""
        with self.path.open("rb") as packed, plain.open("wb") as target:
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            try:
                while block := reader.read(_BLOCK):
                    target.write(block)
            except zstandard.ZstdError as error:
                return f"{self.path.name} cannot be unpacked to its end ({error})"
        if not _ends_whole(self.path):
            return f"{self.path.name} is cut: its compressed data have no end"
        return ""


def _ends_whole(path: Path) -> bool:
    """Whether the compressed frames of a file are complete."""
    unpacker = zstandard.ZstdDecompressor().decompressobj()
    with path.open("rb") as packed:
        while block := packed.read(_BLOCK):
            while block:
                unpacker.decompress(block)
                if not unpacker.eof:
                    break
                block = unpacker.unused_data
                if block:
                    unpacker = zstandard.ZstdDecompressor().decompressobj()
    return unpacker.eof


def _plain_scan(path: Path) -> FileScan:
    return SqliteScan(path) if is_sqlite(path) else McapScan(path)


class BagScan:
    """One pass over all files of a bag, in their order.

    Iterate over it for the messages; the attributes are complete when the iteration is.

    Args:
        path: The bag's folder, or one file of a bag.

    Attributes:
        files: The scans of its files.
        information: The bag's ``metadata.yaml``, None where there is no sound one.
        counts: Messages by topic that were yielded.

    Raises:
        ScanError: There is no bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.information = stored_metadata(path)
        self.files: list[FileScan] = [
            PackedScan(file) if file.name.endswith(PACKED) else _plain_scan(file)
            for file in bag_files(path)
        ]
        self.counts: Counter[str] = Counter()
        self._beside = [self._missing(name) for name in missing_files(path, self.information)]

    def __iter__(self) -> Iterator[Message]:
        self.counts.clear()
        for file in self.files:
            try:
                for message in file:
                    whole = self._unpacked(file, message)
                    if whole is not None:
                        self.counts[message.topic.name] += 1
                        yield whole
            except ScanError as error:
                if len(self.files) == 1:
                    raise
                self._beside.append(Damage(file.path.name, 0, 0, str(error)))

    def _unpacked(self, file: FileScan, message: Message) -> Message | None:
        """The message, decompressed where the recorder compressed each by itself."""
        if not message.data.startswith(_ZSTD_MAGIC):
            return message
        try:
            data = zstandard.ZstdDecompressor().decompress(
                message.data, max_output_size=_LARGEST_MESSAGE
            )
        except (zstandard.ZstdError, MemoryError):
            why = "a compressed message cannot be unpacked"
            span = (message.log_ns, message.log_ns)
            lost = {message.topic.name: 1}
            self._beside.append(Damage(file.path.name, 0, 0, why, lost, span))
            return None
        return message._replace(data=data)

    def _missing(self, name: str) -> Damage:
        """What is known of a file that is not there."""
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
        except (KeyError, TypeError, ValueError):
            pass
        return Damage(name, 0, 0, reason, {}, span)

    @property
    def size(self) -> int:
        """Of its files [byte]."""
        return sum(file.path.stat().st_size for file in self.files)

    @property
    def done(self) -> int:
        """Bytes of its files that have been read."""
        return sum(file.done for file in self.files)

    @property
    def closed(self) -> bool:
        """Whether the recorder closed every file."""
        return all(file.closed for file in self.files)

    @property
    def damage(self) -> list[Damage]:
        """Everything that was left out."""
        return [*self._beside, *(item for file in self.files for item in file.damage)]

    def defects(self, start_ns: int) -> list[str]:
        """What its files lack: their end, their description, stretches of them.

        Args:
            start_ns: Log time of its first message [ns since 1970].
        """
        found = []
        if not self.closed:
            found.append(
                "this bag has no proper end: its recorder was killed or a file was cut, and what "
                "should follow is missing"
            )
        if why := without_description(self.path):
            found.append(
                f"metadata.yaml is {why}: nothing tells whether files are missing after the last"
            )
        return [*found, *(item.words(start_ns) for item in self.damage)]

    @property
    def unverified(self) -> Counter[str]:
        """Messages by topic that no checksum protects."""
        return sum((file.unverified for file in self.files), Counter())

    @property
    def metadata(self) -> list[tuple[str, dict[str, str]]]:
        """Metadata records in their order."""
        return [item for file in self.files for item in file.metadata]

    @property
    def announced(self) -> list[Topic]:
        """Every topic that the files describe."""
        return list(dict.fromkeys(topic for file in self.files for topic in file.announced))

    @property
    def expected(self) -> dict[str, int] | None:
        """Messages by topic as the bag itself counts them; None where nothing counts them.

        The files' own indexes are believed first, then the bag's ``metadata.yaml``.
        """
        if not self._beside and all(file.expected is not None for file in self.files):
            total: Counter[str] = Counter()
            for file in self.files:
                total.update(file.expected or {})
            return dict(total)
        return self._described()

    def _described(self) -> dict[str, int] | None:
        """Messages by topic as ``metadata.yaml`` counts them; a bag that was not closed has 0."""
        if self.information is None or self.path.is_file():
            return None
        try:
            counts = {
                str(row["topic_metadata"]["name"]): int(row["message_count"])
                for row in self.information["topics_with_message_count"]
            }
        except (KeyError, TypeError, ValueError):
            return None
        return counts if sum(counts.values()) else None

    @property
    def lost(self) -> dict[str, int]:
        """Messages by topic that the bag should hold and that were not yielded."""
        expected = self.expected
        missing: Counter[str] = Counter()
        if expected is None:
            for item in self.damage:
                missing.update(item.counts)
        else:
            missing.update(expected)
            missing.subtract(self.counts)
        return {topic: count for topic, count in missing.items() if count > 0}
