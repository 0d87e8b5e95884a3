"""Which plant a scenario asks for."""

from rover_sim.planar_plant import PlanarPlant
from rover_sim.scenario import Scenario


def build_plant(scenario: Scenario) -> PlanarPlant:
    """The plant that the scenario's `model` names."""
    return PlanarPlant(scenario)
