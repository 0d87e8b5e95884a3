"""Convergence test of a step's Newton iteration, with an estimate of its quadratic rate.

Near the solution an increment of size d is followed by one of about C d^2. C is measured during the
iteration; if it predicts a next increment far below the tolerance, the iteration ends without it.
After `_VALID_STEPS` steps that ended on such a prediction, C is measured again.
"""

import numpy as np

from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.tether.ancf import Array

CONTINUE, CONVERGED, FAILED = range(3)

MAX_ITERATIONS = 12
# Largest change of a node's slope in a sound step [rad]; more is a wrong root or too long a step.
MAX_ROTATION = 1.0

# Entries of the array `convergence`: rate constant C [1/m], and steps since its measurement.
RATE_CONSTANT, STEPS_SINCE_MEASURED = range(2)
CONVERGENCE_SIZE = 2
_VALID_STEPS = 8.0
_MARGIN = 0.1


@checked_inner
def reset_rate(convergence: Array) -> None:
    """Discard the rate constant C, so that the next step measures it."""
    convergence[RATE_CONSTANT] = 0.0
    convergence[STEPS_SINCE_MEASURED] = _VALID_STEPS


@checked_inner
def convergence_status(
    iteration: int, change: float, previous: float, tolerance: float, convergence: Array
) -> int:
    """Decide after an iteration whether it has converged.

    Args:
        iteration: its number, from 0.
        change: size of its increment [m].
        previous: size of the previous increment [m]; inf in the first iteration.
        tolerance: [m].
        convergence: (CONVERGENCE_SIZE,), changed.

    Returns:
        CONTINUE, CONVERGED, or FAILED (increment not finite or growing, or MAX_ITERATIONS).
    """
    if not np.isfinite(change) or (iteration > 1 and change > 2.0 * previous):
        return FAILED
    if iteration > 0:
        convergence[RATE_CONSTANT] = max(change / previous**2, 0.5 * convergence[RATE_CONSTANT])
        if iteration == 1:
            convergence[STEPS_SINCE_MEASURED] = 0.0
    if change < tolerance:
        return CONVERGED
    is_valid = convergence[STEPS_SINCE_MEASURED] < _VALID_STEPS
    if is_valid and convergence[RATE_CONSTANT] * change**2 < _MARGIN * tolerance:
        convergence[STEPS_SINCE_MEASURED] += 1.0
        return CONVERGED
    return CONTINUE if iteration + 1 < MAX_ITERATIONS else FAILED
