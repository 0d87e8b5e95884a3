"""Ahead-of-time compilation: all processes run the same code, regardless of the compiling one."""

import os
import pickle
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rover_sim import compile_ahead as exported
from rover_sim import load_scenario
from rover_sim.plants import ahead_of_time
from rover_sim.plants.ahead_of_time import compile_ahead

ROOT = Path(__file__).resolve().parents[2]
PLANAR, SPATIAL = "paper_table1_high", "free_hang"

JUMP = f"""
from rover_sim import build_plant, compile_ahead, jump, load_scenario
scenario = load_scenario({PLANAR!r}, {{"tether.elements": 10, "start.slack": 1.29}})
assert compile_ahead(scenario)
metrics = jump(build_plant(scenario))
print(metrics.height.hex(), metrics.attitude_variation.hex())
"""

COMPILE_COMMAND = """
from rover_cli.command_line import main
from rover_sim.plants import ahead_of_time
ahead_of_time._PROGRESS_PERIOD = 0.5
raise SystemExit(main(["compile", "planar"]))
"""

# Prints how many functions the simulations of all scenarios of a model call, those of them that
# `compile_ahead` has not compiled, and those of a step that it has compiled for more than one type.
COMPILED_BY_ITSELF = """
import gc, os, sys
from numba.core.registry import CPUDispatcher
from rover_sim import (
    Simulation, SpatialPlant, build_interface, build_plant, compile_ahead, jump, list_scenarios,
    load_scenario
)
from rover_sim.plants.ahead_of_time import compiled_marker
for name in list_scenarios(sys.argv[1]):
    scenario = load_scenario(name)
    assert compile_ahead(scenario)
    simulation = Simulation(build_interface(build_plant(scenario), 1), 0.01)
    for _ in range(5):
        simulation.tick()
        list(simulation.interface.samples(set(simulation.interface.topics)))
    simulation.interface.environment_markers(0)
    simulation.fork().tick()
    if sys.argv[1] == "planar" and scenario.rover is not None:
        jump(build_plant(scenario))

markers = [compiled_marker(model) for model in ("planar", "spatial")]
last = max(marker.stat().st_mtime_ns for marker in markers if marker.exists())

def ahead(function):
    file = function._cache._cache_file
    paths = {key: file._data_path(name) for key, name in file._load_index().items()}
    return {key for key, path in paths.items() if os.stat(path).st_mtime_ns <= last}

def loaded(function):
    codegen = function.targetctx.codegen()
    return {function._cache._index_key(each, codegen) for each in function.stats.cache_hits}

called = [each for each in gc.get_objects() if isinstance(each, CPUDispatcher) and each.overloads]
print(len(called))
for each in called:
    if sum(each.stats.cache_misses.values()) or not loaded(each) <= ahead(each):
        print(each.py_func.__module__, each.py_func.__qualname__)
if sys.argv[1] == "spatial":
    for each, _ in SpatialPlant(scenario).step_parts():
        if len(ahead(each)) != 1:
            print(each.py_func.__qualname__, *ahead(each))
"""


def run(program: str, cache: Path | None, *arguments: str, seed: str = "random") -> str:
    """Output of a program with a compilation cache of its own; None: with that of all."""
    environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=600.0,
    ).stdout


def machine_code(cache: Path) -> dict[str, list[bytes]]:
    """The object files of each function in a cache."""
    found = {}
    for path in cache.rglob("*.nbc"):
        found[path.name] = list(_object_files(pickle.loads(path.read_bytes())))
    return found


def _object_files(value: object) -> Iterator[bytes]:
    if isinstance(value, bytes) and value.startswith(b"\x7fELF"):
        yield value
    elif isinstance(value, bytes) and value.startswith(pickle.PROTO):
        yield from _object_files(pickle.loads(value))
    elif isinstance(value, tuple):
        for each in value:
            yield from _object_files(each)


@pytest.mark.process
@pytest.mark.slow
def test_the_command_compiles_the_same_complete_planar_code_in_any_process(tmp_path: Path):
    *lines, last = run(COMPILE_COMMAND, tmp_path / "1", seed="1").splitlines()
    found = [re.fullmatch(r"compiling the planar plant for \d+ s, (\d+) functions done", each)
             for each in lines]  # fmt: skip
    counts = [int(each[1]) for each in found if each is not None]
    assert len(counts) == len(lines) > 1
    assert counts == sorted(counts)
    assert last.startswith("the planar plant is compiled (")
    (again,) = run(COMPILE_COMMAND, tmp_path / "1").splitlines()
    assert again.startswith("the planar plant is compiled (")

    called, *compiled = run(COMPILED_BY_ITSELF, tmp_path / "1", "planar", seed="1").splitlines()
    assert int(called) >= 4
    assert not compiled
    outputs = {
        run(JUMP, tmp_path / seed, seed=hashes)
        for seed, hashes in (("1", "1"), ("2", "2"), ("2", "1"))
    }
    assert len(outputs) == 1
    first, second = machine_code(tmp_path / "1"), machine_code(tmp_path / "2")
    assert first == second
    assert sum(map(len, first.values())) >= 4


