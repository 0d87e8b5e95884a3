"""What is installed: package.xml, setup.py, the README's pip line and the constraints agree."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from importlib.metadata import requires
from xml.etree import ElementTree as ET

import architecture
import pytest
import tool_scripts
from documented import ROOT
from packaging.requirements import Requirement

from msg_schemas.table import find_topic

write_constraints = tool_scripts.load("write_constraints")

UBUNTU = ROOT / "constraints" / "ubuntu-24.04.in"
# Keys of rosdep are "python3-" and the distribution's name, but for these.
NAMED_OTHERWISE = {
    "python3-can": "python-can",
    "python3-pil": "pillow",
    "python3-serial": "pyserial",
    "python3-yaml": "pyyaml",
    "urdfdom_py": "urdf-parser-py",
    "rclpy": "ros-jazzy-rclpy",
    "std_msgs": "ros-jazzy-common-interfaces",
}
TOOLS = {"colcon-common-extensions", "setuptools"}


def required(*extras: str) -> list[Requirement]:
    """What setup.py requires, with extras."""
    arguments = architecture.setup_arguments(ROOT)
    always, optional = arguments["install_requires"], arguments["extras_require"]
    assert isinstance(always, list)
    assert isinstance(optional, dict)
    return [Requirement(each) for each in (*always, *(x for e in extras for x in optional[e]))]


def constrained(name: str) -> dict[str, str]:
    """The version of each distribution of a file of constraints."""
    text = (ROOT / "constraints" / name).read_text(encoding="utf-8")
    return dict(re.findall(r"^([a-z0-9-]+)==(\S+)$", text, re.MULTILINE))


def from_apt() -> dict[str, Requirement]:
    """What Ubuntu and ROS 2 have, by distribution."""
    lines = UBUNTU.read_text(encoding="utf-8").splitlines()
    found = [Requirement(line.partition(" #")[0]) for line in lines if line[:1] not in {"", "#"}]
    return {each.name: each for each in found if each.name not in TOOLS}


def from_pip() -> dict[str, Requirement]:
    """What the README installs with pip, by distribution."""
    found = [Requirement(each) for each in write_constraints.pip_line()]
    return {each.name: each for each in found}


def of_the_manifest() -> set[str]:
    """The distributions for which package.xml has a key; a ROS package stands for its release."""
    manifest = ET.parse(ROOT / "package.xml").getroot()
    keys = {str(each.text) for each in manifest if each.tag.endswith("depend")}
    return {NAMED_OTHERWISE[key] for key in keys & NAMED_OTHERWISE.keys()} | {
        key.removeprefix("python3-")
        for key in keys - NAMED_OTHERWISE.keys()
        if key.startswith("python3-")
    }


def brought_along(names: set[str]) -> set[str]:
    """Distributions and all that they require."""
    found, waiting = set[str](), set(names)
    while waiting:
        name = waiting.pop()
        found.add(name)
        parts = (Requirement(each) for each in requires(name) or ())
        waiting |= {each.name for each in parts if not each.marker} - found
    return found


def test_package_xml_has_what_apt_installs_and_nothing_that_ubuntu_lacks():
    assert of_the_manifest() == from_apt().keys()


def test_apt_and_the_pip_line_of_the_readme_install_all_that_setup_py_requires():
    pip = from_pip()
    assert not pip.keys() & from_apt().keys()
    names = {each.name for each in required()}
    assert pip.keys() <= names
    assert names <= from_apt().keys() | brought_along(set(pip))


def test_the_pip_line_of_the_readme_keeps_the_upper_limits_of_setup_py():
    pip = from_pip()
    for requirement in required():
        limits = {each for each in requirement.specifier if each.operator.startswith("<")}
        if requirement.name in pip:
            assert set(pip[requirement.name].specifier) == limits, requirement


@pytest.mark.parametrize(
    ("name", "extras"),
    [("make.txt", ("test", "bench", "docs", "dev", "fuzz")), ("colcon.txt", ())],
)
def test_the_constraints_fulfil_setup_py(name: str, extras: tuple[str, ...]):
    versions = constrained(name)
    for requirement in required(*extras):
        version = versions.get(requirement.name.lower())
        assert version is not None, f"{requirement}: make constraints"
        assert requirement.specifier.contains(version), requirement


def test_the_constraints_of_colcon_have_the_versions_of_ubuntu():
    versions = constrained("colcon.txt")
    for requirement in from_apt().values():
        if requirement.marker is None:
            assert requirement.specifier.contains(versions[requirement.name]), requirement


def test_the_set_up_and_colcon_are_constrained():
    set_up = (ROOT / "tools" / "set_up.sh").read_text(encoding="utf-8")
    assert "--constraint constraints/make.txt" in set_up
    colcon = (ROOT / ".ci" / "colcon").read_text(encoding="utf-8")
    assert "PIP_CONSTRAINT=$tree/constraints/colcon.txt" in colcon
    assert "'^pip install ' README.md" in colcon


def test_bash_runs_what_sources_in_the_devcontainer():
    text = (ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8")
    program, _, script = json.loads(text)["postCreateCommand"]
    assert program == "bash"  # a text is given to sh, which knows no `source`
    assert script.startswith("source ")


def test_the_container_s_launch_is_awaited_by_the_topic_s_type():
    script = (ROOT / ".ci" / "jazzy").read_text(encoding="utf-8").replace("\\\n", "")
    (echo,) = re.findall(r"ros2 topic echo .*", script)
    name, message_type = echo.split()[-2:]
    assert find_topic(name.lstrip("/")).message == message_type


@pytest.mark.parametrize("name", ["check_commits", "write_constraints"])
def test_help_of_a_tool_does_nothing_else(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(subprocess, "run", lambda *_words, **_options: pytest.fail("it began"))
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(tool_scripts.TOOLS / f"{name}.py"), run_name="__main__")
    assert not ended.value.code
    assert capsys.readouterr().out.startswith("usage: ")
