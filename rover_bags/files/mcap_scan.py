"""Walks an MCAP file of a bag, whole or broken, and vouches for what it yields.

Readers that trust a bag's index cannot open one whose recorder was killed, and some return
wrong data where a bit has flipped. This one reads the data section itself: every chunk is
checked against its checksum and size, a damaged stretch is named and skipped, and the walk goes
on at the next chunk that proves itself by its checksum. Messages that no checksum protects
(other recorders leave them out) are yielded and counted as unverified.

Format: https://mcap.dev/spec
"""

import contextlib
import mmap
import struct
import zlib
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

from rover_bags.files.folder import ScanError
from rover_bags.files.records import Damage, Message, Topic
from rover_bags.files.store import CHANNEL_RECORD, CHECKSUM_KEY, unsealed

MAGIC: Final = b"\x89MCAP0\r\n"
_FRAME: Final = struct.Struct("<BQ")
_CHUNK: Final = struct.Struct("<QQQII")
_MESSAGE: Final = struct.Struct("<HIQQ")
_FOOTER: Final = struct.Struct("<QQI")
_FOOTER_LENGTH: Final = _FRAME.size + _FOOTER.size
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
"""Kinds of records that may stand before the index at the end."""
_LARGEST_CHUNK: Final = 1 << 30
"""A chunk that claims to be larger [byte] when unpacked is taken for damaged."""

_RELEASED: Final = 1 << 25
"""After so many bytes of the file those behind are let go."""
_PAGE: Final = mmap.PAGESIZE


@dataclass(frozen=True)
class _Chunk:
    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    packed: memoryview


class _Broken(Exception):
    """A record that is not what it should be."""


