# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
"""Wheel drive: two wheels behind one motor, through bevel gears and ratchets.

Mechanism. The source paper's traveling mechanism has bevel gears and ratchets "on each wheel drive
system"; both directions of one motor are to give straight and turning motion, and while the rover
hangs the same motor must rotate it about the axle. This simple arrangement fulfils all three
[choice]: the motor's bevel gear turns the axle at the rate u;

- the left wheel is fixed to the axle;
- the right wheel has two ratchets. The driving one lets it overrun the axle: w >= u. The holding
  one, fixed to Body 1, prevents backward rotation: w >= 0.

    motor     left wheel   right wheel            the rover on its wheels
    forward   forward      driven forward         drives straight ahead
    reverse   backward     held                   turns left (+z) about its right wheel
    braked    braked       coasts                 turns left (+z) while it coasts
    at rest   at rest      rolls forward only     cannot roll back on the right side
    off       drags motor  rolls forward only

Straight runs and left turns reach every pose. While hanging, the wheels' momentum about the axle,
relative to Body 1, is I (u + w) and ranges from -I w_max (the left wheel alone) to 2 I w_max, so
that the wheels give reaction torques of both signs from rest. After both have been accelerated, the
left wheel alone returns its momentum; the right one coasts down by its bearing's friction.

A reversing gear for the right wheel (driven forward by both motor directions, turning in place) is
not used: it gives w >= |u|, the wheels' momentum is never negative, and they could not hold the
attitude without a bias that bearing friction removes within seconds.

Mathematics. With torques a, b >= 0 of the driving and of the holding ratchet,

    (I + N^2 J_m) u' = gear torque + left load - friction - I W' - a,       0 <= a _|_ w - u >= 0,
    I w'             =              right load - friction - I W' + a + b,   0 <= b _|_ w >= 0,

with the rates relative to Body 1, which turns at W about the axle (base_link +y; rolling forward is
a positive rate). The complementarity is solved exactly for the accelerations: in each piece of a
step the wheels move either separately or together as one shaft. When the axle catches up with an
overrunning wheel within a step, both continue at their common rate, momentum conserved; the kinetic
energy of the relative motion, at most one step's acceleration, becomes ratchet heat. The tooth
pitch is neglected (sprag clutches have none).

The motor's rotor axis is perpendicular to the axle: its inertia is part of u's (N^2 J_m) but not of
the momentum about the axle; its own momentum is a separate output.

Body 1's equation contains the momentum h = I (u + W) + I (w + W), absolute and along base_link +y;
Body 1's inertia excludes the wheels' spin inertia. A step needs the ground's torques and W at its
end; `WheelResponse` has the derivatives with which an iteration finds them.

Energy balance of every step, exact to rounding: d(kinetic) = motor work + load work + body work
- gear, friction and ratchet heat.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, quantity
from rover_sim.physics.mechanisms.motor import Motor, MotorParameters, make_motor, motor_torque
from rover_sim.physics.mechanisms.shaft import (
    Friction,
    FrictionParameters,
    ShaftMotion,
    advance_shaft,
    angle_by_torque,
    base_motion_work,
    directional_work,
    dry_heat,
    geared_torques,
    make_friction,
    rate_by_torque,
    sliding_torque,
    viscous_heat,
)
from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.named_parameters import from_parameters

_INFINITE = float("inf")
# Difference of rates below which wheel and axle are engaged: rounding [rad/s].
_ENGAGED = 1e-12


class Ratchet(IntEnum):
    """State of the right wheel's ratchets at the end of a step."""

    OVERRUNNING = 0  # turns forward faster than the axle
    DRIVEN = 1  # turns with the axle
    HELD = 2  # at rest, while the axle rests or turns backward


_OVERRUNNING, _DRIVEN, _HELD = (int(ratchet) for ratchet in Ratchet)


