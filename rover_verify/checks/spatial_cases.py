"""Simplified spatial plants for the checks: overrides of the scenario `free_hang`.

In `free_hang` the rover hangs without ground below it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from rover_sim import PlanarPlant, PlanarState, Scenario, SpatialPlant, SpatialState, load_spatial
from rover_sim.physics.rover import rep103
from rover_sim.physics.tether.ancf import Array

_NO_FRICTION = {"coulomb": 0.0, "breakaway": 0.0, "stribeck_rate": 1.0, "viscous": 0.0}
_NEGLIGIBLE = 1.0e-12  # where a scenario requires a value above 0 [kg m^2]

# Only the bodies rotate, and the slider has no end stops.
NO_ROTORS: dict[str, object] = {
    "rover.jump_drive.inertia": _NEGLIGIBLE,
    "rover.jump_drive.friction": _NO_FRICTION,
    "rover.jump_drive.free_travel": 2.0,
    "rover.wheel_drive.wheel_inertia": _NEGLIGIBLE,
    "rover.wheel_drive.motor_inertia": 0.0,
    "rover.wheel_drive.left_friction": _NO_FRICTION,
    "rover.wheel_drive.right_friction": _NO_FRICTION,
}
ENDLESS_SLIDER: dict[str, object] = {
    "rover.slider.friction": 0.0,
    "rover.slider.lower_stop": 100.0,
    "rover.slider.pad_stiffness": 1.0e-9,
    "rover.slider.nut_stiffness": 1.0e-9,
}

# A drum that follows its commands immediately and without losses.
IDEAL_WINCH: dict[str, object] = {
    "winch.efficiency": 1.0,
    "winch.back_efficiency": 1.0,
    "winch.friction": _NO_FRICTION,
    "winch.motor.max_torque": 2.0,
    "winch.motor.stall_torque": 1.0e3,
    "winch.motor.no_load_rate": 1.0e6,
    "winch.motor.servo_bandwidth": 200.0,
}


def make_plant(*parts: Mapping[str, object]) -> SpatialPlant:
    """The plant of `free_hang` with overrides; later ones take precedence."""
    overrides: dict[str, object] = {}
    for part in parts:
        overrides.update(part)
    return SpatialPlant(load_spatial("free_hang", overrides))


def without_winch(length: float, elements: int, **values: object) -> dict[str, object]:
    """Overrides for a pinned root and a tether with these values."""
    return {
        "winch": None,
        "tether": {"contact": None, "length": length, "elements": elements, **values},
    }


def spatial_twin(scenario: Scenario) -> SpatialPlant:
    """The spatial plant with only the tether and the rover of a planar jump."""
    rover, integration = scenario.rover, scenario.integration
    assert rover is not None
    section = scenario.tether.section
    a, b = rover.attachment
    # The planar model only has the moments of inertia about y, normal to its plane.
    return make_plant(
        NO_ROTORS,
        ENDLESS_SLIDER,
        without_winch(
            scenario.tether.length,
            scenario.tether.elements,
            axial_stiffness=section.axial_stiffness,
            bending_stiffness=section.bending_stiffness,
            line_density=section.line_density,
            axial_damping_time=section.axial_damping_time,
            bending_damping_time=section.bending_damping_time,
            buckling=False,
        ),
        {
            "environment.gravity": scenario.gravity,
            "rover.m1": rover.m1,
            "rover.m2": rover.m2,
            "rover.inertia1": [0.7 * rover.inertia1, rover.inertia1, 1.3 * rover.inertia1],
            "rover.inertia2": [rover.inertia2, rover.inertia2, 0.8 * rover.inertia2],
            "rover.attachment": [a, 0.0, b],
            "rover.slider.spring_rate": rover.spring_rate,
            "rover.slider.free_length": rover.spring_free_length,
            "rover.slider.damping": rover.slider_damping,
            "start": {"kind": "straight", "direction": [1.0, 0.0, 0.0]},
            "integration.h": integration.h,
            "integration.tolerance": integration.tolerance,
            "integration.numerical_damping": integration.numerical_damping,
        },
    )


def twin_state(plant: SpatialPlant, state: PlanarState, azimuth: float) -> SpatialState:
    """A planar state, placed in the vertical plane of an azimuth [rad]."""
    turn = Rotation.from_euler("z", azimuth)

    def placed(vectors: Array) -> Array:
        lifted = rep103.vector(vectors)
        return np.asarray(turn.apply(lifted.reshape(-1, 3)).reshape(lifted.shape))

    return plant.state_at(
        placed(state.nodes),
        placed(state.node_rates),
        orientation=(turn * Rotation.from_quat(rep103.quaternion(state.theta))).as_quat(),
        angular_velocity=rep103.rotation_rate(state.omega),
        slide=state.s,
    )


def taken_off(plant: PlanarPlant) -> PlanarState:
    """A planar jump at its take-off."""
    return plant.take_off(plant.initial_state())
