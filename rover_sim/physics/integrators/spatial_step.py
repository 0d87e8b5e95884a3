"""One time step of the spatial plant: winch, tether, rover and ground in one Newton iteration.

The unknowns are the increments of the tether's chain (`energy_momentum`), of the exit slope at the
fairlead (`variable_length`) and of the rover's rotation and slide (`spatial_rover`); the contact
forces on tether (`tether_contact`) and rover (`rover_contact`) and the motions of the drum
(`drum`), of the screw (`jump_drive`) and of the wheels with their ratchets (`wheel_drive`) are
functions of these increments. For each iterate the wheels turn such that drive and ground agree,
because friction on rock is far stiffer than a wheel's inertia: forces and spins that are corrected
in turn do not converge, and create energy. So does the drum: it turns such that its torque balance
and the exit element agree on the tension, which a stiff tether changes by more than a light drum
bears.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.ground.rover_contact import (
    add_corner_contact,
    add_wheel_contact,
    begin_rover_contact,
    end_rover_contact,
    place_wheels,
    roll_wheels,
    shift_spin,
    solve_torques,
)
from rover_sim.physics.ground.tether_contact import (
    TetherContactTotals,
    add_tether_contact,
    begin_tether_contact,
    end_tether_contact,
)
from rover_sim.physics.integrators.initial_guess import ORDER, extrapolate
from rover_sim.physics.integrators.session import Model, MotionArrays, Session, Solver
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive, wheel_drive
from rover_sim.physics.mechanisms.jump_drive import JumpLoads, JumpResponse, JumpState, JumpStep
from rover_sim.physics.mechanisms.slider import slider_energy, slider_force
from rover_sim.physics.mechanisms.wheel_drive import (
    WheelCommand,
    WheelEnergyBalance,
    WheelLoads,
    WheelOutputs,
    WheelState,
)
from rover_sim.physics.numerics.compiled import checked_inner, inner
from rover_sim.physics.numerics.vectors import Vector, cayley, rotate, rotation_of
from rover_sim.physics.rover.spatial_rover import (
    SLIDE,
    SPIN,
    Pose,
    RoverStep,
    add_rover,
    apply_rover_increment,
    clear_loads,
    end_rover_step,
    orientation,
    pose_of,
    slide_rate,
    vector_at,
)
from rover_sim.physics.tether.air_drag import add_drag, drag_loss
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import (
    Workspace,
    assemble,
    begin_ends,
    begin_step,
    end_step,
    largest_turn,
    set_end,
    solve_increment,
)
from rover_sim.physics.tether.natural_curvature import (
    add_natural_curvature,
    begin_natural_curvature,
)
from rover_sim.physics.tether.newton import CONTINUE, FAILED, MAX_ROTATION, convergence_status
from rover_sim.physics.tether.point_masses import add_point_masses
from rover_sim.physics.tether.tether import Tether, row_width
from rover_sim.physics.tether.variable_length import (
    Payout,
    PayoutChange,
    add_exit,
    apply_exit_increment,
    begin_exit,
    end_exit_step,
    tension_for,
)

# Iterations of the wheels: their largest number, and the changes of a wheel's slip, as fractions of
# the slip that friction resolves, up to which its tangent holds and up to which forces are linear.
_MAX_ROLLS, _TANGENT, _LINEAR = 30, 0.5, 0.1
# Last increment of the rover in an iteration beyond which the loads on it are evaluated once more,
# in tolerances.
_STIFF = 10.0
# Evaluations of the drum for an iterate, at most; the difference of its tension and the exit
# element's that is left, relative to the tension and to the stiffness of the damped tether, whose
# strains have rounding errors; and the tension's increase for derivatives, relative and in N.
_MAX_TURNS, _TENSION_SHARE, _STRAIN_NOISE = 40, 1e-10, 1e-13
_INCREASE_SHARE, _INCREASE = 1e-3, 1e-3


class StepInputs(NamedTuple):
    """Inputs of a step from drives and swivel."""

    drum: drums.DrumState
    drum_command: drums.DrumCommand
    tension: float  # at the fairlead in the last step [N]
    jump: JumpState
    jump_step: JumpStep
    wheels: WheelState
    wheel_command: WheelCommand
    wheel_torques: tuple[float, float]  # of the ground in the last step, left and right [N m]
    torque: Vector  # of the tether on the rover, world axes [N m]
    root_rates: tuple[Vector, Vector]  # velocity of a driven root at start and end [m/s]
    tip_rates: tuple[Vector, Vector]  # the same of a driven tip
    rotors: Vector  # momentum of the prescribed rotors at the end, in base_link [N m s]


class WheelMotion(NamedTuple):
    """Motion of the wheel drive in a step."""

    state: WheelState
    outputs: WheelOutputs
    balance: WheelEnergyBalance


class WinchMotion(NamedTuple):
    """Motion of the drum in a step, and what it pays out."""

    tension: float  # of the tether on the drum [N]
    state: drums.DrumState
    outputs: drums.DrumOutputs
    balance: drums.DrumEnergyBalance
    pay: Payout


class Losses(NamedTuple):
    """Energy losses of a step [J], with its contact state and peak tension."""

    tether: float
    slider: float
    rover_ground: float
    tether_ground: float
    air: float  # work on the air
    ends: float  # work of what drives the tether's ends, an input
    rover_stored: float  # change of the energy stored by the rover's contacts
    tether_stored: float  # the same by the tether's contacts
    near_ground: bool  # whether the rover's contacts were evaluated
    peak_tension: float  # [N]


class Attempt(NamedTuple):
    """Result of `attempt_step`."""

    converged: bool  # to a valid state
    losses: Losses
    screw: JumpResponse
    wheels: WheelMotion
    winch: WinchMotion


@inner
def _set_initial_guess(
    model: Model,
    n: int,
    h: float,
    motion: MotionArrays,
    inputs: StepInputs,
    solver: Solver,
) -> None:
    """Set the initial guess from the history of the previous steps, or from the rates.

    Driven ends have their increments.
    """
    width = row_width(n, 3)
    increment = solver.work.increment
    extra_increments = solver.extra_increments
    if solver.history.counts[ORDER] == 0.0:
        for k in range(6):
            for i in range(width):
                increment[k, i] = h * motion.v[k, i]
        for d in range(3):
            extra_increments[d] = h * motion.body[SPIN + d]
            extra_increments[4 + d] = h * motion.fairlead_slope[1, d]
        extra_increments[3] = h * slide_rate(model.rover, motion.body)
    else:
        extrapolate(solver.history, h, increment[:, :width], extra_increments)
    if not model.has_winch:
        for d in range(3):
            increment[d, 0] = 0.5 * h * (inputs.root_rates[0][d] + inputs.root_rates[1][d])
            extra_increments[4 + d] = 0.0
    if model.tip_motion.active:
        for d in range(3):
            increment[d, n] = 0.5 * h * (inputs.tip_rates[0][d] + inputs.tip_rates[1][d])
    if not model.has_rover:
        for k in range(4):
            extra_increments[k] = 0.0
    for k in range(4):
        solver.rover.increment[k] = extra_increments[k]
    for d in range(3):
        solver.exit_element.increment[d] = extra_increments[4 + d]


@inner
def _add_point_mass(model: Model, n: int, h: float, v: Array, work: Workspace) -> None:
    """Add the point mass to the tip."""
    for d in range(3):
        force = 2.0 / h * (work.increment[d, n] / h - v[d, n]) - model.tether.gravity[d]
        set_end(work, 1, 6, d, model.tip_mass * force)
        set_end(work, 1, d, d, 2.0 * model.tip_mass / h**2)


@inner
def _load_rover(
    session: Session, n: int, h: float, inputs: StepInputs, near: bool
) -> tuple[WheelMotion, float]:
    """Loads on the rover by slider, tether twist, wheels and ground.

    Returns:
        Motion of the wheels at which drive and ground agree, and its last correction [m].
    """
    model, motion, solver = session.model, session.motion, session.solver
    step, contact = solver.rover, solver.rover_contact
    clear_loads(step)
    _add_slider(model, h, motion.body, inputs, step)
    for d in range(3):
        step.load[3 + d] = inputs.torque[d]
    pose = pose_of(model.rover, motion.body, step.increment)
    if near:
        increment = solver.work.increment
        dr = (increment[0, n], increment[1, n], increment[2, n])
        add_corner_contact(
            model.rover_contact,
            model.terrain,
            model.rover.attachment,
            h,
            pose,
            motion.body,
            dr,
            motion.rover_anchors,
            step,
            contact,
        )
        place_wheels(
            model.rover_contact,
            model.terrain,
            model.rover.attachment,
            pose,
            motion.body,
            dr,
            contact,
        )
    wheels, correction = _roll(session, h, inputs, pose)
    step.rotors_after[1] = wheels.outputs.momentum + inputs.rotors[1]
    step.rotors_after[2] = inputs.rotors[2]
    add_wheel_contact(
        model.rover_contact,
        model.rover.attachment,
        h,
        pose,
        wheels.outputs.response,
        -2.0 / h**2 * model.wheels.wheel_inertia,
        step,
        contact,
    )
    return wheels, correction


@inner
def _roll(session: Session, h: float, inputs: StepInputs, pose: Pose) -> tuple[WheelMotion, float]:
    """Motion of the wheels at which drive and ground agree, and its last correction [m].

    Newton's method for the ground's torques. Where it would change the slip by more than the
    friction resolves, it takes the secant from a rolling wheel instead of the tangent (Kachanov's
    method): friction saturates, and with its small tangent a light wheel would overshoot.
    """
    model, contact = session.model, session.solver.rover_contact
    radius = model.rover_contact.tip_radius
    torque, wheel = contact.ground_torque, contact.wheel
    left, right = 0.0, 0.0
    wheels = _turn_wheels(session, h, inputs)
    for _ in range(_MAX_ROLLS):
        contact.spin[0], contact.spin[1] = wheels.outputs.left_rate, wheels.outputs.right_rate
        roll_wheels(
            model.rover_contact, model.terrain, h, pose, session.motion.rover_anchors, contact
        )
        response = wheels.outputs.response
        rest0, rest1 = -torque[0] - wheel[0, 0], -torque[1] - wheel[1, 0]
        d0, d1 = solve_torques(response, wheel[0, 1], wheel[1, 1], rest0, rest1)
        left = radius * abs(response.left * d0 + response.cross * d1)
        right = radius * abs(response.cross * d0 + response.right * d1)
        if left > _TANGENT * wheel[0, 3] or right > _TANGENT * wheel[1, 3]:
            slope0 = wheel[0, 2] if left > _TANGENT * wheel[0, 3] else wheel[0, 1]
            slope1 = wheel[1, 2] if right > _TANGENT * wheel[1, 3] else wheel[1, 1]
            d0, d1 = solve_torques(response, slope0, slope1, rest0, rest1)
        if d0 == 0.0 and d1 == 0.0:  # no contact
            break
        torque[0] += d0
        torque[1] += d1
        wheels = _turn_wheels(session, h, inputs)
        left = radius * abs(wheels.outputs.left_rate - contact.spin[0])
        right = radius * abs(wheels.outputs.right_rate - contact.spin[1])
        if left <= _LINEAR * wheel[0, 3] and right <= _LINEAR * wheel[1, 3]:
            break
    shift_spin(model.rover_contact, 0, wheels.outputs.left_rate, contact)
    shift_spin(model.rover_contact, 1, wheels.outputs.right_rate, contact)
    return wheels, h * (left + right)


@checked_inner
def _turn_drum(
    session: Session, tether: Tether, h: float, inputs: StepInputs, tension: float
) -> WinchMotion:
    """Advance the drum under a tension [N]."""
    drum, before = session.model.drum, inputs.drum
    after, outputs, balance = drums.advance(drum, before, inputs.drum_command, tension, h)
    chain = tether.elements * tether.element_length
    pay = Payout(
        before.length - chain,
        after.length - chain,
        drums.payout_rate(drum, before),
        drums.payout_rate(drum, after),
    )
    return WinchMotion(tension, after, outputs, balance, pay)


@inner
def _pays_alike(first: Payout, second: Payout) -> bool:
    """Whether two motions of the drum end in the same length and rate."""
    return first.length1 == second.length1 and first.rate1 == second.rate1


@checked_inner
def _wind(
    session: Session, tether: Tether, h: float, inputs: StepInputs, winch: WinchMotion, slope: float
) -> WinchMotion:
    """Motion of the drum at which its torque balance and the exit element agree on the tension.

    The more the tension, the more is paid out, and the more is paid out, the less is the tension:
    there is one solution. The secant method finds it, kept between the bounds known so far, as the
    drum's motion has kinks where it comes to rest or leaves it.

    Args:
        session: as of `attempt_step`.
        tether: as of `attempt_step`.
        h: [s].
        inputs: from the drives.
        winch: motion at a first guess of the tension.
        slope: first guess of the change of the exit element's tension per change of the drum's,
            by what it pays out [-], at most 0.
    """
    solver = session.solver
    rounding = _STRAIN_NOISE * tether.axial_stiffness * (1.0 + tether.axial_damping_time / h)
    low, high = -np.inf, np.inf
    found = tension_for(tether, h, winch.pay, solver.work, solver.exit_element)
    for _ in range(_MAX_TURNS):
        gap = found - winch.tension
        if not abs(gap) > rounding + _TENSION_SHARE * abs(winch.tension):
            break
        if gap > 0.0:
            low = winch.tension
        else:
            high = winch.tension
        tension = winch.tension + gap / (1.0 - slope)
        if not low < tension < high:
            tension = 0.5 * (low + high)
        if tension == winch.tension:
            break
        following = _turn_drum(session, tether, h, inputs, tension)
        before = found
        if not _pays_alike(following.pay, winch.pay):
            found = tension_for(tether, h, following.pay, solver.work, solver.exit_element)
        slope = min((found - before) / (tension - winch.tension), 0.0)
        winch = following
    return winch


@inner
def _payout_change(
    session: Session, tether: Tether, h: float, inputs: StepInputs, winch: WinchMotion
) -> PayoutChange:
    """What the drum pays out at a somewhat larger tension."""
    if winch.outputs.stuck:
        return PayoutChange(winch.pay, 0.0)
    step = _INCREASE + _INCREASE_SHARE * abs(winch.tension)
    beyond = _turn_drum(session, tether, h, inputs, winch.tension + step)
    if _pays_alike(beyond.pay, winch.pay):
        return PayoutChange(winch.pay, 0.0)
    return PayoutChange(beyond.pay, step)


@inner
def jump_loads(h: float, body: Array, step: RoverStep) -> JumpLoads:
    """Motion of the bodies in the step, as input of the jump drive."""
    return JumpLoads(body[SLIDE], step.increment[3] / h, 2.0 / h * step.increment[0] - body[SPIN])


@inner
def _add_slider(model: Model, h: float, body: Array, inputs: StepInputs, step: RoverStep) -> None:
    """Add slider and screw: the force between the bodies and the flywheel's momentum."""
    screw = jump_drive.respond(
        model.jump, model.slider, inputs.jump, inputs.jump_step, jump_loads(h, body, step)
    )
    slide = slider_force(model.slider, body[SLIDE], step.increment[3], h)
    step.slide[0] = slide.force - screw.force
    step.slide[1] = slide.by_change - screw.force_by_change
    step.rotors_after[0] = screw.momentum + inputs.rotors[0]
    axis = rotate(
        rotation_of(orientation(body)), cayley(vector_at(step.increment, 0), (1.0, 0.0, 0.0))
    )
    step.load_tangent[6, 0] -= 2.0 / h * screw.force_by_rate
    for d in range(3):
        step.load_tangent[3 + d, 0] -= 2.0 / h**2 * screw.momentum_by_rate * axis[d]
        step.load_tangent[3 + d, 3] -= screw.momentum_by_change / h * axis[d]


