"""Tables of the report: activities, descents, drives, imaging stops and audits."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from rover_bags.analysis.metrics import Metrics
from rover_bags.analysis.timeline import Activity
from rover_bags.views.markup import escaped, table
from rover_runtime.text_output import text_table

_ROWS: Final = 200


@dataclass(frozen=True)
class Column:
    """One column of a table: heading with unit, value of a row, and number format."""

    heading: str
    value: Callable[[Any], float | str | None]
    form: str = ".2f"

    def text(self, row: Any) -> str:
        """Return the text of a cell."""
        value = self.value(row)
        if isinstance(value, str):
            return value
        if value is None or not math.isfinite(value):
            return "-"
        return f"{value:{self.form}}"


@dataclass(frozen=True)
class Section:
    """A table of the report.

    Attributes:
        name: Heading.
        columns: Columns.
        rows: Objects shown in the rows.
        about: Explanation above the table.
    """

    name: str
    columns: tuple[Column, ...]
    rows: tuple[Any, ...]
    about: str = ""

    def as_text(self) -> list[str]:
        """Return lines for a terminal."""
        cells = [[column.text(row) for column in self.columns] for row in self.rows[:_ROWS]]
        heads = [column.heading for column in self.columns]
        left = [i for i, head in enumerate(heads) if head in self._text_columns]
        lines = ["", f"{self.name.lower()}:"]
        lines += [f"  {line}" for line in text_table([heads, *cells], left)]
        if len(self.rows) > _ROWS:
            lines.append(f"  and {len(self.rows) - _ROWS} more")
        return lines

    def as_html(self) -> str:
        """Return a table for the page."""
        rows = [
            [_cell(column.value(row), column.text(row)) for column in self.columns]
            for row in self.rows[:_ROWS]
        ]
        about = f'<p class="soft">{escaped(self.about)}</p>' if self.about else ""
        more = f"<p>and {len(self.rows) - _ROWS} more</p>" if len(self.rows) > _ROWS else ""
        heads = [column.heading for column in self.columns]
        return f"{about}{table(heads, rows, text_columns=self._text_columns)}{more}"

    @property
    def _text_columns(self) -> set[str]:
        """Headings of columns that hold text."""
        return {
            column.heading
            for column in self.columns
            if any(isinstance(column.value(row), str) for row in self.rows[:_ROWS])
        }


def _cell(value: float | str | None, text: str) -> str:
    kind = ' class="words"' if isinstance(value, str) else ""
    return f"<td{kind}>{escaped(text)}</td>"


def _degrees(value: float | None) -> float | None:
    return None if value is None else math.degrees(value)


_WHEN: Final = (
    Column("start [s]", lambda row: row.begin_s),
    Column("end [s]", lambda row: row.end_s),
)

_DESCENTS: Final = (
    Column("direction", lambda d: "down" if d.downward else "up"),
    *_WHEN,
    Column("duration [s]", lambda d: d.end_s - d.begin_s),
    Column("length from [m]", lambda d: d.from_m, ".3f"),
    Column("to [m]", lambda d: d.to_m, ".3f"),
    Column("depth from [m]", lambda d: d.depth_from_m, ".3f"),
    Column("to [m]", lambda d: d.depth_to_m, ".3f"),
    Column("mean rate [m/s]", lambda d: d.rate_m_s, ".3f"),
    Column("max. rate [m/s]", lambda d: d.rate_max_m_s, ".3f"),
    Column(
        "tracking error [mm]",
        lambda d: None if d.tracking_error_m is None else 1e3 * d.tracking_error_m,
    ),
    Column("mean tension [N]", lambda d: d.tension_mean_N),
    Column("ripple [%]", lambda d: None if d.ripple is None else 100.0 * d.ripple),
    Column("peak tension [N]", lambda d: d.peak_tension_N),
    Column("max. swing [deg]", lambda d: _degrees(d.swing_max_rad)),
    Column("RMS swing [deg]", lambda d: _degrees(d.swing_rms_rad)),
)

_DRIVES: Final = (
    Column("motion", lambda d: "turn" if d.turning else "drive"),
    *_WHEN,
    Column("path [m]", lambda d: d.path_m, ".3f"),
    Column("displacement [m]", lambda d: d.distance_m, ".3f"),
    Column("heading change [deg]", lambda d: _degrees(d.heading_rad), "+.1f"),
    Column("rolled [m]", lambda d: d.rolled_m, ".3f"),
    Column("slip [%]", lambda d: None if d.slip is None else 100.0 * d.slip, ".1f"),
    Column("odometry error [m]", lambda d: d.odometry_error_m, ".3f"),
)

_TRAVERSES: Final = (
    *_WHEN,
    Column("drives", lambda t: t.drives, "d"),
    Column("path [m]", lambda t: t.path_m, ".3f"),
    Column("start to end [m]", lambda t: t.closing_distance_m, ".3f"),
)

_IMAGING_STOPS: Final = (
    *_WHEN,
    Column("depth [m]", lambda e: e.depth_m),
    Column("wall distance [m]", lambda e: e.wall_m),
    Column("images", lambda e: e.images, "d"),
    Column("sharp [%]", lambda e: 100.0 * e.sharp, ".1f"),
    Column("median smear [px]", lambda e: e.smear_median_px),
    Column("max. smear [px]", lambda e: e.smear_max_px),
)

_ACTIVITIES: Final = (
    Column("activity", lambda row: row[0]),
    Column("count", lambda row: row[1], "d"),
    Column("total [s]", lambda row: row[2]),
    Column("share [%]", lambda row: row[3], ".1f"),
)

_INTERVALS: Final = (
    Column("activity", lambda interval: interval.activity.value),
    *_WHEN,
    Column("duration [s]", lambda interval: interval.duration_s),
)

_EVENTS: Final = (
    Column("event", lambda event: event.kind.value.replace("_off", "-off").replace("_", " ")),
    Column("time [s]", lambda event: event.time_s, ".3f"),
    Column("reason", lambda event: event.reason),
)

_COMMANDS: Final = (
    Column("taken [s]", lambda command: command.taken_s, ".3f"),
    Column("ended [s]", lambda command: command.changed_s if command.reason else None, ".3f"),
    Column("sender", lambda command: command.sender),
    Column("command", lambda command: command.request),
    Column("state", lambda command: command.state),
    Column("reason", lambda command: command.reason),
    Column("text", lambda command: command.text),
)

_ENERGY_BALANCE: Final = (
    Column("activity", lambda line: line.activity),
    *_WHEN,
    Column("input [J]", lambda line: line.input_J, "+.3f"),
    Column("dissipated [J]", lambda line: line.dissipated_J, "+.3f"),
    Column("stored [J]", lambda line: line.stored_J, "+.3f"),
    Column("residual [J]", lambda line: line.residual_J, "+.1e"),
)

_ROTORS: Final = (
    Column("rotor", lambda rotor: rotor.name.replace("_", " ")),
    Column("max. [N m s]", lambda rotor: rotor.momentum_max_N_m_s, ".4f"),
    Column("limit [N m s]", lambda rotor: rotor.momentum_limit_N_m_s, ".3f"),
    Column("share [%]", lambda r: None if r.share is None else 100.0 * r.share, ".1f"),
    Column("final [N m s]", lambda rotor: rotor.momentum_final_N_m_s, ".4f"),
)

_FLIGHTS: Final = (
    *_WHEN,
    Column("momentum change [N s]", lambda f: f.momentum_change_N_s, ".4f"),
    Column("tether impulse [N s]", lambda f: f.tether_impulse_N_s, ".4f"),
    Column("unexplained [N s]", lambda f: f.unexplained_N_s, ".4f"),
    Column("angular momentum change [N m s]", lambda f: f.angular_momentum_change_N_m_s, ".4f"),
    Column("max. angular momentum [N m s]", lambda f: f.angular_momentum_max_N_m_s, ".4f"),
)


def activity_sections(metrics: Metrics) -> list[Section]:
    """Return the tables of total times by activity, of timeline events and of commands."""
    found = []
    timeline = metrics.timeline
    if timeline.intervals:
        found.append(Section("Activities", _ACTIVITIES, tuple(_shares(metrics))))
    if timeline.events:
        found.append(Section("Timeline events", _EVENTS, timeline.events))
    if metrics.commands:
        found.append(
            Section(
                "Commands", _COMMANDS, metrics.commands,
                "Requests and service calls that the nodes have taken. Sender: name and "
                "identifier; where none is named the stamp [ns].",
            )
        )  # fmt: skip
    return found


def interval_section(metrics: Metrics) -> Section | None:
    """Return the table of all activity intervals."""
    intervals = metrics.timeline.intervals
    return Section("Activity intervals", _INTERVALS, intervals) if intervals else None


def _shares(metrics: Metrics) -> Iterable[tuple[str, int, float, float]]:
    times: dict[Activity, list[float]] = defaultdict(list)
    for interval in metrics.timeline.intervals:
        times[interval.activity].append(interval.duration_s)
    total = sum(sum(spans) for spans in times.values()) or 1.0
    for what, spans in times.items():
        yield what.value, len(spans), sum(spans), 100.0 * sum(spans) / total


def metric_sections(metrics: Metrics) -> list[Section]:
    """Return the tables of descents, imaging stops, drives and traverses that the bag holds."""
    sections = [
        Section(
            "Descents", _DESCENTS, metrics.descents,
            "Length: at the drum. Depth: of Body 1 below the fairlead. Tension: at the fairlead; "
            "mean and ripple (RMS of the detrended tension over its mean) during steady payout. "
            "Swing: angle from the vertical of the line from the fairlead to Body 1.",
        ),
        Section(
            "Imaging stops", _IMAGING_STOPS, metrics.imaging_stops,
            "Images of the wall taken while the rover hung at one depth. Sharp: motion smear of at "
            "most 1 px.",
        ),
        Section(
            "Drives", _DRIVES, metrics.drives,
            "Path and displacement: of Body 1 over ground. Rolled: mean of both wheels. Slip: "
            "1 - path/rolled. Odometry error: dead reckoning from encoders and gyro against the "
            "true position.",
        ),
        Section(
            "Traverses", _TRAVERSES, metrics.traverses,
            "Consecutive drives between two times off the floor.",
        ),
    ]  # fmt: skip
    return [section for section in sections if section.rows]


def energy_balance_section(metrics: Metrics) -> Section | None:
    """Return the energy balance of each activity interval."""
    energy = metrics.audits.energy
    return (
        None
        if energy is None
        else Section("Energy balance by activity interval", _ENERGY_BALANCE, energy.intervals)
    )


def momentum_sections(metrics: Metrics) -> list[Section]:
    """Return the tables of rotors and flights."""
    audits = metrics.audits
    found = []
    if audits.rotors:
        found.append(Section("Angular momentum of rotors", _ROTORS, audits.rotors))
    if audits.flights:
        found.append(
            Section(
                "Momentum in flight", _FLIGHTS, audits.flights,
                "Momentum change: linear momentum of both bodies beyond gravity's impulse. "
                "Unexplained: change beyond the tether's impulse. Angular momentum: about the "
                "common centre of mass, rotors included; the tether and the slider's friction "
                "change it.",
            )
        )  # fmt: skip
    return found


def audit_sentences(metrics: Metrics) -> list[str]:
    """Return the results of the audits in sentences."""
    energy, lines = metrics.audits.energy, []
    if energy is not None:
        share = (
            ""
            if energy.share is None
            else f", {100.0 * energy.share:.2g} % of the turnover of {energy.turnover_J:.4g} J"
        )
        lines.append(
            f"Energy: the balance closes within {energy.residual_J:.2g} J{share}. The published "
            f"drift agrees with the recorded terms within {energy.drift_error_J:.1g} J."
        )
        if energy.gravity_error_J is not None:
            lines.append(
                "Gravity: the recorded term agrees with the recorded positions of bodies and "
                f"tether within {energy.gravity_error_J:.2g} J."
            )
    lines += [f"Not audited: {text}." for text in metrics.audits.not_audited]
    return lines


def texts(sections: Sequence[Section]) -> list[str]:
    """Return all sections as lines for a terminal."""
    return [line for section in sections for line in section.as_text()]
