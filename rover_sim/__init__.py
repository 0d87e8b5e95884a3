"""The plant: a tethered rover, simulated."""
