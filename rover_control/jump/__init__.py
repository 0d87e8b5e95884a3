"""The jump: sensors, sequence and its node."""
