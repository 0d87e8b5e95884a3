"""When Newton's iteration for a step has converged, and when it will not.

A Newton increment is followed by one of about C times its square. C is measured while the
iteration runs; an increment whose successor would be far below the tolerance by that word ends the
iteration without it. After so many steps that ended on its word C is measured again.
"""

import numpy as np

from rover_sim.physics.ancf import Array
from rover_sim.physics.compiled import checked_inner

CONTINUE, CONVERGED, FAILED = range(3)

MAX_ITERATIONS = 12
# Nodes of a converged step turn less than this [rad]; more is a wrong root or too coarse a step.
MAX_TURN = 1.0

# Entries of the array `convergence`: C, and steps since it was measured.
RATE_CONSTANT, STEPS_SINCE_MEASURED = range(2)
CONVERGENCE_SIZE = 2
_VALID_STEPS = 8.0
_MARGIN = 0.1


@checked_inner
def reset_rate(convergence: Array) -> None:
    """Have C measured in the next step, and forget what it was."""
    convergence[RATE_CONSTANT] = 0.0
    convergence[STEPS_SINCE_MEASURED] = _VALID_STEPS


@checked_inner
def convergence_status(
    iteration: int, change: float, previous: float, tolerance: float, convergence: Array
) -> int:
    """What to do after an iteration.

    Args:
        iteration: its number, from 0.
        change: size of its increment [m].
        previous: size of the increment before [m]; inf in the first.
        tolerance: [m].
        convergence: (CONVERGENCE_SIZE,), changed.

    Returns:
        GO_ON, CONVERGED, or FAILED for an increment that is not finite or that grows.
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
