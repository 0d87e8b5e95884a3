"""What the documents show and what ends by itself: run, word for word."""

from __future__ import annotations

import importlib
import json
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path

import architecture
import documented
import pytest
from contract_bag import MadeUp, Parabola
from documented import ROOT, Command
from lockstep_run import PLANAR, Recorder, nut_until_trip

TUTORIALS = ROOT / "docs" / "tutorials"
SCRIPTS = (
    "one_jump.py",
    pytest.param("three_jumps.py", marks=pytest.mark.slow),
    "into_the_pit.py",
)
# And the exit code: of the broken bag not everything can be had back.
ON_BAGS = {"bag_report": 0, "bag_recover": 1, "bag_resim": 0}


def main_of(executable: str) -> Callable[[list[str]], int]:
    module, _, function = architecture.executables(ROOT)[executable].partition(":")
    found: Callable[[list[str]], int] = vars(importlib.import_module(module))[function]
    return found


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the bags that the documents speak of."""
    folder = tmp_path_factory.mktemp("documented")
    recorder = Recorder(PLANAR)
    recorder.run(120, nut_until_trip)
    recorder.made.write(folder / "run")
    made = MadeUp()
    made.jumps([Parabola()], until=2.5, rate=50.0)
    for name in ("run1", "run2", "run3", "descent_bag", "pit", "broken"):
        made.write(folder / name)
    (file,) = (folder / "broken").glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    return folder


@pytest.mark.parametrize(
    "command", [each for each in documented.commands() if each.program in ON_BAGS], ids=str
)
def test_what_is_done_with_bags(
    command: Command, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "here"
    shutil.copytree(recorded, folder)
    monkeypatch.chdir(folder)
    assert main_of(command.program)(list(command.words[1:])) == ON_BAGS[command.program]


def test_a_single_point_of_the_study(capsys: pytest.CaptureFixture[str]):
    (command,) = [
        each for each in documented.commands()
        if each.program == "paper_study" and "--all" not in each.words
    ]  # fmt: skip
    assert main_of("paper_study")(list(command.words[1:])) == 0
    assert 0.2 < json.loads(capsys.readouterr().out)["jump_height_m"] < 0.4


@pytest.mark.usefixtures("compiled", "compiled_in_space")
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_without_ros(script: str, capsys: pytest.CaptureFixture[str]):
    runpy.run_path(str(TUTORIALS / script), run_name="__main__")
    printed = capsys.readouterr().out
    for block in (each for path in documented.DOCUMENTS for each in documented.blocks(path)):
        if block.language == "text" and block.file == f"docs/tutorials/{script}":
            assert printed == block.text
    assert " m" in printed


def test_the_words_of_the_documents_are_those_that_are_run():
    programs = {command.program for command in documented.commands()}
    assert programs >= {*ON_BAGS, "paper_study"}
