"""Time stepping of the planar plant: a tether with a rover, a point mass or a free tip.

The ground holds a standing rover fixed; the rover flies from take-off to landing and stands again.
Each time step solves tether (`energy_momentum`) and rover (`planar_rover`) in one Newton iteration,
and is halved where that does not converge. Axes and symbols are those of `planar_rover`.
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.integrators.initial_guess import (
    ORDER,
    History,
    clear_history,
    extrapolate,
    make_history,
    record_step,
)
from rover_sim.physics.numerics.compiled import checked, checked_inner, inner, kernel
from rover_sim.physics.numerics.event_location import apex_instant, crossing_instant, hermite
from rover_sim.physics.rover.planar_rover import (
    BODY_SIZE,
    OMEGA,
    SLIDE,
    THETA,
    VX1,
    VX2,
    VY1,
    VY2,
    X1,
    Y1,
    PlanarRover,
    add_rover,
    apply_rover_increment,
    end_rover_step,
    rover_energies,
)
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import (
    Workspace,
    begin_ends,
    begin_step,
    end_step,
    largest_turn,
    make_workspace,
    newton_increment,
    set_end,
)
from rover_sim.physics.tether.newton import (
    CONTINUE,
    CONVERGENCE_SIZE,
    FAILED,
    MAX_ROTATION,
    convergence_status,
    reset_rate,
)
from rover_sim.physics.tether.tether import Tether, row_width, tether_energies

# Entries of the array `memory`: state besides the motion, and energy sums.
(
    TIME,  # [s]
    COMPRESSION,  # of the jump spring by its drive [m]
    TAKE_OFF_TIME,  # [s]; this and the next three are of the last take-off
    TAKE_OFF_X,  # of G1 [m]
    TAKE_OFF_Y,  # [m]
    TAKE_OFF_THETA,  # [rad]
    MAX_RISE,  # largest rise of G1 since take-off [m]
    INPUT,  # energy input since the start [J]
    DISSIPATED,  # energy dissipated since the start [J]
    INITIAL_ENERGY,  # energy stored at the start [J]
) = range(10)
MEMORY_SIZE = 10

# Phases.
HELD, FLIGHT, LANDED, FREE, DIVERGED, TETHER_BROKEN = range(6)

# Outcomes of `advance`.
OUTCOME_CONVERGED, OUTCOME_HALVED, OUTCOME_DIVERGED, OUTCOME_BROKEN = range(4)

# Rows of the event array: kind, time [s], then height over start [m], travel dx [m], attitude
# variation theta - theta0 [rad], time since take-off [s], speed of Body 1 [m/s], tension [N].
EVENT_TAKE_OFF, EVENT_APEX, EVENT_TOUCHDOWN, EVENT_BROKEN, EVENT_DIVERGED = range(5)
EVENT_SIZE = 8
MAX_EVENTS = 32

# Entries of the array `report`.
(
    ITERATIONS,  # Newton iterations
    SMALLEST_STEP,  # [s]
    PEAK_TENSION,  # [N], see `end_step`
    HALVINGS,  # number of halved steps
    ELAPSED,  # [s], less than dt after a divergence or a stop
    KINETIC,  # [J]; energies at the end of the call
    GRAVITY,
    AXIAL,
    BENDING,
    SPRING,
    CONSTRAINT_DRIFT,  # |G1 + R p - r_n| [m]
    EVENT_COUNT,
) = range(12)
REPORT_SIZE = 12

# Entries of the array `search`.
_LENGTH, _LOW, _HIGH, _TRIES = range(4)
_MOST_TRIES = 12.0


class PlanarModel(NamedTuple):
    """Everything constant during a run, as the compiled functions see it."""

    tether: Tether
    rover: PlanarRover
    has_rover: bool  # else `rover` is not used
    tip_mass: float  # of a tether without a rover [kg]
    root_pinned: bool  # position of the first node fixed
    root_clamped: bool  # slope of the first node fixed
    linear_rates: bool  # take-off sets the tether's rates linear in arc length, else only the tip's
    hold_after_landing: bool
    breaking_load: float  # [N]
    step: float  # h [s]
    tolerance: float  # [m]
    max_halvings: int


class PlanarMotion(NamedTuple):
    """State of tether and rover, which the compiled functions change in place."""

    q: Array  # nodal coordinates in rows, (4, width)
    v: Array  # their rates
    body: Array  # the rover's state, (BODY_SIZE,)
    memory: Array  # of the integrator, (MEMORY_SIZE,)


class JumpSetpoint(NamedTuple):
    """Command to the jump drive, which compresses the spring."""

    compression: float  # [m]
    rate: float  # at which the drive moves there [m/s]; 0: off
    trips: bool  # whether the latch trips at a setpoint above 0


class PlanarSolver(NamedTuple):
    """Work arrays of `advance`; only the report is valid after a call."""

    work: Workspace
    q1: Array  # (4, width), the state after an attempted step
    v1: Array
    body1: Array  # (BODY_SIZE,)
    rover_increment: Array  # (2,): th and ds
    condensed: Array  # (2, 3): K_zz^-1 (g, K_zr) of z = (th, ds)
    history: History
    convergence: Array  # (CONTROL_SIZE,), see `newton`
    search: Array  # (4,): state of the touchdown search, see `_locate_touchdown`
    report: Array  # of the last call, (REPORT_SIZE,)


def make_solver(elements: int) -> PlanarSolver:
    """Allocate the arrays for a tether of n elements."""
    width = row_width(elements, 2)
    return PlanarSolver(
        make_workspace(elements, 2),
        np.zeros((4, width)),
        np.zeros((4, width)),
        np.zeros(BODY_SIZE),
        np.zeros(2),
        np.zeros((2, 3)),
        make_history(4, width, 2),
        np.zeros(CONVERGENCE_SIZE),
        np.zeros(4),
        np.zeros(REPORT_SIZE),
    )


@kernel
def energies(model: PlanarModel, q: Array, v: Array, body: Array) -> tuple[float, ...]:
    """Kinetic, gravity, axial, bending and spring energy of the whole system [J].

    The potential of gravity is zero at the origin.
    """
    kinetic, gravity, axial, bending = tether_energies(model.tether, q, v)
    spring = 0.0
    gx, gy = model.tether.gravity
    if model.has_rover:
        more, weight, spring = rover_energies(model.rover, model.tether.gravity, body)
        kinetic += more
        gravity += weight
    else:
        n = model.tether.elements
        kinetic += 0.5 * model.tip_mass * (v[0, n] ** 2 + v[1, n] ** 2)
        gravity -= model.tip_mass * (gx * q[0, n] + gy * q[1, n])
    return kinetic, gravity, axial, bending, spring


@inner
def stored_energy(model: PlanarModel, q: Array, v: Array, body: Array) -> float:
    """Sum of `energies` [J]."""
    kinetic, gravity, axial, bending, spring = energies(model, q, v, body)
    return kinetic + gravity + axial + bending + spring


@inner
def _add_point_mass(model: PlanarModel, h: float, v0: Array, work: Workspace) -> None:
    """Add a point mass to the tether's tip."""
    n = model.tether.elements
    mass = model.tip_mass
    for d in range(2):
        force = 2.0 / h * (work.increment[d, n] / h - v0[d, n]) - model.tether.gravity[d]
        set_end(work, 1, 4, d, mass * force)
        set_end(work, 1, d, d, 2.0 * mass / h**2)


