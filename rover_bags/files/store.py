"""Write bags: a folder with ``metadata.yaml`` and ``<name>_0.mcap``.

The layout is rosbag2's version 9 (ROS 2 Jazzy): ``ros2 bag``, rosbags and the MCAP tools read it.
In addition to a plain MCAP writer, this writer is robust to failures:

* Messages reach the file in complete, checksummed chunks at least every ``chunk_period`` seconds of
  wall time, so that a killed recorder loses only the last fraction of a second. An fdatasync after
  each chunk extends this to a loss of power.
* A chunk that the disk did not accept completely is truncated: the file always ends with a chunk.
* The recording ends while there is still room for the index.
* The declaration of each topic is stored twice, once outside the chunks, so that one damaged chunk
  does not make others unreadable.

Nothing here needs ROS.
"""

import contextlib
import errno
import json
import os
import shutil
import time
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, Self, cast

import yaml
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.typesys import Stores, TypesysError, get_typestore

from rover_bags.files.records import CDR

STORAGE_VERSION: Final = 9
ROS_DISTRO: Final = "jazzy"
IDENTITY_RECORD: Final = "mother_rover"
"""MCAP metadata record with the versions, the configuration and the seed of a recording."""
CHANNEL_RECORD: Final = "mother_rover.channel"
"""MCAP metadata record that repeats one topic's declaration outside the chunks."""
LOSSES_RECORD: Final = "mother_rover.losses"
"""MCAP metadata record with the numbers of dropped and lost messages, by topic."""
CHECKSUM_KEY: Final = "crc32"

_COMPRESSIONS: Final = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
_FULL: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


class BagError(OSError):
    """A bag that cannot be written or read; the message states path, reason and remedy."""


class DiskFullError(BagError):
    """The disk, a quota or a size limit is exhausted; the chunks written so far are complete."""


def with_checksum(values: Mapping[str, str]) -> dict[str, str]:
    """Return the mapping with a checksum of its contents, as MCAP metadata records have none."""
    text = json.dumps(dict(sorted(values.items())), ensure_ascii=True)
    return {**values, CHECKSUM_KEY: f"{zlib.crc32(text.encode()):08x}"}


def verified_contents(values: Mapping[str, str]) -> dict[str, str] | None:
    """Return the contents of a :func:`with_checksum` mapping, or None if the checksum is wrong."""
    contents = {key: value for key, value in values.items() if key != CHECKSUM_KEY}
    return contents if with_checksum(contents) == dict(values) else None


@dataclass(frozen=True)
class TopicType:
    """A message type with its definition.

    Attributes:
        name: Type name such as ``sensor_msgs/msg/JointState``.
        schema: Definition text, including nested types.
        encoding: Encoding of the text (``ros2msg``).
        type_hash: RIHS01 hash of the type; empty if unknown.
        serialization: Encoding of the messages.
    """

    name: str
    schema: bytes
    encoding: str = "ros2msg"
    type_hash: str = ""
    serialization: str = CDR


_STORE: Final = get_typestore(Stores.ROS2_JAZZY)


def standard_type(name: str) -> TopicType:
    """Return definition and hash of a message type of the standard packages.

    Raises:
        BagError: The type is not one of Jazzy's common interfaces.
    """
    try:
        text, _ = _STORE.generate_msgdef(name, ros_version=2)
        return TopicType(name, text.encode(), "ros2msg", _STORE.hash_rihs01(name))
    except (TypesysError, KeyError) as error:
        raise BagError(
            f"no definition of message type {name!r} is known; "
            "record types of the standard packages (std_msgs, sensor_msgs, ...)"
        ) from error


@dataclass(frozen=True)
class BagSummary:
    """Summary of a bag.

    Attributes:
        path: The bag's folder.
        counts: Messages by topic.
        first_ns: Log time of the first message [ns since 1970]; 0 for an empty bag.
        last_ns: Log time of the last message [ns since 1970].
        size: Size of the MCAP file [byte].
    """

    path: Path
    counts: Mapping[str, int]
    first_ns: int
    last_ns: int
    size: int

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(self.counts.values())

    @property
    def duration(self) -> float:
        """Time from the first to the last message [s]."""
        return (self.last_ns - self.first_ns) * 1e-9