@inner
def _end_slider(
    model: Model, h: float, body: Array, inputs: StepInputs, step: RoverStep
) -> tuple[float, JumpResponse]:
    """Heat of slider and pads [J], and the screw's motion."""
    s0, ds = body[SLIDE], step.increment[3]
    screw = jump_drive.respond(
        model.jump, model.slider, inputs.jump, inputs.jump_step, jump_loads(h, body, step)
    )
    force = slider_force(model.slider, s0, ds, h).force - screw.force
    travel = model.jump.pitch * (screw.motion.first + screw.motion.second)
    nut, pressing = inputs.jump.nut, inputs.jump_step.pressing
    stored = slider_energy(model.slider, pressing, nut + travel, s0 + ds)
    stored -= slider_energy(model.slider, pressing, nut, s0)
    step.rotors_after[0] = screw.momentum + inputs.rotors[0]
    return screw.force * travel - force * ds - stored, screw


@inner
def _begin_attempt(
    session: Session, tether: Tether, h: float, inputs: StepInputs
) -> tuple[int, bool]:
    """Prepare all parts; returns the number of tether points and whether the rover is near ground.

    Arguments as for `attempt_step`.
    """
    model, motion, solver = session.model, session.motion, session.solver
    n, work = tether.elements, solver.work
    for k in range(6):
        work.end_fixed[0, k] = 0.0 if model.has_winch or k >= 3 else 1.0
        work.end_fixed[1, k] = 1.0 if model.tip_motion.active and k < 3 else 0.0
    begin_ends(tether, work)
    _set_initial_guess(model, n, h, motion, inputs, solver)
    begin_step(tether, h, motion.q, motion.v, work)
    if model.has_winch:
        begin_exit(
            solver.fairlead,
            motion.fairlead_slope[0],
            motion.fairlead_slope[1],
            motion.q,
            motion.v,
            solver.exit_element,
        )
    if session.natural.active:
        begin_natural_curvature(tether, motion.q, session.natural)
    if not model.has_ground:
        return 0, False
    points = begin_tether_contact(
        model.terrain,
        tether,
        h,
        motion.q,
        motion.v,
        motion.tether_anchors,
        solver.history.counts[ORDER] > 0.0,
        solver.tether_contact,
    )
    if not model.has_rover:
        return points, False
    return points, begin_rover_contact(
        model.rover_contact,
        model.terrain,
        h,
        pose_of(model.rover, motion.body, solver.rover.increment),
        motion.body,
        motion.rover_anchors,
        solver.rover_contact,
    )


