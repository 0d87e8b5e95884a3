# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Winch drum: inertia, geared motor, friction, power-off brake, end stops, layers of tether.

    (J_d + N^2 J_m) w' = R T + N tau_m (through the gear) - friction(w) - brake,    v_pay = R w

with all torques at the drum; w > 0 pays out. T is the tether's pull at the drum. It may be
negative: a tether carries compression until it buckles, and if its end is paid out faster than it
falls, the drum does work on it. The wound tether's inertia is neglected (5 g/m on a drum of 0.05 m
radius: 100 m add 5 % to the default drum's). Standstill is exact (module `shaft`): while brake and
friction carry the load, the rate is exactly zero.

Brake. It is open only while powered. `release_brake` opens it after `release_delay`, its withdrawal
closes it after `engage_delay`; a change of the command restarts the delay. The closed brake is dry
friction of the torque `brake_torque`. The delays are resolved to the substep.

Stops. At `min_length` (fully reeled in) and `max_length` (fully paid out) the drum stops at once,
within a substep if necessary; its kinetic energy becomes heat.

Layers. With `layer_pitch` > 0 the tether is wound in layers of `turns_per_layer`: each layer's
radius is larger by the pitch, and over the last quarter turn of a layer the radius rises to the
next. The length is the integral of the payout rate; `length_at` computes it in closed form from
the angle.

Energy balance of every step, exact to rounding:
d(kinetic) = motor work + tension work - gear, friction, brake and stop heat.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, ConfigurationError, quantity
from rover_sim.physics.mechanisms.motor import (
    RATE,
    TORQUE,
    Motor,
    MotorParameters,
    make_motor,
    motor_torque,
)
from rover_sim.physics.mechanisms.shaft import (
    Friction,
    FrictionParameters,
    advance_shaft,
    cut_at_stop,
    directional_work,
    dry_heat,
    geared_torques,
    make_friction,
    sliding_torque,
    viscous_heat,
)
from rover_sim.physics.numerics.compiled import checked, checked_inner
from rover_sim.physics.numerics.named_parameters import from_parameters

_TURN = 2.0 * math.pi
_CLIMB = 0.25  # turns over which the tether rises to the next layer


@dataclass(frozen=True)
class DrumParameters(Configuration):
    """Drum, gear, motor and power-off brake of a winch; the tether's length limits the payout.

    Defaults: a winch for a 10 kg rover on the Moon, slow enough to need no more than 100 W. A
    weight of 16.2 N at 0.05 m needs 0.81 N m, so the brake's 2 N m are 2.5 times the weight.
    Reflected to the tether the drum's mass is J/R^2 = 11 kg, about the rover's.
    """

    radius: float = quantity("m", "of the innermost layer", 0.05, above=0.0)  # R, to tether's axis
    drum_inertia: float = quantity(  # J_d; a 1.5 kg aluminium drum
        "kg m^2", "of the drum", 2.0e-3, above=0.0
    )
    gear_ratio: float = quantity("-", "motor turns per drum turn", 50.0, above=0.0)
    motor_inertia: float = quantity("kg m^2", "of the rotor", 1.0e-5, minimum=0.0)
    efficiency: float = quantity(  # three planetary stages
        "-", "of the gear, motor driving", 0.85, above=0.0, maximum=1.0
    )
    back_efficiency: float = quantity(  # about 2 - 1/efficiency
        "-", "of the gear, load driving", 0.82, above=0.0, maximum=1.0
    )
    friction: FrictionParameters = configuration.section(
        FrictionParameters,
        "of the drum",
        FrictionParameters(coulomb=0.05, breakaway=0.07, stribeck_rate=0.2, viscous=0.005),
    )
    brake_torque: float = quantity("N m", "of the brake, at the drum", 2.0, minimum=0)
    engage_delay: float = quantity("s", "until the brake holds", 0.02, minimum=0.0)
    release_delay: float = quantity("s", "until the brake is open", 0.04, minimum=0.0)
    quick_stop_deceleration: float = quantity(
        "m/s^2",
        "of the payout rate, when the drive's commands time out",
        0.4,
        above=0.0,
        maximum=100.0,
    )
    min_length: float = quantity("m", "payout when fully reeled in", 0.0, minimum=0.0)
    layer_pitch: float = quantity(
        "m", "increase of the radius per layer; 0: constant", 0.0, minimum=0.0
    )
    turns_per_layer: float = quantity("-", "turns per layer", 40.0, above=0.0)
    motor: MotorParameters = configuration.section(
        MotorParameters,
        "the winch motor",
        MotorParameters(
            max_torque=0.2,  # lifts 10 kg under 9.81 m/s^2 as well (4.9 N m at the drum)
            stall_torque=0.6,
            no_load_rate=600.0,  # 0.5 m/s are 500 rad/s
            torque_constant=0.04,
            servo_bandwidth=40.0,
        ),
    )

    def check(self) -> None:
        """Refuse layers that are shorter than the climb to the next one."""
        if self.layer_pitch > 0.0 and self.turns_per_layer <= _CLIMB:
            raise ConfigurationError(
                "turns_per_layer",
                self.turns_per_layer,
                f"should be above {_CLIMB:g} with a layer_pitch",
            )


