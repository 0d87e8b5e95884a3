"""Locate events inside a step: the instant of an extremum or of a level crossing.

Inside the step a quantity is interpolated by the cubic Hermite polynomial of its values and rates
at the ends; its error is of fourth order in the step.
"""

from rover_sim.physics.numerics.compiled import inner, kernel


@kernel
def hermite(t: float, h: float, y0: float, dy0: float, y1: float, dy1: float) -> float:
    """Cubic Hermite polynomial of the values and rates at 0 and h, at the time t."""
    u = t / h
    return (
        y0
        + u * h * dy0
        + u * u * (3.0 * (y1 - y0) - h * (2.0 * dy0 + dy1))
        + u * u * u * (2.0 * (y0 - y1) + h * (dy0 + dy1))
    )


@inner
def hermite_rate(t: float, h: float, y0: float, dy0: float, y1: float, dy1: float) -> float:
    """Derivative of `hermite` with respect to t."""
    u = t / h
    return (
        dy0
        + 2.0 * u * (3.0 * (y1 - y0) / h - (2.0 * dy0 + dy1))
        + 3.0 * u * u * (2.0 * (y0 - y1) / h + dy0 + dy1)
    )


@kernel
def apex_instant(h: float, y0: float, dy0: float, y1: float, dy1: float) -> float:
    """Time at which the cubic's rate falls through zero, for dy0 > 0 >= dy1, by bisection."""
    low, high = 0.0, h
    for _ in range(60):
        middle = 0.5 * (low + high)
        if hermite_rate(middle, h, y0, dy0, y1, dy1) > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def crossing_instant(
    low: float, high: float, h: float, y0: float, dy0: float, y1: float, dy1: float, level: float
) -> float:
    """Time in [low, high] at which the cubic falls through the level, by bisection."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        if hermite(middle, h, y0, dy0, y1, dy1) > level:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