@inner
def _set_initial_guess(
    n: int, h: float, motion: PlanarMotion, flying: bool, solver: PlanarSolver
) -> None:
    """Set the initial guess from the history of the previous steps, or from the rates.

    The increments of fixed coordinates are zero.
    """
    work = solver.work
    increment = work.increment
    if solver.history.counts[ORDER] == 0.0:
        body = motion.body
        for k in range(4):
            for i in range(increment.shape[1]):
                increment[k, i] = h * motion.v[k, i]
        c, z = np.cos(body[THETA]), np.sin(body[THETA])
        solver.rover_increment[0] = h * body[OMEGA]
        solver.rover_increment[1] = h * (c * (body[VY2] - body[VY1]) - z * (body[VX2] - body[VX1]))
    else:
        extrapolate(solver.history, h, increment, solver.rover_increment)
    for k in range(4):
        if work.end_fixed[0, k] != 0.0:
            increment[k, 0] = 0.0
        if work.end_fixed[1, k] != 0.0:
            increment[k, n] = 0.0
    if not flying:
        solver.rover_increment[0] = 0.0
        solver.rover_increment[1] = 0.0


@checked_inner
def attempt_step(
    model: PlanarModel, h: float, motion: PlanarMotion, flying: bool, solver: PlanarSolver
) -> tuple[bool, float, float]:
    """Attempt one step of length h and write its end state to the solver.

    If `flying` is false, the tip of a tether with a rover is fixed.

    Returns:
        Whether Newton's iteration converged to a valid state, the energy dissipated [J] and the
        largest tension [N].
    """
    work, body = solver.work, motion.body
    for d in range(2):
        work.end_fixed[0, d] = 1.0 if model.root_pinned else 0.0
        work.end_fixed[0, 2 + d] = 1.0 if model.root_clamped else 0.0
        work.end_fixed[1, d] = 1.0 if model.has_rover and not flying else 0.0
    begin_ends(model.tether, work)
    _set_initial_guess(model.tether.elements, h, motion, flying, solver)
    begin_step(model.tether, h, motion.q, motion.v, work)
    previous = np.inf
    status = CONTINUE
    iteration = 0
    while status == CONTINUE:
        if flying:
            add_rover(
                model.tether, model.rover, h, body, solver.rover_increment, solver.condensed, work
            )
        elif not model.has_rover:
            _add_point_mass(model, h, motion.v, work)
        change = newton_increment(model.tether, h, work)
        if flying:
            change += apply_rover_increment(
                model.tether.elements, solver.condensed, work, solver.rover_increment
            )
        solver.report[ITERATIONS] += 1.0
        status = convergence_status(
            iteration, change, previous, model.tolerance, solver.convergence
        )
        previous = change
        iteration += 1
    if status == FAILED or not largest_turn(model.tether, work) < MAX_ROTATION:
        return False, 0.0, 0.0
    dissipated, tension = end_step(model.tether, h, motion.q, motion.v, work, solver.q1, solver.v1)
    if flying:
        dissipated += end_rover_step(
            model.tether.elements, model.rover, h, body, solver.rover_increment, work, solver.body1
        )
    else:
        for k in range(BODY_SIZE):
            solver.body1[k] = body[k]
    return True, dissipated, tension


