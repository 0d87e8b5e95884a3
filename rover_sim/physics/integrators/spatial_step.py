"""One time step of the spatial plant: tether, fairlead, rover and ground in one Newton iteration.

The motion of the drum in the step is given (`StepInputs`). The unknowns are the increments
of the tether's chain (`energy_momentum`), of the exit slope at the fairlead (`variable_length`) and
of the rover's rotation and slide (`spatial_rover`); the contact forces on tether (`tether_contact`)
and rover (`rover_contact`) and the motion of the screw (`jump_drive`) are functions of these
increments. The wheels, with their ratchets, first move under the expected torques of the ground; if
they would move otherwise under the torques of the solution, they do, and the iteration goes on.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.ground.rover_contact import (
    CONTACTS_PER_WHEEL,
    RoverContactStep,
    add_rover_contact,
    begin_rover_contact,
    end_rover_contact,
)
from rover_sim.physics.ground.tether_contact import (
    TetherContactTotals,
    add_tether_contact,
    begin_tether_contact,
    end_tether_contact,
)
from rover_sim.physics.integrators.initial_guess import extrapolate
from rover_sim.physics.integrators.session import Model, MotionArrays, Session, Solver
from rover_sim.physics.mechanisms import jump_drive, wheel_drive
from rover_sim.physics.mechanisms.jump_drive import (
    JumpLoads,
    JumpResponse,
    JumpState,
    JumpStep,
)
from rover_sim.physics.mechanisms.slider import slider_energy, slider_force
from rover_sim.physics.mechanisms.wheel_drive import (
    WheelCommand,
    WheelEnergyBalance,
    WheelLoads,
    WheelOutputs,
    WheelState,
)
from rover_sim.physics.numerics.compiled import checked_inner, inner
from rover_sim.physics.numerics.vectors import Vector, cayley, dot, rotate, rotation_of, sub
from rover_sim.physics.rover.spatial_rover import (
    SLIDE,
    SPIN,
    VELOCITY1,
    VELOCITY2,
    RoverStep,
    add_rover,
    apply_rover_increment,
    clear_loads,
    end_rover_step,
    orientation,
    pose_of,
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
from rover_sim.physics.tether.newton import (
    CONTINUE,
    FAILED,
    MAX_ROTATION,
    convergence_status,
)
from rover_sim.physics.tether.point_masses import add_point_masses
from rover_sim.physics.tether.tether import Tether, row_width
from rover_sim.physics.tether.variable_length import (
    Payout,
    add_exit,
    apply_exit_increment,
    begin_exit,
    end_exit_step,
)

# Corrections of the wheels in a step: their largest number, and the difference of their travel that
# needs none, in tolerances of the other unknowns.
_MAX_CORRECTIONS, _WHEEL_TOLERANCE = 4, 10.0


class StepInputs(NamedTuple):
    """Inputs of a step from drives and swivel."""

    pay: Payout  # of the exit element
    jump: JumpState
    jump_step: JumpStep
    wheels: WheelState
    wheel_command: WheelCommand
    wheel_loads: WheelLoads  # expected torques of the ground; its body rate is not used
    torque: Vector  # of the tether on the rover, world axes [N m]
    root_rates: tuple[Vector, Vector]  # velocity of a driven root at start and end [m/s]
    tip_rates: tuple[Vector, Vector]  # the same of a driven tip


class WheelMotion(NamedTuple):
    """Motion of the wheel drive in a step."""

    state: WheelState
    outputs: WheelOutputs
    balance: WheelEnergyBalance


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
    touching: int  # number of the tether's points in contact
    peak_tension: float  # [N]


class Attempt(NamedTuple):
    """Result of `attempt_step`."""

    converged: bool  # to a valid state
    losses: Losses
    screw: JumpResponse
    wheels: WheelMotion


@inner
def slide_rate(body: Array) -> float:
    """Rate of the slide s' [m/s]."""
    axis = rotation_of(orientation(body))[2]
    return dot(axis, sub(vector_at(body, VELOCITY2), vector_at(body, VELOCITY1)))