@inner
def _turn_wheels(session: Session, h: float, inputs: StepInputs) -> WheelMotion:
    """Advance the wheels under the ground's torques, with Body 1's rate of the increment."""
    torque = session.solver.rover_contact.ground_torque
    rate = 2.0 / h * session.solver.rover.increment[1] - session.motion.body[SPIN + 1]
    state, outputs, balance = wheel_drive.advance(
        session.model.wheels,
        inputs.wheels,
        inputs.wheel_command,
        WheelLoads(torque[0], torque[1], rate),
        h,
    )
    return WheelMotion(state, outputs, balance)


@inner
def _assemble_chain(session: Session, tether: Tether, h: float, points: int) -> None:
    """Residual and tangent of the tether's chain with its laws, point masses and ground."""
    model, motion, work = session.model, session.motion, session.solver.work
    assemble(tether, h, work)
    if model.drag.normal > 0.0:
        add_drag(model.drag, tether, h, motion.q, work)
    if session.natural.active:
        add_natural_curvature(tether, motion.q, work, session.natural)
    if model.masses.mass.size > 0:
        add_point_masses(model.masses, tether, h, motion.v, work)
    if points > 0:
        add_tether_contact(
            model.terrain,
            model.tether_contact,
            tether,
            h,
            motion.tether_anchors,
            work,
            session.solver.tether_contact,
        )


