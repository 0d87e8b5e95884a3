"""``bag_report``: what a bag tells, in the terminal, as JSON for machines and as a page for people.

The page stands alone: it opens offline, in any browser, and loads nothing.
"""

import argparse
import html
import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Self

from rover_bags.animation import Scene, scene_of, write_gif
from rover_bags.metrics import Entry, Jump, Metrics, TopicFigures, measure
from rover_bags.page import PLAYER, STYLE
from rover_bags.plots import Plot, bag_plots, jump_plots
from rover_bags.read import Bag, read_bag
from rover_bags.records import Damage
from rover_bags.store import BagError

_SHOWN_IN_FULL = 6
"""So many jumps get plots and an animation of their own; the table has all."""
_ROWS = 400
_FIGURES = (
    ("jump_height_m", "jump height", "m", ".4f"),
    ("attitude_variation_rad", "attitude variation", "rad", "+.4f"),
    ("slack", "slack dh/df", "", ".3f"),
    ("flight_time_s", "flight time", "s", ".4f"),
    ("travel_m", "travel", "m", "+.4f"),
    ("peak_tension_N", "peak tension", "N", ".2f"),
    ("energy_drift_J", "energy drift", "J", ".1e"),
)


class ExitCode(IntEnum):
    """What the exit code of ``bag_report`` says."""

    OK = 0
    REFUSED = 2
    NOT_WRITTEN = 3


# --- text ----------------------------------------------------------------------------------------


def as_text(bag: Bag, metrics: Metrics) -> str:
    """The report for a terminal."""
    lines = [f"{bag.path}: {_summary(bag, metrics)}"]
    lines += [f"! {text}" for text in complaints(bag, metrics)]
    for number, jump in enumerate(metrics.jumps, 1):
        lines += ["", f"jump {number}, take-off at {jump.take_off_s:.3f} s"]
        lines += [
            f"  {label:<20} {_value(getattr(jump, name), unit, form)}"
            for name, label, unit, form in _FIGURES
        ]
    if not metrics.jumps:
        lines += ["", "no jump in this bag"]
    lines += ["", _columns(metrics.topics.values())]
    if metrics.events:
        lines += ["", "events:"]
        lines += [f"  {e.time_s:10.3f} s  {e.node}  {e.name}: {e.message}" for e in metrics.events]
    if metrics.refusals:
        lines += ["", "refusals:"]
        lines += [f"  {e.time_s:10.3f} s  {e.name}: {e.message}" for e in metrics.refusals]
    return "\n".join(lines)


def _summary(bag: Bag, metrics: Metrics) -> str:
    simulated = (
        f", {metrics.simulated_s:.2f} s of simulated time"
        if metrics.simulated_s is not None
        else ""
    )
    return (
        f"{sum(bag.counts.values())} messages on {len(bag.counts)} topics over "
        f"{bag.duration:.2f} s{simulated}"
    )


def complaints(bag: Bag, metrics: Metrics) -> list[str]:
    """What a reader must know before trusting the rest."""
    found = []
    if not bag.closed:
        found.append("the recorder never closed this bag: what it had not yet written is missing")
    found += [_left_out(item, bag.start_ns) for item in bag.damage]
    found += [
        f"{name}: {count} messages that the bag should hold cannot be read"
        for name, count in sorted(bag.lost.items())
    ]
    if bag.unverified:
        count = sum(bag.unverified.values())
        found.append(f"{count} messages carry no checksum: they cannot be vouched for")
    for losses, what in (
        (bag.dropped, "the recorder could not keep"),
        (bag.missed, "were lost on the way to the recorder"),
    ):
        for name, count in sorted(losses.items()):
            found.append(f"{name}: {count} messages {what}")
    for name, count in sorted(bag.rejected.items()):
        example = next((item.reason for item in bag.examples if item.topic == name), "")
        found.append(f"{name}: {count} messages break the contract, such as: {example}")
    for figures in metrics.topics.values():
        if figures.gaps:
            found.append(
                f"{figures.topic}: {figures.gaps} gaps, the longest {figures.max_gap_s:.3f} s at "
                f"{figures.max_gap_at_s:.3f} s"
            )
    return found


