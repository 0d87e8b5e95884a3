"""The swing as what lasts of it: its two circles, followed slowly. Pure.

What pumps goes by the swing's velocity over its square, and so makes much of little: where the
estimate of the velocity carries some of the tilt, that comes backward into the tilt. The swing
itself
hardly changes within a period. In space it is the sum of two circles that turn at its frequency,

    z = A e^(i w t) + B e^(-i w t),
    A = (z + z'/(i w))/2 e^(-i w t),   B = (z - z'/(i w))/2 e^(i w t),

whose complex amplitudes are smoothed over some of a period. What turns at another frequency is
smoothed away, and what turns at the swing's is not delayed.
"""

from __future__ import annotations

import cmath
import math

from rover_control.swing_estimator import SwingEstimate

_FILTER_PHASE = 4.0  # of the smoothing, in radians of the swing


class SwingFilter:
    """Follows a swing."""

    def __init__(self) -> None:
        self._forward = self._backward = 0j
        self._phase = 0.0
        self._elapsed = 0.0  # duration since the start, in radians of the swing

    def restart(self) -> None:
        """Begin anew with what the next estimate says."""
        self._elapsed = 0.0

    def step(self, swing: SwingEstimate, heading: float, h: float) -> SwingEstimate:
        """Advance by h to an estimate; returns it with the swing that lasts.

        Args:
            swing: as estimated.
            heading: of base_link about the plumb line [rad].
            h: since the last step [s].
        """
        w = swing.frequency
        self._phase = math.remainder(self._phase + w * h, math.tau)
        self._elapsed += w * h
        turned = cmath.exp(1j * heading)
        z = complex(*swing.direction) * turned
        across = complex(*swing.direction_rate) * turned / (1j * w)
        phase = cmath.exp(1j * self._phase)
        # A mean of all so far, until there is enough.
        share = min(w * h / min(self._elapsed, _FILTER_PHASE), 1.0)
        self._forward += share * (0.5 * (z + across) / phase - self._forward)
        self._backward += share * (0.5 * (z - across) * phase - self._backward)
        forward, backward = self._forward * phase, self._backward / phase
        direction, rate = (forward + backward) / turned, 1j * w * (forward - backward) / turned
        return swing._replace(
            direction=(direction.real, direction.imag), direction_rate=(rate.real, rate.imag)
        )
