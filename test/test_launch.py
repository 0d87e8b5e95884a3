"""Launch files: what they start exists, what they set are parameters, what they refuse."""

from __future__ import annotations

import dataclasses
import importlib.util
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from msg_schemas.access import COMPOSED
from rover_launch.composed import run_composed
from rover_launch.nodes import NODES
from rover_launch.plan import (
    ACTION,
    PARAMETERS,
    PLANTS,
    VIEW,
    LaunchError,
    LaunchPlan,
    ProcessSpec,
    arguments_of,
    files_of,
    plan,
    unknown_arguments,
)
from rover_runtime.component import ExitCode
from rover_runtime.ros.lockstep import read_processes
from rover_sim.node.mock_plant_node import MockPlantParameters
from rover_sim.node.sim_node import SimParameters
from rover_verify.checks.launches import described

ROOT = Path(__file__).parents[1]
CONFIG = str(ROOT / "config")
FILES = sorted((ROOT / "launch").glob("*.launch.py"))
MISSION = ("winch_node", "descent_node", "drive_node", "jump_node", "mission_node")


def controllers_of(path: Path) -> tuple[str, ...]:
    """What a launch file gives to `describe`."""
    return described(path)[0]


def planned(
    *controllers: str, find: Any = lambda _name: None, **values: str
) -> tuple[LaunchPlan, dict[str, ProcessSpec]]:
    given = {each.name: each.default for each in arguments_of(controllers, CONFIG, {})}
    assert values.keys() <= given.keys()
    made = plan(controllers, given | values, find)
    return made, {each.executable: each for each in made.started}


# ------------------------------------------------------------------------------------- the files


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("composed", ["true", "false"])
def test_what_is_started_is_there_with_its_parameter_files(path: Path, plant: str, composed: str):
    controllers = controllers_of(path)
    made, started = planned(*controllers, plant=plant, record="no_such_bag", composed=composed)
    shims = {shim.name for shim in (ROOT / "scripts").iterdir()}
    nodes = {name for each in made.started for name in each.node_names}
    assert {PLANTS[plant], "bag_record", *controllers} <= nodes
    assert {PLANTS[plant], "bag_record"} <= started.keys() <= shims
    assert all(Path(file).is_file() for each in made.started for file in each.files)


def test_what_is_started_imports_what_takes_long_later_or_not_at_all():
    _, started = planned(*MISSION, record="no_such_bag", composed="false")
    program = (
        "import importlib, sys\n"
        "for name in sys.argv[1:]: importlib.import_module(name)\n"
        "late = 'matplotlib', 'numba', 'scipy.optimize', 'scipy.stats'\n"
        "print(*(name for name in late if name in sys.modules))"
    )
    modules = [NODES[name] for name in started]
    done = subprocess.run(
        [sys.executable, "-c", program, *modules],
        capture_output=True,
        text=True,
        check=True,
        timeout=60.0,
    )
    assert done.stdout == "\n"


def test_the_mission_is_all_controllers_there_are():
    assert {*controllers_of(ROOT / "launch" / "mission.launch.py")} == {
        name for path in FILES for name in controllers_of(path)
    }


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


# ------------------------------------------------------------------------------------ the arguments


def test_composed_controllers_share_processes_with_all_their_files():
    made, started = planned(*MISSION)
    alone, each = planned(*MISSION, composed="false")
    assert [p.executable for p in made.started] == ["sim_node", *COMPOSED, VIEW]
    assert [name for p in made.started for name in p.node_names] == ["sim_node", *MISSION, VIEW]
    rover = started["rover_nodes"]
    assert rover.arguments == ("descent_node", "drive_node", "jump_node")
    assert rover.files == sum((each[name].files for name in rover.nodes), ())
    assert [p.node_names for p in alone.started[1:-1]] == [(name,) for name in MISSION]
    assert planned("winch_node", "jump_node")[1]["rover_nodes"].nodes == ("jump_node",)


def test_a_process_has_each_of_its_nodes_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    for words, complaint in (
        (["jump_node"], "'jump_node' should be of winch_node, once"),
        (["winch_node", "winch_node"], "'winch_node' should be of winch_node, once"),
    ):
        monkeypatch.setattr(sys, "argv", ["mother_nodes", *words])
        assert run_composed("mother_nodes") == ExitCode.BAD_CONFIGURATION
        assert complaint in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", ["rover_nodes", "--help"])
    with pytest.raises(SystemExit):
        run_composed("rover_nodes")
    assert "`jump_node --help`" in capsys.readouterr().out