@inner
def _set_initial_guess(
    model: Model,
    n: int,
    h: float,
    motion: MotionArrays,
    inputs: StepInputs,
    past_steps: int,
    solver: Solver,
) -> None:
    """Set the initial guess from `past_steps` previous steps, or from the rates if that is 0.

    Driven ends have their increments.
    """
    width = row_width(n, 3)
    increment = solver.work.increment
    extra_increments = solver.extra_increments
    if past_steps == 0:
        for k in range(6):
            for i in range(width):
                increment[k, i] = h * motion.v[k, i]
        for d in range(3):
            extra_increments[d] = h * motion.body[SPIN + d]
            extra_increments[4 + d] = h * motion.fairlead_slope[1, d]
        extra_increments[3] = h * slide_rate(motion.body)
    else:
        extrapolate(solver.history, h, past_steps, increment[:, :width], extra_increments)
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
def _add_rover(
    model: Model,
    n: int,
    h: float,
    motion: MotionArrays,
    inputs: StepInputs,
    near: bool,
    solver: Solver,
) -> None:
    """Add the rover with the forces of slider, tether twist and ground."""
    step = solver.rover
    clear_loads(step)
    _add_slider(model, h, motion.body, inputs, step)
    for d in range(3):
        step.load[3 + d] = inputs.torque[d]
    if near:
        increment = solver.work.increment
        add_rover_contact(
            model.rover_contact,
            model.terrain,
            model.rover.attachment,
            h,
            pose_of(model.rover, motion.body, step.increment),
            motion.body,
            (increment[0, n], increment[1, n], increment[2, n]),
            motion.rover_anchors,
            step,
            solver.rover_contact,
        )
    add_rover(model.rover, model.tether.gravity, h, n, motion.body, solver.work, step)


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
    step.rotors_after[0] = screw.momentum
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
    step.rotors_after[0] = screw.momentum
    return screw.force * travel - force * ds - stored, screw


@inner
def _begin_attempt(
    session: Session, tether: Tether, h: float, inputs: StepInputs, past_steps: int
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
    _set_initial_guess(model, n, h, motion, inputs, past_steps, solver)
    begin_step(tether, h, motion.q, motion.v, work)
    if model.has_winch:
        begin_exit(
            solver.origin,
            motion.fairlead_slope[0],
            motion.fairlead_slope[1],
            motion.q,
            motion.v,
            solver.exit_element,
        )
    if not model.has_ground:
        return 0, False
    points = begin_tether_contact(
        model.terrain,
        tether,
        h,
        motion.q,
        motion.v,
        motion.tether_anchors,
        past_steps > 0,
        solver.tether_contact,
    )
    if not model.has_rover:
        return points, False
    return points, begin_rover_contact(
        model.rover_contact,
        model.terrain,
        pose_of(model.rover, motion.body, solver.rover.increment),
        motion.body,
        motion.rover_anchors,
        solver.rover_contact,
    )


@inner
def _turn_wheels(session: Session, h: float, inputs: StepInputs, loads: WheelLoads) -> WheelMotion:
    """Advance the wheels under ground torques, with Body 1's rate of the current increment."""
    rate = 2.0 / h * session.solver.rover.increment[1] - session.motion.body[SPIN + 1]
    state, outputs, balance = wheel_drive.advance(
        session.model.wheels,
        inputs.wheels,
        inputs.wheel_command,
        WheelLoads(
            loads.left_torque, loads.left_slope, loads.right_torque, loads.right_slope, rate
        ),
        h,
    )
    return WheelMotion(state, outputs, balance)


@inner
def _ground_torque(
    contact: RoverContactStep, wheel: int, before: float, after: float
) -> tuple[float, float]:
    """Torque of the ground on a wheel and its slope, for `wheel_drive`.

    The torque belongs to the mean rate of the step, in which the wheel's rate went from `before` to
    `after`; the drive refers it to the rate at the start, and its slope to that at the end.
    """
    torque, slope = 0.0, 0.0
    for w in range(CONTACTS_PER_WHEEL * wheel, CONTACTS_PER_WHEEL * (wheel + 1)):
        torque -= contact.torque[w, 0]
        slope += 0.5 * max(contact.torque[w, 1], 0.0)
    return torque + slope * (after - before), slope


@inner
def _corrected_wheels(
    session: Session, h: float, inputs: StepInputs, wheels: WheelMotion
) -> tuple[WheelMotion, float]:
    """Motion of the wheels under the ground's torques of the solution, and its difference [m]."""
    contact, before, after = session.solver.rover_contact, inputs.wheels, wheels.state
    left, left_slope = _ground_torque(contact, 0, before.left, after.left)
    right, right_slope = _ground_torque(contact, 1, before.right, after.right)
    corrected = _turn_wheels(
        session, h, inputs, WheelLoads(left, left_slope, right, right_slope, 0.0)
    )
    old, new = wheels.outputs, corrected.outputs
    rate = abs(new.left_rate - old.left_rate) + abs(new.right_rate - old.right_rate)
    rate += abs(new.momentum - old.momentum) / session.model.wheels.train_inertia
    return corrected, rate * session.model.rover_contact.tip_radius * h


@inner
def _assemble_chain(session: Session, tether: Tether, h: float, points: int) -> None:
    """Residual and tangent of the tether's chain with air, point masses and ground."""
    model, motion, work = session.model, session.motion, session.solver.work
    assemble(tether, h, work)
    if model.drag.normal > 0.0:
        add_drag(model.drag, tether, h, motion.q, work)
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
    if model.root_motion.active or model.tip_motion.active:
        n = tether.elements
        _assemble_chain(session, tether, h, points)
        for d in range(3):
            if model.root_motion.active:
                total += work.blocks[1, 0, 6, d] * work.increment[d, 0]
            if model.tip_motion.active:
                total += work.blocks[n, 1, 6, d] * work.increment[d, n]
    return total


@checked_inner
def _iterate(
    session: Session, tether: Tether, h: float, inputs: StepInputs, points: int, near_rover: bool
) -> int:
    """Newton's iteration from the current increments; returns its `convergence_status`."""
    model, motion, solver = session.model, session.motion, session.solver
    n, work = tether.elements, solver.work
    previous = np.inf
    status = CONTINUE
    iteration = 0
    while status == CONTINUE:
        if model.has_rover:
            _add_rover(model, n, h, motion, inputs, near_rover, solver)
        elif not model.tip_motion.active:
            _add_point_mass(model, n, h, motion.v, work)
        if model.has_winch:
            add_exit(tether, h, inputs.pay, work, solver.exit_element)
        _assemble_chain(session, tether, h, points)
        change = solve_increment(tether, work)
        if model.has_rover:
            change += apply_rover_increment(n, work, solver.rover)
        if model.has_winch:
            change += apply_exit_increment(inputs.pay.length0, work, solver.exit_element)
        session.report[0] += 1.0
        status = convergence_status(
            iteration, change, previous, model.tolerance, solver.convergence
        )
        previous = change
        iteration += 1
    return status


@inner
def _end_attempt(
    session: Session, tether: Tether, h: float, inputs: StepInputs, points: int, near_rover: bool
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
            inputs.pay,
            solver.exit_element,
            after.fairlead_slope[0],
            after.fairlead_slope[1],
        )
        exit_tension = solver.exit_element.tension[0]
    ground = TetherContactTotals(0.0, 0.0, 0.0, 0)
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
        ground.touching,
        max(peak, exit_tension),
    ), screw


