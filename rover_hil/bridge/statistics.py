"""Percentiles of a measured quantity over a window of the last values."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

WINDOW_SIZE = 20_000  # values
Floats: TypeAlias = NDArray[np.float64]


class Percentiles(NamedTuple):
    """Percentiles of a window, in the unit of the values."""

    number: int
    p50: float
    p99: float
    largest: float


class SlidingWindow:
    """Window of the last values."""

    def __init__(self) -> None:
        self._values = np.empty(WINDOW_SIZE)
        self._number = 0  # of values since the start

    def add(self, value: float) -> None:
        """Add a value."""
        self._values[self._number % WINDOW_SIZE] = value
        self._number += 1

    def copied_values(self) -> Floats:
        """Copy of the values in the window, in any order."""
        return self._values[: self._number].copy()


def percentiles(values: Floats) -> Percentiles | None:
    """Percentiles of values; None: there are none."""
    if not len(values):
        return None
    p50, p99 = np.percentile(values, (50.0, 99.0), method="higher").tolist()
    return Percentiles(len(values), p50, p99, float(values.max()))
