"""Air about the tether of a scenario: drag, its energy, and wind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rover_sim import Energies, PlantCommand, SpatialState, build_plant, load_spatial

AIR = {"diameter": 0.01, "density": 1.2}


def swung(
    air: dict[str, Any] | None, duration: float, **changes: Any
) -> tuple[SpatialState, Energies]:
    """State and energies of the pendulum after a duration."""
    plant = build_plant(load_spatial("spatial_pendulum", {"environment.air": air, **changes}))
    state = plant.initial_state()
    result = None
    for _ in range(round(duration / 0.02)):
        state, result = plant.step(state, PlantCommand(), 0.02)
    assert result is not None
    return state, result.energies


def test_drag_takes_energy_and_the_balance_holds():
    state, energies = swung(AIR, 1.0)
    vacuum, _ = swung(None, 1.0)
    heat = state.energy_balance["heat_air"]
    assert heat > 0.1
    assert energies.dissipated == pytest.approx(heat, rel=1e-6)
    assert abs(energies.drift) < 1e-4 * heat
    assert vacuum.energy_balance["heat_air"] == 0.0
    assert np.linalg.norm(state.nodes[-1, 0] - vacuum.nodes[-1, 0]) > 0.05


@pytest.mark.parametrize(("wind", "heading"), [(2.0, 0.5), (3.0, 0.0), (5.0, -2.5)])
def test_a_tether_in_the_wind_rests_where_drag_balances_weight(
    wind: float, heading: float, record_property: Callable[[str, object], None]
):
    """Each metre leans so that the cross-flow drag balances the weight across it."""
    weight = 1.0e4 * np.pi * 3.45e-4**2 * 9.81
    drag = 0.5 * 1.2 * 0.01 * 1.1 * wind**2
    angles = np.linspace(0.0, 1.57, 20000)  # weight sin a = drag cos^2 a
    angle = angles[np.argmin(np.abs(weight * np.sin(angles) - drag * np.cos(angles) ** 2))]
    across = np.array([np.cos(heading), np.sin(heading), 0.0])
    direction = (np.sin(angle) * across - [0.0, 0.0, np.cos(angle)]).tolist()
    changes = {"start.direction": direction, "tether.axial_damping_time": 0.01}
    moved = {}
    for speed in (wind, 0.0):
        air = {**AIR, "wind": (speed * across).tolist()}
        state, energies = swung(air, 0.5, **changes)
        moved[speed] = float(np.linalg.norm(state.nodes[-1, 0] - 5.0 * np.array(direction)))
        assert abs(energies.drift) < 1e-4
    record_property("error", moved[wind] / 5.0)
    assert moved[wind] < 0.01
    assert moved[0.0] > 0.1
