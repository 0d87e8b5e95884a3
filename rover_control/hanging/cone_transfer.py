"""Transfer of a cone's momentum to the mother machine: when it is due, and its unwinding. Pure.

The winch cannot damp a cone's momentum about the plumb line. Where the tether can take it up by its
twist, the rotors transfer it; afterwards the twisted tether is unwound, so that it does not spin
the rover.
"""

from __future__ import annotations

import math

from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.descent_stop import PresentStop
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.yaw_momentum import MomentumTransfer

_TRANSFER_HYSTERESIS = 1.6  # ratio of the rates at which a momentum transfer begins and ends
_CONE_RATE_FRACTION = 0.85  # fraction of the steady rate that a cone may keep
_PLANE_RATIO = 0.15  # minor over major axis below which a swing is plane


class ConeTransfer:
    """Decides when a cone's momentum is transferred, and when the tether is unwound.

    Args:
        parameters: limits of the transfer.
        hanging: rover and tether.

    Attributes:
        prediction: of a transfer of the present momentum.
        is_active: the momentum is transferred.
        unwinds: the tether is unwound after a transfer.
    """

    def __init__(self, parameters: ProfileParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self.prediction = MomentumTransfer(0.0, math.inf, 0.0)
        self._holds_swing = False
        self.end()

    def end(self) -> None:
        """End transfer and unwinding."""
        self.is_active = self.unwinds = False
        self._duration = 0.0  # of the damping [s]

    def step(self, swing: SwingEstimate, present: PresentStop, duration: float) -> None:
        """Decide anew while the swing is damped.

        Args:
            swing: estimate of the swing.
            present: the present stop.
            duration: of the damping [s].
        """
        was_active, self._duration = self.is_active, duration
        self.is_active = self.is_due(swing, present)
        self.unwinds = not self.is_active and (was_active or self.unwinds) and self._is_wound(swing)

    @property
    def is_possible(self) -> bool:
        """Whether the tether can take up the momentum in time."""
        return self.prediction.time <= self.parameters.max_transfer_time

    def is_due(self, swing: SwingEstimate, present: PresentStop) -> bool:
        """Whether a cone's momentum must, and can, be transferred to the mother machine here."""
        stop, p = present.stop, self.parameters
        if not self.is_possible:
            return False
        # A nearly plane swing is damped by the winch; its momentum estimate is uncertain.
        if not self.is_active and abs(swing.ellipse.minor) < _PLANE_RATIO * swing.ellipse.major:
            return False
        limit = p.transfer_threshold_rate
        if not stop.observes:
            limit = 0.25 * p.largest_swing * self.hanging.swing_frequency(stop.depth)
            if not present.is_at:
                return False
        # Relax the limit with time: the estimates of momentum and twist have errors.
        limit *= (
            1.0 + max(self._duration - p.transfer_relaxation_time, 0.0) / p.transfer_relaxation_time
        )
        # Hysteresis: the rest after a transfer is of the size of the estimation errors.
        limit *= 1.0 if self.is_active else _TRANSFER_HYSTERESIS
        if stop.observes:
            limit = min(limit, _CONE_RATE_FRACTION * p.steady_rate)
        return self.residual_rate(stop.depth) > limit

    def residual_rate(self, depth: float) -> float:
        """Camera rate [rad/s] at a depth after damping: w a of the circle with the same momentum.

        The momentum of a circle is m (l + d)^2 w a^2.
        """
        w, inertia = self.hanging.swing_frequency(depth), self.hanging.pendulum_inertia(depth)
        return math.sqrt(abs(self.prediction.momentum) * w / inertia)

    def trims(self, swing: SwingEstimate) -> bool:
        """Whether the winch damps during a transfer, which needs some swing for the rotors."""
        plane = swing.ellipse.major - abs(swing.ellipse.minor)
        most = self.parameters.transfer_swing * (2.0 if self._holds_swing else 1.0)
        self._holds_swing = plane < most
        return not self._holds_swing

    def _is_wound(self, swing: SwingEstimate) -> bool:
        """Whether the tether is twisted so far that it would spin the rover."""
        p = self.parameters
        return (
            abs(self.prediction.twist_acceleration) > p.unwound_acceleration
            or abs(swing.yaw_rate) > p.unwound_yaw_rate
        )
