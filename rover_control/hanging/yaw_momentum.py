"""Control of yaw and of the momentum about the plumb line. Pure.

The momentum about the plumb line, of swing and spin together, is changed only by the torque of the
twisted tether, -GJ/l times the twist, as long as the swivel does not slip. A rover whose rotors
(`rotor_pump`) hold it at a twist transfers its momentum to the mother machine through the tether:
with the twist

    twist = L/(T GJ/l),   at most `largest_twist` and the swivel's friction,

the momentum L decays with the time constant T, and the twist with it, so that both end at zero. As
GJ/l falls with the length, the transfer works best on a short tether.

Three cascaded loops control momentum, twist and yaw rate, each about three times as slow as the one
inside; the innermost is limited by the swing, whose rate the rotors push against.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate

_UNWINDING_FRACTION = 0.5  # fraction of the largest yaw rate that is assumed
_TWIST_LOOP, _MOMENTUM_LOOP = 3.0, 7.0  # time constants over the rate loop's
_TORQUE_RAMP = 2.0  # ramp of the torque, in radians of the swing
_MOMENTUM_FILTER = math.tau  # low-pass of the momentum, in radians of the swing


@dataclass(frozen=True)
class YawParameters:
    """Control of the yaw about the tether."""

    largest_twist: float = parameter(10.0, "rad", "largest twist of the tether", 0.0, 1e3)
    swivel_friction_fraction: float = parameter(
        0.7, "-", "fraction of the swivel's friction that the twist may use", 0.0, 1.0
    )
    yaw_rate_phase: float = parameter(
        5.0, "rad", "swing phase over which a yaw rate error is corrected", 0.5, 100.0
    )
    largest_yaw_rate: float = parameter(
        0.15, "rad/s", "largest yaw rate of the rover about the tether", 0.0, 5.0
    )


class MomentumTransfer(NamedTuple):
    """Prediction of a transfer of the momentum about the plumb line."""

    momentum: float  # of swing and spin [N m s]
    time: float  # [s]; inf = not possible
    twist_acceleration: float  # yaw acceleration from the twist [rad/s^2]


class YawMomentumController:
    """Controller of the torque about the plumb line.

    Args:
        parameters: time constants and bounds.
        hanging: rover and tether.
    """

    def __init__(self, parameters: YawParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self._torque = 0.0  # [N m]
        self._momentum = math.nan  # filtered [N m s]
        self._filter_phase = 0.0  # since the restart, in radians of the swing

    def restart(self) -> None:
        """Restart the momentum filter after a disturbance."""
        self._filter_phase = 0.0

    def momentum(self, swing: SwingEstimate, length: float) -> float:
        """Momentum about the plumb line, of swing and spin [N m s]."""
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        turning = self.hanging.pendulum_inertia(length) * (x * vy - y * vx)
        return turning + self.hanging.inertia_about_z * swing.yaw_rate

    def twist_bound(self, length: float) -> float:
        """Largest twist [rad] of a tether of this length [m]."""
        p, torsion = self.parameters, self.hanging.torsional_stiffness(length)
        if torsion <= 0.0:
            return 0.0
        return min(
            p.largest_twist, p.swivel_friction_fraction * self.hanging.swivel_friction / torsion
        )

    def predict_transfer(
        self, swing: SwingEstimate, twist: float, length: float
    ) -> MomentumTransfer:
        """Predict a momentum transfer from a swing, a twist [rad] and a length [m]."""
        torsion = self.hanging.torsional_stiffness(length)
        momentum = self._momentum if self._filter_phase > 0.0 else self.momentum(swing, length)
        most = self.twist_bound(length) * torsion
        time = math.inf
        if most > 0.0:
            unwinding = self.twist_bound(length) / self.parameters.largest_yaw_rate
            time = abs(momentum) / most + unwinding + 30.0 / swing.frequency
        return MomentumTransfer(momentum, time, -torsion * twist / self.hanging.inertia_about_z)

    def step(
        self,
        swing: SwingEstimate,
        twist: float,
        length: float,
        largest: float,
        h: float,
        *,
        transfers: bool,
        unwinds: bool = False,
    ) -> float:
        """Advance by h; returns the torque setpoint about the plumb line [N m].

        Args:
            swing: estimate.
            twist: of the tether, the rover's turn about +z [rad].
            length: payout [m].
            largest: largest torque that the swing allows now [N m].
            h: duration [s].
            transfers: transfer the momentum to the mother machine.
            unwinds: remove the twist; with neither, the yaw rate setpoint is zero.
        """
        p, torsion = self.parameters, self.hanging.torsional_stiffness(length)
        quick = p.yaw_rate_phase / swing.frequency
        momentum = self._filter_momentum(swing, torsion * twist, length, h)
        rate = goal = 0.0
        if unwinds:
            rate = -twist / (_TWIST_LOOP * quick)
        elif transfers and torsion > 0.0:
            setpoint, follows = self._unwinding(abs(momentum) / torsion, _MOMENTUM_LOOP * quick)
            if setpoint > self.twist_bound(length):
                setpoint, follows = self.twist_bound(length), 0.0
            goal = math.copysign(setpoint, momentum)
            away = goal - twist
            # Leave half of the torque for stopping.
            stopped = math.sqrt(abs(away) * largest / self.hanging.inertia_about_z)
            rate = min(max(away / (_TWIST_LOOP * quick), -stopped), stopped) - follows * twist
        if rate * twist < 0.0 <= goal * twist:
            # Do not overshoot zero twist.
            most = math.sqrt(abs(twist) * largest / self.hanging.inertia_about_z)
            rate = min(max(rate, -most), most)
        rate = min(max(rate, -p.largest_yaw_rate), p.largest_yaw_rate)
        need = self.hanging.inertia_about_z * (rate - swing.yaw_rate) / quick
        need = min(max(need + torsion * twist, -largest), largest)
        # Ramp it: the rotor momenta change sign with it.
        change = largest * swing.frequency * h / _TORQUE_RAMP
        self._torque = min(max(need, self._torque - change), self._torque + change)
        self._torque = min(max(self._torque, -largest), largest)
        return self._torque

    def _filter_momentum(
        self, swing: SwingEstimate, twist_torque: float, length: float, h: float
    ) -> float:
        """Filter the momentum about the plumb line; the twist torque [N m] changes it."""
        now = self.momentum(swing, length)
        if self._filter_phase == 0.0:
            self._momentum = now
        self._filter_phase += swing.frequency * h
        share = swing.frequency * h / min(self._filter_phase, _MOMENTUM_FILTER)
        self._momentum += share * (now - self._momentum) - twist_torque * h
        return self._momentum

    def _unwinding(self, left: float, time: float) -> tuple[float, float]:
        """Twist [rad] that transfers the rest of a momentum while it unwinds to zero.

        It unwinds at a constant rate, and exponentially at the end.

        Args:
            left: momentum over GJ/l [rad s].
            time: time constant of the end [s].

        Returns:
            The twist, and its relative decay rate [1/s].
        """
        rate = _UNWINDING_FRACTION * self.parameters.largest_yaw_rate
        last = rate * time  # twist at which the exponential end begins
        if left <= last * time:
            return left / time, 1.0 / time
        twist = math.sqrt(last**2 + 2.0 * rate * (left - last * time))
        return twist, rate / twist
