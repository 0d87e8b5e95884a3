"""Scan an MCAP file, intact or damaged, and verify its checksums.

Readers that rely on a bag's index cannot open one whose recorder was killed, and some return wrong
data after a bit flip. This scan reads the data section itself: it checks every chunk against its
checksum and size, reports and skips a damaged part, and continues at the next chunk with a valid
checksum. Messages without a checksum (other recorders omit them) are yielded and counted as
unverified.

Format: https://mcap.dev/spec
"""

import contextlib
import mmap
import os
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema, Statistics

from msg_schemas.regular_files import open_regular
from rover_bags.files.decompression import unpack_zstd
from rover_bags.files.file_scan import FileScan
from rover_bags.files.folder import ScanError
from rover_bags.files.records import ALL_TIMES, CDR, Damage, DeclaredTopic, RecordedMessage
from rover_bags.files.store import CHANNEL_RECORD, CHECKSUM_KEY, verified_contents

MAGIC: Final = b"\x89MCAP0\r\n"
_FRAME: Final = struct.Struct("<BQ")
_CHUNK: Final = struct.Struct("<QQQII")
_MESSAGE: Final = struct.Struct("<HIQQ")
_FOOTER: Final = struct.Struct("<QQI")
_FOOTER_LENGTH: Final = _FRAME.size + _FOOTER.size
_KNOWN: Final = frozenset(Opcode)
_IN_DATA: Final = frozenset(
    {
        int(Opcode.HEADER),
        int(Opcode.SCHEMA),
        int(Opcode.CHANNEL),
        int(Opcode.MESSAGE),
        int(Opcode.CHUNK),
        int(Opcode.MESSAGE_INDEX),
        int(Opcode.ATTACHMENT),
        int(Opcode.METADATA),
        int(Opcode.DATA_END),
    }
)
"""Record types of the data section."""
_LARGEST_CHUNK: Final = 1 << 28
"""Largest uncompressed size of a chunk that is read [byte]."""
_SEARCHED: Final = 8
"""Bytes of supposed chunks that the search for valid ones examines, for each byte of the file."""
_SEARCHED_AT_LEAST: Final = 1 << 26

_RELEASED: Final = 1 << 25
"""Number of bytes after which mapped pages are released."""
_PAGE: Final = mmap.PAGESIZE


@dataclass(frozen=True)
class _Chunk:
    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    packed: memoryview


class _InvalidRecord(Exception):
    """A record that is damaged or inconsistent."""


