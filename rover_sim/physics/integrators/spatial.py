"""Time stepping of the spatial plant: winch, tether, rover with its drives, and the ground.

A step of length h, which ends early where the jump drive's latch trips, is one implicit step of
winch, tether, rover, jump drive, wheels and ground (`spatial_step`); if its Newton iteration does
not converge, it is repeated with half the length.
Finally the exit element at the fairlead is split or merged with the next one (`remesh`) if it is
too long or too short.

World frame: origin at the fairlead, z up. The rover's axes are those of `spatial_rover`.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.integrators import integrator_memory as entry
from rover_sim.physics.integrators.drive_states import (
    DriveCommands,
    DriveStates,
    read_drives,
    write_drives,
)
from rover_sim.physics.integrators.initial_guess import clear_history, record_step
from rover_sim.physics.integrators.integrator_memory import record_wheel_torques
from rover_sim.physics.integrators.material_frames import (
    end_frames,
    exit_span,
    frame_torque,
    frames_energy,
    remesh_frames,
)
from rover_sim.physics.integrators.session import Session
from rover_sim.physics.integrators.spatial_step import Attempt, StepInputs, attempt_step, jump_loads
from rover_sim.physics.integrators.step_record import (
    Progress,
    add_losses,
    check_energy,
    check_push,
    end_drum,
    end_jump_drive,
    end_wheels,
    follow_flight,
    pressing,
    record_event,
    release_nut,
)
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive
from rover_sim.physics.mechanisms.prescribed_rotors import rotor_momentum
from rover_sim.physics.mechanisms.slider import slider_energy
from rover_sim.physics.numerics.compiled import checked, checked_inner, inner
from rover_sim.physics.numerics.vectors import Vector, dot, scale, sub
from rover_sim.physics.rover.spatial_rover import (
    BODY_SIZE,
    POSITION,
    SLIDE,
    SPIN,
    VELOCITY1,
    orientation,
    pose_of,
    rover_energies,
    slide_rate,
    vector_at,
)
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.driven_end import DrivenEnd, end_position, end_rate
from rover_sim.physics.tether.natural_curvature import natural_energies
from rover_sim.physics.tether.newton import reset_rate
from rover_sim.physics.tether.point_masses import point_mass_energies
from rover_sim.physics.tether.remesh import merge_first, split_first
from rover_sim.physics.tether.tether import Tether, row_width, tether_energies, with_elements
from rover_sim.physics.tether.twist import swivel_torque, twist_angle, twist_axis, twist_energy
from rover_sim.physics.tether.variable_length import begin_exit, exit_energies

# An exit element is split or merged beyond these fractions of the nominal element length.
_SPLIT_BEYOND, _MERGE_BELOW = 1.5, 0.5


@inner
def _move_fairlead(session: Session, time: float, h: float) -> None:
    """Set the motion of a driven fairlead in the step of length h from a time."""
    root, fairlead = session.model.root_motion, session.solver.fairlead
    if root.active:
        before, after = end_position(root, time), end_position(root, time + h)
        rate = end_rate(root, time)
        for d in range(3):
            fairlead[0, d], fairlead[1, d] = before[d], rate[d]
            fairlead[2, d] = after[d] - before[d]


@checked
def energies(session: Session) -> tuple[float, float, float, float, float, float, float]:
    """Kinetic, gravity, axial, bending, spring, contact and torsion energy [J].

    The potential of gravity is zero at the fairlead, the contact energy at the run's start.
    Overwrites the session's arrays of the exit element.
    """
    model, motion, memory = session.model, session.motion, session.memory
    drives = read_drives(session.drives)
    n = int(memory[entry.ELEMENTS])
    tether = with_elements(model.tether, n)
    kinetic, gravity, axial, bending = tether_energies(tether, motion.q, motion.v)
    kinetic += memory[entry.DRIVE_KINETIC]
    more, weight = point_mass_energies(model.masses, tether, motion.q, motion.v)
    kinetic += more
    gravity += weight
    spring, torsion = 0.0, 0.0
    length = n * tether.element_length
    first = 0.0
    if model.has_winch:
        exit_element = session.solver.exit_element
        _move_fairlead(session, memory[entry.TIME], 0.0)
        begin_exit(
            session.solver.fairlead, motion.fairlead_slope[0], motion.fairlead_slope[1], motion.q,
            motion.v, exit_element,
        )  # fmt: skip
        first = drives.drum.length - length
        rate = drums.payout_rate(model.drum, drives.drum)
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
        if not session.natural.active:
            torsion = twist_energy(
                model.torsion / length, memory[entry.TWIST], memory[entry.SWIVEL_SLIP]
            )
    else:
        for d in range(3):
            kinetic += 0.5 * model.tip_mass * motion.v[d, n] ** 2
            gravity -= model.tip_mass * tether.gravity[d] * motion.q[d, n]
    if session.natural.active:
        more, torsion = natural_energies(
            tether, motion.q, exit_span(session, first), session.natural
        )
        bending += more
    return kinetic, gravity, axial, bending, spring, memory[entry.CONTACT_ENERGY], torsion


class _Swivel(NamedTuple):
    """Twist of the tether in a step."""

    twist: float  # [rad]
    slip: float  # [rad]
    heat: float  # [J]
    torque: Vector  # on the rover, world axes [N m]


@inner
def _twist_tether(session: Session, tether: Tether, drum: drums.DrumState) -> _Swivel:
    """Twist and slip of the tether's swivel at the step's start."""
    model, motion, memory = session.model, session.motion, session.memory
    if not model.has_rover:
        return _Swivel(memory[entry.TWIST], memory[entry.SWIVEL_SLIP], 0.0, (0.0, 0.0, 0.0))
    n = tether.elements
    length = n * tether.element_length
    slope = (motion.q[3, 0], motion.q[4, 0], motion.q[5, 0])
    if model.has_winch:
        slope = vector_at(motion.fairlead_slope[0], 0)
        length = drum.length
    attitude = orientation(motion.body)
    twist = twist_angle(n, slope, motion.q, attitude, memory[entry.TWIST])
    if session.natural.active:
        return _Swivel(twist, memory[entry.SWIVEL_SLIP], 0.0, frame_torque(session, tether))
    pull, slip, heat = swivel_torque(
        model.torsion / length, model.swivel_torque, twist, memory[entry.SWIVEL_SLIP]
    )
    return _Swivel(twist, slip, heat, scale(pull, twist_axis(n, motion.q, attitude)))


@inner
def _remesh(session: Session, drum: drums.DrumState, time: float) -> bool:
    """Split or merge the exit element if it is too long or too short; returns whether it did."""
    _move_fairlead(session, time, 0.0)
    motion, memory, fairlead = session.motion, session.memory, session.solver.fairlead
    tether = with_elements(session.model.tether, int(memory[entry.ELEMENTS]))
    n, nominal = tether.elements, tether.element_length
    first = drum.length - n * nominal
    rate = drums.payout_rate(session.model.drum, drum)
    if first > _SPLIT_BEYOND * nominal and n < motion.tether_anchors.shape[0] // 2:
        before = frames_energy(session, tether, first)
        memory[entry.INPUT_REMESHING] += split_first(
            tether, first, rate, fairlead, motion.fairlead_slope, motion.q, motion.v,
            motion.tether_anchors,
        )  # fmt: skip
        memory[entry.ELEMENTS] = n + 1
        remesh_frames(session, tether, True, first, before)
    elif first < _MERGE_BELOW * nominal and n > 1:
        before = frames_energy(session, tether, first)
        memory[entry.INPUT_REMESHING] += merge_first(
            tether, first, rate, fairlead, motion.fairlead_slope, motion.q, motion.v,
            motion.tether_anchors,
        )  # fmt: skip
        memory[entry.ELEMENTS] = n - 1
        remesh_frames(session, tether, False, first, before)
    else:
        return False
    session.report[entry.REMESH_COUNT] += 1.0
    return True


@inner
def _accept_motion(session: Session) -> None:
    """Copy the state of fairlead and rover after the attempted step to the session's state."""
    motion, after = session.motion, session.solver.after
    if session.model.has_winch:
        for r in range(2):
            for d in range(3):
                motion.fairlead_slope[r, d] = after.fairlead_slope[r, d]
    if session.model.has_rover:
        for k in range(BODY_SIZE):
            motion.body[k] = after.body[k]
        for k in range(motion.rover_anchors.shape[0]):
            for d in range(3):
                motion.rover_anchors[k, d] = after.rover_anchors[k, d]


