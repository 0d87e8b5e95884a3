"""Material frames of a tether from step to step: carried, turned, relaxed, split and merged.

The laws are those of `natural_curvature`; during a step the frames follow the slopes, and what is
here happens once the step is accepted.
"""

import math

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector, axpy, cross, dot, scale
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.natural_curvature import (
    NO_EXIT,
    Components,
    ExitSpan,
    NaturalCurvature,
    carry_vector,
    column,
    element_twist,
    guided_director,
    mean_square,
    natural_vector,
    set_column,
    slope_at,
    twisting_energy,
    unit,
)
from rover_sim.physics.tether.tether import Tether

_RELAXATIONS = 2  # Newton steps of the twist after each step
_LARGEST_TURN = 0.5  # of a frame in such a step [rad]


@inner
def carry_director(law: NaturalCurvature, i: int, t0: Vector, t1: Vector) -> None:
    """Carry the frame of node i from the direction t0 to t1."""
    d = carry_vector(column(law.director, 0, i), t0, t1)
    d = axpy(-dot(d, t1), t1, d)
    d, _ = unit(d)
    set_column(law.director, i, d)


@inner
def carry_frames(tether: Tether, q1: Array, increment: Array, law: NaturalCurvature) -> None:
    """Carry the frames of all nodes to the end q1 of a step of this increment."""
    for i in range(tether.elements + 1):
        t0, _ = unit(slope_at(q1, increment, -1.0, i))
        t1, _ = unit(column(q1, 3, i))
        carry_director(law, i, t0, t1)


@inner
def hold_root(law: NaturalCurvature, q: Array) -> None:
    """Set the root's frame to that of the fairlead."""
    t, _ = unit(column(q, 3, 0))
    set_column(law.director, 0, guided_director(t))


@inner
def end_natural_curvature(tether: Tether, q0: Array, q1: Array, law: NaturalCurvature) -> None:
    """Carry the frames to the end of an accepted step, and relax the twist between held ends.

    Args:
        tether: constants.
        q0: rows at the step's start.
        q1: rows at its end.
        law: changed.
    """
    for i in range(tether.elements + 1):
        t0, _ = unit(column(q0, 3, i))
        t1, _ = unit(column(q1, 3, i))
        carry_director(law, i, t0, t1)
    relax_twist(tether, q1, NO_EXIT, True, 0.0, law)


@inner
def turn_director(law: NaturalCurvature, q: Array, i: int, angle: float) -> None:
    """Turn the frame of node i about the tether."""
    t, _ = unit(column(q, 3, i))
    d = column(law.director, 0, i)
    set_column(law.director, i, axpy(math.cos(angle), d, scale(math.sin(angle), cross(t, d))))


@inner
def tip_moment(tether: Tether, q: Array, law: NaturalCurvature) -> float:
    """Moment that holds the tip's frame, the derivative of W by its angle [N m]."""
    n = tether.elements
    t_i, _ = unit(column(q, 3, n - 1))
    t_j, _ = unit(column(q, 3, n))
    bend = 0.5 * tether.bending_stiffness * (4.0 - dot(t_i, t_j)) / 3.0
    moment = bend * dot(t_i, cross(t_j, natural_vector(tether, law, q, n)))
    return moment + law.torsion / tether.element_length * law.twist[n - 1]


@inner
def relax_twist(
    tether: Tether,
    q: Array,
    span: ExitSpan,
    is_tip_held: bool,
    load: float,
    law: NaturalCurvature,
) -> tuple[float, float]:
    """Turn the inner frames towards the least energy.

    The frame of the root, or of the fairlead in front of the exit element, stays, and the tip's if
    it is held; else the moment `load` [N m] acts on the tip. A frame that is bent against its
    natural curvature would be turned to a maximum by Newton's step: there the curvature of the
    bending energy is left out.

    Returns:
        W of all elements [J], and the turn of the tip [rad].
    """
    n = tether.elements
    first = 0 if span.length > 0.0 else 1
    last = n - 1 if is_tip_held else n
    rigidity = law.torsion / tether.element_length
    exit_rigidity = law.torsion / span.length if span.length > 0.0 else 0.0
    turned = 0.0
    total = twisting_energy(tether, q, span, law)
    for _ in range(_RELAXATIONS):
        # forward elimination of the tridiagonal equations for the turns of nodes first to last
        before, before_value = 0.0, 0.0
        for i in range(first, last + 1):
            t, _ = unit(column(q, 3, i))
            k = natural_vector(tether, law, q, i)
            turn = cross(t, k)
            if i == 0:
                t_before, _ = unit(span.slope)
                diagonal, gradient = exit_rigidity, exit_rigidity * law.exit[0]
            else:
                t_before, _ = unit(column(q, 3, i - 1))
                diagonal, gradient = rigidity, rigidity * law.twist[i - 1]
            ahead = (0.0, 0.0, 0.0)
            if i < n:
                ahead, _ = unit(column(q, 3, i + 1))
                factor = (4.0 - dot(t, ahead)) / 3.0
                ahead = scale(factor, ahead)
                diagonal += rigidity
                gradient -= rigidity * law.twist[i]
            else:
                gradient -= load
            factor = (4.0 - dot(t, t_before)) / 3.0
            bend = scale(0.5 * tether.bending_stiffness, axpy(-factor, t_before, ahead))
            gradient -= dot(bend, turn)
            diagonal += max(0.0, dot(bend, k))
            pivot = diagonal + rigidity * before
            before = -rigidity / pivot
            before_value = (-gradient + rigidity * before_value) / pivot
            law.sweep[0, i] = before
            law.sweep[1, i] = before_value
        angle = 0.0
        for i in range(last, first - 1, -1):
            angle = law.sweep[1, i] - law.sweep[0, i] * angle
            law.sweep[2, i] = min(max(angle, -_LARGEST_TURN), _LARGEST_TURN)
        for i in range(first, last + 1):
            turn_director(law, q, i, law.sweep[2, i])
        if last == n:
            turned += law.sweep[2, n]
        total = twisting_energy(tether, q, span, law)
    return total, turned