def _left_out(item: Damage, start_ns: int) -> str:
    place = f", byte {item.offset}" if item.offset or item.length else ""
    when = ""
    if item.span_ns is not None:
        begin, end = ((value - start_ns) * 1e-9 for value in item.span_ns)
        when = f", about {begin:.3f} s to {end:.3f} s after the first message"
    return f"{item.file}{place}: {item.reason}{when}; left out"


def _value(value: float | None, unit: str, form: str) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:{form}} {unit}".rstrip()


_TOPIC_COLUMNS = (
    ("messages", "count", "d"),
    ("promised Hz", "expected_hz", ".4g"),
    ("rate Hz", "rate_hz", ".4g"),
    ("longest gap s", "max_gap_s", ".3f"),
    ("gaps", "gaps", "d"),
    ("delay ms p50", "latency_p50_ms", ".2f"),
    ("p99", "latency_p99_ms", ".2f"),
    ("max", "latency_max_ms", ".2f"),
    ("lost", "missed", "d"),
    ("dropped", "dropped", "d"),
    ("refused", "rejected", "d"),
)


def _columns(figures: Iterable[TopicFigures]) -> str:
    rows = [["topic", *(label for label, _, _ in _TOPIC_COLUMNS)]]
    rows += [[item.topic, *_cells(item)] for item in figures]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    )


def _cells(item: TopicFigures) -> list[str]:
    values = [(getattr(item, name), form) for _, name, form in _TOPIC_COLUMNS]
    return ["" if value is None else f"{value:{form}}" for value, form in values]


# --- JSON ----------------------------------------------------------------------------------------


def as_mapping(bag: Bag, metrics: Metrics) -> dict[str, Any]:
    """The report for machines; every number is finite or null."""
    content = {
        "bag": str(bag.path),
        "seed": bag.seed,
        "contract_version": bag.identity.get("contract_version"),
        "package_version": bag.identity.get("package_version"),
        "closed": bag.closed,
        "complaints": complaints(bag, metrics),
        **metrics.to_mapping(),
    }
    cleaned: dict[str, Any] = _finite(content)
    return cleaned


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


# --- page ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawings:
    """Everything drawn for a report: made once, used by the page and the files.

    Attributes:
        scenes: What moves, by jump; of the whole bag where it has no jump.
        plots: Plots by jump.
        overall: Plots of the whole bag.
    """

    scenes: tuple[Scene | None, ...]
    plots: tuple[tuple[Plot, ...], ...]
    overall: tuple[Plot, ...]

    @classmethod
    def of(cls, bag: Bag, metrics: Metrics) -> Self:
        """Draws the first jumps and the whole bag."""
        jumps = metrics.jumps[:_SHOWN_IN_FULL]
        scenes = [scene_of(bag, jump) for jump in jumps] or [scene_of(bag, None)]
        plots = [
            tuple(jump_plots(bag, jump, scene)) for jump, scene in zip(jumps, scenes, strict=False)
        ]
        return cls(tuple(scenes), tuple(plots), tuple(bag_plots(bag, metrics)))


def as_page(bag: Bag, metrics: Metrics, drawings: Drawings) -> str:
    """The report as one HTML page that needs nothing else."""
    title = f"Bag report: {bag.path.resolve().name}"
    parts = [
        f"<h1>{_safe(title)}</h1>",
        f'<p class="soft">{_safe(_origin(bag))}{_safe(_summary(bag, metrics))}</p>',
        _notes(complaints(bag, metrics)),
    ]
    if len(metrics.jumps) > 1:
        parts.append(_jump_table(metrics.jumps))
    for number, jump in enumerate(metrics.jumps[:_SHOWN_IN_FULL], 1):
        parts.append(_jump_section(jump, number, len(metrics.jumps), drawings))
    if not metrics.jumps:
        parts.append(_rest_section(drawings.scenes[0]))
    parts.append("<section><h2>Recording</h2>")
    parts.append(_plots(drawings.overall))
    parts.append(_topic_table(metrics.topics.values()))
    parts.append("</section>")
    parts.append(_entries("Events", metrics.events))
    parts.append(_entries("Refusals", metrics.refusals))
    parts.append(_settings(bag))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_safe(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><main>{''.join(part for part in parts if part)}</main>\n"
        f"<script>{PLAYER}</script></body></html>\n"
    )


