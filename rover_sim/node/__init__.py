"""The nodes of the simulator: loop, pause, reset, and publication."""
