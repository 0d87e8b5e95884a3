"""``mother_rover bag compare``: metrics in columns with differences marked, and overlaid plots."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from msg_schemas import machine, topics
from msg_schemas.fields import FieldRule, read_or_none
from rover_bags.analysis.activities import hanging_swing
from rover_bags.analysis.jumps import RecordedJump, motion
from rover_bags.analysis.metrics import Metrics
from rover_bags.files.store import BagError
from rover_bags.reading.read import Bag, Floats, windows
from rover_bags.views.bag_analysis import ProgressFactory, analyse_bag
from rover_bags.views.lines import envelope
from rover_bags.views.markup import escaped, plot_grid, whole_page
from rover_bags.views.plots import (
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    PURPLE,
    STYLE,
    TEAL,
    YELLOW,
    Plot,
    as_svg,
)
from rover_bags.views.report import (
    EXIT_CODES,
    ProgressBars,
    add_output_arguments,
    beside,
    deliver,
    refused,
)
from rover_bags.views.summary import as_mapping
from rover_runtime.text_output import text_table

DIFFERS: Final = 0.01
"""Relative difference from which metrics are marked as different."""
_COLOURS: Final = (BLUE, ORANGE, GREEN, PINK, PURPLE, TEAL, YELLOW)
_DASHES: Final = ("-", "--", "-.", ":")
_SETTINGS: Final = "settings"

Value = float | str | None


@dataclass(frozen=True)
class Row:
    """One metric of all bags.

    Attributes:
        group: Group of the metric, such as ``descents``.
        name: Name with unit.
        values: Value of each bag; None if it has none.
        spread: Largest value minus smallest; None unless all values are numbers.
        differs: Whether the values are marked as different.
    """

    group: str
    name: str
    values: tuple[Value, ...]
    spread: float | None
    differs: bool


@dataclass(frozen=True)
class Line:
    """One curve to overlay: times [s] and values, shape (N,) each."""

    time: Floats
    values: Floats


@dataclass(frozen=True)
class BagComparison:
    """A comparison of bags.

    Attributes:
        names: Short unique names of the bags.
        reports: The JSON report of each bag.
        rows: The metrics of all bags.
        plots: Overlaid plots.
    """

    names: tuple[str, ...]
    reports: tuple[Mapping[str, Any], ...]
    rows: tuple[Row, ...]
    plots: tuple[Plot, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "bags": list(self.names),
            "differing": sum(row.differs for row in self.rows),
            "rows": [asdict(row) for row in self.rows],
            "reports": list(self.reports),
        }

    def as_text(self) -> str:
        """Return the text for a terminal; an asterisk marks differences."""
        table = [["", "", *self.names, "spread"]]
        group = ""
        for row in self.rows:
            if row.group != group:
                group = row.group
                table.append(["", group.upper(), *("" for _ in self.names), ""])
            cells = [_text(value) for value in row.values]
            spread = "" if row.spread is None else f"{row.spread:.3g}"
            table.append(["*" if row.differs else "", row.name, *cells, spread])
        lines = text_table(table, left=(0, 1))
        differing = sum(row.differs for row in self.rows)
        lines.append(f"\n{differing} of {len(self.rows)} metrics differ by more than 1 % (*)")
        return "\n".join(lines)

    def as_page(self) -> str:
        """Return the comparison as one self-contained HTML page."""
        names = ", ".join(self.names)
        differing = sum(row.differs for row in self.rows)
        parts = [
            f"<h1>Bag comparison: {escaped(names)}</h1>",
            (
                f'<p class="soft">{differing} of {len(self.rows)} metrics differ by more than 1 % '
                "and are marked. Times count from the start of each bag.</p>"
            ),
            plot_grid(self.plots),
            (
                '<p class="only"><label><input type="checkbox" id="only-differing"> '
                "show differences only</label></p>"
            ),
        ]
        for group in dict.fromkeys(row.group for row in self.rows):
            rows = [row for row in self.rows if row.group == group]
            kind = "" if any(row.differs for row in rows) else ' class="same"'
            parts.append(f"<section{kind}><h2>{escaped(group.capitalize())}</h2>")
            parts.append(f"{self._table(rows)}</section>")
        return whole_page(f"Bag comparison: {names}", parts)

    def _table(self, rows: Sequence[Row]) -> str:
        heads = "".join(f"<th>{escaped(name)}</th>" for name in ("", *self.names, "spread"))
        body = []
        for row in rows:
            mark = ' class="bad"' if row.differs else ""
            kind = "" if row.differs else ' class="same"'
            cells = "".join(f"<td{mark}>{escaped(_text(value))}</td>" for value in row.values)
            spread = "" if row.spread is None else f"{row.spread:.3g}"
            body.append(f"<tr{kind}><td>{escaped(row.name)}</td>{cells}<td>{spread}</td></tr>")
        return (
            f'<div class="scroll"><table><thead><tr>{heads}</tr></thead>'
            f"<tbody>{''.join(body)}</tbody></table></div>"
        )


def _text(value: Value) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    return f"{value:.6g}"


def compare(
    paths: Sequence[Path],
    *,
    namespace: str | None = None,
    progress_factory: ProgressFactory | None = None,
) -> BagComparison:
    """Read bags one after the other and compare their metrics.

    Args:
        paths: Paths of the bags.
        namespace: Namespace of the rover, if bags hold several.
        progress_factory: Creates the progress callback of a pass.

    Raises:
        BagError: A bag cannot be read.
    """
    reports, tables, lines, scenarios = [], [], [], []
    for path in paths:
        found = analyse_bag(
            path, namespace=namespace, with_drawings=False, progress_factory=progress_factory
        )
        report = as_mapping(found.bag, found.metrics)
        reports.append(report)
        tables.append(dict(_report_metrics(report)))
        scenarios.append(dict(_flat(found.bag.scenario)))
        lines.append(_lines(found.bag, found.metrics))
    names = _names(paths)
    rows = [*_rows(tables), *_settings(scenarios)]
    return BagComparison(names, tuple(reports), tuple(rows), tuple(_plots(names, lines)))


def write_comparison(comparison: BagComparison, folder: Path) -> list[Path]:
    """Write ``comparison.json`` and ``comparison.html``; raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers, page = folder / "comparison.json", folder / "comparison.html"
    text = json.dumps(comparison.to_mapping(), indent=2) + "\n"
    numbers.write_text(text, encoding="utf-8")
    page.write_text(comparison.as_page(), encoding="utf-8")
    return [numbers, page]


