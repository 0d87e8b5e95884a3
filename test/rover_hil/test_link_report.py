"""Reports of the link do not hold up its cycles."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rover_hil.bridge.bridge import Bridge
from rover_hil.bridge.bridge_node import BridgeNode
from rover_hil.bridge.statistics import WINDOW_SIZE


class RecordedLock:
    """Lock that knows whether it is held."""

    def __init__(self) -> None:
        self.is_held = False

    def __enter__(self) -> None:
        self.is_held = True

    def __exit__(self, *_: object) -> None:
        self.is_held = False


def test_percentiles_of_full_windows_are_computed_while_the_lock_of_the_cycles_is_free(
    monkeypatch: pytest.MonkeyPatch,
):
    bridge = Bridge(lambda _id, _data: None, lambda _: None, lambda _: None)
    for value in np.arange(float(WINDOW_SIZE)):
        for window in (bridge.round_trip, bridge.command_time, bridge.answer_time):
            window.add(value)
    lock = RecordedLock()
    held: list[bool] = []
    percentile = np.percentile

    def recorded(*args: Any, **options: Any) -> Any:
        held.append(lock.is_held)
        return percentile(*args, **options)

    monkeypatch.setattr(np, "percentile", recorded)
    link = SimpleNamespace(sent=0, received=0, line_errors=0, failed=0, problem="")
    node = SimpleNamespace(
        active=True,
        NAME=BridgeNode.NAME,
        _lock=lock,
        _bridge=bridge,
        _open_link=link,
        _now_ns=lambda: 0,
    )
    status, *_ = BridgeNode.health(node)  # type: ignore[arg-type]
    assert held == [False] * 3
    for name in ("round_trip", "command_time", "answer_time"):
        assert status.values[f"{name}_count"] == str(WINDOW_SIZE)
        assert float(status.values[f"{name}_max"]) == WINDOW_SIZE - 1.0
