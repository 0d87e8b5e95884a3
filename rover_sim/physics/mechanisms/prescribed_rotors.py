"""Rotors of Body 1 whose angular momentum is prescribed over time, such as gyroscopes and fans.

Only their absolute axial momentum h(t) counts, in body axes. It is part of the rover's angular
momentum: a rotor at constant momentum acts on the rover with the gyroscopic torque -w x h, one that
is driven with -h' besides (Hughes 1986, Spacecraft Attitude Dynamics, chapter 6). The drive's work
on the rover in a step of length dt is exactly -(h1 - h0).th/dt with the Cayley vector th, as th/dt
is the mean angular velocity (`spatial_rover`). The rotors' own energy is not part of the plant.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.time_table import row_at
from rover_sim.physics.numerics.vectors import Vector
from rover_sim.physics.tether.ancf import Array


class PrescribedRotors(NamedTuple):
    """Sum of the rotors' momenta, linear between the rows of a table and constant beyond it."""

    times: Array  # [s], increasing, (rows,), at least one
    momenta: Array  # in base_link [N m s], (rows, 3)


def make_rotors(axes: Array, times: list[Array], momenta: list[Array]) -> PrescribedRotors:
    """Add up the momenta of several rotors.

    Args:
        axes: unit vectors in base_link, (rotors, 3).
        times: of the rows of each rotor's table [s].
        momenta: of each rotor at these times [N m s].
    """
    if not times:
        return PrescribedRotors(np.zeros(1), np.zeros((1, 3)))
    union = np.unique(np.concatenate(times))
    along = [np.interp(union, own, values) for own, values in zip(times, momenta, strict=True)]
    return PrescribedRotors(union, np.ascontiguousarray(np.stack(along, axis=1) @ axes))


@inner
def rotor_momentum(rotors: PrescribedRotors, time: float) -> Vector:
    """Momentum of the rotors in base_link [N m s]."""
    times, rows = rotors.times, rotors.momenta
    last = times.size - 1
    if time <= times[0]:
        return rows[0, 0], rows[0, 1], rows[0, 2]
    if time >= times[last]:
        return rows[last, 0], rows[last, 1], rows[last, 2]
    low = row_at(times, time)
    high = low + 1
    share = (time - times[low]) / (times[high] - times[low])
    return (
        rows[low, 0] + share * (rows[high, 0] - rows[low, 0]),
        rows[low, 1] + share * (rows[high, 1] - rows[low, 1]),
        rows[low, 2] + share * (rows[high, 2] - rows[low, 2]),
    )
