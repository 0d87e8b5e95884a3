"""Variations of a scenario's start: a displaced hanging rover, a compressed jump spring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from rover_sim.physics.integrators import integrator_memory
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.rover import spatial_rover
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.plants.spatial_start import product, quaternion_of
from rover_sim.plants.spatial_state import SpatialState, rotation_matrix
from rover_sim.scenarios.scenario_parts import ScenarioError

Pair: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class Displacement:
    """Displacement of a hanging start from the scenario's.

    Attributes:
        swing: rotation vector of tether and rover about the fairlead, x and y of map [rad].
        swing_rate: of that rotation [rad/s].
        tilt: additional rotation vector of the rover, x and y of base_link [rad].
        body_rate: additional angular velocity of the rover in base_link [rad/s].
        twist: additional twist of the tether [rad].
    """

    swing: Pair = (0.0, 0.0)
    swing_rate: Pair = (0.0, 0.0)
    tilt: Pair = (0.0, 0.0)
    body_rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    twist: float = 0.0


def displaced(plant: SpatialPlant, by: Displacement) -> SpatialState:
    """Return the scenario's start, displaced, with the stretch and slide of the equilibrium.

    Raises:
        ScenarioError: the start is not hanging with the winch at rest.
    """
    start = plant.scenario.start
    if start.kind != "hanging":
        raise ScenarioError("start.kind", start.kind, "should be hanging to be displaced")
    if start.payout_rate != 0.0:
        raise ScenarioError("start.payout_rate", start.payout_rate, "should be 0 to be displaced")
    state = plant.initial_state()
    turn = quaternion_of((*by.swing, 0.0))
    matrix = rotation_matrix(turn)
    rate = np.array([*by.swing_rate, 0.0])
    nodes = plant.to_full_nodes(state) @ matrix.T
    rates = state.node_rates @ matrix.T
    if len(rates) < len(nodes):
        fairlead_slope = np.array([[np.zeros(3), matrix @ state.fairlead_slope[1]]])
        rates = np.concatenate([fairlead_slope, rates])
    rates = rates + np.cross(rate, nodes)
    x, y, z, w = state.orientation
    tilt = quaternion_of((*by.tilt, 0.0))
    turned = product(product(turn, np.array([w, x, y, z])), tilt)
    spin = rotation_matrix(tilt).T @ state.omega + rotation_matrix(turned).T @ rate
    after = plant.state_at(
        nodes,
        rates,
        orientation=(*turned[1:], turned[0]),
        angular_velocity=spin + np.array(by.body_rate),
        slide=state.s,
    )
    memory = after.memory.copy()
    memory[integrator_memory.SWIVEL_SLIP] -= state.twist + by.twist
    return after.replaced(memory=memory)


def compressed(
    plant: SpatialPlant, state: SpatialState, stroke: float, tilt: Pair = (0.0, 0.0)
) -> SpatialState:
    """Return a state at rest with the spring compressed, held by the latch, and the rover tilted.

    The clock and the energy balance do not change: they do not account for the spring's energy.

    Args:
        plant: of the state.
        state: with the rover at rest.
        stroke: compression of the spring [m]; a value above the drive's stroke represents a spring
            stiffer than the scenario's.
        tilt: rotation vector of the rover, x and y of base_link [rad].

    Raises:
        ScenarioError: the scenario has no rover.
        ValueError: the stroke is not above 0 or not below the slider's lower stop.
    """
    rover = plant.scenario.rover
    if rover is None:
        raise ScenarioError("rover", None, "should be there to jump")
    slider = rover.slider
    if not 0.0 < stroke < slider.lower_stop:
        raise ValueError(
            f"stroke = {stroke!r} m: must be above 0 and below the slider's lower stop at "
            f"{slider.lower_stop:g} m"
        )
    body, nodes = state.body.copy(), state.nodes.copy()
    quaternion = slice(spatial_rover.ORIENTATION, spatial_rover.ORIENTATION + 4)
    turned = product(body[quaternion], quaternion_of((*tilt, 0.0)))
    body[quaternion] = turned
    body[spatial_rover.SLIDE] = slider.free_length - stroke
    nodes[-1, 0] = state.G1 + rotation_matrix(turned) @ np.array(rover.attachment)
    # The nut yields elastically to the spring's force.
    nut = stroke * (1.0 + slider.spring_rate / slider.nut_stiffness)
    jump = state.drives.jump._replace(latch=int(Latch.ENGAGED), nut=nut, rate=0.0)
    return state.replaced(body=body, nodes=nodes, drives=state.drives._replace(jump=jump))
