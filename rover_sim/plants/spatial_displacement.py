"""Displacements of a hanging start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

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
    return plant.state_at(
        nodes,
        rates,
        orientation=(*turned[1:], turned[0]),
        angular_velocity=spin + np.array(by.body_rate),
        slide=state.s,
        twist=state.twist + by.twist,
    )
