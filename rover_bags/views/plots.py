"""Plots of a bag as SVG, drawn by matplotlib for inclusion in a page.

Colours are those of Okabe and Ito, which colour-blind readers can distinguish. Legends stand above
the axes and never cover data.
"""

import io
import math
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from msg_schemas import topics
from msg_schemas.samples import TETHER_COLUMNS
from msg_schemas.specifications import Intent
from msg_schemas.table import TOPICS
from rover_bags.analysis.geometry import headings, tilts
from rover_bags.analysis.jumps import MotionSeries, RecordedJump, is_spatial, motion
from rover_bags.analysis.metrics import Metrics
from rover_bags.reading.read import Bag, Floats, TimeSeries
from rover_bags.reading.time_series import GAP, LARGEST, pacing_times, typical_period
from rover_bags.views.animation import (
    LEAD,
    TRAIL,
    MovingScene,
    element_curve,
    shown,
    tension_scale_max,
)
from rover_bags.views.lines import envelope

BLUE, ORANGE, GREEN, PINK, SKY, YELLOW, RED, BLACK = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#b8860b", "#a50026", "#212529",
)  # fmt: skip
TEAL, PURPLE, BROWN = "#117a8b", "#6a3d9a", "#7f4f24"
_ENERGY_COLOURS: Final = {
    "kinetic": BLUE, "rotors": TEAL, "gravity": ORANGE, "axial": GREEN, "bending": PINK,
    "twist": PURPLE, "spring": YELLOW, "contact": BROWN, "input": BLACK, "dissipated": SKY,
}  # fmt: skip
_FONT: Final = "DejaVu Sans"
_PAGE_FONTS: Final = "system-ui, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
STYLE: Final[Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "mother_rover",
    "font.family": _FONT,
    "font.size": 10.0,
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": BLACK,
    "axes.edgecolor": "#868e96",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": BLACK,
    "xtick.color": "#495057",
    "ytick.color": "#495057",
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "lines.linewidth": 1.8,
}
_TENSION: Final = TETHER_COLUMNS.index("tension")
_PATH_SIZE: Final = (11.4, 5.0)


@dataclass(frozen=True)
class Plot:
    """One drawing.

    Attributes:
        name: Identifier for the page.
        svg: The drawing, without external resources.
        left, right: Ends of the time axis, as fractions of the drawing's width; both 0 for
            drawings without a time axis.
        begin, end: Times at these ends [s].
        wide: Whether it takes the full width of the page.
        alt: Text alternative.
    """

    name: str
    svg: str
    alt: str
    left: float = 0.0
    right: float = 0.0
    begin: float = 0.0
    end: float = 0.0
    wide: bool = False


def jump_plots(bag: Bag, jump: RecordedJump, scene: MovingScene | None) -> list[Plot]:
    """Draw height, attitude, tension and energy over a jump, and its path in the plane."""
    with mpl.rc_context(STYLE):
        plots = [
            _height(bag, jump),
            _attitude(bag, jump),
            _tension(bag, jump),
            _energy(bag, jump),
            _drift(bag, jump),
            _along(bag, jump),
        ]
        if scene is not None and not scene.follow:
            plots.append(_path(scene, jump))
    return [plot for plot in plots if plot is not None]


def bag_plots(bag: Bag, metrics: Metrics) -> list[Plot]:
    """Draw the height over the whole recording, and the rates and gaps of the topics."""
    with mpl.rc_context(STYLE):
        plots = [_overview(bag, metrics), _strips(bag)]
    return [plot for plot in plots if plot is not None]


# --- one jump -----------------------------------------------------------------------------------


def _time_axes(
    jump: RecordedJump, name: str, title: str, unit: str, *, rows: int = 1
) -> tuple[Figure, Axes]:
    """Axes over the time of a jump, below a legend of a number of ``rows``."""
    figure = Figure(figsize=(5.6, 3.4))
    axes = figure.add_axes((0.15, 0.15, 0.835, 0.71 - 0.06 * rows))
    axes.set_title(title, pad=8 + 15 * rows, x=-0.148)
    axes.yaxis.set_label_coords(-0.132, 0.5)
    axes.set_xlabel("time since take-off [s]")
    axes.set_ylabel(unit)
    axes.set_xlim(-LEAD, jump.flight_time_s + TRAIL)
    axes.axvspan(0.0, jump.flight_time_s, color="#f1f3f5", zorder=0)
    axes.yaxis.set_major_locator(MaxNLocator(6))
    figure.set_label(name)
    return figure, axes