def _safe(text: object) -> str:
    return html.escape(str(text))


def _origin(bag: Bag) -> str:
    words = []
    scenario = bag.scenario.get("name")
    if scenario:
        words.append(f"scenario {scenario}")
    if bag.seed is not None:
        words.append(f"seed {bag.seed}")
    for key, label in (("package_version", "mother_rover"), ("contract_version", "contract")):
        if bag.identity.get(key, "unknown") != "unknown":
            words.append(f"{label} {bag.identity[key]}")
    return ", ".join(words) + ". " if words else ""


def _notes(texts: Sequence[str]) -> str:
    if not texts:
        return ""
    items = "".join(f"<li>{_safe(text)}</li>" for text in texts[:30])
    more = f"<li>and {len(texts) - 30} more</li>" if len(texts) > 30 else ""
    return f'<div class="note"><b>Before you trust it</b><ul>{items}{more}</ul></div>'


def _cards(jump: Jump) -> str:
    cards = "".join(
        f'<div class="card"><span>{label}</span>'
        f"<b>{_safe(_value(getattr(jump, name), unit, form)).replace('e-0', 'e-')}</b></div>"
        for name, label, unit, form in _FIGURES
    )
    return f'<div class="cards">{cards}</div>'


def _jump_section(jump: Jump, number: int, count: int, drawings: Drawings) -> str:
    scene = drawings.scenes[number - 1]
    heading = "Jump" if count == 1 else f"Jump {number}"
    moment = f"take-off at {jump.take_off_s:.3f} s of simulated time"
    if jump.touchdown_s is None:
        moment += "; the recording ends in flight, the figures with it"
    player = _player(scene, jump.apex_s - jump.take_off_s) if scene is not None else ""
    return (
        f'<section id="jump-{number}"><h2>{heading}</h2><p class="soft">{_safe(moment)}</p>'
        f"{_cards(jump)}{_agreement(jump)}{player}"
        f"{_plots(drawings.plots[number - 1], prefix=f'jump{number}-')}</section>"
    )


def _agreement(jump: Jump) -> str:
    """How the figures from the recorded motion compare with what the plant itself reported."""
    pairs = (("height", jump.jump_height_m, "m"),
             ("attitude_variation", jump.attitude_variation_rad, "rad"))  # fmt: skip
    words = [
        f"{name.replace('_', ' ')} {jump.reported[name]:.6f} {unit} "
        f"(difference {value - jump.reported[name]:+.1e})"
        for name, value, unit in pairs
        if name in jump.reported
    ]
    if not words:
        return ""
    return (
        '<p class="soft">Found from the recorded motion. The plant itself reported '
        f"{_safe(' and '.join(words))}.</p>"
    )


def _rest_section(scene: Scene | None) -> str:
    shown = _player(scene, float(scene.time[0])) if scene is not None else ""
    return f"<section><h2>Motion</h2><p>No jump in this bag.</p>{shown}</section>"


def _player(scene: Scene, poster: float) -> str:
    data = json.dumps(scene.to_mapping(), separators=(",", ":")).replace("</", "<\\/")
    speeds = "".join(
        f'<option value="{value}"{" selected" if value == 0.25 else ""}>{label}</option>'
        for value, label in ((0.1, "1/10 speed"), (0.25, "1/4 speed"), (0.5, "1/2 speed"),
                             (1, "real time"), (4, "4 x"))
    )  # fmt: skip
    return (
        f'<div class="player" data-poster="{poster:.4f}">'
        '<canvas role="img" aria-label="Side view of rover and tether"></canvas>'
        '<div class="bar"><button type="button">Play</button>'
        f'<select aria-label="Speed">{speeds}</select>'
        '<input type="range" aria-label="Time"><output></output></div>'
        f'<script type="application/json">{data}</script></div>'
        '<p class="soft">Left the whole scene, right the rover from near, both to scale. The '
        "ground line marks the level at which the rover stood. Click into a plot to go to that "
        "moment.</p>"
    )


