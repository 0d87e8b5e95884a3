"""A measured wheel on sand: identify the wheel-soil law, predict and compare."""
