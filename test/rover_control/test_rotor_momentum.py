"""Momentum of a rotor at the time of another sensor's sample."""

from __future__ import annotations

import pytest

from rover_control.hanging.rotor_momentum import RotorMomentum


def test_a_momentum_is_interpolated_between_its_samples():
    momentum = RotorMomentum()
    assert momentum.at(5) == 0.0
    momentum.add(10, 1.0)
    momentum.add(20, 3.0)
    assert momentum.at(15) == pytest.approx(2.0)
    assert momentum.at(20) == 3.0


def test_outside_its_samples_a_momentum_is_the_nearest():
    momentum = RotorMomentum()
    momentum.add(10, 1.0)
    momentum.add(20, 3.0)
    assert momentum.at(2) == 1.0
    assert momentum.at(90) == 3.0


def test_a_sample_older_than_the_newest_is_dropped():
    momentum = RotorMomentum()
    momentum.add(20, 3.0)
    momentum.add(10, 1.0)
    assert (momentum.newest_ns, momentum.newest) == (20, 3.0)