def _plots(plots: Sequence[Plot], prefix: str = "") -> str:
    figures = []
    for plot in plots:
        timed = (
            f' data-left="{plot.left:.5f}" data-right="{plot.right:.5f}"'
            f' data-begin="{plot.begin:.5f}" data-end="{plot.end:.5f}"'
            if plot.right > plot.left
            else ""
        )
        kind = "plot wide" if plot.wide else "plot"
        svg = plot.svg
        if prefix:
            for mark in ('id="', 'href="#', "url(#"):
                svg = svg.replace(mark + plot.name, mark + prefix + plot.name)
        svg = svg.replace("<svg", f'<svg role="img" aria-label="{_safe(plot.alt)}"', 1)
        figures.append(f'<figure class="{kind}"{timed}>{svg}</figure>')
    return f'<div class="plots">{"".join(figures)}</div>' if figures else ""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    heads = "".join(f"<th>{_safe(text)}</th>" for text in head)
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _jump_table(jumps: Sequence[Jump]) -> str:
    head = ["jump", "take-off [s]"] + [
        f"{label} [{unit}]" if unit else label for _, label, unit, _ in _FIGURES
    ]
    rows = []
    for number, jump in enumerate(jumps, 1):
        name = f'<a href="#jump-{number}">{number}</a>' if number <= _SHOWN_IN_FULL else str(number)
        cells = [f"<td>{name}</td>", f"<td>{jump.take_off_s:.3f}</td>"]
        cells += [
            f"<td>{_value(getattr(jump, key), '', form)}</td>" for key, _, _, form in _FIGURES
        ]
        rows.append(cells)
    return f"<section><h2>Jumps</h2>{_table(head, rows)}</section>"


def _topic_table(figures: Iterable[TopicFigures]) -> str:
    head = ["topic", *(label for label, _, _ in _TOPIC_COLUMNS)]
    rows = []
    for item in figures:
        bad = {
            "gaps": bool(item.gaps),
            "missed": item.missed > 0,
            "dropped": item.dropped > 0,
            "rejected": item.rejected > 0,
        }
        cells = [f'<td title="{_safe(item.type)}">{_safe(item.topic)}</td>']
        for (_, name, _), text in zip(_TOPIC_COLUMNS, _cells(item), strict=True):
            mark = ' class="bad"' if bad.get(name) else ""
            cells.append(f"<td{mark}>{text}</td>")
        rows.append(cells)
    return (
        "<h3>Topics</h3><p class='soft'>Rates and gaps in simulated time (health and status: by "
        "the machine's clock); delay from sending to reception by the machine's clock. "
        "Lost: on the way to the recorder; dropped: by the recorder; refused: breaking the "
        "contract.</p>"
        f"{_table(head, rows)}"
    )


def _entries(heading: str, entries: Sequence[Entry]) -> str:
    if not entries:
        return ""
    rows = []
    for entry in entries[:_ROWS]:
        values = ", ".join(f"{key} = {_short(text)}" for key, text in entry.values.items())
        bad = ' class="words bad"' if entry.level in {"error", "warn"} else ' class="words"'
        rows.append(
            [
                f"<td>{entry.time_s:.3f}</td>",
                f'<td class="words">{_safe(entry.node)}</td>',
                f"<td{bad}>{_safe(entry.name)}</td>",
                f'<td class="words">{_safe(entry.message)}</td>',
                f'<td class="words soft">{_safe(values)}</td>',
            ]
        )
    table = _table(["time [s]", "node", "what", "why", "values"], rows)
    table = table.replace("<th>node", '<th class="words">node').replace(
        "<th>what", '<th class="words">what'
    )
    table = table.replace("<th>why", '<th class="words">why').replace(
        "<th>values", '<th class="words">values'
    )
    more = f"<p>and {len(entries) - _ROWS} more</p>" if len(entries) > _ROWS else ""
    return f"<section><h2>{heading}</h2>{table}{more}</section>"


