"""Estimated numbers, their intervals and their bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rover_validation.estimation import EstimatedNumber, estimate


@pytest.mark.parametrize(
    ("mean", "remark"),
    [(0.5, ""), (0.995, "at its bound: not measured"), (1.2, "at its bound: not measured")],
)
def test_a_number_that_only_its_bound_holds_is_remarked(mean: float, remark: str):
    """A bound within a tenth of half of the interval decides, not what was measured."""
    measured = np.random.default_rng(1).normal(0.0, 1.0, (30, 10))
    measured += mean - measured.mean()
    number = EstimatedNumber("size", "m", 0.3, 0.0, 1.0, 0.1)
    (found,) = estimate(
        lambda values: list(values["size"] - measured), [number], evaluations=50, loss="linear"
    )
    assert found.remark == remark
    assert found.value == pytest.approx(min(mean, 1.0), abs=1e-3)
    # of a mean of thirty groups whose errors are correlated
    reach = 1.96 * float(measured.mean(axis=1).std()) / math.sqrt(30.0)
    if mean < 1.0:
        assert found.low == pytest.approx(mean - reach, abs=1e-3)
        assert found.high == pytest.approx(min(mean + reach, 1.0), abs=1e-3)
