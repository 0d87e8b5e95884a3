"""Random places and machine parameters of missions."""

from __future__ import annotations

import numpy as np

from rover_sim import load_spatial
from rover_verify.checks.machine_off import machine_off

_MASS, _FRICTION, _SPRING = 0.1, 0.2, 0.05  # relative deviations from the nominal machine, at most


def shallow(rng: np.random.Generator, depth: float = 8.0) -> dict[str, object]:
    """Overrides of `floor_rubble`: the rover hangs at the stow over random rubble.

    Rubble, swing, attitude and machine parameters are random.
    """
    swing, plane, heading = rng.uniform(0.5, 3.0), *rng.uniform(0.0, 360.0, 2)
    tilt = rng.uniform(-1.0, 1.0, 2)
    return {
        "environment.seed": int(rng.integers(1, 2**31)),
        "environment.floor": {"height": -depth},
        "environment.patch": {"centre": [0.0, 0.0], "half_width": 6.0},
        "environment.boulders.clear_radius": 1.0,
        "tether.length": 2.0,
        "start": {
            "kind": "hanging",
            "swing_angle": float(swing),
            "swing_heading": float(plane),
            "heading": float(heading),
            "tilt": [float(tilt[0]), float(tilt[1]), 0.0],
        },
        **_machine(rng),
    }


def _machine(rng: np.random.Generator) -> dict[str, object]:
    mass = float(rng.uniform(1.0 - _MASS, 1.0 + _MASS))
    friction = float(rng.uniform(1.0 - _FRICTION, 1.0 + _FRICTION))
    spring = float(rng.uniform(1.0 - _SPRING, 1.0 + _SPRING))
    scenario = load_spatial("floor_rubble")
    assert scenario.rover is not None
    rate = scenario.rover.slider.spring_rate * spring
    return machine_off(scenario, mass, friction) | {"rover.slider.spring_rate": rate}
