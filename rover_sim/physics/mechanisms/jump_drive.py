"""Jump drive: motor with flywheel, ball screw, nut and latch.

Shaft. Motor, flywheel and screw turn together at the rate v relative to Body 1, inertia J:

    J v' = tau_m - friction(v) - load(F, direction of v) - J W',      nut: y = p/(2 pi) angle

W is Body 1's rate about the flywheel's axis, base_link +x; a positive rate moves the nut down,
which compresses the spring. With the nut force F the screw torque is F p/(2 pi eta) going down and
F p eta_b/(2 pi) going up, eta_b = 2 - 1/eta: the usual estimates for a screw with equal friction
angles in both directions. With eta <= 0.5 eta_b is not positive and the screw is self-locking. The
efficient ball screw (0.9) is not: without motor torque a compressed spring drives it back.
The bevel gear between flywheel and screw has the ratio 1 and its losses are part of eta and of the
friction; the screw's momentum about the slider axis (1e-6 kg m^2) is neglected. Reflected to the
nut the inertia is J (2 pi/p)^2, 10 t: during a release the nut is practically at rest.

Body 1's equation contains the momentum h = J (v + W), absolute and along base_link +x; Body 1's
inertia excludes the rotor's spin inertia. W is the rate at the start of the step, so the rotor
feels the body's angular acceleration of the previous step.

Positions. y [m] is the nut's position expressed as compression: a nut at y touches the latch of a
Body 2 whose compression x = l0 - s is y. y ranges from -free_travel (top) to stroke + over_travel;
with the spring relaxed the nut is free for y < 0, that is for free_travel/p = 30 turns. At both
ends the nut stops at once and its momentum passes to Body 1; its kinetic energy becomes heat.

Latch. g = y - x is the distance of the nut below the latch's face.

    state        the nut ...                      leaves to       when
    FREE         is above the latch, clear of     ENGAGED         g >= 0, it is at rest
                 it: a reaction wheel             COMPRESSING     g >= 0, it moves down
    ENGAGED      is in contact with the latch, at COMPRESSING     it moves down
                 rest or moving up                FREE            g < -clearance
    COMPRESSING  pushes Body 2 down               ENGAGED         it is at rest or moves up
                                                  FREE            g < -clearance
                                                  RELEASED        y reaches the trip
    RELEASED     is below the tripped latch,      HOOKING         the release is over, 0 < g <=
                 whose holding force falls to                     hook_depth and g decreases
                 zero in release_time             FREE            the release is over, g <= 0
    HOOKING      moves up past the latch and      FREE            g <= 0: the latch snaps in
                 lifts it with a force that       RELEASED        g > hook_depth
                 rises to hook_force

The trip is the only event with a sudden change of force, so it is located inside the step:
`advance` stops there, `elapsed` is the time advanced, and the caller advances the rest. The latch
trips at the commanded compression (`JumpCommand.trip`; inf: not before the stroke's end), corrected
for the elastic deflection of the nut, and always at the stroke's end.

Energy balance of every step, exact to rounding: d(kinetic) = motor work + body work - nut work
- screw, friction and stop heat.
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from rover_sim.physics.mechanisms.motor import (
    POSITION,
    RATE,
    TORQUE,
    Motor,
    MotorParameters,
    limited_torque,
    make_motor,
    rate_servo,
)
from rover_sim.physics.mechanisms.shaft import (
    Friction,
    FrictionParameters,
    ShaftMotion,
    advance_shaft,
    base_motion_work,
    cut_at_stop,
    directional_work,
    dry_heat,
    make_friction,
    sliding_torque,
    viscous_heat,
)
from rover_sim.physics.mechanisms.slider import NutAction, Slider, nut_force
from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.parameter_ranges import check_ranges

# The position loop: gain [1/s], fraction of the motor's torque planned for braking, dead band [m].
_POSITION_GAIN = 10.0
_BRAKING_SHARE = 0.5
_POSITION_TOLERANCE = 2.0e-5
# Fraction of a step within which an event counts as at the step's start or end.
_SHORTEST = 1.0e-3
_INFINITE = float("inf")


class Latch(IntEnum):
    """State of nut and latch; the module's docstring lists the transitions."""

    FREE = 0
    HOOKING = 1
    ENGAGED = 2
    COMPRESSING = 3
    RELEASED = 4