@pytest.mark.process
@pytest.mark.slow
@pytest.mark.usefixtures("compiled_in_space")
def test_no_simulation_in_space_compiles_a_function_for_itself():
    called, *compiled = run(COMPILED_BY_ITSELF, None, "spatial").splitlines()
    assert int(called) >= 4
    assert not compiled


def test_the_plant_is_compiled_once(monkeypatch: pytest.MonkeyPatch):
    scenario = load_scenario(PLANAR)
    assert exported is compile_ahead
    assert compile_ahead(scenario)

    def start(*_arguments: object, **_options: object) -> None:
        raise AssertionError("compiled again")

    monkeypatch.setattr(subprocess, "Popen", start)
    assert compile_ahead(scenario)


@pytest.fixture
def marker(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Nothing is compiled yet; the file that marks the compiled code."""
    path = tmp_path / "cache" / "marker"
    monkeypatch.setattr(ahead_of_time, "compiled_marker", lambda _model: path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    return path


def test_a_cache_that_cannot_be_written_is_reported(marker: Path, monkeypatch: pytest.MonkeyPatch):
    marker.parent.write_text("a file in place of the folder")
    monkeypatch.setattr(ahead_of_time, "_compile_in_children", lambda *_: pytest.fail("compiled"))
    assert not compile_ahead(load_scenario(PLANAR))


def test_who_comes_second_waits_for_the_compilation_of_the_first(
    marker: Path, monkeypatch: pytest.MonkeyPatch
):
    """Two compilations would replace code that others have loaded already."""
    compiling, finish = threading.Event(), threading.Event()
    compilations: list[str] = []

    def compile_in_children(model: str, *_: object) -> bool:
        compilations.append(model)
        compiling.set()
        return finish.wait(30.0)

    monkeypatch.setattr(ahead_of_time, "_compile_in_children", compile_in_children)
    scenario = load_scenario(PLANAR)
    results: list[bool] = []
    first = threading.Thread(target=lambda: results.append(compile_ahead(scenario)))
    first.start()
    assert compiling.wait(30.0)
    polls: list[bool] = []
    shown: list[int] = []
    monkeypatch.setattr(ahead_of_time, "_PROGRESS_PERIOD", 0.0)

    def cancelled() -> bool:
        polls.append(marker.exists())
        if len(polls) == 3:
            finish.set()
        return False

    assert compile_ahead(scenario, cancelled, lambda _duration, count: shown.append(count))
    first.join(30.0)
    assert len(shown) >= 3
    assert results == [True]
    assert compilations == ["planar"]
    assert len(polls) >= 3


def test_an_error_of_a_child_is_shown(
    marker: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(ahead_of_time, "__name__", "rover_sim.there_is_no_such_module")
    assert not compile_ahead(load_scenario(PLANAR))
    assert "No module named rover_sim.there_is_no_such_module" in capfd.readouterr().err
    assert not marker.exists()


def test_who_waits_can_be_cancelled(marker: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        ahead_of_time,
        "_compile_in_children",
        lambda *_: not compile_ahead(load_scenario(SPATIAL), lambda: True),
    )
    assert compile_ahead(load_scenario(PLANAR))
    assert marker.exists()


def test_a_child_may_end_at_any_instant(marker: Path, monkeypatch: pytest.MonkeyPatch):
    polls = iter([None, 0, 0, 0])  # the last child ends between two polls

    class ChildProcess(subprocess.Popen):  # type: ignore[type-arg]
        def poll(self) -> int | None:
            return next(polls, 0)

        def wait(self, timeout: float | None = None) -> int:
            self.returncode = super().wait()
            return self.returncode

    def started(_command: list[str], **options: Any) -> subprocess.Popen[bytes]:
        return ChildProcess([sys.executable, "-c", ""], stdout=options["stdout"])

    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "Popen", started)
        compile_ahead(load_scenario(PLANAR))
    assert list(polls) == []


@pytest.mark.usefixtures("marker")
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
        return len(polls) == 4

    assert not compile_ahead(load_scenario(PLANAR), cancelled)
    assert polls == [False, True, True, True]
    assert [process.returncode for process in started] == [-signal.SIGKILL] * 2


def test_a_process_waits_for_the_parts_until_the_other_one_ends(monkeypatch: pytest.MonkeyPatch):
    reading, writing = os.pipe()
    with os.fdopen(reading) as source, os.fdopen(writing, "wb", 0) as other:
        monkeypatch.setattr(sys, "stdin", source)
        compiled = ahead_of_time._Progress()
        other.write(b"..")
        compiled.wait_for(1)
        compiled.wait_for(2)
        has_waited = threading.Event()

        def wait_for_third() -> None:
            compiled.wait_for(3)
            has_waited.set()

        waiting = threading.Thread(target=wait_for_third)
        waiting.start()
        assert not has_waited.wait(0.1)
        other.close()
        assert has_waited.wait(30.0)
        waiting.join()