class Drum(NamedTuple):
    """`DrumParameters` for compiled functions."""

    radius: float
    inertia: float  # J_d + N^2 J_m
    gear_ratio: float
    efficiency: float
    back_efficiency: float
    friction: Friction
    brake_torque: float
    engage_delay: float
    release_delay: float
    min_length: float
    max_length: float
    layer_pitch: float
    turns_per_layer: float
    full_turns: float  # turns wound when nothing is paid out
    motor: Motor


class DrumState(NamedTuple):
    """State of the drum; `initial_state` makes one that is consistent."""

    angle: float  # drum angle, zero when nothing is paid out: the encoder [rad]
    length: float  # paid out, unstretched, at the drum [m]
    rate: float  # w [rad/s], > 0 pays out
    braked: bool  # whether the brake is closed
    brake_clock: float  # time since the opposite state was commanded [s]
    integral: float  # of the rate servo [N m]


class DrumCommand(NamedTuple):
    """Command to the drum. While the brake is closed the rate servo is off.

    The feed-forward torque acts against the closed brake too, so that the motor can carry the load
    before the brake opens.
    """

    mode: int  # MotorMode: OFF, TORQUE or RATE
    torque: float  # at the motor shaft [N m], > 0 pays out; with RATE: feed-forward
    payout_rate: float  # setpoint with RATE [m/s]
    max_torque: float  # at the motor shaft [N m]; inf: the motor's own limit
    release_brake: bool  # power the brake open


class DrumOutputs(NamedTuple):
    """Outputs of the drum in a step."""

    payout_rate: float  # mean of the step [m/s]: change of length / h
    motor_torque: float  # at the motor shaft [N m]
    current: float  # of the motor [A]
    stuck: bool  # at rest throughout the step
    stop: int  # -1: stop fully reeled in, +1: stop fully paid out, 0: neither


class DrumEnergyBalance(NamedTuple):
    """Energy balance of a step [J]; no heat is negative."""

    kinetic: float  # at the step's end
    motor_work: float  # of the motor on its shaft
    tension_work: float  # of the tether on the drum
    gear_heat: float
    friction_heat: float
    brake_heat: float
    stop_heat: float


def make_drum(parameters: DrumParameters, max_length: float) -> Drum:
    """Convert the parameters for compiled functions.

    Args:
        parameters: of the winch.
        max_length: paid-out length when fully paid out [m].

    Raises:
        ValueError: the length is not finite or not above `min_length`.
    """
    if not parameters.min_length < max_length < math.inf:
        raise ValueError(
            f"max_length = {max_length}: must be finite and above"
            f" min_length = {parameters.min_length} m"
        )
    drum = from_parameters(
        Drum,
        parameters,
        inertia=parameters.drum_inertia + parameters.gear_ratio**2 * parameters.motor_inertia,
        friction=make_friction(parameters.friction),
        max_length=float(max_length),
        full_turns=0.0,
        motor=make_motor(parameters.motor),
    )
    return drum._replace(full_turns=_turns_wound(drum, drum.max_length))


def initial_state(drum: Drum, length: float) -> DrumState:
    """State of a braked drum at rest with a paid-out length [m].

    Raises:
        ValueError: the length lies outside the drum's stops.
    """
    if not drum.min_length <= length <= drum.max_length:
        raise ValueError(
            f"length = {length}: must lie between {drum.min_length} and {drum.max_length} m"
        )
    turns = drum.full_turns - _turns_wound(drum, drum.max_length - length)
    return DrumState(_TURN * turns, float(length), 0.0, True, 0.0, 0.0)


def _turns_wound(drum: Drum, wound: float) -> float:
    """Inverse of `wound_length` by Newton's method; it converges because the length is convex."""
    turns = wound / (_TURN * drum.radius)
    for _ in range(100):
        step = (wound_length(drum, turns) - wound) / (_TURN * radius_at(drum, turns))
        turns -= step
        if abs(step) <= 1e-14 * max(1.0, turns):
            break
    return float(turns)


@checked
def radius_at(drum: Drum, turns: float) -> float:
    """Radius [m] of the outermost turn when `turns` are wound."""
    if drum.layer_pitch == 0.0:
        return drum.radius
    layer = math.floor(max(turns, 0.0) / drum.turns_per_layer)
    climb = max(turns - (layer + 1.0) * drum.turns_per_layer + _CLIMB, 0.0)
    return drum.radius + drum.layer_pitch * (layer + climb / _CLIMB)


