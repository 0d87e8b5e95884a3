"""Motion of an end of the tether that is driven: position over time from a table.

Between the rows of the table the position is a cubic spline at rest before the first and after the
last row, so that velocity and acceleration are continuous within it and the velocity everywhere.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.roots_and_splines import cubic_spline
from rover_sim.physics.numerics.time_table import row_at
from rover_sim.physics.numerics.vectors import Vector
from rover_sim.physics.tether.ancf import Array


class DrivenEnd(NamedTuple):
    """Motion of a driven end, piecewise cubic in time."""

    active: bool
    times: Array  # of the table's rows [s], (rows,)
    positions: Array  # at these times, relative to the start [m], (rows, 3)
    rates: Array  # coefficients of (t - times[i])^k in row i [m/s^(k+1)], (rows - 1, 3, 3)


NOT_DRIVEN = DrivenEnd(False, np.zeros(2), np.zeros((2, 3)), np.zeros((1, 3, 3)))


def make_driven_end(times: Array, positions: Array) -> DrivenEnd:
    """Drive an end through the rows of a table.

    Args:
        times: [s], increasing, (rows,), at least two.
        positions: relative to the end's position at the start [m], (rows, 3).
    """
    spline = cubic_spline(times, positions, "clamped").derivative()
    coefficients = np.transpose(spline.c[::-1], (1, 0, 2))
    return DrivenEnd(
        True,
        np.array(times, dtype=float),
        np.array(positions, dtype=float),
        np.ascontiguousarray(coefficients),
    )


@inner
def end_position(end: DrivenEnd, time: float) -> Vector:
    """Position of the end relative to its start [m]."""
    times, places = end.times, end.positions
    last = times.size - 1
    if not end.active or time <= times[0]:
        return 0.0, 0.0, 0.0
    if time >= times[last]:
        return places[last, 0], places[last, 1], places[last, 2]
    low = row_at(times, time)
    c, s = end.rates[low], time - times[low]
    return (
        places[low, 0] + s * (c[0, 0] + s * (c[1, 0] / 2.0 + s * c[2, 0] / 3.0)),
        places[low, 1] + s * (c[0, 1] + s * (c[1, 1] / 2.0 + s * c[2, 1] / 3.0)),
        places[low, 2] + s * (c[0, 2] + s * (c[1, 2] / 2.0 + s * c[2, 2] / 3.0)),
    )


@inner
def end_rate(end: DrivenEnd, time: float) -> Vector:
    """Velocity of the end [m/s]; zero before the table and after it."""
    times = end.times
    if not end.active or time <= times[0] or time >= times[times.size - 1]:
        return 0.0, 0.0, 0.0
    low = row_at(times, time)
    c, s = end.rates[low], time - times[low]
    return (
        c[0, 0] + s * (c[1, 0] + s * c[2, 0]),
        c[0, 1] + s * (c[1, 1] + s * c[2, 1]),
        c[0, 2] + s * (c[1, 2] + s * c[2, 2]),
    )
