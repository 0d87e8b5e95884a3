"""Least squares with intervals, for laws that are identified from repeated measurements.

The residuals come in groups (a take, a repeat) whose errors are correlated, as no law explains all
of them. So the covariance is the sandwich estimate with gradients summed over groups, and the loss
grows linearly for groups that the law does not explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from rover_estimation import (
    STANDARD_ERRORS,
    Floats,
    grouped_gradients,
    inverse_curvature,
    minimise,
    sandwich,
)

_AT_BOUND: Final = 1.0e-3
"""Distance from a bound, over the number's scale, that counts as at the bound."""
_HELD_BY_BOUND: Final = 0.1
"""The same over half of the interval: the residuals alone would put the number beyond."""


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
        at_bound: whether the search ended at a bound of the number, or closer to it than a tenth
            of half of the interval, so that the value is the bound's and none that was measured.
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
    found = minimise(
        stacked, np.clip(start, lower + margin, upper - margin), scales, bounds=(lower, upper),
        loss=loss, evaluations=evaluations,
    )  # fmt: skip
    groups = np.repeat(np.arange(len(sizes)), sizes)
    gradients = grouped_gradients(found.jacobian, found.residuals, groups)
    errors = np.sqrt(np.diag(sandwich(inverse_curvature(found.jacobian), gradients)))
    result = []
    for place, each in enumerate(numbers):
        x, reach = float(found.x[place]), STANDARD_ERRORS * float(errors[place])
        least, most = float(lower[place]), float(upper[place])
        near = max(3.0 * _AT_BOUND * each.scale, _HELD_BY_BOUND * min(reach, most - least))
        at_bound = x - least < near or most - x < near
        result.append(
            Identified(
                each.name,
                each.unit,
                each.outer(x),
                each.outer(max(x - reach, least)),
                each.outer(min(x + reach, most, 700.0)),
                at_bound,
            )
        )
    return result