def _names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Unique short names: the fewest trailing path components that distinguish the bags."""
    whole = [path.resolve() for path in paths]
    for parts in range(1, 1 + max(len(path.parts) for path in whole)):
        names = ["/".join(path.parts[-parts:]) for path in whole]
        if len(set(names)) == len(names):
            return tuple(names)
    return tuple(f"{path.name} ({number})" for number, path in enumerate(whole, 1))


# --- metrics --------------------------------------------------------------------------------------

Key = tuple[str, str]


_KIND_LABELS: Final = {
    "downward": ("direction", "down", "up"),
    "turning": ("motion", "turn", "drive"),
}
"""Label of a boolean metric, and its texts for true and false."""


def _report_metrics(report: Mapping[str, Any]) -> Iterator[tuple[Key, Value]]:
    """Group, name and value of each metric of a report."""
    for name in ("seed", "package_version", "contract_version"):
        value = report.get(name)
        yield ("recording", name.replace("_", " ")), None if value is None else str(value)
    yield ("recording", "duration [s]"), report["duration_s"]
    yield ("recording", "simulated time [s]"), report["simulated_s"]
    yield ("recording", "closed"), "yes" if report["closed"] else "no"
    yield ("recording", "warnings"), float(len(report["warnings"]))
    times: dict[str, list[float]] = {}
    for interval in report["activities"]:
        times.setdefault(interval["activity"], []).append(interval["end_s"] - interval["begin_s"])
    for what, spans in times.items():
        yield ("activities", f"{what} [s]"), sum(spans)
        yield ("activities", f"{what}, count"), float(len(spans))
    kinds: dict[str, int] = {}
    for event in report["timeline_events"]:
        kinds[event["event"]] = kinds.get(event["event"], 0) + 1
    for what, count in kinds.items():
        yield ("activities", f"{what.replace('_', ' ')}, count"), float(count)
    for group, one in (("descents", "descent"), ("drives", "drive"), ("imaging_stops", "stop"),
                       ("jumps", "jump")):  # fmt: skip
        for number, item in enumerate(report[group], 1):
            for name, value in item.items():
                if name in _KIND_LABELS:
                    label, if_true, if_false = _KIND_LABELS[name]
                    yield (group, f"{one} {number}: {label}"), if_true if value else if_false
                    continue
                is_metric = isinstance(value, int | float | None) and name != "log_ns"
                if isinstance(value, bool) or not is_metric:
                    continue
                yield (group, f"{one} {number}: {_label(name)}"), value
    yield from _audit_metrics(report["audits"])
    for topic, item in report["topics"].items():
        for name in ("count", "rate_hz", "max_gap_s", "gaps", "latency_p50_ms", "latency_p99_ms",
                     "age_p99_ms", "dropped", "lost_in_transport", "rejected"):  # fmt: skip
            value = item[name]
            yield ("topics", f"{topic}: {_label(name)}"), None if value is None else float(value)


def _audit_metrics(audits: Mapping[str, Any]) -> Iterator[tuple[Key, Value]]:
    energy = audits["energy"]
    for name in ("turnover_J", "residual_J", "share", "gravity_error_J"):
        if energy is not None:
            yield ("audits", f"energy: {_label(name)}"), energy[name]
    for rotor in audits["rotors"]:
        name = f"{rotor['name'].replace('_', ' ')}: max. momentum [N m s]"
        yield ("audits", name), rotor["momentum_max_N_m_s"]
    for number, flight in enumerate(audits["flights"], 1):
        for name in ("momentum_change_N_s", "unexplained_N_s", "angular_momentum_change_N_m_s"):
            yield ("audits", f"flight {number}: {_label(name)}"), flight[name]


_UNITS: Final = (("_N_m_s", "N m s"), ("_N_s", "N s"), ("_m_s", "m/s"), ("_hz", "Hz"),
                 ("_rad", "rad"), ("_ms", "ms"), ("_px", "px"), ("_s", "s"), ("_m", "m"),
                 ("_N", "N"), ("_J", "J"))  # fmt: skip


def _label(name: str) -> str:
    """A metric's name in words, with its unit in brackets."""
    for suffix, unit in _UNITS:
        if name.endswith(suffix):
            return f"{name.removesuffix(suffix).replace('_', ' ')} [{unit}]"
    return name.replace("_", " ")


