"""Least squares with intervals, for laws that are identified from repeated measurements.

The residuals come in groups (a take, a repeat) whose errors are correlated, as no law explains all
of them. So the covariance is the sandwich estimate with gradients summed over groups, as in the
identification from bags, and the loss grows linearly for groups that the law does not explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Floats: TypeAlias = NDArray[np.float64]

_STANDARD_ERRORS: Final = 1.959964
"""Half of a 95 % interval."""
_AT_BOUND: Final = 1.0e-3
"""Distance from a bound, over the number's scale, that counts as at the bound."""
_DIFFERENCE: Final = 5.0e-3
"""Step of the derivatives, over the number's scale."""


@dataclass(frozen=True)
class EstimatedNumber:
    """A number that is identified.

    Attributes:
        name: of the number.
        unit: of its value.
        start: first guess.
        lower, upper: bounds of its value.
        scale: size of a change that matters; of the logarithm for a logarithmic number.
        logarithmic: whether its logarithm is searched; then it is above 0.
    """

    name: str
    unit: str
    start: float
    lower: float = -math.inf
    upper: float = math.inf
    scale: float = 1.0
    logarithmic: bool = False

    def inner(self, value: float) -> float:
        """Value as it is searched."""
        return math.log(value) if self.logarithmic else value

    def outer(self, inner: float) -> float:
        """Value from what is searched."""
        return math.exp(inner) if self.logarithmic else inner


@dataclass(frozen=True)
class Identified:
    """A number with its 95 % interval.

    Attributes:
        name: of the number.
        unit: of value and bounds.
        value: best fit.
        low, high: interval.
        at_bound: whether the search ended at a bound of the number, so that the value is the
            bound's and no property that was measured.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    at_bound: bool = False

    @property
    def remark(self) -> str:
        """Why the number is no property that was measured; empty if it is one."""
        if self.at_bound:
            return "at its bound: not measured"
        if self.high - self.low > 2.0 * abs(self.value):
            return "interval wider than the number: hardly determined"
        return ""

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for YAML."""
        return {
            "value": self.value, "low": self.low, "high": self.high,
            "unit": self.unit, "at_bound": self.at_bound,
        }  # fmt: skip


def estimate(
    residuals: Callable[[dict[str, float]], Sequence[Floats]],
    numbers: Sequence[EstimatedNumber],
    evaluations: int,
    loss: Literal["linear", "soft_l1"] = "soft_l1",
) -> list[Identified]:
    """Find the numbers with the least residuals.

    Args:
        residuals: returns the residuals of each group, over their expected size, for values of the
            numbers by name.
        numbers: what is identified, with first guesses.
        evaluations: largest number of steps of the search.
        loss: of `scipy.optimize.least_squares`.
    """
    sizes: list[int] = []

    def stacked(x: Floats) -> Floats:
        groups = residuals(
            {each.name: each.outer(inner) for each, inner in zip(numbers, x.tolist(), strict=True)}
        )
        sizes[:] = [group.size for group in groups]
        return np.concatenate(groups)

    scales = np.array([each.scale for each in numbers])
    bounds = [
        [
            -math.inf if each.logarithmic and bound <= 0.0 else each.inner(bound)
            for each, bound in zip(numbers, side, strict=True)
        ]
        for side in ([n.lower for n in numbers], [n.upper for n in numbers])
    ]
    lower, upper = np.array(bounds)
    start = np.array([each.inner(each.start) for each in numbers])
    margin = 2.0 * _AT_BOUND * scales
    start = np.clip(start, lower + margin, upper - margin)

    def jacobian(x: Floats) -> Floats:
        here = stacked(x)
        columns = []
        for place, scale in enumerate(scales.tolist()):
            step = _DIFFERENCE * scale
            if x[place] + step > upper[place]:
                step = -step
            there = x.copy()
            there[place] += step
            columns.append((stacked(there) - here) / step)
        return np.stack(columns, axis=1)

    found: Any = least_squares(
        stacked, start, jac=jacobian, bounds=(lower, upper), x_scale=scales, loss=loss,
        max_nfev=evaluations,
    )  # fmt: skip
    errors = np.sqrt(np.diag(_sandwich(found.jac, found.fun, sizes)))
    result = []
    for place, each in enumerate(numbers):
        x, reach = float(found.x[place]), _STANDARD_ERRORS * float(errors[place])
        near = _AT_BOUND * each.scale
        at_bound = min(x - float(lower[place]), float(upper[place]) - x) <= 3.0 * near
        result.append(
            Identified(
                each.name,
                each.unit,
                each.outer(x),
                each.outer(max(x - reach, float(lower[place]))),
                each.outer(min(x + reach, float(upper[place]), 700.0)),
                at_bound,
            )
        )
    return result


def _sandwich(jacobian: Floats, residuals: Floats, sizes: Sequence[int]) -> Floats:
    """Covariance for errors that are correlated within groups and in the loss of `soft_l1`."""
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    meat = np.zeros_like(bread)
    first = 0
    for size in sizes:
        gradient = jacobian[first : first + size].T @ residuals[first : first + size]
        meat += np.outer(gradient, gradient)
        first += size
    return np.asarray(bread @ meat @ bread)
