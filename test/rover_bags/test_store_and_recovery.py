"""Bags on disk: intact, interrupted, cut and damaged ones, and refused locations."""

import errno
import os
import random
import shutil
import subprocess
import sys
import textwrap
import threading
import time
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    ConnectionExtRosbag2,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from rover_bags.files import store
from rover_bags.files.folder import ScanError, stored_metadata
from rover_bags.files.recover import RecoverExitCode, recover
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError, BagWriter, DiskFullError, standard_type
from rover_cli.command_line import main

STORE = get_typestore(Stores.ROS2_JAZZY)
INFINITE = QosTime(9223372036, 854775807)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    INFINITE,
    INFINITE,
    QosLiveliness.AUTOMATIC,
    INFINITE,
    False,
)
START = 1_700_000_000_000_000_000
STRING = "std_msgs/msg/String"
JOINTS = "sensor_msgs/msg/JointState"

Written = list[tuple[str, int, int, bytes]]


def text_message(text: str) -> bytes:
    return bytes(STORE.serialize_cdr(STORE.types[STRING](data=text), STRING))


def write_bag(path: Path, count: int = 300, *, close: bool = True, chunk: int = 2000) -> Written:
    """A bag of two topics in many small chunks; returns what was written."""
    rng = random.Random(7)
    writer = BagWriter(path, chunk_bytes=chunk, sync=False, compression="zstd")
    writer.add_metadata(store.IDENTITY_RECORD, store.with_checksum({"seed": "7"}))
    channels = {
        "/words": writer.add_topic("/words", standard_type(STRING), [LATCHED]),
        "/more": writer.add_topic("/more", standard_type(STRING)),
    }
    written: Written = []
    for index in range(count):
        topic = "/words" if index % 3 else "/more"
        data = text_message("".join(rng.choices("abcdefgh", k=rng.randrange(1, 60))))
        written.append((topic, START + index * 10_000_000, START + index * 10_000_000 - 5, data))
        writer.write(channels[topic], *written[-1][1:], sequence=index)
    if close:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    return written


def contents(path: Path) -> Written:
    return [(m.topic.name, m.log_ns, m.publish_ns, m.data) for m in BagScan(path)]


def mcap_file(bag: Path) -> Path:
    return next(bag.glob("*.mcap"))


# --- whole bags ---------------------------------------------------------------------------------


