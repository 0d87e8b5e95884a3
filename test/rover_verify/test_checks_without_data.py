"""Checks that have measured nothing do not pass."""

import math
from pathlib import Path

import pytest

from rover_bags.analysis.timeline import Activity, ActivityInterval, Timeline
from rover_verify.checks import CheckBatch, bags_report, hil_fuzz, hil_safety
from rover_verify.harness.hil_bench import HilBench
from rover_verify.harness.scripted_bag import TrueActivity


@pytest.fixture
def batch(tmp_path: Path) -> CheckBatch:
    return CheckBatch(runs=1, seed=1, folder=tmp_path)


@pytest.fixture
def without_arming(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the drives disarmed."""
    monkeypatch.setattr(HilBench, "arm", lambda bench: bench.cycles(0.1))
    monkeypatch.setattr("rover_hil.bridge.bridge.Bridge.arm", lambda _bridge, _now_ns: "")


@pytest.mark.usefixtures("without_arming")
def test_frames_without_an_active_drive_are_an_error(batch: CheckBatch):
    with pytest.raises(RuntimeError, match="driven in 0 of 4 cycles"):
        hil_fuzz.frames(batch, 400)


@pytest.mark.usefixtures("without_arming")
def test_a_disordered_link_that_no_command_passes_is_an_error(batch: CheckBatch):
    with pytest.raises(RuntimeError, match="no command passed"):
        hil_safety.stale(batch)


def test_a_fault_that_a_report_misses_has_no_finite_error(
    batch: CheckBatch, monkeypatch: pytest.MonkeyPatch
):
    script = [TrueActivity("hanging", 0.0, 9.0), TrueActivity("fault", 5.0, 5.0)]
    timeline = Timeline((ActivityInterval(Activity.HANGING, 0.0, 9.0, 0, 0),))
    monkeypatch.setattr(bags_report, "_missions", lambda _batch: [(script, timeline)])
    assert bags_report.phase_times(batch).value == math.inf