class McapScan:
    """One pass over one MCAP file.

    Iterate over it for the messages; the attributes are complete when the iteration is.

    Attributes:
        path: The file.
        closed: Whether the recorder closed it (index and footer are there).
        damage: What was left out.
        unverified: Messages by topic that were yielded though no checksum protects them.
        announced: Every topic that the file describes.
        metadata: Metadata records by name, in their order.
        done: Bytes that have been read.
        foreign: Attachments, which carry no messages and are not read.
        expected: Messages by topic as the index at the end counts them; None without one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.closed = False
        self.damage: list[Damage] = []
        self.unverified: Counter[str] = Counter()
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.foreign = 0
        self.expected: dict[str, int] | None = None
        self.done = 0
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}
        self._topics: dict[int, Topic] = {}
        self._spare: dict[int, Topic] = {}
        self._orphans: Counter[int] = Counter()
        self._in_chunks: bool | None = None

    @property
    def announced(self) -> list[Topic]:
        """Every topic that the file describes."""
        return list({**self._spare, **self._topics}.values())

    def __iter__(self) -> Iterator[Message]:
        try:
            stream = self.path.open("rb")
        except OSError as error:
            raise ScanError(f"cannot read {self.path}: {error.strerror}") from error
        with stream:
            size = self.path.stat().st_size
            if size == 0:
                raise ScanError(f"{self.path} is empty: nothing was recorded in it")
            mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
            view = memoryview(mapped)
            try:
                yield from self._walk(view, mapped)
            finally:
                view.release()
                with contextlib.suppress(BufferError):
                    mapped.close()

    # --- the walk over the file ------------------------------------------------------------------

    def _walk(self, view: memoryview, mapped: mmap.mmap) -> Iterator[Message]:
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
                self._leave_out(position, following - position, self._cut_reason(view, position))
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
            self._leave_out(end, 0, "the record that ends the data is missing")
        self._count_orphans()

    def _first_chunk(self, view: memoryview, mapped: mmap.mmap) -> int:
        found = self._search(view, mapped, 0)
        if found is None:
            raise ScanError(
                f"{self.path} is not an MCAP file: it neither begins as one nor holds a sound chunk"
            )
        self._leave_out(0, found, "the file's beginning is damaged")
        return found

    def _frame(
        self, view: memoryview, mapped: mmap.mmap, position: int
    ) -> tuple[int, Opcode | None]:
        """End and kind of the record at a position; kind None where it is damaged or cut."""
        if position + _FRAME.size <= len(view):
            number, length = _FRAME.unpack_from(view, position)
            start = position + _FRAME.size
            if start + length <= len(view) and number in _IN_DATA:
                opcode = Opcode(number)
                if self._adds_up(view, mapped, opcode, start, start + length):
                    return start + length, opcode
        found = self._search(view, mapped, position + 1)
        return (len(view) if found is None else found), None

    def _adds_up(
        self, view: memoryview, mapped: mmap.mmap, opcode: Opcode, start: int, end: int
    ) -> bool:
        """Whether a record's length can be believed, so that nothing behind it is jumped over.

        Chunks prove themselves later; the others carry no checksum of their own.
        """
        body = view[start:end]
        if opcode == Opcode.MESSAGE_INDEX:
            return len(body) >= 6 and len(body) == 6 + struct.unpack_from("<I", body, 2)[0]
        if opcode == Opcode.DATA_END:
            return len(body) == 4 and self._search(view, mapped, end) is None
        if opcode == Opcode.CHUNK:
            return end == len(view) or view[end] in _IN_DATA
        if opcode == Opcode.MESSAGE:
            return not self._has_sound_chunk(view, mapped)
        if opcode == Opcode.ATTACHMENT:
            return len(body) > 4 and zlib.crc32(body[:-4]) == struct.unpack("<I", body[-4:])[0]
        kind = {
            Opcode.HEADER: Header,
            Opcode.SCHEMA: Schema,
            Opcode.CHANNEL: Channel,
            Opcode.METADATA: Metadata,
        }[opcode]
        try:
            _parse(kind, body)
        except _Broken:
            return False
        return True

    def _has_sound_chunk(self, view: memoryview, mapped: mmap.mmap) -> bool:
        """Whether the file keeps its messages in chunks, so that bare ones cannot be genuine."""
        if self._in_chunks is None:
            self._in_chunks = self._search(view, mapped, 0) is not None
        return self._in_chunks

    def _cut_reason(self, view: memoryview, position: int) -> str:
        left = len(view) - position
        if left < _FRAME.size:
            return f"the file ends inside a record's header ({left} bytes of it are there)"
        opcode, length = _FRAME.unpack_from(view, position)
        if opcode in _IN_DATA and length + _FRAME.size > left:
            return (
                f"the file ends inside a record: {length + _FRAME.size} bytes announced, "
                f"{left} are there"
            )
        return "no record can be made out"

    def _search(self, view: memoryview, mapped: mmap.mmap, start: int) -> int | None:
        """Next position of a chunk that its checksum proves sound."""
        lead = bytes([Opcode.CHUNK])
        position = mapped.find(lead, start)
        while position != -1:
            if position + _FRAME.size <= len(view):
                length = _FRAME.unpack_from(view, position)[1]
                following = position + _FRAME.size + length
                if _CHUNK.size < length < _LARGEST_CHUNK and following <= len(view):
                    try:
                        chunk = _parse_chunk(view[position + _FRAME.size : following])
                        if chunk.crc:
                            _unpack(chunk)
                            return position
                    except _Broken:
                        pass
            position = mapped.find(lead, position + 1)
        return None

    def _record(
        self, view: memoryview, opcode: Opcode, body: memoryview, position: int, following: int
    ) -> Iterator[Message]:
        span = None
        try:
            if opcode == Opcode.CHUNK:
                chunk = _parse_chunk(body)
                span = (chunk.start_ns, chunk.end_ns)
                contents = _unpack(chunk)
                yield from self._messages(contents, verified=chunk.crc != 0)
            elif opcode in {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}:
                yield from self._messages(view[position:following], verified=False)
            elif opcode == Opcode.METADATA:
                self._keep_metadata(_parse(Metadata, body))
            elif opcode == Opcode.ATTACHMENT:
                self.foreign += 1
        except _Broken as error:
            counts = self._indexed(view, following) if opcode == Opcode.CHUNK else {}
            name = opcode.name.lower().replace("_", " ")
            self._leave_out(position, following - position, f"{name}: {error}", counts, span)

    def _messages(self, records: memoryview | bytes, *, verified: bool) -> Iterator[Message]:
        """Messages of a sequence of records, which the caller has checked where it can.

        Where no checksum vouches for the records, they are first walked through whole, so that
        nothing of a sequence that does not add up is yielded.
        """
        frames = list(_frames(records))
        parsed = [
            (opcode, _parse(Schema if opcode == Opcode.SCHEMA else Channel, records[start:stop]))
            for opcode, start, stop in frames
            if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}
        ]
        for opcode, record in parsed:
            known = self._schemas if opcode == Opcode.SCHEMA else self._channels
            if not verified and known.setdefault(record.id, record) != record:
                raise _Broken("it contradicts what was announced before")
            known[record.id] = record
            if opcode == Opcode.CHANNEL:
                self._topics[record.id] = self._described(record)
        for opcode, start, stop in frames:
            if opcode != Opcode.MESSAGE:
                continue
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(records, start)
            topic = self._topics.get(channel) or self._spare.get(channel)
            if topic is None:
                self._orphans[channel] += 1
                continue
            if not verified:
                self.unverified[topic.name] += 1
            data = bytes(records[start + _MESSAGE.size : stop])
            yield Message(topic, log_ns, publish_ns, sequence, data)

    def _described(self, channel: Any) -> Topic:
        """A channel's topic; its type from elsewhere where that was announced in a lost chunk."""
        topic = _topic(channel, self._schemas)
        spare = self._spare.get(channel.id)
        lost = channel.schema_id != 0 and channel.schema_id not in self._schemas
        return spare if lost and spare is not None and spare.name == topic.name else topic

    # --- what stands around the data -------------------------------------------------------------

    def _keep_metadata(self, record: Metadata) -> None:
        values: dict[str, str] = record.metadata
        if CHECKSUM_KEY in values:
            checked = unsealed(values)
            if checked is None:
                raise _Broken(f"the record {record.name!r} does not fit its checksum")
            values = checked
            if record.name == CHANNEL_RECORD:
                self._spare[int(values["id"])] = Topic(
                    name=values["topic"],
                    type=values["type"],
                    encoding="cdr",
                    schema=values["schema"],
                    schema_encoding=values["encoding"],
                    qos=values["offered_qos_profiles"],
                    type_hash=values["topic_type_hash"],
                )
                return
        self.metadata.append((record.name, values))

    def _read_summary(self, view: memoryview) -> None:
        """Reads the index at the file's end where there is a sound one."""
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
                self._leave_out(start, _FOOTER_LENGTH, "footer: points outside the file")
            return
        if crc and zlib.crc32(view[summary : len(view) - len(MAGIC) - 4]) != crc:
            self._leave_out(summary, start - summary, "index: does not fit its checksum")
            return
        try:
            self._take_summary(view[summary:start])
        except _Broken as error:
            self._leave_out(summary, start - summary, f"index: {error}")

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
        self._spare.update({number: _topic(item, schemas) for number, item in channels.items()})
        if statistics is not None:
            counts: Counter[str] = Counter()
            for number, count in statistics.channel_message_counts.items():
                topic = self._spare.get(number)
                counts[topic.name if topic else f"channel {number}"] += count
            self.expected = dict(counts)

    def _check_data(self, body: memoryview, checksum: int) -> None:
        expected = struct.unpack("<I", body)[0]
        if expected and expected != checksum and not self.damage:
            self._leave_out(
                0, 0, "the data as a whole do not fit their checksum, though every chunk does"
            )

    def _indexed(self, view: memoryview, position: int) -> dict[str, int]:
        """Messages by topic as the index records behind a damaged chunk count them."""
        counts: Counter[str] = Counter()
        while position + _FRAME.size <= len(view):
            opcode, length = _FRAME.unpack_from(view, position)
            following = position + _FRAME.size + length
            if opcode != Opcode.MESSAGE_INDEX or following > len(view) or length < 6:
                break
            channel, size = struct.unpack_from("<HI", view, position + _FRAME.size)
            topic = self._topics.get(channel) or self._spare.get(channel)
            counts[topic.name if topic else f"channel {channel}"] += size // 16
            position = following
        return dict(counts)

    def _count_orphans(self) -> None:
        if self._orphans:
            counts = {f"channel {number}": count for number, count in self._orphans.items()}
            self._leave_out(0, 0, "messages of topics whose description is not in the file", counts)

    def _leave_out(
        self,
        offset: int,
        length: int,
        reason: str,
        counts: dict[str, int] | None = None,
        span_ns: tuple[int, int] | None = None,
    ) -> None:
        self.damage.append(Damage(self.path.name, offset, length, reason, counts or {}, span_ns))