_FREE, _HOOKING, _ENGAGED, _COMPRESSING, _RELEASED = (int(latch) for latch in Latch)


@dataclass(frozen=True)
class JumpDriveParameters:
    """A direct-driven 2 mm ball screw for a 0.2 m stroke against 165 N.

    The drive torque at full stroke is 0.058 N m, the torque that drives it back 0.047 N m.

    Raises:
        ValueError: a value is not finite or out of its range.
    """

    lead: float = 2.0e-3  # p [m/turn]
    efficiency: float = 0.9  # eta of the screw, motor driving
    inertia: float = 1.0e-3  # J, flywheel with motor rotor and screw [kg m^2]
    friction: FrictionParameters = field(
        default_factory=lambda: FrictionParameters(
            coulomb=5.0e-3, breakaway=7.0e-3, stribeck_rate=5.0, viscous=1.0e-5
        )
    )
    free_travel: float = 0.060  # of the nut above the relaxed latch [m]
    stroke: float = 0.20  # largest compression at which the latch trips [m]
    over_travel: float = 0.010  # of the nut beyond the stroke [m]
    soft_margin: float = 0.006  # to either end of the free travel: sets the soft limit [m]
    momentum_limit: float = 0.3  # J v at which the flywheel counts as saturated [N m s]
    clearance: float = 1.0e-3  # between ENGAGED and FREE; covers a bounce [m]
    hook_depth: float = 2.0e-3  # height of the latch that the nut moves past [m]
    hook_force: float = 3.0  # at the end of hooking [N]
    release_time: float = 1.5e-3  # in which the latch's force falls to zero [s]
    quick_stop_deceleration: float = 75.0  # of the shaft, by its drive [rad/s^2]; 0.075 N m
    motor: MotorParameters = field(
        default_factory=lambda: MotorParameters(
            max_torque=0.15,  # twice what the stroke's end needs
            stall_torque=0.30,
            no_load_rate=320.0,  # a little above the saturated flywheel
            torque_constant=0.05,
            servo_bandwidth=50.0,
        )
    )

    def __post_init__(self) -> None:
        check_ranges(
            self,
            positive=(
                "lead",
                "inertia",
                "free_travel",
                "stroke",
                "over_travel",
                "momentum_limit",
                "clearance",
                "hook_depth",
                "quick_stop_deceleration",
            ),
            not_negative=("soft_margin", "hook_force", "release_time"),
            fraction=("efficiency",),
        )


class JumpDrive(NamedTuple):
    """`JumpDriveParameters` for compiled functions."""

    pitch: float  # p/(2 pi) [m/rad]
    efficiency: float
    back_efficiency: float  # 2 - 1/eta; not positive: self-locking
    inertia: float
    friction: Friction
    free_travel: float
    stroke: float
    over_travel: float
    soft_margin: float
    rate_limit: float  # momentum_limit / J
    clearance: float
    hook_depth: float
    hook_force: float
    release_time: float
    motor: Motor


class JumpState(NamedTuple):
    """State of the drive; `initial_state` makes one."""

    latch: int  # Latch
    nut: float  # y [m]
    rate: float  # v, relative to Body 1 [rad/s]
    body_rate: float  # W of the previous step [rad/s]
    integral: float  # of the rate servo [N m]
    released_for: float  # time since the last trip [s]; inf after the release
    trip_force: float  # of the nut at the last trip [N]


class JumpCommand(NamedTuple):
    """Command to the jump motor."""

    mode: int  # MotorMode
    torque: float  # TORQUE: at the shaft [N m], > 0 compresses; RATE, POSITION: feed-forward
    position: float  # POSITION: setpoint of the nut, y [m]
    rate: float  # RATE: setpoint of the nut, y' [m/s]; POSITION: limit of its magnitude
    max_force: float  # POSITION and RATE: limit of the nut force [N]; inf: the motor's limit
    trip: float  # compression at which the latch trips [m]; inf: at the stroke's end


