"""The descent's launch on the loop host, for a short while."""

from __future__ import annotations

import math

import numpy as np
import pytest

from msg_schemas import topics
from msg_schemas.phases import DescentPhase
from msg_schemas.refusal import RefusalCode
from rover_runtime.delays import Delays
from rover_verify.checks.hanging import damp, disturbed_error, look
from rover_verify.checks.hanging_delays import attitude_error
from rover_verify.checks.hanging_flight import HangingFlight, HangingStart, tilt_of
from rover_verify.checks.pointing import turn


def test_swing_and_tilt_are_found_on_the_plant_and_the_tilt_is_damped():
    flight = HangingFlight(
        HangingStart(10.0, 2.0, 1.0, plane=40.0, heading=120.0, tilt=(1.0, -1.0), seed=3)
    )
    flight.begin()
    flight.stop_at(10.0)
    flight.run(8.0 - flight.time)
    assert np.abs(np.degrees(tilt_of(flight.state))).max() < 0.25
    flight.run(17.0)
    true, ellipse = flight.true_swing(), flight.swing.ellipse
    assert ellipse.major == pytest.approx(true.major, abs=math.radians(0.1))
    assert ellipse.minor == pytest.approx(true.minor, abs=math.radians(0.1))
    # What the drives are asked for stays within their budgets.
    assert not flight.spent


def test_a_stop_is_reached_by_the_winch_s_own_controller():
    flight = HangingFlight(HangingStart(10.0, 0.2, seed=5))
    flight.run(0.2)
    flight.stop_at(12.0)
    flight.run(0.2)
    ((_, refusal),) = flight.refusals
    assert refusal.code is RefusalCode.NOT_ARMED
    flight.begin()
    flight.stop_at(11.0)
    settling = DescentPhase.SETTLING.value
    assert flight.run(30.0, lambda: flight.phases[topics.DESCENT_PHASE] == settling)
    tolerance = flight.descent.controller.parameters.profile.depth_tolerance
    assert flight.state.length == pytest.approx(11.0, abs=tolerance)
    assert len(flight.refusals) == 1


def test_the_swing_is_estimated_soon_after_an_impact_between_two_samples():
    assert math.degrees(disturbed_error(1, 0)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("index", [24, 49])  # 14 % heavier at 15 m, 18 % lighter at 30 m
def test_the_duration_of_a_turn_follows_mass_and_swing(index: int):
    flown = turn(3, index)
    assert flown.at_request is not None
    # Six flights took 0.93 to 1.17 of the prediction.
    assert flown.turning == pytest.approx(flown.at_request.turning, rel=0.2)


def test_a_disturbance_gives_its_swing_amplitude():
    flight = HangingFlight(HangingStart(20.0, 0.0))
    flight.disturb(math.radians(1.5), 0.7)
    assert math.degrees(flight.true_swing().major) == pytest.approx(1.5, rel=0.01)


def test_the_attitude_is_damped_with_late_messages():
    default = attitude_error(2.0, None)
    assert attitude_error(2.0, Delays(ticks=(3, 4, 5, 6, 7))) < 1.5 * default


@pytest.mark.parametrize("index", [4, 8])  # calm, at 15 m and 45 m
def test_a_calm_rover_takes_its_pictures_with_the_largest_yaw_bias(index: int):
    taken = look(1, index, 0.0)
    assert taken.is_taken
    assert not taken.swings
    assert taken.duration < 30.0
    assert abs(taken.error) < math.radians(0.04)


@pytest.mark.slow
@pytest.mark.parametrize("index", [2, 7])  # calm at 15 m, swinging at 45 m
def test_a_rover_on_a_wound_tether_takes_its_pictures(index: int):
    assert look(1, index, 2.0).is_taken


@pytest.mark.slow
def test_a_swing_is_not_given_up_for_a_momentum_from_before_it_was_known():
    assert damp(5, 3, 7.5) < 240.0
