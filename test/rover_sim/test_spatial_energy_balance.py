"""The spatial plant's energy balance with drives on the ground."""

from __future__ import annotations

import pytest

from rover_sim import Command, SpatialPlant, WheelRateCommand, load_spatial

BARE_ROCK = {
    "environment.relief": None,
    "environment.boulders": None,
    "environment.floor": {"height": -4.0, "material": "rock"},
    "start.position": [1.5, 0.0],
    "tether.length": 8.0,
}


@pytest.mark.parametrize("rate", [3.0, -3.0])  # straight ahead, and turning
def test_driving_and_braking_on_rock_conserve_energy(rate: float):
    plant = SpatialPlant(load_spatial("floor_rubble", BARE_ROCK))
    state = plant.initial_state()
    state, _ = plant.step(state, Command(wheel=WheelRateCommand(rate)), 1.0)
    state, result = plant.step(state, Command(wheel=WheelRateCommand(0.0)), 1.0)
    given = state.energy_balance["input_wheel_motor"]
    assert given > 1.0
    assert abs(result.energies.drift) < 2e-3 * given
