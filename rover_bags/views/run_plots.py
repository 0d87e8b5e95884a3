"""Plots of a whole run: activities, winch, swing, images, path on the floor, audits."""

from __future__ import annotations

from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from msg_schemas import machine, topics
from rover_bags.analysis.activities import hanging_swing
from rover_bags.analysis.audits import STORED, rotors_of
from rover_bags.analysis.geometry import inside
from rover_bags.analysis.metrics import Metrics
from rover_bags.analysis.timeline import Activity, TimelineEventKind
from rover_bags.analysis.wall_coverage import observations_of
from rover_bags.reading.read import Bag, TimeSeries
from rover_bags.views.coverage_plot import draw_coverage
from rover_bags.views.lines import envelope
from rover_bags.views.plots import (
    BLACK,
    BLUE,
    BROWN,
    GREEN,
    ORANGE,
    PINK,
    PURPLE,
    RED,
    SKY,
    STYLE,
    TEAL,
    YELLOW,
    Plot,
    as_svg,
    legend,
)

COLOURS: Final = {
    Activity.HANGING: "#c9d3dc", Activity.DESCENDING: BLUE, Activity.ASCENDING: SKY,
    Activity.STANDING: "#d9cdb8", Activity.SLACK: BROWN, Activity.DRIVING: GREEN,
    Activity.TURNING: "#7fc97f", Activity.COMPRESSING: YELLOW, Activity.FLIGHT: ORANGE,
}  # fmt: skip
"""Colour of each activity in all plots."""
_ROTOR_COLOURS: Final = {
    "flywheel": BLUE, machine.WHEEL_LEFT: GREEN, machine.WHEEL_RIGHT: PINK,
}  # fmt: skip
_WIDE: Final = 11.4
_LEFT, _WIDTH = 0.068, 0.915
_DEFLECTED: Final = 1e-3
_HEAD: Final = 0.62
"""Height of a plot's title and legend [inch]."""


def run_plots(bag: Bag, metrics: Metrics) -> list[Plot]:
    """Draw every plot of a whole run for which the bag holds the data."""
    with mpl.rc_context(STYLE):
        plots = [
            _timeline(bag, metrics),
            _winch(bag, metrics),
            _swing(bag, metrics),
            _images(bag),
            _coverage(bag),
            _floor(bag, metrics),
            _energy_balance(bag),
            _rotors(bag),
        ]
    return [plot for plot in plots if plot is not None]


def _line(axes: Axes, series: TimeSeries, path: str, scale: float = 1.0, **style: Any) -> None:
    low, high = series.lowest(path), series.highest(path)
    if scale != 1.0:
        low, high = (scale * low, scale * high) if scale > 0.0 else (scale * high, scale * low)
        if series.stride == 1:
            high = low
    axes.plot(*envelope(series.time, low, high), **style)


# --- figures with one or more axes over the run's time --------------------------------------------


def _rows(name: str, title: str, heights: tuple[float, ...], top: float = 0.62) -> tuple[
    Figure, list[Axes]
]:  # fmt: skip
    """Axes below one another, each with ``top`` inches for its legend."""
    bottom = 0.5
    head = max(_HEAD - top, 0.0)
    tall = head + sum(heights) + len(heights) * top + bottom
    figure = Figure(figsize=(_WIDE, tall))
    figure.set_label(name)
    found: list[Axes] = []
    at = tall - head
    for height in heights:
        at -= top + height
        box = (_LEFT, at / tall, _WIDTH, height / tall)
        axes = figure.add_axes(box, sharex=found[0] if found else None)
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.yaxis.set_label_coords(-0.048, 0.5)
        found.append(axes)
    found[0].set_title(title, pad=24, x=-0.062)
    for axes in found[:-1]:
        axes.tick_params(labelbottom=False)
    found[-1].set_xlabel("simulated time [s]")
    return figure, found


def _plot(figure: Figure, axes: list[Axes], alt: str, bag: Bag) -> Plot:
    begin, end = _span(bag)
    axes[0].set_xlim(begin, end)
    box = axes[0].get_position()
    return Plot(str(figure.get_label()), as_svg(figure), alt, box.x0, box.x1, begin, end, wide=True)


