"""The report of bags: activities against a script, and memory for a long bag."""

from __future__ import annotations

import functools
import json
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from difflib import SequenceMatcher
from pathlib import Path

from msg_schemas import topics
from msg_schemas.samples import DrawingSample, TextSample
from msg_schemas.table import TOPICS
from rover_bags.analysis.timeline import Timeline, TimelineEventKind, timeline_of
from rover_bags.files.records import RecordedMessage
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagWriter, standard_type
from rover_bags.reading.read import read_bag
from rover_verify.checks import CheckBatch, Measured, NotPossible
from rover_verify.harness.scripted_bag import TrueActivity, record_mission

LARGE = 2_000_000_000
"""Size of a large bag [byte]."""
_MISSIONS = 5
_FAULT = "fault"
_COMMAND = (sys.executable, "-m", "rover_cli", "bag")
_MEGA = 1e6
_STAMP = struct.Struct("<iI")
_STAMP_AT = 4  # offset behind the encapsulation header
_NANO = 1_000_000_000

Intervals = list[tuple[str, float]]  # name and start of each activity


# --- activities -----------------------------------------------------------------------------------


@functools.cache
def _missions(batch: CheckBatch) -> list[tuple[list[TrueActivity], Timeline]]:
    """True activities of scripts, and the timelines found in their bags."""
    found = []
    for index, generator in enumerate(batch.generators(_MISSIONS)):
        path = batch.folder / f"mission_{index}"
        script = record_mission(path, generator)
        found.append((script, timeline_of(read_bag(path))))
        shutil.rmtree(path)
    return found


def _scripted(script: Sequence[TrueActivity]) -> Intervals:
    """The script's activities in their order, neighbours of a kind as one."""
    intervals: Intervals = []
    for true in sorted(script, key=lambda true: true.begin):
        if true.activity != _FAULT and (not intervals or intervals[-1][0] != true.activity):
            intervals.append((true.activity, true.begin))
    return intervals


def _found(timeline: Timeline) -> Intervals:
    return [(interval.activity.value, interval.begin_s) for interval in timeline.intervals]


def phases(batch: CheckBatch) -> Measured:
    """Number of missed and false activities and faults of scripted missions."""
    wrong, right, details = 0, 0, {}
    for index, (script, timeline) in enumerate(_missions(batch)):
        expected, got = _scripted(script), _found(timeline)
        matcher = SequenceMatcher(
            None, [w for w, _ in expected], [w for w, _ in got], autojunk=False
        )
        same = sum(block.size for block in matcher.get_matching_blocks())
        faults = sum(true.activity == _FAULT for true in script)
        found = sum(event.kind is TimelineEventKind.FAULT for event in timeline.events)
        missed = len(expected) - same + len(got) - same + abs(faults - found)
        if missed:
            text = ", ".join(f"{word} {at:.1f}" for word, at in got)
            details[f"mission {index}"] = f"{missed} wrong; found {text}"
        wrong += missed
        right += same
    return Measured(wrong, f"{right} found in {_MISSIONS} missions", details)


def phase_times(batch: CheckBatch) -> Measured:
    """Largest error of an activity's start against the script [s]; infinite for a missed fault."""
    worst, details = 0.0, {}
    for index, (script, timeline) in enumerate(_missions(batch)):
        expected, got = _scripted(script), _found(timeline)
        if [word for word, _ in expected] != [word for word, _ in got]:
            return Measured(float("nan"), "the activities differ from the script")
        apart = {
            f"{w} at {a:.2f} s": abs(a - b) for (w, a), (_, b) in zip(expected, got, strict=True)
        }
        times = [m.time_s for m in timeline.events if m.kind is TimelineEventKind.FAULT]
        for true in script:
            if true.activity == _FAULT:
                near = min((abs(at - true.begin) for at in times), default=float("inf"))
                apart[f"fault at {true.begin:.2f} s"] = near
        what = max(apart, key=lambda name: apart[name])
        details[f"mission {index}: {what}"] = apart[what]
        worst = max(worst, apart[what])
    return Measured(worst, f"of {_MISSIONS} missions", details)


