"""The report as a self-contained HTML page that opens offline in any browser."""

import json
from collections.abc import Iterable, Sequence

from rover_bags.analysis.entries import TimelineEntry
from rover_bags.analysis.jumps import RecordedJump
from rover_bags.analysis.metrics import Metrics, TopicMetrics
from rover_bags.reading.read import Bag
from rover_bags.views.animation import MovingScene
from rover_bags.views.bag_analysis import SHOWN_IN_FULL, Drawings
from rover_bags.views.markup import escaped, page_file, plot_grid, table, whole_page
from rover_bags.views.sections import (
    activity_sections,
    audit_sentences,
    energy_balance_section,
    interval_section,
    metric_sections,
    momentum_sections,
)
from rover_bags.views.summary import (
    JUMP_METRICS,
    TOPIC_COLUMNS,
    data_warnings,
    formatted,
    recording_summary,
    topic_cells,
)

_ROWS = 400
_SHOWN_ROWS = 30


def as_page(bag: Bag, metrics: Metrics, drawings: Drawings) -> str:
    """Return the report as one self-contained HTML page."""
    title = f"Bag report: {bag.path.resolve().name}"
    parts = [
        f"<h1>{escaped(title)}</h1>",
        f'<p class="soft">{escaped(_origin(bag))}{escaped(recording_summary(bag, metrics))}</p>',
        _notes(data_warnings(bag, metrics)),
        _run_section(metrics, drawings),
    ]
    if len(metrics.jumps) > 1:
        parts.append(_jump_table(metrics.jumps))
    for number, jump in enumerate(metrics.jumps[:SHOWN_IN_FULL], 1):
        parts.append(_jump_section(jump, number, len(metrics.jumps), drawings))
    parts.append(_audit_section(metrics))
    parts.append("<section><h2>Recording</h2>")
    parts.append(plot_grid(drawings.recording))
    parts.append(_topic_table(metrics.topics.values()))
    parts.append("</section>")
    parts.append(_entries("Events", metrics.events))
    parts.append(_entries("Refusals", metrics.refusals))
    parts.append(_settings(bag))
    return whole_page(title, parts, page_file("player.js"))


def _run_section(metrics: Metrics, drawings: Drawings) -> str:
    """The whole run: animation, plots and tables."""
    parts = []
    if drawings.run is not None:
        poster = float(drawings.run.time[0])
        parts.append(_player(drawings.run, poster))
    parts.append(plot_grid(drawings.overall))
    sections = [*activity_sections(metrics), *metric_sections(metrics)]
    parts += [f"<h3>{escaped(item.name)}</h3>{item.as_html()}" for item in sections]
    if metrics.coverage is not None:
        parts.append(f"<h3>Wall coverage</h3><p>{escaped(metrics.coverage.summary)}.</p>")
    intervals = interval_section(metrics)
    if intervals is not None:
        count = len(metrics.timeline.intervals)
        parts.append(
            f"<details><summary>All {count} activity intervals</summary>"
            f"{intervals.as_html()}</details>"
        )
    if not metrics.jumps:
        parts.append("<p>No jump in this bag.</p>")
    return f"<section><h2>Run</h2>{''.join(parts)}</section>" if parts else ""


def _audit_section(metrics: Metrics) -> str:
    words = "".join(f"<p>{escaped(text)}</p>" for text in audit_sentences(metrics))
    energy_balance = energy_balance_section(metrics)
    sections = momentum_sections(metrics)
    if energy_balance is not None and energy_balance.rows:
        sections.insert(0, energy_balance)
    tables = "".join(
        f"<h3>{escaped(item.name)}</h3>{item.as_html()}"
        if len(item.rows) <= _SHOWN_ROWS
        else f"<details><summary>{escaped(item.name)}</summary>{item.as_html()}</details>"
        for item in sections
    )
    return (
        f"<section><h2>Energy and momentum audits</h2>{words}{tables}</section>"
        if words or tables
        else ""
    )


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
    items = "".join(f"<li>{escaped(text)}</li>" for text in texts[:30])
    more = f"<li>and {len(texts) - 30} more</li>" if len(texts) > 30 else ""
    return f'<div class="note"><b>Data quality</b><ul>{items}{more}</ul></div>'


def _cards(jump: RecordedJump) -> str:
    cards = "".join(
        f'<div class="card"><span>{label}</span>'
        f"<b>{escaped(formatted(getattr(jump, name), unit, form)).replace('e-0', 'e-')}</b></div>"
        for name, label, unit, form in JUMP_METRICS
    )
    return f'<div class="cards">{cards}</div>'


def _jump_section(jump: RecordedJump, number: int, count: int, drawings: Drawings) -> str:
    scene = drawings.scenes[number - 1]
    heading = "Jump" if count == 1 else f"Jump {number}"
    when = f"take-off at {jump.take_off_s:.3f} s of simulated time"
    if jump.touchdown_s is None:
        when += "; the recording ends in flight, metrics are of its recorded part"
    player = _player(scene, jump.apex_s - jump.take_off_s) if scene is not None else ""
    return (
        f'<section id="jump-{number}"><h2>{heading}</h2><p class="soft">{escaped(when)}</p>'
        f"{_cards(jump)}{_agreement(jump)}{player}"
        f"{plot_grid(drawings.plots[number - 1], prefix=f'jump{number}-')}</section>"
    )


