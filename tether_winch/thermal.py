"""I2t: what a motor may give without overheating its winding. Pure."""

from __future__ import annotations

import math

_KNEE = 0.8  # from this part of the bearable heat on, the torque is cut down


class MotorHeat:
    """Heat of the winding as part of what it bears for ever, and the torque that it leaves.

    First order in the square of the torque (the current's): torque for ever `continuous` heats
    it to 1. From 0.8 on the torque allowed falls, linearly in the heat, from `peak` to
    `continuous`, so that 1 is never passed.

    Args:
        continuous: torque that the motor bears for ever [N m].
        peak: torque that it gives when cold [N m].
        time: time constant of the winding [s].
    """

    def __init__(self, continuous: float, peak: float, time: float) -> None:
        self._continuous, self._peak, self._time = continuous, peak, time
        self.heat = 0.0

    def step(self, torque: float, dt: float) -> float:
        """Let a torque [N m] act for dt [s]; returns the torque that is allowed now [N m]."""
        source = (torque / self._continuous) ** 2
        self.heat += (source - self.heat) * -math.expm1(-dt / self._time)
        return self.allowed

    @property
    def allowed(self) -> float:
        """Torque that is allowed now [N m]."""
        share = min(max((self.heat - _KNEE) / (1.0 - _KNEE), 0.0), 1.0)
        return self._peak + share * (self._continuous - self._peak)
