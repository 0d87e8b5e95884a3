"""The recorder as a process: kill -9, signals, refusals, full disk, namespaces, weaker QoS."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from numbered_source import FIRST_OF_SECOND, SEED, STRANGE_TOPIC
from rclpy.qos import QoSProfile
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from msg_schemas import topics
from msg_schemas.cdr import pack
from msg_schemas.samples import TextSample
from msg_schemas.specifications import Intent
from msg_schemas.table import CONTRACT_VERSION, TOPICS
from rover_bags.files.folder import stored_metadata
from rover_bags.files.recover import recover
from rover_bags.files.scan import BagScan
from rover_bags.files.store import (
    IDENTITY_RECORD,
    LOSSES_RECORD,
    BagError,
    BagWriter,
    standard_type,
)
from rover_bags.files.write_queue import Item, SequenceMonitor, Source, WriteQueue
from rover_bags.recording.record import CONFIG_RECORD, DISK_FAILED, RecordNode
from rover_bags.recording.recorded_topic import RecordedTopic
from rover_verify.harness import NodeHarness
from rover_verify.harness.processes import DEFAULT_TIMEOUT, Process, Processes

STORE = get_typestore(Stores.ROS2_JAZZY)
SECOND = 1_000_000_000
RECORDER = "rover_bags.recording.record"
SOURCE = "numbered_source"


def start_recorder(
    processes: Processes, bag: Path, *arguments: str, namespace: str = ""
) -> Process:
    """A recorder that has subscribed."""
    recorder = processes.start(
        RECORDER, None, "--output", str(bag), *arguments, namespace=namespace
    )
    recorder.wait_for_output("recording into")
    return recorder


def sent(source: Process) -> list[tuple[int, int]]:
    """Number and time [ns] of each message that a source has sent."""
    rows = [line.split() for line in source.output.splitlines(keepends=True) if line.endswith("\n")]
    return [(int(row[0]), int(row[1])) for row in rows]


def wait_until_received(source: Process, count: int) -> None:
    """Wait until a source has sent a number of messages to a subscriber."""
    source.wait_for_output(rf"(?m) {count}$")


def reported_lost(recorder: Process, topic: str) -> int:
    """Number of messages that the recorder reports as lost in transport."""
    match = re.search(rf"(\d+)  {topic}: lost in transport", recorder.output)
    return int(match[1]) if match else 0


def numbers(bag: Path, name: str = "/" + topics.JUMP_MOTOR_STATE) -> list[int]:
    """Numbers of the source's messages in a bag."""
    kind = TOPICS[topics.JUMP_MOTOR_STATE].message
    found = [STORE.deserialize_cdr(m.data, kind) for m in BagScan(bag) if m.topic.name == name]
    return [round(message.effort[0] * 1e3) for message in found]  # type: ignore[attr-defined]


def scanned(bag: Path) -> BagScan:
    scan = BagScan(bag)
    list(scan)
    return scan


@pytest.mark.process
@pytest.mark.parametrize(("mode", "rate"), [("contract", 100.0), ("batches", 3.0)])
def test_after_kill_9_all_but_the_last_second_is_recovered(
    tmp_path: Path, processes: Processes, mode: str, rate: float
):
    bag = tmp_path / "bag"
    recorder = start_recorder(processes, bag)
    source = processes.start(SOURCE, None, mode, str(rate))
    wait_until_received(source, round(4 * rate))
    killed_at = time.time_ns()
    assert recorder.stop(signal.SIGKILL) == -signal.SIGKILL
    source.stop()
    assert not (bag / "metadata.yaml").exists()

    result = recover(bag, tmp_path / "clean")
    assert not result.was_closed
    found = numbers(tmp_path / "clean")
    owed = [number for number, at in sent(source) if at < killed_at - SECOND]
    assert found == list(range(found[0], found[-1] + 1))
    assert found[0] < owed[-1] - 2 * rate
    assert found[-1] >= owed[-1]
    with Reader(tmp_path / "clean") as reader:
        assert reader.message_count == result.summary.messages
        assert {c.topic for c in reader.connections} >= {"/config", "/" + topics.TENSION_WATCH}


