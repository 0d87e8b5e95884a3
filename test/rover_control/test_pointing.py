"""Turning by coning: what is foretold against its own model's motion, and what is refused."""

from __future__ import annotations

import math

import pytest

from msg_schemas.refusal import Refusal
from rover_control.hanging_rover import HangingParameters
from rover_control.pointing import Pointing, PointingParameters

HANGING, POINTING = HangingParameters(), PointingParameters()
RIGHT = 0.5 * math.pi
H = 0.05


def make() -> Pointing:
    return Pointing(POINTING, HANGING)


def test_from_no_twist_the_turn_is_that_of_the_closed_form():
    pointing = make()
    torsion = math.sqrt(HANGING.torsion(15.0) / HANGING.inertia_about_z)
    rate = pointing.largest_rate
    foretold = pointing.foretell(RIGHT, 0.0, 15.0)
    assert foretold.turning == pytest.approx(math.asin(RIGHT * torsion / rate) / torsion, abs=2.0)
    assert foretold.limit == "twist"
    # On a rope of any length that does not twist it takes its time, and is held for ever.
    loose = Pointing(POINTING, HangingParameters(twist_stiffness=0.0))
    free = loose.foretell(RIGHT, 0.0, 15.0)
    assert free.turning == pytest.approx(RIGHT / rate, abs=2.0)
    assert free.holding == math.inf


def test_a_twist_that_helps_makes_it_easier_and_a_bias_limits_the_holding():
    pointing = make()
    plain = pointing.foretell(RIGHT, 0.0, 20.0)
    helped = pointing.foretell(RIGHT, -0.5 * RIGHT, 20.0)
    assert helped.turning < plain.turning
    assert helped.holding > plain.holding
    biased = pointing.foretell(RIGHT, 0.0, 20.0, yaw_error=1e-3)
    assert biased.limit == "gyro bias"
    assert biased.holding == pytest.approx(POINTING.tolerance / 1e-3)


@pytest.mark.parametrize("turn", [RIGHT, -RIGHT])
def test_a_right_angle_is_promised_at_15_m_and_deeper_and_refused_at_5_m_with_the_reason(
    turn: float,
):
    for length in (15.0, 30.0, 45.0):
        pointing = make()
        foretold = pointing.request(turn, 0.3, length, yaw_error=1e-4, twist=0.0)
        assert foretold.turning < POINTING.longest_turn
        assert foretold.holding > POINTING.least_hold
        assert pointing.is_active
    pointing = make()
    with pytest.raises(Refusal, match=r"90 deg are not reached .* 5 m of tether: its twist"):
        pointing.request(turn, 0.3, 5.0, yaw_error=1e-4, twist=0.0)
    assert not pointing.is_active
    with pytest.raises(Refusal, match="limited by gyro bias"):
        pointing.request(turn, 0.3, 30.0, yaw_error=0.01, twist=0.0)
    with pytest.raises(Refusal, match="half a turn"):
        pointing.request(math.nan, 0.3, 30.0, yaw_error=0.0, twist=0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("heavier", [0.85, 1.0, 1.15])
def test_on_its_own_model_it_turns_and_holds_as_foretold(sign: float, heavier: float):
    pointing = make()
    length, inertia = 15.0, heavier * HANGING.inertia_about_z
    pointing.request(sign * RIGHT, 0.0, length, yaw_error=0.0, twist=0.0)
    heading = spin = time = 0.0
    reached = lost = None
    while lost is None:
        pointing.step(heading, heading, length, H)
        coned = pointing.coning_rate / heavier**2
        spin -= H * HANGING.torsion(length) * heading / inertia
        heading += H * (coned + spin)
        time += H
        told = pointing.take_reached()
        if told is not None:
            reached, foretold = time, told
        if reached is not None and abs(heading - sign * RIGHT) > 1.01 * POINTING.tolerance:
            lost = time
        assert time < 1000.0
    assert reached is not None
    assert reached < POINTING.longest_turn
    assert lost - reached == pytest.approx(foretold.holding, rel=0.15)


def test_the_rotors_stay_within_their_bound_and_run_out_softly():
    pointing = make()
    pointing.request(RIGHT, 0.0, 30.0, yaw_error=0.0, twist=0.0)
    last = pointing.step(0.0, 0.0, 30.0, H)
    for k in range(2000):
        if k == 1000:
            pointing.stop()
        now = pointing.step(0.0, 0.0, 30.0, H)
        assert math.hypot(now.x, now.y) <= POINTING.coning_momentum + 1e-9
        # By its frequency, and the ramp's root from rest.
        assert abs(now.x - last.x) < 0.012
        last = now
    assert (now.x, now.y) == (0.0, 0.0)
    assert not pointing.is_coning
