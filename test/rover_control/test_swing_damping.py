"""Winch and wheels against a swing: strokes, and decay on a pendulum by its own equations."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import pytest

from rover_control.hanging_rover import HangingParameters
from rover_control.swing_damping import DampingParameters, WheelPump, WinchTrim
from rover_control.swing_estimator import SwingEstimate

HANGING, DAMPING = HangingParameters(), DampingParameters()
H = 0.02


@dataclass
class Pendulum:
    """A rover as one point on a rope whose length follows a rate; small angles, in space."""

    length: float
    u: complex
    v: complex
    yaw: float = 0.0
    yaw_rate: float = 0.0
    trimmed: float = 0.0
    force: float = 0.0  # on the rover along base_link x [N]

    def estimate(self) -> SwingEstimate:
        turned = cmath.exp(-1j * self.yaw)
        u, v = self.u * turned, self.v * turned
        frequency = HANGING.swing_frequency(self.length)
        zero = (0.0, 0.0)
        return SwingEstimate(
            (u.real, u.imag), (v.real, v.imag), zero, zero, zero, self.yaw_rate, frequency, 0.0, 0.0
        )

    def step(self, rate: float = 0.0, momentum_change: float = 0.0) -> None:
        reach = self.length + HANGING.lever
        along = -momentum_change / H / (HANGING.rover_mass * reach**2)
        push = along * cmath.exp(1j * self.yaw)
        pull = HANGING.pull(self.length) / reach
        for _ in range(4):
            self.v += 0.25 * H * (-pull * self.u - 2.0 * rate / reach * self.v + push)
            self.u += 0.25 * H * self.v
        self.length += H * rate
        self.trimmed += H * rate
        # What the swing gains in momentum about the plumb line, the rover loses.
        lever = HANGING.rover_mass * reach**2
        self.yaw_rate -= H * lever * (self.u.conjugate() * push).imag / 0.153
        self.yaw += H * self.yaw_rate

    @property
    def amplitude(self) -> float:
        return self.estimate().ellipse.major

    @property
    def momentum(self) -> float:
        reach = self.length + HANGING.lever
        return HANGING.rover_mass * reach**2 * (self.u.conjugate() * self.v).imag


def swinging(length: float, major: float, minor: float = 0.0) -> Pendulum:
    frequency = HANGING.swing_frequency(length)
    return Pendulum(length, complex(math.radians(major)), 1j * math.radians(minor) * frequency)


@pytest.mark.parametrize(
    ("length", "bound"), [(45.0, "rate"), (7.5, "acceleration"), (0.5, "acceleration")]
)
def test_the_stroke_is_bounded_by_what_binds_first(length: float, bound: str):
    trim = WinchTrim(DAMPING)
    frequency = HANGING.swing_frequency(length)
    stroke = trim.stroke(length, frequency)
    assert stroke.bound == bound
    assert 2.0 * frequency * stroke.length <= DAMPING.trim_rate + 1e-12
    assert 4.0 * frequency**2 * stroke.length <= 0.8 * DAMPING.trim_acceleration + 1e-12
    assert stroke.length <= DAMPING.trim_share * length


def test_a_share_of_the_length_bounds_a_quick_winch():
    quick = WinchTrim(DampingParameters(trim_rate=0.3, trim_acceleration=5.0, trim_share=0.01))
    assert quick.stroke(2.0, HANGING.swing_frequency(2.0)).bound == "share"


@pytest.mark.parametrize("length", [2.5, 7.5, 45.0])
def test_a_plane_swing_decays_as_foretold(length: float):
    trim = WinchTrim(DAMPING)
    rover = swinging(length, 3.0)
    decay = trim.decay(length, HANGING.swing_frequency(length))
    for _ in range(round(1.0 / (decay * H))):
        rover.step(trim.rate(rover.estimate(), length, rover.trimmed))
    fallen = math.log(math.radians(3.0) / rover.amplitude)
    assert fallen == pytest.approx(1.0, rel=0.15)
    assert abs(rover.trimmed) < 1.1 * trim.stroke(length, 0.2).length


def test_a_circle_is_left_alone_by_the_winch_and_an_ellipse_becomes_one():
    trim = WinchTrim(DAMPING)
    circle = swinging(10.0, 1.0, 1.0)
    assert abs(trim.rate(circle.estimate(), 10.0, 0.0)) < 1e-3 * DAMPING.trim_rate
    ellipse = swinging(10.0, 2.0, 0.5)
    before = ellipse.momentum
    for _ in range(round(200.0 / H)):
        ellipse.step(trim.rate(ellipse.estimate(), 10.0, ellipse.trimmed))
    end = ellipse.estimate().ellipse
    assert math.degrees(end.major) == pytest.approx(1.0, abs=0.12)
    assert math.degrees(end.minor) == pytest.approx(1.0, abs=0.12)
    assert ellipse.momentum == pytest.approx(before, rel=0.03)


def pumped(rover: Pendulum, seconds: float, *, may_spin: bool, turns: bool = True) -> None:
    pump = WheelPump(DAMPING, HANGING)
    last = None
    for _ in range(round(seconds / H)):
        if not turns:
            rover.yaw_rate = 0.0
        momentum = pump.momentum(rover.estimate(), may_spin=may_spin)
        rover.step(0.0, 0.0 if last is None else momentum - last)
        last = momentum


def test_the_wheels_take_a_plane_swing_away_as_foretold():
    rover = swinging(3.0, 3.0)
    pumped(rover, 60.0, may_spin=True)
    fallen = WheelPump(DAMPING, HANGING).decay(3.0) * 60.0
    assert math.radians(3.0) - rover.amplitude == pytest.approx(fallen, rel=0.05)


def test_a_cone_that_is_pumped_away_spins_the_rover():
    rover = swinging(2.0, 1.5, 1.4)
    before = rover.momentum
    pumped(rover, 60.0, may_spin=True)
    assert rover.momentum < 0.8 * before
    assert 0.153 * rover.yaw_rate == pytest.approx(before - rover.momentum, rel=5e-3)


def test_for_pictures_only_the_plane_part_is_pumped():
    rover = swinging(2.0, 2.0, 0.8)
    # Along the ellipse's own axes no force of one direction could.
    rover.yaw = 0.25 * math.pi
    before = rover.momentum
    pumped(rover, 120.0, may_spin=False)
    ellipse = rover.estimate().ellipse
    assert ellipse.major < math.radians(1.8)
    assert ellipse.minor > math.radians(0.85)
    assert rover.momentum == pytest.approx(before, rel=0.02)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_spinning_rover_is_stopped_by_its_swing(sign: float):
    rover = swinging(20.0, 0.6, 0.5)
    rover.yaw_rate = sign * math.radians(0.5)
    pumped(rover, 300.0, may_spin=False)
    assert abs(rover.yaw_rate) < math.radians(0.06)
    # The swing took it up, and hardly changed.
    assert math.degrees(rover.amplitude) < 0.65


def test_the_pumping_s_own_tilt_is_that_of_its_torque():
    pump = WheelPump(DAMPING, HANGING)
    frequency, momentum = 0.5, 0.02
    # h = H cos wt, p = -h'/(m g d): p' = H w^2/(m g d) at t = 0.
    wanted = momentum * frequency**2 / (10.0 * 1.62 * 0.203)
    assert pump.own_tilt_rate(momentum, frequency) == pytest.approx(wanted)
