"""A bag of any length read, measured and drawn within bounded memory.

A bag whose tracks had to be thinned is gone through a second time for its jumps: each is read in
full, measured, drawn where it is among the first, and let go.
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
from rover_bags.analysis.jumps import Jump, flights, is_spatial, jumped, jumps_of, motion
from rover_bags.analysis.metrics import Metrics, measure
from rover_bags.analysis.timeline import Phase, Timeline
from rover_bags.read import Bag, Progress, read_bag, windows
from rover_bags.views.animation import LEAD, TRAIL, Scene, scene_of
from rover_bags.views.plots import Plot, bag_plots, jump_plots
from rover_bags.views.run_plots import run_plots
from rover_bags.views.spatial_scene import spatial_scene

MOST: Final = 1 << 15
"""Messages that a track holds before it is thinned, at least."""
SHOWN_IN_FULL: Final = 6
"""So many jumps get plots and an animation of their own; the table has all."""
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

Reading = Callable[[Path, str], Progress]
"""Gives the progress bar of one pass over a bag: its path and what the pass is for."""


@dataclass(frozen=True)
class Drawings:
    """Everything drawn for a report: made once, used by the page and the files.

    Attributes:
        scenes: What moves, by jump.
        plots: Plots by jump.
        run: What moves in the whole bag, where it has no jump or is of a run in space.
        overall: Plots of the whole bag.
        recording: Plots of how the topics came.
    """

    scenes: tuple[Scene | None, ...]
    plots: tuple[tuple[Plot, ...], ...]
    run: Scene | None
    overall: tuple[Plot, ...]
    recording: tuple[Plot, ...]


@dataclass(frozen=True)
class Survey:
    """A bag with all that is told of it."""

    bag: Bag
    metrics: Metrics
    drawings: Drawings | None


def survey(
    path: Path,
    *,
    namespace: str | None = None,
    drawn: bool = True,
    reading: Reading | None = None,
    most: int = MOST,
) -> Survey:
    """Read, measure and draw a bag.

    Args:
        path: Its folder, or one of its files.
        namespace: Which rover, where the bag holds several.
        drawn: Whether drawings are wanted.
        reading: Makes the progress bar of a pass.
        most: Messages that a track holds before it is thinned, at least.

    Raises:
        BagError: It cannot be read.
    """
    progress = reading(path, "reading") if reading is not None else None
    bag = read_bag(path, namespace=namespace, most=most, progress=progress)
    metrics = measure(bag)
    spans = _spans(bag, metrics.timeline)
    if not bag.thinned or not spans:
        return Survey(bag, metrics, draw(bag, metrics) if drawn else None)
    progress = reading(path, "jumps") if reading is not None else None
    jumps: list[Jump] = []
    audits: list[FlightAudit] = []
    scenes: list[Scene | None] = []
    plots: list[tuple[Plot, ...]] = []
    parts = windows(bag, [flight.span for flight in spans], _OF_JUMPS, progress=progress)
    for part, flight in zip(parts, spans, strict=False):
        timeline = flight.timeline
        found = list(jumps_of(part, metrics.events, timeline))
        if not found:
            continue
        # The stretch may hold others, too.
        jump = min(found, key=partial(_apart, flight.begin_s))
        jumps.append(jump)
        audits += flight_audits(part, timeline)
        if drawn and len(jumps) <= SHOWN_IN_FULL:
            scene = _jump_scene(part, jump)
            scenes.append(scene)
            plots.append(tuple(jump_plots(part, jump, scene)))
            gc.collect()  # figures are rings of references, and each is large
    metrics = replace(
        metrics, jumps=tuple(jumps), audits=replace(metrics.audits, flights=tuple(audits))
    )
    if not drawn:
        return Survey(bag, metrics, None)
    drawings = _overall(bag, metrics)
    return Survey(bag, metrics, replace(drawings, scenes=tuple(scenes), plots=tuple(plots)))


class _Flight(NamedTuple):
    """Where a flight is: log times around it, when it began, and a timeline of it alone."""

    span: tuple[int, int]
    begin_s: float
    timeline: Timeline


def _apart(begin_s: float, jump: Jump) -> float:
    return abs(jump.take_off_s - begin_s)


def _spans(bag: Bag, timeline: Timeline) -> list[_Flight]:
    track = bag.track(topics.TRUTH_BODY1)
    if track is None or len(track) < 3:
        return []
    found = []
    if is_spatial(bag):
        for phase, _ in jumped(timeline):
            alone = replace(timeline, phases=tuple(_around(timeline, phase.log_begin)))
            span = (phase.log_begin - _AROUND_NS, phase.log_end + _AROUND_NS)
            found.append(_Flight(span, phase.begin_s, alone))
    else:
        for first, last, _ in flights(bag, motion(track)):
            after = min(last + 1, len(track) - 1)
            begin, end = int(track.log_ns[first]), int(track.log_ns[after])
            span = (begin - _AROUND_NS, end + _AROUND_NS)
            found.append(_Flight(span, float(track.time[first]), timeline))
    return found


def _around(timeline: Timeline, log_begin: int) -> list[Phase]:
    """The flight that begins at a log time, and the phases beside it."""
    index = next(i for i, phase in enumerate(timeline.phases) if phase.log_begin == log_begin)
    kept = timeline.phases[max(0, index - 1) : index + 2]
    return [p for p in kept if p.log_begin == log_begin or p.what != timeline.phases[index].what]


# --- drawings -------------------------------------------------------------------------------------


def draw(bag: Bag, metrics: Metrics) -> Drawings:
    """Draws the first jumps and the whole of a bag that is held in full."""
    jumps = metrics.jumps[:SHOWN_IN_FULL]
    scenes = tuple(_jump_scene(bag, jump) for jump in jumps)
    plots = tuple(
        tuple(jump_plots(bag, jump, scene)) for jump, scene in zip(jumps, scenes, strict=True)
    )
    return replace(_overall(bag, metrics), scenes=scenes, plots=plots)


def _overall(bag: Bag, metrics: Metrics) -> Drawings:
    spatial = is_spatial(bag)
    run: Scene | None = None
    if spatial:
        run = spatial_scene(bag)
    elif not metrics.jumps:
        run = scene_of(bag, None)
    overall = run_plots(bag, metrics) if spatial else []
    return Drawings((), (), run, tuple(overall), tuple(bag_plots(bag, metrics)))


def _jump_scene(bag: Bag, jump: Jump) -> Scene | None:
    if not is_spatial(bag):
        return scene_of(bag, jump)
    end = jump.take_off_s + jump.flight_time_s + TRAIL
    return spatial_scene(
        bag, jump.take_off_s - LEAD, end, since=jump.take_off_s, level=jump.start_height_m
    )
