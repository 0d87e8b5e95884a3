"""The bag of a recorded jump: read by others, identified, complete, and true to the plant."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from msg_schemas import topics
from msg_schemas.events import PlantEvent
from rover_bags.files.scan import BagScan
from rover_bags.reading.read import read_bag
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.nodes import RECORD, drive_nut, simulation
from rover_verify.harness import NodeHarness, Process
from rover_verify.harness.recording import wait_until_recording


def _start_recording(harness: NodeHarness, bag: Path) -> Process:
    recorder = harness.processes.start(RECORD, None, "-o", str(bag))
    wait_until_recording(bag)
    return recorder


def _whole_bag(batch: CheckBatch) -> Path:
    """Record a complete jump; return its bag."""
    bag = batch.folder / "bag"
    with simulation(batch, real_time_factor=1.0) as (harness, _, observer):
        recorder = _start_recording(harness, bag)
        drive_nut(observer, 0.1, 0.2, lambda: observer.events(PlantEvent.TAKE_OFF))
        observer.wait_for_event(PlantEvent.TOUCHDOWN)
        observer.wait_for_time(observer.time_ns() + 500_000_000)
        if recorder.stop() != 0:
            raise RuntimeError(f"the recorder failed:\n{recorder.output}")
    return bag


def independent_reader(batch: CheckBatch) -> Measured:
    """Number of recorded messages that `mcap` with its ROS 2 decoder reads differently."""
    bag = _whole_bag(batch)
    ours = Counter(message.topic.name for message in BagScan(bag))
    theirs: Counter[str] = Counter()
    with next(bag.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, _ in reader.iter_decoded_messages():
            theirs[channel.topic] += 1
    different = sum(((ours - theirs) + (theirs - ours)).values())
    note = f"{sum(theirs.values())} messages on {len(theirs)} topics"
    return Measured(different, note, dict(sorted(theirs.items())))


def identity(batch: CheckBatch) -> Measured:
    """Number of missing items: contract version, package version, seed and scenario."""
    bag = read_bag(_whole_bag(batch))
    present = {
        "contract version": bool(bag.identity.get("contract_version")),
        "package version": bool(bag.identity.get("package_version")),
        "seed": bag.seed is not None,
        "scenario": bag.scenario.get("name") == "paper_table1_high",
    }
    missing = {name: "missing" for name, there in present.items() if not there}
    return Measured.number_of(missing, "of four")


def report_agrees(batch: CheckBatch) -> Measured:
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


def recorded_completely(batch: CheckBatch) -> Measured:
    """Missing fraction of Body 1's 100 Hz motion in a recording of a jump."""
    series = read_bag(_whole_bag(batch)).series(topics.TRUTH_BODY1)
    if series is None:
        return Measured(float("nan"), "nothing was recorded")
    gaps = np.diff(series.time)
    missing = sum(round(gap / 0.01) - 1 for gap in gaps)
    return Measured(missing / len(series), f"{len(series)} samples recorded, {missing} missing")