def _agreement(jump: RecordedJump) -> str:
    """Difference between the metrics of the recorded motion and those published by the plant."""
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
        '<p class="soft">Computed from the recorded motion. The plant published '
        f"{escaped(' and '.join(words))}.</p>"
    )


def _player(scene: MovingScene, poster: float) -> str:
    data = json.dumps(scene.to_mapping(), separators=(",", ":")).replace("</", "<\\/")
    usual = 10 if scene.is_run else 0.25
    choices = (
        ((1, "real time"), (4, "4 x"), (10, "10 x"), (30, "30 x"), (100, "100 x"))
        if scene.is_run
        else ((0.1, "1/10 speed"), (0.25, "1/4 speed"), (0.5, "1/2 speed"), (1, "real time"),
              (4, "4 x"))
    )  # fmt: skip
    speeds = "".join(
        f'<option value="{value}"{" selected" if value == usual else ""}>{label}</option>'
        for value, label in choices
    )
    about = "Left: whole scene. Right: close-up of the rover. Both to scale, viewed along y. "
    if not scene.follow:
        about += "The ground line marks the level on which the rover stood. "
    return (
        f'<div class="player" data-poster="{poster:.4f}">'
        '<canvas role="img" aria-label="Side view of rover and tether"></canvas>'
        '<div class="bar"><button type="button">Play</button>'
        f'<select aria-label="Speed">{speeds}</select>'
        '<input type="range" aria-label="Time"><output></output></div>'
        f'<script type="application/json">{data}</script></div>'
        f'<p class="soft">{about}Click in a plot to move the animation to that time.</p>'
    )


def _jump_table(jumps: Sequence[RecordedJump]) -> str:
    head = ["jump", "take-off [s]"] + [
        f"{label} [{unit}]" if unit else label for _, label, unit, _ in JUMP_METRICS
    ]
    rows = []
    for number, jump in enumerate(jumps, 1):
        name = f'<a href="#jump-{number}">{number}</a>' if number <= SHOWN_IN_FULL else str(number)
        cells = [f"<td>{name}</td>", f"<td>{jump.take_off_s:.3f}</td>"]
        cells += [
            f"<td>{formatted(getattr(jump, key), '', form)}</td>"
            for key, _, _, form in JUMP_METRICS
        ]
        rows.append(cells)
    return f"<section><h2>Jumps</h2>{table(head, rows)}</section>"


def _topic_table(items: Iterable[TopicMetrics]) -> str:
    head = ["topic", *(label for label, _, _ in TOPIC_COLUMNS)]
    rows = []
    for item in items:
        bad = {
            "gaps": bool(item.gaps),
            "lost_in_transport": item.lost_in_transport > 0,
            "dropped": item.dropped > 0,
            "rejected": item.rejected > 0,
        }
        cells = [f'<td title="{escaped(item.type)}">{escaped(item.topic)}</td>']
        for (_, name, _), text in zip(TOPIC_COLUMNS, topic_cells(item), strict=True):
            mark = ' class="bad"' if bad.get(name) else ""
            cells.append(f"<td{mark}>{text}</td>")
        rows.append(cells)
    return (
        "<h3>Topics</h3><p class='soft'>Rates and gaps are in simulated time (status topics: wall "
        "time). Latency: publication to reception, wall time. Age: stamp to reception. Lost: in "
        "transport to the recorder; dropped: by the recorder; rejected: violates the "
        "contract.</p>"
        f"{table(head, rows)}"
    )


def _entries(heading: str, entries: Sequence[TimelineEntry]) -> str:
    if not entries:
        return ""
    rows = []
    for entry in entries[:_ROWS]:
        values = ", ".join(f"{key} = {_short(text)}" for key, text in entry.values.items())
        bad = ' class="words bad"' if entry.level in {"error", "warn"} else ' class="words"'
        rows.append(
            [
                f"<td>{entry.time_s:.3f}</td>",
                f'<td class="words">{escaped(entry.node)}</td>',
                f"<td{bad}>{escaped(entry.name)}</td>",
                f'<td class="words">{escaped(entry.message)}</td>',
                f'<td class="words soft">{escaped(values)}</td>',
            ]
        )
    words = ("node", "event", "message", "values")
    shown = table(["time [s]", *words], rows, text_columns=words)
    more = f"<p>and {len(entries) - _ROWS} more</p>" if len(entries) > _ROWS else ""
    return f"<section><h2>{heading}</h2>{shown}{more}</section>"


def _short(text: str) -> str:
    try:
        return f"{float(text):.6g}"
    except ValueError:
        return text


def _settings(bag: Bag) -> str:
    if not bag.configurations:
        return ""
    blocks = "".join(
        f"<details><summary>{escaped(content.get('node', 'node'))}</summary>"
        f"<pre>{escaped(json.dumps(content, indent=2, sort_keys=True))}</pre></details>"
        for content in bag.configurations
    )
    return f"<section><h2>Configuration</h2>{blocks}</section>"