@checked
def wound_length(drum: Drum, turns: float) -> float:
    """Length [m] of `turns` wound: 2 pi times the integral of `radius_at`."""
    if drum.layer_pitch == 0.0:
        return _TURN * drum.radius * turns
    n = drum.turns_per_layer
    layer = math.floor(max(turns, 0.0) / n)
    climb = max(turns - (layer + 1.0) * n + _CLIMB, 0.0)
    layers = 0.5 * n * layer * (layer - 1.0) + 0.5 * _CLIMB * layer  # full layers below
    current = layer * (turns - layer * n) + 0.5 * climb * climb / _CLIMB
    return _TURN * (drum.radius * turns + drum.layer_pitch * (layers + current))


@checked_inner
def length_at(drum: Drum, angle: float) -> float:
    """Paid-out length [m] at a drum angle [rad], in closed form."""
    return drum.max_length - wound_length(drum, drum.full_turns - angle / _TURN)


@checked_inner
def payout_rate(drum: Drum, state: DrumState) -> float:
    """Payout rate of the tether at the drum [m/s]."""
    return radius_at(drum, drum.full_turns - state.angle / _TURN) * state.rate


@checked_inner
def _brake(drum: Drum, state: DrumState, release: bool, h: float) -> tuple[bool, float]:
    """Whether the brake is closed in the step, and its clock at the end."""
    if release != state.braked:  # as commanded
        return state.braked, 0.0
    delay = drum.release_delay if state.braked else drum.engage_delay
    if state.brake_clock >= delay - 0.5 * h:
        return not state.braked, 0.0
    return state.braked, state.brake_clock + h


@checked_inner
def _shaft_torque(
    drum: Drum, state: DrumState, command: DrumCommand, braked: bool, radius: float, h: float
) -> tuple[float, float]:
    """Torque at the motor shaft in a step, and the rate servo's integral at its end [N m]."""
    ratio = drum.gear_ratio
    return motor_torque(
        drum.motor,
        TORQUE if braked and command.mode == RATE else command.mode,
        drum.inertia / (ratio * ratio),
        ratio * command.payout_rate / radius,
        ratio * state.rate,
        command.torque,
        command.max_torque,
        state.integral,
        h,
    )


@checked_inner
def advance(
    drum: Drum, state: DrumState, command: DrumCommand, tension: float, h: float
) -> tuple[DrumState, DrumOutputs, DrumEnergyBalance]:
    """Advance the drum by h under a constant tension.

    Args:
        drum: from `make_drum`.
        state: at the start of the step.
        command: constant over the step.
        tension: pull of the tether at the drum [N].
        h: duration [s], > 0.

    Returns:
        State at the end, outputs and energy balance of the step.
    """
    braked, clock = _brake(drum, state, command.release_brake, h)
    rate = state.rate
    radius = radius_at(drum, drum.full_turns - (state.angle + 0.5 * rate * h) / _TURN)

    shaft_torque, integral = _shaft_torque(drum, state, command, braked, radius, h)

    pull = radius * tension
    at_drum = drum.gear_ratio * shaft_torque
    forward, backward = geared_torques(at_drum, drum.efficiency, drum.back_efficiency)
    brake = drum.brake_torque if braked else 0.0
    sliding = sliding_torque(drum.friction, rate)
    breakaway = drum.friction.breakaway
    motion = advance_shaft(
        drum.inertia,
        rate,
        pull + forward - sliding - brake,
        pull + backward + sliding + brake,
        pull + forward - breakaway - brake,
        pull + backward + breakaway + brake,
        drum.friction.viscous,
        h,
    )

    angle = motion.first + motion.second
    stop = 0
    high = (drum.max_length - state.length) / radius
    low = (drum.min_length - state.length) / radius
    if angle >= high or angle <= low:
        stop = 1 if angle >= high else -1
        motion = cut_at_stop(motion, high if stop == 1 else low)
        angle = motion.first + motion.second

    motor_work = at_drum * angle
    tension_work = pull * angle
    gear_heat = motor_work - directional_work(motion, forward, backward)
    friction_heat = dry_heat(motion, sliding, breakaway)
    friction_heat += viscous_heat(motion, drum.friction.viscous)
    brake_heat = brake * (abs(motion.first) + abs(motion.second))
    kinetic = 0.5 * drum.inertia * motion.rate * motion.rate
    stop_heat = 0.0
    if stop != 0:
        before = 0.5 * drum.inertia * rate * rate
        stop_heat = (
            before + motor_work + tension_work - gear_heat - friction_heat - brake_heat - kinetic
        )
    length = state.length + radius * angle
    if stop == 1:
        length = drum.max_length
    elif stop == -1:
        length = drum.min_length
    return (
        DrumState(state.angle + angle, length, motion.rate, braked, clock, integral),
        DrumOutputs(
            radius * angle / h,
            shaft_torque,
            shaft_torque / drum.motor.torque_constant,
            angle == 0.0 and motion.rate == 0.0,
            stop,
        ),
        DrumEnergyBalance(
            kinetic, motor_work, tension_work, gear_heat, friction_heat, brake_heat, stop_heat
        ),
    )
