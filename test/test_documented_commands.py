"""Every command in the documents is run, or checked as far as a test can.

`CHECKS` holds the check of each program. A program without one fails, as does a code block with no
language, and a block that shows lines which its file does not contain.
"""

from __future__ import annotations

import ast
import functools
import importlib
import re
import runpy
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import architecture
import documented
import pytest
import ros2_commands
from documented import DOCUMENTS, ROOT, SHELL, Block, Command
from ros2_commands import check_parameters, node_class, split_ros_arguments

from msg_schemas.package import PACKAGE
from operator_console.command_line import checked_arguments, make_parser
from operator_console.commands import COMMANDS
from rover_cli.command_line import make_parser as make_suite_parser
from rover_cli.subcommands import SUBCOMMANDS, find_subcommand
from rover_hil.rehearsal.procedure import load_procedure
from rover_runtime.ros.arguments import split_ros_arguments as split_ros_words
from rover_verify.bench import bench, bench_cases
from rover_verify.requirements.requirements import load_requirements

Check = Callable[[Sequence[str]], None]

NODES = architecture.nodes(ROOT)
COMMANDS_ON_PATH = architecture.commands(ROOT)
# Languages of blocks that no shell is given: text is what a command printed, mermaid is drawn.
SHOWN = {"text", "python", "yaml", "mermaid", "{toctree}", "{eval-rst}"}

# ------------------------------------------------------------------------------ ways of doing it


def parsed(words: Sequence[str]) -> Namespace:
    """`mother_rover`: the arguments are parsed; the subcommand itself would take too long."""
    subcommand = find_subcommand(words[1:])
    assert subcommand is not None, f"{' '.join(words)}: no such subcommand"
    module = importlib.import_module(subcommand.module)
    own, _ = split_ros_words(words[1:]) if subcommand.is_node else (list(words[1:]), [])
    return make_suite_parser(subcommand, module).parse_args(own)


@functools.cache
def requirements() -> tuple[str, ...]:
    """What is listed, by its identifier."""
    return tuple(requirement.id for requirement in load_requirements())


def by_mother_rover(words: Sequence[str]) -> None:
    """`mother_rover`: parsed; nodes, requirements and procedures that it names exist."""
    if any(each.path[: len(words) - 1] == tuple(words[1:]) for each in SUBCOMMANDS):
        return  # named without arguments
    options = parsed(words)
    if words[1] == "run":
        started([options.node, *options.arguments])
    for name in getattr(options, "only", None) or ():
        assert name == "ID" or any(each.startswith(name) for each in requirements()), name
    for name in getattr(options, "case", None) or ():
        chosen = [case for case in bench_cases.cases() if name in case.name]
        assert any(part.selected for part in bench._parts(options, chosen)), name
    if words[1] == "hil" and "procedure" in options:
        own = {"my_procedure.yaml": "docs/tutorials/own_procedure.yaml"}
        load_procedure(own.get(options.procedure, options.procedure))


def started(words: Sequence[str]) -> None:
    """A node, which runs until it is stopped: its parameters are checked against its rules."""
    arguments, parameters = split_ros_arguments(words)
    node = node_class(words[0])
    assert node is not None, f"{words[0]} is no node"
    assert arguments == [words[0]], f"{words[0]} takes parameters alone"
    check_parameters(node, parameters)


def operated(words: Sequence[str]) -> None:
    """`rover`, which wants a machine: parsed and held to the contract; a session gives orders."""
    if "--help" in words:
        with pytest.raises(SystemExit) as ended:
            make_parser().parse_args(list(words[1:]))
        assert not ended.value.code
        return
    options = make_parser().parse_args(list(words[1:]))
    if options.command in COMMANDS:
        checked_arguments(COMMANDS[options.command], options)


def by_ros2(words: Sequence[str]) -> None:
    """What a sourced ROS 2 does: held to our files, topics, types and parameters."""
    command = ros2_commands.read(words)
    command.check()
    if isinstance(command, ros2_commands.Run):
        started(command.words)


def by_python(words: Sequence[str]) -> None:
    """`python3`: a line is run; a node of the tutorials as `started`, others are looked for."""
    if words[1:3] == ["-m", "colcon"]:
        in_the_ci(words[2:])
    elif words[1] == "-m":
        importlib.import_module(words[2])
    elif words[1] == "-c":
        subprocess.run([sys.executable, *words[1:3]], check=True, capture_output=True)
    elif words[1].endswith("lander.py"):
        _, parameters = split_ros_arguments(words)
        check_parameters(runpy.run_path(str(ROOT / words[1]))["LanderNode"], parameters)
    else:
        assert (ROOT / words[1]).is_file(), words[1]