def _span(bag: Bag) -> tuple[float, float]:
    """Start and end of the run [s], the same in every plot."""
    for name in (topics.CLOCK, topics.TRUTH_BODY1, topics.WINCH_STATE, topics.CONTACT):
        series = bag.series(name)
        if series is not None and len(series) > 1:
            return float(series.time.min()), float(series.time.max())
    times = [series.time for series in bag.time_series.values() if len(series)]
    return min(float(t.min()) for t in times), max(float(t.max()) for t in times)


def _shade(axes: Axes, metrics: Metrics) -> None:
    """Shade the activities in the background."""
    for interval in metrics.timeline.intervals:
        if interval.activity not in {Activity.HANGING, Activity.STANDING}:
            axes.axvspan(
                interval.begin_s,
                interval.end_s,
                color=COLOURS[interval.activity],
                alpha=0.1,
                lw=0,
                zorder=0,
            )


def _timeline(bag: Bag, metrics: Metrics) -> Plot | None:
    intervals = metrics.timeline.intervals
    body, drum = bag.series(topics.TRUTH_BODY1), bag.series(topics.WINCH_STATE)
    if not intervals or (body is None and drum is None):
        return None
    figure, (strip, depth) = _rows("timeline", "Activities and height", (0.42, 2.0), top=0.5)
    for interval in intervals:
        strip.axvspan(interval.begin_s, interval.end_s, color=COLOURS[interval.activity], lw=0)
    strip.set_yticks([])
    strip.grid(visible=False)
    for spine in strip.spines.values():
        spine.set_visible(False)
    seen = dict.fromkeys(interval.activity for interval in intervals)
    strip.legend(
        handles=[Patch(color=COLOURS[what], label=what.value) for what in seen],
        loc="lower left", bbox_to_anchor=(-0.005, 1.0), ncol=9, handlelength=1.0,
        columnspacing=1.2, handletextpad=0.5, borderaxespad=0.0,
    )  # fmt: skip
    if body is not None:
        _line(depth, body, "position.z", color=BLUE, label="Body 1", lw=1.6)
        depth.set_ylabel("z [m]")
    elif drum is not None:
        _line(
            depth,
            drum,
            f"{machine.WINCH_DRUM}.position",
            -1.0,
            color=BLUE,
            label="tether length at the drum",
            lw=1.6,
        )
        depth.set_ylabel("-length [m]")
    depth.margins(y=0.1)
    _mark(depth, metrics)
    legend(depth, 8)
    return _plot(figure, [strip, depth], "Activities and height over time", bag)


_MARKS: Final = {
    TimelineEventKind.TOUCHDOWN: ("v", GREEN, "touchdown"),
    TimelineEventKind.LIFT_OFF: ("^", TEAL, "lift-off"),
    TimelineEventKind.TAKE_OFF: ("^", ORANGE, "take-off"),
    TimelineEventKind.LANDING: ("v", ORANGE, "landing"),
    TimelineEventKind.WARNING: ("P", BROWN, "warning"),
    TimelineEventKind.FAULT: ("X", RED, "fault"),
}


def _mark(axes: Axes, metrics: Metrics) -> None:
    for kind, (sign, colour, label) in _MARKS.items():
        times = [m.time_s for m in metrics.timeline.events if m.kind is kind]
        if times:
            axes.plot(
                times, np.full(len(times), 0.96), sign, color=colour, ms=7, label=label,
                transform=axes.get_xaxis_transform(), clip_on=False, ls="none",
            )  # fmt: skip
            for time in times[:60]:
                axes.axvline(time, color=colour, lw=0.8, alpha=0.5, zorder=0)


