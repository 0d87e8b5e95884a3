"""A bag as the page replays it: the frames that a live page would have shown, and the journal.

Telemetry and page state process the bag's samples as they process live ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
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
from operator_console.liveness import DEAD_AFTER
from operator_console.page_state import PAGE_TOPICS, JournalEntry, PageState, frame
from operator_console.scene import DEFAULT_MACHINE
from operator_console.telemetry import Snapshot, Telemetry
from rover_bags.files.scan import BagScan
from rover_bags.reading.read import Bag, Floats, TimeSeries, read_bag, received_messages

PERIOD: Final = 0.1
"""Time between the frames of a short bag [s]."""
MOST_FRAMES: Final = 3000
_LARGE: Final = 256 * 1024 * 1024  # [B]
_MOST_ROWS: Final = 20_000
_MOST_ENTRIES: Final = 2000


@dataclass(frozen=True)
class Replay:
    """What the page needs to replay a bag, in plain values.

    Attributes:
        name: name of the bag.
        frames: in order of time; unchanged ``parts``, ``health`` and ``commands`` are omitted.
        journal: events and refusals.
        place: geometry of the place.
        machine: sizes of the rover.
        remarks: what is missing or damaged.
    """

    name: str
    frames: tuple[dict[str, Any], ...]
    journal: tuple[dict[str, Any], ...]
    place: dict[str, Any] | None
    machine: dict[str, Any]
    remarks: tuple[str, ...]


def read_state(path: Path, at: float = math.inf, namespace: str | None = None) -> Snapshot:
    """Read the state that a bag holds at a time, as operators see it.

    Args:
        path: the bag.
        at: time on the bag's axis [s]; after its end = the end.
        namespace: of the rover, if the bag holds several.

    Raises:
        BagError: it cannot be read.
        ValueError: it holds no topic that is shown, or begins later.
    """
    bag, axes = _read_shown(path, namespace)
    begin, end = _span(axes)
    if at < begin:
        raise ValueError(f"the bag {path.name} begins at {begin:.1f} s, after {at:g} s")
    telemetry = Telemetry(_patience(bag, begin, end))
    steady = {name: _reception(bag, axis) for name, axis in axes.items()}
    arrivals = [
        (float(axis[row]), float(steady[name][row]), name, row)
        for name, axis in axes.items()
        for row in _received(bag.time_series[name], 0, int(np.searchsorted(axis, at, side="right")))
    ]
    for _, arrival, name, row in sorted(arrivals, key=itemgetter(0)):
        telemetry.on_sample(name, sample_at(bag.time_series[name], row), arrival)
    return telemetry.snapshot(float(_reception(bag, np.array([min(at, end)]))[0]))


def _span(axes: Mapping[str, Floats]) -> tuple[float, float]:
    """First and last time [s]."""
    first, last = min(map(np.min, axes.values())), max(map(np.max, axes.values()))
    return float(first), float(last)


def _patience(bag: Bag, begin: float, end: float) -> float:
    """Gap between samples up to which a source lives [s]: a large bag is read with fewer."""
    received = float(np.ptp(_reception(bag, np.array([begin, end]))))
    return max(DEAD_AFTER, 3.0 * max(end - begin, received) / _MOST_ROWS)


def _read_shown(path: Path, namespace: str | None = None) -> tuple[Bag, dict[str, Floats]]:
    """Read what the page shows of a bag, and the time axis of each topic."""
    bag = _read(path, namespace)
    axes = {
        name: _time_axis(bag, series) for name, series in bag.time_series.items() if len(series)
    }
    if not axes:
        raise ValueError(f"the bag {path.name} has no topic that the page shows")
    return bag, axes


def read_replay(path: Path, most_frames: int = MOST_FRAMES) -> Replay:
    """Read a bag for replay.

    Args:
        path: the bag.
        most_frames: largest number of frames; a longer bag has a longer frame period.

    Raises:
        BagError: it cannot be read.
        ValueError: it holds no topic of the page.
    """
    bag, axes = _read_shown(path)
    page_state = PageState()
    if topics.PLACE in bag.full_names:
        _read_place(bag, page_state)
    begin, end = _span(axes)
    telemetry = Telemetry(_patience(bag, begin, end))
    period = max(PERIOD, (end - begin) / max(1, most_frames - 1))
    count = math.floor((end - begin) / period) + 1
    times = np.array([begin + (index + 1) * period for index in range(count)])
    steady = {name: _reception(bag, axis) for name, axis in axes.items()}
    pointers = dict.fromkeys(axes, 0)
    frames: list[dict[str, Any]] = []
    journal: list[JournalEntry] = []
    before: dict[str, Any] = {}
    for time, now in zip(times.tolist(), _reception(bag, times).tolist(), strict=True):
        arrivals_now = []
        for name, axis in axes.items():
            first, last = pointers[name], int(np.searchsorted(axis, time, side="right"))
            pointers[name] = last
            arrivals_now += [
                (float(axis[row]), float(steady[name][row]), name, row)
                for row in _received(bag.time_series[name], first, last)
            ]
        for at, arrival, name, row in sorted(arrivals_now, key=itemgetter(0)):
            sample = sample_at(bag.time_series[name], row)
            telemetry.on_sample(name, sample, arrival)
            journal += page_state.on_sample(name, sample, arrival, at)
        made = frame(telemetry.snapshot(now), page_state, now, time)
        del made["obstacles"]  # a replay moves nothing
        components = {key: made[key] for key in ("parts", "health", "commands")}
        for key, value in components.items():
            if before.get(key) == value:
                del made[key]
        before = components
        frames.append(made)
    return Replay(
        path.name,
        tuple(frames),
        tuple(entry.as_dict() for entry in journal[-_MOST_ENTRIES:]),
        page_state.place,
        page_state.machine or dict(DEFAULT_MACHINE),
        tuple(_remarks(bag, period)),
    )


def _read(path: Path, namespace: str | None) -> Bag:
    """Read the bag; of a large one fewer numbers, but every status."""
    required = [topic for topic in PAGE_TOPICS if TOPICS[topic].sample is not DrawingSample]
    files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
    if sum(file.stat().st_size for file in files) < _LARGE:
        return read_bag(path, required, namespace=namespace)
    coarse = read_bag(path, required, namespace=namespace, max_messages=_MOST_ROWS)
    statuses = [topic for topic in required if TOPICS[topic].sample is StatusSample]
    fine = read_bag(path, statuses, namespace=namespace)
    return replace(coarse, time_series={**coarse.time_series, **fine.time_series})


def _time_axis(bag: Bag, series: TimeSeries) -> Floats:
    """Times of the messages on the replay's axis [s], non-decreasing.

    Simulated time if it never restarts, else the recorder's time.
    """
    restarts = _restarts(bag)
    if restarts == 0 and TOPICS[series.topic].sample is not StatusSample:
        times: Floats = np.maximum.accumulate(series.time)
        return times
    if restarts == 0 and bag.clock is not None:
        unstamped = np.zeros_like(series.log_ns)
        return np.maximum.accumulate(bag.clock.times(unstamped, series.log_ns))
    return np.asarray((series.log_ns - bag.start_ns) * 1e-9)


def _reception(bag: Bag, times: Floats) -> Floats:
    """Steady times [s] of times on the replay's axis, by which ages and silences count.

    Simulated time may run faster or slower than the health reports of nodes by the wall clock.
    """
    if bag.clock is None or _restarts(bag):
        return times
    return bag.clock.reception(times)


def _restarts(bag: Bag) -> int:
    """Number of times that simulated time was set back."""
    timing = bag.timings.get(topics.CLOCK)
    return 0 if timing is None else timing.restarts


def _received(series: TimeSeries, first: int, last: int) -> Sequence[int]:
    """Messages to process: every text and status, only the last of the numbers."""
    if series.texts or series.statuses:
        return range(first, last)
    return range(max(first, last - 1), last)


def _read_place(bag: Bag, page_state: PageState) -> None:
    found = received_messages(BagScan(bag.path), {topics.PLACE}, namespace=bag.namespace)
    for arrival in found:
        page_state.on_sample(arrival.name, arrival.sample, 0.0, 0.0)
        return


def _remarks(bag: Bag, period: float) -> Iterator[str]:
    if not bag.closed:
        yield "the recorder did not close this bag"
    if bag.damage:
        yield f"{len(bag.damage)} damaged parts are omitted"
    if bag.rejected:
        count = sum(bag.rejected.values())
        yield f"{count} messages break the contract and are omitted"
    if _restarts(bag):
        yield "simulated time restarts: times are the recorder's"
    if period > PERIOD:
        yield f"one frame per {period:.1f} s"


def sample_at(series: TimeSeries, row: int) -> Any:
    """Convert one message of a time series to a sample of the contract."""
    kind = TOPICS[series.topic].sample
    stamp = int(series.stamp_ns[row]) if len(series.stamp_ns) else 0
    if kind is TextSample:
        return TextSample(series.texts[row])
    if kind is StatusSample:
        return StatusSample(stamp, series.statuses[row])
    if kind is TetherSample:
        return TetherSample(stamp, series.shapes[row])
    if kind is ClockSample:
        return ClockSample(round(float(series.columns["clock"][row]) * 1e9))
    if kind is JointSample:
        return JointSample(stamp, _joints(series, row))
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
        tuple(float(series.columns[f"{name}.{axis}"][row]) for axis in axes) for name, axes in parts
    ]
    return kind(stamp, *vectors)  # type: ignore[call-arg]


def _joints(series: TimeSeries, row: int) -> dict[str, JointValue]:
    found: dict[str, dict[str, float]] = {}
    for path, column in series.columns.items():
        joint, _, part = path.rpartition(".")
        value = float(column[row])
        if not math.isnan(value):
            found.setdefault(joint, {})[part] = value
    return {joint: JointValue(**parts) for joint, parts in found.items()}
