"""The ``mock_plant`` executable: replaces `sim_node` by a plant that follows commands exactly."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

from msg_schemas.parameters import parameter
from rover_sim.interface.mock_interface import MockInterface
from rover_sim.node.sim_loop import Simulation
from rover_sim.node.sim_node import RateParameters, SimNode, SimParameters
from rover_sim.node.state_publisher import simulation_from
from rover_sim.plants.mock_plant import MockPlant
from rover_sim.plants.saved_state import read_state
from rover_sim.scenarios.scenario import AnyScenario


@dataclass(frozen=True)
class MockPlantParameters(SimParameters):
    """Parameters of `sim_node`; sensors have no errors, so the seed has no effect."""

    scenario: str = parameter(
        "marius_hills",
        "-",
        "name of a spatial scenario of the package with a rover, or path of a .yaml file",
        read_only=True,
    )


class MockPlantNode(SimNode):
    """Has the topics and services of `sim_node`, without mechanics and without compilation."""

    NAME = "mock_plant"
    SIM_PARAMETERS = MockPlantParameters
    PARAMETERS = (SIM_PARAMETERS, RateParameters)

    def make_simulation(self, scenario: AnyScenario, parameters: SimParameters) -> Simulation[Any]:
        """Build the mock plant of the scenario and its simulation."""
        values = read_state(parameters.start_state, scenario) if parameters.start_state else None
        return simulation_from(MockInterface(MockPlant(scenario)), parameters.tick, values)


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(MockPlantNode)


if __name__ == "__main__":
    sys.exit(main())
