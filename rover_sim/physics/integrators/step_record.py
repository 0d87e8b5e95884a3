"""What the spatial plant records of an accepted step: energy sums, report and events."""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.integrators import integrator_memory as entry
from rover_sim.physics.integrators.integrator_memory import report_loads
from rover_sim.physics.integrators.session import Session
from rover_sim.physics.integrators.spatial_step import Losses, WheelMotion
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive
from rover_sim.physics.mechanisms.jump_drive import Latch
from rover_sim.physics.mechanisms.slider import slider_energy
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.event_location import apex_instant, hermite
from rover_sim.physics.numerics.vectors import Vector, dot
from rover_sim.physics.rover.spatial_rover import POSITION, SLIDE, VELOCITY1, vector_at
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.buckling import NO_BUCKLING
from rover_sim.physics.tether.tether import Tether
from rover_sim.physics.tether.variable_length import ExitElement, Payout, strain_energy_inflow

# The rover is airborne after this time without contact [s]: bounces are part of a landing.
_AIRBORNE_AFTER = 0.02
_RELEASED, _HOOKING = int(Latch.RELEASED), int(Latch.HOOKING)


# A run's energy balance that is open by more than this share of the energy turned over, plus this
# energy [J], makes the run's results doubtful.
_DRIFT_SHARE, _DRIFT_FLOOR = 1.0e-2, 1.0e-3


# A push of the tether beyond what it can carry is reported if it exceeds this share of the weight
# of rover or tip mass.
_PUSH_SHARE = 0.25


class Progress(NamedTuple):
    """Time within a call of `advance`."""

    start: float  # time of the run at the call [s]
    elapsed: float  # since then [s]
    h: float  # length of the last step [s]


@inner
def record_event(session: Session, kind: int, time: float, value: float, tension: float) -> None:
    """Append an event with the present motion of G1 if there is room."""
    body = session.motion.body
    _append_event(session, kind, time, vector_at(body, POSITION), _speed(body), value, tension)


@inner
def _append_event(
    session: Session, kind: int, time: float, place: Vector, speed: float, value: float,
    tension: float,
) -> None:  # fmt: skip
    report = session.report
    count = int(report[entry.EVENT_COUNT])
    if count < session.events.shape[0]:
        row = session.events[count]
        row[0] = kind
        row[1] = time
        for d in range(3):
            row[2 + d] = place[d]
        row[5] = speed
        row[6] = session.memory[entry.MAX_RISE]
        row[7] = tension
        row[8] = value
        report[entry.EVENT_COUNT] += 1.0


@inner
def _speed(body: Vector) -> float:
    velocity = vector_at(body, VELOCITY1)
    return float(np.sqrt(dot(velocity, velocity)))


@inner
def add_losses(losses: Losses, memory: Array) -> None:
    """Add a step's losses to the energy sums."""
    memory[entry.HEAT_TETHER] += losses.tether
    memory[entry.HEAT_SLIDER] += losses.slider
    memory[entry.HEAT_ROVER_GROUND] += losses.rover_ground
    memory[entry.HEAT_TETHER_GROUND] += losses.tether_ground
    memory[entry.HEAT_AIR] += losses.air
    memory[entry.INPUT_ENDS] += losses.ends
    memory[entry.CONTACT_ENERGY] += losses.rover_stored + losses.tether_stored


@inner
def pressing(latch: int) -> bool:
    """Whether nut and latch can touch."""
    return latch not in (_RELEASED, _HOOKING)


@inner
def _tether_inflow(
    tether: Tether,
    pay: Payout,
    slope0: Vector,
    fairlead_slope: Array,
    exit_element: ExitElement,
) -> float:
    """Energy carried through the fairlead by paid-out tether in a step, beyond the drum's work [J].

    The drum's energy balance holds the work v_pay T per time along the unstretched length, but
    stretched tether passes the fairlead at |r'| v_pay and carries kinetic and strain energy:

        dE = v_pay (T (1 - |r'|) + rho A |dr/dt|^2/2 + EA eps^2/2) dt,

    the last term in compression as `strain_energy_inflow` has it.
    """
    paid_out = pay.length1 - pay.length0
    tension = exit_element.tension[0]
    square, speed = 0.0, 0.0
    rate = 0.5 * (pay.rate0 + pay.rate1)
    for d in range(3):
        slope = 0.5 * (slope0[d] + fairlead_slope[0, d])
        square += slope * slope
        speed += (exit_element.rate[0, d] + rate * slope) ** 2
    carried = 0.5 * tether.line_density * speed
    stored = strain_energy_inflow(tether, square, exit_element)
    return paid_out * (tension * (1.0 - np.sqrt(square)) + carried + stored)


