"""One time step of the spatial plant: tether, fairlead, rover and ground in one Newton iteration.

The motion of drum and wheels in the step is given (`StepInputs`). The unknowns are the increments
of the tether's chain (`energy_momentum`), of the exit slope at the fairlead (`variable_length`) and
of the rover's rotation and slide (`spatial_rover`); the contact forces on tether (`tether_contact`)
and rover (`rover_contact`) and the motion of the screw (`jump_drive`) are functions of these
increments.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.ground.rover_contact import (
    RoverContact,
    RoverContactStep,
    add_rover_contact,
    anchor_rows,
    begin_rover_contact,
    end_rover_contact,
    make_rover_contact_step,
)
from rover_sim.physics.ground.terrain import Terrain
from rover_sim.physics.ground.tether_contact import (
    TetherContact,
    TetherContactLaw,
    TetherContactTotals,
    add_tether_contact,
    begin_tether_contact,
    end_tether_contact,
    make_tether_contact,
)
from rover_sim.physics.integrators.initial_guess import History, extrapolate, make_history
from rover_sim.physics.mechanisms import jump_drive
from rover_sim.physics.mechanisms.drum import Drum
from rover_sim.physics.mechanisms.jump_drive import (
    JumpDrive,
    JumpLoads,
    JumpResponse,
    JumpState,
    JumpStep,
)
from rover_sim.physics.mechanisms.slider import Slider, slider_energy, slider_force
from rover_sim.physics.mechanisms.wheel_drive import WheelDrive
from rover_sim.physics.numerics.compiled import checked_inner, inner
from rover_sim.physics.numerics.vectors import Vector, cayley, dot, rotate, rotation_of, sub
from rover_sim.physics.rover.spatial_rover import (
    BODY_SIZE,
    SLIDE,
    SPIN,
    VELOCITY1,
    VELOCITY2,
    Rover,
    RoverStep,
    add_rover,
    apply_rover_increment,
    clear_loads,
    end_rover_step,
    make_rover_step,
    orientation,
    pose_of,
    vector_at,
)
from rover_sim.physics.tether.air_drag import AirDrag, add_drag, drag_loss
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import (
    Workspace,
    assemble,
    begin_ends,
    begin_step,
    end_step,
    make_workspace,
    set_end,
    solve_increment,
)
from rover_sim.physics.tether.newton import (
    CONTINUE,
    CONVERGENCE_SIZE,
    FAILED,
    MAX_ROTATION,
    convergence_status,
)
from rover_sim.physics.tether.tether import Tether, row_width
from rover_sim.physics.tether.variable_length import (
    ExitElement,
    Payout,
    add_exit,
    apply_exit_increment,
    begin_exit,
    end_exit_step,
    make_exit,
)


class Model(NamedTuple):
    """Constants of a run, for compiled functions."""

    tether: Tether  # its `elements` is not used: the memory's entry ELEMENTS holds the number
    has_winch: bool  # else the root is pinned at the fairlead and the length is constant
    drum: Drum
    has_rover: bool  # else a point mass hangs at the tip
    tip_mass: float  # [kg]
    rover: Rover
    slider: Slider
    jump: JumpDrive
    wheels: WheelDrive
    rover_contact: RoverContact
    has_ground: bool
    terrain: Terrain
    tether_contact: TetherContactLaw
    drag: AirDrag
    torsion: float  # GJ of the tether [N m^2]
    swivel_torque: float  # at which the swivel slips [N m]; 0: free, inf: clamped
    breaking_load: float  # [N]
    step: float  # h [s]
    tolerance: float  # [m]
    max_halvings: int


class MotionArrays(NamedTuple):
    """Arrays of the moving parts; see `rover_sim.physics.integrators.spatial`."""

    q: Array  # (6, width)
    v: Array  # (6, width)
    fairlead_slope: Array  # slope and slope rate at the fairlead, (2, 3)
    body: Array  # (BODY_SIZE,)
    rover_anchors: Array  # (anchor_rows(corners), 3)
    tether_anchors: Array  # (points, 3)


class StepInputs(NamedTuple):
    """Inputs of a step from drives and swivel."""

    pay: Payout  # of the exit element
    jump: JumpState
    jump_step: JumpStep
    wheel_momentum: float  # of the wheels about base_link +y at the step's end [N m s]
    left_rate: float  # mean rates of the wheels relative to Body 1 [rad/s]
    right_rate: float
    torque: Vector  # of the tether on the rover, world axes [N m]


class Losses(NamedTuple):
    """Energy losses of a step [J], with its contact state and peak tension."""

    tether: float
    slider: float
    rover_ground: float
    tether_ground: float
    air: float  # work on the air
    rover_stored: float  # change of the energy stored by the rover's contacts
    tether_stored: float  # the same by the tether's contacts
    near_ground: bool  # whether the rover's contacts were evaluated
    touching: int  # number of the tether's points in contact
    peak_tension: float  # [N]


class Solver(NamedTuple):
    """Work arrays; their contents are valid within one call only."""

    work: Workspace
    rover: RoverStep
    exit_element: ExitElement
    rover_contact: RoverContactStep
    tether_contact: TetherContact
    after: MotionArrays  # the state after an attempted step; its tether anchors are not used
    origin: Array  # position of the fairlead, zeros (3,)
    zero_increment: Array  # zeros (4,)
    extra_increments: Array  # increments th, ds and of the exit slope, (7,)
    history: History
    convergence: Array  # see `newton`


def make_solver(capacity: int, corners: int) -> Solver:
    """Allocate for a tether of at most `capacity` elements and a rover with `corners` corners."""
    width = row_width(capacity, 3)
    return Solver(
        make_workspace(capacity, 3),
        make_rover_step(),
        make_exit(3),
        make_rover_contact_step(corners),
        make_tether_contact(capacity),
        MotionArrays(
            np.zeros((6, width)),
            np.zeros((6, width)),
            np.zeros((2, 3)),
            np.zeros(BODY_SIZE),
            np.zeros((anchor_rows(corners), 3)),
            np.zeros((0, 3)),
        ),
        np.zeros(3),
        np.zeros(4),
        np.zeros(7),
        make_history(6, width, 7),
        np.zeros(CONVERGENCE_SIZE),
    )


@inner
def slide_rate(body: Array) -> float:
    """Rate of the slide s' [m/s]."""
    axis = rotation_of(orientation(body))[2]
    return dot(axis, sub(vector_at(body, VELOCITY2), vector_at(body, VELOCITY1)))


