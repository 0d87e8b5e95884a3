"""The tether's material frames in a step of the spatial plant, with natural curvature.

The fairlead holds the frame of the tether's root, the swivel that of its tip: below its friction
torque it sticks to the rover, above it slips, and a free one leaves the tip untwisted. Between them
the twist takes the values of least energy after each step (`natural_curvature`), so that the
spring of `twist` becomes a field. The moment that holds the tip at a step's start acts on rover and
tip during the step, as the spring's does.
"""

import math

from rover_sim.physics.integrators.integrator_memory import (
    HEAT_SWIVEL,
    HEAT_TETHER,
    INPUT_REMESHING,
    INPUT_TETHER,
    SWIVEL_SLIP,
)
from rover_sim.physics.integrators.session import Session
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector, axpy, cross, dot, rotation_of, scale
from rover_sim.physics.rover.spatial_rover import orientation, vector_at
from rover_sim.physics.tether.carried_frames import (
    carry_frames,
    hold_root,
    merge_frames,
    relax_bending,
    relax_twist,
    split_frames,
    tip_moment,
    turn_director,
)
from rover_sim.physics.tether.natural_curvature import (
    NO_EXIT,
    ExitSpan,
    exit_energy_by_length,
    natural_energies,
    twisting_energy,
)
from rover_sim.physics.tether.tether import Tether, with_elements
from rover_sim.physics.tether.twist import FOLDED, tip_direction, transported, twist_axis
from rover_sim.physics.tether.variable_length import Payout, bending_at_length


@inner
def exit_span(session: Session, length: float) -> ExitSpan:
    """The exit element, of this length [m], as natural curvature needs it."""
    if not session.model.has_winch:
        return NO_EXIT
    return ExitSpan(length, vector_at(session.motion.fairlead_slope[0], 0))


@inner
def frame_torque(session: Session, tether: Tether) -> Vector:
    """Torque of the tether's tip on the rover [N m]; sets its counterpart on the tip's slope."""
    motion, law = session.motion, session.natural
    n, limit = tether.elements, session.model.swivel_torque
    moment = min(max(tip_moment(tether, motion.q, law), -limit), limit)
    attitude = orientation(motion.body)
    t = tip_direction(n, motion.q)
    b = scale(-1.0, rotation_of(attitude)[2])
    slope = (motion.q[3, n], motion.q[4, n], motion.q[5, n])
    share = -moment / (max(1.0 + dot(t, b), FOLDED) * math.sqrt(dot(slope, slope)))
    law.tip[0], law.tip[1], law.tip[2] = scale(share, cross(b, t))
    return scale(-moment, twist_axis(n, motion.q, attitude))


@inner
def _lead_of_rover(session: Session, tether: Tether) -> float:
    """Angle from the tip's frame to that of a swivel which sticks [rad]."""
    motion, law, n = session.motion, session.natural, tether.elements
    t = tip_direction(n, motion.q)
    body = rotation_of(orientation(motion.body))
    d, defined = transported(body[0], scale(-1.0, body[2]), t)
    if not defined:
        return 0.0
    slip = session.memory[SWIVEL_SLIP]
    d = axpy(math.cos(slip), d, scale(-math.sin(slip), cross(t, d)))
    tip = (law.director[0, n], law.director[1, n], law.director[2, n])
    return math.atan2(dot(cross(tip, d), t), dot(tip, d))


@inner
def _energy_of_length(session: Session, tether: Tether, pay: Payout, twist: float) -> float:
    """Energy by which the exit element's of bending and torsion changes with its length alone [J].

    The energy is that of U(e, l) at the same coordinates and twist (radians, at the step's start).
    """
    law, exit_element = session.natural, session.solver.exit_element
    energy = exit_energy_by_length(
        tether,
        (pay.length0, pay.length1),
        exit_element.start,
        exit_element.change,
        (twist, law.exit[0]),
        law,
    )
    energy += bending_at_length(tether, pay.length1, exit_element)
    energy -= bending_at_length(tether, pay.length0, exit_element)
    return energy


@inner
def end_frames(session: Session, tether: Tether, pay: Payout, h: float) -> None:
    """Carry the frames to the end of an accepted step, turn the tip with the rover, and relax.

    The heat of the relaxed twist and bending belongs to the tether.

    Args:
        session: changed.
        tether: the chain.
        pay: what was paid out in the step.
        h: its length [s].
    """
    model, memory, law, q = session.model, session.memory, session.natural, session.motion.q
    n, limit = tether.elements, model.swivel_torque
    span = exit_span(session, pay.length1)
    twist = law.exit[0]
    carry_frames(tether, q, session.solver.work.increment, law)
    if not model.has_winch:
        hold_root(law, q)
    carried = twisting_energy(tether, q, span, law)
    if model.has_winch:
        memory[INPUT_TETHER] += _energy_of_length(session, tether, pay, twist)
    lead, turned, slip_heat = 0.0, 0.0, 0.0
    if model.has_rover:
        lead = _lead_of_rover(session, tether)
    if model.has_rover and limit > 0.0:
        turn_director(law, q, n, lead)
        turned = lead
        carried = twisting_energy(tether, q, span, law)
        after, _ = relax_twist(tether, q, span, True, 0.0, law)
        moment = tip_moment(tether, q, law)
        if abs(moment) > limit:
            load = math.copysign(limit, moment)
            after, more = relax_twist(tether, q, span, False, load, law)
            turned += more
            slip_heat = -load * more
    else:
        after, turned = relax_twist(tether, q, span, False, 0.0, law)
    memory[SWIVEL_SLIP] += lead - turned
    memory[HEAT_SWIVEL] += slip_heat
    memory[HEAT_TETHER] += carried - after - slip_heat
    if law.relaxation.share > 0.0:
        memory[HEAT_TETHER] += relax_bending(tether, q, h, law)


@inner
def frames_energy(session: Session, tether: Tether, length: float) -> float:
    """Energy of natural curvature and twist [J], with an exit element of this length [m]."""
    if not session.natural.active:
        return 0.0
    parts = natural_energies(tether, session.motion.q, exit_span(session, length), session.natural)
    return parts[0] + parts[1]


@inner
def remesh_frames(
    session: Session, tether: Tether, split: bool, length: float, before: float
) -> None:
    """Give or take the frame of a node that is split off the exit element or merged with it.

    Args:
        session: after the change.
        tether: the chain before the change.
        split: whether the node is new.
        length: of the exit element before the change [m].
        before: the frames' energy there [J].
    """
    if not session.natural.active:
        return
    nominal = tether.element_length
    if split:
        chain = with_elements(tether, tether.elements + 1)
        length -= nominal
        split_frames(chain, session.motion.q, exit_span(session, length), session.natural)
    else:
        chain = with_elements(tether, tether.elements - 1)
        length += nominal
        merge_frames(chain, session.motion.q, exit_span(session, length), session.natural)
    session.memory[INPUT_REMESHING] += frames_energy(session, chain, length) - before
