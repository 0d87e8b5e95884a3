"""Model of drum, gear and motor. Pure.

Signs as in the contract: a positive payout rate lengthens the tether; a positive motor tension
reels in.

At the drum, with radius R, rate w = v/R and inertia J = J_d + N^2 J_m,

    J w' = R T - Q(motor, transmitted the gear) - friction(w).

A gear transmits `gear_efficiency` of the torque when the motor drives; a motor that brakes holds
1/`gear_backdrive_efficiency` of its own torque. `motor_tension` compensates this and the friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas.parameters import ParameterError, parameter

_TURN = 2.0 * math.pi
_CLIMB = 0.25  # turns over which the tether climbs to the next layer


@dataclass(frozen=True)
class DrumModelParameters:
    """Drum, gear, motor and tether, from their data sheets."""

    drum_radius: float = parameter(
        0.05,
        "m",
        "radius of the innermost layer, to the tether's centre line",
        0.005,
        2.0,
        read_only=True,
    )
    layer_pitch: float = parameter(
        0.0, "m", "growth of the radius per layer", 0.0, 0.1, read_only=True
    )
    turns_per_layer: float = parameter(40.0, "-", "turns per layer", 1.0, 1e4, read_only=True)
    tether_on_drum: float = parameter(
        60.0, "m", "total length of the tether", 0.1, 1000.0, read_only=True
    )
    drum_inertia: float = parameter(
        0.027, "kg m^2", "inertia of drum, gear and motor, reduced to the drum", 0.0, 100.0
    )
    gear_ratio: float = parameter(50.0, "-", "motor turns per drum turn", 1.0, 1000.0)
    gear_efficiency: float = parameter(
        0.85, "-", "efficiency of the gear, motor driving", 0.05, 1.0
    )
    gear_backdrive_efficiency: float = parameter(
        0.82, "-", "efficiency of the gear, load driving", 0.05, 1.0
    )
    drum_friction: float = parameter(0.05, "N m", "dry friction at the drum", 0.0, 100.0)
    drum_viscous: float = parameter(0.005, "N m s/rad", "viscous friction at the drum", 0.0, 10.0)
    friction_rate: float = parameter(
        0.01, "m/s", "payout rate over which the friction compensation builds up", 1e-4, 0.1
    )
    motor_torque: float = parameter(
        0.2, "N m", "current limit of the drive, as motor torque", 1e-3, 100.0
    )
    motor_continuous_torque: float = parameter(
        0.08, "N m", "continuous torque of the motor", 1e-3, 100.0
    )
    motor_thermal_time: float = parameter(
        60.0, "s", "thermal time constant of the motor's winding", 1.0, 3600.0
    )
    motor_stall_torque: float = parameter(
        0.6, "N m", "stall torque at the bus voltage, without the current limit", 1e-3, 1000.0
    )
    motor_no_load_rate: float = parameter(
        600.0, "rad/s", "no-load speed of the motor at the bus voltage", 1.0, 1e5
    )
    torque_constant: float = parameter(0.04, "N m/A", "torque constant of the motor", 1e-4, 10.0)
    line_density: float = parameter(0.005, "kg/m", "mass per length of the tether", 0.0, 10.0)
    axial_stiffness: float = parameter(2.0e4, "N", "axial stiffness EA of the tether", 1.0, 1e9)
    gravity: float = parameter(1.62, "m/s^2", "gravity at the winch", 0.0, 30.0)

    def __post_init__(self) -> None:
        """Refuse a motor whose limits contradict each other."""
        if self.motor_continuous_torque > self.motor_torque:
            msg = (
                f"motor_continuous_torque is {self.motor_continuous_torque:g} N m, it must not "
                f"be above motor_torque, {self.motor_torque:g} N m"
            )
            raise ParameterError(msg)


class DrumModel:
    """Winding radius by layer, and torques of motor and tether.

    Args:
        parameters: drum, motor and tether.
    """

    def __init__(self, parameters: DrumModelParameters) -> None:
        self.parameters = parameters

    def radius(self, length: float) -> float:
        """Radius [m] at which the tether leaves the drum at a payout of `length` [m]."""
        p = self.parameters
        if p.layer_pitch == 0.0:
            return p.drum_radius
        return self._radius_at(self._turns_wound(p.tether_on_drum - length))

    def hanging_weight(self, length: float) -> float:
        """Weight [N] of a hanging tether of this length [m]."""
        return self.parameters.line_density * self.parameters.gravity * max(length, 0.0)

    def bounce_period(self, length: float, weight: float) -> float:
        """Bounce period [s] of a rover of this weight [N] on a tether of this length [m]."""
        p = self.parameters
        if p.gravity == 0.0:
            return 0.0
        return _TURN * math.sqrt(weight * max(length, 0.0) / (p.gravity * p.axial_stiffness))

    def mass(self, length: float) -> float:
        """Drum inertia as a mass [kg] at the tether."""
        return self.parameters.drum_inertia / self.radius(length) ** 2

    def stiffness(self, length: float) -> float:
        """Axial stiffness [N/m] of a tether of this length [m]."""
        return self.parameters.axial_stiffness / max(length, 1e-3)

    def stretched(self, length: float, tension: float) -> float:
        """Stretched length [m] of a hanging tether with this tension [N] at its top."""
        p = self.parameters
        stretch = tension * length - 0.5 * self.hanging_weight(length) * length
        return length + max(stretch, 0.0) / p.axial_stiffness

    def largest_rate(self, length: float, tension: float) -> float:
        """Largest payout rate [m/s] at which the motor can still hold a tension [N]."""
        p = self.parameters
        torque = self.shaft_torque(abs(tension), length) / p.gear_efficiency
        share = max(0.0, 1.0 - torque / p.motor_stall_torque)
        return p.motor_no_load_rate * share / p.gear_ratio * self.radius(length)

    def shaft_torque(self, tension: float, length: float) -> float:
        """Motor shaft torque [N m] of a motor tension [N]."""
        return tension * self.radius(length) / self.parameters.gear_ratio

    def tension_of(self, shaft_torque: float, length: float) -> float:
        """Motor tension [N] of a motor shaft torque [N m]."""
        return shaft_torque * self.parameters.gear_ratio / self.radius(length)

    def motor_tension(
        self, tension: float, length: float, rate: float, acceleration: float
    ) -> float:
        """Motor tension [N] that balances a tether tension [N] in a given motion.

        Args:
            tension: tether tension at the drum [N].
            length: payout [m].
            rate: payout rate [m/s]; its sign selects the friction compensation.
            acceleration: payout acceleration [m/s^2].
        """
        p, r = self.parameters, self.radius(length)
        direction = math.tanh(rate / p.friction_rate)
        friction = p.drum_friction * direction + p.drum_viscous * rate / r
        required = tension - (friction + p.drum_inertia * acceleration / r) / r
        # The motor drives while its torque acts along the motion, that is while it reels in.
        driving = direction < 0.0 if required >= 0.0 else direction > 0.0
        factor = 1.0 / p.gear_efficiency if driving else p.gear_backdrive_efficiency
        return required * (1.0 + (factor - 1.0) * abs(direction))

    def tether_tension(
        self, motor_tension: float, length: float, rate: float, acceleration: float
    ) -> float:
        """Tether tension [N] from a motor tension [N]: the inverse of `motor_tension`."""
        p, r = self.parameters, self.radius(length)
        direction = math.tanh(rate / p.friction_rate)
        driving = direction < 0.0 if motor_tension >= 0.0 else direction > 0.0
        factor = 1.0 / p.gear_efficiency if driving else p.gear_backdrive_efficiency
        transmitted = motor_tension / (1.0 + (factor - 1.0) * abs(direction))
        friction = p.drum_friction * direction + p.drum_viscous * rate / r
        return transmitted + (friction + p.drum_inertia * acceleration / r) / r

    def _radius_at(self, turns: float) -> float:
        p = self.parameters
        layer = math.floor(max(turns, 0.0) / p.turns_per_layer)
        climb = max(turns - (layer + 1.0) * p.turns_per_layer + _CLIMB, 0.0)
        return p.drum_radius + p.layer_pitch * (layer + climb / _CLIMB)

    def _wound(self, turns: float) -> float:
        """Wound length [m]: 2 pi times the integral of the radius over the turns."""
        p = self.parameters
        n = p.turns_per_layer
        layer = math.floor(max(turns, 0.0) / n)
        climb = max(turns - (layer + 1.0) * n + _CLIMB, 0.0)
        below = 0.5 * n * layer * (layer - 1.0) + 0.5 * _CLIMB * layer
        current = layer * (turns - layer * n) + 0.5 * climb * climb / _CLIMB
        return _TURN * (p.drum_radius * turns + p.layer_pitch * (below + current))

    def _turns_wound(self, wound: float) -> float:
        """Inverse of `_wound` by Newton's method."""
        turns = wound / (_TURN * self.parameters.drum_radius)
        for _ in range(50):
            step = (self._wound(turns) - wound) / (_TURN * self._radius_at(turns))
            turns -= step
            if abs(step) <= 1e-12 * max(1.0, turns):
                break
        return turns