class _Disk:
    """File object for the MCAP writer that writes complete groups of records only.

    The MCAP writer counts its own offsets, so a failed group ends the file: it is truncated to the
    last complete group, and nothing can be added.
    """

    def __init__(self, path: Path, *, sync: bool) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._sync = sync
        self._pending = bytearray()
        self.committed = 0

    def tell(self) -> int:
        return self.committed + len(self._pending)

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def flush(self) -> None:
        if not self._pending:
            return
        view = memoryview(bytes(self._pending))
        try:
            written = 0
            while written < len(view):
                written += os.write(self._fd, view[written:])
            if self._sync:
                os.fdatasync(self._fd)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._fd, self.committed)
            raise
        self.committed += len(view)
        self._pending.clear()

    def force(self) -> None:
        os.fsync(self._fd)

    def close(self) -> None:
        os.close(self._fd)


class _PackedIndex:
    """The index of a chunk as the bytes that the file will hold, smaller than its object."""

    __slots__ = ("_record",)

    def __init__(self, index: ChunkIndex) -> None:
        builder: Any = RecordBuilder()
        index.write(builder)
        self._record = builder.end()

    def write(self, builder: RecordBuilder) -> None:
        builder.write(self._record)


class _PackedIndices(list[_PackedIndex]):
    """Replaces the list of indices that the MCAP writer keeps until it finishes the file."""

    def append(self, index: Any) -> None:
        super().append(_PackedIndex(index))


@dataclass
class _Topic:
    name: str
    kind: TopicType
    qos: tuple[Qos, ...]
    count: int = 0
    committed: int = 0  # in complete chunks


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _create_folder(path: Path) -> None:
    """Create the bag's folder, which must not exist."""
    try:
        if path.is_symlink() or path.exists():
            if _any_mcap(path) or (path / "metadata.yaml").exists():
                kind = "a bag"
            else:
                kind = "a folder" if path.is_dir() else "a file"
            raise BagError(
                f"cannot write the bag {path}: {kind} of that name exists and is never "
                "overwritten; choose another name or remove it"
            )
        path.mkdir(parents=True)
    except BagError:
        raise
    except NotADirectoryError as error:
        raise BagError(
            f"cannot write the bag {path}: a part of its path is a file, not a folder"
        ) from error
    except OSError as error:
        if error.errno in _FULL:
            raise DiskFullError(f"cannot write the bag {path}: the disk is full") from error
        raise BagError(
            f"cannot write the bag {path}: its folder cannot be created ({error.strerror}); "
            "choose a writable location"
        ) from error


def _any_mcap(folder: Path) -> bool:
    """Whether a folder holds MCAP files."""
    return folder.is_dir() and any(folder.glob("*.mcap"))


