"""The state as lines and tables for a terminal."""

from __future__ import annotations

import itertools
from datetime import UTC, datetime

from rich import box
from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from operator_console.telemetry import (
    CommandReport,
    NodeHealth,
    Snapshot,
    StatusReport,
    TelemetryReading,
)

_BAD, _WARN, _STALE = "bold red", "yellow", "dim italic"
_LEVELS = {"OK": "", "WARN": _WARN, "ERROR": _BAD, "STALE": _STALE}
_SIMULATION_END = 1e9  # later stamps are wall-clock time [s]
_SHOWN = 5  # refusals and events
_IN_A_LINE = ("depth", "payout_rate", "tension", "swing_major")


def age_text(age: float) -> str:
    """An age with its unit."""
    if age < 10.0:
        return f"{age:.1f} s"
    return f"{age:.0f} s" if age < 120.0 else f"{age / 60.0:.0f} min"


def time_text(stamp: float) -> str:
    """A stamp: simulated seconds, or the time of day in UTC, wherever the terminal is."""
    if stamp < _SIMULATION_END:
        return f"{stamp:.1f} s"
    return datetime.fromtimestamp(stamp, UTC).strftime("%H:%M:%SZ")


def status_view(now: Snapshot) -> RenderableType:
    """The whole state in groups, side by side if the terminal is wide."""
    boxes = [_panel("phases", _phases(now)), *_numbers(now)]
    parts: list[RenderableType] = [Columns(boxes, padding=(0, 1)), _panel("nodes", _nodes(now))]
    if now.commands:
        parts.append(_panel("last commands", command_view(now.commands[-_SHOWN:])))
    if now.refusals:
        parts.append(_panel("last refusals", _reports(now.refusals)))
    if now.events:
        parts.append(_panel("last events", _reports(now.events)))
    return Group(*parts)


def status_line(now: Snapshot) -> str:
    """The most important values in one line, for a log."""
    parts = []
    for key in _IN_A_LINE:
        reading = now.reading(key)
        if reading.value is not None:
            parts.append(f"{reading.label} {_with_age(reading)}")
    parts += [f"{w.label} {_with_age(w)}" for w in now.phases if w.value is not None]
    parts += [f"ALARM {name}" for name in now.alarms]
    parts += [f"{node.node} SILENT {age_text(node.age)}" for node in now.nodes if node.is_silent]
    parts += [
        f"{node.node} {node.condition}"
        for node in now.nodes
        if not node.is_silent and node.condition != "ready"
    ]
    return ", ".join(parts) if parts else "no data"


def _with_age(reading: TelemetryReading) -> str:
    if reading.is_stale and reading.age is not None:
        return f"{reading.text} (STALE, {age_text(reading.age)} old)"
    return reading.text


def _cell(reading: TelemetryReading) -> Text:
    if reading.value is None:
        return Text("no data", style=_STALE)
    style = _STALE if reading.is_stale else _BAD if reading.is_warning else "bold"
    return Text(_with_age(reading), style=style)


def _grid() -> Table:
    return Table.grid(padding=(0, 2, 0, 0))


def _panel(title: str, content: RenderableType) -> Panel:
    return Panel(content, title=title, title_align="left", box=box.ROUNDED, expand=False)


def _phases(now: Snapshot) -> RenderableType:
    grid = _grid()
    for word in now.phases:
        grid.add_row(word.label, _cell(word))
    alarms = ", ".join(now.alarms) if now.alarms else "none"
    grid.add_row("alarms", Text(alarms, style=_BAD if now.alarms else ""))
    return grid


def _numbers(now: Snapshot) -> list[RenderableType]:
    parts: list[RenderableType] = []
    for group, readings in itertools.groupby(now.readings, key=lambda row: row.group):
        rows = list(readings)
        if all(row.value is None for row in rows):
            continue
        grid = _grid()
        for row in rows:
            grid.add_row(row.label, _cell(row))
        parts.append(_panel(group, grid))
    return parts


def _nodes(now: Snapshot) -> RenderableType:
    grid = _grid()
    for node in now.nodes:
        grid.add_row(Text(node.node), _health(node))
    for station in now.link:
        grid.add_row(Text(f"link: {station.node}"), _health(station))
    if now.simulation is not None:
        parts = (now.simulation.condition, now.simulation.pace)
        grid.add_row("simulation", Text("; ".join(filter(None, parts))))
    return grid


def _health(node: NodeHealth) -> Text:
    if node.is_silent:
        return Text(f"SILENT for {age_text(node.age)}, last report: {node.condition}", style=_BAD)
    text = Text(node.condition, style=_LEVELS[node.level])
    if node.level != "OK":
        for detail in node.details:
            text.append(f"; {detail}")
    return text


def command_view(commands: tuple[CommandReport, ...]) -> RenderableType:
    """Commands with their senders, states and reasons, the last changed one last."""
    grid = _grid()
    for each in commands:
        state = each.state
        if each.progress is not None and not each.is_over:
            state += f" {100.0 * each.progress:.0f} %"
        style = _WARN if each.is_warning else "" if each.is_over else "bold"
        code = f" [{each.reason}]" if each.reason else ""
        cells = (each.name, f"{each.subject} {each.what}".rstrip())
        grid.add_row(
            time_text(each.taken), *map(Text, cells), Text(state, style=style),
            Text(f"{each.text}{code}".strip()), time_text(each.changed),
        )  # fmt: skip
    return grid


def _reports(reports: tuple[StatusReport, ...]) -> RenderableType:
    grid = _grid()
    for each in reports[-_SHOWN:]:
        code = f" [{each.values['code']}]" if "code" in each.values else ""
        what = Text(f"{each.name}: {each.message}{code}", style=_LEVELS[each.level])
        grid.add_row(time_text(each.stamp), Text(each.node), what)
    return grid