@pytest.mark.process
@pytest.mark.parametrize(
    ("signals", "mode"),
    [
        ([signal.SIGINT], "contract"),
        ([signal.SIGINT] * 2, "contract"),
        ([signal.SIGTERM], "batches"),
        ([signal.SIGHUP], "contract"),
    ],
)
def test_a_signal_closes_the_bag_and_prints_its_summary(
    tmp_path: Path, processes: Processes, signals: list[signal.Signals], mode: str
):
    bag = tmp_path / "bag"
    recorder = start_recorder(processes, bag)
    source = processes.start(SOURCE, None, mode, "200")
    wait_until_received(source, 300)
    source.stop()
    for number in signals:
        recorder.send(number)
    assert recorder.wait() == 0
    assert recorder.has_group_exited()
    found = numbers(bag)
    assert found == list(range(found[0], sent(source)[-1][0] + 1))
    assert reported_lost(recorder, "/" + topics.JUMP_MOTOR_STATE) == 0
    assert f"{len(found):8d}  /{topics.JUMP_MOTOR_STATE}" in recorder.output
    assert "Traceback" not in recorder.output
    with Reader(bag) as reader:
        assert reader.message_count > len(found)
    scan = BagScan(bag)
    messages = list(scan)
    assert not scan.damage
    assert scan.closed
    assert all(message.log_ns >= message.publish_ns > 0 for message in messages)
    assert messages[0].topic.name == "/" + topics.CONFIG
    # Configurations that arrive before the first write precede all other messages.
    others = [m.log_ns for m in messages if m.topic.name != "/" + topics.CONFIG]
    assert others == sorted(others)
    assert dict(scan.metadata)[IDENTITY_RECORD]["contract_version"] == CONTRACT_VERSION
    notes = [values for name, values in scan.metadata if name == CONFIG_RECORD]
    assert [note["seed"] for note in notes if note["node"] == "/source"] == [str(SEED)]
    custom = (stored_metadata(bag) or {})["custom_data"]
    assert custom["dropped_by_recorder"] == "{}"
    assert custom["contract_version"] == CONTRACT_VERSION


@pytest.mark.process
def test_a_stream_of_two_publishers_is_recorded_whether_in_batches_or_not(
    tmp_path: Path, processes: Processes
):
    bag = tmp_path / "bag"
    recorder = start_recorder(processes, bag)
    first = processes.start(SOURCE, None, "batches", "100")
    wait_until_received(first, 100)
    second = processes.start(SOURCE, None, "second", "100")
    wait_until_received(second, 100)
    second.stop()
    wait_until_received(first, sent(first)[-1][0] + 100)
    first.stop()
    assert recorder.stop() == 0
    found = numbers(bag)
    of_second = [number - FIRST_OF_SECOND for number in found if number > FIRST_OF_SECOND]
    assert of_second == list(range(of_second[0], sent(second)[-1][0] + 1))
    assert len(of_second) >= 99
    of_first = [number for number in found if number < FIRST_OF_SECOND]
    assert of_first == sorted(set(of_first))
    assert of_first[-1] == sent(first)[-1][0]
    # What the last batch would have held may be missing where the recorder turns to the topic.
    assert of_first[-1] - of_first[0] + 1 - len(of_first) <= 20


@pytest.mark.process
def test_beside_a_recorder_only_what_there_is_is_listed(tmp_path: Path, harness: NodeHarness):
    observer = harness.observer()
    own = {topics.COMMANDS, topics.EVENTS, topics.DIAGNOSTICS}  # of the observer
    start_recorder(harness.processes, tmp_path / "bag")

    def listed() -> set[str]:
        present = dict(observer.node.get_topic_names_and_types())
        return {name for name in TOPICS if observer.node.resolve_topic_name(name) in present}

    observer.wait_until(lambda: topics.WINCH_REQUEST in listed(), "the recorder is not discovered")
    observer.wait_until_ready(RecordNode.NAME)
    without_publisher = {
        name for name in listed() if not observer.node.count_publishers(name)
    } - own  # fmt: skip
    assert without_publisher == {
        name for name, row in TOPICS.items() if row.intent is Intent.COMMAND and not row.owned
    }


