"""Search for the minimum of a sum of squares.

The steps are those of a trust region (`scipy.optimize.least_squares`: Branch, Coleman and Li 1999,
SIAM J. Sci. Comput. 21): each unknown moves by about its scale at most, and further where the
linear model proves right. So well observable unknowns converge first, and poorly observable ones do
not diverge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import least_squares

Floats: TypeAlias = NDArray[np.float64]
Function: TypeAlias = Callable[[Floats], Floats]

_SHORTEST_STEP: Final = 1e-6
"""Length of a step, over that of all unknowns, that ends the search whatever its tolerance."""
_KEPT: Final = 0.6
"""Fraction of the promised gain from which costly derivatives are kept."""


@dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    Attributes:
        x: unknowns, (n,).
        residuals: there, (m,).
        jacobian: derivatives there, scaled by the loss, (m, n).
        converged: whether the search ended by itself.
    """

    x: Floats
    residuals: Floats
    jacobian: Floats
    converged: bool

    @property
    def gain(self) -> float:
        """Decrease of the sum of squares that another step of Gauss and Newton promises."""
        step = lstsq(self.jacobian, -self.residuals)[0]
        return float(np.sum((self.jacobian @ step) ** 2))


class _CorrectedDerivatives:
    """Derivatives that are computed anew only where a step has not brought what they promised.

    Otherwise they are corrected by the residuals after the step (Broyden 1965, Math. Comp. 19); the
    unknowns are weighted by their effect on the residuals.
    """

    def __init__(self, residuals: Function, derivatives: Function) -> None:
        self._residuals, self._derivatives = residuals, derivatives
        self._known: tuple[Floats, Floats, Floats] | None = None  # unknowns, residuals, derivatives

    def __call__(self, x: Floats) -> Floats:
        after = self._residuals(x)
        corrected = None if self._known is None else _corrected(*self._known, x, after)
        jacobian = self._derivatives(x) if corrected is None else corrected
        self._known = x.copy(), after, jacobian
        return jacobian


def _corrected(
    before: Floats, residuals: Floats, jacobian: Floats, x: Floats, after: Floats
) -> Floats | None:
    """Derivatives after a step; None if it brought much less than they promised."""
    step = x - before
    predicted = residuals + jacobian @ step
    sums = [float(each @ each) for each in (residuals, predicted, after)]
    if not sums[0] - sums[2] > _KEPT * (sums[0] - sums[1]) > 0.0:
        return None
    weighted = np.sum(jacobian**2, axis=0) * step
    return np.asarray(jacobian + np.outer(after - predicted, weighted) / float(step @ weighted))


def minimise(
    residuals: Function,
    start: Floats,
    scales: Floats,
    *,
    derivatives: Function | None = None,
    costly: bool = False,
    bounds: tuple[Floats | float, Floats | float] = (-math.inf, math.inf),
    difference: float = 5e-3,
    loss: Literal["linear", "soft_l1"] = "linear",
    evaluations: int,
    tolerance: float = 1e-8,
) -> Minimum:
    """Find the unknowns with the least sum of squares.

    Args:
        residuals: as a function of the unknowns, (n,) to (m,).
        start: first guess within the bounds, (n,).
        scales: size of a change that matters, (n,).
        derivatives: of the residuals, (n,) to (m, n); None: differences of the residuals.
        costly: whether derivatives cost much more than residuals: they are then corrected instead
            while the steps bring what they promise, so that those of the minimum are inexact.
        bounds: lower and upper bounds of the unknowns, (n,) each.
        difference: step of these differences, over the scale; backwards at the upper bound.
        loss: of `scipy.optimize.least_squares`.
        evaluations: largest number of points that are tried.
        tolerance: decrease of the sum of squares, over the sum, that ends the search.
    """

    def differences(x: Floats) -> Floats:
        here = residuals(x)
        columns = []
        for place, step in enumerate(difference * scales):
            there = x.copy()
            there[place] += step
            if np.any(there > bounds[1]):
                there[place] -= 2.0 * step
            columns.append((residuals(there) - here) / (there[place] - x[place]))
        return np.stack(columns, axis=1)

    exact = derivatives or differences
    found: Any = least_squares(
        residuals,
        start,
        jac=_CorrectedDerivatives(residuals, exact) if costly else exact,
        bounds=bounds,
        x_scale=scales,
        loss=loss,
        max_nfev=evaluations,
        ftol=tolerance,
        xtol=min(tolerance, _SHORTEST_STEP),
    )
    return Minimum(found.x, found.fun, found.jac, found.status > 0)
