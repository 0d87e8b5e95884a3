"""Launch files: what they start exists, what they set are parameters."""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
from pathlib import Path
from typing import Any

import pytest

from rover_sim.sim_node import SimParameters

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "launch").glob("*.launch.py"))
KINDS = {"str": str, "float": float, "bool": bool, "int": int}


def strings_of_calls(path: Path, function: str, keyword: str) -> list[str]:
    """Literal values of a keyword in all calls of a function."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        item.value.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == function
        for item in node.keywords
        if item.arg == keyword
        and isinstance(item.value, ast.Constant)
        and isinstance(item.value.value, str)
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_is_started_is_an_executable_of_the_package(path: Path):
    shims = {shim.name for shim in (ROOT / "scripts").iterdir()}
    assert {*strings_of_calls(path, "Node", "executable")} <= shims


def test_the_simulator_s_arguments_are_its_parameters_with_their_types():
    tree = ast.parse((ROOT / "launch" / "sim.launch.py").read_text(encoding="utf-8"))
    (given,) = [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and getattr(node.targets[0], "id", "") == "PARAMETERS"
        and isinstance(node.value, ast.Dict)
    ]
    types = {field.name: type(field.default) for field in dataclasses.fields(SimParameters)}
    for key, value in zip(given.keys, given.values, strict=True):
        assert isinstance(key, ast.Constant)
        assert isinstance(value, ast.Tuple)
        assert isinstance(value.elts[0], ast.Name)
        assert KINDS[value.elts[0].id] is types[str(key.value)]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_is_a_launch_description(path: Path):
    pytest.importorskip("launch_ros", reason="launch comes with a ROS 2 installation, not by pip")
    spec = importlib.util.spec_from_file_location(path.name.replace(".", "_"), path)
    assert spec is not None
    assert spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    from launch.actions import DeclareLaunchArgument

    entities = module.generate_launch_description().entities
    declared = [each for each in entities if isinstance(each, DeclareLaunchArgument)]
    assert declared
    assert all(each.description for each in declared)
