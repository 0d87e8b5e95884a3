"""Percentiles of what is measured again and again, over a window of the last ones."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np


class Percentiles(NamedTuple):
    """Of a window of values, all in the values' unit."""

    number: int
    p50: float
    p99: float
    largest: float


class Window:
    """The last values, and the largest of all.

    Args:
        size: how many are kept.
    """

    def __init__(self, size: int = 20_000) -> None:
        self._values: deque[float] = deque(maxlen=size)

    def __len__(self) -> int:
        return len(self._values)

    def add(self, value: float) -> None:
        """Take a value."""
        self._values.append(value)

    def clear(self) -> None:
        """Forget all."""
        self._values.clear()

    def percentiles(self) -> Percentiles | None:
        """Of what is kept; None without a value."""
        if not self._values:
            return None
        values = np.array(self._values)
        p50, p99 = np.percentile(values, (50.0, 99.0), method="higher").tolist()
        return Percentiles(len(values), p50, p99, float(values.max()))
