# ruff: noqa: RUF009 - the helpers that the fields call return dataclass fields
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
inertia excludes the rotor's spin inertia.

A step. The nut is stiff: with 2 MN/m it oscillates on a Body 2 of 0.5 kg at 2000 rad/s. So the
shaft is part of the plant's implicit step: `begin` fixes what is constant in it, `respond` gives
nut force and momentum for a motion of the bodies (the plant's Newton iteration calls it with every
increment, and takes its derivatives), and `end` gives the state after an accepted step. Within
`respond` the nut force, which depends on the nut's travel, is solved for.

Positions. y [m] is the nut's position expressed as compression: a nut at y touches the latch of a
Body 2 whose compression x = l0 - s is y. y ranges from -free_travel (top) to stroke + over_travel;
with the spring relaxed the nut is free for y < 0, that is for free_travel/p = 30 turns. At both
ends the nut stops at once: its momentum passes to Body 1, and so does the share J/(J + I) of its
kinetic energy relative to it; the rest becomes heat.

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
the step ends there, `elapsed` is the time advanced, and the caller advances the rest. The latch
trips at the commanded compression (`JumpCommand.trip`; inf: not before the stroke's end), corrected
for the elastic deflection of the nut, and always at the stroke's end.

Energy balance of every step, exact to rounding: d(kinetic) = motor work + body work - nut work
- screw, friction and stop heat.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from msg_schemas import configuration
from msg_schemas.configuration import Configuration, quantity
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
    angle_by_torque,
    base_motion_work,
    cut_at_stop,
    directional_work,
    dry_heat,
    make_friction,
    rate_by_torque,
    sliding_torque,
    viscous_heat,
)
from rover_sim.physics.mechanisms.slider import Slider, pad
from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.named_parameters import from_parameters

# The position loop: gain [1/s], fraction of the motor's torque planned for braking, dead band [m].
_POSITION_GAIN = 10.0
_BRAKING_SHARE = 0.5
_POSITION_TOLERANCE = 2.0e-5
# Fraction of a step within which an event counts as at the step's start or end.
_SHORTEST = 1.0e-3
_INFINITE = float("inf")
# A releasing or lifted latch loses its force when it approaches the nut, or leaves it, at this rate
# [m/s]: the force resists, it does not push.
_RESISTS_ABOVE = 2.0e-3
# The solution of the nut force in a step: most iterations and relative residual.
_MAX_ITERATIONS, _FORCE_TOLERANCE = 50, 1.0e-10


class Latch(IntEnum):
    """State of nut and latch; the module's docstring lists the transitions."""

    FREE = 0
    HOOKING = 1
    ENGAGED = 2
    COMPRESSING = 3
    RELEASED = 4


_FREE, _HOOKING, _ENGAGED, _COMPRESSING, _RELEASED = (int(latch) for latch in Latch)


