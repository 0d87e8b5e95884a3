"""Filter of the camera's rate, which is too noisy to be judged sample by sample. Pure."""

from __future__ import annotations

import math

_FILTER_TIME = 0.5  # averaging time [s]


class CameraRate:
    """Mean square of the rate at which the camera turns."""

    def __init__(self) -> None:
        self._updated_at = math.nan  # [s]
        self._mean_square = 0.0  # [(rad/s)^2]

    def update(self, rate: float, now: float) -> None:
        """Add a rate [rad/s] at a time [s]."""
        h = 0.0 if math.isnan(self._updated_at) else now - self._updated_at
        self._updated_at = now
        self._mean_square += min(h / _FILTER_TIME, 1.0) * (rate * rate - self._mean_square)

    def is_below(self, rate: float) -> bool:
        """Whether the root of the mean square is below a rate [rad/s]."""
        return self._mean_square < rate**2