@kernel
def take_off(model: PlanarModel, velocity: tuple[float, float], motion: PlanarMotion) -> None:
    """Give both bodies the velocity [m/s], with the spring at its free length; in place.

    The tether's last node gets the same velocity; the other nodes keep theirs, or all get rates
    linear in arc length (`linear_rates`). The change of the system's energy is added to INPUT.
    """
    n = model.tether.elements
    q, v, body, memory = motion
    before = stored_energy(model, q, v, body)
    body[SLIDE] = model.rover.spring_free_length
    body[OMEGA] = 0.0
    body[VX1], body[VY1] = velocity
    body[VX2], body[VY2] = velocity
    for d in range(2):
        if model.linear_rates:
            for i in range(n + 1):
                v[d, i] = velocity[d] * i / n
                v[2 + d, i] = velocity[d] / (n * model.tether.element_length)
            if model.root_clamped:
                v[2 + d, 0] = 0.0
        v[d, n] = velocity[d]
    memory[INPUT] += stored_energy(model, q, v, body) - before
    memory[TAKE_OFF_TIME] = memory[TIME]
    memory[TAKE_OFF_X], memory[TAKE_OFF_Y] = body[X1], body[Y1]
    memory[TAKE_OFF_THETA] = body[THETA]
    memory[MAX_RISE] = 0.0


