"""The search for the touchdown's instant ends, and each touchdown is found once."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from msg_schemas.events import PlantEvent
from rover_sim import PlantCommand, build_plant, load_planar
from rover_sim.physics.integrators import planar
from rover_sim.physics.rover.planar_rover import BODY_SIZE, VY1, Y1

STEP = 4e-3
MOST_TRIES = 20


def tries_until_found(
    after: Callable[[float], tuple[float, float]], accuracy: float = 1e-12
) -> tuple[int, float]:
    """Search for level 0 from 1 mm above it, falling at 1 m/s; returns tries and the length."""
    solver = planar.make_solver(1)
    body = np.zeros(BODY_SIZE)
    body[Y1], body[VY1] = 1e-3, -1.0
    length = STEP
    for tries in range(MOST_TRIES):
        solver.body1[Y1], solver.body1[VY1] = after(length)
        if planar._locate_touchdown(length, 0.0, accuracy, body, solver.body1, solver.search):
            return tries, length
        length = solver.search[planar._LENGTH]
    raise AssertionError(f"not found in {MOST_TRIES} tries")


def test_a_smooth_fall_is_found_in_a_few_tries():
    tries, length = tries_until_found(lambda h: (1e-3 - h - 40.0 * h**2, -1.0 - 80.0 * h))
    assert tries <= 5
    assert 1e-3 - length - 40.0 * length**2 == pytest.approx(0.0, abs=1e-12)


def test_the_search_ends_if_the_height_never_reaches_the_accuracy():
    """Newton's iteration ends within its tolerance, so the height as a function has jumps."""
    tries, length = tries_until_found(lambda h: (1e-3 - h + math.copysign(1e-9, 1e-3 - h), -1.0))
    assert tries <= 12
    assert length == pytest.approx(1e-3, abs=1e-7)


@pytest.mark.parametrize("tick", [0.004, 0.01, 0.02, 0.6])
@pytest.mark.parametrize("name", ["paper_table1_high", "paper_table2_case1", "paper_table2_case2"])
def test_a_rover_that_flies_on_touches_down_once_with_few_iterations(name: str, tick: float):
    changes = {
        "start.geometry": "+K",
        "start.slack": 2.0,
        "tether.elements": 20,
        "integration.h": STEP,
        "after_landing": "fly_on",
    }
    plant = build_plant(load_planar(name, changes))
    state = plant.take_off(plant.initial_state())
    touchdowns = []
    while state.time < 0.6 - 1e-9:
        state, result = plant.step(state, PlantCommand(), tick)
        touchdowns += [event for event in result.events if event.name == PlantEvent.TOUCHDOWN]
        # A second touchdown at the same place would end a step of the length of rounding errors.
        assert result.smallest_step > 1e-9
        # For each step of 4 ms, its halves and the search included.
        assert result.newton_iterations <= 250 * max(1.0, tick / STEP)
    assert len(touchdowns) == 1
