"""The demonstrations, and the bag of the jump: complete, identified, true, and read by others."""

from __future__ import annotations

import math
import shutil
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from msg_schemas import topics
from rover_bags.files.scan import BagScan
from rover_bags.reading.read import read_bag
from rover_verify.checks import CheckBatch, Measured
from rover_verify.demo import jump_show, mission_show


@cache
def _jump(folder: Path) -> tuple[dict[str, Any], Path]:
    """Show the jump once for all rows; returns its metrics and its bag."""
    place = folder / "jump"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    return jump_show.show_jump(place, 1.0, quiet=True), place / "bag"


def demo(batch: CheckBatch, metric: str) -> Measured:
    """Deviation of a metric of the demonstration's jump from the independent code."""
    (reference,) = [each for each in jump_show.REFERENCES if each.key == metric]
    value = float(_jump(batch.folder.parent)[0][metric])
    note = f"{value:.5f} {reference.unit}, other code {reference.value} {reference.unit}"
    return Measured(abs(value - reference.value), note)


def demo_time(batch: CheckBatch) -> Measured:
    """Wall time of the demonstration in an existing environment [s]."""
    metrics, _ = _jump(batch.folder.parent)
    details = {"ready after [s]": str(metrics["ready_after_s"])}
    return Measured(metrics["wall_time_s"], "compiled functions may come from the cache", details)


def independent_reader(batch: CheckBatch) -> Measured:
    """Number of recorded messages that `mcap` with its ROS 2 decoder reads differently."""
    _, bag = _jump(batch.folder.parent)
    ours = Counter(message.topic.name for message in BagScan(bag))
    with next(bag.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        theirs = Counter(channel.topic for _, channel, _, _ in reader.iter_decoded_messages())
    different = ((ours - theirs) + (theirs - ours)).total()
    note = f"{theirs.total()} messages on {len(theirs)} topics"
    return Measured(different, note, dict(sorted(theirs.items())))


def identity(batch: CheckBatch) -> Measured:
    """Number of missing items: contract version, package version, seed and scenario."""
    bag = read_bag(_jump(batch.folder.parent)[1])
    present = {
        "contract version": bool(bag.identity.get("contract_version")),
        "package version": bool(bag.identity.get("package_version")),
        "seed": bag.seed is not None,
        "scenario": bag.scenario.get("name") == jump_show.SCENARIO,
    }
    missing = {name: "missing" for name, there in present.items() if not there}
    return Measured.number_of(missing, "of four")


def report_agrees(batch: CheckBatch) -> Measured:
    """Difference of the height computed from the bag and the plant's own [m]."""
    (found,) = _jump(batch.folder.parent)[0]["jumps"]
    height, plants = found["jump_height_m"], found["reported"]["height"]
    return Measured(abs(height - plants), f"{height:.5f} m, plant's {plants:.5f} m")


def recorded_completely(batch: CheckBatch) -> Measured:
    """Missing fraction of Body 1's 100 Hz motion in a recording of a jump."""
    series = read_bag(_jump(batch.folder.parent)[1]).series(topics.TRUTH_BODY1)
    if series is None:
        return Measured(math.nan, "nothing was recorded")
    missing = sum(max(round(gap / 0.01) - 1, 0) for gap in np.diff(series.time))
    return Measured(missing / len(series), f"{len(series)} samples recorded, {missing} missing")


def mission_time(batch: CheckBatch) -> Measured:
    """Wall time of the demonstration of the whole mission [s]; inf if it fails."""
    folder = batch.folder / "mission"
    folder.mkdir()
    metrics = mission_show.show_mission(folder, seed=batch.seed, quiet=True)
    mission = metrics["mission"]
    details = {key: str(mission[key]) for key in ("ready_after_s", "flown_in_s", "simulated_s")}
    missed = [item["text"] for item in metrics["verdict"] if not item["pass"]]
    taken = float(mission["wall_time_s"]) if not missed else math.inf
    return Measured(taken, "; ".join(missed) or mission_show.summary(metrics), details)