@inner
def _hold_rover(model: PlanarModel, motion: PlanarMotion, history: History) -> None:
    """Stop the rover at its touchdown and add its kinetic energy to DISSIPATED."""
    q, v, body, memory = motion
    before = stored_energy(model, q, v, body)
    for k in range(VX1, BODY_SIZE):
        body[k] = 0.0
    for d in range(2):
        v[d, model.tether.elements] = 0.0
    memory[DISSIPATED] += before - stored_energy(model, q, v, body)
    memory[COMPRESSION] = 0.0
    clear_history(history)


@inner
def _record(
    kind: int,
    time: float,
    rise: float,
    tension: float,
    body: Array,
    memory: Array,
    events: Array,
    report: Array,
) -> None:
    """Append an event if there is room."""
    count = int(report[EVENT_COUNT])
    if count < events.shape[0]:
        row = events[count]
        row[0] = kind
        row[1] = time
        row[2] = rise
        row[3] = body[X1] - memory[TAKE_OFF_X]
        row[4] = body[THETA] - memory[TAKE_OFF_THETA]
        row[5] = time - memory[TAKE_OFF_TIME]
        row[6] = np.sqrt(body[VX1] ** 2 + body[VY1] ** 2)
        row[7] = tension
        report[EVENT_COUNT] += 1.0


@inner
def _falls_through(body: Array, body1: Array, level: float, accuracy: float) -> bool:
    """Whether G1 falls through the level between two states, from above.

    A state closer to the level than ten times the accuracy, as after a touchdown, is above it only
    if it rises.
    """
    margin = 10.0 * accuracy
    above = body[Y1] > level + (margin if body[VY1] <= 0.0 else -margin)
    return above and body1[Y1] <= level and body1[VY1] < 0.0


@inner
def _locate_touchdown(
    h: float, level: float, accuracy: float, body: Array, body1: Array, search: Array
) -> bool:
    """Check whether a step of length h ends at the level; if not, set the next length to try.

    The search varies the step's length: first to the crossing of the Hermite cubic, then by
    Newton's method within a bracket, else by bisection. `search` holds its state.

    Returns:
        Whether the step ends at the level, to the accuracy [m].
    """
    y1, dy1 = body1[Y1], body1[VY1]
    if search[_TRIES] == 0.0:
        y0, dy0 = body[Y1], body[VY1]
        low = apex_instant(h, y0, dy0, y1, dy1) if dy0 > 0.0 else 0.0
        search[_LOW], search[_HIGH] = low, h
        search[_LENGTH] = crossing_instant(low, h, h, y0, dy0, y1, dy1, level)
    else:
        gap = y1 - level
        if abs(gap) <= accuracy or search[_TRIES] >= _MOST_TRIES:
            return True
        search[_LOW if gap > 0.0 else _HIGH] = h
        following = h - gap / dy1 if dy1 < 0.0 else 0.0
        if not search[_LOW] < following < search[_HIGH]:
            following = 0.5 * (search[_LOW] + search[_HIGH])
        search[_LENGTH] = following
    search[_TRIES] += 1.0
    return False


@checked_inner
def _touches_down(
    h: float, level: float, accuracy: float, body: Array, body1: Array, search: Array
) -> bool:
    """Whether a step of the flight ends at the touchdown, at the level [m].

    If the step passes the touchdown, a search begins, which goes on while its tries are not 0.
    """
    if search[_TRIES] == 0.0 and not _falls_through(body, body1, level, accuracy):
        return False
    found = _locate_touchdown(h, level, accuracy, body, body1, search)
    if found:
        search[_TRIES] = 0.0
    return found


