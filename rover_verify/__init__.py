"""How the suite is held to its requirements: verification matrix, speed bench and demonstration."""
