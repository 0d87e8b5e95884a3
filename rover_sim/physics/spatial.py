"""The plant in space, stepped in time: winch, tether, rover with its drives, and the ground.

A step of length h first moves the drives on: the jump drive (which may end the step early, where
its latch trips), the winch's drum under the tension of the step before, the wheel drive under the
ground's torques of the step before. Then tether, rover and ground go through one implicit step
(`spatial_step`); where its iteration does not converge, drives and all are tried again with half
the step. At last the first element at the fairlead is divided or joined to the next (`remesh`) when
it has become too long or too short.

The world's origin is the fairlead, z points up; the rover's axes are those of `spatial_rover`.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics import drum as drums
from rover_sim.physics import jump_drive, wheel_drive
from rover_sim.physics.ancf import Array
from rover_sim.physics.compiled import checked, inner
from rover_sim.physics.initial_guess import remember
from rover_sim.physics.integrator_memory import (
    AIRBORNE,
    AXIAL,
    BENDING,
    CONSTRAINT_DRIFT,
    CONTACT,
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
    FAIRLEAD_X,
    FLYWHEEL_SATURATED,
    GRAVITY,
    GROUND_STORED,
    HALVINGS,
    HEAT_JUMP,
    HEAT_SLIDER,
    HEAT_SWIVEL,
    HEAT_WHEELS,
    HEAT_WINCH,
    HIGHEST,
    INPUT_JUMP,
    INPUT_TETHER,
    INPUT_WHEELS,
    INPUT_WINCH,
    JUMP_CURRENT,
    JUMP_TORQUE,
    KINETIC,
    LEFT_SLOPE,
    LEFT_TORQUE,
    NUT_FORCE,
    OUTCOME_BROKEN,
    OUTCOME_CONVERGED,
    OUTCOME_DIVERGED,
    OUTCOME_HALVED,
    PEAK_TENSION,
    RATCHET,
    REMESHED,
    REMESHES,
    REPORT_SIZE,
    RIGHT_SLOPE,
    RIGHT_TORQUE,
    SCREW_HARD_LIMIT,
    SCREW_SOFT_LIMIT,
    SLIP,
    SMALLEST_STEP,
    SPRING,
    TAKE_OFF_TIME,
    TAKE_OFF_X,
    TAKE_OFF_Y,
    TAKE_OFF_Z,
    TENSION,
    TETHER_GROUNDED,
    TIME,
    TIP_TENSION,
    TORSION,
    TWIST,
    WHEEL_CURRENT,
    WHEEL_TORQUE,
    WINCH_CURRENT,
    WINCH_TORQUE,
    book_losses,
    record_event,
    remember_torques,
    report_loads,
)
from rover_sim.physics.jump_drive import Latch
from rover_sim.physics.locate import apex_instant, hermite
from rover_sim.physics.newton import distrust
from rover_sim.physics.remesh import merge_first, split_first
from rover_sim.physics.slider import slider_energy
from rover_sim.physics.spatial_rover import (
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
from rover_sim.physics.spatial_step import (
    Actions,
    Model,
    Motion,
    Solver,
    attempt_step,
    slide_rate,
)
from rover_sim.physics.tether import Tether, row_width, tether_energies
from rover_sim.physics.twist import swivel_torque, twist_angle, twist_axis, twist_energy
from rover_sim.physics.variable_length import Payout, begin_exit, exit_energies
from rover_sim.physics.vectors import Vector, dot, scale

# Without contact for so long [s] the rover counts as airborne: bounces are part of a landing.
_AIRBORNE_AFTER = 0.02
# Exit elements longer than this part of the nominal length are divided, shorter ones joined.
_SPLIT_BEYOND, _MERGE_BELOW = 1.5, 0.5
_RELEASED, _HOOKING = int(Latch.RELEASED), int(Latch.HOOKING)


class Machines(NamedTuple):
    """States of the drives."""

    jump: jump_drive.JumpState
    drum: drums.DrumState
    wheels: wheel_drive.WheelState


class Orders(NamedTuple):
    """What the drives are asked to do during a call."""

    jump: jump_drive.JumpCommand
    drum: drums.DrumCommand
    wheels: wheel_drive.WheelCommand


@inner
def with_elements(tether: Tether, elements: int) -> Tether:
    """The same tether with another number of elements of the same length."""
    return Tether(
        elements,
        tether.element_length,
        tether.axial_stiffness,
        tether.bending_stiffness,
        tether.line_density,
        tether.axial_damping_time,
        tether.bending_damping_time,
        tether.numerical_damping,
        tether.gravity,
    )


@inner
def _pressing(latch: int) -> bool:
    """Whether nut and latch can touch."""
    return latch not in (_RELEASED, _HOOKING)


@inner
def payout_rate(drum: drums.Drum, state: drums.DrumState) -> float:
    """Rate of the tether at the drum [m/s]."""
    turns = drum.full_turns - state.angle / (2.0 * np.pi)
    return drums.radius_at(drum, turns) * state.rate


@checked
def energies(
    model: Model, motion: Motion, machines: Machines, book: Array, solver: Solver
) -> tuple[float, float, float, float, float, float, float]:
    """Kinetic, gravity, axial, bending, spring, contact and torsion energy [J].

    Gravity's potential is zero at the fairlead, the contacts' energy at the run's start. Uses the
    solver's arrays of the exit element.
    """
    n = int(book[ELEMENTS])
    tether = with_elements(model.tether, n)
    kinetic, gravity, axial, bending = tether_energies(tether, motion.q, motion.v)
    kinetic += book[DRIVE_KINETIC]
    spring, torsion = 0.0, 0.0
    length = n * tether.element_length
    if model.has_winch:
        exit_ = solver.exit
        begin_exit(solver.origin, motion.mouth[0], motion.mouth[1], motion.q, motion.v, exit_)
        first = machines.drum.length - length
        rate = payout_rate(model.drum, machines.drum)
        parts = exit_energies(tether, first, rate, exit_.start, exit_.rate)
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
            _pressing(machines.jump.latch),
            machines.jump.nut,
            motion.body[SLIDE],
        )
        torsion = twist_energy(model.torsion / length, book[TWIST], book[SLIP])
    else:
        for d in range(3):
            kinetic += 0.5 * model.tip_mass * motion.v[d, n] ** 2
            gravity -= model.tip_mass * tether.gravity[d] * motion.q[d, n]
    return kinetic, gravity, axial, bending, spring, book[GROUND_STORED], torsion


@inner
def _keep(has_winch: bool, has_rover: bool, n: int, motion: Motion, after: Motion) -> None:
    """Make the attempted step's end the state."""
    width = row_width(n, 3)
    for k in range(6):
        for i in range(width):
            motion.q[k, i] = after.q[k, i]
            motion.v[k, i] = after.v[k, i]
    if has_winch:
        for r in range(2):
            for d in range(3):
                motion.mouth[r, d] = after.mouth[r, d]
    if has_rover:
        for k in range(BODY_SIZE):
            motion.body[k] = after.body[k]
        for k in range(motion.feet_anchors.shape[0]):
            for d in range(3):
                motion.feet_anchors[k, d] = after.feet_anchors[k, d]