# --- a large bag ----------------------------------------------------------------------------------


def repeat(source: Path, target: Path, size: int) -> int:
    """Write a bag anew, over and over with later stamps, until it has a size [byte].

    Nothing is compressed: as many messages as that size can hold of these.

    Returns:
        How many times it was written.
    """
    messages = list(BagScan(source))
    begin = min(message.log_ns for message in messages)
    span = max(message.log_ns for message in messages) - begin + 10_000_000
    count = 0
    with BagWriter(
        target, compression="none", chunk_period=1e9, chunk_bytes=1 << 20, sync=False
    ) as writer:
        channels = {
            topic.name: writer.add_topic(topic.name, standard_type(topic.type))
            for topic in dict.fromkeys(message.topic for message in messages)
        }
        while writer.summary.size < size:
            for message in messages:
                later = count * span
                writer.write(
                    channels[message.topic.name],
                    message.log_ns + later,
                    message.publish_ns + later,
                    _restamped(message, later) if later else message.data,
                )
            count += 1
    return count


def _restamped(message: RecordedMessage, later: int) -> bytes:
    """The message with a later stamp, where it has one at its begin."""
    name = message.topic.name
    row = TOPICS.get(name) or TOPICS.get(name.strip("/"))
    if row is None or row.sample in {TextSample, DrawingSample}:
        return message.data
    seconds, nanos = _STAMP.unpack_from(message.data, _STAMP_AT)
    stamp = seconds * _NANO + nanos + later
    head, tail = message.data[:_STAMP_AT], message.data[_STAMP_AT + _STAMP.size :]
    return head + _STAMP.pack(stamp // _NANO, stamp % _NANO) + tail


def memory(batch: CheckBatch) -> Measured:
    """Peak resident memory of `bag report` on a bag of 2 GB [MB]; infinite if a jump is missed."""
    if shutil.disk_usage(batch.folder).free < 2 * LARGE:
        raise NotPossible(f"less than {2 * LARGE / 1e9:g} GB are free in {batch.folder}")
    source, large = batch.folder / "mission", batch.folder / "large"
    (generator,) = batch.generators(1)
    record_mission(source, generator)
    alone = read_bag(source)
    jumps = sum(m.kind is TimelineEventKind.TAKE_OFF for m in timeline_of(alone).events)
    times = repeat(source, large, LARGE)
    size = sum(file.stat().st_size for file in large.iterdir())
    try:
        peak, seconds, words = _reported(large, batch.folder / "report")
    finally:
        shutil.rmtree(large)
    result = json.loads((batch.folder / "report" / "metrics.json").read_text(encoding="utf-8"))
    page = (batch.folder / "report" / "report.html").stat().st_size
    counted = result["topics"][topics.TRUTH_BODY1]["count"]
    expected = times * alone.counts[alone.full_names[topics.TRUTH_BODY1]]
    details: dict[str, float | str] = {
        "size [MB]": size / _MEGA,
        "messages": float(sum(item["count"] for item in result["topics"].values())),
        "time [s]": seconds,
        "page [MB]": page / _MEGA,
        "missions in it": float(times),
        "jumps measured": float(len(result["jumps"])),
        "progress shown": "yes" if "100%" in words else "no",
    }
    if len(result["jumps"]) != times * jumps or counted != expected or "100%" not in words:
        return Measured(float("inf"), "the report is not of the whole bag", details)
    return Measured(peak, f"a bag of {size / 1e9:.2f} GB in {seconds:.0f} s", details)


def _reported(bag: Path, folder: Path) -> tuple[float, float, str]:
    """Peak memory [MB], time [s] and standard error of the command on a bag."""
    command = [*_COMMAND, "report", str(bag), "--out", str(folder)]
    log = folder.with_suffix(".log")
    with log.open("w", encoding="utf-8") as stream:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stream)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    words = log.read_text(encoding="utf-8")
    if process.returncode != 0:
        raise RuntimeError(
            f"mother_rover bag report ended with {process.returncode}:\n{words[-2000:]}"
        )
    return usage.ru_maxrss * 1024.0 / _MEGA, usage.ru_utime + usage.ru_stime, words