def test_in_lockstep_each_process_knows_all_and_follows_no_clock():
    made, _ = planned(*MISSION, delay_seed="7", record="no_such_bag")
    text = (
        "sim_node=sim_node,mother_nodes=winch_node,"
        "rover_nodes=descent_node+drive_node+jump_node,operations_nodes=mission_node"
    )
    *waited, recorder, viewer = made.started
    assert all(p.parameters["lockstep"] == text for p in waited)
    assert all(p.parameters["delay_seed"] == 7 for p in waited)
    assert not any("use_sim_time" in p.parameters for p in waited)
    assert recorder.parameters == {}
    assert viewer.parameters == {"use_sim_time": True}
    *linked, _, _ = planned(*MISSION, plant="hil", lockstep="true", record="bag")[0].started
    assert [p.executable for p in linked[:2]] == ["drive_emulator", "hil_bridge"]
    assert {str(p.parameters["lockstep"]).split("=")[0] for p in linked} == {"drive_emulator"}
    assert not any("use_sim_time" in p.parameters for p in linked)
    assert read_processes(text)["rover_nodes"] == ("descent_node", "drive_node", "jump_node")


@pytest.mark.parametrize("parameters", [SimParameters, MockPlantParameters])
def test_the_plant_s_arguments_are_its_parameters_with_their_types(parameters: type[Any]):
    types = {field.name: type(field.default) for field in dataclasses.fields(parameters)}
    assert {name: kind for name, (kind, _) in PARAMETERS.items()}.items() <= types.items()


@pytest.mark.parametrize("plant", ["sim", "mock"])
def test_simulated_time_runs_by_itself_on_request_only(plant: str):
    by_default, _ = planned(*MISSION, plant=plant)
    *waited, view = by_default.started
    assert all("lockstep" in p.parameters for p in waited)
    assert view.parameters == {"use_sim_time": True}
    source, *others = planned(*MISSION, plant=plant, lockstep="false")[0].started
    assert source.parameters == {}
    assert [p.parameters for p in others] == [{"use_sim_time": True}] * len(others)


def test_only_what_is_given_goes_before_the_plant_s_file():
    values = {"real_time_factor": "2", "start_paused": "True", "seed": "7"}
    _, started = planned(plant="mock", lockstep="false", **values)
    assert started["mock_plant"].parameters == {
        "real_time_factor": 2.0,
        "start_paused": True,
        "seed": 7,
    }
    assert planned(lockstep="false")[1]["sim_node"].parameters == {}


def test_the_winch_has_room_for_the_trim_only_beside_a_descent():
    assert files_of(("winch_node", "jump_node"))["winch_node"] == ("winch_node",)
    assert files_of(MISSION)["winch_node"] == ("winch_node", "winch_descent")


def test_the_end_of_the_plant_ends_all_and_that_of_a_controller_nothing():
    made, started = planned(*MISSION)
    assert [each.executable for each in made.started if each.shutdown_reason] == ["sim_node"]
    assert not started["mother_nodes"].shutdown_reason


def test_real_drives_run_by_the_wall_clock_and_nothing_is_emulated():
    _, started = planned(*MISSION, plant="hil", drives="socketcan:can0", scenario="marius_hills")
    assert "drive_emulator" not in started
    assert started["hil_bridge"].parameters == {"use_sim_time": False, "link": "socketcan:can0"}
    assert not any(started[name].parameters["use_sim_time"] for name in COMPOSED)


def test_emulated_drives_and_bridge_share_the_link_of_a_rover():
    link = "udp_multicast:239.74.163.9"
    _, started = planned(plant="hil", link=link, scenario="free_hang", model="spatial")
    assert started["hil_bridge"].parameters == {"use_sim_time": True, "link": link}
    assert started["drive_emulator"].parameters == {"scenario": "free_hang", "link": link}


def test_the_processes_of_the_loop_get_the_requested_priority():
    _, started = planned(
        *MISSION, plant="hil", realtime_priority="20", record="no_such_bag", console="true"
    )
    having = {name for name, each in started.items() if "realtime_priority" in each.parameters}
    assert having == {"drive_emulator", "hil_bridge", *COMPOSED}
    assert started["mother_nodes"].parameters["realtime_priority"] == 20
    _, without = planned(*MISSION)
    assert not any("realtime_priority" in each.parameters for each in without.values())