def _winch(bag: Bag, metrics: Metrics) -> Plot | None:
    drum, cell = bag.series(topics.WINCH_STATE), bag.series(topics.LOAD_CELL)
    if drum is None or not metrics.descents:
        return None
    estimate, rover = bag.series(topics.WINCH_ESTIMATE), bag.series(topics.ROVER_LOAD_CELL)
    heights = (1.6, 1.2, 1.5) if cell is not None else (1.6, 1.2)
    figure, rows = _rows("winch", "Winch and tether", heights, top=0.42)
    length, rate = rows[0], rows[1]
    _line(
        length,
        drum,
        f"{machine.WINCH_DRUM}.position",
        color=BLUE,
        label="tether length at the drum",
    )
    _line(
        rate,
        drum,
        f"{machine.WINCH_DRUM}.velocity",
        color=BLUE,
        label="payout rate at the drum",
        lw=1.2,
    )
    if estimate is not None:
        style: dict[str, Any] = {"color": ORANGE, "ls": "--", "lw": 1.2}
        _line(length, estimate, f"{machine.REFERENCE}.position", label="reference", **style)
        _line(rate, estimate, f"{machine.REFERENCE}.velocity", label="reference", **style)
    length.set_ylabel("length [m]")
    length.invert_yaxis()
    rate.set_ylabel("rate [m/s]")
    if cell is not None:
        for series, colour, label in (
            (cell, BLUE, "at the fairlead"),
            (rover, ORANGE, "at the rover"),
        ):
            if series is not None:
                size = np.linalg.norm(series.vector("force"), axis=1)
                most = series.largest("force") if series.stride > 1 else size
                rows[2].plot(
                    *envelope(series.time, size, most),
                    color=colour,
                    label=label,
                    lw=1.0,
                    alpha=0.85,
                )
        rows[2].set_ylabel("tension [N]")
    for axes in rows:
        _shade(axes, metrics)
        legend(axes, 3)
    return _plot(figure, rows, "Length, rate and tension of the tether over time", bag)


def _swing(bag: Bag, metrics: Metrics) -> Plot | None:
    swing = hanging_swing(bag, metrics.timeline)
    if swing is None:
        return None
    time, angle = swing
    if not np.isfinite(angle).any() or np.nanmax(angle) < _DEFLECTED:
        return None
    figure, (axes,) = _rows("swing", "Swing angle of the hanging rover, from the vertical", (1.6,))
    degrees = np.degrees(angle)
    axes.plot(*envelope(time, degrees, degrees), color=PURPLE, lw=1.0, label="Body 1")
    axes.set_ylabel("angle [deg]")
    axes.set_ylim(bottom=0.0)
    _shade(axes, metrics)
    legend(axes, 1)
    return _plot(figure, [axes], "Swing angle over time", bag)


def _images(bag: Bag) -> Plot | None:
    camera = bag.series(topics.CAMERA)
    if camera is None:
        return None
    wall = camera.columns[f"{machine.WALL_DISTANCE}.position"]
    sees = wall < machine.NO_WALL
    if sees.sum() < 10:
        return None
    figure, (axes,) = _rows("pictures", "Motion smear of the wall images", (1.7,))
    smear = camera.columns[f"{machine.SMEAR}.position"]
    axes.plot(
        camera.time[sees], np.maximum(smear[sees], 1e-3), ".", ms=2.5, color=BLUE,
        label="images of the wall", rasterized=bool(sees.sum() > 4000),
    )  # fmt: skip
    limit = machine.SHARP_SMEAR
    axes.axhline(limit, color=RED, lw=1.0, ls="--", label=f"limit {limit:.2g} px")
    axes.set_yscale("log")
    axes.set_ylabel("smear [px]")
    legend(axes, 2)
    return _plot(figure, [axes], "Motion smear of the images over time", bag)


def _coverage(bag: Bag) -> Plot | None:
    """Footprints on the wall of the images that the descent has logged."""
    series = bag.series(topics.DESCENT_OBSERVATION)
    figure = None if series is None else draw_coverage(observations_of(series))
    if figure is None:
        return None
    alt = "Footprints of images on the unrolled wall, over heading and depth"
    return Plot(str(figure.get_label()), as_svg(figure), alt, wide=True)


# --- path on the floor ----------------------------------------------------------------------------


