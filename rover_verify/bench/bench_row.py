"""Rows of `bench.json`: common keys and keys of a case, and their tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

Row = dict[str, Any]
Progress = Callable[[str], None]


def bench_row(case: str, elements: int, **more: object) -> Row:
    """Make a row; common keys that were not measured are None.

    Args:
        case: name.
        elements: n.
        more: measured common keys, and the case's own keys.
    """
    common: Row = dict.fromkeys(
        ("rtf", "error_m", "peer", "peer_rtf", "peer_error_m", "peer_setting", "ratio")
    )
    return {"case": case, "n": elements, **common, **more}


def text_table(columns: Sequence[tuple[str, str, str]], rows: Sequence[Row]) -> list[str]:
    """Lines of a table for a terminal; a value that was not measured is a dash.

    Args:
        columns: heading, key, and format of its numbers; texts are aligned left.
        rows: of the bench.
    """
    lines = [""] * (len(rows) + 2)
    for head, key, form in columns:
        values = [row.get(key) for row in rows]
        cells = [head, "", *(_cell(value, form) for value in values)]
        width = max(map(len, cells))
        cells[1] = "-" * width
        is_text = any(isinstance(value, str) for value in values)
        lines = [
            f"{line}  {cell:{'<' if is_text else '>'}{width}}"
            for line, cell in zip(lines, cells, strict=True)
        ]
    return [line[2:].rstrip() for line in lines]


def _cell(value: object, form: str) -> str:
    return "-" if value is None else f"{value:{form}}" if not isinstance(value, str) else value