def _short(text: str) -> str:
    try:
        return f"{float(text):.6g}"
    except ValueError:
        return text


def _settings(bag: Bag) -> str:
    if not bag.configurations:
        return ""
    blocks = "".join(
        f"<details><summary>{_safe(content.get('node', 'node'))}</summary>"
        f"<pre>{_safe(json.dumps(content, indent=2, sort_keys=True))}</pre></details>"
        for content in bag.configurations
    )
    return f"<section><h2>Configuration</h2>{blocks}</section>"


# --- the executable ------------------------------------------------------------------------------


def write_report(bag: Bag, metrics: Metrics, folder: Path) -> list[Path]:
    """Writes ``metrics.json``, ``report.html``, the plots as SVG files and the animation.

    Args:
        bag: What was read.
        metrics: What was measured in it.
        folder: Where to write; made if it is not there.

    Returns:
        The files written.

    Raises:
        OSError: They cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers, page = folder / "metrics.json", folder / "report.html"
    numbers.write_text(json.dumps(as_mapping(bag, metrics), indent=2) + "\n", encoding="utf-8")
    drawings = Drawings.of(bag, metrics)
    page.write_text(as_page(bag, metrics, drawings), encoding="utf-8")
    written = [numbers, page]
    if drawings.scenes[0] is not None:
        animation = folder / "animation.gif"
        write_gif(drawings.scenes[0], animation)
        written.append(animation)
    for plot in (*(drawings.plots[0] if drawings.plots else ()), *drawings.overall):
        file = folder / f"{plot.name}.svg"
        svg = plot.svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
        file.write_text(svg + "\n", encoding="utf-8")
        written.append(file)
    return written


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="bag_report",
        description="Reports what a bag holds: jumps, tension, energy, rates and gaps of every "
        "topic, events and refusals. Bags that were never closed or are damaged are read as far "
        "as they are whole.",
        epilog="exit codes: 0 reported, 2 no bag or none that can be read, 3 the report could "
        "not be written",
    )
    parser.add_argument("bag", type=Path, help="the bag: its folder or its .mcap file")
    parser.add_argument(
        "--out", type=Path, metavar="DIR",
        help="write metrics.json, report.html, plots and animation here (default: beside the bag, "
        "BAG_report)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON and write nothing else")
    parser.add_argument("--html", action="store_true", help="print the page and write nothing else")
    parser.add_argument("--namespace", help="which rover, where the bag holds several")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """The executable ``bag_report``; returns an :class:`ExitCode`."""
    options = _parser().parse_args(arguments)
    try:
        bag = read_bag(options.bag, namespace=options.namespace)
    except BagError as error:
        print(f"bag_report: {error}", file=sys.stderr)
        return ExitCode.REFUSED
    metrics = measure(bag)
    if options.json:
        print(json.dumps(as_mapping(bag, metrics), indent=2))
    elif options.html:
        print(as_page(bag, metrics, Drawings.of(bag, metrics)))
    else:
        print(as_text(bag, metrics))
    if options.out is None and (options.json or options.html):
        return ExitCode.OK
    folder = options.out or options.bag.with_name(options.bag.name + "_report")
    try:
        written = write_report(bag, metrics, folder)
    except OSError as error:
        print(
            f"bag_report: cannot write the report into {folder}: {error.strerror}", file=sys.stderr
        )
        return ExitCode.NOT_WRITTEN
    print("\nwritten: " + ", ".join(str(path) for path in written), file=sys.stderr)
    return ExitCode.OK


if __name__ == "__main__":
    sys.exit(main())