@inner
def _work_of_ends(session: Session, tether: Tether, h: float, points: int) -> float:
    """Work on the tether by what drives its ends in the step [J]: residual times increment."""
    model, work = session.model, session.solver.work
    total = 0.0
    root_driven = model.root_motion.active and not model.has_winch
    if root_driven or model.tip_motion.active:
        n = tether.elements
        _assemble_chain(session, tether, h, points)
        for d in range(3):
            if root_driven:
                total += work.blocks[1, 0, 6, d] * work.increment[d, 0]
            if model.tip_motion.active:
                total += work.blocks[n, 1, 6, d] * work.increment[d, n]
    return total


@checked_inner
def _iterate(
    session: Session, tether: Tether, h: float, inputs: StepInputs, points: int, near_rover: bool
) -> tuple[int, WheelMotion, WinchMotion]:
    """Newton's iteration from the current increments.

    Returns:
        Its `convergence_status`, and the motions of wheels and drum.
    """
    model, motion, solver = session.model, session.motion, session.solver
    n, work = tether.elements, solver.work
    torque = solver.rover_contact.ground_torque
    torque[0], torque[1] = inputs.wheel_torques
    wheels = _turn_wheels(session, h, inputs)
    winch = _turn_drum(session, tether, h, inputs, inputs.tension)
    slope = 0.0
    previous, moved = np.inf, 0.0
    status = CONTINUE
    iteration = 0
    while status == CONTINUE:
        rolled = 0.0
        if model.has_rover:
            wheels, rolled = _load_rover(session, n, h, inputs, near_rover)
            add_rover(
                model.rover, model.tether.gravity, h, n, motion.body, solver.work, solver.rover
            )
        elif not model.tip_motion.active:
            _add_point_mass(model, n, h, motion.v, work)
        if model.has_winch:
            winch = _wind(session, tether, h, inputs, winch, slope)
            change_of_pay = _payout_change(session, tether, h, inputs, winch)
            slope = add_exit(
                tether, h, winch.pay, change_of_pay, session.natural, work, solver.exit_element
            )
        _assemble_chain(session, tether, h, points)
        change = rolled + solve_increment(tether, work)
        moved = rolled
        if model.has_rover:
            turned = apply_rover_increment(n, work, solver.rover)
            change += turned
            moved += turned
            for d in range(3):
                moved += abs(work.solution[n + 1, d])
        if model.has_winch:
            change += apply_exit_increment(winch.pay.length0, work, solver.exit_element)
        session.report[0] += 1.0
        status = convergence_status(
            iteration, change, previous, model.tolerance, solver.convergence
        )
        previous = change
        iteration += 1
    if model.has_rover and moved > _STIFF * model.tolerance:
        # the last increment changes the forces of stiff contacts, whose work the balance needs
        wheels, _ = _load_rover(session, n, h, inputs, near_rover)
    if model.has_winch and not winch.outputs.stuck:
        winch = _wind(session, tether, h, inputs, winch, slope)
    return status, wheels, winch