@dataclass(frozen=True)
class JumpDriveParameters(Configuration):
    """Jump motor with flywheel, ball screw, nut and latch.

    Defaults: a direct-driven 2 mm ball screw for a 0.2 m stroke against 165 N. The drive torque at
    full stroke is 0.058 N m, the torque that drives it back 0.047 N m.
    """

    lead: float = quantity("m", "of the screw, per turn", 2.0e-3, above=0.0)
    efficiency: float = quantity("-", "of the screw, motor driving", 0.9, above=0.0, maximum=1.0)
    inertia: float = quantity("kg m^2", "flywheel with rotor and screw", 1.0e-3, above=0.0)
    friction: FrictionParameters = configuration.section(
        FrictionParameters,
        "of shaft and nut",
        FrictionParameters(coulomb=5.0e-3, breakaway=7.0e-3, stribeck_rate=5.0, viscous=1.0e-5),
    )
    free_travel: float = quantity("m", "of the nut above the latch", 0.060, above=0.0)
    stroke: float = quantity("m", "compression at which the latch always trips", 0.20, above=0.0)
    over_travel: float = quantity("m", "of the nut beyond the stroke", 0.010, above=0.0)
    momentum_limit: float = quantity(
        "N m s", "angular momentum at which the flywheel is saturated", 0.3, above=0.0
    )
    clearance: float = quantity("m", "between nut and latch", 1.0e-3, above=0.0)  # covers a bounce
    hook_depth: float = quantity("m", "height of the latch", 2.0e-3, above=0.0)
    hook_force: float = quantity("N", "to move past the latch", 3.0, minimum=0.0)  # at the end
    release_time: float = quantity(
        "s", "duration of the latch's release", 1.5e-3, minimum=0.0, maximum=0.1
    )
    quick_stop_deceleration: float = quantity(  # by 0.075 N m
        "rad/s^2",
        "of the shaft, when the drive's commands time out",
        75.0,
        above=0.0,
        maximum=1e4,
    )
    motor: MotorParameters = configuration.section(
        MotorParameters,
        "the jump motor",
        MotorParameters(
            max_torque=0.15,  # twice what the stroke's end needs
            stall_torque=0.30,
            no_load_rate=320.0,  # a little above the saturated flywheel
            torque_constant=0.05,
            servo_bandwidth=50.0,
        ),
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
    body_rate: float  # W [rad/s]
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
    """Motion of the bodies in a step, as input of the drive."""

    slider: float  # s at the step's start [m]
    slider_rate: float  # mean s' of the step [m/s]
    body_rate: float  # W of Body 1 about +x at the step's end [rad/s]


class JumpStep(NamedTuple):
    """Constants of one step of the drive; `begin` makes them."""

    elapsed: float  # its length [s]: h, or less if the latch trips
    tripped: bool  # at the end of `elapsed`, which is 0 if the trip was already due
    force: float  # of the nut: expected in the step, or now if `elapsed` is 0 [N]
    torque: float  # of the motor [N m]
    integral: float  # of its servo at the end [N m]
    sliding: float  # dry friction of the shaft in motion [N m]
    pressing: bool  # whether nut and latch can touch
    latch_force: float  # of a releasing or lifted latch on Body 2, > 0 compresses [N]


class JumpResponse(NamedTuple):
    """Motion of the shaft in a step with its derivatives, for a given motion of the bodies."""

    motion: ShaftMotion
    force: float  # mean force of the nut on Body 2, > 0 compresses; the load on the screw [N]
    momentum: float  # h about base_link +x at the end, absolute [N m s]
    hard_limit: int  # -1 / +1: at the upper / lower end of the screw
    force_by_change: float  # derivatives by the change of s [N/m], [N s]
    momentum_by_change: float
    force_by_rate: float  # and by W at the end [N s], [N m s^2]
    momentum_by_rate: float


# Response of a drive that no step moves.
AT_REST = JumpResponse(ShaftMotion(0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0)


class JumpOutputs(NamedTuple):
    """Outputs of the drive in a step."""

    nut_force: float  # load on the screw [N]
    torque_on_body: float  # mean, -dh/dt about +x [N m]
    motor_torque: float  # [N m]
    current: float  # [A]
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
    """Convert the parameters for compiled functions."""
    return from_parameters(
        JumpDrive,
        parameters,
        pitch=parameters.lead / (2.0 * math.pi),
        back_efficiency=2.0 - 1.0 / parameters.efficiency,
        friction=make_friction(parameters.friction),
        motor=make_motor(parameters.motor),
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
            drive.motor, drive.inertia, rate_setpoint / drive.pitch, state.rate, command.torque,
            limit, state.integral, h,
        )  # fmt: skip
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
def _resistance(latch_force: float, change: float, h: float) -> tuple[float, float]:
    """Force of a releasing or lifted latch [N], and its derivative by the change of g [N/m].

    A releasing latch (a positive force) resists while g grows, a lifted one while g falls. Against
    that direction it would push and create energy.
    """
    if latch_force == 0.0:
        return 0.0, 0.0
    slope = abs(latch_force) / (_RESISTS_ABOVE * h)
    force = abs(latch_force) + math.copysign(slope, latch_force) * change
    if force >= abs(latch_force):
        return latch_force, 0.0
    if force <= 0.0:
        return 0.0, 0.0
    return math.copysign(force, latch_force), slope


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
    drive: JumpDrive, state: JumpState, step: JumpStep, force: float, body_rate: float
) -> tuple[ShaftMotion, int]:
    """Motion of the shaft in the step under a nut force, and the end of the screw it reaches."""
    h = step.elapsed
    down_torque, up_torque = _screw_torques(drive, force * drive.pitch)
    drag = step.torque - drive.inertia * (body_rate - state.body_rate) / h
    breakaway = drive.friction.breakaway
    motion = advance_shaft(
        drive.inertia, state.rate, drag - down_torque - step.sliding,
        drag - up_torque + step.sliding, drag - down_torque - breakaway,
        drag - up_torque + breakaway, drive.friction.viscous, h,
    )  # fmt: skip
    angle = motion.first + motion.second
    highest = (-drive.free_travel - state.nut) / drive.pitch
    lowest = (drive.stroke + drive.over_travel - state.nut) / drive.pitch
    if angle >= lowest:
        return cut_at_stop(motion, lowest), 1
    if angle <= highest:
        return cut_at_stop(motion, highest), -1
    return motion, 0


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
def respond(
    drive: JumpDrive, slider: Slider, state: JumpState, step: JumpStep, loads: JumpLoads
) -> JumpResponse:
    """Motion of the shaft and force of the nut in a step in which the bodies move as given.

    Args:
        drive: from `make_jump_drive`.
        slider: the slider that the nut presses on.
        state: at the step's start.
        step: from `begin`; its `elapsed` is not 0.
        loads: the bodies' motion.
    """
    h, pitch = step.elapsed, drive.pitch
    force, stiffness = step.latch_force, 0.0
    motion, limit = _shaft_motion(drive, state, step, force, loads.body_rate)
    if step.pressing or step.latch_force != 0.0:
        depth0 = state.nut - slider.free_length + loads.slider
        carried = depth0 + h * loads.slider_rate
        # The force decreases the nut's travel, which decreases the force: one root, bracketed.
        low, high = min(step.latch_force, 0.0), _INFINITE
        for _ in range(_MAX_ITERATIONS):
            depth1 = carried + pitch * (motion.first + motion.second)
            if step.pressing:
                pressed, stiffness = pad(
                    slider.nut_stiffness, slider.nut_damping, depth0, depth1, h
                )
            else:
                pressed, stiffness = _resistance(step.latch_force, depth1 - depth0, h)
            excess = pressed - force
            if abs(excess) <= _FORCE_TOLERANCE * (1.0 + abs(pressed)):
                break
            if excess > 0.0:
                low = force
            else:
                high = force
            slope = 1.0 + stiffness * pitch * _lead(drive, motion) * _compliance(
                drive, motion, limit
            )
            force += excess / slope
            if not low <= force <= high:
                force = 0.5 * (low + min(high, 2.0 * abs(low) + pressed + 1.0))
            motion, limit = _shaft_motion(drive, state, step, force, loads.body_rate)
    travel = _compliance(drive, motion, limit)
    gain = rate_by_torque(motion, drive.inertia)
    lead, inertia = _lead(drive, motion), drive.inertia
    stiffness /= 1.0 + stiffness * pitch * lead * travel
    by_rate = -stiffness * pitch * travel * inertia / h
    return JumpResponse(
        motion,
        force,
        inertia * (motion.rate + loads.body_rate),
        limit,
        stiffness,
        -inertia * gain * lead * stiffness,
        by_rate,
        inertia * (1.0 - gain * (lead * by_rate + inertia / h)),
    )


@checked_inner
def _lead(drive: JumpDrive, motion: ShaftMotion) -> float:
    """Shaft torque per compressing nut force in the direction of motion [m]."""
    if motion.first + motion.second >= 0.0:
        return drive.pitch / drive.efficiency
    return drive.pitch * drive.back_efficiency


@checked_inner
def _compliance(drive: JumpDrive, motion: ShaftMotion, limit: int) -> float:
    """Angle of the shaft in a step per torque [rad/(N m)]."""
    if limit != 0:
        return 0.0
    return angle_by_torque(motion, drive.inertia)


@checked_inner
def _pressing_force(drive: JumpDrive, slider: Slider, state: JumpState, loads: JumpLoads) -> float:
    """Force [N] of the nut on the latch at the step's start; loads with the rate there."""
    depth = state.nut - slider.free_length + loads.slider
    if depth <= 0.0:
        return 0.0
    rate = drive.pitch * state.rate + loads.slider_rate
    return slider.nut_stiffness * depth * max(1.0 + slider.nut_damping * rate, 0.0)


@checked_inner
def begin(
    drive: JumpDrive,
    slider: Slider,
    state: JumpState,
    command: JumpCommand,
    expected: JumpLoads,
    h: float,
) -> JumpStep:
    """Constants of a step of length h, or of one to the trip of the latch if that is earlier.

    Args:
        drive: from `make_jump_drive`.
        slider: the slider that the nut presses on.
        state: at the start of the step.
        command: constant over the step.
        expected: motion of the bodies if their rates remain; locates the trip.
        h: duration [s], > 0.
    """
    pressing = state.latch not in (_RELEASED, _HOOKING)
    latch_force = _holding_force(drive, state, h) if state.latch == _RELEASED else 0.0
    if state.latch == _HOOKING and state.rate < 0.0:
        gap = state.nut - slider.free_length + expected.slider
        latch_force -= drive.hook_force * min(max(1.0 - gap / drive.hook_depth, 0.0), 1.0)
    torque, integral = _motor_torque(drive, state, command, h)
    sliding = sliding_torque(drive.friction, state.rate)
    step = JumpStep(h, False, latch_force, torque, integral, sliding, pressing, latch_force)
    if not (pressing and state.nut + drive.clearance >= 0.0):
        return step
    trip = min(command.trip, drive.stroke) * (1.0 + slider.spring_rate / slider.nut_stiffness)
    response = respond(drive, slider, state, step, expected)
    motion, to_trip = response.motion, (trip - state.nut) / drive.pitch
    goes_down = motion.rate > 0.0 or motion.first > 0.0
    farthest = max(motion.first + motion.second, motion.first)
    if not (goes_down and farthest >= to_trip and response.force > 0.0):
        return step
    time = _time_to_angle(motion, state.rate, to_trip) if to_trip > 0.0 else 0.0
    if time <= _SHORTEST * h:
        force = _pressing_force(drive, slider, state, expected)
        return JumpStep(0.0, True, force, torque, state.integral, sliding, pressing, latch_force)
    elapsed = time if time < (1.0 - _SHORTEST) * h else h
    return JumpStep(elapsed, True, response.force, torque, integral, sliding, pressing, latch_force)


@checked_inner
def at_trip(state: JumpState, step: JumpStep) -> JumpState:
    """State after a step of no length: the latch has tripped."""
    return JumpState(
        _RELEASED, state.nut, state.rate, state.body_rate, state.integral, 0.0, step.force
    )


@checked_inner
def end(
    drive: JumpDrive,
    slider: Slider,
    state: JumpState,
    step: JumpStep,
    loads: JumpLoads,
    response: JumpResponse,
) -> tuple[JumpState, JumpOutputs, JumpEnergyBalance]:
    """State at the end of an accepted step, outputs and energy balance.

    Args:
        drive: from `make_jump_drive`.
        slider: the slider that the nut presses on.
        state: at the step's start.
        step: from `begin`.
        loads: the bodies' motion in the step.
        response: of the shaft to it.
    """
    motion, force, h = response.motion, response.force, step.elapsed
    angle = motion.first + motion.second
    nut = state.nut + drive.pitch * angle
    if response.hard_limit == 1:
        nut = drive.stroke + drive.over_travel
    elif response.hard_limit == -1:
        nut = -drive.free_travel
    nut_rate = drive.pitch * angle / h

    released_for = state.released_for + h
    if released_for >= drive.release_time:
        released_for = _INFINITE
    latch, trip_force = state.latch, state.trip_force
    if step.tripped:
        latch, released_for, trip_force = _RELEASED, 0.0, force
    elif latch != _RELEASED or released_for == _INFINITE:
        gap = nut - slider.free_length + loads.slider + loads.slider_rate * h
        latch = _next_latch(drive, latch, gap, nut_rate + loads.slider_rate, motion.rate)

    load = force * drive.pitch
    before = drive.inertia * (state.rate + state.body_rate)
    motor_work = step.torque * angle
    nut_work = load * angle
    screw_heat = directional_work(motion, *_screw_torques(drive, load)) - nut_work
    friction_heat = dry_heat(motion, step.sliding, drive.friction.breakaway)
    friction_heat += viscous_heat(motion, drive.friction.viscous)
    body_work = base_motion_work(
        drive.inertia, state.rate, motion.rate, angle, state.body_rate, loads.body_rate, h
    )
    kinetic = 0.5 * response.momentum * response.momentum / drive.inertia
    stop_heat = 0.0
    if response.hard_limit != 0:
        # All of the momentum that the rotor loses passes to Body 1 at its mean rate.
        body_work = (response.momentum - before) * 0.5 * (state.body_rate + loads.body_rate)
        stop_heat = 0.5 * before * before / drive.inertia - kinetic
        stop_heat += motor_work + body_work - nut_work - screw_heat - friction_heat
    return (
        JumpState(
            latch, nut, motion.rate, loads.body_rate, step.integral, released_for, trip_force
        ),
        JumpOutputs(
            force,
            (before - response.momentum) / h,
            step.torque,
            step.torque / drive.motor.torque_constant,
            response.hard_limit,
        ),
        JumpEnergyBalance(
            kinetic, motor_work, body_work, nut_work, screw_heat, friction_heat, stop_heat
        ),
    )
