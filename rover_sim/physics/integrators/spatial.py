"""Time stepping of the spatial plant: winch, tether, rover with its drives, and the ground.

A step of length h, which ends early where the jump drive's latch trips, first advances the winch's
drum under the previous step's tension. Then tether, rover, jump drive, wheels and ground take one
implicit step (`spatial_step`); if its Newton iteration does not converge, both are repeated with
half the length.
Finally the exit element at the fairlead is split or merged with the next one (`remesh`) if it is
too long or too short.

World frame: origin at the fairlead, z up. The rover's axes are those of `spatial_rover`.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.integrators.initial_guess import record_step
from rover_sim.physics.integrators.integrator_memory import (
    AXIAL,
    BENDING,
    CONSTRAINT_DRIFT,
    CONTACT,
    CONTACT_ENERGY,
    DRIVE_KINETIC,
    ELAPSED,
    ELEMENTS,
    EVENT_BROKEN,
    EVENT_DIVERGED,
    EVENT_DRUM_STOP,
    EVENT_LATCH,
    FAIRLEAD_TENSION,
    GRAVITY,
    HALVINGS,
    HEAT_SWIVEL,
    INPUT_REMESHING,
    KINETIC,
    LEFT_TORQUE,
    LEFT_TORQUE_SLOPE,
    OUTCOME_BROKEN,
    OUTCOME_CONVERGED,
    OUTCOME_DIVERGED,
    OUTCOME_HALVED,
    PEAK_TENSION,
    REMESH_COUNT,
    REPORT_SIZE,
    RIGHT_TORQUE,
    RIGHT_TORQUE_SLOPE,
    SMALLEST_STEP,
    SPRING,
    SWIVEL_SLIP,
    TETHER_CONTACT_POINTS,
    TIME,
    TIP_TENSION,
    TORSION,
    TWIST,
    add_losses,
    record_event,
    record_wheel_torques,
)
from rover_sim.physics.integrators.session import Model, MotionArrays, Session
from rover_sim.physics.integrators.spatial_step import (
    StepInputs,
    attempt_step,
    jump_loads,
    slide_rate,
)
from rover_sim.physics.integrators.step_record import (
    Progress,
    check_energy,
    end_drum,
    end_jump_drive,
    end_wheels,
    follow_flight,
    pressing,
    report_root,
)
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive, wheel_drive
from rover_sim.physics.mechanisms.slider import slider_energy
from rover_sim.physics.numerics.compiled import checked, inner
from rover_sim.physics.numerics.vectors import Vector, scale
from rover_sim.physics.rover.spatial_rover import (
    BODY_SIZE,
    POSITION,
    SLIDE,
    SPIN,
    VELOCITY1,
    orientation,
    pose_of,
    rover_energies,
    vector_at,
)
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.newton import reset_rate
from rover_sim.physics.tether.remesh import merge_first, split_first
from rover_sim.physics.tether.tether import Tether, row_width, tether_energies, with_elements
from rover_sim.physics.tether.twist import swivel_torque, twist_angle, twist_axis, twist_energy
from rover_sim.physics.tether.variable_length import Payout, begin_exit, exit_energies

# An exit element is split or merged beyond these fractions of the nominal element length.
_SPLIT_BEYOND, _MERGE_BELOW = 1.5, 0.5


class DriveStates(NamedTuple):
    """States of the drives."""

    jump: jump_drive.JumpState
    drum: drums.DrumState
    wheels: wheel_drive.WheelState


class DriveCommands(NamedTuple):
    """Commands to the drives, constant during a call."""

    jump: jump_drive.JumpCommand
    drum: drums.DrumCommand
    wheels: wheel_drive.WheelCommand


@inner
def payout_rate(drum: drums.Drum, state: drums.DrumState) -> float:
    """Payout rate of the tether at the drum [m/s]."""
    turns = drum.full_turns - state.angle / (2.0 * np.pi)
    return drums.radius_at(drum, turns) * state.rate


@checked
def energies(
    session: Session, drives: DriveStates
) -> tuple[float, float, float, float, float, float, float]:
    """Kinetic, gravity, axial, bending, spring, contact and torsion energy [J].

    The potential of gravity is zero at the fairlead, the contact energy at the run's start.
    Overwrites the session's arrays of the exit element.
    """
    model, motion, memory = session.model, session.motion, session.memory
    n = int(memory[ELEMENTS])
    tether = with_elements(model.tether, n)
    kinetic, gravity, axial, bending = tether_energies(tether, motion.q, motion.v)
    kinetic += memory[DRIVE_KINETIC]
    spring, torsion = 0.0, 0.0
    length = n * tether.element_length
    if model.has_winch:
        exit_element = session.solver.exit_element
        origin = session.solver.origin
        begin_exit(
            origin, motion.fairlead_slope[0], motion.fairlead_slope[1], motion.q, motion.v,
            exit_element,
        )  # fmt: skip
        first = drives.drum.length - length
        rate = payout_rate(model.drum, drives.drum)
        parts = exit_energies(tether, first, rate, exit_element.start, exit_element.rate)
        kinetic += parts[0]
        gravity += parts[1]
        axial += parts[2]
        bending += parts[3]
        length += first
    if model.has_rover:
        more, weight = rover_energies(model.rover, tether.gravity, motion.body)
        kinetic += more
        gravity += weight
        spring = slider_energy(
            model.slider,
            pressing(drives.jump.latch),
            drives.jump.nut,
            motion.body[SLIDE],
        )
        torsion = twist_energy(model.torsion / length, memory[TWIST], memory[SWIVEL_SLIP])
    else:
        for d in range(3):
            kinetic += 0.5 * model.tip_mass * motion.v[d, n] ** 2
            gravity -= model.tip_mass * tether.gravity[d] * motion.q[d, n]
    return kinetic, gravity, axial, bending, spring, memory[CONTACT_ENERGY], torsion


@inner
def _accept_step(
    has_winch: bool, has_rover: bool, n: int, motion: MotionArrays, after: MotionArrays
) -> None:
    """Copy the end state of an attempted step to `motion`."""
    width = row_width(n, 3)
    for k in range(6):
        for i in range(width):
            motion.q[k, i] = after.q[k, i]
            motion.v[k, i] = after.v[k, i]
    if has_winch:
        for r in range(2):
            for d in range(3):
                motion.fairlead_slope[r, d] = after.fairlead_slope[r, d]
    if has_rover:
        for k in range(BODY_SIZE):
            motion.body[k] = after.body[k]
        for k in range(motion.rover_anchors.shape[0]):
            for d in range(3):
                motion.rover_anchors[k, d] = after.rover_anchors[k, d]


class _Swivel(NamedTuple):
    """Twist of the tether in a step."""

    twist: float  # [rad]
    slip: float  # [rad]
    heat: float  # [J]
    torque: Vector  # on the rover, world axes [N m]


@inner
def _twist_tether(
    model: Model, n: int, motion: MotionArrays, length: float, memory: Array
) -> _Swivel:
    """Twist and slip of the tether's swivel at the step's start, for a tether of `length` [m]."""
    if not model.has_rover:
        return _Swivel(memory[TWIST], memory[SWIVEL_SLIP], 0.0, (0.0, 0.0, 0.0))
    slope = vector_at(motion.fairlead_slope[0], 0)
    if not model.has_winch:
        slope = (motion.q[3, 0], motion.q[4, 0], motion.q[5, 0])
    attitude = orientation(motion.body)
    twist = twist_angle(n, slope, motion.q, attitude, memory[TWIST])
    pull, slip, heat = swivel_torque(
        model.torsion / length, model.swivel_torque, twist, memory[SWIVEL_SLIP]
    )
    return _Swivel(twist, slip, heat, scale(pull, twist_axis(n, motion.q, attitude)))


@inner
def _expected_wheel_loads(memory: Array) -> wheel_drive.WheelLoads:
    """Torques of the ground as extrapolated from the previous step."""
    return wheel_drive.WheelLoads(
        memory[LEFT_TORQUE],
        memory[LEFT_TORQUE_SLOPE],
        memory[RIGHT_TORQUE],
        memory[RIGHT_TORQUE_SLOPE],
        0.0,
    )


@inner
def _remesh(session: Session, tether: Tether, drum: drums.DrumState) -> bool:
    """Split or merge the exit element if it is too long or too short; returns whether it did."""
    motion, memory = session.motion, session.memory
    n, nominal = tether.elements, tether.element_length
    first = drum.length - n * nominal
    rate = payout_rate(session.model.drum, drum)
    if first > _SPLIT_BEYOND * nominal and n < motion.tether_anchors.shape[0] // 2:
        split_first(
            tether, first, rate, motion.fairlead_slope, motion.q, motion.v, motion.tether_anchors
        )
        memory[ELEMENTS] = n + 1
    elif first < _MERGE_BELOW * nominal and n > 1:
        memory[INPUT_REMESHING] += merge_first(
            tether, first, rate, motion.fairlead_slope, motion.q, motion.v, motion.tether_anchors
        )
        memory[ELEMENTS] = n - 1
    else:
        return False
    session.report[REMESH_COUNT] += 1.0
    return True


@checked
def advance(
    session: Session, drives: DriveStates, commands: DriveCommands, dt: float
) -> tuple[int, int, DriveStates]:
    """Advance the plant by dt; changes the session's arrays in place and allocates nothing.

    Args:
        session: a `Record` of a `Session`: constants; motion, memory, changed; report and events,
            filled; and work arrays, which hold nothing from one call to the next.
        drives: states of the drives.
        commands: of the drives, constant during the call.
        dt: [s].

    Returns:
        Outcome, number of events, and the drives' states. After OUTCOME_DIVERGED the arrays hold
        the last converged state, after OUTCOME_BROKEN the state after the step that broke the
        tether.
    """
    model, motion, solver = session.model, session.motion, session.solver
    memory, report, events, body = session.memory, session.report, session.events, motion.body
    for k in range(REPORT_SIZE):
        report[k] = 0.0
    report[SMALLEST_STEP] = np.inf
    report[PEAK_TENSION] = -np.inf
    reset_rate(solver.convergence)
    count = 0
    # variables of type int64: a literal would compile attempt_step a second time
    past_steps, stored_steps = np.int64(0), np.int64(0)
    elapsed = 0.0
    outcome = OUTCOME_CONVERGED
    start = memory[TIME]
    jump, drum, wheels = drives.jump, drives.drum, drives.wheels
    longest = model.step
    shortest = model.step / (1 << model.max_halvings)
    nominal = model.tether.element_length
    stop_before = 0
    while elapsed < dt * (1.0 - 1e-12):
        n = int(memory[ELEMENTS])
        tether = with_elements(model.tether, n)
        h = longest
        if dt - elapsed < h * (1.0 + 1e-6):
            h = dt - elapsed

        # drives and swivel
        jump_step = jump_drive.begin(
            model.jump,
            model.slider,
            jump,
            commands.jump,
            jump_drive.JumpLoads(body[SLIDE], slide_rate(body), body[SPIN]),
            h,
        )
        if model.has_rover:
            h = jump_step.elapsed
        if h == 0.0:
            jump = jump_drive.at_trip(jump, jump_step)
            count = record_event(
                EVENT_LATCH, start + elapsed, jump.latch, 0.0, body, memory, events, count
            )
            continue
        drum1, drum_out, drum_balance = drums.advance(
            model.drum, drum, commands.drum, memory[FAIRLEAD_TENSION], h
        )
        chain = n * nominal
        pay = Payout(
            drum.length - chain,
            drum1.length - chain,
            payout_rate(model.drum, drum),
            payout_rate(model.drum, drum1),
        )
        swivel = _twist_tether(
            model, n, motion, chain + (pay.length0 if model.has_winch else 0.0), memory
        )

        # tether, rover, screw, wheels and ground
        attempt = attempt_step(
            session,
            tether,
            h,
            StepInputs(
                pay,
                jump,
                jump_step,
                wheels,
                commands.wheels,
                _expected_wheel_loads(memory),
                swivel.torque,
            ),
            past_steps,
        )
        if not attempt.converged:
            past_steps, stored_steps = np.int64(0), np.int64(0)
            reset_rate(solver.convergence)
            if 0.5 * h < shortest:
                outcome = OUTCOME_DIVERGED
                count = record_event(
                    EVENT_DIVERGED, start + elapsed, h, 0.0, body, memory, events, count
                )
                break
            report[HALVINGS] += 1.0
            longest = 0.5 * h
            continue
        longest = min(2.0 * longest, model.step)
        losses = attempt.losses
        z0, dz0 = body[POSITION + 2], body[VELOCITY1 + 2]
        slope0 = vector_at(motion.fairlead_slope[0], 0)
        loads = jump_loads(h, body, solver.rover)
        if model.has_ground and model.has_rover:
            record_wheel_torques(
                model.rover_contact, solver.rover_contact, body, solver.after.body, memory
            )
        _accept_step(model.has_winch, model.has_rover, n, motion, solver.after)
        elapsed += h
        progress = Progress(start, elapsed, h)
        now = start + elapsed

        # energy balance and report
        add_losses(losses, memory)
        report[SMALLEST_STEP] = min(report[SMALLEST_STEP], h)
        report[PEAK_TENSION] = max(report[PEAK_TENSION], losses.peak_tension)
        report[TIP_TENSION] = solver.work.tension[n - 1]
        report[TETHER_CONTACT_POINTS] = losses.touching
        kinetic = 0.0
        if model.has_rover:
            memory[TWIST], memory[SWIVEL_SLIP] = swivel.twist, swivel.slip
            memory[HEAT_SWIVEL] += swivel.heat
            latch = jump.latch
            jump, kinetic = end_jump_drive(session, jump, jump_step, loads, attempt.screw)
            if jump.latch != latch:
                count = record_event(EVENT_LATCH, now, jump.latch, 0.0, body, memory, events, count)
            wheels = attempt.wheels.state
            kinetic += attempt.wheels.balance.kinetic
            end_wheels(session, attempt.wheels)
        if model.has_winch:
            drum = drum1
            kinetic += drum_balance.kinetic
            end_drum(session, tether, pay, slope0, drum_out, drum_balance)
            if drum_out.stop != 0 and stop_before == 0:
                count = record_event(
                    EVENT_DRUM_STOP, now, drum_out.stop, memory[FAIRLEAD_TENSION], body, memory,
                    events, count,
                )  # fmt: skip
            stop_before = drum_out.stop
        else:
            report_root(session)
        memory[DRIVE_KINETIC] = kinetic
        past_steps = record_step(
            solver.history,
            h,
            stored_steps,
            nominal,
            solver.work.increment[:, : row_width(n, 3)],
            solver.extra_increments,
        )
        stored_steps = np.int64(stored_steps + 1 if stored_steps < 3 else 3)

        if model.has_ground and model.has_rover:
            count = follow_flight(session, losses, progress, z0, dz0, count)
        if losses.peak_tension > model.breaking_load:
            outcome = OUTCOME_BROKEN
            count = record_event(
                EVENT_BROKEN, now, losses.peak_tension, losses.peak_tension, body, memory, events,
                count,
            )  # fmt: skip
            break
        if model.has_winch and _remesh(session, tether, drum):
            past_steps, stored_steps = np.int64(0), np.int64(0)
            reset_rate(solver.convergence)

    memory[TIME] = start + (dt if outcome == OUTCOME_CONVERGED else elapsed)
    report[ELAPSED] = elapsed
    drives = DriveStates(jump, drum, wheels)
    _report_end(session, drives)
    count = check_energy(session, start + elapsed, count)
    if outcome == OUTCOME_CONVERGED and report[HALVINGS] > 0.0:
        outcome = OUTCOME_HALVED
    return outcome, count, drives


@inner
def _report_end(session: Session, drives: DriveStates) -> None:
    """Report the energies and the drift between rover attachment and tether tip."""
    model, motion, report = session.model, session.motion, session.report
    parts = energies(session, drives)
    report[KINETIC] = parts[0]
    report[GRAVITY] = parts[1]
    report[AXIAL] = parts[2]
    report[BENDING] = parts[3]
    report[SPRING] = parts[4]
    report[CONTACT] = parts[5]
    report[TORSION] = parts[6]
    if model.has_rover:
        n = int(session.memory[ELEMENTS])
        pose = pose_of(model.rover, motion.body, session.solver.zero_increment)
        square = 0.0
        for d in range(3):
            gap = motion.body[POSITION + d] + pose.attachment0[d] - motion.q[d, n]
            square += gap * gap
        report[CONSTRAINT_DRIFT] = np.sqrt(square)
