"""Plant, winch and pilot in one process."""

import sys

from pilot_node import Pilot

from rover_runtime.ros.process import run
from rover_sim.node.mock_plant_node import MockPlantNode
from tether_winch.winch_node import WinchNode

if __name__ == "__main__":
    sys.exit(run(MockPlantNode, WinchNode, Pilot))
