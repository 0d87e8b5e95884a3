"""Bags made to fill memory or time: what is unpacked is bounded, and time grows with the length."""

from __future__ import annotations

import contextlib
import os
import struct
import subprocess
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from damage import damaged, little_time
from foreign_bags import KINDS, messages, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import Writer

from msg_schemas import topics
from msg_schemas.cdr import pack
from msg_schemas.samples import TextSample
from rover_bags.files.decompression import unpack_zstd
from rover_bags.files.folder import ScanError
from rover_bags.files.recover import recover
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagWriter, standard_type
from rover_bags.reading.read import read_bag

MAGIC = b"\x89MCAP0\r\n"
MEBIBYTE = 1 << 20
PHASE = f"/{topics.DESCENT_PHASE}"
BOMB = 512 * MEBIBYTE
ALLOWED = 300 * MEBIBYTE  # resident size of the process that reads, and of its libraries


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(compression: str, size: int, packed: bytes, crc: int = 1) -> bytes:
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 0, size, crc, len(name)) + name
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(packed)) + packed)


def zstd_zeros(size: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(MEBIBYTE)
    parts = [packer.compress(block) for _ in range(size // MEBIBYTE)]
    return b"".join((*parts, packer.flush()))


def lz4_zeros(size: int) -> bytes:
    packer = lz4.frame.LZ4FrameCompressor()
    block = bytes(MEBIBYTE)
    parts = [packer.begin(), *(packer.compress(block) for _ in range(size // MEBIBYTE))]
    packed: bytes = b"".join((*parts, packer.flush()))
    return packed


def declarations() -> bytes:
    builder = RecordBuilder()
    Schema(id=1, data=b"string data", encoding="ros2msg", name="std_msgs/msg/String").write(builder)
    channel = Channel(id=1, topic="/a", message_encoding="cdr", metadata={}, schema_id=1)
    channel.write(builder)
    made: bytes = builder.end()
    return made


def message(number: int) -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, number, number, number) + b"data")


def good_chunk() -> bytes:
    contents = declarations() + message(7)
    return chunk("", len(contents), contents, zlib.crc32(contents))


BOMBS: dict[str, Callable[[], bytes]] = {
    "zstd that announces 100 bytes": lambda: chunk("zstd", 100, zstd_zeros(BOMB)),
    "lz4 that announces 100 bytes": lambda: chunk("lz4", 100, lz4_zeros(BOMB)),
    "zstd that announces what it has": lambda: chunk("zstd", BOMB, zstd_zeros(BOMB)),
    "lz4 that announces what it has": lambda: chunk("lz4", BOMB, lz4_zeros(BOMB)),
    "empty records": lambda: chunk("zstd", 200 * MEBIBYTE, zstd_zeros(200 * MEBIBYTE), 0),
}


def read_in_a_process(path: Path) -> tuple[int, str]:
    """Largest resident size [byte] of a process that reads a bag, and what it prints."""
    script = (
        "import sys\n"
        "from pathlib import Path\n"
        "from rover_bags.files.scan import BagScan\n"
        "scan = BagScan(Path(sys.argv[1]))\n"
        "count = sum(1 for _ in scan)\n"
        "print(count, len(scan.damage))\n"
        # Of this program alone: getrusage counts what its parent held when it started it.
        "status = Path('/proc/self/status').read_text()\n"
        "print(int(status.partition('VmHWM:')[2].split()[0]) * 1024)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True
    )
    counts, size = done.stdout.splitlines()[-2:]
    return int(size), counts


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_chunk_unpacks_no_more_than_it_announces(tmp_path: Path, bomb: Callable[[], bytes]):
    path = tmp_path / "bag.mcap"
    path.write_bytes(MAGIC + bomb() + good_chunk())
    size, counts = read_in_a_process(path)
    assert counts == "1 1"  # the message behind the bomb, and the bomb as damage
    assert size < ALLOWED


def test_a_compressed_file_unpacks_no_more_than_a_multiple_of_its_size(tmp_path: Path):
    path = tmp_path / "bag_0.mcap.zstd"
    path.write_bytes(zstd_zeros(BOMB))
    with pytest.raises(ScanError, match="has contents more than 256 times as large as itself"):
        list(BagScan(path))


def test_a_cut_compressed_file_is_reported(tmp_path: Path):
    plain = MAGIC + good_chunk() * 200
    packed = zstandard.ZstdCompressor().compress(plain)
    path = tmp_path / "bag_0.mcap.zstd"
    path.write_bytes(packed[:-5])
    with pytest.raises(ScanError, match="is cut: its compressed data are incomplete"):
        list(BagScan(path))


@pytest.mark.parametrize("announced", [0, 10, 99])
def test_a_frame_that_announces_more_than_accepted_is_refused(announced: int):
    with pytest.raises(zstandard.ZstdError):
        unpack_zstd(zstandard.ZstdCompressor().compress(bytes(100)), announced)
    assert unpack_zstd(zstandard.ZstdCompressor().compress(bytes(100)), 100) == bytes(100)


def nested(count: int) -> bytes:
    """Headers of chunks that all last until the end of the file, none with the right checksum."""
    head = len(chunk("", 0, b""))
    end = count * head
    return b"".join(
        chunk("", end - (number + 1) * head, b"")[:-8].replace(
            struct.pack("<Q", head - 9), struct.pack("<Q", end - number * head - 9), 1
        )
        + struct.pack("<Q", end - (number + 1) * head)
        for number in range(count)
    )


def took(path: Path, content: bytes) -> float:
    path.write_bytes(content)
    started = time.process_time()
    with contextlib.suppress(ScanError):
        list(BagScan(path))
    return time.process_time() - started


@pytest.mark.parametrize(
    "content",
    [
        lambda count: b"X" + nested(count),
        lambda count: MAGIC + nested(count),
        lambda count: MAGIC + record(Opcode.DATA_END, bytes(4)) * (3 * count) + good_chunk(),
        lambda count: MAGIC + bytes([Opcode.CHUNK]) * (40 * count),
        lambda count: MAGIC + (record(Opcode.ATTACHMENT, bytes(40))) * count,
    ],
    ids=["nested, no magic", "nested", "ends", "chunk bytes", "attachments"],
)
def test_the_time_grows_with_the_length(tmp_path: Path, content: Callable[[int], bytes]):
    took(tmp_path / "first.mcap", content(10))
    short = took(tmp_path / "short.mcap", content(20_000))
    assert took(tmp_path / "long.mcap", content(80_000)) < 2.5 * 4 * short + 0.2


def test_a_valid_chunk_inside_a_false_one_is_found(tmp_path: Path):
    path = tmp_path / "bag.mcap"
    path.write_bytes(MAGIC + nested(50) + good_chunk())
    scan = BagScan(path)
    assert [each.data for each in scan] == [b"data"]
    assert scan.damage


@pytest.mark.parametrize("name", ["bag_0.mcap", "bag_0.db3", "bag_0.mcap.zstd", "bag_0.db3.zstd"])
def test_only_regular_files_are_opened(tmp_path: Path, name: str):
    for number, make in enumerate((os.mkfifo, lambda p: p.symlink_to("/dev/zero"), os.mkdir)):
        folder = tmp_path / str(number)
        folder.mkdir()
        make(folder / name)
        with pytest.raises(ScanError, match="it is no regular file"):
            list(BagScan(folder))


# --- a later version of the format ---------------------------------------------------------------


def extended(records: bytes) -> bytes:
    """Records with three bytes behind the fields of all but messages and chunks."""
    made, position = b"", 0
    while position < len(records):
        opcode, length = struct.unpack_from("<BQ", records, position)
        body = records[position + 9 : position + 9 + length]
        surplus = b"" if opcode in {Opcode.MESSAGE, Opcode.CHUNK} else b"\x01\xff\xff"
        made += record(opcode, body + surplus)
        position += 9 + length
    return made


@pytest.mark.parametrize("in_chunks", [True, False])
def test_fields_that_a_later_version_appends_are_ignored(tmp_path: Path, in_chunks: bool):
    builder = RecordBuilder()
    Header(profile="", library="").write(builder)
    Attachment(create_time=1, log_time=2, name="a.txt", media_type="text/plain", data=b"abc").write(
        builder
    )
    Metadata(name="run", metadata={"seed": "1"}).write(builder)
    messages = extended(declarations()) + message(7) + message(8)
    index = record(Opcode.MESSAGE_INDEX, struct.pack("<HIQQ", 1, 16, 7, 0))
    stored = chunk("", len(messages), messages, zlib.crc32(messages)) if in_chunks else messages
    front = extended(builder.end())
    data = MAGIC + front + stored + (extended(index) if in_chunks else b"")
    end = record(Opcode.DATA_END, struct.pack("<I", zlib.crc32(data)))
    path = tmp_path / "bag.mcap"
    path.write_bytes(data + end + record(Opcode.FOOTER, bytes(20)) + MAGIC)
    scan = BagScan(path)
    assert [each.sequence for each in scan] == [7, 8]
    assert not scan.damage
    assert [name for each in scan.files for name, _ in each.metadata] == ["run"]
    # A record that swallows the next one has a damaged length.
    (header,) = struct.unpack_from("<Q", front, 1)
    (attachment,) = struct.unpack_from("<Q", front, 9 + header + 1)
    longer = bytearray(data)
    longer[len(MAGIC) + 1] += 9 + attachment
    path.write_bytes(bytes(longer) + end)
    scan = BagScan(path)
    list(scan)
    assert scan.damage


# --- any damage ----------------------------------------------------------------------------------

NUMBER = 60  # of messages


def small_bag(folder: Path, compression: str) -> bytes:
    """A bag of a few chunks."""
    writer = BagWriter(folder / "bag", compression=compression, chunk_bytes=400, sync=False)
    topics = [writer.add_topic(name, standard_type("std_msgs/msg/String")) for name in ("/a", "/b")]
    for number in range(NUMBER):
        data = b"\0\1\0\0" + struct.pack("<I", 6) + b"%05d\0" % number
        writer.write(topics[number % 2], 1000 + number, 1000 + number, data)
    writer.close()
    (file,) = (folder / "bag").glob("*.mcap")
    return file.read_bytes()


def contents(path: Path) -> tuple[BagScan, set[tuple[object, ...]]]:
    scan = BagScan(path)
    return scan, {(m.topic.name, m.log_ns, m.sequence, m.data) for m in scan}


with TemporaryDirectory() as _folder:
    BAGS = {each: small_bag(Path(_folder) / each, each) for each in ("none", "zstd", "lz4")}
    (Path(_folder) / "whole.mcap").write_bytes(BAGS["none"])
    WHOLE = contents(Path(_folder) / "whole.mcap")[1]
    SQLITE = write(Path(_folder) / "sqlite", KINDS[0], messages(NUMBER)).read_bytes()


@pytest.mark.fuzz
@given(good=st.sampled_from([*BAGS.values()]), data=st.data())
@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_bag_gives_no_false_message_and_reports_what_it_lost(
    good: bytes, data: st.DataObject
):
    damage = data.draw(damaged(good))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag.mcap"
        path.write_bytes(damage)
        try:
            with little_time(2.0):
                scan, found = contents(path)
        except ScanError:
            return
    assert len(WHOLE) == NUMBER
    assert found <= WHOLE
    assert found == WHOLE or scan.damage or not scan.closed


@pytest.mark.fuzz
@given(data=st.data())
@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_sqlite_bag_is_read_or_refused_and_no_message_is_called_verified(
    data: st.DataObject,
):
    damage = data.draw(damaged(SQLITE))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(damage)
        unverified, counts = Counter[str](), Counter[str]()
        with contextlib.suppress(ScanError), little_time(2.0):
            scan = BagScan(path)
            counts = Counter(each.topic.name for each in scan)
            unverified = scan.unverified
        assert list(Path(folder).iterdir()) == [path]
        assert path.read_bytes() == damage
    assert counts == unverified


def test_an_undamaged_sqlite_bag_gives_all_its_messages(tmp_path: Path):
    path = tmp_path / "bag.db3"
    path.write_bytes(SQLITE)
    assert len(contents(path)[1]) == NUMBER


# --- what a bag declares of its messages ---------------------------------------------------------


def foreign(
    folder: Path, count: int, types: Sequence[str] = ("std_msgs/msg/String",),
    serialization: str = "cdr", first_ns: int = 10**18,
) -> Path:  # fmt: skip
    """A bag of words on ``descent/phase``, in turns of several types."""
    folder.mkdir()
    data = pack(topics.DESCENT_PHASE, TextSample("holding"))
    with (folder / "bag_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        channels = [
            writer.register_channel(
                PHASE, serialization,
                writer.register_schema(name, "ros2msg", standard_type(name).schema),
            )
            for name in types
        ]  # fmt: skip
        for number in range(count):
            time_ns = first_ns + number
            writer.add_message(channels[number % len(types)], time_ns, data, time_ns, number)
        writer.finish()
    return folder


def test_messages_of_a_topic_of_several_types_are_all_counted_as_recovered(tmp_path: Path):
    source = foreign(tmp_path / "bag", 9, ("std_msgs/msg/String", "std_msgs/msg/Header"))
    recovered = recover(source, tmp_path / "recovered")
    assert recovered.summary.counts == {PHASE: 9}
    assert len(list(BagScan(tmp_path / "recovered"))) == 9


@pytest.mark.parametrize("serialization", ["json", "protobuf", ""])
def test_messages_that_are_declared_as_no_cdr_are_no_samples(tmp_path: Path, serialization: str):
    source = foreign(tmp_path / "bag", 5, serialization=serialization)
    recover(source, tmp_path / "recovered")
    for path in (source, tmp_path / "recovered"):
        bag = read_bag(path)
        assert bag.rejected == {topics.DESCENT_PHASE: 5}
        assert "ROS 2 requires cdr" in bag.rejected_examples[0].reason


@pytest.mark.parametrize("first_ns", [(1 << 63) - 3, (1 << 64) - 5])
def test_a_time_that_ros_cannot_hold_is_refused(tmp_path: Path, first_ns: int):
    bag = read_bag(foreign(tmp_path / "bag", 5, first_ns=first_ns))
    late = sum(first_ns + number >= 1 << 63 for number in range(5))
    assert bag.rejected == {topics.DESCENT_PHASE: late}
    assert "ns, should be at most 9223372036854775807" in bag.rejected_examples[0].reason