class JumpLoads(NamedTuple):
    """Motion of the bodies at the step's start, as input of the drive."""

    slider: float  # s [m]
    slider_rate: float  # s' [m/s]
    body_rate: float  # W of Body 1 about +x [rad/s]


class JumpOutputs(NamedTuple):
    """Outputs of the drive in a step."""

    elapsed: float  # time advanced [s]: h, or less if the latch tripped
    tripped: bool  # at the end of `elapsed`, which is 0 if the trip was already due
    nut: NutAction  # for the slider's force during `elapsed`
    nut_force: float  # load on the screw [N]
    momentum: float  # h about base_link +x at the end, absolute [N m s]
    torque_on_body: float  # mean, -dh/dt about +x [N m]
    motor_torque: float  # [N m]
    current: float  # [A]
    saturated: bool  # the flywheel is at its momentum limit
    soft_limit: int  # -1 / +1: within the margin of the upper / lower end of the free travel
    hard_limit: int  # -1 / +1: at the upper / lower end of the screw


class JumpEnergyBalance(NamedTuple):
    """Energy balance of a step [J]; no heat is negative."""

    kinetic: float  # of the rotor at the end, absolute
    motor_work: float
    body_work: float  # of Body 1's rotation on the rotor
    nut_work: float  # of the nut on Body 2
    screw_heat: float
    friction_heat: float
    stop_heat: float


def make_jump_drive(parameters: JumpDriveParameters) -> JumpDrive:
    """Convert the parameters to plain floats for compiled functions."""
    derived = {"pitch", "back_efficiency", "friction", "rate_limit", "motor"}
    values = {
        name: float(getattr(parameters, name)) for name in JumpDrive._fields if name not in derived
    }
    return JumpDrive(
        pitch=float(parameters.lead / (2.0 * math.pi)),
        back_efficiency=float(2.0 - 1.0 / parameters.efficiency),
        friction=make_friction(parameters.friction),
        rate_limit=float(parameters.momentum_limit / parameters.inertia),
        motor=make_motor(parameters.motor),
        **values,
    )


def initial_state(drive: JumpDrive, nut: float | None = None) -> JumpState:
    """State of a drive at rest, the nut above the latch, by default at half its free travel.

    Raises:
        ValueError: the nut's position is not in the free travel.
    """
    position = -0.5 * drive.free_travel if nut is None else float(nut)
    if not -drive.free_travel <= position <= 0.0:
        raise ValueError(f"nut = {nut}: must lie between {-drive.free_travel} and 0 m")
    return JumpState(_FREE, position, 0.0, 0.0, 0.0, _INFINITE, 0.0)


@checked_inner
def _motor_torque(
    drive: JumpDrive, state: JumpState, command: JumpCommand, h: float
) -> tuple[float, float]:
    """Torque of the motor [N m] and the new integral of its servo [N m]."""
    if command.mode == TORQUE:
        return limited_torque(drive.motor, command.torque, state.rate, _INFINITE), 0.0
    if command.mode in (RATE, POSITION):
        rate_setpoint = command.rate
        if command.mode == POSITION:
            error = command.position - state.nut
            rate_setpoint = 0.0
            if abs(error) > _POSITION_TOLERANCE:
                braking = _BRAKING_SHARE * drive.motor.max_torque / drive.inertia * drive.pitch
                rate_setpoint = min(
                    abs(command.rate),
                    math.sqrt(2.0 * braking * abs(error)),
                    _POSITION_GAIN * abs(error),
                )
                rate_setpoint = math.copysign(rate_setpoint, error)
        limit = command.max_force * drive.pitch / drive.efficiency + drive.friction.breakaway
        return rate_servo(
            drive.motor,
            drive.inertia,
            rate_setpoint / drive.pitch,
            state.rate,
            command.torque,
            limit,
            state.integral,
            h,
        )
    return 0.0, 0.0


@checked_inner
def _holding_force(drive: JumpDrive, state: JumpState, h: float) -> float:
    """Mean force [N] over h of the releasing latch; it falls linearly from the trip force."""
    left = drive.release_time - state.released_for
    if left <= 0.0:
        return 0.0
    covered = min(left, h)
    return state.trip_force * (left - 0.5 * covered) / drive.release_time * covered / h