@checked_inner
def attempt_step(
    session: Session, tether: Tether, h: float, inputs: StepInputs, past_steps: int
) -> Attempt:
    """Attempt one step of length h.

    If the step succeeds, tether and anchors of the tether in `motion` are those of its end, and
    solver.after has the other parts.

    Args:
        session: constants, state and work arrays; entry 0 of its report counts the Newton
            iterations.
        tether: model.tether with the chain's current number of elements.
        h: [s].
        inputs: from the drives.
        past_steps: number of steps that the initial guess extrapolates from; 0: from the rates.
    """
    model, solver = session.model, session.solver
    losses = Losses(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, 0, 0.0)
    screw = jump_drive.AT_REST
    points, near_rover = _begin_attempt(session, tether, h, inputs, past_steps)
    wheels = _turn_wheels(session, h, inputs, inputs.wheel_loads)
    for correction in range(_MAX_CORRECTIONS + 1):
        solver.rover.rotors_after[1], solver.rover.rotors_after[2] = wheels.outputs.momentum, 0.0
        solver.rover_contact.spin[0] = wheels.outputs.left_rate
        solver.rover_contact.spin[1] = wheels.outputs.right_rate
        if _iterate(session, tether, h, inputs, points, near_rover) == FAILED:
            return Attempt(False, losses, screw, wheels)
        if not model.has_rover or correction == _MAX_CORRECTIONS:
            break
        corrected, difference = _corrected_wheels(session, h, inputs, wheels)
        if not difference > _WHEEL_TOLERANCE * model.tolerance:
            break
        wheels = corrected
    if not largest_turn(tether, solver.work) < MAX_ROTATION:
        return Attempt(False, losses, screw, wheels)
    losses, screw = _end_attempt(session, tether, h, inputs, points, near_rover)
    return Attempt(True, losses, screw, wheels)
