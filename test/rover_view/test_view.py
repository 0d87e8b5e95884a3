"""Frames from the robot description, and markers of wall images and predicted jumps."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from msg_schemas import machine, topics
from msg_schemas.cdr import pack, unpack
from msg_schemas.samples import JointSample, JointValue, OdometrySample, PoseEstimateSample
from rover_runtime.loop_host import LoopHost
from rover_sim.interface.robot_description import robot_description
from rover_sim.scenarios.scenario import SpatialScenario, load_overridden
from rover_view import view_node
from rover_view.observed_wall import SMEARED, STEADY, UNKNOWN, ObservedWall
from rover_view.predicted_jump import prediction_markers
from rover_view.robot_model import (
    DescriptionError,
    RobotModel,
    about_y,
    about_z,
    body_frames,
    estimated_frames,
    rotate,
)

SCENARIO = load_overridden("marius_hills", "")
assert isinstance(SCENARIO, SpatialScenario)
DESCRIPTION = robot_description(SCENARIO)
MACHINE = RobotModel.read(DESCRIPTION)


def observation(depth: float, heading: float, **more: float) -> JointSample:
    joints = {
        machine.PICTURE: JointValue(1.0),
        machine.DEPTH: JointValue(depth),
        machine.HEADING: JointValue(heading),
        machine.CAMERA_RATE: JointValue(),
        **{name: JointValue(value) for name, value in more.items()},
    }
    return JointSample(7, joints)


def test_the_fixed_frames_are_those_that_no_joint_moves():
    assert {placed.child for placed in MACHINE.fixed} == {
        "camera", "camera_optical", "contact_switches", "fairlead", "imu", "tether_attachment",
    }  # fmt: skip
    assert MACHINE.drum_radius == pytest.approx(0.05)


def test_body2_is_placed_along_the_slider_of_a_tilted_rover():
    tilted = about_y(0.3)
    offset = rotate(tilted, (0.0, 0.0, 0.15))
    body1 = OdometrySample(0, (1.0, 2.0, -9.0), tilted, (0, 0, 0), (0, 0, 0))
    there = (1.0 + offset[0], 2.0 + offset[1], -9.0 + offset[2])
    body2 = OdometrySample(0, there, tilted, (0, 0, 0), (0, 0, 0))
    first, second = body_frames(body1, body2)
    assert (first.parent, first.child) == (machine.WORLD_FRAME, machine.TRUTH_BODY1_FRAME)
    assert first.position == body1.position
    assert (second.parent, second.child) == (machine.TRUTH_BODY1_FRAME, machine.TRUTH_BODY2_FRAME)
    assert second.position == pytest.approx((0.0, 0.0, 0.15))


def test_the_estimate_is_in_map_and_the_odometry_in_odom():
    odometry = OdometrySample(0, (2.0, 1.0, 0.0), about_z(0.4), (0, 0, 0), (0, 0, 0))
    pose = PoseEstimateSample(0, (3.0, -1.0, -49.8), about_z(2.0))
    in_map, in_odom = estimated_frames(odometry, pose)
    assert (in_map.parent, in_map.child) == (machine.WORLD_FRAME, machine.ODOM_FRAME)
    assert (in_odom.parent, in_odom.child) == (machine.ODOM_FRAME, machine.BODY1_FRAME)
    assert in_odom[2:] == (odometry.position, odometry.orientation)
    position, orientation = in_map.then(*in_odom[2:])
    assert position == pytest.approx(pose.position)
    assert orientation == pytest.approx(pose.orientation)


def test_wheels_and_drum_rotate_at_their_positions():
    left, drum, body2 = MACHINE.moved(
        {machine.WHEEL_LEFT: 0.5, machine.WINCH_DRUM: 0.5, machine.JUMP_SLIDER: -0.1}
    )
    assert left.child == machine.WHEEL_LEFT
    assert left.position == pytest.approx((0.08, 0.22, 0.0))
    # Rolling forward, the top of the wheel moves forward.
    assert rotate(left.orientation, (0.0, 0.0, 1.0))[0] > 0.4
    assert drum.child == machine.WINCH_DRUM
    # Paying out, the side of the tether moves down.
    assert rotate(drum.orientation, (1.0, 0.0, 0.0))[2] < -0.4
    assert (body2.parent, body2.child) == (machine.BODY1_FRAME, machine.BODY2_FRAME)
    free = MACHINE.joints[machine.BODY2_FRAME].position[2]
    assert body2.position == pytest.approx((0.0, 0.0, free - 0.1))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("no xml", "not a URDF"),
        ("<robot><joint name='a'/></robot>", "lacks a parent or child link"),
        ("<robot/>", "has no link base_link"),
        (DESCRIPTION.replace("0.08 0.22 0", "0.08 x 0"), "not a URDF"),
        (DESCRIPTION.replace("0.08 0.22 0", "0.08 nan 0"), "three finite numbers"),
        (DESCRIPTION.replace("0.08 0.22 0", "0.08 1e999 0"), "three finite numbers"),
    ],
)
def test_a_description_of_another_robot_is_refused(text: str, complaint: str):
    with pytest.raises(DescriptionError, match=complaint):
        RobotModel.read(text)


def test_an_image_is_drawn_where_the_camera_looked():
    wall = ObservedWall()
    assert wall.add(observation(12.0, 0.0, wall_distance=2.84), MACHINE)
    (shape,) = wall.drawing(7).shapes
    # The camera is 0.16 m aft and 0.05 m up and looks aft; the attachment is 0.28 m up.
    assert shape.position == pytest.approx((-3.0, 0.0, -12.0 - 0.28 + 0.05))
    assert wall.add(observation(12.0, 0.5 * math.pi, wall_distance=2.84), MACHINE)
    assert wall.drawing(7).shapes[1].position == pytest.approx((0.0, -3.0, -12.23))
    assert rotate(about_z(0.5 * math.pi), (-1.0, 0.0, 0.0)) == pytest.approx((0.0, -1.0, 0.0))
    packed = pack(topics.OBSERVED_WALL, wall.drawing(7))
    assert len(unpack(topics.OBSERVED_WALL, packed).shapes) == 2


def test_frames_are_published_in_the_message_of_tf():
    frames = MACHINE.moved({machine.WHEEL_LEFT: 0.5})
    published = view_node.frames_message(SimpleNamespace, frames, 3_000_000_007)
    first = published.transforms[0]
    assert (first.header.frame_id, first.child_frame_id) == (
        machine.BODY1_FRAME,
        machine.WHEEL_LEFT,
    )
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == (3, 7)
    assert first.transform.translation.y == pytest.approx(0.22)
    assert first.transform.rotation.y == pytest.approx(math.sin(0.25))


def test_its_colour_shows_the_smear():
    wall = ObservedWall()
    for more in ({machine.SMEAR: 0.1}, {machine.SMEAR: 9.0}, {}):
        wall.add(observation(12.0, 0.0, **{machine.WALL_DISTANCE: 3.0}, **more), MACHINE)
    colours = [shape.colour for shape in wall.drawing(0).shapes]
    assert colours == [STEADY, pytest.approx(SMEARED), UNKNOWN]


@pytest.mark.parametrize("more", [{}, {machine.WALL_DISTANCE: 1000.0}])
def test_without_a_wall_in_range_there_is_no_marker(more: dict[str, float]):
    wall = ObservedWall()
    assert not wall.add(observation(12.0, 0.0, **more), MACHINE)
    assert not wall.drawing(0).shapes


def test_a_predicted_jump_is_drawn_at_the_rover():
    joints = {
        machine.JUMP_HEIGHT: JointValue(0.30, 0.25, 0.35),
        machine.JUMP_RANGE: JointValue(0.4, 0.3, 0.5),
    }
    stands = PoseEstimateSample(0, (1.0, 2.0, -4.8))
    drawing = prediction_markers(JointSample(5, joints), stands, 7)
    mark, inner, outer = drawing.shapes
    assert mark.points[0] == pytest.approx((1.0, 2.0, -4.55))
    assert mark.points[1] == pytest.approx((1.0, 2.0, -4.45))
    for ring, radius in ((inner, 0.3), (outer, 0.5)):
        assert {round(math.dist(point, stands.position), 9) for point in ring.points} == {radius}
        assert ring.points[0] == pytest.approx(ring.points[-1])
    assert len(unpack(topics.PREDICTED_JUMP, pack(topics.PREDICTED_JUMP, drawing)).shapes) == 3
    still = {**joints, machine.JUMP_RANGE: JointValue()}
    assert len(prediction_markers(JointSample(5, still), stands, 7).shapes) == 1


def test_a_reset_clears_the_wall_and_the_predicted_jump():
    host, drawn = LoopHost(), []
    view = host.start(view_node.ViewNode)
    names = (topics.OBSERVED_WALL, topics.PREDICTED_JUMP)
    host.exchange.listen(lambda name, sample, *_: drawn.append((name, sample.shapes)), *names)
    view.clock_went_back()
    assert drawn == [(name, ()) for name in names]
