"""A shaft with dry friction: exact standstill, exact energy balance.

The shaft obeys J w' = D(direction) - F(w) direction - c w, with a drive torque D that may depend on
the direction of motion (a lossy gear transmits less torque when it drives than when it is driven),
dry friction F and a viscous coefficient c. Dry friction follows Stribeck's curve,
F(w) = F_c + (F_s - F_c) exp(-(w/w_s)^2), taken at the start of each piece of motion.

A step is divided where the shaft comes to rest. It remains at a rate of exactly zero as long as the
drive exceeds the breakaway friction in neither direction; otherwise it leaves rest in the same
step. So a step has at most two pieces, each with constant dry torques and the viscous torque at the
piece's mean rate (midpoint rule). A piece's angle is its duration times its mean rate; hence torque
times angle is its work to rounding, and J (w1^2 - w0^2)/2 is the sum of the works.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.named_parameters import from_parameters


@dataclass(frozen=True)
class FrictionParameters(Configuration):
    """Friction of a shaft's bearings, seals and gears: Stribeck curve and viscous friction."""

    coulomb: float = quantity("N m", "Coulomb friction torque", minimum=0.0)
    breakaway: float = quantity("N m", "breakaway torque, at least coulomb", minimum=0.0)
    stribeck_rate: float = quantity("rad/s", "Stribeck velocity", above=0.0)
    viscous: float = quantity("N m s/rad", "viscous coefficient", minimum=0.0)

    def check(self) -> None:
        """Refuse a breakaway torque below the sliding torque."""
        if self.breakaway < self.coulomb:
            raise ConfigurationError(
                "breakaway",
                self.breakaway,
                f"should be at least the coulomb torque of {self.coulomb:g} N m",
            )


class Friction(NamedTuple):
    """`FrictionParameters` for compiled functions."""

    coulomb: float
    breakaway: float
    stribeck_rate: float
    viscous: float


class ShaftMotion(NamedTuple):
    """Motion of a shaft in one step, in at most two pieces.

    The first piece keeps the sign of the starting rate and is empty if the shaft starts at rest;
    the second starts from rest and is empty if the shaft stays at rest.
    """

    rate: float  # at the end of the step [rad/s]
    first: float  # angle of the first piece [rad]
    first_time: float  # its duration [s]
    second: float  # angle of the second piece [rad]
    second_time: float  # its duration [s]


def make_friction(parameters: FrictionParameters) -> Friction:
    """Convert the parameters for compiled functions."""
    return from_parameters(Friction, parameters)


@checked_inner
def sliding_torque(friction: Friction, rate: float) -> float:
    """Dry friction F(w) [N m] by Stribeck's curve."""
    if friction.breakaway == friction.coulomb:
        return friction.coulomb
    ratio = rate / friction.stribeck_rate
    return friction.coulomb + (friction.breakaway - friction.coulomb) * math.exp(-ratio * ratio)


@checked_inner
def geared_torques(torque: float, efficiency: float, back_efficiency: float) -> tuple[float, float]:
    """Output torque of a lossy gear for forward and for backward motion [N m].

    A driving gear transmits `efficiency` times the torque; a driven one (its motor brakes) resists
    with torque / back_efficiency. The forward value never exceeds the backward one: between them
    the gear's friction holds the shaft at rest.
    """
    if torque >= 0.0:
        return torque * efficiency, torque / back_efficiency
    return torque / back_efficiency, torque * efficiency