@checked_inner
def _next_latch(drive: JumpDrive, latch: int, gap: float, gap_rate: float, rate: float) -> int:
    """Next state of the latch, the trip excluded; `gap` is g, `rate` the screw's."""
    if latch in (_RELEASED, _HOOKING):
        if gap <= 0.0:
            return _FREE
        if gap > drive.hook_depth:
            return _RELEASED
        return _HOOKING if gap_rate < 0.0 else latch
    if gap < (0.0 if latch == _FREE else -drive.clearance):
        return _FREE
    return _COMPRESSING if rate > 0.0 else _ENGAGED


@checked_inner
def _screw_torques(drive: JumpDrive, load: float) -> tuple[float, float]:
    """Shaft torque [N m] of a load F p/(2 pi) [N m] when the nut moves down, and when up."""
    if load >= 0.0:
        return load / drive.efficiency, load * drive.back_efficiency
    return load * drive.back_efficiency, load / drive.efficiency


@checked_inner
def _shaft_motion(
    drive: JumpDrive,
    state: JumpState,
    body_rate: float,
    torque: float,
    force: float,
    h: float,
) -> tuple[ShaftMotion, float]:
    """Motion of the shaft over h, and its sliding friction [N m]."""
    down_torque, up_torque = _screw_torques(drive, force * drive.pitch)
    drag = torque - drive.inertia * (body_rate - state.body_rate) / h
    sliding = sliding_torque(drive.friction, state.rate)
    breakaway = drive.friction.breakaway
    motion = advance_shaft(
        drive.inertia,
        state.rate,
        drag - down_torque - sliding,
        drag - up_torque + sliding,
        drag - down_torque - breakaway,
        drag - up_torque + breakaway,
        drive.friction.viscous,
        0.0,
        h,
    )
    return motion, sliding


@checked_inner
def _time_to_angle(motion: ShaftMotion, start: float, angle: float) -> float:
    """Time at which a motion that ends forward reaches an angle [s]; `start` is its first rate."""
    if motion.first > 0.0 and motion.first >= angle:
        # Constant acceleration: angle = t (start + a t / 2), root without cancellation.
        end = 2.0 * motion.first / motion.first_time - start
        acceleration = (end - start) / motion.first_time
        root = math.sqrt(max(start * start + 2.0 * acceleration * angle, 0.0))
        return min(2.0 * angle / (start + root), motion.first_time)
    left = max(angle - motion.first, 0.0)
    return motion.first_time + motion.second_time * math.sqrt(left / motion.second)


