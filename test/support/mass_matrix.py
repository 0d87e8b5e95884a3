"""The mass matrix of a cable's element, in closed form."""

import numpy as np

from rover_sim.physics.tether.ancf import Array


def mass_matrix(line_density: float, length: float) -> Array:
    """M [kg, kg m, kg m2] = int rhoA S^T S dx, (4, 4); each entry acts on all directions alike."""
    l1, l2 = length, length**2
    return (line_density * length / 420.0) * np.array(
        [
            [156.0, 22.0 * l1, 54.0, -13.0 * l1],
            [22.0 * l1, 4.0 * l2, 13.0 * l1, -3.0 * l2],
            [54.0, 13.0 * l1, 156.0, -22.0 * l1],
            [-13.0 * l1, -3.0 * l2, -22.0 * l1, 4.0 * l2],
        ]
    )