@pytest.mark.process
def test_a_namespace_and_a_selection_are_followed(tmp_path: Path, processes: Processes):
    bag = tmp_path / "bag"
    chosen = ("--topics", topics.JUMP_MOTOR_STATE, "no_such/topic")
    recorder = start_recorder(processes, bag, *chosen, namespace="rover1")
    mine, other = (
        processes.start(SOURCE, None, "contract", "100", namespace=name)
        for name in ("rover1", "rover2")
    )
    other.wait_for_output(r"(?m)^50 ")
    wait_until_received(mine, 50)
    assert recorder.stop() == 0
    assert "/rover1/no_such/topic is no topic of the contract" in recorder.output
    assert "no message received on: /rover1/no_such/topic" in recorder.output
    scan = BagScan(bag)
    full = "/rover1/" + topics.JUMP_MOTOR_STATE
    assert {message.topic.name for message in scan} == {full}
    names = json.loads(dict(scan.metadata)[IDENTITY_RECORD]["topics"])
    assert names[topics.JUMP_MOTOR_STATE] == full


@pytest.mark.process
def test_all_records_topics_outside_the_contract_with_their_offered_profile(
    tmp_path: Path, processes: Processes
):
    recorder = start_recorder(processes, tmp_path / "bag", "--all")
    source = processes.start(SOURCE, None, "stranger", "100")
    wait_until_received(source, 50)
    assert recorder.stop() == 0
    found = [m for m in BagScan(tmp_path / "bag") if m.topic.name == "/" + STRANGE_TOPIC]
    assert len(found) >= 20
    assert "best_effort" in found[0].topic.qos


@pytest.mark.process
def test_a_volatile_publisher_of_a_latched_topic_is_recorded(tmp_path: Path, processes: Processes):
    recorder = start_recorder(processes, tmp_path / "bag")
    source = processes.start(SOURCE, None, "volatile", "100")
    wait_until_received(source, 50)
    assert recorder.stop() == 0
    full = "/" + topics.TENSION_WATCH
    assert len([m for m in BagScan(tmp_path / "bag") if m.topic.name == full]) >= 20
    assert "offers a weaker QoS than the contract requires" in recorder.output


@pytest.mark.process
@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--output", "{taken}"], "of that name exists"),
        (["--output", "{taken}/file/bag"], "is a file"),
        (["--output", "/proc/bag"], "cannot be created"),
        (["--output", "{new}", "--min-free-mib", "1000000"], "MiB are free"),
        (["--output", "{new}", "--duration", "-1"], "duration"),
        (["--output", "{new}", "--topics", "not:a:name"], "'not:a:name' should be one topic"),
        (["--output", "{new}", "--topics", "clock", "imu odom"], "'imu odom' should be one topic"),
        (["--output", "{new}", "--ros-args", "-p", "topics:=a//b"], "'a//b' is not a valid topic"),
        (["--nonsense"], "--nonsense"),
    ],
)
def test_bad_arguments_are_refused_with_the_reason(
    tmp_path: Path, processes: Processes, arguments: list[str], reason: str
):
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "file").write_text("")
    places = {"taken": str(taken), "new": str(tmp_path / "new")}
    recorder = processes.start(
        RECORDER, None, *(argument.format(**places) for argument in arguments)
    )
    assert recorder.wait() == 2, recorder.output
    assert reason in recorder.output
    assert "Traceback" not in recorder.output
    assert not (tmp_path / "new").exists()


@pytest.mark.process
def test_a_disk_that_fills_up_ends_the_recording_with_its_own_exit_code(
    tmp_path: Path, processes: Processes
):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("mounting a small disk needs root")
    try:
        recorder = start_recorder(
            processes, disk / "bag", "--compression", "none", "--min-free-mib", "0"
        )
        processes.start(SOURCE, None, "contract", "2000")
        assert recorder.wait() == DISK_FAILED
        assert "the disk is full" in recorder.output
        result = recover(disk / "bag", tmp_path / "clean")
        assert result.complete
        found = numbers(tmp_path / "clean")
        assert found == sorted(found)
        missing = found[-1] - found[0] + 1 - len(found)
        assert missing <= reported_lost(recorder, "/" + topics.JUMP_MOTOR_STATE)
        assert len(found) > 500
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.process
def test_a_summary_that_cannot_be_printed_fails_no_recording(tmp_path: Path):
    command = [sys.executable, "-m", RECORDER, "--output", "~/bag", "--duration", "0.5"]
    own = {**os.environ, "HOME": str(tmp_path)}
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(command, env=own, stdout=full, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)
    assert (tmp_path / "bag" / "metadata.yaml").exists()