class McapScan(FileScan):
    """One pass over one MCAP file.

    Args:
        path: The file.
        within: First and last log time [ns since 1970] of the messages that are yielded.
    """

    def __init__(self, path: Path, within: tuple[int, int] = ALL_TIMES) -> None:
        super().__init__(path)
        self.closed = False
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}
        self._fallback_topics: dict[int, DeclaredTopic] = {}
        self._undeclared: Counter[int] = Counter()
        self._within = within
        self._in_chunks: bool | None = None
        self._examinable = 0  # bytes of supposed chunks that may still be examined

    @property
    def declared_topics(self) -> list[DeclaredTopic]:
        """Every topic declared in the file."""
        return list({**self._fallback_topics, **self._topics}.values())

    def __iter__(self) -> Iterator[RecordedMessage]:
        try:
            stream = open_regular(self.path)
        except OSError as error:
            raise ScanError(f"cannot read {self.path}: {error.strerror}") from error
        with stream:
            size = os.fstat(stream.fileno()).st_size
            if size == 0:
                raise ScanError(f"{self.path} is empty: nothing was recorded in it")
            self._examinable = _SEARCHED * size + _SEARCHED_AT_LEAST
            mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
            view = memoryview(mapped)
            try:
                yield from self._scan_data(view, mapped)
            finally:
                view.release()
                with contextlib.suppress(BufferError):
                    mapped.close()

    # --- scan of the file ------------------------------------------------------------------------

    def _scan_data(self, view: memoryview, mapped: mmap.mmap) -> Iterator[RecordedMessage]:
        end = len(view)
        position = len(MAGIC)
        if bytes(view[:position]) != MAGIC:
            position = self._first_chunk(view, mapped)
        self._read_summary(view)
        checksum = zlib.crc32(view[:position])
        released = 0
        while position < end:
            following, opcode = self._frame(view, mapped, position)
            body = view[position + _FRAME.size : following]
            if opcode == Opcode.DATA_END:
                self._check_data(body, checksum)
                break
            if opcode is None:
                self._skip(position, following - position, self._cut_reason(view, position))
            else:
                yield from self._record(view, opcode, body, position, following)
            checksum = zlib.crc32(view[position:following], checksum)
            position = following
            self.done = position
            if position - released > _RELEASED:
                # What was read need not stay in memory: a bag may be larger than that.
                mapped.madvise(mmap.MADV_DONTNEED, released, position // _PAGE * _PAGE - released)
                released = position // _PAGE * _PAGE
        if position >= end and self.closed:
            self._skip(end, 0, "the record that ends the data is missing")
        self._report_undeclared()

    def _first_chunk(self, view: memoryview, mapped: mmap.mmap) -> int:
        found = self._search(view, mapped, 0)
        if found is None:
            raise ScanError(
                f"{self.path} is not an MCAP file: it neither begins as one nor holds a sound chunk"
            )
        self._skip(0, found, "the file's beginning is damaged")
        return found

    def _frame(
        self, view: memoryview, mapped: mmap.mmap, position: int
    ) -> tuple[int, Opcode | None]:
        """End and type of the record at a position; type None if it is damaged or cut."""
        if position + _FRAME.size <= len(view):
            number, length = _FRAME.unpack_from(view, position)
            start = position + _FRAME.size
            if start + length <= len(view) and number in _IN_DATA:
                opcode = Opcode(number)
                if self._is_plausible(view, mapped, opcode, start, start + length):
                    return start + length, opcode
        found = self._search(view, mapped, position + 1)
        return (len(view) if found is None else found), None

    def _is_plausible(
        self, view: memoryview, mapped: mmap.mmap, opcode: Opcode, start: int, end: int
    ) -> bool:
        """Whether a record's length is plausible, so that no valid record is skipped.

        Chunks are checked by their checksum later; other records have none.
        """
        body = view[start:end]
        if opcode == Opcode.MESSAGE_INDEX:
            stop = 6 + struct.unpack_from("<I", body, 2)[0] if len(body) >= 6 else len(body) + 1
            return stop <= len(body) and not _begins_with_record(body[stop:])
        if opcode == Opcode.DATA_END:
            return len(body) == 4 and self._search(view, mapped, end) is None
        if opcode == Opcode.CHUNK:
            return end == len(view) or view[end] in _IN_DATA
        if opcode == Opcode.MESSAGE:
            return not self._has_valid_chunk(view, mapped)
        if opcode == Opcode.ATTACHMENT:
            return _is_sound_attachment(body)
        kind = {
            Opcode.HEADER: Header,
            Opcode.SCHEMA: Schema,
            Opcode.CHANNEL: Channel,
            Opcode.METADATA: Metadata,
        }[opcode]
        try:
            _parse(kind, body)
        except _InvalidRecord:
            return False
        return True

    def _has_valid_chunk(self, view: memoryview, mapped: mmap.mmap) -> bool:
        """Whether the file stores messages in chunks, so that bare messages are invalid."""
        if self._in_chunks is None:
            self._in_chunks = self._search(view, mapped, 0) is not None
        return self._in_chunks

    def _cut_reason(self, view: memoryview, position: int) -> str:
        left = len(view) - position
        if left < _FRAME.size:
            return f"the file ends inside a record's header ({left} bytes of it are present)"
        opcode, length = _FRAME.unpack_from(view, position)
        if opcode in _IN_DATA and length + _FRAME.size > left:
            return (
                f"the file ends inside a record: {length + _FRAME.size} bytes declared, "
                f"{left} present"
            )
        return "no valid record"

    def _search(self, view: memoryview, mapped: mmap.mmap, start: int) -> int | None:
        """Position of the next chunk with a valid checksum.

        The bytes that all searches examine are limited: false chunks may lie in one another, and
        time would grow with the square of the file's length.
        """
        lead = bytes([Opcode.CHUNK])
        position = mapped.find(lead, start)
        while position != -1 and self._examinable > 0:
            if position + _FRAME.size <= len(view):
                length = _FRAME.unpack_from(view, position)[1]
                following = position + _FRAME.size + length
                if _CHUNK.size < length < _LARGEST_CHUNK and following <= len(view):
                    try:
                        chunk = _parse_chunk(view[position + _FRAME.size : following])
                        if chunk.crc:
                            self._examinable -= length
                            _decompress(chunk)
                            return position
                    except _InvalidRecord:
                        pass
            position = mapped.find(lead, position + 1)
        return None

    def _record(
        self, view: memoryview, opcode: Opcode, body: memoryview, position: int, following: int
    ) -> Iterator[RecordedMessage]:
        span = None
        try:
            if opcode == Opcode.CHUNK:
                chunk = _parse_chunk(body)
                span = (chunk.start_ns, chunk.end_ns)
                if self._concerns(span):
                    contents = _decompress(chunk)
                    yield from self._messages(contents, verified=chunk.crc != 0)
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}:
                yield from self._messages(view[position:following], verified=False)
            elif opcode == Opcode.METADATA:
                self._keep_metadata(_parse(Metadata, body))
            elif opcode == Opcode.ATTACHMENT:
                self.attachments += 1
        except _InvalidRecord as error:
            counts = self._indexed(view, following) if opcode == Opcode.CHUNK else {}
            name = opcode.name.lower().replace("_", " ")
            self._skip(position, following - position, f"{name}: {error}", counts, span)

    def _concerns(self, span: tuple[int, int]) -> bool:
        """Whether a chunk of this span may hold messages to read, or declare their topics."""
        first_ns, last_ns = self._within
        is_indexed = bool(self._fallback_topics)
        return not is_indexed or (span[0] <= last_ns and span[1] >= first_ns)

    def _messages(
        self, records: memoryview | bytes, *, verified: bool
    ) -> Iterator[RecordedMessage]:
        """Messages of a sequence of records.

        All records are parsed before the first message is yielded: nothing of an inconsistent
        sequence is returned.
        """
        bounds = array("Q")  # start and end of each message
        declared: tuple[dict[int, Any], dict[int, Any]] = {}, {}
        for opcode, start, stop in _frames(records):
            if opcode == Opcode.MESSAGE:
                bounds.extend((start, stop))
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                is_channel = opcode == Opcode.CHANNEL
                record = _parse(Channel if is_channel else Schema, records[start:stop])
                known = self._channels if is_channel else self._schemas
                new = declared[is_channel]
                if not verified and new.get(record.id, known.get(record.id, record)) != record:
                    raise _InvalidRecord("it contradicts an earlier declaration")
                new[record.id] = record
        schemas, channels = declared
        self._schemas |= schemas
        self._channels |= channels
        for number, record in channels.items():
            self._topics[number] = self._described(record)
        first_ns, last_ns = self._within
        for start, stop in zip(*[iter(bounds)] * 2, strict=True):
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(records, start)
            if not first_ns <= log_ns <= last_ns:
                continue
            topic = self._topics.get(channel) or self._fallback_topics.get(channel)
            if topic is None:
                self._undeclared[channel] += 1
                continue
            if not verified:
                self.unverified[topic.name] += 1
            data = bytes(records[start + _MESSAGE.size : stop])
            yield RecordedMessage(topic, log_ns, publish_ns, sequence, data)

    def _described(self, channel: Any) -> DeclaredTopic:
        """A channel's topic; if its schema was in a lost chunk, from a copy of the declaration."""
        topic = _topic(channel, self._schemas)
        spare = self._fallback_topics.get(channel.id)
        lost = channel.schema_id != 0 and channel.schema_id not in self._schemas
        return spare if lost and spare is not None and spare.name == topic.name else topic

    # --- metadata and index ---------------------------------------------------------------------

    def _keep_metadata(self, record: Metadata) -> None:
        values: dict[str, str] = record.metadata
        if CHECKSUM_KEY in values:
            checked = verified_contents(values)
            if checked is None:
                raise _InvalidRecord(f"the checksum of the record {record.name!r} is wrong")
            values = checked
            if record.name == CHANNEL_RECORD:
                try:
                    self._fallback_topics[int(values["id"])] = DeclaredTopic(
                        name=values["topic"],
                        type=values["type"],
                        encoding=values.get("serialization", CDR),
                        schema=values["schema"],
                        schema_encoding=values["encoding"],
                        qos=values["offered_qos_profiles"],
                        type_hash=values["topic_type_hash"],
                    )
                except (KeyError, ValueError) as error:
                    raise _InvalidRecord(f"it describes no channel: {error}") from error
                return
        self.metadata.append((record.name, values))

    def _read_summary(self, view: memoryview) -> None:
        """Read the index at the file's end if there is a valid one."""
        start = len(view) - len(MAGIC) - _FOOTER_LENGTH
        if start < len(MAGIC) or bytes(view[-len(MAGIC) :]) != MAGIC:
            return
        opcode, length = _FRAME.unpack_from(view, start)
        if opcode != Opcode.FOOTER or length != _FOOTER.size:
            return
        self.closed = True
        summary, _, crc = _FOOTER.unpack_from(view, start + _FRAME.size)
        if not len(MAGIC) <= summary <= start:
            if summary:
                self._skip(start, _FOOTER_LENGTH, "footer: points outside the file")
            return
        if crc and zlib.crc32(view[summary : len(view) - len(MAGIC) - 4]) != crc:
            self._skip(summary, start - summary, "index: wrong checksum")
            return
        try:
            self._take_summary(view[summary:start])
        except _InvalidRecord as error:
            self._skip(summary, start - summary, f"index: {error}")

    def _take_summary(self, records: memoryview) -> None:
        statistics: Statistics | None = None
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for opcode, start, stop in _frames(records):
            body = records[start:stop]
            if opcode == Opcode.SCHEMA:
                schema = _parse(Schema, body)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = _parse(Channel, body)
                channels[channel.id] = channel
            elif opcode == Opcode.STATISTICS:
                statistics = _parse(Statistics, body)
        self._fallback_topics.update(
            {number: _topic(item, schemas) for number, item in channels.items()}
        )
        if statistics is not None:
            counts: Counter[str] = Counter()
            for number, count in statistics.channel_message_counts.items():
                topic = self._fallback_topics.get(number)
                counts[topic.name if topic else f"channel {number}"] += count
            self.expected = dict(counts)

    def _check_data(self, body: memoryview, checksum: int) -> None:
        expected = struct.unpack("<I", body)[0]
        has_read_all = self._within == ALL_TIMES
        if has_read_all and expected and expected != checksum and not self.damage:
            self._skip(
                0, 0, "the checksum of the data section is wrong, though all chunks are valid"
            )

    def _indexed(self, view: memoryview, position: int) -> dict[str, int]:
        """Messages by topic as counted by the index records behind a damaged chunk."""
        counts: Counter[str] = Counter()
        while position + _FRAME.size <= len(view):
            opcode, length = _FRAME.unpack_from(view, position)
            following = position + _FRAME.size + length
            if opcode != Opcode.MESSAGE_INDEX or following > len(view) or length < 6:
                break
            channel, size = struct.unpack_from("<HI", view, position + _FRAME.size)
            topic = self._topics.get(channel) or self._fallback_topics.get(channel)
            counts[topic.name if topic else f"channel {channel}"] += size // 16
            position = following
        return dict(counts)

    def _report_undeclared(self) -> None:
        if self._undeclared:
            counts = {f"channel {number}": count for number, count in self._undeclared.items()}
            self._skip(0, 0, "messages of topics that are not declared in the file", counts)

    def _skip(
        self,
        offset: int,
        length: int,
        reason: str,
        counts: dict[str, int] | None = None,
        span_ns: tuple[int, int] | None = None,
    ) -> None:
        self.damage.append(Damage(self.path.name, offset, length, reason, counts or {}, span_ns))


