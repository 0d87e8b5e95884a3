"""The ``mock_plant`` executable: in `sim_node`'s place, a plant that follows commands perfectly."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from rover_sim.mock_interface import MockInterface
from rover_sim.mock_plant import MockPlant
from rover_sim.scenario import AnyScenario
from rover_sim.sim_loop import Simulation
from rover_sim.sim_node import RateParameters, SimNode, SimParameters


@dataclass(frozen=True)
class MockPlantParameters(SimParameters):
    """As those of `sim_node`; sensors have no errors, so the seed changes nothing."""

    scenario: str = parameter(
        "marius_hills",
        "-",
        "name of a spatial scenario of the package with a rover, or path of a .yaml file",
        read_only=True,
    )


class MockPlantNode(SimNode):
    """Tells and obeys what `sim_node` does, without mechanics and without compiling anything."""

    NAME = "mock_plant"
    SIM_PARAMETERS = MockPlantParameters
    PARAMETERS = (SIM_PARAMETERS, RateParameters)

    def make_simulation(self, scenario: AnyScenario, parameters: SimParameters) -> Simulation[Any]:
        """The mock plant with the scenario's machine."""
        return Simulation(MockInterface(MockPlant(scenario)), parameters.tick)


def main() -> int:
    """Run the node."""
    return run(MockPlantNode)


if __name__ == "__main__":
    sys.exit(main())
