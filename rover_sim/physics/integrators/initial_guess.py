"""Initial guess of a step's Newton iteration, extrapolated from the previous steps.

The mid-step rates D/h are extrapolated: the midpoint rule leaves them smooth even where the rates
at the steps' ends alternate. Lagrange polynomials of up to three steps omit the third differences
of the rates. These are those of damped vibrations, which follow a linear recurrence: while the
steps' lengths are equal, the next third difference is predicted from the last three, with the
weights that predict the last one best in the least squares of all coordinates (linear prediction;
Makhoul 1975, Proceedings of the IEEE 63). Where motion is smooth, many steps then need one
iteration less.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.tether.ancf import Array

RECURRENCE = 4
"""Order that stands for three steps and the prediction of the third difference."""

# Entries of the array `counts`.
(
    STORED,  # steps in the history, at most 3
    ORDER,  # past steps with which to extrapolate, or RECURRENCE; 0: the history is empty
    EQUAL,  # equal steps up to the last one, at most 3
) = range(3)

_LAGS = 3  # third differences that predict the next one
# Regularises the weights of nearly parallel differences, relative to the sum of their squares.
_RIDGE = 1e-9
_SAME_LENGTH = 1e-9  # relative difference of the lengths of equal steps


class History(NamedTuple):
    """Mid-step rates of the last three steps, latest first, and their third differences."""

    rates: Array  # of the tether, (3, 2 dim, width)
    extra_rates: Array  # of the other unknowns (rover, exit slope), (3, m)
    instants: Array  # their instants relative to the start of the next step [s], (3,)
    differences: Array  # third differences of the tether's rates; 0: unknown, (3, 2 dim, width)
    products: Array  # inner products of these and the one before them, latest first, (4, 4)
    weights: Array  # of the differences in the next one, (3,)
    counts: Array  # numbers of steps, (3,)


def make_history(rows: int, width: int, extra: int) -> History:
    """Allocate for a tether's `rows` of `width` columns and `extra` other increments."""
    return History(
        np.zeros((3, rows, width)),
        np.zeros((3, extra)),
        np.zeros(3),
        np.zeros((_LAGS, rows, width)),
        np.zeros((_LAGS + 1, _LAGS + 1)),
        np.zeros(_LAGS),
        np.zeros(3),
    )


@inner
def clear_history(history: History) -> None:
    """Remove all steps, as after a discontinuity of the motion."""
    history.counts[STORED] = 0.0
    history.counts[ORDER] = 0.0


@inner
def extrapolate(history: History, h: float, increment: Array, extra: Array) -> None:
    """Extrapolate the increments of a step of length h by the order of a history with steps."""
    rates, extra_rates, instants = history.rates, history.extra_rates, history.instants
    order = history.counts[ORDER]
    at = 0.5 * h
    first, second, third = 1.0, 0.0, 0.0
    if order == 2.0:
        first = (at - instants[1]) / (instants[0] - instants[1])
        second = 1.0 - first
    elif order >= 3.0:
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
    if order < RECURRENCE:
        return
    differences = history.differences
    first, second = h * history.weights[0], h * history.weights[1]
    third = h * history.weights[2]
    for k in range(increment.shape[0]):
        for i in range(increment.shape[1]):
            increment[k, i] += (
                first * differences[0, k, i]
                + second * differences[1, k, i]
                + third * differences[2, k, i]
            )


