"""Attitude control of the hanging rover by reaction wheels. Pure.

The law of `attitude_gains` commands a momentum per axis, within a budget. Near saturation the axis
reports it and stops adding momentum outward, while desaturation reduces the stored momentum.

- About base_link y the left wheel is the reaction wheel. It turns backward at a bias rate: the
  ratchet then never drives the right wheel, and the friction keeps its sign instead of sticking at
  zero rate. During imaging the bias is small, as it yaws a swinging rover by its momentum times the
  swing over the inertia about z; during pumping it is large. The drive's rate loop compensates the
  friction.
- About base_link x the flywheel is the reaction wheel while the nut is clear of the latch. Its
  drive takes a torque, so this module compensates the friction. The flywheel turns the screw, so
  the screw's travel is a second budget; it allows a bias only during imaging, toward the middle.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from msg_schemas.parameters import parameter
from rover_control.hanging.attitude_gains import AttitudeDesign, AxisGains, design_axis
from rover_control.hanging.hanging_rover import HangingParameters

_MIN_BUDGET = 1e-6  # of a wheel at rest [N m s]
_SPENT, _RECOVERED = 0.8, 0.5  # fractions of a budget, with hysteresis
_ROUNDING = 1e-6  # of times [s]
_RECOVERY_TIME = 6.0  # some tilt periods, before the saturation clears [s]


@dataclass(frozen=True)
class RotorParameters:
    """Budgets and friction of the rotors."""

    wheel_pump_bias: float = parameter(
        -5.0, "rad/s", "bias rate of the left wheel while it pumps, backward", -20.0, -0.1
    )
    wheel_quiet_bias: float = parameter(
        -1.0, "rad/s", "bias rate of the left wheel without pumping, backward", -20.0, -0.01
    )
    wheel_rate_fraction: float = parameter(
        0.9, "-", "largest deviation from the bias rate, as a fraction of it", 0.1, 1.0
    )
    wheel_acceleration: float = parameter(
        1.0, "rad/s^2", "acceleration limit of the wheel toward its bias rate", 0.01, 20.0
    )
    wheel_torque: float = parameter(1.0, "N m", "torque limit of the wheel motor", 0.05, 20.0)
    flywheel_rate: float = parameter(200.0, "rad/s", "largest rate of the flywheel", 1.0, 1e3)
    flywheel_torque: float = parameter(
        0.12, "N m", "torque limit of the flywheel's motor", 1e-3, 1.0
    )
    flywheel_friction: float = parameter(5.0e-3, "N m", "dry friction of the flywheel", 0.0, 1.0)
    flywheel_friction_rate: float = parameter(
        1.0, "rad/s", "rate over which the friction compensation builds up", 1e-3, 100.0
    )
    flywheel_viscous: float = parameter(
        1.0e-5, "N m s/rad", "viscous friction of the flywheel", 0.0, 0.1
    )
    flywheel_rate_gain: float = parameter(
        20.0, "1/s", "gain of the flywheel's rate loop", 0.1, 100.0
    )
    flywheel_bias: float = parameter(
        1.5, "rad/s", "bias rate of the flywheel during imaging", 0.0, 100.0
    )
    flywheel_bias_ramp: float = parameter(
        1.5, "rad/s^2", "ramp of the flywheel's bias and of its return to the middle", 0.01, 100.0
    )
    screw_travel_centre: float = parameter(
        -94.2, "rad", "screw angle at the middle of the nut's free travel", -1e4, 1e4
    )
    screw_travel: float = parameter(70.0, "rad", "largest deviation from the middle", 0.1, 1e4)
    screw_travel_gain: float = parameter(
        0.8, "1/s", "largest screw rate over the remaining travel", 0.1, 100.0
    )
    screw_return_time: float = parameter(
        8.0, "s", "time constant of the return to the middle", 1.0, 600.0
    )


class AxisControl:
    """Momentum that damps the tilt of one axis, within a budget.

    Args:
        name: axis and rotor, for messages.
        gains: gains of the law.
        budget: largest momentum [N m s].
    """

    def __init__(self, name: str, gains: AxisGains, budget: float) -> None:
        self.name = name
        self.gains = gains
        self.budget = budget
        self.momentum = 0.0
        self.saturation = ""
        self._is_spent = False
        self._recovery_time = 0.0  # time since it was last spent [s]

    def step(self, tilt_rate: float, h: float, spent: float = 0.0, description: str = "") -> float:
        """Advance by h; returns the momentum setpoint [N m s].

        Args:
            tilt_rate: q, less the rate that pumping and coning induce [rad/s].
            h: duration [s].
            spent: signed fraction of another budget that is spent.
            description: description of that budget.
        """
        torque = self.gains.rate * tilt_rate - self.gains.desaturation * self.momentum
        own = self.momentum / self.budget
        used, text = own, f"momentum {self.momentum:.3g} of {self.budget:.3g} N m s"
        if abs(spent) > abs(own):
            used, text = spent, description
        if abs(used) >= _SPENT:
            self._is_spent, self._recovery_time = True, 0.0
            self.saturation = self.saturation or f"{self.name} cannot hold the attitude: {text}"
        elif abs(used) < _RECOVERED:
            self._is_spent = False
            self._recovery_time += h
            # A tilt that is too large spends the budget in every half period.
            if self._recovery_time > _RECOVERY_TIME:
                self.saturation = ""
        if self._is_spent and torque * used > 0.0:
            torque = -self.gains.desaturation * self.momentum
        self.momentum += torque * h
        self.momentum = min(max(self.momentum, -self.budget), self.budget)
        return self.momentum


class WheelReaction:
    """The left wheel as the reaction wheel about base_link y.

    Args:
        hanging: the rover.
        rotors: budgets.
        design: requirements on the law.
    """

    def __init__(
        self, hanging: HangingParameters, rotors: RotorParameters, design: AttitudeDesign
    ) -> None:
        self.rotors = rotors
        self.inertia = hanging.wheel_inertia
        gains = design_axis(hanging.inertia_about_y, hanging.stiffness, design)
        budget = -rotors.wheel_rate_fraction * rotors.wheel_pump_bias * self.inertia
        self.axis = AxisControl("wheels about y", gains, budget)
        self._bias = 0.0

    @property
    def is_quiet(self) -> bool:
        """Whether the wheel is at its quiet bias."""
        return self._bias == self.rotors.wheel_quiet_bias

    def start_from(self, rate: float) -> None:
        """Start from the present rate [rad/s] of the left wheel; a step would tilt the rover."""
        self._bias = min(rate, self.rotors.wheel_quiet_bias)

    def step(self, tilt_rate: float, pumped: float, h: float, *, pumps: bool) -> float:
        """Advance by h; returns the rate setpoint of the left wheel [rad/s].

        Args:
            tilt_rate: along x, less the induced rate [rad/s].
            pumped: pumping momentum along x [N m s].
            h: duration [s].
            pumps: pumping, now or soon.
        """
        p = self.rotors
        change = p.wheel_acceleration * h
        goal = p.wheel_pump_bias if pumps else p.wheel_quiet_bias
        self._bias = min(max(goal, self._bias - change), self._bias + change)
        self.axis.budget = max(-p.wheel_rate_fraction * self._bias * self.inertia, _MIN_BUDGET)
        share = min(self._bias / p.wheel_pump_bias, 1.0)
        total = self.axis.step(tilt_rate, h) + share * pumped
        # Momentum along x is a rotation about -y.
        return self._bias - min(max(total, -self.axis.budget), self.axis.budget) / self.inertia


class FlywheelReaction:
    """The jump motor's flywheel as the reaction wheel about base_link x.

    Args:
        hanging: the rover.
        rotors: budgets.
        design: requirements on the law.
    """

    def __init__(
        self, hanging: HangingParameters, rotors: RotorParameters, design: AttitudeDesign
    ) -> None:
        self.rotors = rotors
        self.inertia = hanging.flywheel_inertia
        gains = design_axis(hanging.inertia_about_x, hanging.stiffness, design)
        self.axis = AxisControl("flywheel about x", gains, rotors.flywheel_rate * self.inertia)
        self._side = 0.0  # sign of the bias
        self._bias_rate = 0.0  # bias rate, or rate toward the middle of the travel [rad/s]
        self._rate_setpoint = 0.0  # of the screw [rad/s]
        self._offset = 0.0  # from the middle of the travel [rad]
        self._elapsed = 0.0  # [s]
        self._sent: deque[tuple[float, float]] = deque()  # time [s], change of the rate [rad/s]

    @property
    def is_near_end(self) -> bool:
        """Whether the nut is too near an end of its travel for a bias."""
        return abs(self._offset) > 0.7 * self.rotors.screw_travel

    def step(
        self,
        tilt_rate: float,
        pumped: float,
        integral: float,
        angle: float,
        rate: float,
        age: float,
        h: float,
        *,
        quiet: bool,
    ) -> float:
        """Advance by h; returns the motor's torque [N m].

        Args:
            tilt_rate: along y, less the induced rate [rad/s].
            pumped: pumping momentum along y [N m s].
            integral: integral of that, about zero mean [N m s^2].
            angle: screw angle [rad].
            rate: flywheel rate [rad/s].
            age: of angle and rate [s].
            h: duration [s].
            quiet: imaging, now or soon.
        """
        p = self.rotors
        offset = self._offset = angle - p.screw_travel_centre
        text = f"travel {offset:.3g} of {p.screw_travel:.3g} rad"
        momentum = self.axis.step(tilt_rate, h, offset / p.screw_travel, text)
        if not quiet:
            self._side = 0.0
        elif self._side == 0.0:
            self._side = -math.copysign(1.0, offset)
        bias_rate = self._side * p.flywheel_bias
        if not quiet:
            bias_rate = -(offset - integral / self.inertia) / p.screw_return_time
        # A step would tilt the rover.
        ramp = p.flywheel_bias_ramp * h
        self._bias_rate = min(max(bias_rate, self._bias_rate - ramp), self._bias_rate + ramp)
        setpoint = (momentum + pumped) / self.inertia + self._bias_rate
        # Slow down toward the end of the travel; a hard stop would tilt the rover.
        room = p.screw_travel - math.copysign(offset, offset * setpoint)
        most = max(p.screw_travel_gain * room, 0.0)
        setpoint = min(max(setpoint, -most), most)
        change, self._rate_setpoint = setpoint - self._rate_setpoint, setpoint
        coming = rate + self._rate_change_sent(age, h)
        torque = self.inertia * (change / h + p.flywheel_rate_gain * (setpoint - coming))
        friction = p.flywheel_friction * math.tanh(setpoint / p.flywheel_friction_rate)
        friction += p.flywheel_viscous * coming
        torque = min(max(torque + friction, -p.flywheel_torque), p.flywheel_torque)
        self._sent.append((self._elapsed, (torque - friction) * h / self.inertia))
        return torque

    def _rate_change_sent(self, age: float, h: float) -> float:
        """Change of the rate [rad/s] by commands whose effect a sample of this age does not show.

        Commands are taken to travel for as long as samples, and to act for a step. Without it the
        rate loop would oscillate from a delay of pi/2 over its gain on, 80 ms.
        """
        self._elapsed += h
        while self._sent and self._sent[0][0] <= self._elapsed - 2.0 * age - h + _ROUNDING:
            self._sent.popleft()
        return sum(change for _, change in self._sent)