def _topic(channel: Any, schemas: dict[int, Any]) -> Topic:
    schema = schemas.get(channel.schema_id)
    return Topic(
        name=channel.topic,
        type=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema=schema.data.decode("utf-8", "replace") if schema else "",
        schema_encoding=schema.encoding if schema else "",
        qos=channel.metadata.get("offered_qos_profiles", ""),
        type_hash=channel.metadata.get("topic_type_hash", ""),
    )


def _frames(records: memoryview | bytes) -> Iterator[tuple[int, int, int]]:
    """Kind, start and end of the contents of each record in a sequence that must add up."""
    position, end = 0, len(records)
    while position < end:
        if position + _FRAME.size > end:
            raise _Broken("its records do not add up")
        opcode, length = _FRAME.unpack_from(records, position)
        start = position + _FRAME.size
        position = start + length
        if position > end or (opcode == Opcode.MESSAGE and length < _MESSAGE.size):
            raise _Broken("its records do not add up")
        yield opcode, start, position


def _parse_chunk(body: memoryview) -> _Chunk:
    try:
        start_ns, end_ns, size, crc, name_length = _CHUNK.unpack_from(body)
        position = _CHUNK.size
        if name_length > 8:
            raise _Broken("its compression has no name that is known")
        name = bytes(body[position : position + name_length]).decode("ascii")
        position += name_length
        (packed,) = struct.unpack_from("<Q", body, position)
    except (struct.error, UnicodeDecodeError) as error:
        raise _Broken("its header cannot be read") from error
    if position + 8 + packed != len(body) or size > _LARGEST_CHUNK:
        raise _Broken("its lengths do not add up")
    return _Chunk(start_ns, end_ns, size, crc, name, body[position + 8 :])


