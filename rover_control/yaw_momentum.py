"""The rover's turning about the tether: kept small, or used to rid it of a cone's momentum. Pure.

The momentum about the plumb line, the swing's and the rover's spin together, changes by nothing
but the torque of the twisted tether, -GJ/l times the twist, as long as the swivel does not slip.
A rover that is held at a twist by its rotors (`rotor_pump`) hands it to the mother through the
tether: with the twist held at

    twist = L/(T GJ/l),   at most `largest_twist` and what the swivel bears,

the momentum L falls with the time T, and the twist with it, so that both end at nothing. As GJ/l
falls with the length, this is to be done where the tether is short.

The loops are one within the other, each three times as slow: momentum, twist, yaw rate; the fastest
is as fast as the swing allows, whose velocity the rotors push against.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from rover_control.hanging_rover import HangingParameters
from rover_control.swing_estimator import SwingEstimate

_UNWINDING_FRACTION = 0.5  # of the largest yaw rate, that is counted on
_TWIST_LOOP, _MOMENTUM_LOOP = (
    3.0,
    7.0,
)  # times of the twist's loop and of the momentum's, over the rate's
_TORQUE_RAMP = 2.0  # radians of the swing in which the torque comes up
_MOMENTUM_FILTER = math.tau  # radians of the swing over which the momentum is smoothed


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
    """What predict_transfer the momentum about the plumb line on would take."""

    momentum: float  # of swing and spin [N m s]
    time: float  # [s]; inf = the tether passes nothing on
    twist_acceleration: float  # yaw acceleration by the tether's twist [rad/s^2]


class YawMomentumController:
    """Torque about the plumb line that is to be had.

    Args:
        parameters: times and bounds.
        hanging: the rover.
    """

    def __init__(self, parameters: YawParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self._torque = 0.0  # [N m]
        self._momentum = math.nan  # followed [N m s]
        self._filter_phase = 0.0  # for so long, in radians of the swing

    def restart(self) -> None:
        """Follow the momentum anew: something pushed the rover."""
        self._filter_phase = 0.0

    def momentum(self, swing: SwingEstimate, length: float) -> float:
        """About the plumb line, of swing and spin [N m s]."""
        (x, y), (vx, vy) = swing.direction, swing.direction_rate
        turning = self.hanging.pendulum_inertia(length) * (x * vy - y * vx)
        return turning + self.hanging.inertia_about_z * swing.yaw_rate

    def twist_bound(self, length: float) -> float:
        """Twist that so much tether [m] may have [rad]."""
        p, torsion = self.parameters, self.hanging.torsional_stiffness(length)
        if torsion <= 0.0:
            return 0.0
        return min(
            p.largest_twist, p.swivel_friction_fraction * self.hanging.swivel_friction / torsion
        )

    def predict_transfer(
        self, swing: SwingEstimate, twist: float, length: float
    ) -> MomentumTransfer:
        """What it would take from here, by swing, twist [rad] and length [m]."""
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
        """Advance by h; returns the torque about the plumb line that the swing shall give [N m].

        Args:
            swing: as estimated.
            twist: of the tether, as the rover has turned about +z [rad].
            length: paid out [m].
            largest: torque that the swing can give now [N m].
            h: duration [s].
            transfers: the momentum is to be handed to the mother.
            unwinds: the twist is to be taken out; with neither of both the rover shall not turn.
        """
        p, torsion = self.parameters, self.hanging.torsional_stiffness(length)
        quick = p.yaw_rate_phase / swing.frequency
        momentum = self._filter_momentum(swing, torsion * twist, length, h)
        rate = goal = 0.0
        if unwinds:
            rate = -twist / (_TWIST_LOOP * quick)
        elif transfers and torsion > 0.0:
            wanted, follows = self._unwinding(abs(momentum) / torsion, _MOMENTUM_LOOP * quick)
            if wanted > self.twist_bound(length):
                wanted, follows = self.twist_bound(length), 0.0
            goal = math.copysign(wanted, momentum)
            away = goal - twist
            # What is begun must be stopped again, with half of the torque that there is.
            stopped = math.sqrt(abs(away) * largest / self.hanging.inertia_about_z)
            rate = min(max(away / (_TWIST_LOOP * quick), -stopped), stopped) - follows * twist
        if rate * twist < 0.0 <= goal * twist:
            # Not past no twist at all.
            most = math.sqrt(abs(twist) * largest / self.hanging.inertia_about_z)
            rate = min(max(rate, -most), most)
        rate = min(max(rate, -p.largest_yaw_rate), p.largest_yaw_rate)
        need = self.hanging.inertia_about_z * (rate - swing.yaw_rate) / quick
        need = min(max(need + torsion * twist, -largest), largest)
        # Softly: where it changes its sign, so do the rotors' momenta.
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
        """Twist [rad] that hands the rest of a momentum on while it is unwound to nothing.

        Unwound at a steady rate, and at the end within a time.

        Args:
            left: momentum over GJ/l [rad s].
            time: of the end [s].

        Returns:
            The twist, and how it falls over the twist that there is [1/s].
        """
        rate = _UNWINDING_FRACTION * self.parameters.largest_yaw_rate
        last = rate * time  # twist from which on it ends
        if left <= last * time:
            return left / time, 1.0 / time
        twist = math.sqrt(last**2 + 2.0 * rate * (left - last * time))
        return twist, rate / twist