class BagWriter:
    """Writes one bag.

    As a context manager it leaves a whole bag, or none where the block raises: so a copy is
    complete. A recorder calls :meth:`close` instead; what it had written before an error stays. A
    bag that was not closed lacks its index and ``metadata.yaml`` and holds every message of the
    chunks written so far.

    Args:
        path: Folder to create.
        compression: ``zstd``, ``lz4`` or ``none``, by chunk.
        chunk_period: Longest wall time [s] that a message waits before its chunk is written.
        chunk_bytes: Uncompressed size [byte] at which a chunk is written before its period ends.
        sync: Whether each chunk is forced onto the disk, against loss of power.
        reserve: Free space [byte] below which the disk counts as full, for index and metadata.

    Raises:
        BagError: The folder exists or cannot be written.
        DiskFullError: Less than ``reserve`` is free.
    """

    def __init__(
        self,
        path: Path,
        *,
        compression: str = "zstd",
        chunk_period: float = 0.25,
        chunk_bytes: int = 1 << 20,
        sync: bool = True,
        reserve: int = 16 << 20,
    ) -> None:
        if compression not in _COMPRESSIONS:
            raise BagError(
                f"unknown compression {compression!r}; choose one of {', '.join(_COMPRESSIONS)}"
            )
        if not chunk_period > 0.0:
            raise BagError(f"the chunk period is {chunk_period} s; it must be above 0")
        self.path = path
        self._period = chunk_period
        self._reserve = reserve
        self._sync = sync
        self._topics: dict[int, _Topic] = {}
        self._schemas: dict[TopicType, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._chunk_opened: float | None = None
        self._broken = False
        self._closed = False
        self._is_whole_or_none = False
        _create_folder(path)
        self.file = path / f"{path.resolve().name}_0.mcap"
        try:
            self._check_room(path)
            self._disk = _Disk(self.file, sync=sync)
            self._writer: Any = Writer(
                cast("IO[bytes]", self._disk),
                chunk_size=chunk_bytes,
                compression=_COMPRESSIONS[compression],
                enable_crcs=True,
                enable_data_crcs=True,
            )
            # Its attribute is private, and there is no other way to bound its memory.
            vars(self._writer)["_Writer__chunk_indices"] = _PackedIndices()
            self._writer.start(profile="ros2", library="mother_rover")
            self._disk.flush()
            if sync:
                _sync_folder(path)
        except OSError as error:
            self.file.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                path.rmdir()
            if isinstance(error, BagError):
                raise
            raise self._explained(error, "cannot write the bag") from error

    def __enter__(self) -> Self:
        self._is_whole_or_none = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None:
            self.discard()
        elif not self._closed:
            self.close()

    def add_topic(self, name: str, kind: TopicType, qos: Iterable[Qos] = ()) -> int:
        """Declare a topic; return its channel number for :meth:`write`.

        Args:
            name: Full topic name.
            kind: Its type.
            qos: Quality of service that its publishers offered.
        """
        profiles = tuple(qos)
        if kind not in self._schemas:
            self._schemas[kind] = int(
                self._writer.register_schema(kind.name, kind.encoding, kind.schema)
            )
        metadata = {
            "offered_qos_profiles": _yaml(dump_qos_v9(list(profiles))).strip(),
            "topic_type_hash": kind.type_hash,
        }
        channel = int(
            self._writer.register_channel(name, kind.serialization, self._schemas[kind], metadata)
        )
        self._topics[channel] = _Topic(name, kind, profiles)
        self.add_metadata(
            CHANNEL_RECORD,
            with_checksum(
                {
                    "id": str(channel),
                    "topic": name,
                    "type": kind.name,
                    "encoding": kind.encoding,
                    "serialization": kind.serialization,
                    "schema": kind.schema.decode(),
                    **metadata,
                }
            ),
        )
        return channel

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add an MCAP metadata record; it is written with the next chunk."""
        self._writer.add_metadata(name, dict(values))

    def write(
        self, channel: int, log_ns: int, publish_ns: int, data: bytes, sequence: int = 0
    ) -> None:
        """Add a message; it is written when its chunk is full or its period has passed.

        Args:
            channel: Number from :meth:`add_topic`.
            log_ns: Time of receipt [ns since 1970].
            publish_ns: Time of publication [ns since 1970].
            data: Serialised message (CDR with its 4 byte header).
            sequence: Sequence number by the publisher; 0 if unknown.

        Raises:
            DiskFullError: The disk is full; close the bag.
            BagError: The disk failed; close the bag.
        """
        topic = self._topics[channel]
        now = time.monotonic()
        if self._chunk_opened is None:
            self._chunk_opened = now
        before = self._disk.tell()
        self._writer.add_message(
            channel_id=channel,
            log_time=log_ns,
            data=data,
            publish_time=publish_ns,
            sequence=sequence & 0xFFFFFFFF,
        )
        topic.count += 1
        self._first_ns = log_ns if self._first_ns is None else min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)
        if self._disk.tell() > before or now - self._chunk_opened >= self._period:
            self.flush()

    @property
    def due(self) -> float:
        """Wall time [s] until the current chunk must be written; infinite without a chunk."""
        if self._chunk_opened is None:
            return float("inf")
        return max(0.0, self._chunk_opened + self._period - time.monotonic())

    def flush_if_due(self) -> None:
        """Write the current chunk if its period has passed; call it while no messages come."""
        if self.due == 0.0:
            self.flush()

    def flush(self) -> None:
        """Write the current chunk and all pending records, completely or not at all.

        Raises:
            DiskFullError: The disk is full.
            BagError: The disk failed.
        """
        self._check_room(self.file)
        self._chunk_opened = None
        try:
            self._write_chunk()
        except OSError as error:
            self._broken = True
            raise self._explained(error, "the recording ended:") from error

    def _write_chunk(self) -> None:
        try:
            self._writer.flush()
        except OSError:
            for topic in self._topics.values():
                topic.count = topic.committed
            raise
        for topic in self._topics.values():
            topic.committed = topic.count

    def close(self, custom: Mapping[str, str] | None = None) -> BagSummary:
        """Write index, checksums and ``metadata.yaml``, and close the file.

        Args:
            custom: Texts for the field ``custom_data`` of the metadata.

        Raises:
            DiskFullError: The disk is full; every chunk written before is complete and
                ``mother_rover bag recover`` makes a clean bag of it.
            BagError: The disk failed; as above.
        """
        self._closed = True
        if self._broken:
            self._disk.close()
            raise BagError(
                f"the bag {self.path} has no index, as the disk failed; every message up "
                f"to then is whole: make a clean bag elsewhere with "
                f"`mother_rover bag recover {self.path} <new bag>`"
            )
        try:
            self._write_chunk()
            metadata = self._metadata(custom or {})
            text = _yaml(metadata["rosbag2_bagfile_information"])
            self._writer.add_metadata("rosbag2", {"serialized_metadata": text})
            self._writer.finish()
            self._disk.flush()
            self._disk.force()
            self._write_metadata(_yaml(metadata))
        except OSError as error:
            raise self._explained(error, "the bag could not be closed") from error
        finally:
            self._disk.close()
        return self.summary

    def abandon(self) -> None:
        """Close the file without an index, as if the recorder were killed."""
        self._closed = True
        self._disk.close()

    def discard(self) -> None:
        """Close the file and remove the bag."""
        if not self._closed:
            self.abandon()
        shutil.rmtree(self.path, ignore_errors=True)

    @property
    def summary(self) -> BagSummary:
        """Summary of what has been written so far, without what a failed disk did not take."""
        counts: Counter[str] = Counter()
        for topic in self._topics.values():  # a topic of several types has several channels
            counts[topic.name] += topic.count
        return BagSummary(
            path=self.path,
            counts=dict(counts),
            first_ns=self._first_ns or 0,
            last_ns=self._last_ns,
            size=self._disk.committed,
        )

    def _check_room(self, path: Path) -> None:
        try:
            free = shutil.disk_usage(path).free
        except OSError as error:
            raise self._explained(error, "the recording ended:") from error
        if free < self._reserve:
            raise DiskFullError(
                f"{free / 2**20:.1f} MiB are free for the bag {self.path}, and "
                f"{self._reserve / 2**20:.1f} MiB are reserved to close it; free space or choose "
                "another disk"
            )

    def _explained(self, error: OSError, what: str) -> BagError:
        if isinstance(error, FileNotFoundError):
            reason = "its folder or file was moved or deleted, or its disk unmounted"
            return BagError(f"{what} {self.path}: {reason}")
        rescue = ""
        if self._is_whole_or_none:
            rescue = "; the unfinished bag is removed"
        elif self._topics:
            rescue = (
                "; every message written before is whole: make a valid bag of them with "
                f"`mother_rover bag recover {self.path} <new bag>`"
            )
        if error.errno in _FULL:
            return DiskFullError(f"{what} {self.path}: the disk is full ({error.strerror}){rescue}")
        return BagError(f"{what} {self.path}: {error.strerror}{rescue}")

    def _metadata(self, custom: Mapping[str, str]) -> dict[str, Any]:
        summary = self.summary
        span = {
            "starting_time": {"nanoseconds_since_epoch": summary.first_ns},
            "duration": {"nanoseconds": summary.last_ns - summary.first_ns},
            "message_count": summary.messages,
        }
        return {
            "rosbag2_bagfile_information": {
                "version": STORAGE_VERSION,
                "storage_identifier": "mcap",
                **span,
                "topics_with_message_count": [
                    {
                        "topic_metadata": {
                            "name": topic.name,
                            "type": topic.kind.name,
                            "serialization_format": topic.kind.serialization,
                            "offered_qos_profiles": dump_qos_v9(list(topic.qos)),
                            "type_description_hash": topic.kind.type_hash,
                        },
                        "message_count": topic.count,
                    }
                    for topic in self._topics.values()
                ],
                "compression_format": "",
                "compression_mode": "",
                "relative_file_paths": [self.file.name],
                "files": [{"path": self.file.name, **span}],
                "custom_data": dict(custom),
                "ros_distro": ROS_DISTRO,
            }
        }

    def _write_metadata(self, text: str) -> None:
        part = self.path / "metadata.yaml.part"
        with part.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(self.path / "metadata.yaml")
        _sync_folder(self.path)


def _yaml(value: object) -> str:
    text = yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False)
    return str(text)


class _PlainDumper(yaml.SafeDumper):
    """Writes equal mappings in full: yaml-cpp based readers do not expect aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        del data
        return True
