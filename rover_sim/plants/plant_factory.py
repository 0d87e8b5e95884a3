"""Build the plant of a scenario."""

from __future__ import annotations

from typing import overload

from rover_sim.plants.planar_plant import PlanarPlant
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.scenarios.scenario import AnyScenario, Scenario, SpatialScenario


@overload
def build_plant(scenario: Scenario) -> PlanarPlant: ...


@overload
def build_plant(scenario: SpatialScenario) -> SpatialPlant: ...


def build_plant(scenario: AnyScenario) -> PlanarPlant | SpatialPlant:
    """Build the plant that the scenario's `model` names."""
    if isinstance(scenario, SpatialScenario):
        return SpatialPlant(scenario)
    return PlanarPlant(scenario)
