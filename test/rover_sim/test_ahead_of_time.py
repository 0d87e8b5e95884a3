"""Whoever compiles first, all processes run the same code."""

import os
import subprocess
import sys
from pathlib import Path

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
    told = [
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
    assert told[0] == told[1]


def test_it_is_done_once(monkeypatch: pytest.MonkeyPatch):
    scenario = load_scenario("paper_table1_high")
    assert exported is compile_ahead
    assert compile_ahead(scenario)

    def start(*_arguments: object, **_options: object) -> None:
        raise AssertionError("started again")

    monkeypatch.setattr(subprocess, "run", start)
    assert compile_ahead(scenario)


def test_where_nothing_can_be_kept_it_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(ahead_of_time, "_marker", lambda _model: tmp_path / "not there" / "marker")
    monkeypatch.setattr(subprocess, "run", lambda *_a, **_k: None)
    assert not compile_ahead(load_scenario("paper_table1_high"))
