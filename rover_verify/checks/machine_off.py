"""The machine as it truly is, where it is off what its controllers take it for."""

from __future__ import annotations

from rover_sim import SpatialScenario


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
