"""Bags: killed recordings, cut and damaged bags, an independent reader, refused paths."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory

from msg_schemas import topics
from msg_schemas.events import PlantEvent
from rover_bags.files.recover import recover
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagError
from rover_bags.reading.read import read_bag
from rover_verify.checks import Batch, Measured
from rover_verify.checks.nodes import (
    RECORD,
    drive_nut,
    has_event,
    simulation,
    wait_until_time,
)
from rover_verify.harness import NodeHarness, Process
from rover_verify.harness.recording import wait_until_recording

_LIVE_RUNS = 3
_RECORDED_S = 1.5


def _start_recording(harness: NodeHarness, bag: Path) -> Process:
    recorder = harness.processes.start(RECORD, None, "-o", str(bag))
    wait_until_recording(bag)
    return recorder


def _whole_bag(batch: Batch) -> Path:
    """Record a complete jump; return its bag."""
    bag = batch.folder / "bag"
    with simulation(batch, real_time_factor=1.0) as (harness, _, observer):
        recorder = _start_recording(harness, bag)
        drive_nut(observer, 0.1, 0.2, has_event(observer, PlantEvent.TAKE_OFF))
        observer.wait_for_event(PlantEvent.TOUCHDOWN)
        wait_until_time(observer, observer.time_ns() + 500_000_000)
        if recorder.stop() != 0:
            raise RuntimeError(f"the recorder failed:\n{recorder.output}")
    return bag


def killed(batch: Batch) -> Measured:
    """Longest time before a SIGKILL of the recorder that the recovered bag lacks [s]."""
    worst, details = 0.0, {}
    with simulation(batch, real_time_factor=1.0) as (harness, _, observer):
        for index, generator in enumerate(batch.generators(_LIVE_RUNS)):
            bag = batch.folder / f"killed_{index}"
            recorder = _start_recording(harness, bag)
            longer = _RECORDED_S + float(generator.uniform(0.0, 1.5))
            wait_until_time(observer, observer.time_ns() + round(longer * 1e9))
            at = observer.time_ns()
            recorder.kill_group()
            recovery = recover(bag, batch.folder / f"recovered_{index}")
            rescued = read_bag(batch.folder / f"recovered_{index}")
            series = rescued.series(topics.CLOCK)
            last = 0.0 if series is None else float(series.time[-1])
            details[f"kill {index}: recovered messages"] = float(recovery.summary.messages)
            details[f"kill {index}: lost [s]"] = at * 1e-9 - last
            worst = max(worst, at * 1e-9 - last)
    return Measured(
        worst, f"{_LIVE_RUNS} kills at random times at a real-time factor of 1", details
    )


def independent_reader(batch: Batch) -> Measured:
    """Number of recorded messages that `mcap` with its ROS 2 decoder reads differently."""
    bag = _whole_bag(batch)
    ours = Counter(message.topic.name for message in BagScan(bag))
    theirs: Counter[str] = Counter()
    with next(bag.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, _ in reader.iter_decoded_messages():
            theirs[channel.topic] += 1
    different = sum(((ours - theirs) + (theirs - ours)).values())
    identity = read_bag(bag).identity
    details: dict[str, float | str] = {name: float(count) for name, count in sorted(theirs.items())}
    details["identity"] = json.dumps(dict(identity))[:200]
    return Measured(different, f"{sum(theirs.values())} messages on {len(theirs)} topics", details)


def identity(batch: Batch) -> Measured:
    """Number of missing items: contract version, package version, seed and scenario."""
    bag = read_bag(_whole_bag(batch))
    present = {
        "contract version": bool(bag.identity.get("contract_version")),
        "package version": bool(bag.identity.get("package_version")),
        "seed": bag.seed is not None,
        "scenario": bag.scenario.get("name") == "paper_table1_high",
    }
    details = {name: "there" if there else "MISSING" for name, there in present.items()}
    return Measured(sum(not there for there in present.values()), "of four", details)


def _contents(path: Path) -> list[tuple[str, int, bytes]]:
    return [(m.topic.name, m.log_ns, m.data) for m in BagScan(path)]


def _complete_messages(file: Path) -> Callable[[int], int]:
    """Return a function: number of messages in complete chunks within a number of bytes."""
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        ends = sorted(c.chunk_start_offset + c.chunk_length for c in summary.chunk_indexes)
    with file.open("rb") as stream:
        counts = [
            sum(isinstance(record, McapMessage) for record in breakup_chunk(chunk))
            for chunk in StreamReader(stream, emit_chunks=True).records
            if isinstance(chunk, Chunk)
        ]

    def complete(length: int) -> int:
        return sum(count for end, count in zip(ends, counts, strict=True) if end <= length)

    return complete


def cut(batch: Batch) -> Measured:
    """Number of randomly cut bags that are not recovered up to the cut."""
    bag = _whole_bag(batch)
    file = next(bag.glob("*.mcap"))
    data, whole = file.read_bytes(), Counter(_contents(bag))
    expected = _complete_messages(file)
    bad, empty = 0, 0
    details: dict[str, float | str] = {}
    for index, generator in enumerate(batch.generators()):
        length = int(generator.integers(len(data) // 20, len(data)))
        broken, target = batch.folder / "cut.mcap", batch.folder / "recovered"
        broken.write_bytes(data[:length])
        shutil.rmtree(target, ignore_errors=True)
        try:
            recover(broken, target)
            found = Counter(_contents(target))
        except BagError as error:
            found = Counter()
            empty += 1
            words = str(error)
        else:
            words = f"{found.total()} messages"
        if found.total() < expected(length) or found - whole:
            bad += 1
            details[f"run {index}, {length} bytes"] = f"{words}, whole: {expected(length)}"
    note = f"of {batch.runs} cuts of a bag of {whole.total()} messages; {empty} before the first"
    return Measured(bad, note, details)


def damaged(batch: Batch) -> Measured:
    """Number of randomly damaged bags that yield a false message or an unexpected exception."""
    bag = _whole_bag(batch)
    file = next(bag.glob("*.mcap"))
    data, whole = file.read_bytes(), set(_contents(bag))
    wrong, refused, details = 0, 0, {}
    runs = batch.runs * 10
    for index, generator in enumerate(batch.generators(runs)):
        corrupted = bytearray(data)
        for _ in range(int(generator.integers(1, 4))):
            corrupted[int(generator.integers(len(data)))] ^= 1 << int(generator.integers(8))
        broken = batch.folder / "damaged.mcap"
        broken.write_bytes(bytes(corrupted))
        try:
            found = set(_contents(broken))
        except BagError:
            refused += 1
            continue
        except Exception as error:  # noqa: BLE001 - any other exception is a failure
            wrong += 1
            details[f"run {index}"] = f"{type(error).__name__}: {error}"[:160]
            continue
        false_messages = found - whole
        if false_messages:
            wrong += 1
            details[f"run {index}"] = f"{len(false_messages)} messages that were never recorded"
    return Measured(wrong, f"of {runs} damaged bags; {refused} refused as a whole", details)


def refused_folders(batch: Batch) -> Measured:
    """Number of impossible paths of a bag that the recorder does not refuse with the path."""
    plain = batch.folder / "a_file"
    plain.write_text("not a folder", encoding="utf-8")
    taken = batch.folder / "taken"
    taken.mkdir()
    (taken / "taken_0.mcap").write_bytes(b"another bag")
    bad, details = 0, {}
    with simulation(batch) as (harness, _, _):
        cases = {
            "below a plain file": (str(plain / "bag"), "2"),
            "in place of another bag": (str(taken), "2"),
            "in a system folder": ("/proc/bag", "2"),
        }
        for name, (path, _) in cases.items():
            process = harness.processes.start(RECORD, None, "-o", path)
            code = process.wait()
            details[name] = f"code {code}: {process.output.strip().splitlines()[-1]}"
            bad += code != 2 or path not in process.output
        full = harness.processes.start(
            RECORD, None, "-o", str(batch.folder / "full"), "--min-free-mib", "1000000"
        )
        code = full.wait()
        details["a full disk"] = f"code {code}: {full.output.strip().splitlines()[-1]}"
        bad += code not in {2, 4}
    if (taken / "taken_0.mcap").read_bytes() != b"another bag":
        bad += 1
        details["in place of another bag, too"] = "the other bag was touched"
    return Measured(bad, f"of {len(cases) + 1} places", details)


def report_agrees(batch: Batch) -> Measured:
    """Difference of the height computed from the bag and the plant's own [m]."""
    from rover_bags.analysis.metrics import measure  # noqa: PLC0415 - the report's part, big to load

    bag = read_bag(_whole_bag(batch))
    metrics = measure(bag)
    (found,) = metrics.jumps
    details: dict[str, float | str] = {
        "height in the bag [m]": found.jump_height_m,
        "attitude variation in the bag [rad]": found.attitude_variation_rad,
        **{f"plant's {name}": value for name, value in found.reported.items()},
    }
    return Measured(abs(found.jump_height_m - found.reported["height"]), "one jump", details)


def recorded_completely(batch: Batch) -> Measured:
    """Missing fraction of Body 1's 100 Hz motion in a recording of a jump."""
    series = read_bag(_whole_bag(batch)).series(topics.TRUTH_BODY1)
    if series is None:
        return Measured(float("nan"), "nothing was recorded")
    gaps = np.diff(series.time)
    missing = sum(round(gap / 0.01) - 1 for gap in gaps)
    return Measured(missing / len(series), f"{len(series)} samples recorded, {missing} missing")
