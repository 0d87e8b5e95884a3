"""A row of `bench.json`: what every case has, and what it has besides."""

from __future__ import annotations

from collections.abc import Callable

Row = dict[str, object]
Tell = Callable[[str], None]


def bench_row(case: str, elements: int, **more: object) -> Row:
    """A row in which what was not measured is None.

    Args:
        case: name.
        elements: n.
        more: of the common keys those that were measured, and the case's own.
    """
    common: Row = dict.fromkeys(
        ("rtf", "error_m", "peer", "peer_rtf", "peer_error_m", "peer_setting", "ratio")
    )
    return {"case": case, "n": elements, **common, **more}