@checked_inner
def _record_apex(
    h: float,
    start: float,
    tension: float,
    body: Array,
    body1: Array,
    memory: Array,
    events: Array,
    report: Array,
) -> None:
    """Record an apex that is the highest since take-off, in a step of length h from `start` [s]."""
    if body[VY1] > 0.0 >= body1[VY1]:
        y0, dy0, y1, dy1 = body[Y1], body[VY1], body1[Y1], body1[VY1]
        instant = apex_instant(h, y0, dy0, y1, dy1)
        rise = hermite(instant, h, y0, dy0, y1, dy1) - memory[TAKE_OFF_Y]
        if rise > memory[MAX_RISE]:
            memory[MAX_RISE] = rise
            _record(EVENT_APEX, start + instant, rise, tension, body1, memory, events, report)


@inner
def _accept_step(motion: PlanarMotion, q1: Array, v1: Array, body1: Array) -> None:
    """Copy the end state of an attempted step to the state."""
    for k in range(q1.shape[0]):
        for i in range(q1.shape[1]):
            motion.q[k, i] = q1[k, i]
            motion.v[k, i] = v1[k, i]
    for k in range(BODY_SIZE):
        motion.body[k] = body1[k]


@checked_inner
def _move_jump_drive(
    setpoint: JumpSetpoint, phase: int, step: float, memory: Array
) -> tuple[float, bool]:
    """Move the drive of a standing rover to its setpoint, where the latch trips or holds.

    Returns:
        The step's length, up to the trip [s], and whether the latch trips at its end.
    """
    if phase not in (HELD, LANDED) or setpoint.rate <= 0.0:
        return step, False
    distance = setpoint.compression - memory[COMPRESSION]
    instant = abs(distance) / setpoint.rate
    if setpoint.trips and setpoint.compression > 0.0 and instant <= step:
        memory[COMPRESSION] = setpoint.compression
        return instant, True
    memory[COMPRESSION] += np.sign(distance) * min(abs(distance), setpoint.rate * step)
    return step, False


@checked_inner
def _release_spring(model: PlanarModel, motion: PlanarMotion, events: Array, report: Array) -> None:
    """Take off along the slider, with the energy of the compressed spring."""
    rover, body, memory = model.rover, motion.body, motion.memory
    speed = memory[COMPRESSION] * np.sqrt(rover.spring_rate / (rover.m1 + rover.m2))
    take_off(model, (-np.sin(body[THETA]) * speed, np.cos(body[THETA]) * speed), motion)
    memory[COMPRESSION] = 0.0
    _record(EVENT_TAKE_OFF, memory[TIME], 0.0, 0.0, body, memory, events, report)


@checked_inner
def _march(
    model: PlanarModel,
    motion: PlanarMotion,
    phase: int,
    setpoint: JumpSetpoint,
    dt: float,
    stop_at_touchdown: bool,
    events: Array,
    solver: PlanarSolver,
) -> int:
    """The time steps of `advance`, with its arguments; returns the phase."""
    body, memory, report, search = motion.body, motion.memory, solver.report, solver.search
    start = memory[TIME]
    accuracy = 1e-13 + 1e-4 * model.tolerance
    done = phase in (DIVERGED, TETHER_BROKEN)
    while not done and report[ELAPSED] < dt * (1.0 - 1e-12):
        step = model.step
        if dt - report[ELAPSED] < step * (1.0 + 1e-6):
            step = dt - report[ELAPSED]
        step, trips = _move_jump_drive(setpoint, phase, step, memory)

        # The step, divided where Newton's iteration does not converge at full length.
        flying = phase == FLIGHT
        unit = 1 << model.max_halvings
        part, left = unit, unit
        while left > 0 and step > 0.0:
            now, level = start + report[ELAPSED], memory[TAKE_OFF_Y]
            h = search[_LENGTH] if search[_TRIES] > 0.0 else step * part / unit
            ok, dissipated, tension = attempt_step(model, h, motion, flying, solver)
            if not ok:
                search[_TRIES] = 0.0
                clear_history(solver.history)
                reset_rate(solver.convergence)
                part >>= 1
                if part == 0:
                    phase, done, rise = DIVERGED, True, body[Y1] - level
                    _record(EVENT_DIVERGED, now, rise, 0.0, body, memory, events, report)
                    break
                report[HALVINGS] += 1.0
                continue
            touches = flying and _touches_down(h, level, accuracy, body, solver.body1, search)
            if search[_TRIES] > 0.0:
                continue

            if flying:
                _record_apex(h, now, tension, body, solver.body1, memory, events, report)
            _accept_step(motion, solver.q1, solver.v1, solver.body1)
            memory[DISSIPATED] += dissipated
            length = model.tether.element_length
            record_step(solver.history, h, length, solver.work.increment, solver.rover_increment)
            report[ELAPSED] += h
            report[SMALLEST_STEP] = min(report[SMALLEST_STEP], h)
            report[PEAK_TENSION] = max(report[PEAK_TENSION], tension)
            now = start + report[ELAPSED]
            if tension > model.breaking_load:
                phase, done, rise = TETHER_BROKEN, True, body[Y1] - level
                _record(EVENT_BROKEN, now, rise, tension, body, memory, events, report)
                break
            if touches:
                rise = memory[MAX_RISE]
                _record(EVENT_TOUCHDOWN, now, rise, tension, body, memory, events, report)
                if model.hold_after_landing:
                    phase = LANDED
                    _hold_rover(model, motion, solver.history)
                done = stop_at_touchdown
                break
            left -= part
            if part < unit and left % (2 * part) == 0:
                part *= 2

        memory[TIME] = start + report[ELAPSED]
        if trips and not done:
            phase = FLIGHT
            _release_spring(model, motion, events, report)
            clear_history(solver.history)
    if not done:
        memory[TIME] = start + dt
    return phase


