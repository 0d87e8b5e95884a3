"""What the documents show and what ends by itself: run, word for word."""

from __future__ import annotations

import json
import runpy
import shutil
from pathlib import Path

import documented
import pytest
from contract_bag import MadeUp, Parabola
from documented import ROOT, Command
from lockstep_run import PLANAR, Recorder, nut_until_trip

from rover_cli.command_line import main
from rover_cli.subcommands import find_subcommand

TUTORIALS = ROOT / "docs" / "tutorials"
SCRIPTS = (
    "one_jump.py",
    pytest.param("three_jumps.py", marks=pytest.mark.slow),
    "into_the_pit.py",
    "lander_loop.py",
)
# And the exit code: of the broken bag not everything can be had back.
ON_BAGS = {"report": 0, "compare": 0, "recover": 1, "resim": 0}


def subcommand_of(command: Command) -> tuple[str, ...]:
    """The words that select a subcommand of `mother_rover`; empty for another program."""
    found = find_subcommand(command.words[1:]) if command.program == "mother_rover" else None
    return () if found is None else found.path


def on_a_bag(command: Command) -> bool:
    path = subcommand_of(command)
    return path[:1] == ("bag",) and path[1] in ON_BAGS


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
    "command", [each for each in documented.commands() if on_a_bag(each)], ids=str
)
def test_what_is_done_with_bags(
    command: Command, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "here"
    shutil.copytree(recorded, folder)
    monkeypatch.chdir(folder)
    assert main(command.words[1:]) == ON_BAGS[command.words[2]]


def test_a_single_point_of_the_study(capsys: pytest.CaptureFixture[str]):
    (command,) = [
        each for each in documented.commands()
        if subcommand_of(each) == ("study", "point")
    ]  # fmt: skip
    assert main(command.words[1:]) == 0
    assert 0.2 < json.loads(capsys.readouterr().out)["jump_height_m"] < 0.4


@pytest.mark.usefixtures("compiled", "compiled_in_space")
@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_without_ros(
    script: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(TUTORIALS)  # as `python3 docs/tutorials/...` does
    runpy.run_path(str(TUTORIALS / script), run_name="__main__")
    printed = capsys.readouterr().out
    for block in (each for path in documented.DOCUMENTS for each in documented.blocks(path)):
        if block.language == "text" and block.file == f"docs/tutorials/{script}":
            assert printed == block.text
    assert " m" in printed


def test_the_words_of_the_documents_are_those_that_are_run():
    paths = {subcommand_of(command) for command in documented.commands()}
    assert paths >= {*(("bag", name) for name in ON_BAGS), ("study", "point")}
