"""Suspended mass from the tension at the fairlead."""

from __future__ import annotations

import math

import pytest

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.suspended_mass import SuspendedMassEstimator

HANGING = HangingParameters()
H = 0.01


def weigh(
    suspended_mass: SuspendedMassEstimator, mass: float, length: float, seconds: float
) -> None:
    """Tension of a rover that swings by 3 deg and bounces on its tether."""
    w = HANGING.swing_frequency(length)
    for k in range(round(seconds / H)):
        t = k * H
        angle, rate = 0.05 * math.sin(w * t), 0.05 * w * math.cos(w * t)
        pull = HANGING.rover_gravity * math.cos(angle) + length * rate**2
        pull *= mass * (1.0 + 0.05 * math.sin(9.0 * t))
        weight = HANGING.tether_density * length * HANGING.rover_gravity
        suspended_mass.update(pull + weight, length, H)


@pytest.mark.parametrize("length", [2.0, 50.0])
@pytest.mark.parametrize("mass", [8.0, 10.0, 12.0])
def test_the_mass_is_estimated_to_one_percent_under_swing_and_bounce(mass: float, length: float):
    suspended_mass = SuspendedMassEstimator(HANGING)
    assert suspended_mass.ratio == 1.0
    weigh(suspended_mass, mass, length, 14.0)
    assert suspended_mass.ratio == 1.0
    weigh(suspended_mass, mass, length, 60.0)
    assert suspended_mass.ratio == pytest.approx(mass / HANGING.rover_mass, rel=0.01)


def test_the_estimate_forgets_an_earlier_mass():
    suspended_mass = SuspendedMassEstimator(HANGING)
    weigh(suspended_mass, 8.0, 20.0, 100.0)
    weigh(suspended_mass, 12.0, 20.0, 100.0)
    assert suspended_mass.ratio == pytest.approx(1.2, rel=0.01)
    suspended_mass.restart()
    assert suspended_mass.ratio == 1.0


@pytest.mark.parametrize("mass", [0.0, 5.0, 20.0])
def test_an_implausible_mass_is_rejected(mass: float):
    suspended_mass = SuspendedMassEstimator(HANGING)
    weigh(suspended_mass, mass, 20.0, 60.0)
    assert suspended_mass.ratio == 1.0