@inner
def _set_initial_guess(
    model: Model, n: int, h: float, motion: MotionArrays, past_steps: int, solver: Solver
) -> None:
    """Set the initial guess from `past_steps` previous steps, or from the rates if that is 0."""
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
            increment[d, 0] = 0.0
            extra_increments[4 + d] = 0.0
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


@checked_inner
def attempt_step(
    model: Model,
    tether: Tether,
    h: float,
    motion: MotionArrays,
    inputs: StepInputs,
    past_steps: int,
    solver: Solver,
    iterations: Array,
) -> tuple[bool, Losses, JumpResponse]:
    """Attempt one step of length h and write its end state to solver.after.

    If the step succeeds, the tether's anchors in `motion` are updated in place.

    Args:
        model: constants.
        tether: model.tether with the chain's current number of elements.
        h: [s].
        motion: the state; only its tether anchors are changed.
        inputs: from the drives.
        past_steps: number of steps that the initial guess extrapolates from; 0: from the rates.
        solver: work arrays.
        iterations: entry 0 counts the Newton iterations.

    Returns:
        Whether the iteration converged to a valid state, the step's losses and the screw's motion.
    """
    n = tether.elements
    work, step, after = solver.work, solver.rover, solver.after
    failed = Losses(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, 0, 0.0)
    screw = jump_drive.AT_REST
    for k in range(6):
        work.end_fixed[0, k] = 0.0 if model.has_winch or k >= 3 else 1.0
        work.end_fixed[1, k] = 0.0
    begin_ends(tether, work)
    _set_initial_guess(model, n, h, motion, past_steps, solver)
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
    near_points = 0
    near_rover = False
    if model.has_rover:
        step.rotors_after[1], step.rotors_after[2] = inputs.wheel_momentum, 0.0
        solver.rover_contact.spin[0] = inputs.left_rate
        solver.rover_contact.spin[1] = inputs.right_rate
    if model.has_ground:
        near_points = begin_tether_contact(
            model.terrain,
            tether,
            h,
            motion.q,
            motion.v,
            motion.tether_anchors,
            solver.tether_contact,
        )
        if model.has_rover:
            pose = pose_of(model.rover, motion.body, step.increment)
            near_rover = begin_rover_contact(
                model.rover_contact,
                model.terrain,
                pose,
                motion.body,
                motion.rover_anchors,
                solver.rover_contact,
            )

    previous = np.inf
    status = CONTINUE
    iteration = 0
    while status == CONTINUE:
        if model.has_rover:
            _add_rover(model, n, h, motion, inputs, near_rover, solver)
        else:
            _add_point_mass(model, n, h, motion.v, work)
        if model.has_winch:
            add_exit(tether, h, inputs.pay, work, solver.exit_element)
        assemble(tether, h, work)
        if model.drag.normal > 0.0:
            add_drag(model.drag, tether, h, motion.q, work)
        if near_points > 0:
            add_tether_contact(
                model.terrain,
                model.tether_contact,
                tether,
                h,
                motion.tether_anchors,
                work,
                solver.tether_contact,
            )
        change = solve_increment(tether, work)
        if model.has_rover:
            change += apply_rover_increment(n, work, step)
        if model.has_winch:
            change += apply_exit_increment(inputs.pay.length0, work, solver.exit_element)
        iterations[0] += 1.0
        status = convergence_status(
            iteration, change, previous, model.tolerance, solver.convergence
        )
        previous = change
        iteration += 1
    if status == FAILED:
        return False, failed, screw

    tether_heat, peak, rotation = end_step(tether, h, motion.q, motion.v, work, after.q, after.v)
    if not rotation < MAX_ROTATION:
        return False, failed, screw
    for k in range(4):
        solver.extra_increments[k] = step.increment[k]
    for d in range(3):
        solver.extra_increments[4 + d] = solver.exit_element.increment[d]
    slider_heat, rover_heat, rover_stored = 0.0, 0.0, 0.0
    if model.has_rover:
        slider_heat, screw = _end_slider(model, h, motion.body, inputs, step)
        end_rover_step(model.rover, h, n, motion.body, work, step, after.body)
        if near_rover:
            pose = pose_of(model.rover, motion.body, step.increment)
            ground_work, rover_stored = end_rover_contact(
                model.rover_contact,
                model.terrain,
                h,
                pose,
                motion.rover_anchors,
                solver.rover_contact,
                after.rover_anchors,
            )
            rover_heat = -ground_work - rover_stored
        else:
            for k in range(after.rover_anchors.shape[0]):
                for d in range(3):
                    after.rover_anchors[k, d] = 0.0
    if model.has_winch:
        tether_heat += end_exit_step(
            tether,
            h,
            inputs.pay,
            solver.exit_element,
            after.fairlead_slope[0],
            after.fairlead_slope[1],
        )
        peak = max(peak, solver.exit_element.tension[0])
    ground = TetherContactTotals(0.0, 0.0, 0.0, 0)
    if near_points > 0:
        ground = end_tether_contact(
            model.tether_contact,
            tether,
            h,
            motion.tether_anchors,
            work,
            solver.tether_contact,
        )
    air = 0.0
    if model.drag.normal > 0.0:
        air = drag_loss(model.drag, tether, h, motion.q, work)
    return (
        True,
        Losses(
            tether_heat,
            slider_heat,
            rover_heat,
            ground.dissipated,
            air,
            rover_stored,
            ground.stored_change,
            near_rover,
            ground.touching,
            peak,
        ),
        screw,
    )
