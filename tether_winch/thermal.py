"""I2t protection: thermal model of the motor's winding. Pure."""

from __future__ import annotations

import math

_KNEE = 0.8  # relative heat above which the torque is derated


class MotorThermalModel:
    """Relative heat of the winding, and the torque that it allows.

    First order in the square of the torque, as of the current; the `continuous` torque heats the
    winding to 1. Above 0.8 the allowed torque falls linearly with the heat from `peak` to
    `continuous`, so that the heat never exceeds 1.

    Args:
        continuous: continuous torque [N m].
        peak: torque of the cold motor [N m].
        time: thermal time constant [s].
    """

    def __init__(self, continuous: float, peak: float, time: float) -> None:
        self._continuous, self._peak, self._time = continuous, peak, time
        self.heat = 0.0

    def step(self, torque: float, dt: float) -> float:
        """Apply a torque [N m] for dt [s]; returns the torque allowed now [N m]."""
        source = (torque / self._continuous) ** 2
        self.heat += (source - self.heat) * -math.expm1(-dt / self._time)
        return self.allowed

    @property
    def allowed(self) -> float:
        """Torque allowed now [N m]."""
        share = min(max((self.heat - _KNEE) / (1.0 - _KNEE), 0.0), 1.0)
        return self._peak + share * (self._continuous - self._peak)
