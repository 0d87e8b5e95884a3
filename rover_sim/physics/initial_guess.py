"""Where Newton's iteration starts: increments extrapolated from the steps before.

What is extrapolated are the mid-step rates D/h, which the midpoint rule leaves smooth where its
rates at the steps' ends alternate.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.ancf import Array
from rover_sim.physics.compiled import inner


class History(NamedTuple):
    """Mid-step rates of the last three steps, the last one first."""

    rates: Array  # of the tether, (3, 2 dim, width)
    turns: Array  # of what else moves, (3, m)
    times: Array  # their instants relative to the start of the coming step [s], (3,)


def make_history(rows: int, width: int, turns: int) -> History:
    """Allocate for a tether's rows and so many further increments."""
    return History(np.zeros((3, rows, width)), np.zeros((3, turns)), np.zeros(3))


@inner
def extrapolate(history: History, h: float, depth: int, increment: Array, turn: Array) -> None:
    """Set the increments of a step of length h by Lagrange's polynomial through 1 to 3 steps."""
    rates, turns, times = history
    at = 0.5 * h
    first, second, third = 1.0, 0.0, 0.0
    if depth == 2:
        first = (at - times[1]) / (times[0] - times[1])
        second = 1.0 - first
    elif depth == 3:
        first = (at - times[1]) * (at - times[2])
        first /= (times[0] - times[1]) * (times[0] - times[2])
        second = (at - times[0]) * (at - times[2])
        second /= (times[1] - times[0]) * (times[1] - times[2])
        third = 1.0 - first - second
    first, second, third = h * first, h * second, h * third
    for k in range(increment.shape[0]):
        for i in range(increment.shape[1]):
            increment[k, i] = (
                first * rates[0, k, i] + second * rates[1, k, i] + third * rates[2, k, i]
            )
    for k in range(turn.shape[0]):
        turn[k] = first * turns[0, k] + second * turns[1, k] + third * turns[2, k]


@inner
def remember(
    history: History, h: float, known: int, length: float, increment: Array, turn: Array
) -> int:
    """Push the increments of a finished step of length h onto the history.

    Args:
        history: to push onto.
        h: [s].
        known: how many steps the history holds.
        length: of an element [m], to weigh slopes against positions.
        increment: of the tether.
        turn: of what else moves.

    Returns:
        The depth of `extrapolate` that would have been best for this step, 1 if none was possible:
        low orders for rough motion, whose noise extrapolation amplifies.
    """
    rates, turns, times = history
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
    for k in range(turn.shape[0]):
        turns[2, k] = turns[1, k]
        turns[1, k] = turns[0, k]
        turns[0, k] = inverse * turn[k]
    times[2] = times[1] - h
    times[1] = times[0] - h
    times[0] = -0.5 * h
    depth = 1
    if known >= 2 and linear < constant:
        depth = 2
    if known >= 3 and quadratic < min(constant, linear):
        depth = 3
    return depth
