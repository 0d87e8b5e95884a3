"""Quick stop of a drive, as in CiA 402 with the option code 2. Pure.

The drive lowers its rate setpoint to zero with its quick-stop deceleration (6085h). At standstill
its function is off and the holding brake, if it has one, closes.
"""

from __future__ import annotations

import math

# After the ramp, the longest wait for a drive that does not come to rest, as on a slope [s].
_LONGEST_WAIT = 0.2


class QuickStop:
    """The ramp of one quick stop.

    Args:
        rate: at its begin, in the drive's unit per second.
        deceleration: > 0; inf: the setpoint is zero at once.
        standstill: magnitude of the rate up to which the drive stands still.

    Attributes:
        rate: present setpoint.
    """

    def __init__(self, rate: float, deceleration: float, standstill: float) -> None:
        self.rate = rate
        self._deceleration = deceleration
        self._standstill = standstill
        self._waited = 0.0

    def step(self, measured: float, h: float) -> bool:
        """Lower the setpoint to that of the end of a tick.

        Args:
            measured: rate of the drive at the start of the tick.
            h: duration of the tick [s].

        Returns:
            Whether the stop is over: the ramp has ended, and the drive stands still or was waited
            for.
        """
        if self.rate != 0.0:
            left = max(abs(self.rate) - self._deceleration * h, 0.0)
            self.rate = math.copysign(left, self.rate) if left else 0.0
            return False
        self._waited += h
        return abs(measured) <= self._standstill or self._waited > _LONGEST_WAIT
