"""Attitude and heading at any tilt, against rotation matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rover_control.drive.drive_attitude import DriveAttitude

H = 0.02  # [s]
G = 1.62


class Tumble:
    """A rotating body, the attitude from its gyro, and the total change of the heading."""

    def __init__(self, share: float = 0.0) -> None:
        self.attitude, self.share = DriveAttitude(), share
        self.rotation = Rotation.identity()
        self.turned = 0.0

    def turn(self, axis: tuple[float, float, float], angle: float, time: float = 2.0) -> None:
        """Rotate about a body axis."""
        steps = round(time / H)
        x, y, z = (float(value) for value in np.asarray(axis) * angle / time)
        for _ in range(steps):
            self.rotation = self.rotation * Rotation.from_rotvec(np.array((x, y, z)) * H)
            self.turned += self.attitude.turn((x, y, z), self.force, H, self.share)

    @property
    def force(self) -> tuple[float, float, float]:
        """Specific force of an ideal accelerometer."""
        x, y, z = self.rotation.inv().apply([0.0, 0.0, G])
        return float(x), float(y), float(z)

    @property
    def true_heading(self) -> float:
        x, y, _ = self.rotation.apply([1.0, 0.0, 0.0])
        return math.atan2(y, x)

    def miss(self) -> float:
        return abs(math.remainder(self.turned - self.true_heading, math.tau))


def test_a_full_turn_on_a_slope_is_a_full_turn_of_the_heading():
    body = Tumble()
    body.turn((1.0, 0.0, 0.0), 0.3)
    body.turn((0.0, 0.0, 1.0), math.tau, 20.0)
    assert body.turned == pytest.approx(math.tau, abs=1e-9)
    assert body.attitude.inclination == pytest.approx(0.3, abs=1e-9)
    assert body.attitude.roll == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("aside", [0.0, 0.02, 0.4])
def test_the_heading_is_correct_after_a_pitch_over_and_a_roll(aside: float):
    body = Tumble()
    body.turn((0.0, 0.0, 1.0), 0.7)
    body.turn((math.sin(aside), math.cos(aside), 0.0), 3.0)
    assert body.attitude.inclination == pytest.approx(3.0, abs=1e-9)
    assert body.miss() < 1e-6
    body.turn((1.0, 0.0, 0.0), 3.0)
    assert body.miss() < 1e-6
    if aside == 0.0:
        assert abs(math.remainder(body.true_heading - 0.7, math.tau)) > 2.8


@pytest.mark.parametrize("tilt", [(0.3, -0.2), (1.4, 0.1), (1.5707963, 0.0), (-1.5, 0.4)])
def test_the_first_sample_gives_the_tilt(tilt: tuple[float, float]):
    body = Tumble()
    body.rotation = Rotation.from_euler("YX", tilt)
    body.attitude.start(body.force)
    assert body.attitude.up == pytest.approx(body.rotation.inv().apply([0.0, 0.0, 1.0]))
    body.turn((0.0, 1.0, 0.0), -tilt[0])
    before = body.true_heading
    body.turned = 0.0
    body.turn((0.0, 0.0, 1.0), 1.0)
    assert body.turned == pytest.approx(math.remainder(body.true_heading - before, math.tau))


def test_the_accelerometer_corrects_the_tilt_but_not_the_heading():
    attitude = DriveAttitude()
    force = (-G * math.sin(0.1), 0.0, G * math.cos(0.1))
    turned = sum(attitude.turn((0.0, 0.0, 0.0), force, H, 0.04) for _ in range(300))
    assert attitude.pitch == pytest.approx(0.1, abs=1e-4)
    assert turned == pytest.approx(0.0, abs=1e-12)


def test_gravity_bounds_the_error_of_a_drifting_gyro():
    body = Tumble(share=0.04)
    body.turn((0.0, 1.0, 0.0), 0.2)
    for _ in range(2000):
        body.attitude.turn((0.002, -0.002, 0.0), body.force, H, 0.04)
    # In equilibrium a drift of 2 mrad/s is balanced by half a second of tilt correction.
    assert body.attitude.pitch == pytest.approx(0.2 - 0.001, abs=1e-4)