def _floor(bag: Bag, metrics: Metrics) -> Plot | None:
    body = bag.series(topics.TRUTH_BODY1)
    moves = metrics.timeline.of(Activity.DRIVING, Activity.TURNING, Activity.FLIGHT)
    if body is None or not moves or not (metrics.drives or metrics.jumps):
        return None
    figure = Figure(figsize=(5.6, 4.6))
    figure.set_label("floor")
    axes = figure.add_axes((0.13, 0.11, 0.84, 0.72))
    axes.set_title("Path on the floor, seen from above", pad=26, x=-0.128)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x, forward from the fairlead [m]")
    axes.set_ylabel("y, left [m]")
    place = body.vector("position")
    labelled = set()
    for interval in moves:
        part = inside(
            body, interval.begin_s, interval.end_s, (interval.log_begin, interval.log_end)
        )
        if len(part) < 2:
            continue
        label = interval.activity.value if interval.activity not in labelled else None
        labelled.add(interval.activity)
        style = "--" if interval.activity is Activity.FLIGHT else "-"
        some = part[:: max(1, len(part) // 400)]
        axes.plot(
            place[some, 0],
            place[some, 1],
            style,
            color=COLOURS[interval.activity],
            lw=2.4,
            label=label,
        )
    first = inside(body, moves[0].begin_s, moves[0].begin_s + 0.1, (moves[0].log_begin,) * 2)
    last = inside(body, moves[-1].end_s - 0.1, moves[-1].end_s, (moves[-1].log_end,) * 2)
    for part, sign, label in ((first[:1], "o", "start"), (last[-1:], "s", "end")):
        if len(part):
            axes.plot(
                place[part, 0], place[part, 1], sign, color=BLACK, ms=6, label=label, zorder=5
            )
    axes.margins(0.12)
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncol=5, handlelength=1.4,
        columnspacing=1.0, handletextpad=0.5, borderaxespad=0.0,
    )  # fmt: skip
    return Plot("floor", as_svg(figure), "Path of Body 1 on the floor, seen from above")


_SHARES = (
    ("of input: driven ends", "driven_ends.position", GREEN),
    ("of dissipated: air", "air_drag.position", BLUE),
    ("of stored: bending", "bending.position", PINK),
    ("of stored: twist", "twist.position", PURPLE),
)
"""Parts of the energy balance by their labels, drawn where they are visible beside its sums."""
_VISIBLE = 0.02

# --- audits ---------------------------------------------------------------------------------------


def _energy_balance(bag: Bag) -> Plot | None:
    series = bag.series(topics.TRUTH_ENERGY)
    if series is None or len(series) < 2:
        return None
    parts = {name: series.columns[f"{name}.position"] for name in (*STORED, "input", "dissipated")}
    stored = np.sum([parts[name] for name in STORED], axis=0)
    lines = {
        "input": (parts["input"], BLACK),
        "dissipated": (parts["dissipated"], SKY),
        "stored": (stored, ORANGE),
    }
    largest = max(float(np.ptp(values)) for values, _ in lines.values())
    shares = {
        label: (series.columns[path], colour)
        for label, path, colour in _SHARES
        if path in series.columns and np.ptp(series.columns[path]) > _VISIBLE * largest
    }
    figure, (axes, residual) = _rows(
        "energy_balance", "Energy change since the start", (1.7, 1.0), top=0.46
    )
    for name, (values, colour) in lines.items():
        change = values - values[0]
        axes.plot(*envelope(series.time, change, change), color=colour, label=name, lw=1.6)
    for name, (values, colour) in shares.items():
        change = values - values[0]
        axes.plot(*envelope(series.time, change, change), "--", color=colour, label=name, lw=1.2)
    axes.set_ylabel("energy [J]")
    rest = lines["stored"][0] - lines["input"][0] + lines["dissipated"][0]
    rest = 1e3 * (rest - rest[0])
    residual.plot(
        *envelope(series.time, rest, rest), color=RED, lw=1.2, label="stored - input + dissipated"
    )
    residual.set_ylabel("residual [mJ]")
    legend(axes, len(lines) + len(shares))
    legend(residual, 1)
    return _plot(figure, [axes, residual], "Energy put in, stored and dissipated over time", bag)


def _rotors(bag: Bag) -> Plot | None:
    moving = [
        (series, rotor)
        for rotor in rotors_of(bag)
        if (series := bag.series(rotor.topic)) is not None
        and np.ptp(series.columns[rotor.path]) > 0.0
    ]
    if not moving:
        return None
    figure, (axes,) = _rows("rotors", "Angular momentum of flywheel and wheels", (1.6,))
    for series, rotor in moving:
        style = {"color": _ROTOR_COLOURS[rotor.name], "label": rotor.name.replace("_", " ")}
        _line(axes, series, rotor.path, rotor.inertia, lw=1.2, **style)
    axes.set_ylabel("momentum [N m s]")
    legend(axes, 4)
    return _plot(figure, [axes], "Angular momentum of flywheel and wheels over time", bag)
