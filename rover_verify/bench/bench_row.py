"""A row of `bench.json`: common keys and keys of a case."""

from __future__ import annotations

from collections.abc import Callable

Row = dict[str, object]
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
