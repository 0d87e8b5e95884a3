"""The ``null_plant`` executable: in `sim_node`'s place, a plant that follows commands perfectly."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

from msg_schemas.node_process import run
from msg_schemas.parameters import parameter
from rover_sim.null_interface import NullInterface
from rover_sim.null_plant import NullPlant
from rover_sim.scenario import AnyScenario
from rover_sim.sim_loop import Simulation
from rover_sim.sim_node import RateParameters, SimNode, SimParameters


@dataclass(frozen=True)
class NullPlantParameters(SimParameters):
    """As those of `sim_node`; sensors have no errors, so the seed changes nothing."""

    scenario: str = parameter(
        "marius_hills",
        "-",
        "name of a spatial scenario of the package with a rover, or path of a .yaml file",
        read_only=True,
    )


class NullPlantNode(SimNode):
    """Tells and obeys what `sim_node` does, without mechanics and without compiling anything."""

    NAME = "null_plant"
    WANTED = NullPlantParameters
    PARAMETERS = (WANTED, RateParameters)

    def simulation_of(self, scenario: AnyScenario, wanted: SimParameters) -> Simulation[Any]:
        """The null plant with the scenario's machine."""
        return Simulation(NullInterface(NullPlant(scenario)), wanted.tick)


def main() -> int:
    """Run the node."""
    return run(NullPlantNode)


if __name__ == "__main__":
    sys.exit(main())
