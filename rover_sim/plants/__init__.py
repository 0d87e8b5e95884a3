"""Plants: the protocol, the planar, spatial and mock plants, and their runs."""