@dataclass(frozen=True)
class WheelDriveParameters(Configuration):
    """Wheel motor, gear and the two wheels as rotors.

    Defaults: two wheels of 0.15 m radius and 0.4 kg that push a 10 kg rover with up to 20 N.
    Friction torques are at the wheels; the left side includes the gear train's.
    """

    wheel_inertia: float = quantity("kg m^2", "of each wheel about the axle", 6.0e-3, above=0.0)
    gear_ratio: float = quantity("-", "motor turns per wheel turn", 60.0, above=0.0)
    motor_inertia: float = quantity("kg m^2", "of the rotor", 1.0e-6, minimum=0.0)
    efficiency: float = quantity("-", "of the gears, motor driving", 0.8, above=0.0, maximum=1.0)
    back_efficiency: float = quantity(  # 2 - 1/efficiency
        "-", "of the gears, wheels driving", 0.75, above=0.0, maximum=1.0
    )
    left_friction: FrictionParameters = configuration.section(
        FrictionParameters,
        "of the left wheel with the gears",
        FrictionParameters(coulomb=0.02, breakaway=0.03, stribeck_rate=0.2, viscous=1.0e-3),
    )
    right_friction: FrictionParameters = configuration.section(
        FrictionParameters,
        "of the right wheel",
        FrictionParameters(coulomb=0.005, breakaway=0.008, stribeck_rate=0.2, viscous=5.0e-4),
    )
    quick_stop_deceleration: float = quantity(
        "rad/s^2",
        "of the left wheel, when the drive's commands time out",
        3.0,
        above=0.0,
        maximum=1e3,
    )
    motor: MotorParameters = configuration.section(
        MotorParameters,
        "the wheel motor",
        MotorParameters(
            max_torque=0.06,  # 2.9 N m at the wheels
            stall_torque=0.12,
            no_load_rate=600.0,  # 10 rad/s at the wheels, 1.5 m/s
            torque_constant=0.02,
            servo_bandwidth=40.0,
        ),
    )


class WheelDrive(NamedTuple):
    """`WheelDriveParameters` for compiled functions."""

    wheel_inertia: float
    train_inertia: float  # I + N^2 J_m of the left wheel with the motor
    gear_ratio: float
    motor_inertia: float
    efficiency: float
    back_efficiency: float
    left_friction: Friction
    right_friction: Friction
    motor: Motor


class WheelState(NamedTuple):
    """Angles [rad] and rates [rad/s] of the wheels relative to Body 1, forward positive."""

    left_angle: float = 0.0
    right_angle: float = 0.0
    left: float = 0.0  # u
    right: float = 0.0  # w >= u and w >= 0
    body_rate: float = 0.0  # W of the previous step [rad/s]
    integral: float = 0.0  # of the rate servo [N m]


class WheelCommand(NamedTuple):
    """Command to the wheel motor."""

    mode: int  # MotorMode: OFF, TORQUE or RATE
    torque: float  # at the motor shaft [N m], > 0 forward; with RATE: feed-forward
    rate: float  # with RATE: setpoint of the left wheel [rad/s]
    max_torque: float  # at the motor shaft [N m]; inf: the motor's own limit


class WheelLoads(NamedTuple):
    """Loads on the wheels in a step."""

    left_torque: float  # of the ground about +y [N m]
    right_torque: float
    body_rate: float  # W of Body 1 about +y at the step's end [rad/s]


class WheelResponse(NamedTuple):
    """Derivatives of the wheels' motion by the ground's torques."""

    left: float  # mean rate of the left wheel by its torque [rad/(N m s)]
    cross: float  # of either wheel by the other's torque
    right: float
    momentum_left: float  # momentum about the axle at the step's end by the left torque [s]
    momentum_right: float


class WheelOutputs(NamedTuple):
    """Outputs of the drive in a step."""

    left_rate: float  # mean of the step, relative to Body 1 [rad/s]
    right_rate: float
    momentum: float  # h about base_link +y at the step's end, absolute [N m s]
    motor_momentum: float  # of the motor's rotor about its own axis, relative [N m s]
    torque_on_body: float  # mean, of the whole drive about +y [N m]: loads - dh/dt
    ratchet: int  # Ratchet
    motor_torque: float  # at the motor shaft [N m]
    current: float  # of the motor [A]
    stalled: bool  # the motor has torque and neither wheel turns
    response: WheelResponse


class WheelEnergyBalance(NamedTuple):
    """Energy balance of a step [J]; no heat is negative."""

    kinetic: float  # at the step's end: wheels absolute, motor rotor relative
    motor_work: float
    load_work: float  # of the ground torques on the wheels' rates relative to Body 1
    body_work: float  # of Body 1's rotation on the wheels
    gear_heat: float
    friction_heat: float
    ratchet_heat: float


def make_wheel_drive(parameters: WheelDriveParameters) -> WheelDrive:
    """Convert the parameters for compiled functions."""
    return from_parameters(
        WheelDrive,
        parameters,
        train_inertia=parameters.wheel_inertia
        + parameters.gear_ratio**2 * parameters.motor_inertia,
        left_friction=make_friction(parameters.left_friction),
        right_friction=make_friction(parameters.right_friction),
        motor=make_motor(parameters.motor),
    )


class _Side(NamedTuple):
    """Torques on one wheel in a step; `viscous` is the coefficient of its rate."""

    drive_forward: float  # gear, load and the body's angular acceleration, moving forward
    drive_backward: float
    sliding: float
    breakaway: float
    viscous: float