@inner
def release_nut(session: Session, was_pressing: bool, jump: jump_drive.JumpState) -> None:
    """Add the elastic energy of nut and latch to the heat if the latch has released."""
    slider, slide = session.model.slider, session.motion.body[SLIDE]
    released = slider_energy(slider, was_pressing, jump.nut, slide)
    released -= slider_energy(slider, pressing(jump.latch), jump.nut, slide)
    session.memory[entry.HEAT_SLIDER] += released


@inner
def end_jump_drive(
    session: Session,
    jump: jump_drive.JumpState,
    step: jump_drive.JumpStep,
    loads: jump_drive.JumpLoads,
    screw: jump_drive.JumpResponse,
) -> tuple[jump_drive.JumpState, float]:
    """End the jump drive's step; returns its state and its kinetic energy [J]."""
    model, memory, report = session.model, session.memory, session.report
    after, out, balance = jump_drive.end(model.jump, model.slider, jump, step, loads, screw)
    memory[entry.INPUT_JUMP] += balance.motor_work
    memory[entry.HEAT_JUMP] += balance.screw_heat + balance.friction_heat + balance.stop_heat
    release_nut(session, step.pressing, after)
    report[entry.JUMP_CURRENT] = out.current
    report[entry.SCREW_HARD_LIMIT] = out.hard_limit
    return after, balance.kinetic


@inner
def end_wheels(session: Session, wheels: WheelMotion) -> None:
    """Add the wheels' energies to the sums, and report their drive."""
    memory, report = session.memory, session.report
    out, balance = wheels.outputs, wheels.balance
    memory[entry.INPUT_WHEELS] += balance.motor_work
    memory[entry.HEAT_WHEELS] += balance.gear_heat + balance.friction_heat + balance.ratchet_heat
    report[entry.WHEEL_CURRENT] = out.current


@inner
def end_drum(
    session: Session, tether: Tether, pay: Payout, slope0: Vector, out: drums.DrumOutputs,
    balance: drums.DrumEnergyBalance,
) -> None:  # fmt: skip
    """Add the drum's energies to the sums, and report its drive and the tension."""
    memory, report = session.memory, session.report
    exit_element = session.solver.exit_element
    memory[entry.INPUT_WINCH] += balance.motor_work
    memory[entry.HEAT_WINCH] += balance.gear_heat + balance.friction_heat
    memory[entry.HEAT_WINCH] += balance.brake_heat + balance.stop_heat
    tension = exit_element.tension[0]
    memory[entry.INPUT_TETHER] += _tether_inflow(
        tether, pay, slope0, session.motion.fairlead_slope, exit_element
    )
    memory[entry.FAIRLEAD_TENSION] = tension
    report[entry.WINCH_CURRENT] = out.current
    report[entry.DRUM_STOP] = out.stop


