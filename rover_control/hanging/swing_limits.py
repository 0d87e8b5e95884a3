"""Limits of the swing: for a travel, at a stop, for its pictures, and to the wall. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

from rover_control.hanging.cone_transfer import ConeTransfer
from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.descent_stop import PresentStop
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.imaging_window import imaging_window, longest_imaging_window
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.yaw_momentum import YawTask

_DAMPING_HYSTERESIS = 1.25  # ratio of the limits at which damping begins and ends
_ROUND_RATIO = 1.15  # major axis over its circle's radius below which an ellipse is round


class SwingLimits:
    """Judges whether the rover is calm enough, and whether damping can make it so.

    Args:
        parameters: rates, limits, timeouts.
        hanging: rover and tether.
        decay_time: decay time of a damped plane swing [s] on a length [m].
        transfer: of a cone's momentum, which makes more swings dampable.
    """

    def __init__(
        self,
        parameters: ProfileParameters,
        hanging: HangingParameters,
        decay_time: Callable[[float], float],
        transfer: ConeTransfer,
    ) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self.decay_time = decay_time
        self.transfer = transfer

    def exceeds(self, swing: SwingEstimate, length: float, present: PresentStop) -> bool:
        """Whether swing, yaw or twist exceed the limits of the present stop."""
        transfer = self.transfer
        is_due = transfer.due(swing, length, present) is not YawTask.HOLD
        if is_due or transfer.task is YawTask.UNWIND:
            return True
        if self.swing_exceeds(swing, length, present):
            return True
        limit = self.parameters.damped_yaw_rate
        # Hysteresis: the rest after damping must not start it again.
        if present.is_settling:
            limit *= 2.0
        return present.stop.observes and present.is_at and abs(swing.yaw_rate) > limit

    def swing_exceeds(self, swing: SwingEstimate, length: float, present: PresentStop) -> bool:
        """Whether the swing that the winch can damp exceeds the limits of the present stop."""
        stop, is_at = present.stop, present.is_at
        p, ellipse = self.parameters, swing.ellipse
        there = self.hanging.swing_amplitude_at(ellipse.major, length, stop.depth)
        going_up = not is_at and stop.depth < length
        if going_up:
            # Damping works best on a short tether; only the amplified plane swing counts.
            plane = self.hanging.swing_amplitude_at(
                ellipse.major - abs(ellipse.minor), length, stop.depth
            )
            return plane > p.largest_swing
        if not stop.observes:
            return is_at and there > 0.5 * p.largest_swing
        quick = self.decay_time(length) < p.quick_damping_time
        if self.unachievable(swing, length, stop.depth, is_at=is_at) and (is_at or not quick):
            return False
        w = self.hanging.swing_frequency(stop.depth)
        if quick and not is_at:
            return there * w > max(
                p.damped_swing_rate, _ROUND_RATIO * self.transfer.residual_rate(stop.depth)
            )
        minor = self.hanging.swing_amplitude_at(ellipse.minor, length, stop.depth)
        # The winch cannot improve a round ellipse any further.
        is_round = ellipse.major < _ROUND_RATIO * math.sqrt(ellipse.major * abs(ellipse.minor))
        limit = p.steady_rate if is_round else p.damped_swing_rate
        span = imaging_window(there, minor, w, limit)
        return span < self._imaging_time / (_DAMPING_HYSTERESIS if present.is_settling else 1.0)

    @property
    def _imaging_time(self) -> float:
        """Steady time [s] that a stop's pictures need."""
        p = self.parameters
        return p.steady_dwell + (p.exposures + 1) * p.exposure_interval

    def unachievable(
        self, swing: SwingEstimate, length: float, depth: float, *, is_at: bool
    ) -> str:
        """Why damping cannot give an imaging window at a depth; empty if it can."""
        p, w = self.parameters, self.hanging.swing_frequency(depth)
        # After a disturbance the ellipse is uncertain; damp what may be plane.
        known = max(abs(swing.ellipse.minor) - 2.0 * swing.swing_error / swing.frequency, 0.0)
        major, minor = (
            self.hanging.swing_amplitude_at(each, length, depth)
            for each in (swing.ellipse.major, known)
        )
        is_transferable = is_at and self.transfer.is_possible
        if (
            is_transferable
            or longest_imaging_window(major, minor, w, p.steady_rate) >= self._imaging_time
        ):
            return ""
        rate = math.degrees(math.sqrt(major * minor) * w)
        return (
            f"a cone of {deg(major)} x {deg(minor)} turns the camera by {rate:.2f} deg/s once "
            "it is round; its momentum about the plumb line cannot be damped here"
        )

    def wall_conflict(
        self, swing: SwingEstimate, length: float, depth: float, deviations: float
    ) -> str:
        """Why the rover could touch the wall on the way to a depth; empty if it cannot.

        Args:
            swing: estimate of the swing.
            length: payout [m].
            depth: of the stop [m].
            deviations: standard deviations by which the swing is larger than estimated.
        """
        p = self.parameters
        error = deviations * swing.swing_error / swing.frequency
        most = max(swing.ellipse.major + error, 0.0)
        there = self.hanging.swing_amplitude_at(most, length, depth)
        reach = max(most * length, there * depth) + p.rover_reach
        if reach < p.wall_clearance:
            return ""
        return (
            f"a swing of {deg(swing.ellipse.major)}, known within {deg(abs(error))}, takes the "
            f"rover {reach:.3g} m from the plumb line, the wall is at {p.wall_clearance:g} m"
        )


def deg(angle: float) -> str:
    """Text of an angle [rad] in degrees."""
    return f"{math.degrees(angle):.2f} deg"
