"""Damping of the swing by the winch's trim. Pure.

Paying out while the rover swings outward and reeling in while it swings inward damps the swing:
with A^2 = |u|^2 + |u'|^2/w^2,

    dl = D 2 u.u'/(A^2 w),    with the damping ratio 3/4 D/l.

With the opposite sign it raises the swing by the same ratio.

The trim runs at twice the swing frequency w. Its amplitude D is bounded by the drum's rate,
D <= v/2w, by its acceleration, D <= 0.8 a/4w^2 (a trim that lags would feed the swing), and by
0.15 l. On a circle u.u' = 0: the winch turns an ellipse into a circle and can do no more. The rest
is the task of `rotor_pump` and `yaw_momentum`.

The trim follows dl on a trajectory of its own, with 1/0.8 of the acceleration that dl itself takes:
each change of the acceleration makes the rover bounce on the tether, and with all of the winch's
acceleration it would bounce by twice its weight at 50 m. It approaches dl no faster than the
acceleration that dl leaves can brake. The measured length, late by the way of the
trim to the winch and back, corrects the trajectory slowly. A loop through the measured length would
saturate the acceleration and swing the drum at 0.3 m/s on 2 m of tether with hops of 50 ms.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas import machine
from msg_schemas.parameters import parameter
from rover_control.hanging.swing_estimator import SwingEstimate

_STROKE_SHARE = 0.8  # of the trim's acceleration that the stroke takes [-]
_CORRECTION_PHASE = 10.0  # of the swing, over which the measured length corrects the trim [rad]


@dataclass(frozen=True)
class DampingParameters:
    """Bounds of winch trim and rotor pumping against a swing."""

    trim_rate: float = parameter(
        0.28, "m/s", "largest rate of the trim", 0.01, machine.MAX_RATE_TRIM
    )
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


class WinchTrim:
    """Trim of the winch against a swing.

    Args:
        parameters: bounds.
    """

    def __init__(self, parameters: DampingParameters) -> None:
        self.parameters = parameters
        self.restart()

    def restart(self) -> None:
        """Start the next trim from rest."""
        self._offset = math.nan  # length that the trim has added [m]
        self._rate = 0.0  # [m/s]

    def stroke(self, length: float, frequency: float) -> float:
        """Amplitude D [m] on a tether of this length [m] at a swing frequency [rad/s]."""
        p = self.parameters
        return min(
            p.trim_rate / (2.0 * frequency),
            _STROKE_SHARE * p.trim_acceleration / (4.0 * frequency**2),
            p.trim_length_fraction * length,
        )

    def decay(self, length: float, frequency: float) -> float:
        """Decay rate [1/s] of the amplitude of a plane swing."""
        return 0.75 * self.stroke(length, frequency) / length * frequency

    def step(
        self, swing: SwingEstimate, length: float, offset: float, h: float, sense: float = 1.0
    ) -> float:
        """Advance by h; returns the payout rate to add [m/s].

        Args:
            swing: estimate.
            length: payout without the trim [m].
            offset: measured length over it [m].
            h: duration [s].
            sense: 1 damps, -1 raises the swing.
        """
        p, w = self.parameters, swing.frequency
        if math.isnan(self._offset):
            self._offset = offset
        self._offset += min(w * h / _CORRECTION_PHASE, 1.0) * (offset - self._offset)
        setpoint, forward = self._setpoint(swing, length, sense)
        error = setpoint - self._offset
        taken = 4.0 * w * w * self.stroke(length, w)
        acceleration = min(p.trim_acceleration, taken / _STROKE_SHARE)
        spare = acceleration - taken
        approach = min(
            p.trim_tracking_bandwidth * w * abs(error), math.sqrt(2.0 * spare * abs(error))
        )
        goal = forward + math.copysign(approach, error)
        goal = min(max(goal, -p.trim_rate), p.trim_rate)
        change = acceleration * h
        self._rate = min(max(goal, self._rate - change), self._rate + change)
        self._offset += self._rate * h
        return self._rate

    def _setpoint(self, swing: SwingEstimate, length: float, sense: float) -> tuple[float, float]:
        """Length to add [m], and its rate of change [m/s]."""
        p, w = self.parameters, swing.frequency
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        along, square = x * vx + y * vy, x * x + y * y
        rate_square = (vx * vx + vy * vy) / (w * w)
        amplitude_square = square + rate_square
        if amplitude_square <= 0.0:
            return 0.0, 0.0
        fade = (
            min(1.0, math.sqrt(amplitude_square) / p.trim_fade_amplitude - 1.0)
            if p.trim_fade_amplitude > 0.0 and sense > 0.0
            else 1.0
        )
        stroke = sense * max(fade, 0.0) * self.stroke(length, w)
        # u.u' changes at |u'|^2 - w^2 |u|^2.
        forward = stroke * 2.0 * w * (rate_square - square) / amplitude_square
        return stroke * 2.0 * along / (amplitude_square * w), forward
