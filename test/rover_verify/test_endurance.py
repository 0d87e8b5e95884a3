"""Growth of what processes use, from samples over simulated time."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import tool_scripts

from rover_verify.checks.endurance import Endured, UsageSample

TIMES = [60.0 * k for k in range(61)]  # an hour


def sample(time: float, leak: float, handles: int) -> UsageSample:
    """Memory of a process that leaks so much an hour, beside one that only starts up."""
    started = min(time / 600.0, 1.0)
    memory = {"leaking": 100.0 + leak * time / 3600.0, "starting": 50.0 + 80.0 * started}
    return UsageSample(time, memory, {"leaking": handles}, 0.1 * time / 3600.0, 2.0 * time)


def test_a_leak_is_found_and_what_a_start_takes_is_not():
    found = Endured([sample(time, 12.0, 20) for time in TIMES])
    name, slope = found.largest(lambda each: each.memory)
    assert name == "leaking"
    assert slope == pytest.approx(12.0)
    assert found.growth(lambda each: each.memory["starting"]) == pytest.approx(0.0, abs=1e-9)
    assert found.growth(lambda each: each.log) == pytest.approx(0.1)
    assert found.growth(lambda each: each.bag) == pytest.approx(7200.0)


def test_handles_that_are_not_closed_are_found():
    found = Endured([sample(time, 0.0, 20 + int(time // 600)) for time in TIMES])
    name, slope = found.largest(lambda each: dict(each.handles))
    assert name == "leaking"
    assert slope == pytest.approx(6.0, rel=0.1)


def test_a_process_that_has_ended_has_no_growth():
    found = Endured([sample(time, 12.0, 20) for time in TIMES])
    last = found.samples[-1]
    found.samples[-1] = last._replace(memory={"starting": last.memory["starting"]})
    name, _ = found.largest(lambda each: each.memory)
    assert name == "starting"


def test_a_process_that_was_started_again_counts_after_the_faults():
    found = Endured([sample(time, 12.0, 20) for time in TIMES])
    early = found.samples[5]
    found.samples[5] = early._replace(memory={"starting": early.memory["starting"]})
    name, slope = found.largest(lambda each: each.memory)
    assert name == "leaking"
    assert slope == pytest.approx(12.0)


def test_the_curves_are_drawn_from_the_results(tmp_path: Path):
    tool = tool_scripts.load("endurance_picture")
    picture = tmp_path / "endurance.png"
    with pytest.raises(FileNotFoundError, match="mother_rover verify"):
        tool.main([str(tmp_path), str(picture)])
    kept = tmp_path / "verification" / "kept" / "0123"
    kept.mkdir(parents=True)
    found = Endured([sample(time, 12.0, 20) for time in TIMES])
    (kept / "endure_1.0_1_0.pickle").write_bytes(pickle.dumps(found))
    assert tool.main([str(tmp_path), str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    memory, handles, log, bag = tool.draw(found).axes
    assert [line.get_label() for line in memory.lines] == ["leaking", "starting"]
    assert memory.lines[0].get_ydata()[-1] == pytest.approx(112.0)
    assert [len(axes.lines) for axes in (handles, log, bag)] == [1, 1, 1]
    assert bag.lines[0].get_xdata()[-1] == pytest.approx(1.0)
    assert bag.lines[0].get_ydata()[-1] == pytest.approx(7200.0)