def _unpack(chunk: _Chunk) -> bytes:
    """Contents of a chunk; raises where size or checksum do not fit."""
    try:
        if chunk.compression == "zstd":
            contents = zstandard.ZstdDecompressor().decompress(
                chunk.packed, max_output_size=chunk.size
            )
        elif chunk.compression == "lz4":
            contents = bytes(lz4.frame.decompress(chunk.packed))
        elif not chunk.compression:
            contents = bytes(chunk.packed)
        else:
            raise _Broken(f"its compression {chunk.compression!r} is not known")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise _Broken("it cannot be unpacked") from error
    if len(contents) != chunk.size:
        raise _Broken(f"{chunk.size} bytes announced, {len(contents)} are there")
    if chunk.crc and zlib.crc32(contents) != chunk.crc:
        raise _Broken("it does not fit its checksum")
    return contents


def _parse(kind: Any, body: memoryview | bytes) -> Any:
    """One record of the mcap library's; raises where it cannot be read."""
    stream = BytesIO(body)
    try:
        record = kind.read(ReadDataStream(stream))
    except (McapError, struct.error, UnicodeDecodeError, ValueError, MemoryError) as error:
        raise _Broken("it cannot be read") from error
    if stream.tell() != len(body):
        raise _Broken("its length does not fit its contents")
    return record
