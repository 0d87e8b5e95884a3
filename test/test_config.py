"""The files in config/ are what the nodes have: every parameter, its default, its unit."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from msg_schemas.fields import rule_of
from msg_schemas.parameters import from_mapping
from operator_console.console_node import OperatorConsole
from rover_control.drive.drive_node import DriveNode
from rover_control.hanging.descent_node import DescentNode
from rover_control.hanging.descent_parameters import DescentParameters
from rover_control.hanging.swing_damping import DampingParameters
from rover_control.jump.jump_node import JumpNode
from rover_control.mission.mission_node import MissionNode
from rover_control.mission.mission_plan import SHIPPED, load_plan
from rover_hil.bridge.bridge_node import BridgeNode
from rover_hil.emulator.emulator_node import EmulatorNode
from rover_runtime.component import Component
from rover_sim.node.mock_plant_node import MockPlantNode
from rover_sim.node.sim_node import SimNode
from rover_sim.scenarios.scenario import load_scenario
from rover_view.view_node import ViewNode
from tether_winch.servo import ServoParameters
from tether_winch.winch_node import WinchNode

CONFIG = Path(__file__).parents[1] / "config"
NODES: list[type[Component]] = [
    SimNode, MockPlantNode, JumpNode, WinchNode, DescentNode, DriveNode, MissionNode,
    BridgeNode, EmulatorNode, OperatorConsole, ViewNode,
]  # fmt: skip


def fields_of(node: type[Component]) -> Iterator[tuple[type[Any], Any]]:
    for cls in node.PARAMETERS:
        for field in dataclasses.fields(cls):
            yield cls, field


def values_of(node: type[Component], name: str = "") -> dict[str, Any]:
    content = yaml.safe_load((CONFIG / f"{name or node.NAME}.yaml").read_text(encoding="utf-8"))
    assert list(content) == [f"/**/{node.NAME}"]
    values = content[f"/**/{node.NAME}"]["ros__parameters"]
    assert isinstance(values, dict)
    return values


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_stands_in_the_file_with_its_default(node: type[Component]):
    defaults = {field.name: field.default for _, field in fields_of(node)}
    assert values_of(node) == defaults


@pytest.mark.parametrize("node", NODES)
def test_the_values_are_accepted(node: type[Component]):
    values = values_of(node)
    for cls in node.PARAMETERS:
        names = {field.name for field in dataclasses.fields(cls)}
        from_mapping(cls, {name: value for name, value in values.items() if name in names})


@pytest.mark.parametrize("node", NODES)
def test_the_unit_of_every_quantity_stands_beside_it(node: type[Component]):
    lines = (CONFIG / f"{node.NAME}.yaml").read_text(encoding="utf-8").splitlines()
    for _, field in fields_of(node):
        if isinstance(field.default, str):
            continue
        (line,) = [each for each in lines if each.strip().startswith(f"{field.name}:")]
        assert f"[{rule_of(field).unit}]" in line


def test_the_winch_of_a_descent_permits_the_largest_trim_of_the_damping():
    given = values_of(WinchNode, "winch_descent")
    servo = from_mapping(ServoParameters, given)
    assert servo.trim_rate >= DampingParameters().trim_rate > ServoParameters().trim_rate
    assert servo.trim_acceleration >= DampingParameters().trim_acceleration
    lines = (CONFIG / "winch_descent.yaml").read_text(encoding="utf-8").splitlines()
    for field in dataclasses.fields(ServoParameters):
        if field.name in given:
            (line,) = [each for each in lines if each.strip().startswith(f"{field.name}:")]
            assert f"[{rule_of(field).unit}]" in line


def test_a_descent_goes_no_further_than_its_winch():
    winch = from_mapping(ServoParameters, values_of(WinchNode, "winch_descent"))
    descent = DescentParameters()
    assert descent.min_depth >= winch.shortest_length + winch.soft_margin - 1e-9
    assert descent.max_depth <= winch.longest_length - winch.soft_margin


def test_a_file_may_be_named_from_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # A shell leaves the ~ in `scenario:=~/own.yaml`.
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "own.yaml").write_text("base: free_hang\nname: own\n")
    assert load_scenario("~/own.yaml").name == "own"
    shutil.copy(SHIPPED / "shallow.yaml", tmp_path / "plan.yaml")
    assert load_plan("~/plan.yaml") == load_plan("shallow")
