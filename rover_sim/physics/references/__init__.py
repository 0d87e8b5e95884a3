"""Independent formulations of the same physics, for comparison."""
