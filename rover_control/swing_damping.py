"""Damping of the swing by the winch's trim. Pure.

Paying out while the rover swings outward and reeling in while it swings inward damps the swing:
with A^2 = |u|^2 + |u'|^2/w^2,

    dl = D 2 u.u'/(A^2 w),    with the damping ratio 3/4 D/l.

The trim runs at twice the swing frequency w. Its amplitude D is bounded by the drum's rate,
D <= v/2w, by its acceleration, D <= 0.8 a/4w^2 (a trim that lags would feed the swing), and by
0.15 l. On a circle u.u' = 0: the winch turns an ellipse into a circle and can do no more. The rest
is the task of `rotor_pump` and `yaw_momentum`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.machine import MAX_RATE_TRIM
from msg_schemas.parameters import parameter
from rover_control.swing_estimator import SwingEstimate


@dataclass(frozen=True)
class DampingParameters:
    """Bounds of winch trim and rotor pumping against a swing."""

    trim_rate: float = parameter(0.28, "m/s", "largest rate of the trim", 0.01, MAX_RATE_TRIM)
    trim_acceleration: float = parameter(
        0.3, "m/s^2", "acceleration limit of a trim at the winch", 0.01, 5.0
    )
    trim_length_fraction: float = parameter(
        0.15, "-", "largest trim amplitude, as a fraction of the length", 0.0, 0.5
    )
    trim_tracking_bandwidth: float = parameter(
        3.0, "-", "bandwidth of the trim's tracking over the swing frequency", 0.5, 20.0
    )
    trim_fade_amplitude: float = parameter(
        0.0005, "rad", "swing amplitude below which the trim fades out", 1e-6, 0.1
    )
    pump_momentum: float = parameter(
        0.022, "N m s", "largest pumping momentum of the wheels", 0.0, 1.0
    )
    flywheel_momentum: float = parameter(
        0.05, "N m s", "largest pumping momentum of the flywheel", 0.0, 1.0
    )
    pump_travel: float = parameter(
        35.0, "rad", "largest screw travel from pumping, each way", 0.0, 1e4
    )
    pump_momentum_fraction: float = parameter(
        0.1, "-", "largest pumping momentum, as a fraction of the swing's own", 0.0, 1.0
    )
    pump_fade_amplitude: float = parameter(
        0.001, "rad", "swing amplitude below which the pumping fades out", 1e-6, 0.1
    )


class TrimStroke(NamedTuple):
    """Amplitude D of the trim, and its active bound."""

    length: float  # [m]
    bound: str  # rate, acceleration or share


class WinchTrim:
    """Trim of the winch against a swing.

    Args:
        parameters: bounds.
    """

    def __init__(self, parameters: DampingParameters) -> None:
        self.parameters = parameters

    def stroke(self, length: float, frequency: float) -> TrimStroke:
        """Amplitude D on a tether of this length [m] at a swing frequency [rad/s]."""
        p = self.parameters
        return min(
            TrimStroke(p.trim_rate / (2.0 * frequency), "rate"),
            TrimStroke(0.8 * p.trim_acceleration / (4.0 * frequency**2), "acceleration"),
            TrimStroke(p.trim_length_fraction * length, "share"),
        )

    def decay(self, length: float, frequency: float) -> float:
        """Decay rate [1/s] of the amplitude of a plane swing."""
        return 0.75 * self.stroke(length, frequency).length / length * frequency

    def rate(self, swing: SwingEstimate, length: float, offset: float) -> float:
        """Payout rate to add [m/s].

        Args:
            swing: estimate.
            length: payout without the trim [m].
            offset: length that the trim has added so far [m].
        """
        p, w = self.parameters, swing.frequency
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        along, square = x * vx + y * vy, x * x + y * y
        rate_square = (vx * vx + vy * vy) / (w * w)
        amplitude_square = square + rate_square
        if amplitude_square <= 0.0:
            return -p.trim_tracking_bandwidth * w * offset
        fade = (
            min(1.0, math.sqrt(amplitude_square) / p.trim_fade_amplitude - 1.0)
            if p.trim_fade_amplitude > 0.0
            else 1.0
        )
        stroke = max(fade, 0.0) * self.stroke(length, w).length
        setpoint = stroke * 2.0 * along / (amplitude_square * w)
        # u.u' changes at |u'|^2 - w^2 |u|^2.
        forward = stroke * 2.0 * w * (rate_square - square) / amplitude_square
        rate = forward + p.trim_tracking_bandwidth * w * (setpoint - offset)
        return min(max(rate, -p.trim_rate), p.trim_rate)