def _rows(tables: Sequence[Mapping[Key, Value]]) -> Iterator[Row]:
    keys = dict.fromkeys(key for table in tables for key in table)
    order = list(dict.fromkeys(group for group, _ in keys))
    for group, name in sorted(keys, key=lambda key: order.index(key[0])):
        yield _row(group, name, tuple(table.get((group, name)) for table in tables))


def _row(group: str, name: str, values: tuple[Value, ...]) -> Row:
    numbers = [float(v) for v in values if isinstance(v, int | float) and math.isfinite(v)]
    if len(numbers) == len(values):
        spread = max(numbers) - min(numbers)
        size = max(abs(number) for number in numbers)
        return Row(group, name, values, spread, spread > DIFFERS * size)
    return Row(group, name, values, None, len(set(values)) > 1)


def _settings(scenarios: Sequence[Mapping[str, Value]]) -> Iterator[Row]:
    """Scenario settings that differ."""
    for name in dict.fromkeys(key for scenario in scenarios for key in scenario):
        values = tuple(scenario.get(name) for scenario in scenarios)
        if len(set(values)) > 1:
            row = _row(_SETTINGS, name, values)
            yield Row(row.group, row.name, row.values, row.spread, differs=True)


def _flat(settings: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Value]]:
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif name != "about":
            number: float | None = read_or_none(FieldRule(kind=float), value)
            yield f"{prefix}{name}", json.dumps(value) if number is None else number


# --- lines ----------------------------------------------------------------------------------------

_TITLES: Final = {
    "height": ("Height of Body 1", "z [m]"),
    "length": ("Tether length at the drum", "length [m]"),
    "tension": ("Tension at the fairlead", "tension [N]"),
    "swing": ("Swing angle while hanging, from the vertical", "angle [deg]"),
    "jump": ("First jump: rise of Body 1", "rise [m]"),
    "drift": ("Residual of the energy balance", "residual [J]"),
}


def _lines(bag: Bag, metrics: Metrics) -> dict[str, Line]:
    """The curves to overlay, thinned to the resolution of a plot."""
    found: dict[str, Line] = {}
    body, drum = bag.series(topics.TRUTH_BODY1), bag.series(topics.WINCH_STATE)
    cell, energy = bag.series(topics.LOAD_CELL), bag.series(topics.TRUTH_ENERGY)

    def put(name: str, time: Floats, low: Floats, high: Floats) -> None:
        known = high[np.isfinite(high)]
        if len(known) > 1 and float(np.ptp(known)) > 0.0:
            at, values = envelope(time - float(time[0]), low, high)
            found[name] = Line(at, values)

    if body is not None:
        path = "position.z"
        put("height", body.time, body.lowest(path), body.highest(path))
    swing = hanging_swing(bag, metrics.timeline)
    if swing is not None:
        degrees = np.degrees(swing[1])
        put("swing", swing[0], degrees, degrees)
    if drum is not None:
        path = f"{machine.WINCH_DRUM}.position"
        put("length", drum.time, drum.lowest(path), drum.highest(path))
    if cell is not None:
        size = np.linalg.norm(cell.vector("force"), axis=1)
        put("tension", cell.time, size, cell.largest("force") if cell.stride > 1 else size)
    if energy is not None:
        path = "drift.position"
        put("drift", energy.time, energy.lowest(path), energy.highest(path))
    jump = _first_jump(bag, metrics.jumps)
    if jump is not None:
        found["jump"] = jump
    return found