# --- the writer's thread, without ROS -----------------------------------------------------------


def _item(source: Source, number: int, size: int = 100) -> Item:
    kind = "std_msgs/msg/String"
    text = STORE.types[kind](data=f"{number}".ljust(size))
    return Item(source, number, number, number, bytes(STORE.serialize_cdr(text, kind)))


class StalledDisk:
    """Stands before a bag's writer and lets nothing through until told."""

    def __init__(self, writer: BagWriter) -> None:
        self.open = threading.Event()
        self.reached = threading.Event()
        self._write = writer.write
        writer.write = self.write  # type: ignore[method-assign]

    def write(self, *arguments: object, **more: object) -> None:
        self.reached.set()
        assert self.open.wait(DEFAULT_TIMEOUT)
        self._write(*arguments, **more)  # type: ignore[arg-type]


def test_a_stalled_disk_blocks_no_callback_and_drops_are_counted_by_topic(tmp_path: Path):
    writer = BagWriter(tmp_path / "bag", sync=False)
    disk = StalledDisk(writer)
    queue = WriteQueue(writer, limit=100_000, hold=0.0)
    busy, quiet = (
        Source(name, standard_type("std_msgs/msg/String")) for name in ("/busy", "/quiet")
    )
    assert queue.offer(_item(quiet, 0))
    assert disk.reached.wait(DEFAULT_TIMEOUT)
    kept = sum(queue.offer(_item(busy, number)) for number in range(1, 1001))
    queue.offer(_item(quiet, 2000, size=90_000))
    assert 100 < kept < 400
    assert queue.losses[0] == {"/busy": 1000 - kept, "/quiet": 1}
    disk.open.set()
    queue.close()
    assert [m.log_ns for m in BagScan(tmp_path / "bag")] == [0, *range(1, kept + 1)]
    custom = (stored_metadata(tmp_path / "bag") or {})["custom_data"]
    assert json.loads(custom["dropped_by_recorder"]) == {"/busy": 1000 - kept, "/quiet": 1}
    records = dict(scanned(tmp_path / "bag").metadata)
    assert json.loads(records[LOSSES_RECORD]["dropped_by_recorder"])["/quiet"] == 1


def test_the_configuration_is_written_first(tmp_path: Path):
    queue = WriteQueue(BagWriter(tmp_path / "bag", sync=False), hold=DEFAULT_TIMEOUT)
    kind = standard_type("std_msgs/msg/String")
    data, config = Source("/data", kind), Source("/config", kind, first=True)
    for number in range(1, 6):
        queue.offer(_item(data, number))
    queue.offer(_item(config, 6))
    queue.release()
    queue.close()
    assert [m.log_ns for m in BagScan(tmp_path / "bag")] == [6, 1, 2, 3, 4, 5]


def test_a_disk_failure_stops_the_queue_and_is_reported(tmp_path: Path):
    writer = BagWriter(tmp_path / "bag", sync=False)
    queue = WriteQueue(writer, hold=0.0)

    def fail(*_: object, **__: object) -> None:
        raise BagError("the disk is on fire")

    writer.write = fail  # type: ignore[method-assign]
    queue.offer(_item(Source("/data", standard_type("std_msgs/msg/String")), 1))
    queue._thread.join(DEFAULT_TIMEOUT)
    assert "on fire" in str(queue.error)
    assert not queue.offer(_item(Source("/data", standard_type("std_msgs/msg/String")), 2))
    queue.close()


