"""The verification matrix as one self-contained HTML page."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby

from rover_bags.views.markup import escaped, table, whole_page

STATES = ("PASS", "FAIL", "ERROR", "NOT RUN", "OPEN")
NOT_PASSED = ("FAIL", "ERROR", "NOT RUN")
_TITLE = "Verification of mother_rover"
_HEAD = ("id", "state", "requirement", "required", "measured")

Row = Mapping[str, object]


def render(rows: Sequence[Row], runs: int, seed: int) -> str:
    """Return the page of the rows of verification.json."""
    required = [row for row in rows if row["status"] == "required"]
    passed = sum(row["state"] == "PASS" for row in required)
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    counts = {state: sum(row["state"] == state for row in rows) for state in STATES}
    cards = "".join(
        f'<div class="card"><b>{count}</b><span>{state.lower()}</span></div>'
        for state, count in counts.items()
        if count
    )
    links = ", ".join(
        f'<a href="#{row["id"]}">{row["id"]}</a>' for row in rows if row["state"] in NOT_PASSED
    )
    summary = (
        f"{passed} of {len(required)} required rows passed; {runs} runs, seed {seed}; {when}; "
        f"Python {platform.python_version()} on {platform.machine()}"
    )
    return whole_page(
        _TITLE,
        [
            f"<h1>{_TITLE}</h1>",
            f'<p class="soft">{escaped(summary)}</p>',
            f'<div class="cards">{cards}</div>',
            f'<div class="note bad">Not passed: {links}</div>' if links else "",
            *(
                f"<h2>{escaped(area)}</h2>" + table(_HEAD, map(_cells, group), _HEAD)
                for area, group in groupby(rows, lambda row: row["area"])
            ),
        ],
    )


def _cells(row: Row) -> list[str]:
    state, measured = str(row["state"]), row["measured"]
    unit = "" if row["unit"] == "-" else f" {row['unit']}"
    value = "-" if measured is None else f"{measured:.4g}{unit}"
    if state == "OPEN" and measured is not None:
        value += " (reached)" if row["pass"] else " (not reached)"
    how = f'<div class="soft">{row["method"]}: <code>{escaped(row["command"])}</code></div>'
    note = f'<div class="soft">{escaped(row["note"])}</div>' if row["note"] else ""
    kind = "words bad" if state in NOT_PASSED else "words"
    return [
        f'<td class="words" id="{row["id"]}">{row["id"]}</td>',
        f'<td class="{kind}">{state}</td>',
        f'<td class="words">{escaped(row["statement"])}{how}</td>',
        f'<td class="words">{escaped(row["required"])}</td>',
        f'<td class="words">{escaped(value)}{note}{_details(row["details"])}</td>',
    ]


def _details(details: object) -> str:
    if not isinstance(details, Mapping) or not details:
        return ""
    lines = "".join(
        f"<li>{escaped(name)}: {escaped(_text(value))}</li>" for name, value in details.items()
    )
    return f"<details><summary>{len(details)} values</summary><ul>{lines}</ul></details>"


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
