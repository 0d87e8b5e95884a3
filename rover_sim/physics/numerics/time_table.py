"""Search in a table of times."""

import numpy as np
from numpy.typing import NDArray

from rover_sim.physics.numerics.compiled import kernel


@kernel
def row_at(times: NDArray[np.float64], time: float) -> int:
    """Last row that does not lie after a time, by bisection.

    numba's `searchsorted` belongs to a module that imports scipy's linear algebra with any function
    that calls it, also with one from the cache.

    Args:
        times: increasing [s], (rows,).
        time: from the first row's to before the last row's [s].
    """
    low, high = 0, times.size - 1
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= time:
            low = middle
        else:
            high = middle
    return low
