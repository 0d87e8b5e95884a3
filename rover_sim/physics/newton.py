"""When Newton's iteration for a step has converged, and when it will not.

A Newton increment is followed by one of about C times its square. C is measured while the
iteration runs; an increment whose successor would be far below the tolerance by that word ends the
iteration without it. After so many steps that ended on its word C is measured again.
"""

import numpy as np

from rover_sim.physics.ancf import Array
from rover_sim.physics.compiled import checked_inner

GO_ON, CONVERGED, FAILED = range(3)

MAX_ITERATIONS = 12
# Nodes of a converged step turn less than this [rad]; more is a wrong root or too coarse a step.
MAX_TURN = 1.0

# Entries of the array `control`: C, and steps since it was measured.
CONSTANT, STEPS = range(2)
CONTROL_SIZE = 2
_TRUSTED_STEPS = 8.0
_TRUST_MARGIN = 0.1


@checked_inner
def distrust(control: Array) -> None:
    """Have C measured in the next step, and forget what it was."""
    control[CONSTANT] = 0.0
    control[STEPS] = _TRUSTED_STEPS


@checked_inner
def verdict(
    iteration: int, change: float, previous: float, tolerance: float, control: Array
) -> int:
    """What to do after an iteration.

    Args:
        iteration: its number, from 0.
        change: size of its increment [m].
        previous: size of the increment before [m]; inf in the first.
        tolerance: [m].
        control: (CONTROL_SIZE,), changed.

    Returns:
        GO_ON, CONVERGED, or FAILED for an increment that is not finite or that grows.
    """
    if not np.isfinite(change) or (iteration > 1 and change > 2.0 * previous):
        return FAILED
    if iteration > 0:
        control[CONSTANT] = max(change / previous**2, 0.5 * control[CONSTANT])
        if iteration == 1:
            control[STEPS] = 0.0
    if change < tolerance:
        return CONVERGED
    trusted = control[STEPS] < _TRUSTED_STEPS
    if trusted and control[CONSTANT] * change**2 < _TRUST_MARGIN * tolerance:
        control[STEPS] += 1.0
        return CONVERGED
    return GO_ON if iteration + 1 < MAX_ITERATIONS else FAILED
