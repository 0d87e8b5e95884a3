"""Between plants and the contract: samples, events, drawings, the robot's description."""