@inner
def _accept_step(
    session: Session,
    tether: Tether,
    drives: DriveStates,
    inputs: StepInputs,
    swivel: _Swivel,
    attempt: Attempt,
    progress: Progress,
) -> DriveStates:
    """Take over the end of an attempted step; record its energies, loads and events.

    Returns:
        The drives' states.
    """
    model, solver, losses = session.model, session.solver, attempt.losses
    memory, report, body = session.memory, session.report, session.motion.body
    z0, dz0 = body[POSITION + 2], body[VELOCITY1 + 2]
    slope0 = vector_at(session.motion.fairlead_slope[0], 0)
    loads = jump_loads(progress.h, body, solver.rover)
    if model.has_ground and model.has_rover:
        record_wheel_torques(solver.rover_contact, memory)
    _accept_motion(session)
    now = progress.start + progress.elapsed
    add_losses(losses, memory)
    report[entry.SMALLEST_STEP] = min(report[entry.SMALLEST_STEP], progress.h)
    report[entry.PEAK_TENSION] = max(report[entry.PEAK_TENSION], losses.peak_tension)
    report[entry.TIP_TENSION] = solver.work.tension[tether.elements - 1]
    jump, wheels, kinetic = drives.jump, drives.wheels, 0.0
    if model.has_rover:
        memory[entry.TWIST], memory[entry.SWIVEL_SLIP] = swivel.twist, swivel.slip
        memory[entry.HEAT_SWIVEL] += swivel.heat
        before = rotor_momentum(model.rotors, now - progress.h)
        turn = vector_at(solver.rover.increment, 0)
        memory[entry.INPUT_ROTORS] -= dot(sub(inputs.rotors, before), turn) / progress.h
        jump, kinetic = end_jump_drive(session, jump, inputs.jump_step, loads, attempt.screw)
        if jump.latch != drives.jump.latch:
            record_event(session, entry.EVENT_LATCH, now, jump.latch, 0.0)
        wheels = attempt.wheels.state
        kinetic += attempt.wheels.balance.kinetic
        end_wheels(session, attempt.wheels)
    drum = drives.drum
    if model.has_winch:
        winch = attempt.winch
        drum = winch.state
        kinetic += winch.balance.kinetic
        stood = report[entry.DRUM_STOP] != 0.0
        end_drum(session, tether, winch.pay, slope0, winch.outputs, winch.balance)
        if winch.outputs.stop != 0 and not stood:
            record_event(
                session,
                entry.EVENT_DRUM_STOP,
                now,
                winch.outputs.stop,
                memory[entry.FAIRLEAD_TENSION],
            )
    else:
        memory[entry.FAIRLEAD_TENSION] = solver.work.tension[0]
    memory[entry.DRIVE_KINETIC] = kinetic
    if session.natural.active:
        end_frames(session, tether, attempt.winch.pay, progress.h)
    if model.has_ground and model.has_rover:
        follow_flight(session, losses, progress, z0, dz0)
    check_push(session, tether, now)
    return DriveStates(jump, drum, wheels)