@checked_inner
def _separate_motion(
    inertia: float, side: _Side, rate: float, may_reverse: bool, h: float
) -> ShaftMotion:
    """Motion of one wheel that is not engaged with the other."""
    return advance_shaft(
        inertia,
        rate,
        side.drive_forward - side.sliding,
        side.drive_backward + side.sliding,
        side.drive_forward - side.breakaway,
        side.drive_backward + side.breakaway if may_reverse else _INFINITE,
        side.viscous,
        h,
    )


@checked_inner
def _heat(motion: ShaftMotion, side: _Side) -> float:
    """Friction heat [J] of one wheel's motion."""
    return dry_heat(motion, side.sliding, side.breakaway) + viscous_heat(motion, side.viscous)


@checked_inner
def _engaged_motion(
    drive: WheelDrive, left: _Side, right: _Side, rate: float, h: float
) -> ShaftMotion:
    """Motion of both wheels as one shaft that turns forward, at most until it comes to rest."""
    torque = left.drive_forward + right.drive_forward
    at_rest = torque - left.breakaway - right.breakaway if rate == 0.0 else 0.0
    return advance_shaft(
        drive.train_inertia + drive.wheel_inertia,
        rate,
        torque - left.sliding - right.sliding,
        0.0,
        at_rest,
        _INFINITE,
        left.viscous + right.viscous,
        h,
    )


@checked_inner
def _add_engaged(
    drive: WheelDrive, response: WheelResponse, motion: ShaftMotion, h: float
) -> WheelResponse:
    """Response of a step of length h with a further motion of the engaged wheels."""
    inertia = drive.train_inertia + drive.wheel_inertia
    turned = angle_by_torque(motion, inertia) / h
    momentum = 2.0 * drive.wheel_inertia * rate_by_torque(motion, inertia)
    return WheelResponse(
        response.left + turned,
        response.cross + turned,
        response.right + turned,
        momentum,
        momentum,
    )


@checked_inner
def _add_separate(
    drive: WheelDrive, response: WheelResponse, left: ShaftMotion, right: ShaftMotion, h: float
) -> WheelResponse:
    """Response of a step of length h with further motions of the separate wheels."""
    inertia = drive.wheel_inertia
    return WheelResponse(
        response.left + angle_by_torque(left, drive.train_inertia) / h,
        response.cross,
        response.right + angle_by_torque(right, inertia) / h,
        inertia * rate_by_torque(left, drive.train_inertia),
        inertia * rate_by_torque(right, inertia),
    )


@checked_inner
def _side(friction: Friction, rate: float, forward: float, backward: float) -> _Side:
    """Torques on a wheel that turns at a rate, with those by direction besides friction."""
    return _Side(
        forward, backward, sliding_torque(friction, rate), friction.breakaway, friction.viscous
    )


@checked_inner
def _sides(
    drive: WheelDrive,
    state: WheelState,
    loads: WheelLoads,
    forward: float,
    backward: float,
    h: float,
) -> tuple[_Side, _Side]:
    """Torques on both wheels, with the gear's on the axle by direction."""
    carried = -drive.wheel_inertia * (loads.body_rate - state.body_rate) / h
    left_load, right_load = loads.left_torque, loads.right_torque
    left = _side(
        drive.left_friction,
        state.left,
        forward + left_load + carried,
        backward + left_load + carried,
    )
    right = _side(drive.right_friction, state.right, right_load + carried, right_load + carried)
    return left, right


@checked_inner
def _ratchet(left: float, right: float) -> int:
    """State of the ratchets with the rates of the wheels [rad/s]."""
    if right == 0.0:
        return _HELD
    return _DRIVEN if right <= left + _ENGAGED else _OVERRUNNING


@checked_inner
def _caught_up(drive: WheelDrive, response: WheelResponse) -> WheelResponse:
    """Response after the axle has caught up with the right wheel."""
    both = drive.train_inertia + drive.wheel_inertia
    return WheelResponse(
        response.left,
        response.cross,
        response.right,
        response.momentum_left * 2.0 * drive.train_inertia / both,
        response.momentum_right * 2.0 * drive.wheel_inertia / both,
    )


@checked_inner
def _shaft_torque(
    drive: WheelDrive, state: WheelState, command: WheelCommand, h: float
) -> tuple[float, float]:
    """Torque at the motor shaft in a step, and the rate servo's integral at its end [N m]."""
    ratio = drive.gear_ratio
    return motor_torque(
        drive.motor,
        command.mode,
        (drive.train_inertia + drive.wheel_inertia) / (ratio * ratio),
        ratio * command.rate,
        ratio * state.left,
        command.torque,
        command.max_torque,
        state.integral,
        h,
    )


