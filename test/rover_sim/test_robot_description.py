"""The URDF, read by another parser, has the scenario's masses, sizes and joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msg_schemas import machine, topics
from msg_schemas.table import TOPICS
from rover_sim.interface.robot_description import robot_description
from rover_sim.scenarios import scenario as scenarios
from rover_sim.scenarios.hardware import RoverSettings
from rover_sim.scenarios.scenario import ScenarioError, SpatialScenario, load_overridden

FOLDER = Path(scenarios.__file__).parent
ROVERS = [
    path.stem
    for path in sorted(FOLDER.glob("*.yaml"))
    if getattr(load_overridden(path.stem, ""), "model", "") == "spatial"
    and load_overridden(path.stem, "").rover is not None
]


urdf = pytest.importorskip("urdf_parser_py.urdf")


def read(name: str) -> tuple[Any, RoverSettings]:
    scenario = load_overridden(name, "")
    assert isinstance(scenario, SpatialScenario)
    assert scenario.rover is not None
    return urdf.URDF.from_xml_string(robot_description(scenario).encode()), scenario.rover


def tensor_of(inertia: Any) -> Any:
    return np.array(
        [
            [inertia.ixx, inertia.ixy, inertia.ixz],
            [inertia.ixy, inertia.iyy, inertia.iyz],
            [inertia.ixz, inertia.iyz, inertia.izz],
        ]
    )


def test_there_are_scenarios_with_a_rover():
    assert {"marius_hills", "free_hang", "lab_rig"} <= {*ROVERS}


@pytest.mark.parametrize("name", ROVERS)
def test_every_moment_of_inertia_is_one_that_a_body_can_have(name: str):
    robot, _ = read(name)
    heavy = [link for link in robot.links if link.inertial is not None]
    assert len(heavy) >= 4
    for link in heavy:
        moments = np.linalg.eigvalsh(tensor_of(link.inertial.inertia))
        assert link.inertial.mass > 0.0
        assert moments[0] > 0.0, link.name
        assert moments[2] <= moments[0] + moments[1] + 1e-12, link.name


@pytest.mark.parametrize("name", ROVERS)
def test_the_links_add_up_to_the_scenario_s_bodies(name: str):
    robot, rover = read(name)
    links, joints = robot.link_map, robot.joint_map
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for part in (machine.BODY1_FRAME, machine.WHEEL_LEFT, machine.WHEEL_RIGHT):
        inertial = links[part].inertial
        place = np.array(inertial.origin.xyz)
        if part in joints:
            place = place + joints[part].origin.xyz
        mass += inertial.mass
        moment += inertial.mass * place
        steiner = place @ place * np.eye(3) - np.outer(place, place)
        inertia += tensor_of(inertial.inertia) + inertial.mass * steiner
    spins = [rover.jump_drive.inertia, 2.0 * rover.wheel_drive.wheel_inertia, 0.0]
    assert mass == pytest.approx(rover.m1)
    assert moment == pytest.approx(np.zeros(3), abs=1e-9)
    assert inertia == pytest.approx(np.diag(rover.inertia1) + np.diag(spins), abs=1e-9)
    assert links[machine.BODY2_FRAME].inertial.mass == rover.m2
    assert np.diag(tensor_of(links[machine.BODY2_FRAME].inertial.inertia)).tolist() == list(
        rover.inertia2
    )


def test_joints_move_as_the_rover_does():
    robot, rover = read("marius_hills")
    joints = robot.joint_map
    assert robot.get_root() == machine.WORLD_FRAME
    slider = joints[machine.JUMP_SLIDER]
    assert (slider.type, slider.parent, slider.child) == (
        "prismatic",
        machine.BODY1_FRAME,
        machine.BODY2_FRAME,
    )
    assert slider.origin.xyz == [0.0, 0.0, rover.slider.free_length]
    assert (slider.limit.lower, slider.limit.upper) == (-rover.slider.lower_stop, 0.0)
    for name, place in (
        (machine.WHEEL_LEFT, rover.wheels.left),
        (machine.WHEEL_RIGHT, rover.wheels.right),
    ):
        assert (joints[name].type, joints[name].axis) == ("continuous", [0.0, 1.0, 0.0])
        assert joints[name].origin.xyz == list(place)
        (shape,) = robot.link_map[name].visuals
        assert shape.geometry.radius == rover.wheels.tip_radius
    drum = joints[machine.WINCH_DRUM]
    # The tether leaves the drum at the fairlead; a turn about +y lowers it there.
    assert drum.origin.xyz == [-0.05, 0.0, 0.0]
    assert robot.link_map[machine.BODY1_FRAME].visuals[0].geometry.size == list(rover.body1_size)


def test_the_camera_has_the_scenario_s_axis():
    robot, _ = read("marius_hills")
    scenario = load_overridden("marius_hills", "")
    assert isinstance(scenario, SpatialScenario)
    turned = np.eye(3)
    for child in (machine.CAMERA_FRAME, machine.CAMERA_OPTICAL_FRAME):
        (joint,) = [each for each in robot.joints if each.child == child]
        turned = turned @ rotation(*joint.origin.rpy)
    camera = scenario.sensors.camera
    assert turned @ [0.0, 0.0, 1.0] == pytest.approx(np.array(camera.axis), abs=1e-9)
    assert turned @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, -1.0], abs=1e-9)


def rotation(roll: float, pitch: float, yaw: float) -> Any:
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def test_without_a_rover_there_is_no_description():
    scenario = load_overridden("spatial_pendulum", "")
    assert isinstance(scenario, SpatialScenario)
    with pytest.raises(ValueError, match="has no rover to describe"):
        robot_description(scenario)


def test_sensors_have_frames_of_the_names_in_their_messages():
    robot, _ = read("marius_hills")
    for name in (
        topics.IMU,
        topics.CONTACT,
        topics.CAMERA,
        topics.LOAD_CELL,
        topics.ROVER_LOAD_CELL,
    ):
        assert TOPICS[name].frame in robot.link_map, name


def test_a_link_with_a_mesh_of_its_name_is_shown_by_it(tmp_path: Path):
    (tmp_path / "body2.STL").write_bytes(b"")
    scenario = load_overridden("marius_hills", f"rover.meshes: {tmp_path}")
    assert isinstance(scenario, SpatialScenario)
    robot = urdf.URDF.from_xml_string(robot_description(scenario).encode())
    (shown,) = robot.link_map[machine.BODY2_FRAME].visuals
    assert shown.geometry.filename == f"file://{tmp_path}/body2.STL"
    (kept,) = robot.link_map[machine.BODY2_FRAME].collisions
    assert not hasattr(kept.geometry, "filename")
    assert not hasattr(robot.link_map[machine.BODY1_FRAME].visuals[0].geometry, "filename")


def test_a_folder_without_meshes_is_refused(tmp_path: Path):
    scenario = load_overridden("marius_hills", f"rover.meshes: {tmp_path}")
    assert isinstance(scenario, SpatialScenario)
    with pytest.raises(ScenarioError, match=r"rover\.meshes.*named as a link: map, base_link"):
        robot_description(scenario)
