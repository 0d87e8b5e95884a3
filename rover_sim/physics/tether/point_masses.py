"""Point masses on the tether, for example markers: consistent with its interpolation."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import dot
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import Workspace
from rover_sim.physics.tether.node_blocks import hermite_weights, interpolated, subtract_force
from rover_sim.physics.tether.tether import Tether


class PointMasses(NamedTuple):
    """Masses at points of the tether, (k,) each."""

    element: NDArray[np.int64]  # number of the element
    xi: Array  # place in it, 0 to 1
    mass: Array  # [kg]


@inner
def add_point_masses(
    masses: PointMasses, tether: Tether, h: float, v0: Array, work: Workspace
) -> None:
    """Add inertia and weight at the increment in `work` to the elements' residual and tangent."""
    for k in range(masses.mass.size):
        e, mass = masses.element[k], masses.mass[k]
        weights = hermite_weights(masses.xi[k], tether.element_length)
        u = interpolated(weights, work.increment, e)
        v = interpolated(weights, v0, e)
        g = tether.gravity
        rate = -2.0 * mass / h
        force = (
            rate * (u[0] / h - v[0]) + mass * g[0],
            rate * (u[1] / h - v[1]) + mass * g[1],
            rate * (u[2] / h - v[2]) + mass * g[2],
        )
        slope = rate / h
        subtract_force(weights, e, force, (slope, 0.0, 0.0, slope, 0.0, slope), work.blocks)


@inner
def point_mass_energies(
    masses: PointMasses, tether: Tether, q: Array, v: Array
) -> tuple[float, float]:
    """Kinetic and gravity energy [J]."""
    kinetic, gravity = 0.0, 0.0
    for k in range(masses.mass.size):
        weights = hermite_weights(masses.xi[k], tether.element_length)
        rate = interpolated(weights, v, masses.element[k])
        place = interpolated(weights, q, masses.element[k])
        g = tether.gravity
        kinetic += 0.5 * masses.mass[k] * dot(rate, rate)
        gravity -= masses.mass[k] * dot((g[0], g[1], g[2]), place)
    return kinetic, gravity