def legend(axes: Axes, columns: int) -> None:
    """Add a legend above the axes."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 0.985), ncol=columns, handlelength=1.3,
        columnspacing=1.1, handletextpad=0.5, borderaxespad=0.0, labelspacing=0.25,
    )  # fmt: skip


def _time_plot(figure: Figure, axes: Axes, alt: str) -> Plot:
    box = axes.get_position()
    begin, end = axes.get_xlim()
    return Plot(
        str(figure.get_label()), as_svg(figure), alt, box.x0, box.x1, float(begin), float(end)
    )


def _of_body(
    bag: Bag, jump: RecordedJump
) -> tuple[TimeSeries, MotionSeries, NDArray[np.intp], Floats] | None:
    """Time series and motion of Body 1, indices to show, and their times since take-off [s]."""
    series = bag.series(topics.TRUTH_BODY1)
    if series is None:
        return None
    body = motion(series)
    chosen = shown(body, jump).indices(series)
    return series, body, chosen, body.time[chosen] - jump.take_off_s


def _height(bag: Bag, jump: RecordedJump) -> Plot | None:
    found = _of_body(bag, jump)
    if found is None:
        return None
    _, body, chosen, time = found
    rise = body.position[chosen, 2] - jump.start_height_m
    figure, axes = _time_axes(jump, "height", "Rise of Body 1 above its start", "rise [m]")
    axes.plot(time, rise, color=BLUE, label="centre of Body 1")
    apex = jump.apex_s - jump.take_off_s
    axes.plot([apex], [jump.jump_height_m], "o", color=ORANGE, ms=6, label="apex")
    axes.annotate(
        f"{jump.jump_height_m:.4f} m", (apex, jump.jump_height_m), (0, 7),
        textcoords="offset points", ha="center", fontsize=10, fontweight="bold",
    )  # fmt: skip
    axes.margins(y=0.16)
    legend(axes, 2)
    alt = f"Height over time; the apex is {jump.jump_height_m:.4f} m above the start"
    return _time_plot(figure, axes, alt)


def _tilt(bag: Bag, jump: RecordedJump) -> Plot | None:
    """Tilt and heading of a rover in space."""
    found = _of_body(bag, jump)
    if found is None:
        return None
    series, _, chosen, time = found
    figure, axes = _time_axes(jump, "attitude", "Attitude of the rover", "angle [deg]")
    heading = np.degrees(headings(series)[chosen])
    axes.plot(time, np.degrees(tilts(series)[chosen]), color=BLUE, label="tilt from the vertical")
    axes.plot(time, heading - heading[0], color=GREEN, label="heading change")
    legend(axes, 2)
    alt = f"Attitude over time; tilt at touchdown {math.degrees(jump.tilt_rad):.1f} degrees"
    return _time_plot(figure, axes, alt)


def _attitude(bag: Bag, jump: RecordedJump) -> Plot | None:
    if is_spatial(bag):
        return _tilt(bag, jump)
    found = _of_body(bag, jump)
    if found is None:
        return None
    _, body, chosen, time = found
    figure, axes = _time_axes(jump, "attitude", "Attitude of the rover", "theta [rad]")
    axes.plot(time, body.theta[chosen], color=BLUE, label="theta, nose up positive")
    start = float(body.theta[chosen][time <= 1e-6][-1]) if (time <= 1e-6).any() else 0.0
    ends = [start, start + jump.attitude_variation_rad]
    landing = jump.flight_time_s
    axes.plot([0.0, landing], ends, "o", color=ORANGE, ms=6, label="take-off and touchdown")
    axes.annotate(
        f"{jump.attitude_variation_rad:+.4f} rad", (landing, ends[1]), (-8, 8),
        textcoords="offset points", ha="right", fontsize=10, fontweight="bold",
    )  # fmt: skip
    axes.margins(y=0.16)
    legend(axes, 2)
    alt = f"Attitude over time; it changes by {jump.attitude_variation_rad:+.4f} rad"
    return _time_plot(figure, axes, alt)


def _tension(bag: Bag, jump: RecordedJump) -> Plot | None:
    body = bag.series(topics.TRUTH_BODY1)
    tether, load = bag.series(topics.TRUTH_TETHER), bag.series(topics.LOAD_CELL)
    if body is None or (tether is None and load is None):
        return None
    window = shown(motion(body), jump)
    figure, axes = _time_axes(jump, "tension", "Tension of the tether", "tension [N]")
    if tether is not None and LARGEST in tether.columns:
        chosen = window.indices(tether)
        tension_max = tether.columns[LARGEST][chosen]
        axes.plot(
            tether.time[chosen] - jump.take_off_s, tension_max, color=ORANGE,
            label="largest along the tether",
        )  # fmt: skip
    if load is not None:
        chosen = window.indices(load)
        force = np.linalg.norm(load.vector("force")[chosen], axis=1)
        axes.plot(
            load.time[chosen] - jump.take_off_s, force, color=BLUE, lw=1.4,
            label="load cell at the fairlead",
        )  # fmt: skip
    legend(axes, 2)
    return _time_plot(figure, axes, "Tension of the tether over time")


def _energy(bag: Bag, jump: RecordedJump) -> Plot | None:
    body, series = bag.series(topics.TRUTH_BODY1), bag.series(topics.TRUTH_ENERGY)
    if body is None or series is None:
        return None
    chosen = shown(motion(body), jump).indices(series)
    if not len(chosen):
        return None
    changes = {}
    for name in _ENERGY_COLOURS:
        values = series.columns[f"{name}.position"][chosen]
        changes[name] = values - values[0]
    largest = max(float(np.abs(change).max()) for change in changes.values())
    # Skip terms that are invisible at this scale.
    seen = {
        name: change for name, change in changes.items() if np.abs(change).max() >= 2e-3 * largest
    }
    rows = 1 if len(seen) <= 5 else 2
    figure, axes = _time_axes(
        jump, "energy", "Energy change since before take-off", "energy [J]", rows=rows
    )
    for name, change in seen.items():
        style = "--" if name in {"input", "dissipated"} else "-"
        axes.plot(
            series.time[chosen] - jump.take_off_s, change, style, color=_ENERGY_COLOURS[name],
            label=name, lw=1.6,
        )  # fmt: skip
    legend(axes, math.ceil(len(seen) / rows))
    return _time_plot(figure, axes, "Energies over time")


def _drift(bag: Bag, jump: RecordedJump) -> Plot | None:
    body, series = bag.series(topics.TRUTH_BODY1), bag.series(topics.TRUTH_ENERGY)
    if body is None or series is None:
        return None
    chosen = shown(motion(body), jump).indices(series)
    if not len(chosen):
        return None
    drift = series.columns["drift.position"][chosen]
    size = float(np.abs(drift).max())
    power = 0 if size == 0.0 or 1e-2 <= size < 1e3 else math.floor(math.log10(size))
    unit = "residual [J]" if power == 0 else f"residual [$10^{{{power}}}$ J]"
    figure, axes = _time_axes(jump, "drift", "Residual of the energy balance", unit)
    axes.plot(
        series.time[chosen] - jump.take_off_s, drift / 10.0**power, color=RED,
        label="stored - initial - input + dissipated",
    )  # fmt: skip
    legend(axes, 1)
    return _time_plot(figure, axes, "Residual of the energy balance over time")


def _along(bag: Bag, jump: RecordedJump) -> Plot | None:
    """Tension over time and position along the tether."""
    body, tether = bag.series(topics.TRUTH_BODY1), bag.series(topics.TRUTH_TETHER)
    if body is None or tether is None or not tether.shapes:
        return None
    chosen = shown(motion(body), jump).indices(tether)
    shapes = [tether.shapes[index] for index in chosen.tolist()]
    if len(chosen) < 2 or len({shape.shape for shape in shapes}) != 1:
        return None
    time = tether.time[chosen] - jump.take_off_s
    tension = np.stack(shapes)[:, :, _TENSION].T
    lengths = np.linalg.norm(np.diff(shapes[0][:, :3], axis=0), axis=1)
    place = np.concatenate([[0.0], np.cumsum(lengths)])
    figure = Figure(figsize=(5.6, 3.4), dpi=180)
    axes = figure.add_axes((0.15, 0.15, 0.72, 0.68))
    axes.set_title("Tension along the tether", pad=10, x=-0.172)
    axes.yaxis.set_label_coords(-0.11, 0.5)
    axes.set_xlabel("time since take-off [s]")
    axes.set_ylabel("distance from the fairlead [m]")
    tension_max = tension_scale_max(tension.T)
    image = axes.pcolormesh(
        time, place, np.maximum(tension, 0.0), cmap="viridis", shading="nearest", vmin=0.0,
        vmax=tension_max, rasterized=True,
    )  # fmt: skip
    axes.axvline(0.0, color="white", lw=1.0, ls="--")
    axes.axvline(jump.flight_time_s, color="white", lw=1.0, ls="--")
    axes.set_xlim(-LEAD, jump.flight_time_s + TRAIL)
    axes.grid(visible=False)
    bar = figure.add_axes((0.885, 0.15, 0.022, 0.68))
    bar.grid(visible=False)
    beyond = "max" if tension.max() > tension_max else "neither"
    figure.colorbar(image, cax=bar, extend=beyond).set_label("tension [N]")
    figure.set_label("along")
    return _time_plot(figure, axes, "Tension along the tether over time")


def _path(scene: MovingScene, jump: RecordedJump) -> Plot:
    """Tether and rover at start, apex and touchdown: the whole scene and a close-up."""
    figure = Figure(figsize=_PATH_SIZE)
    figure.set_label("path")
    whole = figure.add_axes((0.06, 0.11, 0.44, 0.74))
    close_up = figure.add_axes((0.56, 0.11, 0.43, 0.74))
    instants = (
        ("before take-off", 0.0, "#868e96"),
        ("apex", jump.apex_s - jump.take_off_s, BLUE),
        ("touchdown", jump.flight_time_s, ORANGE),
    )
    for axes, (low, high) in ((whole, (scene.low, scene.high)), (close_up, scene.close_up)):
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x, forward from the fairlead [m]")
        axes.set_ylabel("z, up [m]")
        axes.axhline(scene.ground, color="#b8ad9e", lw=1.2, zorder=0)
        for label, time, colour in instants:
            index = int(np.argmin(np.abs(scene.time - time)))
            index = max(index - 1, 0) if time == 0.0 else index
            curve = _curve(scene.tether[index], scene.element)
            axes.plot(curve[:, 0], curve[:, 1], color=colour, lw=2.0, label=label)
            for pose, size in (
                (scene.body1[index], scene.sizes["body1_size"]),
                (scene.body2[index], scene.sizes["body2_size"]),
            ):
                box = _box(pose, size)
                axes.fill(
                    box[:, 0], box[:, 1], facecolor=colour, alpha=0.3, edgecolor=colour, lw=1.2
                )
        axes.plot(
            scene.body1[:, 0], scene.body1[:, 1], ":", color=BLACK, lw=1.4, label="path of Body 1"
        )
        _fit(axes, low, high)
    whole.plot(*scene.tether[0, 0, :2], "s", color=BLACK, ms=6, label="fairlead")
    whole.set_title("Tether and rover in the plane of the jump", pad=24, x=-0.115)
    close_up.set_title("Close-up of the rover", pad=24, x=-0.115)
    whole.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncol=5, handlelength=1.4,
        columnspacing=1.1, handletextpad=0.5, borderaxespad=0.0,
    )  # fmt: skip
    alt = "Tether and rover before take-off, at the apex and at touchdown, to scale"
    return Plot("path", as_svg(figure), alt, wide=True)


def _fit(axes: Axes, low: tuple[float, float], high: tuple[float, float]) -> None:
    """Set limits that show a box with equal scales and fill the axes."""
    box = axes.get_position()
    shape = _PATH_SIZE[0] * box.width / (_PATH_SIZE[1] * box.height)
    span_x, span_z = high[0] - low[0], high[1] - low[1]
    span_x, span_z = max(span_x, span_z * shape), max(span_z, span_x / shape)
    middle_x, middle_z = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
    axes.set_xlim(middle_x - 0.5 * span_x, middle_x + 0.5 * span_x)
    axes.set_ylim(middle_z - 0.5 * span_z, middle_z + 0.5 * span_z)


def _curve(nodes: Floats, element: float) -> Floats:
    ends = nodes[:, :4].reshape(-1, 2, 2)
    return np.concatenate([element_curve(a, b, element, 12) for a, b in pairwise(ends)])


def _box(pose: Floats, size: tuple[float, ...]) -> Floats:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array(size) / 2
    turned: Floats = corners @ np.array([[c, s], [-s, c]]) + pose[:2]
    return turned


# --- the whole bag ------------------------------------------------------------------------------


def _overview(bag: Bag, metrics: Metrics) -> Plot | None:
    series = bag.series(topics.TRUTH_BODY1)
    if series is None or len(series) < 2:
        return None
    body = motion(series)
    figure = Figure(figsize=(11.4, 2.8))
    axes = figure.add_axes((0.07, 0.2, 0.915, 0.58))
    axes.set_title("Height of Body 1 over the recording", pad=18, x=-0.06)
    axes.set_xlabel("simulated time [s]")
    axes.set_ylabel("z of Body 1 [m]")
    time, height = body.time, body.position[:, 2]
    axes.plot(*envelope(time, height, height), color=BLUE, lw=1.5)
    for number, jump in enumerate(metrics.jumps, 1):
        end = jump.take_off_s + jump.flight_time_s
        axes.axvspan(jump.take_off_s, end, color=ORANGE, alpha=0.15, lw=0)
        if len(metrics.jumps) <= 30:
            axes.annotate(
                f"jump {number}", (0.5 * (jump.take_off_s + end), 1.0), (0, 3),
                xycoords=("data", "axes fraction"), textcoords="offset points",
                ha="center", fontsize=9,
            )  # fmt: skip
    axes.set_xlim(float(time.min()), float(time.max()))
    figure.set_label("overview")
    return Plot("overview", as_svg(figure), "Height of Body 1 over the whole recording", wide=True)


def _strips(bag: Bag) -> Plot | None:
    """When each periodic topic was at its rate, and its gaps."""
    rows = [
        (name, float(rate), series)
        for name, series in bag.time_series.items()
        if (rate := TOPICS[name].rate)
        and TOPICS[name].intent is not Intent.COMMAND
        and len(series) > 1
    ]
    if not rows:
        return None
    figure = Figure(figsize=(11.4, 0.25 * len(rows) + 1.55))
    tall = figure.get_figheight()
    axes = figure.add_axes((0.165, 0.62 / tall, 0.82, 1.0 - 1.45 / tall))
    axes.set_title("Topic rates and gaps", pad=26, x=-0.2)
    axes.set_xlabel("simulated time [s]")
    for row, (_, rate, series) in enumerate(rows):
        promised = series.stride / rate
        period = typical_period(np.diff(pacing_times(series)), promised)
        for steady, colour in ((True, SKY if period == promised else YELLOW), (False, RED)):
            spans = _spans(series, GAP * period, steady=steady)
            axes.broken_barh(
                [(begin, end - begin) for begin, end in spans], (row + 0.15, 0.7),
                facecolors=colour,
            )  # fmt: skip
    for colour, label in (
        (SKY, "at the contract's rate"),
        (YELLOW, "slower throughout"),
        (RED, f"gap of more than {GAP:g} periods"),
    ):
        axes.plot([], [], color=colour, lw=6, label=label)
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncol=3, handlelength=1.3,
        borderaxespad=0.0,
    )  # fmt: skip
    axes.set_yticks(np.arange(len(rows)) + 0.5, [name for name, _, _ in rows])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(rows), 0)
    axes.grid(visible=False, axis="y")
    axes.set_xlim(
        min(float(series.time.min()) for _, _, series in rows),
        max(float(series.time.max()) for _, _, series in rows),
    )
    figure.set_label("strips")
    alt = "Times at which each topic was published at its rate, and its gaps"
    return Plot("strips", as_svg(figure), alt, wide=True)


def _spans(series: TimeSeries, longest: float, *, steady: bool) -> list[tuple[float, float]]:
    """Time spans in which messages follow within ``longest`` seconds, or the gaps between."""
    time, steps = series.time, np.diff(pacing_times(series))
    kind = (steps <= longest) & (steps >= 0.0) if steady else steps > longest
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kind, [False]]).astype(np.int8)))
    return [(float(time[a]), float(time[b])) for a, b in edges.reshape(-1, 2)]


# --- SVG ----------------------------------------------------------------------------------------


def as_svg(figure: Figure) -> str:
    """Return the figure as a scalable SVG element without metadata and external addresses."""
    target = io.StringIO()
    FigureCanvasSVG(figure).print_svg(target, metadata={"Date": None, "Creator": None})
    text = target.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", text)
    text = text.replace("xlink:href", "href").replace(f"'{_FONT}'", _PAGE_FONTS)
    # Identifiers must be unique in a page with several drawings.
    label = str(figure.get_label())
    text = re.sub(r'\bid="([^"]+)"', rf'id="{label}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{label}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{label}-\1)", text)
    head, tail = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    return f"{head}>{tail}".strip()