@inner
def _end_rates(end: DrivenEnd, time: float, h: float) -> tuple[Vector, Vector]:
    """Velocity of a driven end at the start and the end of a step [m/s]."""
    return end_rate(end, time), end_rate(end, time + h)


@inner
def _drive_root(session: Session, time: float, h: float) -> tuple[Vector, Vector]:
    """Velocity of a driven root at the start and the end of a step [m/s]; moves the fairlead."""
    _move_fairlead(session, time, h)
    return _end_rates(session.model.root_motion, time, h)


@inner
def _clear_report(report: Array) -> None:
    for k in range(entry.REPORT_SIZE):
        report[k] = 0.0
    report[entry.SMALLEST_STEP] = np.inf
    report[entry.PEAK_TENSION] = -np.inf


@checked_inner
def _trip_latch(
    session: Session, drives: DriveStates, jump_step: jump_drive.JumpStep, now: float
) -> DriveStates:
    """Trip the latch at the start of a step, whose length is 0; returns the drives' states."""
    jump = jump_drive.at_trip(drives.jump, jump_step)
    release_nut(session, True, jump)
    record_event(session, entry.EVENT_LATCH, now, jump.latch, 0.0)
    return DriveStates(jump, drives.drum, drives.wheels)


@checked_inner
def _step_inputs(
    session: Session,
    drives: DriveStates,
    commands: DriveCommands,
    jump_step: jump_drive.JumpStep,
    torque: Vector,
    now: float,
    h: float,
) -> StepInputs:
    """Inputs of a step of length h, with the tether's torque on the rover; moves the fairlead."""
    memory, model = session.memory, session.model
    return StepInputs(
        drives.drum,
        commands.drum,
        memory[entry.FAIRLEAD_TENSION],
        drives.jump,
        jump_step,
        drives.wheels,
        commands.wheels,
        (memory[entry.LEFT_TORQUE], memory[entry.RIGHT_TORQUE]),
        torque,
        _drive_root(session, now, h),
        _end_rates(model.tip_motion, now, h),
        rotor_momentum(model.rotors, now + h),
    )


