"""A bag as the page replays it: the frames that a live page would have shown, and the journal.

The same telemetry and the same page_state are fed as live, with what the bag holds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from msg_schemas import topics
from msg_schemas.samples import (
    ClockSample,
    DrawingSample,
    ImuSample,
    JointSample,
    JointValue,
    OdometrySample,
    StatusSample,
    TetherSample,
    TextSample,
    WrenchSample,
)
from msg_schemas.table import TOPICS
from operator_console.page_state import SEEN, Entry, PageState, frame
from operator_console.scene import USUAL_MACHINE
from operator_console.telemetry import Telemetry
from rover_bags.files.scan import BagScan
from rover_bags.read import Bag, Floats, TimeSeries, read_bag, received_messages

PERIOD: Final = 0.1
"""Of the frames of a short bag [s]."""
MOST_FRAMES: Final = 3000
_LARGE: Final = 256 * 1024 * 1024  # [B]
_MOST_ROWS: Final = 20_000
_MOST_ENTRIES: Final = 2000


@dataclass(frozen=True)
class Replay:
    """What a page needs to replay a bag; plain values.

    Attributes:
        name: Of the bag.
        frames: In order; ``parts`` and ``health`` are left out where they are as before.
        journal: Events and refusals.
        place, machine: As told once.
        remarks: What is missing or damaged, in words.
    """

    name: str
    frames: tuple[dict[str, Any], ...]
    journal: tuple[dict[str, Any], ...]
    place: dict[str, Any] | None
    machine: dict[str, Any]
    remarks: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "name": self.name,
            "frames": self.frames,
            "journal": self.journal,
            "place": self.place,
            "machine": self.machine,
            "remarks": self.remarks,
        }


def read_replay(path: Path, most_frames: int = MOST_FRAMES) -> Replay:
    """Read a bag for being replayed.

    Raises:
        BagError: It cannot be read; the text says why.
    """
    bag = _read(path)
    axes = {name: _axis(bag, track) for name, track in bag.time_series.items() if len(track)}
    if not axes:
        raise ValueError(f"the bag {path.name} holds nothing that can be shown")
    page_state, telemetry = PageState(), Telemetry()
    if topics.PLACE in bag.full_names:
        _see_place(bag, page_state)
    begin = min(float(axis.min()) for axis in axes.values())
    end = max(float(axis.max()) for axis in axes.values())
    period = max(PERIOD, (end - begin) / max(1, most_frames - 1))
    pointers = dict.fromkeys(axes, 0)
    frames: list[dict[str, Any]] = []
    journal: list[Entry] = []
    before: dict[str, Any] = {}
    for index in range(math.floor((end - begin) / period) + 1):
        now = begin + (index + 1) * period
        told = []
        for name, axis in axes.items():
            first, last = pointers[name], int(np.searchsorted(axis, now, side="right"))
            pointers[name] = last
            told += [
                (float(axis[row]), name, row) for row in _rows(bag.time_series[name], first, last)
            ]
        for at, name, row in sorted(told, key=lambda item: item[0]):
            sample = sample_at(bag.time_series[name], row)
            telemetry.hear(name, sample, at)
            journal += page_state.see(name, sample, at, at)
        made = frame(telemetry.snapshot(now), page_state, now, now)
        told_now = {key: made[key] for key in ("parts", "health")}
        for key, value in told_now.items():
            if before.get(key) == value:
                del made[key]
        before = told_now
        frames.append(made)
    return Replay(
        path.name,
        tuple(frames),
        tuple(entry.as_dict() for entry in journal[-_MOST_ENTRIES:]),
        page_state.place,
        page_state.machine or dict(USUAL_MACHINE),
        tuple(_remarks(bag, period)),
    )


def _read(path: Path) -> Bag:
    """The bag, of a large one numbers more coarsely, but all that nodes say of themselves."""
    wanted = [topic for topic in SEEN if TOPICS[topic].sample is not DrawingSample]
    files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
    if sum(file.stat().st_size for file in files) < _LARGE:
        return read_bag(path, wanted)
    coarse = read_bag(path, wanted, max_messages=_MOST_ROWS)
    said = [topic for topic in wanted if TOPICS[topic].sample is StatusSample]
    return replace(coarse, time_series={**coarse.time_series, **read_bag(path, said).time_series})


def _axis(bag: Bag, track: TimeSeries) -> Floats:
    """Times of a track's messages on the replay's axis [s], which never goes back.

    Simulated time where it only went forward, else the recorder's.
    """
    restarts = _restarts(bag)
    if restarts == 0 and TOPICS[track.topic].sample is not StatusSample:
        told: Floats = np.maximum.accumulate(track.time)
        return told
    if restarts == 0 and bag.clock is not None and bag.clock.is_recorded:
        return np.maximum.accumulate(bag.clock.at_reception(track.log_ns) * 1e-9)
    return np.asarray((track.log_ns - bag.start_ns) * 1e-9)


def _restarts(bag: Bag) -> int:
    """How often simulated time was put back."""
    timing = bag.timings.get(topics.CLOCK)
    return 0 if timing is None else timing.restarts


def _rows(track: TimeSeries, first: int, last: int) -> Sequence[int]:
    """Which messages are heard: all words and statuses, of numbers the last one."""
    if track.texts or track.statuses:
        return range(first, last)
    return range(max(first, last - 1), last)


def _see_place(bag: Bag, page_state: PageState) -> None:
    found = received_messages(BagScan(bag.path), {topics.PLACE}, namespace=bag.namespace)
    for arrival in found:
        page_state.see(arrival.name, arrival.sample, 0.0, 0.0)
        return


def _remarks(bag: Bag, period: float) -> Iterator[str]:
    if not bag.closed:
        yield "the recorder did not close this bag"
    if bag.damage:
        yield f"{len(bag.damage)} damaged stretches are left out"
    if bag.rejected:
        count = sum(bag.rejected.values())
        yield f"{count} messages break the contract and are left out"
    if _restarts(bag):
        yield "the clock was put back: times are the recorder's"
    if period > PERIOD:
        yield f"shown every {period:.1f} s"


def sample_at(track: TimeSeries, row: int) -> Any:
    """One message of a track, as a sample of the contract again."""
    kind = TOPICS[track.topic].sample
    stamp = int(track.stamp_ns[row]) if len(track.stamp_ns) else 0
    if kind is TextSample:
        return TextSample(track.texts[row])
    if kind is StatusSample:
        return StatusSample(stamp, track.statuses[row])
    if kind is TetherSample:
        return TetherSample(stamp, track.shapes[row])
    if kind is ClockSample:
        return ClockSample(round(float(track.columns["clock"][row]) * 1e9))
    if kind is JointSample:
        return JointSample(stamp, _joints(track, row))
    parts = {
        OdometrySample: (
            ("position", "xyz"),
            ("orientation", "xyzw"),
            ("linear", "xyz"),
            ("angular", "xyz"),
        ),
        WrenchSample: (("force", "xyz"), ("torque", "xyz")),
        ImuSample: (("angular_velocity", "xyz"), ("linear_acceleration", "xyz")),
    }[kind]
    vectors = [
        tuple(float(track.columns[f"{name}.{axis}"][row]) for axis in axes) for name, axes in parts
    ]
    return kind(stamp, *vectors)  # type: ignore[call-arg]


def _joints(track: TimeSeries, row: int) -> dict[str, JointValue]:
    found: dict[str, dict[str, float]] = {}
    for path, column in track.columns.items():
        joint, _, part = path.rpartition(".")
        value = float(column[row])
        if not math.isnan(value):
            found.setdefault(joint, {})[part] = value
    return {joint: JointValue(**parts) for joint, parts in found.items()}