def test_a_bag_whose_folder_is_moved_ends_the_recording(tmp_path: Path):
    writer = BagWriter(tmp_path / "bag", chunk_period=0.01, sync=False)
    queue = WriteQueue(writer, hold=0.0)
    (tmp_path / "bag").rename(tmp_path / "moved")
    queue.offer(_item(Source("/data", standard_type("std_msgs/msg/String")), 1))
    queue._thread.join(DEFAULT_TIMEOUT)
    assert "moved or deleted" in str(queue.error)
    with pytest.raises(BagError, match="moved or deleted"):
        queue.close()


def test_any_error_of_the_writer_ends_the_recording_and_its_messages_are_dropped(tmp_path: Path):
    writer = BagWriter(tmp_path / "bag", sync=False)
    queue = WriteQueue(writer, hold=DEFAULT_TIMEOUT)
    write = writer.write

    def fail(*arguments: Any, **more: Any) -> None:
        if arguments[1] == 2:
            raise KeyError("two")
        write(*arguments, **more)

    writer.write = fail  # type: ignore[method-assign]
    source = Source("/data", standard_type("std_msgs/msg/String"))
    for number in (1, 2, 3):
        queue.offer(_item(source, number))
    queue.release()
    queue._thread.join(DEFAULT_TIMEOUT)
    assert "the recording ended" in str(queue.error)
    assert queue.losses[0] == {"/data": 2}
    assert queue.close().counts == {"/data": 1}
    records = dict(scanned(tmp_path / "bag").metadata)
    assert json.loads(records[LOSSES_RECORD]["dropped_by_recorder"]) == {"/data": 2}


def test_what_a_failed_disk_did_not_take_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def fail(*_: object) -> int:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    queue = WriteQueue(BagWriter(tmp_path / "bag", sync=False), hold=DEFAULT_TIMEOUT)
    monkeypatch.setattr("rover_bags.files.store.os.write", fail)
    source = Source("/data", standard_type("std_msgs/msg/String"))
    for number in (1, 2, 3):
        queue.offer(_item(source, number))
    queue.release()
    with pytest.raises(BagError):
        queue.close()
    assert queue.losses[0] == {"/data": 3}
    assert queue.summary.messages == 0


def test_a_configuration_with_half_a_character_is_recorded():
    text = '{"node": "\\ud800", "seed": "\\ud800", "scenario": {}}'
    record = RecordNode._configuration_record(pack(topics.CONFIG, TextSample(text)))
    assert record is not None
    assert {key: record[1][key] for key in ("node", "seed")} == {"node": "?", "seed": "?"}
    "".join(record[1].values()).encode()


@pytest.mark.parametrize(
    ("sequences", "publishers", "lost"),
    [
        ([5, 6, 7, 8], 1, 0),
        ([5, 6, 9, 10], 1, 2),
        ([7, 8, 1, 2, 3], 1, 0),
        ([10, 1, 11, 2, 12, 3], 2, 0),
        ([10, 1, 11, 2, 14, 3, 15, 5], 2, 3),
    ],
)
def test_gaps_in_sequence_numbers_are_losses(sequences: list[int], publishers: int, lost: int):
    sequence_monitor = SequenceMonitor()
    assert sum(sequence_monitor.gap_before(n, lambda: publishers) for n in sequences) == lost


def test_a_topic_that_then_arrives_in_batches_has_lost_nothing():
    """Batches count from the first tick on, the topic from when somebody subscribed."""
    source = Source("/data", standard_type("std_msgs/msg/String"))
    topic = RecordedTopic(source, QoSProfile(depth=1), lambda: 1, subscription=object())
    assert [topic.lost_on_topic(number) for number in (1, 2, 3)] == [0, 0, 0]
    assert [topic.lost_in_batches(number) for number in (46, 47, 52)] == [0, 0, 0]
    topic.subscription = None
    assert [topic.lost_in_batches(number) for number in (53, 54, 57)] == [0, 0, 2]
    topic.subscription = object()
    assert [topic.lost_on_topic(number) for number in (4, 6)] == [0, 1]


def test_a_publisher_that_joins_late_has_lost_nothing():
    counts = iter([1, 2])
    source = Source("/data", standard_type("std_msgs/msg/String"))
    topic = RecordedTopic(source, QoSProfile(depth=1), lambda: next(counts))
    assert [topic.lost_on_topic(number) for number in (1, 2, 5, 3, 6)] == [0] * 5
