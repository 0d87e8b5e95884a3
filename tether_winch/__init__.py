"""The mother machine's winch: it knows the contract and its own sensors, never the simulator."""