@checked_inner
def advance(
    drive: JumpDrive,
    slider: Slider,
    state: JumpState,
    command: JumpCommand,
    loads: JumpLoads,
    h: float,
) -> tuple[JumpState, JumpOutputs, JumpEnergyBalance]:
    """Advance the drive by h, or to the trip of the latch if that is earlier.

    Args:
        drive: from `make_jump_drive`.
        slider: the slider that the nut presses on.
        state: at the start of the step.
        command: constant over the step.
        loads: of the bodies at the start of the step.
        h: duration [s], > 0.

    Returns:
        State at the end of the elapsed time, outputs and energy balance.
    """
    compression = slider.free_length - loads.slider
    latch = state.latch
    pressing = latch not in (_RELEASED, _HOOKING)
    holding = _holding_force(drive, state, h) if latch == _RELEASED else 0.0
    lifting = 0.0
    if latch == _HOOKING and state.rate < 0.0:
        climbed = 1.0 - (state.nut - compression) / drive.hook_depth
        lifting = drive.hook_force * min(max(climbed, 0.0), 1.0)
    now = NutAction(pressing, state.nut, drive.pitch * state.rate, holding, lifting)
    force = nut_force(slider, now, loads.slider, loads.slider_rate)
    torque, integral = _motor_torque(drive, state, command, h)

    elapsed = h
    tripped = False
    body_rate = loads.body_rate
    motion, sliding = _shaft_motion(drive, state, body_rate, torque, force, h)
    if pressing and state.nut + drive.clearance >= 0.0:
        trip = min(command.trip, drive.stroke) * (1.0 + slider.spring_rate / slider.nut_stiffness)
        to_trip = (trip - state.nut) / drive.pitch
        angle = motion.first + motion.second
        goes_down = motion.rate > 0.0 or motion.first > 0.0
        if goes_down and max(angle, motion.first) >= to_trip and force > 0.0:
            tripped = True
            trip_time = _time_to_angle(motion, state.rate, to_trip) if to_trip > 0.0 else 0.0
            if trip_time <= _SHORTEST * h:
                elapsed = 0.0
            elif trip_time < (1.0 - _SHORTEST) * h:
                elapsed = trip_time
                body_rate = state.body_rate + (body_rate - state.body_rate) * elapsed / h
                motion, sliding = _shaft_motion(drive, state, body_rate, torque, force, elapsed)

    if elapsed == 0.0:
        body_rate = state.body_rate
        motion = ShaftMotion(state.rate, 0.0, 0.0, 0.0, 0.0)
        integral = state.integral

    hard_limit = 0
    angle = motion.first + motion.second
    highest = (-drive.free_travel - state.nut) / drive.pitch
    lowest = (drive.stroke + drive.over_travel - state.nut) / drive.pitch
    if angle >= lowest or angle <= highest:
        hard_limit = 1 if angle >= lowest else -1
        if elapsed > 0.0:
            motion = cut_at_stop(motion, lowest if hard_limit == 1 else highest)
        angle = motion.first + motion.second

    nut = state.nut + drive.pitch * angle
    if hard_limit == 1:
        nut = drive.stroke + drive.over_travel
    elif hard_limit == -1:
        nut = -drive.free_travel
    nut_rate = drive.pitch * (angle / elapsed if elapsed > 0.0 else state.rate)

    released_for = state.released_for + elapsed
    if released_for >= drive.release_time:
        released_for = _INFINITE
    trip_force = state.trip_force
    if tripped:
        latch, released_for, trip_force = _RELEASED, 0.0, force
    elif latch != _RELEASED or released_for == _INFINITE:
        gap = nut - compression + loads.slider_rate * elapsed
        latch = _next_latch(drive, latch, gap, nut_rate + loads.slider_rate, motion.rate)
    soft_limit = 0
    if latch == _FREE:
        soft_limit += 1 if nut > -drive.soft_margin else 0
        soft_limit -= 1 if nut < drive.soft_margin - drive.free_travel else 0

    load = force * drive.pitch
    before = drive.inertia * (state.rate + state.body_rate)
    momentum = drive.inertia * (motion.rate + body_rate)
    motor_work = torque * angle
    nut_work = load * angle
    screw_heat = directional_work(motion, *_screw_torques(drive, load)) - nut_work
    friction_heat = dry_heat(motion, sliding, drive.friction.breakaway)
    friction_heat += viscous_heat(motion, drive.friction.viscous)
    body_work = 0.0
    if elapsed > 0.0:
        body_work = base_motion_work(
            drive.inertia, state.rate, motion.rate, angle, state.body_rate, body_rate, elapsed
        )
    kinetic = 0.5 * momentum * momentum / drive.inertia
    stop_heat = 0.0
    if hard_limit != 0:
        stop_heat = 0.5 * before * before / drive.inertia - kinetic
        stop_heat += motor_work + body_work - nut_work - screw_heat - friction_heat
    return (
        JumpState(latch, nut, motion.rate, body_rate, integral, released_for, trip_force),
        JumpOutputs(
            elapsed,
            tripped,
            NutAction(pressing, 0.5 * (state.nut + nut), nut_rate, holding, lifting),
            force,
            momentum,
            (before - momentum) / elapsed if elapsed > 0.0 else 0.0,
            torque,
            torque / drive.motor.torque_constant,
            abs(motion.rate) >= drive.rate_limit,
            soft_limit,
            hard_limit,
        ),
        JumpEnergyBalance(
            kinetic, motor_work, body_work, nut_work, screw_heat, friction_heat, stop_heat
        ),
    )
