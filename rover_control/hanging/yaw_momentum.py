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

A tether that turns on the floor have wound spins the rover with more than the swing can hold. The
torque on the rover

    w (L - 3 I_z w_z) - 2 GJ/l twist,    w^2 = GJ/(l I_z),

gives twist, yaw rate and momentum three poles at -w, so that they end at zero together: the tether
itself turns the rover back, past zero twist, until the momentum has gone to the mother machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from msg_schemas.parameters import parameter
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.twist_observer import NO_CORRECTION, TwistObserver

_UNWINDING_FRACTION = 0.5  # fraction of the largest yaw rate that is assumed
_TWIST_LOOP, _MOMENTUM_LOOP = 3.0, 7.0  # time constants over the rate loop's
_TORQUE_RAMP = 2.0  # ramp of the torque, in radians of the swing


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


class YawTask(Enum):
    """What the torque about the plumb line is for."""

    HOLD = auto()  # no yaw rate
    TRANSFER = auto()  # the momentum goes to the mother machine
    UNWIND = auto()  # no twist; the momentum stays
    RELAX = auto()  # neither twist nor yaw rate nor momentum, on a tether wound by turns


class MomentumTransfer(NamedTuple):
    """Prediction of a transfer of the momentum about the plumb line."""

    momentum: float  # of swing and spin [N m s]
    time: float  # [s]; inf = not possible
    twist_acceleration: float  # yaw acceleration from the twist [rad/s^2]
    twist_amplitude: float  # of the rover left to turn to and fro [rad]


class YawMomentumController:
    """Controller of the torque about the plumb line.

    Args:
        parameters: time constants and bounds.
        hanging: rover and tether.

    Attributes:
        observer: of the momentum.
        correction: of twist and yaw bias, by the last step.
    """

    def __init__(self, parameters: YawParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        self.observer = TwistObserver(hanging)
        self.correction = NO_CORRECTION
        self._torque = 0.0  # [N m]

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
        observer = self.observer
        momentum, yaw_rate = observer.measured(swing, length), swing.yaw_rate
        if observer.is_running:
            momentum, yaw_rate = observer.momentum, observer.yaw_rate
        frequency = self.hanging.torsional_frequency(length)
        amplitude = math.hypot(twist, yaw_rate / frequency) if frequency > 0.0 else 0.0
        most = self.twist_bound(length) * torsion
        time = math.inf
        if most > 0.0:
            unwinding = self.twist_bound(length) / self.parameters.largest_yaw_rate
            time = abs(momentum) / most + unwinding + 30.0 / swing.frequency
        return MomentumTransfer(momentum, time, -(frequency**2) * twist, amplitude)

    def step(
        self,
        swing: SwingEstimate,
        twist: float,
        length: float,
        largest: float,
        h: float,
        task: YawTask,
    ) -> float:
        """Advance by h; returns the torque setpoint about the plumb line [N m].

        Args:
            swing: estimate.
            twist: of the tether, the rover's turn about +z [rad].
            length: payout [m].
            largest: largest torque that the swing allows now [N m].
            h: duration [s].
            task: what the torque is for.
        """
        torsion = self.hanging.torsional_stiffness(length)
        self.correction = self.observer.step(swing, twist, length, h)
        momentum = self.observer.momentum
        if task is YawTask.RELAX:
            spin = self.hanging.inertia_about_z * swing.yaw_rate
            need = self.hanging.torsional_frequency(length) * (momentum - 3.0 * spin)
            need -= 2.0 * torsion * twist
        else:
            need = torsion * twist + self._following(swing, momentum, twist, length, largest, task)
        need = min(max(need, -largest), largest)
        # Ramp it: the rotor momenta change sign with it.
        change = largest * swing.frequency * h / _TORQUE_RAMP
        self._torque = min(max(need, self._torque - change), self._torque + change)
        self._torque = min(max(self._torque, -largest), largest)
        return self._torque

    def _following(
        self,
        swing: SwingEstimate,
        momentum: float,
        twist: float,
        length: float,
        largest: float,
        task: YawTask,
    ) -> float:
        """Torque [N m] of the cascaded loops, on top of the twist's."""
        p, torsion = self.parameters, self.hanging.torsional_stiffness(length)
        quick = p.yaw_rate_phase / swing.frequency
        rate = goal = 0.0
        if task is YawTask.UNWIND:
            rate = -twist / (_TWIST_LOOP * quick)
        elif task is YawTask.TRANSFER and torsion > 0.0:
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
        return self.hanging.inertia_about_z * (rate - swing.yaw_rate) / quick

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
