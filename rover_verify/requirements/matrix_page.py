"""The verification matrix as one self-contained HTML page."""

from __future__ import annotations

import html
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby

STATES = ("PASS", "FAIL", "ERROR", "NOT RUN", "OPEN")
NOT_PASSED = ("FAIL", "ERROR", "NOT RUN")

_STYLE = """
:root { --ink:#1d2430; --dim:#667085; --line:#e3e6ec; --paper:#fff; --ground:#f5f6f8; }
* { box-sizing:border-box }
body { margin:0; background:var(--ground); color:var(--ink);
  font:15px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif }
main { max-width:1280px; margin:0 auto; padding:28px 20px 60px }
h1 { margin:0 0 4px; font-size:26px } h2 { margin:34px 0 10px; font-size:18px }
.sub { color:var(--dim) }
.tiles { display:flex; gap:12px; flex-wrap:wrap; margin:20px 0 6px }
.tile { background:var(--paper); border:1px solid var(--line); border-radius:10px;
  padding:12px 18px; min-width:118px; border-top:4px solid var(--colour) }
.tile b { display:block; font-size:26px; line-height:1.1 } .tile span { color:var(--dim) }
.bar { display:flex; height:10px; border-radius:5px; overflow:hidden; margin:14px 0 4px }
.bar i { background:var(--colour) }
table { width:100%; border-collapse:collapse; background:var(--paper); border:1px solid var(--line);
  border-radius:10px; overflow:hidden; table-layout:fixed }
th,td { text-align:left; vertical-align:top; padding:9px 12px; border-top:1px solid var(--line) }
th { background:#fafbfc; color:var(--dim); font-weight:600; font-size:13px; border-top:0 }
td.id { font:13px/1.5 ui-monospace,"DejaVu Sans Mono",monospace; overflow-wrap:anywhere }
td.num { font-variant-numeric:tabular-nums; overflow-wrap:anywhere }
.note { color:var(--dim); font-size:13px; margin-top:3px; overflow-wrap:anywhere }
.state { display:inline-block; padding:1px 9px; border-radius:9px; font-size:12.5px;
  font-weight:700; color:#fff; background:var(--colour); white-space:nowrap }
.PASS { --colour:#18794e } .FAIL { --colour:#c62a2f } .ERROR { --colour:#9b1c5a }
.NOT-RUN { --colour:#8a6d00 } .OPEN { --colour:#5f6b7c }
.trouble { margin-top:14px; padding:10px 14px; background:#fdecec; border-radius:8px }
summary { cursor:pointer; color:var(--dim); font-size:13px }
details table { margin-top:6px; border-radius:6px } details td { padding:3px 8px; font-size:13px }
code { font:12.5px ui-monospace,"DejaVu Sans Mono",monospace; color:var(--dim) }
"""


def render(rows: Sequence[Mapping[str, object]], runs: int, seed: int) -> str:
    """Return the page of the rows of verification.json."""
    counts = {state: sum(row["state"] == state for row in rows) for state in STATES}
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    tiles = "".join(
        f'<div class="tile {_kind(state)}"><b>{count}</b><span>{state.lower()}</span></div>'
        for state, count in counts.items()
        if count
    )
    bar = "".join(
        f'<i class="{_kind(state)}" style="flex:{count}"></i>'
        for state, count in counts.items()
        if count
    )
    required = [row for row in rows if row["status"] == "required"]
    passed = sum(row["state"] == "PASS" for row in required)
    sections = "".join(
        _section(str(area), list(group)) for area, group in groupby(rows, lambda row: row["area"])
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Verification of mother_rover</title><style>{_STYLE}</style></head><body><main>"
        "<h1>Verification of mother_rover</h1>"
        f'<div class="sub">{passed} of {len(required)} required rows passed &middot; {runs} runs, '
        f"seed {seed} &middot; {when} &middot; Python {platform.python_version()} on "
        f"{html.escape(platform.machine())}</div>"
        f'<div class="tiles">{tiles}</div><div class="bar">{bar}</div>{_failures(rows)}{sections}'
        "</main></body></html>\n"
    )


def _section(area: str, rows: Sequence[Mapping[str, object]]) -> str:
    body = "".join(_row(row) for row in rows)
    return (
        f"<h2>{html.escape(area)}</h2><table><colgroup><col style='width:16%'>"
        "<col style='width:8%'><col style='width:44%'><col style='width:12%'>"
        "<col style='width:20%'></colgroup><tr><th>id</th><th>state</th><th>requirement</th>"
        f"<th>required</th><th>measured</th></tr>{body}</table>"
    )


def _row(row: Mapping[str, object]) -> str:
    state, measured = str(row["state"]), row["measured"]
    unit = "" if row["unit"] == "-" else f" {row['unit']}"
    value = "&ndash;" if measured is None else html.escape(f"{measured:.4g}{unit}")
    if state == "OPEN" and measured is not None:
        value += " (reached)" if row["pass"] else " (not reached)"
    note = f'<div class="note">{html.escape(str(row["note"]))}</div>' if row["note"] else ""
    alone = f'<div class="note">{row["method"]}: <code>{html.escape(str(row["command"]))}</code>'
    alone = f"{alone}</div>" if measured is not None or state in {"ERROR", "NOT RUN"} else ""
    return (
        f'<tr id="{row["id"]}"><td class="id">{row["id"]}</td>'
        f'<td><span class="state {_kind(state)}">{state}</span></td>'
        f"<td>{html.escape(str(row['statement']))}{alone}</td>"
        f'<td class="num">{_signs(str(row["required"]))}</td>'
        f'<td class="num">{value}{note}{_details(row["details"])}</td></tr>'
    )


def _signs(required: str) -> str:
    return html.escape(required.replace("<=", "≤").replace(">=", "≥").replace("==", "="))


def _failures(rows: Sequence[Mapping[str, object]]) -> str:
    """Links to the rows that did not pass."""
    links = ", ".join(
        f'<a href="#{row["id"]}">{row["id"]}</a>' for row in rows if row["state"] in NOT_PASSED
    )
    return f'<div class="trouble">Not passed: {links}</div>' if links else ""


def _details(details: object) -> str:
    if not isinstance(details, Mapping) or not details:
        return ""
    body = "".join(
        f"<tr><td>{html.escape(str(name))}</td>"
        f"<td class='num'>{html.escape(_text(value))}</td></tr>"
        for name, value in details.items()
    )
    return f"<details><summary>{len(details)} values</summary><table>{body}</table></details>"


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _kind(state: str) -> str:
    return state.replace(" ", "-")
