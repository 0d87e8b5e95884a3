"""Random places of missions, and machines that are off what their controllers take them for."""

from __future__ import annotations

import numpy as np

from rover_sim import SpatialScenario, load_spatial

_MASS, _FRICTION, _SPRING = 0.1, 0.2, 0.05  # relative deviations from the nominal machine, at most


def shallow(rng: np.random.Generator, depth: float = 8.0) -> dict[str, object]:
    """Overrides of `floor_rubble`: the rover hangs at the stow over random rubble.

    Rubble, swing, attitude and machine parameters are random.
    """
    swing, plane, heading = rng.uniform(0.5, 3.0), *rng.uniform(0.0, 360.0, 2)
    tilt = rng.uniform(-1.0, 1.0, 2)
    ground = int(rng.integers(1, 2**31))
    mass, friction, spring = (
        float(rng.uniform(1.0 - off, 1.0 + off)) for off in (_MASS, _FRICTION, _SPRING)
    )
    scenario = load_spatial("floor_rubble")
    assert scenario.rover is not None
    return {
        "environment.seed": ground,
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
        **machine_off(scenario, mass, friction),
        "rover.slider.spring_rate": scenario.rover.slider.spring_rate * spring,
    }


def machine_off(scenario: SpatialScenario, mass: float, friction: float) -> dict[str, object]:
    """Overrides of a scenario with a rover and a winch.

    Args:
        scenario: as it is known.
        mass: of both bodies, and their inertia, over what is known.
        friction: of all drives over the same.
    """
    rover, winch = scenario.rover, scenario.winch
    assert rover is not None
    assert winch is not None
    changed: dict[str, object] = {
        "rover.m1": rover.m1 * mass,
        "rover.m2": rover.m2 * mass,
        "rover.inertia1": [mass * each for each in rover.inertia1],
        "rover.inertia2": [mass * each for each in rover.inertia2],
    }
    frictions = {
        "winch.friction": winch.friction,
        "rover.jump_drive.friction": rover.jump_drive.friction,
        "rover.wheel_drive.left_friction": rover.wheel_drive.left_friction,
        "rover.wheel_drive.right_friction": rover.wheel_drive.right_friction,
    }
    for name, values in frictions.items():
        for part in ("coulomb", "breakaway", "viscous"):
            changed[f"{name}.{part}"] = getattr(values, part) * friction
    return changed