@inner
def _end_attempt(
    session: Session,
    tether: Tether,
    h: float,
    inputs: StepInputs,
    pay: Payout,
    points: int,
    near_rover: bool,
) -> tuple[Losses, JumpResponse]:
    """Write the end state of all parts; returns the losses and the screw's motion."""
    model, motion, solver = session.model, session.motion, session.solver
    n, step, after = tether.elements, solver.rover, solver.after
    ends = _work_of_ends(session, tether, h, points)
    for k in range(4):
        solver.extra_increments[k] = step.increment[k]
    for d in range(3):
        solver.extra_increments[4 + d] = solver.exit_element.increment[d]
    slider_heat, rover_heat, rover_stored = 0.0, 0.0, 0.0
    screw = jump_drive.AT_REST
    if model.has_rover:
        slider_heat, screw = _end_slider(model, h, motion.body, inputs, step)
        end_rover_step(model.rover, h, n, motion.body, solver.work, step, after.body)
        if near_rover:
            ground_work, rover_stored = end_rover_contact(
                model.rover_contact,
                model.terrain,
                h,
                pose_of(model.rover, motion.body, step.increment),
                motion.rover_anchors,
                solver.rover_contact,
                after.rover_anchors,
            )
            rover_heat = -ground_work - rover_stored
        else:
            for k in range(after.rover_anchors.shape[0]):
                for d in range(3):
                    after.rover_anchors[k, d] = 0.0
    exit_heat, exit_tension = 0.0, -np.inf
    if model.has_winch:
        exit_heat = end_exit_step(
            tether,
            h,
            pay,
            solver.work,
            solver.exit_element,
            after.fairlead_slope[0],
            after.fairlead_slope[1],
        )
        exit_tension = solver.exit_element.tension[0]
        for d in range(3):
            ends += solver.exit_element.reaction[d] * solver.fairlead[2, d]
    ground = TetherContactTotals(0.0, 0.0)
    if model.has_ground:
        ground = end_tether_contact(
            model.tether_contact,
            tether,
            h,
            motion.tether_anchors,
            solver.work,
            solver.tether_contact,
        )
    air = 0.0
    if model.drag.normal > 0.0:
        air = drag_loss(model.drag, tether, h, motion.q, solver.work)
    heat, peak = end_step(tether, h, motion.q, motion.v, solver.work, motion.q, motion.v)
    return Losses(
        heat + exit_heat,
        slider_heat,
        rover_heat,
        ground.dissipated,
        air,
        ends,
        rover_stored,
        ground.stored_change,
        near_rover,
        max(peak, exit_tension),
    ), screw


@checked_inner
def attempt_step(session: Session, tether: Tether, h: float, inputs: StepInputs) -> Attempt:
    """Attempt one step of length h; its initial guess extrapolates from the solver's history.

    If the step succeeds, tether and anchors of the tether in `motion` are those of its end, and
    solver.after has the other parts.

    Args:
        session: constants, state and work arrays; entry 0 of its report counts the Newton
            iterations.
        tether: model.tether with the chain's current number of elements.
        h: [s].
        inputs: from the drives.
    """
    losses = Losses(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, 0.0)
    screw = jump_drive.AT_REST
    points, near_rover = _begin_attempt(session, tether, h, inputs)
    status, wheels, winch = _iterate(session, tether, h, inputs, points, near_rover)
    if status == FAILED:
        return Attempt(False, losses, screw, wheels, winch)
    if not largest_turn(tether, session.solver.work) < MAX_ROTATION:
        return Attempt(False, losses, screw, wheels, winch)
    if session.model.has_winch and not winch.pay.length1 > 0.0:
        return Attempt(False, losses, screw, wheels, winch)
    losses, screw = _end_attempt(session, tether, h, inputs, winch.pay, points, near_rover)
    return Attempt(True, losses, screw, wheels, winch)