def test_rosbags_reads_back_every_message_type_and_profile(tmp_path: Path):
    written = write_bag(tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        found = [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]
        profiles = {
            c.topic: c.ext.offered_qos_profiles
            for c in reader.connections
            if isinstance(c.ext, ConnectionExtRosbag2)
        }
        types = {c.topic: c.msgtype for c in reader.connections}
    assert sorted(found) == sorted((t, stamp, data) for t, stamp, _, data in written)
    assert profiles["/words"] == [LATCHED]
    assert types == {"/words": STRING, "/more": STRING}
    with AnyReader([tmp_path / "bag"]) as typed:
        for connection, _, data in typed.messages():
            assert getattr(typed.deserialize(data, connection.msgtype), "data", "")


def test_the_mcap_library_reads_the_same_messages_and_verifies_checksums(tmp_path: Path):
    written = write_bag(tmp_path / "bag")
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        decoded = [
            (channel.topic, message.log_time, message.publish_time, message.data, ros.data)
            for _, channel, message, ros in reader.iter_decoded_messages(log_time_order=False)
        ]
    assert [item[:4] for item in decoded] == written
    assert all(text_message(item[4]) == item[3] for item in decoded)
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(written)
    assert len(summary.chunk_indexes) > 5


def test_every_chunk_carries_a_checksum_and_an_index(tmp_path: Path):
    from mcap.records import Chunk, DataEnd
    from mcap.stream_reader import StreamReader

    write_bag(tmp_path / "bag")
    with mcap_file(tmp_path / "bag").open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert len(chunks) > 5
    assert all(chunk.uncompressed_crc for chunk in chunks)
    assert next(r for r in records if isinstance(r, DataEnd)).data_section_crc


def test_memory_grows_by_no_more_than_the_index_that_each_chunk_will_have(tmp_path: Path):
    topics, chunks = 40, 100
    writer = BagWriter(tmp_path / "long", sync=False)
    channels = [writer.add_topic(f"/t{k}", standard_type(STRING)) for k in range(topics)]

    def write_chunks() -> int:
        for _ in range(chunks):
            for channel in channels:
                writer.write(channel, START, START, text_message("a"))
            writer.flush()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = write_chunks()
        grown = write_chunks() - before
    finally:
        tracemalloc.stop()
    writer.close()
    # Of each topic its number and the place of its messages, 10 bytes, and some 70 of the chunk.
    assert grown / chunks < 700.0

    with (tmp_path / "long" / "long_0.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert [len(index.message_index_offsets) for index in summary.chunk_indexes] == (
        [topics] * 2 * chunks
    )


def test_metadata_has_the_fields_of_rosbag2_version_9(tmp_path: Path):
    written = write_bag(tmp_path / "bag")
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert set(information) == {
        "version", "storage_identifier", "duration", "starting_time", "message_count",
        "topics_with_message_count", "compression_format", "compression_mode",
        "relative_file_paths", "files", "custom_data", "ros_distro",
    }  # fmt: skip
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    assert information["ros_distro"] == "jazzy"
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["message_count"] == len(written)
    assert information["starting_time"]["nanoseconds_since_epoch"] == START
    assert information["duration"]["nanoseconds"] == (len(written) - 1) * 10_000_000
    topics = {
        row["topic_metadata"]["name"]: row for row in information["topics_with_message_count"]
    }
    words = topics["/words"]["topic_metadata"]
    assert words["type_description_hash"] == STORE.hash_rihs01(STRING)
    assert words["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert topics["/more"]["message_count"] == 100
    assert "&id" not in text
    assert "*id" not in text


def test_the_file_holds_the_contents_of_metadata_yaml(tmp_path: Path):
    write_bag(tmp_path / "bag")
    records = dict(_metadata_of(tmp_path / "bag"))
    inside = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
    assert inside == stored_metadata(tmp_path / "bag")


def test_channels_carry_type_hash_and_profiles(tmp_path: Path):
    write_bag(tmp_path / "bag")
    channels, schemas = _channels_of(tmp_path / "bag")
    words = channels["/words"]
    assert words.metadata["topic_type_hash"] == STORE.hash_rihs01(STRING)
    assert "transient_local" in words.metadata["offered_qos_profiles"]
    assert schemas[words.schema_id].name == STRING
    assert schemas[words.schema_id].encoding == "ros2msg"


def test_an_unknown_message_type_is_refused():
    with pytest.raises(BagError, match="cat_msgs/msg/Purr"):
        standard_type("cat_msgs/msg/Purr")


def _metadata_of(bag: Path) -> list[tuple[str, dict[str, str]]]:
    with mcap_file(bag).open("rb") as stream:
        return [(r.name, dict(r.metadata)) for r in make_reader(stream).iter_metadata()]


def _channels_of(bag: Path) -> tuple[dict[str, Channel], dict[int, Schema]]:
    with mcap_file(bag).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return {c.topic: c for c in summary.channels.values()}, summary.schemas


# --- at low data rates ---------------------------------------------------------------------------


def test_a_lone_message_reaches_the_file_within_its_period(tmp_path: Path):
    writer = BagWriter(tmp_path / "bag", chunk_period=0.2)
    channel = writer.add_topic("/words", standard_type(STRING))
    began = time.monotonic()
    writer.write(channel, START, START, text_message("alone"))
    assert contents(tmp_path / "bag") == []
    while not contents(tmp_path / "bag"):
        assert time.monotonic() - began < 5.0
        threading.Event().wait(min(writer.due, 0.05))
        writer.flush_if_due()
    assert time.monotonic() - began > 0.15
    writer.abandon()
    assert [item[3] for item in contents(tmp_path / "bag")] == [text_message("alone")]


# --- refused and full ----------------------------------------------------------------------------


@pytest.mark.parametrize("what", ["bag", "folder", "file", "link"])
def test_an_existing_path_is_not_overwritten(tmp_path: Path, what: str):
    target = tmp_path / "taken"
    if what == "bag":
        write_bag(target, 3)
    elif what == "folder":
        target.mkdir()
    elif what == "file":
        target.write_text("precious")
    else:
        target.symlink_to(tmp_path / "nowhere")
    before = sorted(str(p) for p in tmp_path.rglob("*"))
    with pytest.raises(BagError, match="of that name exists"):
        BagWriter(target)
    assert sorted(str(p) for p in tmp_path.rglob("*")) == before


def test_a_file_within_the_path_is_reported(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="a part of its path is a file"):
        BagWriter(tmp_path / "file" / "bag")


def test_an_unwritable_folder_is_refused_without_leftovers(tmp_path: Path):
    with pytest.raises(BagError, match="cannot be created"):
        BagWriter(Path("/proc/no_bag_here"))


def test_too_little_free_space_is_refused_before_writing(tmp_path: Path):
    with pytest.raises(DiskFullError, match="MiB are free"):
        BagWriter(tmp_path / "bag", reserve=1 << 60)
    assert list(tmp_path.iterdir()) == []


def _write_until_full(writer: BagWriter, channel: int, data: bytes, reason: str) -> int:
    """Number of messages handed to the writer when it says that the disk is full."""
    for sent in range(1, 100_000):
        try:
            writer.write(channel, START + sent, START + sent, data)
        except DiskFullError as error:
            assert reason in str(error)  # noqa: PT017 - the loop counts what went before
            return sent
    pytest.fail("the disk never filled up")


def test_a_disk_that_fills_up_ends_in_a_closed_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    free = iter([100 << 20] * 6 + [1 << 20] * 1000)
    real = shutil.disk_usage

    def shrinking(path: Path) -> Any:
        return real(path)._replace(free=next(free))

    monkeypatch.setattr("rover_bags.files.store.shutil.disk_usage", shrinking)
    writer = BagWriter(tmp_path / "bag", chunk_bytes=1000)
    channel = writer.add_topic("/words", standard_type(STRING))
    data = text_message("x" * 400)
    sent = _write_until_full(writer, channel, data, "MiB are free")
    writer.close()
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == sent


FILLING = textwrap.dedent(
    """
    import random, resource, sys
    from pathlib import Path
    from rover_bags.files.store import BagWriter, BagError, DiskFullError, standard_type
    from rosbags.typesys import Stores, get_typestore
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "std_msgs/msg/String"
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
    writer = BagWriter(Path(sys.argv[1]), chunk_bytes=4000, compression="none")
    channel = writer.add_topic("/words", standard_type(kind))
    try:
        for index in range(100_000):
            text = f"{index:06d}" + "x" * 300
            data = bytes(store.serialize_cdr(store.types[kind](data=text), kind))
            writer.write(channel, index + 1, index + 1, data)
    except DiskFullError as error:
        print(error)
        print(index)
    try:
        writer.close()
    except BagError as error:
        print(error)
        sys.exit(3)
    """
)


def test_chunks_written_before_a_disk_failure_are_intact(tmp_path: Path):
    bag = tmp_path / "bag"
    run = subprocess.run(
        [sys.executable, "-c", FILLING, str(bag)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 3, run.stderr
    full, sent, at_close = run.stdout.strip().splitlines()
    assert "the disk is full" in full
    assert "bag recover" in full
    assert "bag recover" in at_close
    result = recover(bag, tmp_path / "clean")
    assert result.complete
    found = [m.data for m in BagScan(tmp_path / "clean")]
    assert found == [text_message(f"{i:06d}" + "x" * 300) for i in range(len(found))]
    lost_to_the_full_disk = int(sent) + 1 - len(found)
    assert 0 < lost_to_the_full_disk <= 4000 // 300 + 2
    assert len(found) > 100


def _tmpfs(folder: Path, size: str) -> bool:
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def test_a_full_disk_leaves_a_recoverable_bag(tmp_path: Path):
    disk = tmp_path / "disk"
    if not _tmpfs(disk, "300k"):
        pytest.skip("mounting a small disk needs root")
    try:
        writer = BagWriter(disk / "bag", chunk_bytes=8000, compression="none", reserve=0)
        channel = writer.add_topic("/words", standard_type(STRING))
        sent = _write_until_full(
            writer, channel, text_message("y" * 500), os.strerror(errno.ENOSPC)
        )
        with pytest.raises(BagError, match="bag recover"):
            writer.close()
        result = recover(disk / "bag", tmp_path / "clean")
        assert result.complete
        assert result.summary.messages > 300
        assert sent - result.summary.messages < 40
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_copy_onto_links_in_a_circle_is_refused(tmp_path: Path):
    write_bag(tmp_path / "bag", close=False)
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(BagError, match="a file of that name exists"):
        recover(tmp_path / "bag", tmp_path / "loop")


def test_a_copy_that_does_not_end_leaves_no_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write_bag(tmp_path / "bag", close=False)

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(BagWriter, "write", stop)
    with pytest.raises(KeyboardInterrupt):
        recover(tmp_path / "bag", tmp_path / "clean")
    assert [each.name for each in tmp_path.iterdir()] == ["bag"]


def test_a_copy_onto_a_disk_that_fills_up_leaves_no_bag_and_reports_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write_bag(tmp_path / "bag", close=False)
    original = os.write
    written: list[int] = []

    def fill_up(descriptor: int, data: bytes) -> int:
        written.append(len(data))
        if len(written) > 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return original(descriptor, data)

    monkeypatch.setattr(os, "write", fill_up)
    with pytest.raises(BagError, match=r"the disk is full .*; the unfinished bag is removed"):
        recover(tmp_path / "bag", tmp_path / "clean")
    assert [each.name for each in tmp_path.iterdir()] == ["bag"]


# --- killed, cut, damaged ------------------------------------------------------------------------


def test_a_bag_that_was_never_closed_is_recovered_completely(tmp_path: Path):
    written = write_bag(tmp_path / "bag", close=False)
    before = mcap_file(tmp_path / "bag").read_bytes()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
    result = recover(tmp_path / "bag", tmp_path / "clean")
    assert result.complete
    assert not result.was_closed
    assert contents(tmp_path / "clean") == written
    assert mcap_file(tmp_path / "bag").read_bytes() == before
    with Reader(tmp_path / "clean") as reader:
        assert reader.message_count == len(written)
    identity = dict(_metadata_of(tmp_path / "clean"))[store.IDENTITY_RECORD]
    assert store.verified_contents(identity) == {"seed": "7"} or identity == {"seed": "7"}


def _is_subsequence(found: Written, written: Written) -> bool:
    remaining = iter(written)
    return all(item in remaining for item in found)


def test_every_complete_chunk_before_a_cut_is_recovered(tmp_path: Path):
    written = write_bag(tmp_path / "bag", close=False)
    original = mcap_file(tmp_path / "bag").read_bytes()
    ends = _chunk_ends(original)
    rng = random.Random(1)
    cuts = {0, 1, 7, 8, 9, 20, len(original) - 1, *rng.sample(range(len(original)), 120)}
    broken = tmp_path / "cut.mcap"
    recovered_from_some = 0
    for number, cut in enumerate(sorted(cuts)):
        broken.write_bytes(original[:cut])
        expected = sum(count for end, count in ends if end <= cut)
        if expected == 0:
            with pytest.raises(ScanError):
                recover(broken, tmp_path / f"clean{number}")
            assert not (tmp_path / f"clean{number}").exists()
            continue
        recover(broken, tmp_path / f"clean{number}")
        assert contents(tmp_path / f"clean{number}") == written[:expected], cut
        recovered_from_some += 1
    assert recovered_from_some > 80


def _chunk_ends(data: bytes) -> list[tuple[int, int]]:
    """End of each chunk record and its number of messages, by the mcap library."""
    from io import BytesIO

    from mcap.exceptions import EndOfFile
    from mcap.records import Chunk, Message
    from mcap.stream_reader import StreamReader, breakup_chunk

    stream = BytesIO(data)
    ends: list[tuple[int, int]] = []
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                inside = sum(isinstance(r, Message) for r in breakup_chunk(record))
                ends.append((stream.tell(), inside))
    except EndOfFile:
        pass
    return ends


@pytest.mark.parametrize("closed", [True, False])
def test_a_flipped_bit_never_yields_wrong_data(tmp_path: Path, closed: bool):
    written = write_bag(tmp_path / "bag", close=closed)
    original = mcap_file(tmp_path / "bag").read_bytes()
    rng = random.Random(2)
    broken = tmp_path / "flipped.mcap"
    recovered = 0
    for _ in range(400):
        position, bit = rng.randrange(len(original)), rng.randrange(8)
        data = bytearray(original)
        data[position] ^= 1 << bit
        broken.write_bytes(data)
        scan = BagScan(broken)
        messages = list(scan)
        found = [(m.topic.name, m.log_ns, m.publish_ns, m.data) for m in messages]
        assert _is_subsequence(found, written), (position, bit)
        assert {m.topic.type for m in messages} == {STRING}
        if len(found) < len(written):
            assert scan.damage, (position, bit)
        assert len(found) > 0.8 * len(written), (position, bit)
        recovered += len(found)
    assert recovered > 0.93 * 400 * len(written)


def test_many_flipped_bits_never_yield_wrong_data(tmp_path: Path):
    written = write_bag(tmp_path / "bag", close=False)
    original = mcap_file(tmp_path / "bag").read_bytes()
    rng = random.Random(3)
    for _ in range(150):
        data = bytearray(original)
        for _ in range(rng.randrange(2, 30)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        broken = tmp_path / "flipped.mcap"
        broken.write_bytes(data)
        scan = BagScan(broken)
        try:
            found = [(m.topic.name, m.log_ns, m.publish_ns, m.data) for m in scan]
        except ScanError:
            continue
        assert _is_subsequence(found, written)
        assert len(found) == len(written) or scan.damage


def test_losses_are_counted_by_topic_and_the_damaged_chunk_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    written = write_bag(tmp_path / "bag")
    data = bytearray(mcap_file(tmp_path / "bag").read_bytes())
    (_, before), (end, inside) = _chunk_ends(bytes(data))[1:3]
    first = _chunk_ends(bytes(data))[0][1] + before
    data[end - 10] ^= 0x10
    mcap_file(tmp_path / "bag").write_bytes(data)
    code = main(["bag", "recover", str(tmp_path / "bag"), str(tmp_path / "clean")])
    printed = capsys.readouterr().out
    assert code == RecoverExitCode.LOSSES
    kept = written[:first] + written[first + inside :]
    assert contents(tmp_path / "clean") == kept
    assert f"{inside} messages are known to be lost" in printed
    assert "bag_0.mcap, byte" in printed
    assert "chunk:" in printed


def test_a_lost_first_chunk_does_not_affect_the_others(tmp_path: Path):
    written = write_bag(tmp_path / "bag", close=False)
    data = bytearray(mcap_file(tmp_path / "bag").read_bytes())
    end, inside = _chunk_ends(bytes(data))[0]
    data[end - 5] ^= 0x01
    mcap_file(tmp_path / "bag").write_bytes(data)
    result = recover(tmp_path / "bag", tmp_path / "clean")
    assert contents(tmp_path / "clean") == written[inside:]
    assert sum(result.lost.values()) == inside


@pytest.mark.parametrize("closed", [True, False])
def test_a_type_declared_in_a_lost_chunk_is_known(tmp_path: Path, closed: bool):
    writer = BagWriter(tmp_path / "bag", sync=False)
    first = writer.add_topic("/first", standard_type(STRING))
    writer.write(first, START, START, text_message("first"))
    writer.flush()
    second = writer.add_topic("/second", standard_type(STRING))
    writer.write(second, START + 1, START + 1, text_message("second"))
    if closed:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    data = bytearray(mcap_file(tmp_path / "bag").read_bytes())
    data[_chunk_ends(bytes(data))[0][0] - 5] ^= 0x01
    mcap_file(tmp_path / "bag").write_bytes(data)
    recover(tmp_path / "bag", tmp_path / "clean")
    found = [(m.topic.name, m.topic.type, m.data) for m in BagScan(tmp_path / "clean")]
    assert found == [("/second", STRING, text_message("second"))]


def test_messages_without_checksums_are_reported_as_unverified(tmp_path: Path):
    kind = STORE.types[STRING]
    writer = RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        connection = writer.add_connection("/words", STRING, typestore=STORE)
        for index in range(50):
            data = STORE.serialize_cdr(kind(data=str(index)), STRING)
            writer.write(connection, START + index, data)
    result = recover(tmp_path / "bag", tmp_path / "clean")
    assert result.unverified == {"/words": 50}
    assert "no checksum" in result.text()
    assert result.summary.messages == 50


def test_a_missing_metadata_file_is_tolerated(tmp_path: Path):
    written = write_bag(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    result = recover(tmp_path / "bag", tmp_path / "clean")
    assert result.complete
    assert not result.had_metadata
    assert contents(tmp_path / "clean") == written


@pytest.mark.parametrize("content", [b"", b"no bag at all, only words " * 50, b"\x06" * 5000])
def test_a_path_without_a_bag_is_refused_and_leaves_no_output(
    tmp_path: Path, content: bytes, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "thing.mcap").write_bytes(content)
    code = main(["bag", "recover", str(tmp_path / "thing.mcap"), str(tmp_path / "clean")])
    assert code == RecoverExitCode.REFUSED
    assert "thing.mcap" in capsys.readouterr().err
    assert not (tmp_path / "clean").exists()


def test_an_existing_target_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_bag(tmp_path / "bag")
    (tmp_path / "clean").mkdir()
    assert (
        main(["bag", "recover", str(tmp_path / "bag"), str(tmp_path / "clean")])
        == RecoverExitCode.NOT_WRITTEN
    )
    assert "of that name exists" in capsys.readouterr().err
    assert (
        main(["bag", "recover", str(tmp_path / "bag"), str(tmp_path / "bag")])
        == RecoverExitCode.REFUSED
    )
    assert (
        main(["bag", "recover", str(tmp_path / "none"), str(tmp_path / "new")])
        == RecoverExitCode.REFUSED
    )
