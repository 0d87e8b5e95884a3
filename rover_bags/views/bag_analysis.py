"""Read, measure and draw a bag of any length in bounded memory.

If time series had to be thinned, a second pass reads each jump in full, measures it, draws the
first few and releases the data.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from msg_schemas import topics
from rover_bags.analysis.audits import FlightAudit, flight_audits
from rover_bags.analysis.jumps import RecordedJump, flights, is_spatial, jumped, jumps_of, motion
from rover_bags.analysis.metrics import Metrics, measure
from rover_bags.analysis.timeline import ActivityInterval, Timeline
from rover_bags.reading.read import Bag, Progress, read_bag, windows
from rover_bags.views.animation import LEAD, TRAIL, MovingScene, scene_of
from rover_bags.views.plots import Plot, bag_plots, jump_plots
from rover_bags.views.run_plots import run_plots
from rover_bags.views.spatial_scene import spatial_scene

MAX_MESSAGES: Final = 1 << 15
"""Smallest number of messages that a series holds before it is thinned."""
SHOWN_IN_FULL: Final = 6
"""Number of jumps with plots and an animation of their own; the table lists all."""
_AROUND_NS: Final = 3_000_000_000
_OF_JUMPS: Final = (
    topics.TRUTH_BODY1,
    topics.TRUTH_BODY2,
    topics.TRUTH_TETHER,
    topics.TRUTH_ENERGY,
    topics.LOAD_CELL,
    topics.ROVER_LOAD_CELL,
    topics.FLYWHEEL_STATE,
    topics.WHEEL_STATE,
    topics.CONTACT,
)

ProgressFactory = Callable[[Path, str], Progress]
"""Creates the progress callback of one pass, from the bag's path and the name of the pass."""


@dataclass(frozen=True)
class Drawings:
    """All drawings of a report, shared by the page and the files.

    Attributes:
        scenes: Animated scene of each jump.
        plots: Plots of each jump.
        run: Animated scene of the whole bag, of a spatial run or of a bag without a jump.
        overall: Plots of the whole run.
        recording: Plots of the topics' rates and gaps.
    """

    scenes: tuple[MovingScene | None, ...]
    plots: tuple[tuple[Plot, ...], ...]
    run: MovingScene | None
    overall: tuple[Plot, ...]
    recording: tuple[Plot, ...]


@dataclass(frozen=True)
class BagAnalysis:
    """A bag with its metrics and, if requested, its drawings."""

    bag: Bag
    metrics: Metrics
    drawings: Drawings | None


def analyse_bag(
    path: Path,
    *,
    namespace: str | None = None,
    with_drawings: bool = True,
    progress_factory: ProgressFactory | None = None,
    max_messages: int = MAX_MESSAGES,
) -> BagAnalysis:
    """Read, measure and draw a bag.

    Args:
        path: The bag's folder, or one of its files.
        namespace: Namespace of the rover, if the bag holds several.
        with_drawings: Whether to make drawings.
        progress_factory: Creates the progress callback of a pass.
        max_messages: Smallest number of messages that a series holds before it is thinned.

    Raises:
        BagError: The bag cannot be read.
    """
    progress = progress_factory(path, "reading") if progress_factory is not None else None
    bag = read_bag(path, namespace=namespace, max_messages=max_messages, progress=progress)
    metrics = measure(bag)
    spans = _spans(bag, metrics.timeline)
    if not bag.thinned or not spans:
        return BagAnalysis(bag, metrics, draw(bag, metrics) if with_drawings else None)
    progress = progress_factory(path, "jumps") if progress_factory is not None else None
    jumps: list[RecordedJump] = []
    audits: list[FlightAudit] = []
    scenes: list[MovingScene | None] = []
    plots: list[tuple[Plot, ...]] = []
    parts = windows(bag, [flight.span for flight in spans], _OF_JUMPS, progress=progress)
    for part, flight in zip(parts, spans, strict=False):
        timeline = flight.timeline
        found = list(jumps_of(part, metrics.events, timeline))
        if not found:
            continue
        # The time window may hold other jumps.
        jump = min(found, key=partial(_apart, flight.begin_s))
        jumps.append(jump)
        audits += flight_audits(part, timeline)
        if with_drawings and len(jumps) <= SHOWN_IN_FULL:
            scene, drawn = _draw_jump(part, jump)
            scenes.append(scene)
            plots.append(drawn)
            gc.collect()  # matplotlib figures are large and form reference cycles
    metrics = replace(
        metrics, jumps=tuple(jumps), audits=replace(metrics.audits, flights=tuple(audits))
    )
    if not with_drawings:
        return BagAnalysis(bag, metrics, None)
    drawings = _overall(bag, metrics)
    return BagAnalysis(bag, metrics, replace(drawings, scenes=tuple(scenes), plots=tuple(plots)))


