"""Perspective drawing, and the visible parts of a robot."""

import math

import numpy as np
import pytest

from rover_bags.views.perspective import Camera, Painting, box, cylinder, sphere
from rover_bags.views.urdf import read_robot

SIZE = (100, 80)
AHEAD = Camera(np.array([0.0, -10.0, 0.0]), np.zeros(3), math.radians(60.0))
SKY, RED, BLUE = (0, 0, 0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def square(y: float, half: float) -> np.ndarray:
    corners = [(-half, y, -half), (half, y, -half), (half, y, half), (-half, y, half)]
    return np.array([corners])


def test_points_are_projected_by_the_angle_of_view():
    pixels, distance = AHEAD.project(
        np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]]), SIZE
    )
    assert distance == pytest.approx([10.0] * 3)
    scale = 0.5 * SIZE[1] / math.tan(math.radians(30.0)) / 10.0
    assert pixels[0] == pytest.approx([50.0, 40.0])
    assert pixels[1] == pytest.approx([50.0 + 2.0 * scale, 40.0])
    assert pixels[2] == pytest.approx([50.0, 40.0 - 2.0 * scale])  # up


@pytest.mark.parametrize("near_first", [True, False])
def test_what_is_nearer_covers_what_is_farther(near_first: bool):
    painting = Painting(AHEAD, SIZE, SKY)
    surfaces = [(square(-2.0, 1.0), RED), (square(3.0, 3.0), BLUE)]
    for corners, colour in surfaces if near_first else reversed(surfaces):
        painting.polygons(corners, colour, is_shaded=False)
    image = painting.image()
    assert image.getpixel((50, 40)) == pytest.approx((255, 0, 0), abs=2)
    assert image.getpixel((50, 26)) == pytest.approx((0, 0, 255), abs=2)
    assert image.getpixel((2, 2)) == SKY


def test_what_is_behind_the_camera_is_not_drawn():
    painting = Painting(AHEAD, SIZE, SKY)
    painting.polygons(square(-11.0, 5.0), RED)
    painting.line(np.array([[0.0, -12.0, 0.0], [0.0, -11.0, 1.0]]), np.array([RED]), 2)
    assert painting.image().getextrema() == ((0, 0), (0, 0), (0, 0))


def test_solids_have_their_sizes():
    (faces,) = box((0.2, 0.4, 0.6))
    assert np.ptp(faces.reshape(-1, 3), axis=0) == pytest.approx([0.2, 0.4, 0.6])
    points = np.concatenate([each.reshape(-1, 3) for each in cylinder(0.15, 0.06)])
    assert np.ptp(points, axis=0) == pytest.approx([0.3, 0.3, 0.06])
    (faces,) = sphere(0.5)
    assert np.linalg.norm(faces, axis=2).max() == pytest.approx(0.5)


ROBOT = """<robot name="r">
  <link name="base"><visual><origin xyz="0 0 1"/><geometry><box size="1 1 1"/></geometry></visual>
  </link>
  <link name="arm"><visual><geometry><cylinder radius="0.1" length="1"/></geometry>
    <material name="m"><color rgba="1 0.5 0 1"/></material></visual></link>
  <joint name="mount" type="fixed"><parent link="base"/><child link="arm"/>
    <origin xyz="0 2 0" rpy="1.5707963267948966 0 0"/></joint>
  <link name="wheel"><visual><geometry><mesh filename="w.dae"/></geometry></visual></link>
  <joint name="axle" type="continuous"><parent link="base"/><child link="wheel"/>
    <origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint>
</robot>"""


def test_parts_on_fixed_joints_belong_to_the_link_that_moves():
    robot = read_robot(ROBOT)
    base, arm = robot.parts  # a mesh lies outside the bag
    assert {base.link, arm.link} == {"base"}
    assert arm.colour == (1.0, 0.5, 0.0)
    points = np.concatenate([each.reshape(-1, 3) for each in arm.faces])
    assert points.mean(axis=0) == pytest.approx([0.0, 2.0, 0.0], abs=0.02)
    assert np.ptp(points[:, 1]) == pytest.approx(1.0)  # turned from z to y
    assert list(robot.joints) == ["wheel"]
    assert robot.joints["wheel"].axis.tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    "text",
    [
        "no xml",
        "<robot><link><visual><geometry><box size='1 x 1'/></geometry></visual></link></robot>",
        ROBOT.replace(
            "</robot>",
            "<joint type='fixed'><parent link='arm'/><child link='base'/></joint></robot>",
        ),
    ],
)
def test_a_text_that_is_no_description_is_refused(text: str):
    with pytest.raises(ValueError, match=r"description|could not convert"):
        read_robot(text)
