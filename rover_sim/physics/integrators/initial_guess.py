"""Initial guess of a step's Newton iteration, extrapolated from the previous steps.

The mid-step rates D/h are extrapolated: the midpoint rule leaves them smooth even where the rates
at the steps' ends alternate.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.tether.ancf import Array


class History(NamedTuple):
    """Mid-step rates of the last three steps, latest first."""

    rates: Array  # of the tether, (3, 2 dim, width)
    extra_rates: Array  # of the other unknowns (rover, exit slope), (3, m)
    instants: Array  # their instants relative to the start of the next step [s], (3,)


def make_history(rows: int, width: int, extra: int) -> History:
    """Allocate for a tether's `rows` of `width` columns and `extra` other increments."""
    return History(np.zeros((3, rows, width)), np.zeros((3, extra)), np.zeros(3))


@inner
def extrapolate(
    history: History, h: float, past_steps: int, increment: Array, extra: Array
) -> None:
    """Extrapolate the increments of a step of length h by Lagrange polynomials of 1 to 3 steps."""
    rates, extra_rates, instants = history.rates, history.extra_rates, history.instants
    at = 0.5 * h
    first, second, third = 1.0, 0.0, 0.0
    if past_steps == 2:
        first = (at - instants[1]) / (instants[0] - instants[1])
        second = 1.0 - first
    elif past_steps == 3:
        first = (at - instants[1]) * (at - instants[2])
        first /= (instants[0] - instants[1]) * (instants[0] - instants[2])
        second = (at - instants[0]) * (at - instants[2])
        second /= (instants[1] - instants[0]) * (instants[1] - instants[2])
        third = 1.0 - first - second
    first, second, third = h * first, h * second, h * third
    for k in range(increment.shape[0]):
        for i in range(increment.shape[1]):
            increment[k, i] = (
                first * rates[0, k, i] + second * rates[1, k, i] + third * rates[2, k, i]
            )
    for k in range(extra.shape[0]):
        extra[k] = (
            first * extra_rates[0, k] + second * extra_rates[1, k] + third * extra_rates[2, k]
        )


@inner
def record_step(
    history: History, h: float, stored_steps: int, length: float, increment: Array, extra: Array
) -> int:
    """Add the increments of an accepted step of length h to the history.

    Args:
        history: changed.
        h: [s].
        stored_steps: number of steps in the history.
        length: of an element [m], which scales slopes to positions.
        increment: of the tether.
        extra: the other increments.

    Returns:
        The number of past steps with which `extrapolate` would have been best for this step, 1 if
        the history was too short: rough motion needs a low order, as extrapolation amplifies noise.
    """
    rates, extra_rates, instants = history.rates, history.extra_rates, history.instants
    inverse = 1.0 / h
    constant, linear, quadratic = 0.0, 0.0, 0.0
    rows = increment.shape[0]
    for k in range(rows):
        unit = 1.0 if 2 * k < rows else length * length
        for i in range(increment.shape[1]):
            rate = inverse * increment[k, i]
            first, second, third = rates[0, k, i], rates[1, k, i], rates[2, k, i]
            constant += unit * (rate - first) ** 2
            linear += unit * (rate - 2.0 * first + second) ** 2
            quadratic += unit * (rate - 3.0 * (first - second) - third) ** 2
            rates[2, k, i] = second
            rates[1, k, i] = first
            rates[0, k, i] = rate
    for k in range(extra.shape[0]):
        extra_rates[2, k] = extra_rates[1, k]
        extra_rates[1, k] = extra_rates[0, k]
        extra_rates[0, k] = inverse * extra[k]
    instants[2] = instants[1] - h
    instants[1] = instants[0] - h
    instants[0] = -0.5 * h
    past_steps = 1
    if stored_steps >= 2 and linear < constant:
        past_steps = 2
    if stored_steps >= 3 and quadratic < min(constant, linear):
        past_steps = 3
    return past_steps
