"""Settled starts that are kept beside the compiled code: the same bits, and never a damaged one."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from rover_sim import PlantCommand, SpatialPlant, SpatialState, compile_ahead, load_spatial
from rover_sim.plants import settled_states
from rover_sim.plants.settled_states import settle_or_load, state_file

ROOT = Path(__file__).resolve().parents[2]
OVERRIDES: Mapping[str, object] = {"tether.element_length": None, "tether.elements": 12}
CODE = "compiled_spatial_0"

# Starts as a node does; prints the modules that only a compilation needs, then the state's bytes.
START = """
import sys
from rover_sim import PlantCommand, SpatialPlant, build_interface, compile_ahead, load_scenario
from rover_sim.plants.settled_states import settle_or_load
plant = SpatialPlant(load_scenario("floor_rubble"))
assert compile_ahead(plant.scenario)
plant.warm_up()
settle_or_load(plant)
interface = build_interface(plant, 1)
state = plant.initial_state()
interface.restart(state, 0)
after, result = plant.step(state, PlantCommand(), 0.01)
interface.measure(after, 10_000_000, result)
list(interface.samples(set(interface.topics)))
for name in ("scipy.linalg", "scipy.optimize", "numba.np.linalg", "numba.np.arraymath"):
    if name in sys.modules:
        print(name)
print(state.vector.tobytes().hex() + state.rows.tobytes().hex() + after.rows.tobytes().hex())
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for settled states."""
    use(tmp_path / CODE, monkeypatch)
    return tmp_path


def use(marker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settled_states, "compiled_marker", lambda _model: marker)


def make(**changes: object) -> SpatialPlant:
    return SpatialPlant(load_spatial("floor_rubble", {**OVERRIDES, **changes}))


def refuse_to_settle(monkeypatch: pytest.MonkeyPatch) -> None:
    def settle(_self: object, _state: object) -> SpatialState:
        raise AssertionError("it settles though its state is kept")

    monkeypatch.setattr(SpatialPlant, "_settle", settle)


def assert_same_bits(one: SpatialState, other: SpatialState) -> None:
    for field in dataclasses.fields(SpatialState):
        first, second = getattr(one, field.name), getattr(other, field.name)
        if isinstance(first, np.ndarray):
            assert first.shape == second.shape
            assert first.tobytes() == second.tobytes()
            assert not second.flags.writeable
        else:
            assert first is second


def test_a_kept_state_has_the_bits_of_the_simulated_one(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    first = make()
    settle_or_load(first)
    assert [file.name for file in folder.iterdir()] == [state_file(first).name]
    refuse_to_settle(monkeypatch)
    second = make()
    settle_or_load(second)
    one, other = first.initial_state(), second.initial_state()
    assert_same_bits(one, other)
    assert_same_bits(
        first.step(one, PlantCommand(), 0.1)[0], second.step(other, PlantCommand(), 0.1)[0]
    )


def test_a_tether_with_natural_curvature_keeps_its_frames(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    changes = {"tether.natural_curvature": {"rows": [[0.0, 0.2, 0.0], [60.0, 0.2, 0.0]]}}
    first = make(**changes)
    settle_or_load(first)
    refuse_to_settle(monkeypatch)
    second = make(**changes)
    settle_or_load(second)
    assert first.initial_state().frames.shape[1] > 0
    assert_same_bits(first.initial_state(), second.initial_state())


def test_all_jumps_of_a_scenario_begin_from_one_kept_state(
    folder: Path, monkeypatch: pytest.MonkeyPatch
):
    settle_or_load(make())
    refuse_to_settle(monkeypatch)
    ready = make(**{"start.compression": 0.1, "start.tilt": [1.0, 0.0, 0.0], "name": "jump"})
    settle_or_load(ready)
    assert ready.initial_state().latch.name == "ENGAGED"
    assert len(list(folder.iterdir())) == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"start.position": [2.0, 0.5]},
        {"rover.m1": 8.5},
        {"environment.gravity": 1.6},
        {"integration.h": 0.002},
    ],
    ids=["start", "machine", "place", "integration"],
)
def test_another_scenario_has_another_file(folder: Path, changes: Mapping[str, object]):
    assert state_file(make(**changes)) != state_file(make())


def test_other_code_has_another_file(folder: Path, monkeypatch: pytest.MonkeyPatch):
    plant = make()
    before = state_file(plant)
    use(folder / "compiled_spatial_1", monkeypatch)
    assert state_file(plant) != before
    use(folder / CODE, monkeypatch)
    assert state_file(plant) == before
    monkeypatch.setattr(settled_states, "_sources", lambda: "other sources")
    assert state_file(plant) != before


@pytest.mark.parametrize("damage", ["cut", "digit", "empty", "binary", "folder"])
def test_a_damaged_file_is_ignored(folder: Path, damage: str):
    first = make()
    settle_or_load(first)
    file = state_file(first)
    whole = file.read_bytes()
    digest, _, content = whole.partition(b"\n")
    changed = content.replace(b"1", b"2", 1)
    if damage == "folder":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(
            {
                "cut": whole[: len(whole) // 2],
                "digit": digest + b"\n" + changed,
                "empty": b"",
                "binary": bytes(range(256)),
            }[damage]
        )
    second = make()
    settle_or_load(second)
    assert_same_bits(first.initial_state(), second.initial_state())
    if damage != "folder":
        assert file.read_bytes() == whole
    assert [each.name for each in folder.iterdir()] == [file.name]


def test_a_folder_that_cannot_be_written_costs_only_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    use(tmp_path / "missing" / CODE, monkeypatch)
    plant = make()
    settle_or_load(plant)
    assert plant.initial_state().phase.value == "grounded"
    assert not list(tmp_path.iterdir())


def test_the_oldest_states_are_removed(folder: Path):
    for index in range(settled_states._MOST_FILES):
        old = folder / f"settled_{index:024d}.json"
        old.write_text("old", encoding="utf-8")
        os.utime(old, (index, index))
    plant = make()
    settle_or_load(plant)
    left = {file.name for file in folder.iterdir()}
    assert len(left) == settled_states._MOST_FILES
    assert f"settled_{0:024d}.json" not in left
    assert state_file(plant).name in left


def test_a_start_that_needs_no_simulation_keeps_nothing(folder: Path):
    settle_or_load(SpatialPlant(load_spatial("free_hang")))
    assert not list(folder.iterdir())


@pytest.mark.process
def test_a_warm_start_imports_nothing_that_only_a_compilation_needs():
    assert compile_ahead(load_spatial("floor_rubble"))
    runs = [
        subprocess.run(
            [sys.executable, "-c", START],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=True,
            timeout=300.0,
        ).stdout.split()
        for _ in range(2)
    ]
    assert runs[0][-1] == runs[1][-1]
    assert runs[1][:-1] == []