@inner
def record_step(history: History, h: float, length: float, increment: Array, extra: Array) -> None:
    """Add the increments of an accepted step of length h to the history.

    The next order is that with which `extrapolate` would have been best for this step, 1 if the
    history was too short: rough motion needs a low order, as extrapolation amplifies noise.

    Args:
        history: changed.
        h: [s].
        length: of an element [m], which scales slopes to positions.
        increment: of the tether.
        extra: the other increments.
    """
    rates, extra_rates, instants = history.rates, history.extra_rates, history.instants
    differences, counts = history.differences, history.counts
    stored = counts[STORED]
    is_equal = stored > 0.0 and abs(h + 2.0 * instants[0]) <= _SAME_LENGTH * h
    counts[EQUAL] = min(counts[EQUAL] + 1.0, 3.0) if is_equal else 0.0
    known = 1.0 if stored >= 3.0 and counts[EQUAL] >= 3.0 else 0.0
    inverse = 1.0 / h
    constant, linear, quadratic = 0.0, 0.0, 0.0
    product0, product1, product2, product3 = 0.0, 0.0, 0.0, 0.0
    rows = increment.shape[0]
    for k in range(rows):
        unit = 1.0 if 2 * k < rows else length * length
        for i in range(increment.shape[1]):
            rate = inverse * increment[k, i]
            first, second, third = rates[0, k, i], rates[1, k, i], rates[2, k, i]
            difference = rate - 3.0 * (first - second) - third
            constant += unit * (rate - first) ** 2
            linear += unit * (rate - 2.0 * first + second) ** 2
            quadratic += unit * difference**2
            rates[2, k, i] = second
            rates[1, k, i] = first
            rates[0, k, i] = rate
            difference *= known
            first, second = differences[0, k, i], differences[1, k, i]
            product0 += unit * difference * difference
            product1 += unit * difference * first
            product2 += unit * difference * second
            product3 += unit * difference * differences[2, k, i]
            differences[2, k, i] = second
            differences[1, k, i] = first
            differences[0, k, i] = difference
    for k in range(extra.shape[0]):
        extra_rates[2, k] = extra_rates[1, k]
        extra_rates[1, k] = extra_rates[0, k]
        extra_rates[0, k] = inverse * extra[k]
    instants[2] = instants[1] - h
    instants[1] = instants[0] - h
    instants[0] = -0.5 * h
    recurrent = _predict(history, (product0, product1, product2, product3))
    counts[ORDER] = 1.0
    if stored >= 2.0 and linear < constant:
        counts[ORDER] = 2.0
    if stored >= 3.0 and quadratic < min(constant, linear):
        counts[ORDER] = 3.0
    if known > 0.0 and recurrent < min(constant, linear, product0):
        counts[ORDER] = RECURRENCE
    counts[STORED] = min(stored + 1.0, 3.0)


@inner
def _predict(history: History, latest: tuple[float, float, float, float]) -> float:
    """Set the weights with which the three differences before the latest one predict it best.

    Args:
        history: weights and products, changed.
        latest: products of the latest difference with itself and with the three before it.

    Returns:
        Square of the error with which the weights of before predicted the latest difference.
    """
    products, weights = history.products, history.weights
    for j in range(_LAGS, 0, -1):
        for k in range(_LAGS, 0, -1):
            products[j, k] = products[j - 1, k - 1]
    for k in range(_LAGS + 1):
        products[0, k] = products[k, 0] = latest[k]
    error = latest[0]
    for j in range(_LAGS):
        error -= 2.0 * weights[j] * latest[j + 1]
        for k in range(_LAGS):
            error += weights[j] * weights[k] * products[j + 1, k + 1]
    a, b, c = products[1, 1], products[2, 2], products[3, 3]
    ridge = _RIDGE * (a + b + c)
    if not ridge > 0.0:
        weights[0], weights[1], weights[2] = 0.0, 0.0, 0.0
        return error
    # Cholesky's factor of the normal equations
    d0 = np.sqrt(a + ridge)
    l1, l2 = products[1, 2] / d0, products[1, 3] / d0
    d1 = np.sqrt(max(b + ridge - l1 * l1, ridge))
    l3 = (products[2, 3] - l1 * l2) / d1
    d2 = np.sqrt(max(c + ridge - l2 * l2 - l3 * l3, ridge))
    y0 = latest[1] / d0
    y1 = (latest[2] - l1 * y0) / d1
    y2 = (latest[3] - l2 * y0 - l3 * y1) / d2
    weights[2] = y2 / d2
    weights[1] = (y1 - l3 * weights[2]) / d1
    weights[0] = (y0 - l1 * weights[1] - l2 * weights[2]) / d0
    return error