@checked
def advance(session: Session, commands: DriveCommands, dt: float) -> int:
    """Advance the plant by dt; changes the session's arrays in place and allocates nothing.

    Args:
        session: a `Record` of a `Session`: constants; the state, changed; report and events,
            filled; and work arrays, which hold nothing from one call to the next.
        commands: of the drives, constant during the call.
        dt: [s].

    Returns:
        Outcome. After OUTCOME_DIVERGED the session holds the last converged state, after
        OUTCOME_BROKEN the state after the step that broke the tether.
    """
    model, solver, memory, report = session.model, session.solver, session.memory, session.report
    body = session.motion.body
    _clear_report(report)
    reset_rate(solver.convergence)
    clear_history(solver.history)
    elapsed = 0.0
    outcome = entry.OUTCOME_CONVERGED
    start = memory[entry.TIME]
    drives = read_drives(session.drives)
    longest = model.step
    # a remainder of dt may be shorter than a halved step by rounding
    shortest = (1.0 - 1e-6) * model.step / (1 << model.max_halvings)
    while outcome == entry.OUTCOME_CONVERGED and elapsed < dt * (1.0 - 1e-12):
        tether = with_elements(model.tether, int(memory[entry.ELEMENTS]))
        h = longest
        if dt - elapsed < h * (1.0 + 1e-6):
            h = dt - elapsed
        slide = jump_drive.JumpLoads(body[SLIDE], slide_rate(model.rover, body), body[SPIN])
        jump_step = jump_drive.begin(model.jump, model.slider, drives.jump, commands.jump, slide, h)
        if model.has_rover:
            h = jump_step.elapsed
        now = start + elapsed
        if h == 0.0:
            drives = _trip_latch(session, drives, jump_step, now)
            continue
        swivel = _twist_tether(session, tether, drives.drum)
        inputs = _step_inputs(session, drives, commands, jump_step, swivel.torque, now, h)
        attempt = attempt_step(session, tether, h, inputs)
        if not attempt.converged:
            clear_history(solver.history)
            reset_rate(solver.convergence)
            if 0.5 * h < shortest:
                outcome = entry.OUTCOME_DIVERGED
                record_event(session, entry.EVENT_DIVERGED, now, h, 0.0)
            else:
                report[entry.HALVINGS] += 1.0
                longest = 0.5 * h
            continue
        longest = min(2.0 * longest, model.step)
        elapsed += h
        progress = Progress(start, elapsed, h)
        drives = _accept_step(session, tether, drives, inputs, swivel, attempt, progress)
        increment = solver.work.increment[:, : row_width(tether.elements, 3)]
        record_step(solver.history, h, tether.element_length, increment, solver.extra_increments)
        peak = attempt.losses.peak_tension
        if peak > model.breaking_load:
            outcome = entry.OUTCOME_BROKEN
            record_event(session, entry.EVENT_BROKEN, start + elapsed, peak, peak)
        elif model.has_winch:
            while _remesh(session, drives.drum, start + elapsed):
                clear_history(solver.history)
                reset_rate(solver.convergence)

    memory[entry.TIME] = start + (dt if outcome == entry.OUTCOME_CONVERGED else elapsed)
    report[entry.ELAPSED] = elapsed
    write_drives(drives, session.drives)
    _report_end(session)
    check_energy(session, start + elapsed)
    if outcome == entry.OUTCOME_CONVERGED and report[entry.HALVINGS] > 0.0:
        outcome = entry.OUTCOME_HALVED
    return outcome


@inner
def _report_end(session: Session) -> None:
    """Report the energies and the drift between rover attachment and tether tip."""
    model, motion, report = session.model, session.motion, session.report
    parts = energies(session)
    report[entry.KINETIC] = parts[0]
    report[entry.GRAVITY] = parts[1]
    report[entry.AXIAL] = parts[2]
    report[entry.BENDING] = parts[3]
    report[entry.SPRING] = parts[4]
    report[entry.CONTACT] = parts[5]
    report[entry.TORSION] = parts[6]
    if model.has_rover:
        n = int(session.memory[entry.ELEMENTS])
        pose = pose_of(model.rover, motion.body, session.solver.zero_increment)
        square = 0.0
        for d in range(3):
            gap = motion.body[POSITION + d] + pose.attachment0[d] - motion.q[d, n]
            square += gap * gap
        report[entry.CONSTRAINT_DRIFT] = np.sqrt(square)