def _topic(channel: Any, schemas: dict[int, Any]) -> DeclaredTopic:
    schema = schemas.get(channel.schema_id)
    return DeclaredTopic(
        name=channel.topic,
        type=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema=schema.data.decode("utf-8", "replace") if schema else "",
        schema_encoding=schema.encoding if schema else "",
        qos=channel.metadata.get("offered_qos_profiles", ""),
        type_hash=channel.metadata.get("topic_type_hash", ""),
    )


def _frames(records: memoryview | bytes) -> Iterator[tuple[int, int, int]]:
    """Type, start and end of the contents of each record of a consistent sequence."""
    position, end = 0, len(records)
    while position < end:
        if position + _FRAME.size > end:
            raise _InvalidRecord("the lengths of its records are inconsistent")
        opcode, length = _FRAME.unpack_from(records, position)
        start = position + _FRAME.size
        position = start + length
        is_short = opcode == Opcode.MESSAGE and length < _MESSAGE.size
        if position > end or is_short or not opcode:
            raise _InvalidRecord("the lengths of its records are inconsistent")
        yield opcode, start, position


def _parse_chunk(body: memoryview) -> _Chunk:
    try:
        start_ns, end_ns, size, crc, name_length = _CHUNK.unpack_from(body)
        position = _CHUNK.size
        if name_length > 8:
            raise _InvalidRecord("its compression is unknown")
        name = bytes(body[position : position + name_length]).decode("ascii")
        position += name_length
        (packed,) = struct.unpack_from("<Q", body, position)
    except (struct.error, UnicodeDecodeError) as error:
        raise _InvalidRecord("its header cannot be read") from error
    if position + 8 + packed != len(body) or size > _LARGEST_CHUNK:
        raise _InvalidRecord("its lengths are inconsistent")
    return _Chunk(start_ns, end_ns, size, crc, name, body[position + 8 :])


