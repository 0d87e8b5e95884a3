"""Time stepping of the spatial plant: winch, tether, rover with its drives, and the ground.

A step of length h, which ends early where the jump drive's latch trips, first advances the winch's
drum under the previous step's tension and the wheel drive under the previous step's ground torques.
Then tether, rover, jump drive and ground take one implicit step (`spatial_step`); if its Newton
iteration does not converge, the drives and the implicit step are repeated with half the length.
Finally the exit element at the fairlead is split or merged with the next one (`remesh`) if it is
too long or too short.

World frame: origin at the fairlead, z up. The rover's axes are those of `spatial_rover`.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.integrators.initial_guess import record_step
from rover_sim.physics.integrators.integrator_memory import (
    AIRBORNE,
    AXIAL,
    BENDING,
    CONSTRAINT_DRIFT,
    CONTACT,
    CONTACT_ENERGY,
    CONTACT_TIME,
    DRIVE_KINETIC,
    DRUM_STOP,
    DRUM_STUCK,
    ELAPSED,
    ELEMENTS,
    EVENT_APEX,
    EVENT_BROKEN,
    EVENT_DIVERGED,
    EVENT_DRUM_STOP,
    EVENT_LATCH,
    EVENT_TAKE_OFF,
    EVENT_TOUCHDOWN,
    FAIRLEAD_TENSION,
    FAIRLEAD_X,
    FLYWHEEL_SATURATED,
    GRAVITY,
    HALVINGS,
    HEAT_JUMP,
    HEAT_SLIDER,
    HEAT_SWIVEL,
    HEAT_WHEELS,
    HEAT_WINCH,
    INPUT_JUMP,
    INPUT_REMESHING,
    INPUT_TETHER,
    INPUT_WHEELS,
    INPUT_WINCH,
    JUMP_CURRENT,
    JUMP_TORQUE,
    KINETIC,
    LEFT_TORQUE,
    LEFT_TORQUE_SLOPE,
    MAX_RISE,
    NUT_FORCE,
    OUTCOME_BROKEN,
    OUTCOME_CONVERGED,
    OUTCOME_DIVERGED,
    OUTCOME_HALVED,
    PEAK_TENSION,
    RATCHET,
    REMESH_COUNT,
    REPORT_SIZE,
    RIGHT_TORQUE,
    RIGHT_TORQUE_SLOPE,
    SCREW_HARD_LIMIT,
    SCREW_SOFT_LIMIT,
    SMALLEST_STEP,
    SPRING,
    SWIVEL_SLIP,
    TAKE_OFF_TIME,
    TAKE_OFF_X,
    TAKE_OFF_Y,
    TAKE_OFF_Z,
    TETHER_CONTACT_POINTS,
    TIME,
    TIP_TENSION,
    TORSION,
    TWIST,
    WHEEL_CURRENT,
    WHEEL_TORQUE,
    WINCH_CURRENT,
    WINCH_TORQUE,
    add_losses,
    record_event,
    record_wheel_torques,
    report_loads,
)
from rover_sim.physics.integrators.spatial_step import (
    Model,
    MotionArrays,
    Solver,
    StepInputs,
    attempt_step,
    jump_loads,
    slide_rate,
)
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive, wheel_drive
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.mechanisms.slider import slider_energy
from rover_sim.physics.numerics.compiled import checked, inner
from rover_sim.physics.numerics.event_location import apex_instant, hermite
from rover_sim.physics.numerics.vectors import Vector, dot, scale
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

# The rover is airborne after this time without contact [s]: bounces are part of a landing.
_AIRBORNE_AFTER = 0.02
# An exit element is split or merged beyond these fractions of the nominal element length.
_SPLIT_BEYOND, _MERGE_BELOW = 1.5, 0.5
_RELEASED, _HOOKING = int(Latch.RELEASED), int(Latch.HOOKING)


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
def _pressing(latch: int) -> bool:
    """Whether nut and latch can touch."""
    return latch not in (_RELEASED, _HOOKING)


@inner
def payout_rate(drum: drums.Drum, state: drums.DrumState) -> float:
    """Payout rate of the tether at the drum [m/s]."""
    turns = drum.full_turns - state.angle / (2.0 * np.pi)
    return drums.radius_at(drum, turns) * state.rate


@checked
def energies(
    model: Model, motion: MotionArrays, drives: DriveStates, memory: Array, solver: Solver
) -> tuple[float, float, float, float, float, float, float]:
    """Kinetic, gravity, axial, bending, spring, contact and torsion energy [J].

    The potential of gravity is zero at the fairlead, the contact energy at the run's start.
    Overwrites the solver's arrays of the exit element.
    """
    n = int(memory[ELEMENTS])
    tether = with_elements(model.tether, n)
    kinetic, gravity, axial, bending = tether_energies(tether, motion.q, motion.v)
    kinetic += memory[DRIVE_KINETIC]
    spring, torsion = 0.0, 0.0
    length = n * tether.element_length
    if model.has_winch:
        exit_element = solver.exit_element
        begin_exit(
            solver.origin, motion.fairlead_slope[0], motion.fairlead_slope[1], motion.q, motion.v,
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
            _pressing(drives.jump.latch),
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


@inner
def _tether_inflow(
    tether: Tether, pay: Payout, tension: float, slope0: Vector, fairlead_slope: Array
) -> float:
    """Energy carried through the fairlead by paid-out tether in a step, beyond the drum's work [J].

    The drum's energy balance holds the work v_pay T per time along the unstretched length, but
    stretched tether passes the fairlead at |r'| v_pay and carries kinetic and strain energy:

        dE = v_pay (T (1 - |r'|) + rho A |dr/dt|^2/2 + EA eps^2/2) dt.
    """
    paid_out = pay.length1 - pay.length0
    square = 0.0
    for d in range(3):
        square += (0.5 * (slope0[d] + fairlead_slope[0, d])) ** 2
    strain = 0.5 * (square - 1.0)
    rate = 0.5 * (pay.rate0 + pay.rate1)
    carried = 0.5 * tether.line_density * rate * rate * square
    stored = 0.5 * tether.axial_stiffness * strain * strain
    return paid_out * (tension * (1.0 - np.sqrt(square)) + carried + stored)


@checked
def advance(
    model: Model,
    motion: MotionArrays,
    drives: DriveStates,
    commands: DriveCommands,
    memory: Array,
    dt: float,
    events: Array,
    report: Array,
    solver: Solver,
) -> tuple[int, int, DriveStates]:
    """Advance the plant by dt; changes its arrays in place and allocates nothing.

    Args:
        model: constants.
        motion: arrays of tether and rover, with room for the longest tether; changed.
        drives: states of the drives.
        commands: of the drives, constant during the call.
        memory: see `integrator_memory`, (MEMORY_SIZE,), changed.
        dt: [s].
        events: (m, EVENT_SIZE), filled in order.
        report: (REPORT_SIZE,), filled.
        solver: work arrays; hold nothing from one call to the next.

    Returns:
        Outcome, number of events, and the drives' states. After OUTCOME_DIVERGED the arrays hold
        the last converged state, after OUTCOME_BROKEN the state after the step that broke the
        tether.
    """
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
    body = motion.body
    longest = model.step
    shortest = model.step / (1 << model.max_halvings)
    nominal = model.tether.element_length
    capacity = motion.tether_anchors.shape[0] // 2
    corners = model.rover_contact.corners.shape[0]
    stop_before = 0.0
    while elapsed < dt * (1.0 - 1e-12):
        n = int(memory[ELEMENTS])
        tether = with_elements(model.tether, n)
        h = longest
        if dt - elapsed < h * (1.0 + 1e-6):
            h = dt - elapsed

        # the drives
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
        wheels1, wheel_out, wheel_balance = wheel_drive.advance(
            model.wheels,
            wheels,
            commands.wheels,
            wheel_drive.WheelLoads(
                memory[LEFT_TORQUE],
                memory[LEFT_TORQUE_SLOPE],
                memory[RIGHT_TORQUE],
                memory[RIGHT_TORQUE_SLOPE],
                body[SPIN + 1],
            ),
            h,
        )
        chain = n * nominal
        pay = Payout(
            drum.length - chain,
            drum1.length - chain,
            payout_rate(model.drum, drum),
            payout_rate(model.drum, drum1),
        )

        # the swivel
        slope0 = vector_at(motion.fairlead_slope[0], 0)
        length = chain + (pay.length0 if model.has_winch else 0.0)
        twist, slip, swivel_heat = memory[TWIST], memory[SWIVEL_SLIP], 0.0
        torque = (0.0, 0.0, 0.0)
        if model.has_rover:
            slope = slope0
            if not model.has_winch:
                slope = (motion.q[3, 0], motion.q[4, 0], motion.q[5, 0])
            attitude = orientation(body)
            twist = twist_angle(n, slope, motion.q, attitude, twist)
            pull, slip, swivel_heat = swivel_torque(
                model.torsion / length, model.swivel_torque, twist, slip
            )
            torque = scale(pull, twist_axis(n, motion.q, attitude))

        # tether, rover and ground
        ok, losses, screw = attempt_step(
            model,
            tether,
            h,
            motion,
            StepInputs(
                pay,
                jump,
                jump_step,
                wheel_out.momentum,
                wheel_out.left_rate,
                wheel_out.right_rate,
                torque,
            ),
            past_steps,
            solver,
            report,
        )
        if not ok:
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
        z0, dz0 = body[POSITION + 2], body[VELOCITY1 + 2]
        loads = jump_loads(h, body, solver.rover)
        if model.has_ground and model.has_rover:
            record_wheel_torques(
                model.rover_contact, solver.rover_contact, body, solver.after.body, memory
            )
        _accept_step(model.has_winch, model.has_rover, n, motion, solver.after)
        elapsed += h
        now = start + elapsed

        # energy balance and report
        add_losses(losses, memory)
        report[SMALLEST_STEP] = min(report[SMALLEST_STEP], h)
        report[PEAK_TENSION] = max(report[PEAK_TENSION], losses.peak_tension)
        report[TIP_TENSION] = solver.work.tension[n - 1]
        report[TETHER_CONTACT_POINTS] = losses.touching
        if model.has_rover:
            memory[TWIST], memory[SWIVEL_SLIP] = twist, slip
            memory[HEAT_SWIVEL] += swivel_heat
            jump1, jump_out, jump_balance = jump_drive.end(
                model.jump, model.slider, jump, jump_step, loads, screw
            )
            kinetic = jump_balance.kinetic + wheel_balance.kinetic
            memory[INPUT_JUMP] += jump_balance.motor_work
            memory[HEAT_JUMP] += (
                jump_balance.screw_heat + jump_balance.friction_heat + jump_balance.stop_heat
            )
            memory[INPUT_WHEELS] += wheel_balance.motor_work
            memory[HEAT_WHEELS] += (
                wheel_balance.gear_heat + wheel_balance.friction_heat + wheel_balance.ratchet_heat
            )
            # the elastic energy of nut and latch is lost when the latch releases
            pressed, presses = jump_step.pressing, _pressing(jump1.latch)
            memory[HEAT_SLIDER] += slider_energy(model.slider, pressed, jump1.nut, body[SLIDE])
            memory[HEAT_SLIDER] -= slider_energy(model.slider, presses, jump1.nut, body[SLIDE])
            if jump1.latch != jump.latch:
                count = record_event(
                    EVENT_LATCH, now, jump1.latch, 0.0, body, memory, events, count
                )
            report[JUMP_TORQUE] = jump_out.motor_torque
            report[JUMP_CURRENT] = jump_out.current
            report[NUT_FORCE] = jump_out.nut_force
            report[FLYWHEEL_SATURATED] = 1.0 if jump_out.saturated else 0.0
            report[SCREW_SOFT_LIMIT] = jump_out.soft_limit
            report[SCREW_HARD_LIMIT] = jump_out.hard_limit
            report[WHEEL_TORQUE] = wheel_out.motor_torque
            report[WHEEL_CURRENT] = wheel_out.current
            report[RATCHET] = wheel_out.ratchet
            jump, wheels = jump1, wheels1
        else:
            kinetic = 0.0
        if model.has_winch:
            memory[INPUT_WINCH] += drum_balance.motor_work
            memory[HEAT_WINCH] += (
                drum_balance.gear_heat
                + drum_balance.friction_heat
                + drum_balance.brake_heat
                + drum_balance.stop_heat
            )
            pull_out = solver.exit_element.tension[0]
            memory[INPUT_TETHER] += _tether_inflow(
                tether, pay, pull_out, slope0, motion.fairlead_slope
            )
            kinetic += drum_balance.kinetic
            drum = drum1
            memory[FAIRLEAD_TENSION] = solver.exit_element.tension[0]
            for d in range(3):
                report[FAIRLEAD_X + d] = -solver.exit_element.reaction[d]
            report[WINCH_TORQUE] = drum_out.motor_torque
            report[WINCH_CURRENT] = drum_out.current
            report[DRUM_STUCK] = 1.0 if drum_out.stuck else 0.0
            report[DRUM_STOP] = drum_out.stop
            if drum_out.stop != 0 and stop_before == 0.0:
                count = record_event(
                    EVENT_DRUM_STOP, now, drum_out.stop, memory[FAIRLEAD_TENSION], body, memory,
                    events, count,
                )  # fmt: skip
            stop_before = drum_out.stop
        else:
            memory[FAIRLEAD_TENSION] = solver.work.tension[0]
            slope = (motion.q[3, 0], motion.q[4, 0], motion.q[5, 0])
            pull = memory[FAIRLEAD_TENSION] / np.sqrt(dot(slope, slope))
            for d in range(3):
                report[FAIRLEAD_X + d] = pull * slope[d]
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

        # contact, take-off, apex, touchdown
        if model.has_ground and model.has_rover:
            near = losses.near_ground
            load = report_loads(corners, solver.rover_contact, near, report)
            if load > 0.0:
                if memory[AIRBORNE] != 0.0:
                    count = record_event(
                        EVENT_TOUCHDOWN, now, load, losses.peak_tension, body, memory, events, count
                    )
                memory[AIRBORNE] = 0.0
                memory[CONTACT_TIME] = now
                memory[TAKE_OFF_TIME] = now
                memory[TAKE_OFF_X], memory[TAKE_OFF_Y] = body[POSITION], body[POSITION + 1]
                memory[TAKE_OFF_Z] = body[POSITION + 2]
                memory[MAX_RISE] = 0.0
            else:
                z1, dz1 = body[POSITION + 2], body[VELOCITY1 + 2]
                rise = z1 - memory[TAKE_OFF_Z]
                instant = h
                apex = dz0 > 0.0 >= dz1
                if apex:
                    instant = apex_instant(h, z0, dz0, z1, dz1)
                    rise = hermite(instant, h, z0, dz0, z1, dz1) - memory[TAKE_OFF_Z]
                higher = rise > memory[MAX_RISE]
                memory[MAX_RISE] = max(memory[MAX_RISE], rise)
                if memory[AIRBORNE] == 0.0 and now - memory[CONTACT_TIME] > _AIRBORNE_AFTER:
                    memory[AIRBORNE] = 1.0
                    count = record_event(
                        EVENT_TAKE_OFF, memory[TAKE_OFF_TIME], now - memory[TAKE_OFF_TIME],
                        losses.peak_tension, body, memory, events, count,
                    )  # fmt: skip
                if apex and higher and memory[AIRBORNE] != 0.0:
                    count = record_event(
                        EVENT_APEX, now - h + instant, rise, losses.peak_tension, body, memory,
                        events, count,
                    )  # fmt: skip

        if losses.peak_tension > model.breaking_load:
            outcome = OUTCOME_BROKEN
            count = record_event(
                EVENT_BROKEN, now, losses.peak_tension, losses.peak_tension, body, memory, events,
                count,
            )  # fmt: skip
            break

        # the mesh
        if model.has_winch:
            first = drum.length - chain
            if first > _SPLIT_BEYOND * nominal and n < capacity:
                split_first(
                    tether, first, payout_rate(model.drum, drum), motion.fairlead_slope, motion.q,
                    motion.v, motion.tether_anchors,
                )  # fmt: skip
                memory[ELEMENTS] = n + 1
            elif first < _MERGE_BELOW * nominal and n > 1:
                memory[INPUT_REMESHING] += merge_first(
                    tether, first, payout_rate(model.drum, drum), motion.fairlead_slope, motion.q,
                    motion.v, motion.tether_anchors,
                )  # fmt: skip
                memory[ELEMENTS] = n - 1
            if memory[ELEMENTS] != n:
                report[REMESH_COUNT] += 1.0
                past_steps, stored_steps = np.int64(0), np.int64(0)
                reset_rate(solver.convergence)

    memory[TIME] = start + (dt if outcome == OUTCOME_CONVERGED else elapsed)
    report[ELAPSED] = elapsed
    drives = DriveStates(jump, drum, wheels)
    _report_end(model, motion, drives, memory, report, solver)
    if outcome == OUTCOME_CONVERGED and report[HALVINGS] > 0.0:
        outcome = OUTCOME_HALVED
    return outcome, count, drives


@inner
def _report_end(
    model: Model, motion: MotionArrays, drives: DriveStates, memory: Array, report: Array,
    solver: Solver,
) -> None:  # fmt: skip
    """Report the energies and the drift between rover attachment and tether tip."""
    parts = energies(model, motion, drives, memory, solver)
    report[KINETIC] = parts[0]
    report[GRAVITY] = parts[1]
    report[AXIAL] = parts[2]
    report[BENDING] = parts[3]
    report[SPRING] = parts[4]
    report[CONTACT] = parts[5]
    report[TORSION] = parts[6]
    if model.has_rover:
        n = int(memory[ELEMENTS])
        pose = pose_of(model.rover, motion.body, solver.zero_increment)
        square = 0.0
        for d in range(3):
            gap = motion.body[POSITION + d] + pose.attachment0[d] - motion.q[d, n]
            square += gap * gap
        report[CONSTRAINT_DRIFT] = np.sqrt(square)
