"""Motion of an end of the tether that is driven: position over time from a table.

Between the rows of the table the position is a cubic spline at rest before the first and after the
last row, so that velocity and acceleration are continuous within it and the velocity everywhere.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector
from rover_sim.physics.tether.ancf import Array


class DrivenEnd(NamedTuple):
    """Velocity of a driven end, piecewise quadratic in time."""

    active: bool
    times: Array  # of the table's rows [s], (rows,)
    rates: Array  # coefficients of (t - times[i])^k in row i [m/s^(k+1)], (rows - 1, 3, 3)


NOT_DRIVEN = DrivenEnd(False, np.zeros(2), np.zeros((1, 3, 3)))


def make_driven_end(times: Array, positions: Array) -> DrivenEnd:
    """Drive an end through the rows of a table.

    Args:
        times: [s], increasing, (rows,), at least two.
        positions: relative to the end's position at the start [m], (rows, 3).
    """
    spline = CubicSpline(times, positions, bc_type="clamped").derivative()
    coefficients = np.transpose(spline.c[::-1], (1, 0, 2))
    return DrivenEnd(True, np.array(times, dtype=float), np.ascontiguousarray(coefficients))


@inner
def end_rate(end: DrivenEnd, time: float) -> Vector:
    """Velocity of the end [m/s]; zero before the table and after it."""
    times = end.times
    if not end.active or time <= times[0] or time >= times[times.size - 1]:
        return 0.0, 0.0, 0.0
    low, high = 0, times.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= time:
            low = middle
        else:
            high = middle
    c, s = end.rates[low], time - times[low]
    return (
        c[0, 0] + s * (c[1, 0] + s * c[2, 0]),
        c[0, 1] + s * (c[1, 1] + s * c[2, 1]),
        c[0, 2] + s * (c[1, 2] + s * c[2, 2]),
    )