def _decompress(chunk: _Chunk) -> bytes:
    """Contents of a chunk, no more than announced; raises if size or checksum is wrong."""
    try:
        if chunk.compression == "zstd":
            contents = unpack_zstd(chunk.packed, chunk.size)
        elif chunk.compression == "lz4":
            unpacker = lz4.frame.LZ4FrameDecompressor()
            contents = unpacker.decompress(chunk.packed, max_length=chunk.size + 1)
            if not unpacker.eof:
                raise _InvalidRecord("it cannot be decompressed to its announced size")
        elif not chunk.compression:
            contents = bytes(chunk.packed)
        else:
            raise _InvalidRecord(f"its compression {chunk.compression!r} is unknown")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise _InvalidRecord("it cannot be decompressed") from error
    if len(contents) != chunk.size:
        raise _InvalidRecord(f"{chunk.size} bytes declared, {len(contents)} present")
    if chunk.crc and zlib.crc32(contents) != chunk.crc:
        raise _InvalidRecord("its checksum is wrong")
    return contents


def _parse(kind: Any, body: memoryview | bytes) -> Any:
    """Parse one record with the mcap library; raises if it is invalid."""
    stream = BytesIO(body)
    try:
        record = kind.read(ReadDataStream(stream))
    except (McapError, struct.error, UnicodeDecodeError, ValueError, MemoryError) as error:
        raise _InvalidRecord("it cannot be read") from error
    if _begins_with_record(body[stream.tell() :]):
        raise _InvalidRecord("its length does not match its contents")
    return record


def _begins_with_record(rest: memoryview | bytes) -> bool:
    """Whether what follows a record's fields is another record, so that its length is damaged.

    A later version of the format may append fields, which readers ignore.
    """
    if len(rest) < _FRAME.size:
        return False
    number, length = _FRAME.unpack_from(rest)
    return number in _KNOWN and length <= len(rest) - _FRAME.size


def _is_sound_attachment(body: memoryview) -> bool:
    """Whether an attachment's checksum fits; fields may follow it."""
    try:
        stop = 16
        for size in ("<I", "<I", "<Q"):  # name, media type, data
            stop += struct.calcsize(size) + struct.unpack_from(size, body, stop)[0]
        (checksum,) = struct.unpack_from("<I", body, stop)
    except (struct.error, OverflowError):
        return False
    return bool(zlib.crc32(body[:stop]) == checksum)
