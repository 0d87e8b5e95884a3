"""Momentum of a cone, and twist of the tether: when they are removed. Pure.

The winch cannot damp a cone's momentum about the plumb line. Where the tether can take it up by its
twist, the rotors transfer it; afterwards the twisted tether is unwound, so that it does not spin
the rover. Turns on the floor are all in one sense and wind the tether: at a stop with pictures it
would turn the camera for many minutes. On a short tether it is relaxed first, as it is quick there.
"""

from __future__ import annotations

import math

from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.descent_stop import PresentStop
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.yaw_momentum import MomentumTransfer, YawTask

_TRANSFER_HYSTERESIS = 1.6  # ratio of the rates at which a momentum transfer begins and ends
_CONE_RATE_FRACTION = 0.85  # fraction of the steady rate that a cone may keep
_RELAXATION = 6.0  # duration of the tether's relaxation, times the torsional frequency
_RELAXATION_HYSTERESIS = 2.4  # ratio of the rates at which it begins and ends
_RELAXED_TWIST = 1.0  # amplitude of the twist that the momentum of a relaxation could give [rad]
_LEAST_SWING = 0.6  # swing below which a relaxation raises it, over the one that is kept
_LONGEST_AT_STOP = 2.0  # duration of the transfers at a stop, over their relaxation time
_PLANE_RATIO = 0.15  # minor over major axis below which a swing is plane


class ConeTransfer:
    """Decides when a cone's momentum is transferred, and when the tether is unwound or relaxed.

    Args:
        parameters: limits of the transfer.
        hanging: rover and tether.

    Attributes:
        prediction: of a transfer of the present momentum.
        task: present one.
    """

    def __init__(self, parameters: ProfileParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self.prediction = MomentumTransfer(0.0, math.inf, 0.0, 0.0)
        self._holds_swing = False
        self.end()

    def end(self) -> None:
        """End the present task."""
        self.task = YawTask.HOLD
        self._duration = 0.0  # of the damping [s]

    def step(
        self, swing: SwingEstimate, length: float, present: PresentStop, duration: float
    ) -> None:
        """Decide anew while the swing is damped.

        Args:
            swing: estimate of the swing.
            length: payout [m].
            present: the present stop.
            duration: of the damping [s].
        """
        self._duration = duration
        due = self.due(swing, length, present)
        if due is YawTask.HOLD and self.task is not YawTask.HOLD and self._is_wound(swing):
            due = YawTask.UNWIND
        self.task = due

    def due(self, swing: SwingEstimate, length: float, present: PresentStop) -> YawTask:
        """What must, and can, be done here for the present stop: hold, transfer or relax."""
        frequency = self.hanging.torsional_frequency(length)
        relaxes = math.isfinite(self.prediction.time) and (
            frequency * self.parameters.max_transfer_time >= _RELAXATION
        )
        may_relax = relaxes and self.task in (YawTask.HOLD, YawTask.RELAX)
        if may_relax and self._spins(length, present):
            return YawTask.RELAX
        if not self._is_coning(swing, present):
            return YawTask.HOLD
        # A transfer is quicker; the last of the momentum it would move to and fro.
        spin = self.hanging.inertia_about_z * frequency * _RELAXED_TWIST
        is_little = present.is_at and relaxes and abs(self.prediction.momentum) < spin
        return YawTask.RELAX if is_little else YawTask.TRANSFER

    @property
    def is_possible(self) -> bool:
        """Whether the tether can take up the momentum in time."""
        return self.prediction.time <= self.parameters.max_transfer_time

    def _spins(self, length: float, present: PresentStop) -> bool:
        """Whether the twisted tether would turn the camera at the stop."""
        stop = present.stop
        if not stop.observes:
            return False
        # Energy over frequency is an adiabatic invariant: the angle grows with length^(1/4).
        angle = self.prediction.twist_amplitude * math.pow(stop.depth / length, 0.25)
        limit = self.parameters.unwound_yaw_rate
        limit *= 1.0 if self.task is YawTask.RELAX else _RELAXATION_HYSTERESIS
        return angle * self.hanging.torsional_frequency(stop.depth) > limit

    def _is_coning(self, swing: SwingEstimate, present: PresentStop) -> bool:
        """Whether a cone's momentum must, and can, be transferred to the mother machine here."""
        is_active = self.task in (YawTask.TRANSFER, YawTask.RELAX)
        stop, p = present.stop, self.parameters
        if not self.is_possible:
            return False
        # A nearly plane swing is damped by the winch; its momentum estimate is uncertain.
        if not is_active and abs(swing.ellipse.minor) < _PLANE_RATIO * swing.ellipse.major:
            return False
        # Where they do not end, the estimates' errors are as large as the rest: the camera decides.
        if present.is_at and self._duration > _LONGEST_AT_STOP * p.transfer_relaxation_time:
            return False
        limit = p.transfer_threshold_rate
        if not stop.observes:
            limit = 0.25 * p.largest_swing * self.hanging.swing_frequency(stop.depth)
            if not present.is_at:
                return False
        # Raise the limit with time: the estimates of momentum and twist have errors.
        limit *= (
            1.0 + max(self._duration - p.transfer_relaxation_time, 0.0) / p.transfer_relaxation_time
        )
        # Hysteresis: the rest after a transfer is of the size of the estimation errors.
        limit *= 1.0 if is_active else _TRANSFER_HYSTERESIS
        if stop.observes:
            limit = min(limit, _CONE_RATE_FRACTION * p.steady_rate)
        return self.residual_rate(stop.depth) > limit

    def residual_rate(self, depth: float) -> float:
        """Camera rate [rad/s] at a depth after damping: w a of the circle with the same momentum.

        The momentum of a circle is m (l + d)^2 w a^2.
        """
        w, inertia = self.hanging.swing_frequency(depth), self.hanging.pendulum_inertia(depth)
        return math.sqrt(abs(self.prediction.momentum) * w / inertia)

    def trim(self, swing: SwingEstimate) -> float:
        """What the winch does to a swing that the rotors need: damps 1, nothing 0, raises -1."""
        least = _LEAST_SWING * self.parameters.transfer_swing
        if self.task is YawTask.RELAX and swing.ellipse.major < least:
            return -1.0
        plane = swing.ellipse.major - abs(swing.ellipse.minor)
        most = self.parameters.transfer_swing * (2.0 if self._holds_swing else 1.0)
        self._holds_swing = plane < most
        return 0.0 if self._holds_swing else 1.0

    def _is_wound(self, swing: SwingEstimate) -> bool:
        """Whether the tether is twisted so far that it would spin the rover."""
        p = self.parameters
        return (
            abs(self.prediction.twist_acceleration) > p.unwound_acceleration
            or abs(swing.yaw_rate) > p.unwound_yaw_rate
        )
