"""The drum model agrees with the simulated drum and with itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_schemas.parameters import ParameterError
from rover_sim.physics.mechanisms import drum as plant
from tether_winch.drum_model import DrumModel, DrumModelParameters
from tether_winch.thermal import MotorThermalModel

LAYERED = DrumModelParameters(layer_pitch=1.5e-3, turns_per_layer=20.0)


def test_radius_and_turns_per_layer_match_the_simulated_drum():
    ours = DrumModel(LAYERED)
    parameters = plant.DrumParameters(layer_pitch=1.5e-3, turns_per_layer=20.0)
    theirs = plant.make_drum(parameters, 60.0)
    for length in np.linspace(0.0, 60.0, 121):
        state = plant.initial_state(theirs, float(length))
        turns = theirs.full_turns - state.angle / (2.0 * math.pi)
        assert ours.radius(float(length)) == pytest.approx(plant.radius_at(theirs, turns), rel=1e-9)
        wound = LAYERED.tether_on_drum - float(length)
        assert ours._turns_wound(wound) == pytest.approx(turns, abs=1e-9)


def test_a_fuller_drum_has_a_larger_radius():
    drum = DrumModel(LAYERED)
    assert drum.radius(0.0) > drum.radius(30.0) > drum.radius(59.9) >= 0.05


@settings(deadline=None)
@given(
    st.floats(0.0, 100.0),
    st.floats(1.0, 59.0),
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
)
def test_motor_and_tether_tension_are_inverse_functions(
    tension: float, length: float, rate: float, acceleration: float
):
    drum = DrumModel(DrumModelParameters())
    motor = drum.motor_tension(tension, length, rate, acceleration)
    assert drum.tether_tension(motor, length, rate, acceleration) == pytest.approx(
        tension, abs=1e-9
    )


def test_lifting_takes_more_than_holding_and_lowering_less():
    drum = DrumModel(DrumModelParameters())
    lifting, holding, lowering = (
        drum.motor_tension(16.2, 20.0, rate, 0.0) for rate in (-0.3, 0.0, 0.3)
    )
    # (16.2 + 0.05/0.05 + 0.005 * 6/0.05)/0.85, and (16.2 - 1.6) * 0.82.
    assert lifting == pytest.approx((16.2 + 1.0 + 0.6) / 0.85, rel=1e-6)
    assert holding == 16.2
    assert lowering == pytest.approx((16.2 - 1.6) * 0.82, rel=1e-6)


def test_a_tether_stretches_by_its_load_and_half_its_own_weight():
    drum = DrumModel(DrumModelParameters())
    top = 16.2 + drum.hanging_weight(45.0)
    stretch = drum.stretched(45.0, top) - 45.0
    assert drum.hanging_weight(45.0) == pytest.approx(0.3645)
    assert stretch == pytest.approx((16.2 + 0.5 * 0.3645) * 45.0 / 2e4)
    assert 0.03 < stretch < 0.05  # centimetres


def test_the_largest_rate_falls_under_load():
    drum = DrumModel(DrumModelParameters())
    free, loaded = drum.largest_rate(20.0, 0.0), drum.largest_rate(20.0, 100.0)
    assert free == pytest.approx(600.0 / 50.0 * 0.05)
    # 100 N are 0.1 N m at the shaft, 0.118 of the stall torque's 0.6 behind the gear.
    assert loaded == pytest.approx(free * (1.0 - 0.1 / 0.85 / 0.6))


def test_a_continuous_torque_above_the_peak_is_refused():
    with pytest.raises(ParameterError, match="must not be above motor_torque"):
        DrumModelParameters(motor_torque=0.1, motor_continuous_torque=0.2)


# ----------------------------------------------------------------------------------------- heat


def test_the_continuous_torque_is_never_derated_and_twice_as_much_is():
    heat = MotorThermalModel(0.08, 0.2, 60.0)
    for _ in range(100_000):
        heat.step(0.08, 0.01)
    assert heat.heat == pytest.approx(1.0, abs=1e-6)
    assert heat.allowed == pytest.approx(0.08, abs=1e-6)


def test_a_motor_at_the_allowed_torque_never_overheats():
    heat = MotorThermalModel(0.08, 0.2, 60.0)
    allowed = 0.2
    for _ in range(60_000):
        allowed = heat.step(allowed, 0.01)
        assert heat.heat <= 1.0
    assert allowed == pytest.approx(0.08, rel=1e-2)


def test_heat_follows_the_closed_form_and_decays():
    heat = MotorThermalModel(0.08, 0.2, 60.0)
    for _ in range(3000):
        heat.step(0.16, 0.01)
    assert heat.heat == pytest.approx(4.0 * (1.0 - math.exp(-0.5)), rel=1e-9)
    for _ in range(6000):
        heat.step(0.0, 0.01)
    assert heat.heat == pytest.approx(4.0 * (1.0 - math.exp(-0.5)) * math.exp(-1.0), rel=1e-9)