@inner
def set_relaxed(law: NaturalCurvature, place: int, relaxed: Components) -> None:
    """Set the relaxed curvature at a place counted from the tip [1/m], and what acts there."""
    share = law.relaxation.share
    for k in range(2):
        law.relaxed[k, place] = relaxed[k]
        law.curvature[k, place] = (1.0 - share) * law.elastic[k, place] + share * relaxed[k]


@inner
def relax_bending(tether: Tether, q: Array, h: float, law: NaturalCurvature) -> float:
    """Let the relaxed curvature approach that of the shape q for a time h [s]; infinite: wholly.

    Returns:
        Energy dissipated [J].
    """
    n, length = tether.elements, tether.element_length
    kept = math.exp(-h / law.relaxation.time)
    # forward elimination of the tridiagonal equations C k* = b
    ahead, first, second = 0.0, 0.0, 0.0
    for i in range(n + 1):
        t, _ = unit(column(q, 3, i))
        d = column(law.director, 0, i)
        bend = (0.0, 0.0, 0.0)
        before, diagonal = 0.0, 0.0
        if i > 0:
            u, _ = unit(column(q, 3, i - 1))
            bend = scale(-0.5 * (4.0 - dot(t, u)) / 3.0, u)
            before = length / 6.0
            diagonal += length / 3.0
        if i < n:
            u, _ = unit(column(q, 3, i + 1))
            bend = axpy(0.5 * (4.0 - dot(t, u)) / 3.0, u, bend)
            diagonal += length / 3.0
        pivot = diagonal - before * ahead
        ahead = length / 6.0 / pivot
        first = (dot(bend, d) - before * first) / pivot
        second = (dot(bend, cross(t, d)) - before * second) / pivot
        law.sweep[0, i], law.sweep[1, i], law.sweep[2, i] = ahead, first, second
    square = 0.0
    first, second = 0.0, 0.0
    excess = (0.0, 0.0)
    for i in range(n, -1, -1):
        ahead = law.sweep[0, i] if i < n else 0.0
        first = law.sweep[1, i] - ahead * first
        second = law.sweep[2, i] - ahead * second
        place = n - i
        own = (law.relaxed[0, place] - first, law.relaxed[1, place] - second)
        if i < n:
            square += length * mean_square(own, excess)
        excess = own
        set_relaxed(law, place, (first + kept * own[0], second + kept * own[1]))
    stiffness = law.relaxation.share * tether.bending_stiffness
    return 0.5 * stiffness * (1.0 - kept * kept) * square


@inner
def split_frames(tether: Tether, q: Array, span: ExitSpan, law: NaturalCurvature) -> None:
    """Give a frame to the chain's first node, which has been split off the exit element.

    The twist of the exit element is shared by length.

    Args:
        tether: the chain after the split.
        q: its rows.
        span: the exit element after the split.
        law: changed.
    """
    for i in range(tether.elements, 0, -1):
        set_column(law.director, i, column(law.director, 0, i - 1))
        law.twist[i] = law.twist[i - 1]
    t_0, _ = unit(span.slope)
    t_1, _ = unit(column(q, 3, 0))
    t_2, _ = unit(column(q, 3, 1))
    d = carry_vector(guided_director(t_0), t_0, t_1)
    ahead = column(law.director, 0, 1)
    whole = element_twist(d, ahead, t_1, t_2, law.exit[0])
    law.exit[0] = whole * span.length / (span.length + tether.element_length)
    law.twist[0] = whole - law.exit[0]
    set_column(law.director, 0, d)
    turn_director(law, q, 0, law.exit[0])


@inner
def merge_frames(tether: Tether, q: Array, span: ExitSpan, law: NaturalCurvature) -> None:
    """Remove the frame of the chain's first node, which has been merged with the exit element.

    Args:
        tether: the chain after the merger.
        q: its rows.
        span: the exit element after the merger.
        law: changed.
    """
    whole = law.exit[0] + law.twist[0]
    for i in range(tether.elements + 1):
        set_column(law.director, i, column(law.director, 0, i + 1))
        law.twist[i] = law.twist[i + 1]
    t_i, _ = unit(span.slope)
    t_j, _ = unit(column(q, 3, 0))
    d_i, d_j = guided_director(t_i), column(law.director, 0, 0)
    law.exit[0] = element_twist(d_i, d_j, t_i, t_j, whole)