def made(words: Sequence[str]) -> None:
    """`make`: it is asked what it would do."""
    done = subprocess.run(
        ["make", "--dry-run", *words[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def installed(words: Sequence[str]) -> None:
    """`pip install`, which wants the network: test_install.py holds what it names."""
    assert words[1] == "install"


def in_the_ci(words: Sequence[str]) -> None:
    """The workspace of a sourced ROS 2: CI or container build it by the same commands."""
    script = "".join(
        (ROOT / name).read_text(encoding="utf-8") for name in (".ci/colcon", "Dockerfile")
    )
    does = {
        "mkdir": 'mkdir -p "$workspace/src',
        "cp": f'"$workspace/src/{PACKAGE}"',
        "colcon": "    colcon build",
        "rosdep": "rosdep install --from-paths src --ignore-src -y",
        "source": ". install/setup.bash",
    }
    assert does[words[0]] in script, words


def in_a_container(words: Sequence[str]) -> None:
    """`docker`: what runs in the image is a command of its own, which is checked."""
    if words[1] == "build":
        assert (ROOT / "Dockerfile").is_file()
        return
    image = words.index(PACKAGE)
    CHECKS[words[image + 1]](words[image + 1 :])


def of_the_shell(words: Sequence[str]) -> None:
    """The shell's own, which changes nothing but the shell."""
    assert words[0] in {"cd", "export", "touch", "umask"}


CHECKS: Mapping[str, Check] = {
    "mother_rover": by_mother_rover,
    "rover": operated,
    # what is not ours
    "ros2": by_ros2,
    "python": by_python,
    "python3": by_python,
    "make": made,
    "pip": installed,
    **dict.fromkeys(("colcon", "cp", "mkdir", "rosdep", "source"), in_the_ci),
    "docker": in_a_container,
    **dict.fromkeys(("cd", "export", "touch", "umask"), of_the_shell),
}

# ----------------------------------------------------------------------------------------- tests


@pytest.mark.parametrize("command", documented.commands(), ids=str)
def test_a_command_of_the_documents_can_be_run(command: Command, monkeypatch: pytest.MonkeyPatch):
    check = CHECKS.get(command.program)
    assert check is not None, f"{command}: no check in CHECKS"
    words = list(command.words)
    if ">" in words:
        words = words[: words.index(">")]
    monkeypatch.chdir(ROOT)
    check(words)


@pytest.mark.parametrize("typed", documented.typed_in_text(tuple(CHECKS)), ids=str)
def test_a_command_within_the_text_can_be_run(typed: Command):
    CHECKS[typed.program](typed.words)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_what_is_never_overwritten_has_one_name_for_each_command_of_a_page(document: Path):
    page = str(document.relative_to(ROOT))
    typed = {each.words for each in documented.commands() if each.block.document == page}
    keeping = {("hil", "check"), ("hil", "rehearse"), ("state", "save"), ("bag", "state")}
    made = [
        vars(parsed(words)).get("out") or words[3]
        for words in typed
        if words[1:3] in keeping and "--dry-run" not in words
    ]
    assert len(set(map(str, made))) == len(made)


def test_there_is_a_check_for_every_command_on_the_path():
    assert COMMANDS_ON_PATH.keys() <= CHECKS.keys()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_code_block_names_its_language(document: Path):
    unknown = [
        f"{block.place}: {block.language or 'no language'}"
        for block in documented.blocks(document)
        if block.language not in SHOWN | {SHELL}
    ]
    assert not unknown + documented.indented(document)


def _of_files() -> list[Block]:
    return [
        block
        for document in DOCUMENTS
        for block in documented.blocks(document)
        if block.language in {"python", "yaml"}
    ]


@pytest.mark.parametrize("block", _of_files(), ids=lambda block: block.place)
def test_code_that_is_shown_stands_in_a_file_that_runs(block: Block):
    text = (ROOT / block.file).read_text(encoding="utf-8")
    assert block.text.strip() in text, f"{block.place} is not in {block.file}"


def test_the_readme_lists_every_command_subcommand_and_node():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
    listed = {name for row in rows for name in re.findall(r"`([\w ]+)`", row)}
    assert NODES.keys() | {"rover"} <= listed
    assert {f"mother_rover {each.path[0]}" for each in SUBCOMMANDS} <= listed


@pytest.mark.parametrize("path", sorted((ROOT / "launch").glob("*.py")), ids=lambda p: p.name)
def test_the_examples_of_a_launch_file_can_be_done(path: Path):
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    examples = "".join(re.findall(r"^ros2 (?:.*\\\n)*.*\n?", text, re.MULTILINE))
    for command in documented.commands_of(Block(path.name, 0, SHELL, examples)):
        by_ros2(command.words)
    assert examples
