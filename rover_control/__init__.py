"""The rover's controllers: they know the contract and the rover's sensors, never the simulator."""
