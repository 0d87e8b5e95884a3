"""Low-pass of the swing in a frame that turns with it. Pure.

The pumping law divides the swing rate by its square and so amplifies errors: tilt that leaks into
the estimated rate would feed back into the tilt. The swing itself hardly changes within a period.
In an inertial frame it is the sum of two circles that turn at its frequency,

    z = A e^(i w t) + B e^(-i w t),
    A = (z + z'/(i w))/2 e^(-i w t),   B = (z - z'/(i w))/2 e^(i w t).

The filter smooths the complex amplitudes A and B over a fraction of a period: it removes motion at
other frequencies and does not delay motion at the swing's.
"""

from __future__ import annotations

import cmath
import math

from rover_control.hanging.swing_estimator import SwingEstimate

_FILTER_PHASE = 4.0  # filter time, in radians of the swing


class SwingFilter:
    """Filters a swing."""

    def __init__(self) -> None:
        self._forward = self._backward = 0j
        self._phase = 0.0
        self._elapsed = 0.0  # since the restart, in radians of the swing

    def restart(self) -> None:
        """Restart with the next estimate."""
        self._elapsed = 0.0

    def step(self, swing: SwingEstimate, heading: float, h: float) -> SwingEstimate:
        """Advance by h; returns the estimate with the filtered swing, which has no tilt in it.

        Args:
            swing: estimate.
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
        # Arithmetic mean at first, then a low-pass.
        share = min(w * h / min(self._elapsed, _FILTER_PHASE), 1.0)
        self._forward += share * (0.5 * (z + across) / phase - self._forward)
        self._backward += share * (0.5 * (z - across) * phase - self._backward)
        forward, backward = self._forward * phase, self._backward / phase
        direction, rate = (forward + backward) / turned, 1j * w * (forward - backward) / turned
        return swing._replace(
            direction=(direction.real, direction.imag),
            direction_rate=(rate.real, rate.imag),
            lever_share=0.0,
        )
