"""Observer of the momentum about the plumb line, the tether's twist and the gyro's bias. Pure.

The momentum L, of swing and spin together, is changed only by the torque of the twisted tether. The
twist is the turn by the gyro, which drifts with the bias b of its rate about z:

    L' = -GJ/l twist,    twist' = w_z - b,    b' = 0.

The measured momentum is noisy by the swing's estimate. Its difference e from the expected one
corrects all three, at the rates l_1 e, -l_2 e and l_3 e: l_1 averages over a period of the swing,

    l_2 = w_t/N,    l_3 = GJ/l l_2^2/(4 l_1),

with the torsional frequency w_t, and the error N of the momentum, which is the swing's amplitude
times an error of its minor axis; l_3 gives two poles the same place, GJ/l l_2/(2 l_1). So the twist
shows the bias within minutes on 2 m of tether, and hardly on a long one, where its torque is small
and the swing's momentum large. A rover that turns to and fro by more than a radian, or a cone with
the momentum of such turning, shows errors of its mass and of the torsion instead.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate

_PERIOD = math.tau  # over which the momentum is averaged, in radians of the swing
_BEGIN = 4.0 * _PERIOD  # after a restart, until twist and bias are corrected
_LARGEST_TURN = 1.0  # amplitude of the turning to and fro up to which they are corrected [rad]
_SWING_ERROR = 0.9e-3  # of the ellipse's minor axis, 0.05 deg [rad]
_LEAST_SWING = 4.9e-3  # swing up to which the momentum is equally uncertain, 0.28 deg [rad]


class TwistCorrection(NamedTuple):
    """Changes by a step of the observer."""

    twist: float  # [rad]
    yaw_bias: float  # [rad/s]


NO_CORRECTION = TwistCorrection(0.0, 0.0)


class TwistObserver:
    """Observer of the momentum, and of errors of twist and yaw bias.

    Args:
        hanging: rover and tether.

    Attributes:
        momentum: about the plumb line, of swing and spin [N m s]; NaN before the first step.
        yaw_rate: mean over a period of the swing, whose damping turns the rover to and fro [rad/s].
    """

    def __init__(self, hanging: HangingParameters) -> None:
        self.hanging = hanging
        self.momentum = math.nan
        self.yaw_rate = 0.0
        self._phase = 0.0  # since the restart, in radians of the swing

    def restart(self) -> None:
        """Restart after a disturbance."""
        self._phase = 0.0

    @property
    def is_running(self) -> bool:
        """Whether it has made a step since the restart."""
        return self._phase > 0.0

    def measured(self, swing: SwingEstimate, length: float) -> float:
        """Momentum about the plumb line by the present estimate [N m s]."""
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        turning = self.hanging.pendulum_inertia(length) * (x * vy - y * vx)
        return turning + self.hanging.inertia_about_z * swing.yaw_rate

    def step(self, swing: SwingEstimate, twist: float, length: float, h: float) -> TwistCorrection:
        """Advance by h [s]; returns the corrections of a twist [rad] and of the yaw bias."""
        now, torsion = self.measured(swing, length), self.hanging.torsional_stiffness(length)
        if not self.is_running:
            self.momentum, self.yaw_rate = now, swing.yaw_rate
        self._phase += swing.frequency * h
        unexpected = now - self.momentum
        share = swing.frequency * h / min(self._phase, _PERIOD)
        self.momentum += share * unexpected - torsion * twist * h
        self.yaw_rate += share * (swing.yaw_rate - self.yaw_rate)
        frequency = self.hanging.torsional_frequency(length)
        if self._phase < _BEGIN or frequency == 0.0:
            return NO_CORRECTION
        turn = math.hypot(twist, self.yaw_rate / frequency)
        whole = abs(self.momentum) / (self.hanging.inertia_about_z * frequency)
        if max(turn, whole) > _LARGEST_TURN:
            return NO_CORRECTION
        noise = self.hanging.pendulum_inertia(length) * swing.frequency * _SWING_ERROR
        noise *= max(swing.ellipse.major, _LEAST_SWING)
        twist_gain = frequency / noise
        bias_gain = torsion * twist_gain**2 * _PERIOD / (4.0 * swing.frequency)
        return TwistCorrection(-twist_gain * unexpected * h, bias_gain * unexpected * h)
