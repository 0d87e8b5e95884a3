"""Rotor pumping of swing and spin, on a simulated pendulum."""

from __future__ import annotations

import math

import pytest
from rope_pendulum import HANGING, H, Pendulum, swinging

from rover_control.hanging.rotor_pump import RotorPump
from rover_control.hanging.swing_damping import DampingParameters

DAMPING = DampingParameters()
WHEELS_ONLY = DampingParameters(flywheel_momentum=0.0)


def pumped(
    rover: Pendulum,
    seconds: float,
    torque: float,
    *,
    damps: bool,
    parameters: DampingParameters = DAMPING,
) -> None:
    pump = RotorPump(parameters, HANGING)
    for _ in range(round(seconds / H)):
        momenta = pump.momenta(rover.estimate(), rover.length, torque, damps=damps)
        rover.step(0.0, complex(momenta.x, momenta.y))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("minor", [0.0, 1.4, -1.4])
def test_the_requested_torque_turns_the_rover(sign: float, minor: float):
    rover = swinging(4.0, 2.0, minor)
    rover.u, rover.v = rover.u * (0.6 + 0.8j), rover.v * (0.6 + 0.8j)
    before = rover.momentum
    torque = sign * 1.0e-4
    pumped(rover, 60.0, torque, damps=False)
    spun = HANGING.inertia_about_z * rover.yaw_rate
    assert spun == pytest.approx(60.0 * torque, rel=0.15)
    # It comes from the swing.
    assert rover.momentum + spun == pytest.approx(before, abs=0.03 * abs(spun))


def test_a_torque_beyond_both_rotors_is_limited_to_the_prediction():
    rover = swinging(4.0, 2.0, 1.5)
    pump = RotorPump(DAMPING, HANGING)
    largest = pump.largest_torque(rover.estimate(), 4.0)
    pumped(rover, 20.0, 10.0 * largest, damps=False)
    assert HANGING.inertia_about_z * rover.yaw_rate == pytest.approx(20.0 * largest, rel=0.15)


def test_both_rotors_stay_within_their_bounds_and_the_screw_within_its_travel():
    for length, major in ((2.0, 3.0), (2.0, 0.1), (45.0, 1.0)):
        rover = swinging(length, major, 0.4 * major)
        pump = RotorPump(DAMPING, HANGING)
        swept = 0.0
        for _ in range(3000):
            swing = rover.estimate()
            most = pump.bounds(swing, length)
            momenta = pump.momenta(swing, length, 1.0, damps=True)
            assert abs(momenta.x) <= most[0] + 1e-12
            assert abs(momenta.y) <= most[1] + 1e-12
            swept = max(swept, abs(momenta.y_integral))
            rover.step()
        assert swept / HANGING.flywheel_inertia <= 1.05 * DAMPING.pump_travel


def test_the_integral_matches_the_flywheel_momentum():
    rover = swinging(6.0, 2.0, 1.0)
    pump = RotorPump(DAMPING, HANGING)
    total, misses, sweeps = 0.0, [], []
    for _ in range(2000):
        momenta = pump.momenta(rover.estimate(), 6.0, 1.0e-5, damps=False)
        misses.append(momenta.y_integral - total)
        sweeps.append(momenta.y_integral)
        total += H * momenta.y
        rover.step()
    assert max(misses) - min(misses) < 0.05 * (max(sweeps) - min(sweeps))


def test_the_wheels_damp_a_plane_swing_as_predicted():
    rover = swinging(3.0, 3.0)
    pumped(rover, 40.0, 0.0, damps=True, parameters=WHEELS_ONLY)
    fallen = WHEELS_ONLY.pump_momentum / (2.0 * HANGING.pendulum_inertia(3.0)) * 40.0
    assert math.radians(3.0) - rover.amplitude == pytest.approx(fallen, rel=0.1)
    assert abs(rover.yaw_rate) < 1e-3


def test_without_a_torque_only_the_plane_part_is_pumped():
    rover = swinging(2.0, 2.0, 0.8)
    rover.yaw = 0.25 * math.pi
    before = rover.momentum
    pumped(rover, 40.0, 0.0, damps=True)
    ellipse = rover.estimate().ellipse
    assert ellipse.major < math.radians(1.8)
    assert ellipse.minor > math.radians(0.85)
    assert rover.momentum == pytest.approx(before, rel=0.03)


def test_the_induced_tilt_rate_matches_the_torque():
    pump = RotorPump(DAMPING, HANGING)
    frequency, momentum = 0.5, 0.02
    # h = H cos wt, p = -h'/(m g d): p' = H w^2/(m g d) at t = 0.
    expected = momentum * frequency**2 / (10.0 * 1.62 * 0.203)
    assert pump.induced_tilt_rate(momentum, frequency) == pytest.approx(expected)