@checked_inner
def _outputs(
    drive: WheelDrive,
    state: WheelState,
    loads: WheelLoads,
    u: float,
    w: float,
    left_angle: float,
    right_angle: float,
    shaft_torque: float,
    response: WheelResponse,
    h: float,
) -> WheelOutputs:
    """Outputs of a step that turned the wheels by angles [rad] to rates u and w [rad/s]."""
    inertia = drive.wheel_inertia
    before = inertia * (state.left + state.right + 2.0 * state.body_rate)
    momentum = inertia * (u + w + 2.0 * loads.body_rate)
    return WheelOutputs(
        left_angle / h,
        right_angle / h,
        momentum,
        drive.motor_inertia * (drive.gear_ratio * u),
        loads.left_torque + loads.right_torque - (momentum - before) / h,
        _ratchet(u, w),
        shaft_torque,
        shaft_torque / drive.motor.torque_constant,
        shaft_torque != 0.0 and left_angle == 0.0 and right_angle == 0.0,
        response,
    )


@checked_inner
def advance(
    drive: WheelDrive, state: WheelState, command: WheelCommand, loads: WheelLoads, h: float
) -> tuple[WheelState, WheelOutputs, WheelEnergyBalance]:
    """Advance the wheels by h.

    Args:
        drive: from `make_wheel_drive`.
        state: at the start of the step.
        command: constant over the step.
        loads: ground torques, constant over the step, and Body 1's rate about the axle.
        h: duration [s], > 0.

    Returns:
        State at the end, outputs and energy balance of the step.
    """
    u, w = state.left, state.right
    ratio = drive.gear_ratio
    shaft_torque, integral = _shaft_torque(drive, state, command, h)
    forward, backward = geared_torques(
        ratio * shaft_torque, drive.efficiency, drive.back_efficiency
    )

    inertia = drive.wheel_inertia
    left, right = _sides(drive, state, loads, forward, backward, h)
    left_angle, right_angle = 0.0, 0.0
    transmitted, friction_heat, load_work = 0.0, 0.0, 0.0
    response = WheelResponse(0.0, 0.0, 0.0, 0.0, 0.0)
    remaining = h
    while remaining > 0.0:  # a second pass if the engaged wheels come to rest within the step
        span = remaining
        left_motion = _separate_motion(drive.train_inertia, left, u, True, span)
        right_motion = _separate_motion(inertia, right, w, False, span)
        # Engaged if separately the right wheel would be slower than the axle.
        if w <= u + _ENGAGED and right_motion.rate < left_motion.rate:
            left_motion = right_motion = _engaged_motion(drive, left, right, w, span)
            if w > 0.0 and right_motion.rate == 0.0:
                span = right_motion.first_time
            response = _add_engaged(drive, response, left_motion, h)
        else:
            response = _add_separate(drive, response, left_motion, right_motion, h)
        left_turn = left_motion.first + left_motion.second
        right_turn = right_motion.first + right_motion.second
        left_angle += left_turn
        right_angle += right_turn
        transmitted += directional_work(left_motion, forward, backward)
        friction_heat += _heat(left_motion, left) + _heat(right_motion, right)
        load_work += loads.left_torque * left_turn + loads.right_torque * right_turn
        u, w = left_motion.rate, right_motion.rate
        remaining -= span

    ratchet_heat = 0.0
    lag = u - w
    if lag > 0.0:
        both = drive.train_inertia + inertia
        u = w = (drive.train_inertia * u + inertia * w) / both
        response = _caught_up(drive, response)
        ratchet_heat = 0.5 * drive.train_inertia * inertia / both * lag * lag

    base0, base1 = state.body_rate, loads.body_rate
    body_work = base_motion_work(inertia, state.left, u, left_angle, base0, base1, h)
    body_work += base_motion_work(inertia, state.right, w, right_angle, base0, base1, h)
    motor_work = ratio * shaft_torque * left_angle
    motor_rate = ratio * u
    kinetic = 0.5 * drive.motor_inertia * motor_rate * motor_rate
    kinetic += 0.5 * inertia * ((u + base1) ** 2 + (w + base1) ** 2)
    return (
        WheelState(
            state.left_angle + left_angle, state.right_angle + right_angle, u, w, base1, integral
        ),
        _outputs(drive, state, loads, u, w, left_angle, right_angle, shaft_torque, response, h),
        WheelEnergyBalance(
            kinetic,
            motor_work,
            load_work,
            body_work,
            motor_work - transmitted,
            friction_heat,
            ratchet_heat,
        ),
    )