class _Flight(NamedTuple):
    """Log times [ns] around a flight, its start [s], and a timeline of this flight only."""

    span: tuple[int, int]
    begin_s: float
    timeline: Timeline


def _apart(begin_s: float, jump: RecordedJump) -> float:
    return abs(jump.take_off_s - begin_s)


def _spans(bag: Bag, timeline: Timeline) -> list[_Flight]:
    series = bag.series(topics.TRUTH_BODY1)
    if series is None or len(series) < 3:
        return []
    found = []
    if is_spatial(bag):
        for interval, _ in jumped(timeline):
            alone = replace(timeline, intervals=tuple(_around(timeline, interval.log_begin)))
            span = (interval.log_begin - _AROUND_NS, interval.log_end + _AROUND_NS)
            found.append(_Flight(span, interval.begin_s, alone))
    else:
        for first, last, _ in flights(bag, motion(series)):
            after = min(last + 1, len(series) - 1)
            begin, end = int(series.log_ns[first]), int(series.log_ns[after])
            span = (begin - _AROUND_NS, end + _AROUND_NS)
            found.append(_Flight(span, float(series.time[first]), timeline))
    return found


def _around(timeline: Timeline, log_begin: int) -> list[ActivityInterval]:
    """The flight that begins at a log time, and its neighbouring intervals."""
    index = next(
        i for i, interval in enumerate(timeline.intervals) if interval.log_begin == log_begin
    )
    kept = timeline.intervals[max(0, index - 1) : index + 2]
    return [
        p
        for p in kept
        if p.log_begin == log_begin or p.activity != timeline.intervals[index].activity
    ]


# --- drawings -------------------------------------------------------------------------------------


def draw(bag: Bag, metrics: Metrics) -> Drawings:
    """Draw the first jumps and the whole run of a bag that is held in full."""
    drawn = [_draw_jump(bag, jump) for jump in metrics.jumps[:SHOWN_IN_FULL]]
    scenes, plots = zip(*drawn, strict=True) if drawn else ((), ())
    return replace(_overall(bag, metrics), scenes=scenes, plots=plots)


def _overall(bag: Bag, metrics: Metrics) -> Drawings:
    spatial, first = is_spatial(bag), bag.run_at(bag.start_ns)
    run: MovingScene | None = None
    if spatial:
        run = spatial_scene(first)
    elif not metrics.jumps:
        run = scene_of(first, None)
    overall = run_plots(bag, metrics) if spatial else []
    return Drawings((), (), run, tuple(overall), tuple(bag_plots(bag, metrics)))


def _draw_jump(bag: Bag, jump: RecordedJump) -> tuple[MovingScene | None, tuple[Plot, ...]]:
    run = bag.run_at(jump.log_ns)
    scene = _jump_scene(run, jump)
    return scene, tuple(jump_plots(run, jump, scene))


def _jump_scene(bag: Bag, jump: RecordedJump) -> MovingScene | None:
    if not is_spatial(bag):
        return scene_of(bag, jump)
    end = jump.take_off_s + jump.flight_time_s + TRAIL
    return spatial_scene(
        bag, jump.take_off_s - LEAD, end, since=jump.take_off_s, level=jump.start_height_m
    )