@inner
def _report_end(model: PlanarModel, motion: PlanarMotion, report: Array) -> None:
    """Report the energies and the drift between rover attachment and tether tip."""
    q, body = motion.q, motion.body
    kinetic, gravity, axial, bending, spring = energies(model, q, motion.v, body)
    report[KINETIC] = kinetic
    report[GRAVITY] = gravity
    report[AXIAL] = axial
    report[BENDING] = bending
    report[SPRING] = spring
    if model.has_rover:
        n = model.tether.elements
        a, b = model.rover.attachment_x, model.rover.attachment_y
        c, z = np.cos(body[THETA]), np.sin(body[THETA])
        report[CONSTRAINT_DRIFT] = np.hypot(
            body[X1] + c * a - z * b - q[0, n], body[Y1] + z * a + c * b - q[1, n]
        )


@checked
def advance(
    model: PlanarModel,
    motion: PlanarMotion,
    phase: int,
    setpoint: JumpSetpoint,
    dt: float,
    stop_at_touchdown: bool,
    events: Array,
    solver: PlanarSolver,
) -> tuple[int, int]:
    """Advance the planar tether and rover by dt in place, with events.

    Args:
        model: constants.
        motion: state, changed.
        phase: HELD, FLIGHT, LANDED or FREE; the other two phases are final.
        setpoint: of the jump drive.
        dt: [s].
        stop_at_touchdown: return at the touchdown instead of at dt.
        events: (m, EVENT_SIZE), filled in order; an apex below an earlier one is omitted.
        solver: work arrays of one thread; its report is filled.

    Returns:
        Outcome and phase. After OUTCOME_DIVERGED the arrays hold the last converged state, after
        OUTCOME_BROKEN the state after the step that broke the tether.
    """
    report = solver.report
    for k in range(REPORT_SIZE):
        report[k] = 0.0
    report[SMALLEST_STEP] = np.inf
    report[PEAK_TENSION] = -np.inf
    reset_rate(solver.convergence)
    clear_history(solver.history)
    phase = _march(model, motion, phase, setpoint, dt, stop_at_touchdown, events, solver)
    _report_end(model, motion, report)
    if phase == DIVERGED:
        return OUTCOME_DIVERGED, phase
    if phase == TETHER_BROKEN:
        return OUTCOME_BROKEN, phase
    if report[HALVINGS] > 0.0:
        return OUTCOME_HALVED, phase
    return OUTCOME_CONVERGED, phase
