"""Turn about the tether, and the twist that the swivel holds."""

from __future__ import annotations

import math

import pytest

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.tether_turn import TetherTurn

HANGING = HangingParameters()


def test_the_twist_is_the_turn_until_the_swivel_slips():
    turn = TetherTurn(HANGING)
    most = HANGING.swivel_friction / HANGING.torsional_stiffness(2.0)
    turn.add(0.9 * most, 2.0)
    assert turn.angle == turn.twist == pytest.approx(0.9 * most)
    turn.add(0.3 * most, 2.0)
    assert (turn.angle, turn.twist) == pytest.approx((1.2 * most, most))
    # It turns back with the rover at once.
    turn.add(-most, 2.0)
    assert (turn.angle, turn.twist) == pytest.approx((0.2 * most, 0.0))


def test_a_wound_tether_slips_when_it_gets_short():
    turn = TetherTurn(HANGING)
    turn.add(30.0, 48.0)
    assert turn.twist == 30.0
    turn.add(0.0, 2.0)
    assert turn.twist == pytest.approx(20.0)
    assert turn.angle == 30.0


@pytest.mark.parametrize("length", [2.0, math.nan])
def test_a_tether_without_torsion_or_of_unknown_length_does_not_slip(length: float):
    hanging = HANGING if math.isnan(length) else HangingParameters(twist_stiffness=0.0)
    turn = TetherTurn(hanging)
    turn.add(-100.0, length)
    assert turn.angle == turn.twist == -100.0
