"""Percentiles of a measured quantity over a window of the last values."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np


class Percentiles(NamedTuple):
    """Percentiles of a window, in the unit of the values."""

    number: int
    p50: float
    p99: float
    largest: float


class SlidingWindow:
    """Window of the last values.

    Args:
        size: number of values kept.
    """

    def __init__(self, size: int = 20_000) -> None:
        self._values: deque[float] = deque(maxlen=size)

    def add(self, value: float) -> None:
        """Add a value."""
        self._values.append(value)

    def percentiles(self) -> Percentiles | None:
        """Percentiles of the window; None: it is empty."""
        if not self._values:
            return None
        values = np.array(self._values)
        p50, p99 = np.percentile(values, (50.0, 99.0), method="higher").tolist()
        return Percentiles(len(values), p50, p99, float(values.max()))
