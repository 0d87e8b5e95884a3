import math

import numpy as np
import pytest

from rover_sim.physics.rover import rep103


def test_the_planar_y_axis_is_z() -> None:
    assert rep103.vector([1.0, 2.0]).tolist() == [1.0, 0.0, 2.0]
    assert rep103.vector(np.ones((4, 2, 2))).shape == (4, 2, 3)
    assert rep103.planar_vector([[1.0, 5.0, 2.0]]).tolist() == [[1.0, 2.0]]


@pytest.mark.parametrize("theta", [0.0, 0.4, -1.2, 3.0])
def test_orientation_rotates_the_slider_axis_like_the_planar_model(theta: float) -> None:
    x, y, z, w = rep103.quaternion(theta)
    vector, up = np.array([x, y, z]), np.array([0.0, 0.0, 1.0])
    turned = up + 2.0 * w * np.cross(vector, up) + 2.0 * np.cross(vector, np.cross(vector, up))
    assert turned == pytest.approx(rep103.vector([-math.sin(theta), math.cos(theta)]))
    assert rep103.planar_angle((x, y, z, w)) == pytest.approx(theta)


def test_rates_have_the_sign_of_angles() -> None:
    rate, dt = 0.7, 1e-6
    x, y, z, _ = (rep103.quaternion(rate * dt) - rep103.quaternion(0.0)) / dt
    assert 2.0 * np.array([x, y, z]) == pytest.approx(rep103.rotation_rate(rate))
