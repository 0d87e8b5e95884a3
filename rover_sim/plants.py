"""Which plant a scenario asks for."""

from rover_sim.planar_plant import PlanarPlant
from rover_sim.scenario import AnyScenario


def build_plant(scenario: AnyScenario) -> PlanarPlant:
    """The plant that the scenario's `model` names."""
    return PlanarPlant(scenario)
