"""What a process in lockstep logs while simulated time waits for one of its computations."""

from __future__ import annotations

import time

import pytest

from rover_runtime.ros.lockstep import LockstepCarrier


@pytest.mark.ros
def test_a_computation_that_time_waits_for_is_logged_with_its_duration(
    monkeypatch: pytest.MonkeyPatch,
):
    clock, computing = [100.0], [True]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    carrier = LockstepCarrier({"nodes": ("jump_node",)}, "nodes", 1, "", "token")
    lines: list[str] = []
    carrier._logs["jump_node"] = lambda _level, text: lines.append(text)
    monkeypatch.setattr(carrier.process, "computing", lambda: ("jump_node",) * computing[0])
    for at, late in ((110, 0), (112, 1), (116, 1), (117, 1), (122, 1), (123, 0), (127, 1)):
        clock[0], computing[0] = float(at), bool(late)
        carrier._log_computations()
    assert [line.split(" for ")[1] for line in lines] == ["6 s", "12 s"]
    carrier.host.worker.close()