@checked_inner
def advance_shaft(
    inertia: float,
    rate: float,
    forward: float,
    backward: float,
    forward_rest: float,
    backward_rest: float,
    viscous: float,
    h: float,
) -> ShaftMotion:
    """Advance a shaft by h.

    Args:
        inertia: J [kg m^2].
        rate: w at the start [rad/s].
        forward: drive minus dry friction in forward motion [N m].
        backward: drive plus dry friction in backward motion [N m].
        forward_rest: drive minus breakaway friction, forward [N m]; above 0 it leaves rest.
        backward_rest: drive plus breakaway friction, backward [N m]; below 0 it leaves rest.
        viscous: c [N m s/rad].
        h: duration [s].
    """
    first = 0.0
    first_time = 0.0
    if rate != 0.0:
        torque = forward if rate > 0.0 else backward
        drag = 0.5 * viscous * h
        end = (rate * (inertia - drag) + torque * h) / (inertia + drag)
        if end > 0.0 if rate > 0.0 else end < 0.0:
            return ShaftMotion(end, 0.5 * (rate + end) * h, h, 0.0, 0.0)
        braking = torque - 0.5 * viscous * rate
        first_time = min(h, -inertia * rate / braking) if braking != 0.0 else h
        first = 0.5 * rate * first_time
    torque = 0.0
    if forward_rest > 0.0:
        torque = forward_rest
    elif backward_rest < 0.0:
        torque = backward_rest
    left = h - first_time
    if torque == 0.0 or left <= 0.0:
        return ShaftMotion(0.0, first, first_time, 0.0, 0.0)
    end = torque * left / (inertia + 0.5 * viscous * left)
    return ShaftMotion(end, first, first_time, 0.5 * end * left, left)


@checked_inner
def cut_at_stop(motion: ShaftMotion, allowed: float) -> ShaftMotion:
    """Motion up to the angle of a stop; each piece keeps its mean rate."""
    if motion.first * allowed > 0.0 and abs(motion.first) >= abs(allowed):
        return ShaftMotion(0.0, allowed, motion.first_time * allowed / motion.first, 0.0, 0.0)
    if motion.second == 0.0:
        return ShaftMotion(0.0, allowed, 0.0, 0.0, 0.0)
    second = allowed - motion.first
    time = motion.second_time * second / motion.second
    return ShaftMotion(0.0, motion.first, motion.first_time, second, time)


@checked_inner
def directional_work(motion: ShaftMotion, forward: float, backward: float) -> float:
    """Work [J] of a torque that depends on the direction of motion."""
    first = forward if motion.first > 0.0 else backward
    second = forward if motion.second > 0.0 else backward
    return first * motion.first + second * motion.second


@checked_inner
def dry_heat(motion: ShaftMotion, sliding: float, breakaway: float) -> float:
    """Heat [J] of dry friction: sliding torque in the first piece, breakaway in the second."""
    return sliding * abs(motion.first) + breakaway * abs(motion.second)


@checked_inner
def viscous_heat(motion: ShaftMotion, viscous: float) -> float:
    """Heat [J] of viscous friction, at the mean rate of each piece."""
    heat = 0.0
    if motion.first_time > 0.0:
        heat += viscous * motion.first * motion.first / motion.first_time
    if motion.second_time > 0.0:
        heat += viscous * motion.second * motion.second / motion.second_time
    return heat


@checked_inner
def _second_by_first(motion: ShaftMotion) -> float:
    """Acceleration of the second piece over that of the first; 0 if one is empty."""
    if motion.first == 0.0 or motion.second == 0.0:
        return 0.0
    times = motion.first_time / motion.second_time
    return -motion.second / motion.first * times * times


@checked_inner
def angle_by_torque(motion: ShaftMotion, inertia: float) -> float:
    """Angle of a motion per torque [rad/(N m)] without viscous friction; inertia in [kg m^2]."""
    first, second = motion.first_time, motion.second_time
    both = first * second * _second_by_first(motion)
    return (0.5 * (first * first + second * second) + both) / inertia


@checked_inner
def rate_by_torque(motion: ShaftMotion, inertia: float) -> float:
    """Rate at the end of a motion per torque [rad/(N m s)]; zero for a shaft at rest."""
    if motion.rate == 0.0:
        return 0.0
    if motion.second_time > 0.0:
        return (motion.second_time + motion.first_time * _second_by_first(motion)) / inertia
    return motion.first_time / inertia


@checked_inner
def base_motion_work(
    inertia: float, rate: float, end: float, angle: float, base: float, base_end: float, h: float
) -> float:
    """Work [J] of a rotating base on a rotor whose relative rate changes from `rate` to `end`.

    The base's rate about the rotor's axis changes linearly from `base` to `base_end`. The change of
    the rotor's kinetic energy J (rate + base)^2/2 is this work plus that of the torques between the
    two over the relative `angle`, which include -J base'.
    """
    change = base_end - base
    return inertia * (
        end * base_end - rate * base - change / h * angle + 0.5 * change * (base_end + base)
    )