@inner
def _came_through(
    tether: Tether, pay: Payout, tension: float, slope0: Vector, mouth: Array
) -> float:
    """Energy of the tether that came through the fairlead in a step [J], beside the tension's work.

    The drum's books take what the tension does along the unstretched way, v_pay T, but stretched
    tether passes the fairlead at r' v_pay; and it has its own motion and strain,

        dE = v_pay (T (1 - |r'|) + rho A |dr/dt|^2/2 + EA eps^2/2) dt.
    """
    way = pay.length1 - pay.length0
    square = 0.0
    for d in range(3):
        square += (0.5 * (slope0[d] + mouth[0, d])) ** 2
    strain = 0.5 * (square - 1.0)
    rate = 0.5 * (pay.rate0 + pay.rate1)
    carried = 0.5 * tether.line_density * rate * rate * square
    stored = 0.5 * tether.axial_stiffness * strain * strain
    return way * (tension * (1.0 - np.sqrt(square)) + carried + stored)


@checked
def advance(
    model: Model,
    motion: Motion,
    machines: Machines,
    orders: Orders,
    book: Array,
    dt: float,
    events: Array,
    report: Array,
    solver: Solver,
) -> tuple[int, int, Machines]:
    """Step the plant by dt; arrays in place, without allocating.

    Args:
        model: constants.
        motion: arrays of tether and rover, with room for the longest tether.
        machines: states of the drives.
        orders: commands, held during the call.
        book: (BOOK_SIZE,), changed.
        dt: [s].
        events: (m, EVENT_SIZE), filled in order.
        report: (REPORT_SIZE,), filled.
        solver: work arrays; keep nothing from one call to the next.

    Returns:
        Outcome, number of events, and the drives' states. After OUTCOME_DIVERGED the arrays hold
        the last good state, after OUTCOME_BROKEN that at the end of the step in which it broke.
    """
    for k in range(REPORT_SIZE):
        report[k] = 0.0
    report[SMALLEST_STEP] = np.inf
    report[PEAK_TENSION] = -np.inf
    distrust(solver.control)
    count = 0
    # not literals, for which a step would be compiled apart
    depth, known = np.int64(0), np.int64(0)
    elapsed = 0.0
    outcome = OUTCOME_CONVERGED
    start = book[TIME]
    jump, drum, wheels = machines.jump, machines.drum, machines.wheels
    body = motion.body
    longest = model.step
    shortest = model.step / (1 << model.max_halvings)
    nominal = model.tether.element_length
    capacity = motion.tether_anchors.shape[0] // 2
    corners = model.feet.corners.shape[0]
    stop_before = 0.0
    while elapsed < dt * (1.0 - 1e-12):
        n = int(book[ELEMENTS])
        tether = with_elements(model.tether, n)
        h = longest
        if dt - elapsed < h * (1.0 + 1e-6):
            h = dt - elapsed

        # the drives
        jump1, jump_out, jump_books = jump_drive.advance(
            model.jump,
            model.slider,
            jump,
            orders.jump,
            jump_drive.JumpLoads(body[SLIDE], slide_rate(body), body[SPIN]),
            h,
        )
        if model.has_rover:
            h = jump_out.elapsed
        if h == 0.0:
            count = record_event(
                EVENT_LATCH, start + elapsed, jump1.latch, 0.0, body, book, events, count
            )
            jump = jump1
            continue
        drum1, drum_out, drum_books = drums.advance(model.drum, drum, orders.drum, book[TENSION], h)
        wheels1, wheel_out, wheel_books = wheel_drive.advance(
            model.wheels,
            wheels,
            orders.wheels,
            wheel_drive.WheelLoads(
                book[LEFT_TORQUE],
                book[LEFT_SLOPE],
                book[RIGHT_TORQUE],
                book[RIGHT_SLOPE],
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
        slope0 = vector_at(motion.mouth[0], 0)
        length = chain + (pay.length0 if model.has_winch else 0.0)
        twist, slip, swivel_heat = book[TWIST], book[SLIP], 0.0
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
        ok, losses = attempt_step(
            model,
            tether,
            h,
            motion,
            Actions(
                pay,
                jump_out.nut,
                (jump_out.momentum, wheel_out.momentum, 0.0),
                wheel_out.left_rate,
                wheel_out.right_rate,
                torque,
            ),
            depth,
            solver,
            report,
        )
        if not ok:
            depth, known = np.int64(0), np.int64(0)
            distrust(solver.control)
            if 0.5 * h < shortest:
                outcome = OUTCOME_DIVERGED
                count = record_event(
                    EVENT_DIVERGED, start + elapsed, h, 0.0, body, book, events, count
                )
                break
            report[HALVINGS] += 1.0
            longest = 0.5 * h
            continue
        longest = min(2.0 * longest, model.step)
        z0, dz0 = body[POSITION + 2], body[VELOCITY1 + 2]
        if model.has_ground and model.has_rover:
            remember_torques(model.feet, solver.feet, body, solver.after.body, book)
        _keep(model.has_winch, model.has_rover, n, motion, solver.after)
        elapsed += h
        now = start + elapsed

        # the books
        book_losses(losses, book)
        report[SMALLEST_STEP] = min(report[SMALLEST_STEP], h)
        report[PEAK_TENSION] = max(report[PEAK_TENSION], losses.peak_tension)
        report[TIP_TENSION] = solver.work.tension[n - 1]
        report[TETHER_GROUNDED] = losses.touching
        if model.has_rover:
            book[TWIST], book[SLIP] = twist, slip
            book[HEAT_SWIVEL] += swivel_heat
            kinetic = jump_books.kinetic + wheel_books.kinetic
            book[INPUT_JUMP] += jump_books.motor_work
            book[HEAT_JUMP] += (
                jump_books.screw_heat + jump_books.friction_heat + jump_books.stop_heat
            )
            book[INPUT_WHEELS] += wheel_books.motor_work
            book[HEAT_WHEELS] += (
                wheel_books.gear_heat + wheel_books.friction_heat + wheel_books.ratchet_heat
            )
            # a latch that lets go takes its own elastic energy along
            was, is_ = jump_out.nut.pressing, _pressing(jump1.latch)
            book[HEAT_SLIDER] += slider_energy(model.slider, was, jump1.nut, body[SLIDE])
            book[HEAT_SLIDER] -= slider_energy(model.slider, is_, jump1.nut, body[SLIDE])
            if jump1.latch != jump.latch:
                count = record_event(EVENT_LATCH, now, jump1.latch, 0.0, body, book, events, count)
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
            book[INPUT_WINCH] += drum_books.motor_work
            book[HEAT_WINCH] += (
                drum_books.gear_heat
                + drum_books.friction_heat
                + drum_books.brake_heat
                + drum_books.stop_heat
            )
            pulled = solver.exit.tension[0]
            book[INPUT_TETHER] += _came_through(tether, pay, pulled, slope0, motion.mouth)
            kinetic += drum_books.kinetic
            drum = drum1
            book[TENSION] = solver.exit.tension[0]
            for d in range(3):
                report[FAIRLEAD_X + d] = -solver.exit.reaction[d]
            report[WINCH_TORQUE] = drum_out.motor_torque
            report[WINCH_CURRENT] = drum_out.current
            report[DRUM_STUCK] = 1.0 if drum_out.stuck else 0.0
            report[DRUM_STOP] = drum_out.stop
            if drum_out.stop != 0 and stop_before == 0.0:
                count = record_event(
                    EVENT_DRUM_STOP, now, drum_out.stop, book[TENSION], body, book, events, count
                )
            stop_before = drum_out.stop
        else:
            book[TENSION] = solver.work.tension[0]
            slope = (motion.q[3, 0], motion.q[4, 0], motion.q[5, 0])
            pull = book[TENSION] / np.sqrt(dot(slope, slope))
            for d in range(3):
                report[FAIRLEAD_X + d] = pull * slope[d]
        book[DRIVE_KINETIC] = kinetic
        depth = remember(
            solver.history,
            h,
            known,
            nominal,
            solver.work.increment[:, : row_width(n, 3)],
            solver.moves,
        )
        known = np.int64(known + 1 if known < 3 else 3)

        # touching, taking off, flying, landing
        if model.has_ground and model.has_rover:
            near = losses.near_ground
            load = report_loads(corners, solver.feet, near, report)
            if load > 0.0:
                if book[AIRBORNE] != 0.0:
                    count = record_event(
                        EVENT_TOUCHDOWN, now, load, losses.peak_tension, body, book, events, count
                    )
                book[AIRBORNE] = 0.0
                book[CONTACT_TIME] = now
                book[TAKE_OFF_TIME] = now
                book[TAKE_OFF_X], book[TAKE_OFF_Y] = body[POSITION], body[POSITION + 1]
                book[TAKE_OFF_Z] = body[POSITION + 2]
                book[HIGHEST] = 0.0
            else:
                z1, dz1 = body[POSITION + 2], body[VELOCITY1 + 2]
                rise = z1 - book[TAKE_OFF_Z]
                instant = h
                apex = dz0 > 0.0 >= dz1
                if apex:
                    instant = apex_instant(h, z0, dz0, z1, dz1)
                    rise = hermite(instant, h, z0, dz0, z1, dz1) - book[TAKE_OFF_Z]
                higher = rise > book[HIGHEST]
                book[HIGHEST] = max(book[HIGHEST], rise)
                if book[AIRBORNE] == 0.0 and now - book[CONTACT_TIME] > _AIRBORNE_AFTER:
                    book[AIRBORNE] = 1.0
                    count = record_event(
                        EVENT_TAKE_OFF, book[TAKE_OFF_TIME], now - book[TAKE_OFF_TIME],
                        losses.peak_tension, body, book, events, count,
                    )  # fmt: skip
                if apex and higher and book[AIRBORNE] != 0.0:
                    count = record_event(
                        EVENT_APEX, now - h + instant, rise, losses.peak_tension, body, book,
                        events, count,
                    )  # fmt: skip

        if losses.peak_tension > model.breaking_load:
            outcome = OUTCOME_BROKEN
            count = record_event(
                EVENT_BROKEN, now, losses.peak_tension, losses.peak_tension, body, book, events,
                count,
            )  # fmt: skip
            break

        # the mesh
        if model.has_winch:
            first = drum.length - chain
            if first > _SPLIT_BEYOND * nominal and n < capacity:
                split_first(
                    tether, first, payout_rate(model.drum, drum), motion.mouth, motion.q, motion.v,
                    motion.tether_anchors,
                )  # fmt: skip
                book[ELEMENTS] = n + 1
            elif first < _MERGE_BELOW * nominal and n > 1:
                book[REMESHED] += merge_first(
                    tether, first, payout_rate(model.drum, drum), motion.mouth, motion.q, motion.v,
                    motion.tether_anchors,
                )  # fmt: skip
                book[ELEMENTS] = n - 1
            if book[ELEMENTS] != n:
                report[REMESHES] += 1.0
                depth, known = np.int64(0), np.int64(0)
                distrust(solver.control)

    book[TIME] = start + (dt if outcome == OUTCOME_CONVERGED else elapsed)
    report[ELAPSED] = elapsed
    machines = Machines(jump, drum, wheels)
    _report_end(model, motion, machines, book, report, solver)
    if outcome == OUTCOME_CONVERGED and report[HALVINGS] > 0.0:
        outcome = OUTCOME_HALVED
    return outcome, count, machines


@inner
def _report_end(
    model: Model, motion: Motion, machines: Machines, book: Array, report: Array, solver: Solver
) -> None:
    """Report energies and how far the rover's own place has drifted from the tether's end."""
    parts = energies(model, motion, machines, book, solver)
    report[KINETIC] = parts[0]
    report[GRAVITY] = parts[1]
    report[AXIAL] = parts[2]
    report[BENDING] = parts[3]
    report[SPRING] = parts[4]
    report[CONTACT] = parts[5]
    report[TORSION] = parts[6]
    if model.has_rover:
        n = int(book[ELEMENTS])
        pose = pose_of(model.rover, motion.body, solver.no_turn)
        square = 0.0
        for d in range(3):
            gap = motion.body[POSITION + d] + pose.attachment0[d] - motion.q[d, n]
            square += gap * gap
        report[CONSTRAINT_DRIFT] = np.sqrt(square)