def _first_jump(bag: Bag, jumps: Sequence[RecordedJump]) -> Line | None:
    series = bag.series(topics.TRUTH_BODY1)
    if series is None or not jumps:
        return None
    start = jumps[0].take_off_s
    begin, end = start - 0.1, start + jumps[0].flight_time_s + 0.2
    at = int(np.argmin(np.abs(series.time - start)))
    if series.stride > 1:
        log = int(series.log_ns[at])
        span = round((end - begin) * 10e9)
        parts = windows(bag, [(log - span, log + span)], [topics.TRUTH_BODY1])
        series = next(parts).time_series[topics.TRUTH_BODY1]
    body = motion(series)
    inside = (body.time >= begin) & (body.time <= end)
    if inside.sum() < 2:
        return None
    time = body.time[inside] - start
    height = body.position[inside, 2]
    return Line(time, height - float(np.interp(0.0, time, height)))


def _plots(names: Sequence[str], lines: Sequence[Mapping[str, Line]]) -> Iterator[Plot]:
    with mpl.rc_context(STYLE):
        for name, (title, unit) in _TITLES.items():
            if any(name in found for found in lines):
                yield _plot(name, title, unit, names, lines)


def _plot(
    name: str, title: str, unit: str, names: Sequence[str], lines: Sequence[Mapping[str, Line]]
) -> Plot:
    rows = math.ceil(len(names) / 3)
    figure = Figure(figsize=(5.6, 3.2 + 0.2 * rows))
    tall = figure.get_figheight()
    axes = figure.add_axes((0.155, 0.5 / tall, 0.825, 2.1 / tall))
    axes.yaxis.set_label_coords(-0.14, 0.5)
    for index, (bag, found) in enumerate(zip(names, lines, strict=True)):
        if name not in found:
            continue
        style = _DASHES[(index // len(_COLOURS)) % len(_DASHES)]
        colour = _COLOURS[index % len(_COLOURS)]
        line = found[name]
        axes.plot(line.time, line.values, style, color=colour, lw=1.3, alpha=0.85, label=bag)
    axes.set_title(title, pad=10 + 15 * rows, x=-0.155)
    axes.set_ylabel(unit)
    since = "take-off" if name == "jump" else "start"
    axes.set_xlabel(f"time since {since} [s]")
    axes.yaxis.set_major_locator(MaxNLocator(6))
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncol=3, handlelength=1.5,
        columnspacing=1.1, handletextpad=0.5, borderaxespad=0.0, labelspacing=0.25,
    )  # fmt: skip
    figure.set_label(f"compared-{name}")
    return Plot(f"compared-{name}", as_svg(figure), f"{title} of each bag over time")


# --- the command ----------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Compare bags: the metrics of each in a column, differences marked, plots overlaid."
    )
    parser.epilog = EXIT_CODES
    parser.add_argument("first", type=Path, metavar="BAG", help="a folder or an .mcap file")
    parser.add_argument("others", type=Path, nargs="+", metavar="BAG", help="further bags")
    content = "comparison.json and comparison.html (default: beside the first bag, BAG_comparison)"
    add_output_arguments(parser, content)


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`~rover_bags.views.report.ReportExitCode`."""
    first: Path = options.first
    paths = [first, *options.others]
    try:
        with ProgressBars(quiet=options.quiet) as bars:
            comparison = compare(paths, namespace=options.namespace, progress_factory=bars)
    except BagError as error:
        return refused("compare", error)
    if options.json:
        text = json.dumps(comparison.to_mapping(), indent=2)
    elif options.html:
        text = comparison.as_page()
    else:
        text = comparison.as_text()
    folder = beside(first, "_comparison")
    return deliver(
        "compare", options, text, folder, lambda folder: write_comparison(comparison, folder)
    )
