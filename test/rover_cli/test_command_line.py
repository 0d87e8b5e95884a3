"""The command `mother_rover`: its tree of subcommands, dispatch, errors and completion."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from msg_schemas.name_arguments import namespace
from operator_console.command_line import main as operators_main
from rover_cli import command_line, run_node
from rover_cli.command_line import main
from rover_cli.subcommands import GROUPS, SUBCOMMANDS, Subcommand, find_subcommand
from rover_launch.nodes import NODES
from rover_runtime.ros.arguments import split_ros_arguments

LEVELS = [(), *GROUPS]
COMPLETE = """
eval "$(register-python-argcomplete mother_rover)"
COMP_WORDS=({words}); COMP_CWORD={at}; COMP_LINE="{words}"; COMP_POINT=${{#COMP_LINE}}; COMP_TYPE=9
_python_argcomplete mother_rover
echo "${{COMPREPLY[@]}}"
"""


def named(path: tuple[str, ...]) -> str:
    return " ".join(path)


@pytest.mark.parametrize("path", LEVELS, ids=named)
def test_the_help_of_a_level_lists_its_subcommands(
    path: tuple[str, ...], capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as ended:
        main([*path, "--help"])
    assert ended.value.code == 0
    words = capsys.readouterr().out.split()
    below = {each.path[len(path)] for each in SUBCOMMANDS if each.path[: len(path)] == path}
    assert below <= set(words)


@pytest.mark.parametrize("subcommand", SUBCOMMANDS, ids=lambda each: named(each.path))
def test_every_subcommand_has_help(subcommand: Subcommand, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main([*subcommand.path, "--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: mother_rover {named(subcommand.path)} ")
    assert len(shown) > 150


@pytest.mark.parametrize("words", ["--help", "bag --help", "--version"])
def test_help_of_the_tree_imports_no_subcommand(words: str):
    script = (
        "import atexit, sys\n"
        "from rover_cli.command_line import main\n"
        "atexit.register(lambda: print('loaded', *sys.modules))\n"
        f"main({words.split()})\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.rpartition("loaded ")[2].split())
    assert "rover_cli.subcommands" in loaded
    assert loaded.isdisjoint({"rclpy", "numpy", "matplotlib", *(s.module for s in SUBCOMMANDS)})


def test_the_version_is_the_package_s(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("mother_rover ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "mother_rover: "),
        (["fly"], "invalid choice: 'fly'"),
        (["bag"], "mother_rover bag: "),
        (["bag", "report"], "mother_rover bag report: "),
        (["validate", "cable", "fly"], "mother_rover validate cable: "),
        (
            ["bag", "report", "run", "--ros-args"],
            "mother_rover bag report: unrecognized arguments: --ros-args",
        ),
        (["sweep", "plan.yaml", "--worker", "2"], "unrecognized arguments: --worker"),
        (["run", "no_node"], "invalid choice: 'no_node'"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == command_line.USAGE_ERROR
    shown = capsys.readouterr().err
    assert message in shown
    assert shown.count("\n") == 1
    assert "--help" in shown


def test_a_missing_library_stops_its_subcommand_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def load(name: str) -> ModuleType:
        raise ModuleNotFoundError(f"No module named 'exudyn' for {name}", name="exudyn")

    monkeypatch.setattr(importlib, "import_module", load)
    assert main(["bench"]) == command_line.MISSING_LIBRARY
    assert capsys.readouterr().err == (
        "mother_rover bench: install the Python library exudyn first\n"
    )
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0


def test_a_node_s_subcommand_receives_ros_arguments_apart(monkeypatch: pytest.MonkeyPatch):
    module = importlib.import_module("rover_bags.recording.record")
    received: list[argparse.Namespace] = []

    def run(options: argparse.Namespace) -> int:
        received.append(options)
        return 7

    monkeypatch.setattr(module, "run", run)
    words = ["bag", "record", "-o", "run", "--ros-args", "-r", "__ns:=/rover1", "--", "--all"]
    assert main(words) == 7
    (options,) = received
    assert options.output == "run"
    assert options.all
    assert options.ros_arguments == ["--ros-args", "-r", "__ns:=/rover1"]


def test_words_without_ros_arguments_stay_as_they_are():
    assert split_ros_arguments(["a", "--", "b"]) == (["a", "--", "b"], [])


def test_a_node_runs_with_its_own_arguments(monkeypatch: pytest.MonkeyPatch):
    started: list[list[str]] = []
    node = ModuleType("node")

    def node_main() -> int:
        started.append(sys.argv)
        return 3

    vars(node)["main"] = node_main
    monkeypatch.setattr(sys, "argv", ["pytest"])
    monkeypatch.setattr(importlib, "import_module", lambda _name: node)
    options = argparse.Namespace(node="sim_node", arguments=["--ros-args", "-p", "seed:=1"])
    assert run_node.run(options) == 3
    assert started == [["sim_node", "--ros-args", "-p", "seed:=1"]]


def test_the_arguments_of_a_node_are_not_parsed(capsys: pytest.CaptureFixture[str]):
    subcommand = find_subcommand(["run"])
    assert subcommand is not None
    parser = command_line.make_parser(subcommand, run_node)
    options = parser.parse_args(["run", "winch_node", "--help"])
    assert (options.node, options.arguments) == ("winch_node", ["--help"])
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("module", NODES.values())
def test_every_node_has_help(
    module: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(sys, "argv", [module, "--help"])
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(importlib.import_module(module).main())
    assert not ended.value.code
    assert len(capsys.readouterr().out) > 150


def test_linear_algebra_uses_one_thread_unless_the_user_wants_more(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    assert main(["verify", "--list"]) == 0
    assert capsys.readouterr().out
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_the_command_reads_the_environment_before_it_imports_numpy():
    code = "import sys, rover_cli.command_line; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("mother_rover be", {"bench"}),
        ("mother_rover bag re", {"record", "recover", "report", "resim"}),
        ("mother_rover bag report --h", {"--help", "--html"}),
        ("mother_rover run winch", {"winch_node"}),
    ],
)
def test_the_shell_completes_subcommands_and_options(words: str, offered: set[str]):
    own = Path(sys.executable).parent
    if not all((own / name).exists() for name in ("mother_rover", "register-python-argcomplete")):
        pytest.skip("neither is installed beside this Python")
    given = {**os.environ, "PATH": f"{own}:{os.environ['PATH']}"}
    script = COMPLETE.format(words=words, at=len(words.split()) - 1)
    done = subprocess.run(
        ["bash", "-c", script], env=given, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == offered


@pytest.mark.parametrize("words", [
    ["contract", "FILE/x"], ["contract", "FOLDER"], ["policy", "FOLDER"],
    ["requirements", "--out", "FOLDER"], ["demo", "--out", "FILE"],
    ["validate", "wheel", "example", "FILE"], ["validate", "cable", "example", "FILE"],
    ["bag", "report", "LONG"], ["bag", "export", "LONG"],
], ids=" ".join)  # fmt: skip
def test_a_file_that_cannot_be_used_is_named_in_one_line(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").touch()
    places = {
        "FILE": str(tmp_path / "file"), "FILE/x": str(tmp_path / "file" / "x"),
        "FOLDER": str(tmp_path), "LONG": "x" * 5000,
    }  # fmt: skip
    assert main([places.get(word, word) for word in words]) == command_line.USAGE_ERROR
    message = capsys.readouterr().err
    assert message.startswith(f"mother_rover {' '.join(words[:-1]).removesuffix(' --out')}: ")
    assert message.count("\n") == 1
    assert len(message) < 600


SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("number", SIGNALS, ids=lambda each: each.name)
def test_a_signal_ends_a_command_in_one_line_after_its_clean_up(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    cleaned_up: list[str] = []
    before = [signal.getsignal(each) for each in SIGNALS]

    def run(_options: argparse.Namespace) -> int:
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(number)  # a repeated one does not disturb
            cleaned_up.append("all")
        return 0

    monkeypatch.setattr(importlib.import_module("rover_bags.files.recover"), "run", run)
    assert main(["bag", "recover", "bag", "new"]) == command_line.STOPPED
    assert cleaned_up == ["all"]
    stopped = f"mother_rover bag recover: stopped by {number.name}"
    assert capsys.readouterr().err.strip() == stopped
    assert [signal.getsignal(each) for each in SIGNALS] == before


def test_what_nohup_ignores_stays_ignored(monkeypatch: pytest.MonkeyPatch):
    def run(_options: argparse.Namespace) -> int:
        signal.raise_signal(signal.SIGHUP)
        return 5

    monkeypatch.setattr(importlib.import_module("rover_bags.files.recover"), "run", run)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main(["bag", "recover", "bag", "new"]) == 5
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_reader_that_leaves_early_ends_the_command_quietly():
    done = subprocess.run(
        f"{sys.executable} -m rover_cli verify --list | true; exit ${{PIPESTATUS[0]}}",
        shell=True, executable="/bin/bash", capture_output=True, text=True, timeout=120,
        check=False,
    )  # fmt: skip
    assert done.stderr == ""


@pytest.mark.parametrize("name", ["a b", "/a//b", "/1a", "/\u00e9", "/a/", "a-b", "/a\n"])
@pytest.mark.parametrize("command", [
    lambda name: main(["state", "save", "new.json", "--namespace", name]),
    lambda name: operators_main(["--namespace", name, "status"]),
], ids=["state save", "rover"])  # fmt: skip
def test_a_namespace_that_ros_does_not_accept_is_refused(
    command: Callable[[str], int], name: str, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit) as ended:
        command(name)
    assert ended.value.code == command_line.USAGE_ERROR
    assert "should be names of letters, digits and _" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["", "/", "mother1", "/mother1", "/site/mother_1"])
def test_a_namespace_of_ros_is_accepted(name: str):
    assert namespace(name) == name
