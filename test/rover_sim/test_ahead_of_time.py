"""Ahead-of-time compilation: all processes run the same code."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rover_sim import ahead_of_time, load_scenario
from rover_sim import compile_ahead as exported
from rover_sim.ahead_of_time import compile_ahead

ROOT = Path(__file__).resolve().parents[2]

JUMP = """
from rover_sim import build_plant, compile_ahead, jump, load_scenario
scenario = load_scenario("paper_table1_high", {"tether.elements": 10, "start.slack": 1.29})
assert compile_ahead(scenario)
metrics = jump(build_plant(scenario))
print(metrics.height.hex(), metrics.attitude_variation.hex())
"""


@pytest.mark.process
@pytest.mark.slow
def test_the_first_process_on_a_machine_computes_what_the_later_ones_do(tmp_path: Path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    outputs = [
        subprocess.run(
            [sys.executable, "-c", JUMP],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=600.0,
        ).stdout
        for _ in range(2)
    ]
    assert outputs[0] == outputs[1]


def test_the_plant_is_compiled_once(monkeypatch: pytest.MonkeyPatch):
    scenario = load_scenario("paper_table1_high")
    assert exported is compile_ahead
    assert compile_ahead(scenario)

    def start(*_arguments: object, **_options: object) -> None:
        raise AssertionError("compiled again")

    monkeypatch.setattr(subprocess, "Popen", start)
    assert compile_ahead(scenario)


@pytest.fixture
def unmarked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is compiled yet, and the cache cannot be written."""
    monkeypatch.setattr(ahead_of_time, "_marker", lambda _model: tmp_path / "not there" / "marker")


@pytest.mark.usefixtures("unmarked")
def test_a_cache_that_cannot_be_written_is_reported():
    assert not compile_ahead(load_scenario("paper_table1_high"))


@pytest.mark.usefixtures("unmarked")
def test_a_cancelled_compilation_leaves_no_process(monkeypatch: pytest.MonkeyPatch):
    started: list[subprocess.Popen[bytes]] = []

    class ObservedProcess(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", ObservedProcess)
    polls: list[bool] = []

    def cancelled() -> bool:
        polls.append(len(started) == 2)
        return len(polls) == 3

    assert not compile_ahead(load_scenario("paper_table1_high"), cancelled)
    assert polls == [True] * 3
    assert [process.returncode for process in started] == [-signal.SIGKILL] * 2