@inner
def follow_flight(
    session: Session, losses: Losses, progress: Progress, z0: float, dz0: float
) -> None:
    """Record contact, take-off, apex and touchdown of a step that began at height z0 [m].

    `dz0` is the vertical velocity at its start [m/s].
    """
    memory, body = session.memory, session.motion.body
    now, h = progress.start + progress.elapsed, progress.h
    corners = session.model.rover_contact.corners.shape[0]
    load = report_loads(corners, session.solver.rover_contact, losses.near_ground, session.report)
    if load > 0.0:
        if memory[entry.AIRBORNE] != 0.0:
            record_event(session, entry.EVENT_TOUCHDOWN, now, load, losses.peak_tension)
        memory[entry.AIRBORNE] = 0.0
        memory[entry.CONTACT_TIME] = now
        memory[entry.TAKE_OFF_TIME] = now
        memory[entry.TAKE_OFF_X], memory[entry.TAKE_OFF_Y] = body[POSITION], body[POSITION + 1]
        memory[entry.TAKE_OFF_Z] = body[POSITION + 2]
        memory[entry.TAKE_OFF_SPEED] = _speed(body)
        memory[entry.MAX_RISE] = 0.0
        return
    z1, dz1 = body[POSITION + 2], body[VELOCITY1 + 2]
    rise = z1 - memory[entry.TAKE_OFF_Z]
    instant = h
    apex = dz0 > 0.0 >= dz1
    if apex:
        instant = apex_instant(h, z0, dz0, z1, dz1)
        rise = hermite(instant, h, z0, dz0, z1, dz1) - memory[entry.TAKE_OFF_Z]
    higher = rise > memory[entry.MAX_RISE]
    memory[entry.MAX_RISE] = max(memory[entry.MAX_RISE], rise)
    if memory[entry.AIRBORNE] == 0.0 and now - memory[entry.CONTACT_TIME] > _AIRBORNE_AFTER:
        memory[entry.AIRBORNE] = 1.0
        # It is noticed only now: it has the motion of the last contact.
        time = memory[entry.TAKE_OFF_TIME]
        _append_event(
            session, entry.EVENT_TAKE_OFF, time, vector_at(memory, entry.TAKE_OFF_X),
            memory[entry.TAKE_OFF_SPEED], now - time, losses.peak_tension,
        )  # fmt: skip
    if apex and higher and memory[entry.AIRBORNE] == 1.0:
        record_event(session, entry.EVENT_APEX, now - h + instant, rise, losses.peak_tension)


@inner
def check_push(session: Session, tether: Tether, now: float) -> None:
    """Record once a run if the tether pushes with more than it can carry.

    An element carries the load of the law of `buckling`; without that law, Euler's of a hinged
    column of its length, pi^2 EI/l^2, beyond which a real tether buckles between its nodes. A share
    of the weight of rover or tip mass is allowed beyond that: damping pushes too when a tether
    slackens. Without weight nothing is reported.
    """
    model, memory = session.model, session.memory
    mass = model.rover.m1 + model.rover.m2 if model.has_rover else model.tip_mass
    weight = mass * np.sqrt(dot(tether.gravity, tether.gravity))
    if memory[entry.PUSH_REPORTED] != 0.0 or weight == 0.0:
        return
    push = 0.0
    for e in range(tether.elements):
        push = max(push, -session.solver.work.tension[e])
    if model.has_winch:
        push = max(push, -memory[entry.FAIRLEAD_TENSION])
    limit = tether.axial_stiffness * tether.buckling_strain
    if tether.buckling_strain >= NO_BUCKLING:
        limit = (np.pi / tether.element_length) ** 2 * tether.bending_stiffness
    limit += _PUSH_SHARE * weight
    if push <= limit:
        return
    memory[entry.PUSH_REPORTED] = 1.0
    record_event(session, entry.EVENT_TETHER_PUSH, now, push, limit)


@inner
def check_energy(session: Session, now: float) -> None:
    """Record once a run if the energy balance is open by more than `_DRIFT_SHARE`."""
    memory, report = session.memory, session.report
    if memory[entry.DRIFT_REPORTED] != 0.0:
        return
    drift = -memory[entry.INITIAL_ENERGY] - memory[entry.INPUT_REMESHING]
    turnover = report[entry.KINETIC] + abs(memory[entry.INPUT_REMESHING])
    for k in range(entry.KINETIC, entry.TORSION + 1):
        drift += report[k]
    for k in range(entry.INPUT_JUMP, entry.INPUT_TETHER + 1):
        drift -= memory[k]
        turnover += abs(memory[k])
    for k in range(entry.HEAT_TETHER, entry.HEAT_AIR + 1):
        drift += memory[k]
        turnover += abs(memory[k])
    if abs(drift) <= _DRIFT_SHARE * turnover + _DRIFT_FLOOR:
        return
    memory[entry.DRIFT_REPORTED] = 1.0
    record_event(session, entry.EVENT_ENERGY_DRIFT, now, drift, turnover)
