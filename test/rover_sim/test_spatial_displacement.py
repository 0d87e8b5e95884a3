"""Displaced starts, compared with those of a scenario."""

import math

import numpy as np
import pytest

from rover_sim import Displacement, ScenarioError, SpatialPlant, displaced, load_spatial

HANG = load_spatial("free_hang")


def test_a_displaced_start_equals_that_of_a_scenario():
    angle, rate, tilt = 1.5, 0.7, [2.0, -1.0, 0.0]
    configured = SpatialPlant(
        HANG.with_overrides(
            {
                "start.swing_angle": angle,
                "start.swing_rate": rate,
                "start.tilt": tilt,
                "start.body_rate": [1.0, 2.0, 6.0],
                "start.twist": 20.0,
            }
        )
    ).initial_state()
    found = displaced(
        SpatialPlant(HANG.with_overrides({"start.body_rate": [0.0, 0.0, 6.0]})),
        Displacement(
            swing=(0.0, -math.radians(angle)),
            swing_rate=(0.0, -math.radians(rate)),
            tilt=(math.radians(tilt[0]), math.radians(tilt[1])),
            # A rotation about z before the tilt equals one after it, except for the tilt's angle.
            body_rate=(math.radians(1.0), math.radians(2.0), 0.0),
            twist=math.radians(20.0),
        ),
    )
    # Second order: the load along a swung tether decreases by its cosine, increases by the motion.
    assert found.nodes == pytest.approx(configured.nodes, abs=5e-5)
    assert found.node_rates == pytest.approx(configured.node_rates, abs=2e-5)
    assert found.fairlead_slope == pytest.approx(configured.fairlead_slope, abs=2e-5)
    assert found.orientation == pytest.approx(configured.orientation, abs=2e-5)
    # The configured push of 6 deg/s about z, seen from axes that are tilted by up to 2 degrees.
    assert found.omega == pytest.approx(configured.omega, abs=math.radians(6.0) * math.radians(2.3))
    assert found.s == pytest.approx(configured.s, abs=1e-5)
    assert found.twist == pytest.approx(configured.twist, abs=1e-12)


def test_no_displacement_is_the_start_itself():
    plant = SpatialPlant(HANG)
    start, found = plant.initial_state(), displaced(plant, Displacement())
    assert np.array_equal(found.nodes, start.nodes)
    assert found.omega == pytest.approx(start.omega, abs=1e-15)
    assert found.twist == pytest.approx(start.twist, abs=1e-12)


def test_a_start_that_does_not_hang_at_rest_is_refused():
    with pytest.raises(ScenarioError, match="hanging"):
        displaced(SpatialPlant(load_spatial("floor_rubble")), Displacement())
    paying_out = HANG.with_overrides({"start.payout_rate": 0.1})
    with pytest.raises(ScenarioError, match="payout_rate"):
        displaced(SpatialPlant(paying_out), Displacement())
