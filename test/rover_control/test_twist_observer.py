"""Twist and yaw bias observed by the balance of the momentum about the plumb line."""

from __future__ import annotations

import math

import pytest
from rope_pendulum import HANGING, H, swinging

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.twist_observer import NO_CORRECTION, TwistObserver


class Turning:
    """A rover left to turn to and fro, whose gyro and known twist have errors."""

    def __init__(self, length: float, twist_error: float, bias: float) -> None:
        self.length, self.bias = length, bias
        self.yaw, self.rate = 0.5, 0.0  # true [rad], [rad/s]
        self.twist = self.yaw + twist_error  # known
        self.observer = TwistObserver(HANGING)
        self.swing = swinging(length, 0.2).estimate()
        self.corrected: list[float] = []

    def run(self, seconds: float) -> None:
        """Turn for a time [s]."""
        stiffness, inertia = HANGING.torsional_stiffness(self.length), HANGING.inertia_about_z
        for _ in range(round(seconds / H)):
            self.rate -= H * stiffness * self.yaw / inertia
            self.yaw += H * self.rate
            self.twist += H * (self.rate + self.bias)
            swing = self.swing._replace(yaw_rate=self.rate + self.bias)
            change = self.observer.step(swing, self.twist, self.length, H)
            self.corrected.append(change.twist)
            self.twist += change.twist
            self.bias -= change.yaw_bias


@pytest.mark.parametrize(("twist_error", "bias"), [(0.2, 0.0), (0.0, 0.002), (-0.2, -0.002)])
def test_a_short_tether_shows_twist_and_yaw_bias(twist_error: float, bias: float):
    rover = Turning(2.0, twist_error, bias)
    rover.run(600.0)
    assert rover.twist == pytest.approx(rover.yaw, abs=0.02)
    assert abs(rover.bias) < 1e-4
    true = HANGING.inertia_about_z * rover.rate
    assert rover.observer.momentum == pytest.approx(true, abs=2e-5)


def test_a_known_twist_is_not_changed():
    rover = Turning(2.0, 0.0, 0.0)
    rover.run(300.0)
    assert rover.twist == pytest.approx(rover.yaw, abs=2e-3)
    assert abs(rover.bias) < 1e-5


def test_errors_of_a_large_swing_are_not_taken_for_bias():
    rover = Turning(2.0, 0.0, 0.0)
    swings = [swinging(2.0, 1.5, minor).estimate() for minor in (0.05, -0.05)]
    for k in range(12):
        rover.swing = swings[k % 2]
        rover.run(20.0)
    assert rover.twist == pytest.approx(rover.yaw, abs=0.1)
    assert abs(rover.bias) < 2e-4


def test_turning_to_and_fro_with_the_swing_is_no_spin():
    observer, swing = TwistObserver(HANGING), swinging(2.0, 2.0).estimate()
    begin, rates = 3.0 * math.tau / swing.frequency, []
    for k in range(round(20.0 * begin / H)):
        rate = 0.006 * math.sin(swing.frequency * k * H)
        observer.step(swing._replace(yaw_rate=rate), 0.0, 2.0, H)
        rates.append(observer.yaw_rate)
    assert max(map(abs, rates[round(begin / H) :])) < 0.0012


def test_a_wound_tether_corrects_nothing():
    rover = Turning(2.0, 0.5, 0.0)
    rover.yaw = 3.0
    rover.twist = 3.5
    rover.run(300.0)
    assert set(rover.corrected) == {0.0}


def test_a_long_tether_shows_little():
    rover = Turning(45.0, 0.0, 0.002)
    rover.run(300.0)
    assert rover.bias == pytest.approx(0.002, rel=0.01)
    # The drift stays; it is not made worse.
    assert rover.twist - rover.yaw == pytest.approx(0.002 * 300.0, rel=0.1)


def test_nothing_is_corrected_until_the_momentum_is_averaged():
    rover = Turning(2.0, 0.2, 0.002)
    period = math.tau / HANGING.swing_frequency(2.0)
    rover.run(3.9 * period)
    assert set(rover.corrected) == {0.0}
    rover.run(0.2 * period)
    assert rover.corrected[-1] != 0.0
    rover.observer.restart()
    begun = len(rover.corrected)
    rover.run(3.9 * period)
    assert set(rover.corrected[begun:]) == {0.0}


def test_a_tether_without_torsion_shows_nothing():
    observer = TwistObserver(HangingParameters(twist_stiffness=0.0))
    swing = swinging(2.0, 1.0, 0.5).estimate()
    for k in range(1000):
        assert observer.step(swing._replace(yaw_rate=1e-3 * k), 1.0, 2.0, 0.1) == (0.0, 0.0)
    assert NO_CORRECTION == (0.0, 0.0)