@pytest.mark.parametrize("given", [{}, {"plant": "mock"}, {"plant": "hil"}])
def test_frames_are_published_with_every_plant(given: dict[str, str]):
    assert "view_node" in planned(*MISSION, **given)[1]
    assert "view_node" not in planned(*MISSION, frames="false", **given)[1]


def test_actions_are_offered_on_request():
    assert ACTION not in planned(*MISSION)[1]
    process = planned(*MISSION, actions="true")[1][ACTION]
    # It follows the clock; no lockstep waits for it.
    assert process.parameters == {"use_sim_time": True}


def test_without_rviz_a_message_reports_it_and_everything_else_is_started():
    without, started = planned(*MISSION, rviz="true")
    assert "rviz2" not in started
    (message,) = without.messages
    assert "ros-jazzy-rviz2" in message
    found, started = planned(*MISSION, rviz="true", find=lambda name: f"/usr/bin/{name}")
    assert not found.messages
    assert started["rviz2"].arguments == ("-d", f"{CONFIG}/mother_rover.rviz")
    assert found.started[:-1] == without.started


def test_the_operators_page_is_started_on_request():
    assert "operator_console" not in planned(*MISSION)[1]
    page = planned(*MISSION, console="true")[1]["operator_console"]
    assert page.files == (f"{CONFIG}/operator_console.yaml",)
    assert page.parameters == {"use_sim_time": True}


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"plant": "toy"}, "plant is 'toy', it must be one of sim, mock, hil"),
        ({"real_time_factor": "fast"}, "real_time_factor is 'fast', it must be of type float"),
        ({"start_paused": "maybe"}, "start_paused is 'maybe', it must be true or false"),
        (
            {"plant": "hil", "real_time_factor": "2"},
            "real_time_factor is '2': it must be empty with plant:=hil",
        ),
        ({"plant": "hil", "model": "planar"}, "have a spatial scenario"),
        ({"realtime_priority": "high"}, "is 'high', it must be a whole number from 1"),
        ({"realtime_priority": "0"}, "is '0', it must be a whole number from 1"),
        (
            {"plant": "hil", "drives": "socketcan:can0", "lockstep": "true"},
            "lockstep is true: it must be false with real drives",
        ),
        ({"lockstep": "true", "delay_seed": "x"}, "delay_seed is 'x', it must be a whole number"),
        ({"drives": "socketcan:can0"}, "plant:=sim has no link to drives"),
        ({"plant": "mock", "link": "can"}, "link is 'can', but plant:=mock has no link to drives"),
        (
            {"plant": "hil", "drives": "socketcan:can0", "link": "can"},
            "link is 'can', but the link to real drives is given by drives, 'socketcan:can0'",
        ),
        ({"lockstep": "false", "participants": "pilot"}, "participants is 'pilot', but time runs"),
        ({"plant": "hil", "delay_seed": "3"}, "delay_seed is '3', but time runs by itself"),
        ({"namespace": "rover 1"}, "namespace: 'rover 1' should be names of letters"),
    ],
)
def test_an_inconsistent_argument_is_refused(values: dict[str, str], complaint: str):
    with pytest.raises(LaunchError, match=complaint):
        planned(**values)


def test_a_default_of_an_unknown_argument_is_refused():
    with pytest.raises(LaunchError, match="has the argument speed"):
        arguments_of((), CONFIG, {"speed": "2"})


# -------------------------------------------------------------------------------- the record


@pytest.mark.parametrize("make", [Path.mkdir, Path.touch, lambda path: path.symlink_to("nowhere")])
def test_a_record_that_exists_is_refused_at_the_launch(tmp_path: Path, make: Any):
    target = tmp_path / "bag"
    make(target)
    with pytest.raises(LaunchError, match="which exists: choose another folder"):
        planned(*MISSION, record=str(target))


def test_a_record_that_cannot_be_made_is_refused_at_the_launch(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(LaunchError, match="no folder can be made in"):
        planned(*MISSION, record=str(tmp_path / "file" / "bag"))
    assert "bag_record" in planned(*MISSION, record=str(tmp_path / "a" / "bag"))[1]


def test_an_argument_that_is_none_is_refused_or_reported():
    known = [each.name for each in arguments_of(MISSION, CONFIG, {})]
    assert not unknown_arguments([], known)
    assert not unknown_arguments(["record", "scenario"], known)
    with pytest.raises(LaunchError, match=r"no argument 'recrod'.*did you mean 'record'"):
        unknown_arguments(["scenario", "recrod"], known)
    (message,) = unknown_arguments(["another_files_own"], known)
    assert "another_files_own" in message
