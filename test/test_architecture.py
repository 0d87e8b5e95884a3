"""The house's rules hold for this tree, and each rule is able to fail."""

import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import architecture
import pytest

ROOT = Path(__file__).resolve().parents[1]

Check = Callable[[Path], list[str]]


def undeclared_requirements(root: Path) -> list[str]:
    return architecture.undeclared_requirements(root, sys.stdlib_module_names)


CHECKS: list[Check] = [
    architecture.forbidden_arrows,
    architecture.forbidden_layers,
    architecture.impure_physics,
    architecture.package_cycles,
    architecture.room_cycles,
    architecture.topic_strings,
    architecture.message_decisions,
    architecture.typed_words,
    architecture.sleeps,
    architecture.repeated_classes,
    architecture.long_functions,
    architecture.crowded_classes,
    architecture.broken_executables,
    architecture.untyped_packages,
    undeclared_requirements,
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_tree_keeps_the_rule(check: Check):
    violations = check(ROOT)
    assert not violations, "\n" + "\n".join(violations)


def test_all_files_state_the_same_version():
    assert len(set(architecture.versions(ROOT).values())) == 1, architecture.versions(ROOT)


def test_the_installed_version_is_the_tree_s():
    try:
        installed = version("mother_rover")
    except PackageNotFoundError:
        pytest.skip("run from the bare tree")
    assert installed == architecture.versions(ROOT)["setup.py"]


def test_the_checks_see_the_tree():
    assert len(architecture.imports(ROOT)) > 50
    assert len(architecture.topic_names(ROOT)) > 10
    assert len(architecture.executables(ROOT)) >= 10


# ------------------------------------------------------------- every rule is able to fail


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a small tree that keeps every rule."""
    files = {
        "setup.py": (
            "from setuptools import setup\n"
            "CONSOLE_SCRIPTS = {'command': 'rover_sim.run:main'}\n"
            "setup(version='1.0.0', install_requires=['numpy>=1.26'], extras_require={})\n"
        ),
        "package.xml": (
            "<package><version>1.0.0</version><depend>python3-numpy</depend></package>\n"
        ),
        "scripts/command": '#!/bin/sh\nexec "$(dirname "$0")/../../bin/command" "$@"\n',
        "scripts/run": '#!/bin/sh\nexec "$(dirname "$0")/../../bin/mother_rover" run run "$@"\n',
        "rover_launch/nodes.py": "NODES = {'run': 'rover_sim.run'}\n",
        "msg_schemas/topics.py": "SWITCH = 'lamp/switch'\nCONFIG = 'config'\nCLOCK = '/clock'\n",
        "msg_schemas/events.py": "class E:\n    LANDED = ('landed', 0)\n",
        "msg_schemas/phases.py": "class P:\n    HOLD = ('hold', 'at rest')\n",
        "rover_sim/run.py": (
            "import numpy\nfrom msg_schemas import topics\n"
            "from rover_sim.physics import beam\ndef main(): ...\n"
        ),
        "rover_sim/physics/__init__.py": "",
        "rover_sim/physics/beam.py": "import numpy\nfrom rover_sim.physics import shapes\n",
        "rover_sim/physics/shapes.py": "import math\n",
        "rover_bags/report.py": "from rover_sim import load\nname = 'config'\n",
    }
    for package in architecture.ARROWS:
        files[f"{package}/__init__.py"] = ""
        files[f"{package}/py.typed"] = ""
    for name, text in files.items():
        write(tmp_path, name, text)
    for name in ("command", "run"):
        (tmp_path / "scripts" / name).chmod(0o755)
    return tmp_path


def write(root: Path, name: str, text: str) -> None:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_a_tree_that_keeps_the_rules_passes(tree: Path, check: Check):
    assert check(tree) == []


@pytest.mark.parametrize(
    ("check", "name", "text", "complaint"),
    [
        (
            architecture.forbidden_arrows,
            "msg_schemas/bad.py",
            "import rover_sim",
            "msg_schemas.bad must not import rover_sim",
        ),
        (
            architecture.forbidden_arrows,
            "tether_winch/bad.py",
            "def later():\n    from rover_sim import run",
            "tether_winch/bad.py:2: tether_winch.bad must not import rover_sim.run",
        ),
        (
            architecture.forbidden_arrows,
            "rover_control/bad.py",
            "import tether_winch",
            "must not import tether_winch",
        ),
        (
            architecture.forbidden_arrows,
            "rover_control/prediction/jump_predictor.py",
            "from rover_sim.physics import beam",
            "use what rover_sim itself offers",
        ),
        (
            architecture.forbidden_arrows,
            "rover_bags/bad.py",
            "from rover_sim import run",
            "use what rover_sim itself offers",
        ),
        (
            architecture.forbidden_layers,
            "rover_bags/files/bad.py",
            "from rover_bags.reading.read import read_bag",
            "rover_bags.files must not import rover_bags.reading.read",
        ),
        (
            architecture.forbidden_layers,
            "rover_bags/analysis/bad.py",
            "from rover_bags.views import plots",
            "rover_bags.analysis must not import rover_bags.views",
        ),
        (
            architecture.forbidden_arrows,
            "rover_hil/bad.py",
            "import rover_sim",
            "rover_hil.bad must not import rover_sim",
        ),
        (
            architecture.forbidden_arrows,
            "rover_hil/bad.py",
            "from rover_hil.emulator import device",
            "rover_hil.bad must not import rover_hil.emulator",
        ),
        (
            architecture.forbidden_arrows,
            "rover_hil/emulator/bad.py",
            "from rover_sim import run",
            "use what rover_sim itself offers",
        ),
        (architecture.impure_physics, "rover_sim/physics/bad.py", "import rclpy", "rclpy"),
        (architecture.impure_physics, "rover_sim/physics/bad.py", "import yaml", "yaml"),
        (
            architecture.impure_physics,
            "rover_sim/physics/bad.py",
            "from sensor_msgs.msg import Imu",
            "sensor_msgs",
        ),
        (
            architecture.impure_physics,
            "rover_sim/physics/bad.py",
            "from rover_sim import run",
            "rover_sim.run",
        ),
        (
            architecture.impure_physics,
            "rover_sim/physics/bad.py",
            "from msg_schemas import topics",
            "msg_schemas.topics",
        ),
        (
            architecture.package_cycles,
            "msg_schemas/bad.py",
            "import rover_sim",
            "msg_schemas -> rover_sim -> msg_schemas",
        ),
        (
            architecture.room_cycles,
            "rover_sim/physics/bad.py",
            "from rover_sim import run",
            "rover_sim -> rover_sim.physics -> rover_sim",
        ),
        (
            architecture.topic_strings,
            "rover_control/bad.py",
            "x = '/lamp/switch'",
            "rover_control/bad.py:1: topic '/lamp/switch' written out",
        ),
        (
            architecture.topic_strings,
            "launch/bad.launch.py",
            "x = f'{n}/lamp/switch'",
            "lamp/switch",
        ),
        (architecture.topic_strings, "test/bad.py", "node.subscribe('config', f)", "'config'"),
        (
            architecture.topic_strings,
            "rover_bags/bad.py",
            "node.create_publisher(Clock, '/clock', 1)",
            "'/clock'",
        ),
        (
            architecture.message_decisions,
            "rover_sim/bad.py",
            "if event.message == 'reached':\n    pass",
            "bad.py:1: decides on the text of .message",
        ),
        (
            architecture.message_decisions,
            "rover_sim/bad.py",
            "if 'reached' in event.message:\n    pass",
            "decides on the text of .message",
        ),
        (
            architecture.message_decisions,
            "test/bad.py",
            "assert event.message == f'at {length} m'",
            "decides on the text of .message",
        ),
        (
            architecture.message_decisions,
            "test/bad.py",
            "wait_for(lambda event: reason in event.message)",
            "bad.py:1: finds by the text of .message",
        ),
        (
            architecture.message_decisions,
            "test/bad.py",
            "def look(s):\n    return s.message == words",
            "bad.py:2: finds by the text of .message",
        ),
        (
            architecture.typed_words,
            "test/bad.py",
            "assert event.name == 'landed'",
            "compares with 'landed'",
        ),
        (
            architecture.typed_words,
            "rover_sim/bad.py",
            "if sample.text in ('hold', 'other'):\n    pass",
            "compares with 'hold'",
        ),
        (architecture.sleeps, "rover_sim/bad.py", "import time\ntime.sleep(1)", "bad.py:2"),
        (architecture.sleeps, "test/bad.py", "from time import sleep", "time.sleep"),
        (architecture.broken_executables, "scripts/more", "", "belongs to no node or command"),
        (
            architecture.broken_executables,
            "scripts/run",
            '#!/bin/sh\nexec "$(dirname "$0")/../../bin/other" "$@"\n',
            "scripts/run is not",
        ),
        (architecture.broken_executables, "rover_sim/run.py", "x = 1", "has no main"),
        (
            architecture.repeated_classes,
            "rover_sim/bad.py",
            "class E: ...",
            "class E stands in",
        ),
        (
            architecture.long_functions,
            "rover_sim/bad.py",
            "def f():\n" + "    x = 1\n" * architecture.PAGE,
            f"f has {architecture.PAGE + 1} lines",
        ),
        (
            architecture.crowded_classes,
            "rover_sim/bad.py",
            "class C:\n" + "    def f(self): ...\n" * (architecture.MOST_METHODS + 1),
            f"C has {architecture.MOST_METHODS + 1} methods",
        ),
        (undeclared_requirements, "rover_sim/bad.py", "import scipy", "does not require scipy"),
        (undeclared_requirements, "rover_sim/bad.py", "import scipy", "python3-scipy"),
        (undeclared_requirements, "rover_sim/bad.py", "import nav_msgs.msg", "on nav_msgs"),
        (undeclared_requirements, "rover_sim/bad.py", "import requests", "not among the known"),
    ],
)
def test_a_broken_rule_is_named(tree: Path, check: Check, name: str, text: str, complaint: str):
    write(tree, name, text)
    violations = check(tree)
    assert any(complaint in violation for violation in violations), violations


def test_the_emulator_may_use_the_simulator_s_public_face(tree: Path):
    write(tree, "rover_hil/emulator/emulated_machine.py", "import rover_sim")
    assert architecture.forbidden_arrows(tree) == []


def test_the_jump_predictor_may_use_the_simulator_s_public_face(tree: Path):
    write(tree, "rover_control/prediction/jump_predictor.py", "import rover_sim")
    assert architecture.forbidden_arrows(tree) == []


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("scripts/run", "executable run has no scripts/run"),
        ("rover_sim/run.py", "no module rover_sim.run"),
    ],
)
def test_a_missing_part_of_an_executable_is_named(tree: Path, name: str, complaint: str):
    (tree / name).unlink()
    assert any(complaint in violation for violation in architecture.broken_executables(tree))


def test_a_shim_that_cannot_be_executed_is_named(tree: Path):
    (tree / "scripts" / "run").chmod(0o644)
    assert architecture.broken_executables(tree) == ["scripts/run is not executable"]


def test_a_package_without_the_marker_of_types_is_named(tree: Path):
    (tree / "rover_sim" / "py.typed").unlink()
    assert architecture.untyped_packages(tree) == ["rover_sim/py.typed is missing"]


def test_versions_are_read_from_each_file(tree: Path):
    write(tree, "package.xml", "<package><version>1.0.1</version></package>")
    assert architecture.versions(tree) == {"setup.py": "1.0.0", "package.xml": "1.0.1"}
