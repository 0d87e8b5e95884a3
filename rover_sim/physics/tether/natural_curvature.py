"""Natural curvature of the tether, in a material frame that is carried along it.

A coiled tether is bent where no force acts. Its bending energy is 1/2 int EI |r'' - k|^2 dx with
the natural curvature k = k1 d1 + k2 d2 in the material directions d1, d2 normal to the tether, and
its torsional energy 1/2 int GJ tau^2 dx. Beyond the energy of a straight tether (`energy_momentum`)
an element between nodes i and j of directions t (unit slopes) and natural curvatures K has

    W = -1/2 EI g(c) (t_j.K_i - t_i.K_j) + 1/2 GJ psi^2 / l,    g(c) = 1 + (1 - c)/3,  c = t_i.t_j.

The first term is -EI int r''.k dx for an arc with k linear along it; g replaces the sine of the
arc's angle by the angle to the fourth order. psi is the angle from d1 at node i, carried to node j
by the smallest rotation of the directions (a Bishop frame, see `twist`), to d1 at node j.

The frame of each node is carried along in time by the smallest rotation too (Bergou et al. 2010,
ACM Trans. Graphics 29, 116): its motion within a step is a function of the slopes alone, and so are
the forces, by

    dK_i = -t_i (K_i.dt_i),    dpsi = 1/2 b.(dt_i + dt_j),   b = 2 t_i x t_j / (1 + c).

Twist waves are far faster than bending waves and die out within a step: after each step the angles
of the inner frames take the values of least energy, between the angles of the frames at the ends,
which whatever holds them carries along (Bergou et al. 2008, ACM Trans. Graphics 27, 63). The energy
that this sets free is dissipated.

Forces act at mid-step and are corrected along the increment of an element's slopes so that their
work is exactly the change of W (Gonzalez 1996, J. Nonlinear Science 6).
"""

import math
from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector, axpy, cross, dot, scale
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import Workspace
from rover_sim.physics.tether.tether import Tether
from rover_sim.physics.tether.twist import transported

_RELAXATIONS = 2  # Newton steps of the twist after each step
_LARGEST_TURN = 0.5  # of a frame in such a step [rad]


class NaturalCurvature(NamedTuple):
    """Constants and work arrays of the law; rows of `width` columns, one per node or element."""

    active: bool
    torsion: float  # GJ [N m2]
    curvature: Array  # natural curvature k1, k2 at the nodes [1/m], (2, width)
    director: Array  # d1 at the nodes, the state, (3, width)
    natural: Array  # work: K at the step's start, (3, width)
    twist: Array  # work: psi of the elements at the step's start [rad], (width,)
    stored: Array  # work: W of the elements at the step's start [J], (width,)
    sweep: Array  # work: elimination of the twist, (3, width)


def make_natural_curvature(width: int, torsion: float, active: bool) -> NaturalCurvature:
    """Allocate for rows of `width` columns."""
    return NaturalCurvature(
        active,
        torsion,
        np.zeros((2, width)),
        np.zeros((3, width)),
        np.zeros((3, width)),
        np.zeros(width),
        np.zeros(width),
        np.zeros((3, width)),
    )


@inner
def _column(rows: Array, first: int, i: int) -> Vector:
    return (rows[first, i], rows[first + 1, i], rows[first + 2, i])


@inner
def _set_column(rows: Array, i: int, value: Vector) -> None:
    rows[0, i], rows[1, i], rows[2, i] = value


@inner
def _unit(a: Vector) -> tuple[Vector, float]:
    """Direction and 1/size of a vector."""
    shrink = 1.0 / math.sqrt(dot(a, a) + 1.0e-30)
    return scale(shrink, a), shrink


@inner
def _slope(q: Array, increment: Array, part: float, i: int) -> Vector:
    return (
        q[3, i] + part * increment[3, i],
        q[4, i] + part * increment[4, i],
        q[5, i] + part * increment[5, i],
    )


@inner
def _element_twist(d_i: Vector, d_j: Vector, t_i: Vector, t_j: Vector, before: float) -> float:
    """Angle psi of an element, unwrapped to within half a turn of `before`."""
    d, defined = transported(d_i, t_i, t_j)
    if not defined:
        return before
    turn = math.atan2(dot(cross(d, d_j), t_j), dot(d, d_j)) - before
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    return before + turn


@inner
def _bending_part(stiffness: float, t_i: Vector, t_j: Vector, k_i: Vector, k_j: Vector) -> float:
    """First term of W."""
    factor = (4.0 - dot(t_i, t_j)) / 3.0
    return -0.5 * stiffness * factor * (dot(t_j, k_i) - dot(t_i, k_j))


@inner
def _carried(k: Vector, t0: Vector, t1: Vector) -> Vector:
    moved, _ = transported(k, t0, t1)
    return moved


@inner
def natural_vector(law: NaturalCurvature, q: Array, i: int) -> Vector:
    """Natural curvature K of node i in the world [1/m]."""
    t, _ = _unit(_column(q, 3, i))
    d = _column(law.director, 0, i)
    return axpy(law.curvature[0, i], d, scale(law.curvature[1, i], cross(t, d)))


@inner
def begin_natural_curvature(tether: Tether, q0: Array, law: NaturalCurvature) -> None:
    """Prepare a step from q0."""
    n = tether.elements
    for i in range(n + 1):
        _set_column(law.natural, i, natural_vector(law, q0, i))
    for e in range(n):
        law.stored[e] = _element_energy(tether, q0, e, law)


@inner
def _element_energy(tether: Tether, q: Array, e: int, law: NaturalCurvature) -> float:
    t_i, _ = _unit(_column(q, 3, e))
    t_j, _ = _unit(_column(q, 3, e + 1))
    law.twist[e] = _element_twist(
        _column(law.director, 0, e), _column(law.director, 0, e + 1), t_i, t_j, law.twist[e]
    )
    stored = _bending_part(
        tether.bending_stiffness, t_i, t_j, natural_vector(law, q, e), natural_vector(law, q, e + 1)
    )
    return stored + 0.5 * law.torsion / tether.element_length * law.twist[e] ** 2


@inner
def natural_curvature_energy(tether: Tether, q: Array, law: NaturalCurvature) -> float:
    """Energy beyond that of a straight tether, with the natural state's as zero [J]."""
    total = 0.0
    for e in range(tether.elements):
        total += _element_energy(tether, q, e, law)
        for k in range(2):
            a, b = law.curvature[k, e], law.curvature[k, e + 1]
            third = (a * a + a * b + b * b) / 3.0
            total += 0.5 * tether.bending_stiffness * tether.element_length * third
    return total


@inner
def _perpendicular(f: Vector, t: Vector, shrink: float) -> Vector:
    """Gradient by a slope from the gradient f by its direction t."""
    return scale(shrink, axpy(-dot(f, t), t, f))


@inner
def natural_curvature_force(
    tether: Tether, q0: Array, e: int, work: Workspace, law: NaturalCurvature
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector]:
    """Gradient of W by the slopes of an element's nodes, directions and natural curvatures."""
    stiffness, length = tether.bending_stiffness, tether.element_length
    d = work.increment
    a_i, a_j = _column(q0, 3, e), _column(q0, 3, e + 1)
    s_i, _ = _unit(a_i)
    s_j, _ = _unit(a_j)
    t_i, shrink_i = _unit(_slope(q0, d, 0.5, e))
    t_j, shrink_j = _unit(_slope(q0, d, 0.5, e + 1))
    k_i = _carried(_column(law.natural, 0, e), s_i, t_i)
    k_j = _carried(_column(law.natural, 0, e + 1), s_j, t_j)
    c = dot(t_i, t_j)
    factor = (4.0 - c) / 3.0
    half = 0.5 * stiffness
    pull = half * (dot(t_j, k_i) - dot(t_i, k_j)) / 3.0
    f_i = axpy(half * factor, axpy(c, k_i, k_j), scale(pull, t_j))
    f_j = axpy(-half * factor, axpy(c, k_j, k_i), scale(pull, t_i))
    psi1 = law.twist[e]
    if law.torsion > 0.0:
        u_i, _ = _unit(_slope(q0, d, 1.0, e))
        u_j, _ = _unit(_slope(q0, d, 1.0, e + 1))
        d_i = _carried(_column(law.director, 0, e), s_i, u_i)
        d_j = _carried(_column(law.director, 0, e + 1), s_j, u_j)
        psi1 = _element_twist(d_i, d_j, u_i, u_j, law.twist[e])
        b = scale(1.0 / (1.0 + max(c, -0.99)), cross(t_i, t_j))
        moment = law.torsion / length * 0.5 * (law.twist[e] + psi1)
        f_i = axpy(moment, b, f_i)
        f_j = axpy(moment, b, f_j)
    f_i = _perpendicular(f_i, t_i, shrink_i)
    f_j = _perpendicular(f_j, t_j, shrink_j)
    # the correction along the increment
    da_i, da_j = _column(d, 3, e), _column(d, 3, e + 1)
    square = dot(da_i, da_i) + dot(da_j, da_j)
    if square > 1.0e-14:
        u_i, _ = _unit(_slope(q0, d, 1.0, e))
        u_j, _ = _unit(_slope(q0, d, 1.0, e + 1))
        m_i = _carried(_column(law.natural, 0, e), s_i, u_i)
        m_j = _carried(_column(law.natural, 0, e + 1), s_j, u_j)
        after = _bending_part(stiffness, u_i, u_j, m_i, m_j)
        after += 0.5 * law.torsion / length * psi1**2
        missing = after - law.stored[e] - dot(f_i, da_i) - dot(f_j, da_j)
        f_i = axpy(missing / square, da_i, f_i)
        f_j = axpy(missing / square, da_j, f_j)
    return f_i, f_j, t_i, t_j, k_i, k_j


@inner
def add_natural_curvature(
    tether: Tether, q0: Array, work: Workspace, law: NaturalCurvature
) -> None:
    """Add the forces at the increment in `work` to the elements' residual and tangent.

    The tangent leaves out the derivatives of g, of the twist and of the correction.
    """
    half = 0.25 * tether.bending_stiffness  # half of the increment is at mid-step
    blocks = work.blocks
    for e in range(tether.elements):
        f_i, f_j, t_i, t_j, k_i, k_j = natural_curvature_force(tether, q0, e, work, law)
        factor = half * (4.0 - dot(t_i, t_j)) / 3.0
        own_i, own_j = factor * dot(t_i, k_j), factor * dot(t_j, k_i)
        for r in range(3):
            blocks[e + 1, 0, 6, 3 + r] += f_i[r]
            blocks[e + 1, 1, 6, 3 + r] += f_j[r]
            blocks[e + 1, 0, 3 + r, 3 + r] -= own_i
            blocks[e + 1, 1, 3 + r, 3 + r] += own_j
            for c in range(3):
                blocks[e + 1, 0, 3 + c, 3 + r] += factor * k_i[r] * t_j[c]
                blocks[e + 1, 1, 3 + c, 3 + r] -= factor * k_j[r] * t_i[c]
                mixed = factor * (k_i[r] * t_i[c] - t_j[r] * k_j[c])
                blocks[e + 1, 0, 10 + c, 3 + r] += mixed
                blocks[e + 1, 1, 10 + r, 3 + c] += mixed


@inner
def end_natural_curvature(
    tether: Tether, q0: Array, q1: Array, roll0: float, roll1: float, law: NaturalCurvature
) -> tuple[float, float]:
    """Carry the frames to the end of an accepted step, turn the ends and relax the twist.

    Args:
        tether: constants.
        q0: rows at the step's start.
        q1: rows at its end.
        roll0: turn of the root's frame about the tether in the step [rad].
        roll1: the same of the tip's.
        law: changed.

    Returns:
        Work of the turned ends and energy dissipated by the relaxation [J].
    """
    n = tether.elements
    carried = 0.0
    for i in range(n + 1):
        t0, _ = _unit(_column(q0, 3, i))
        t1, _ = _unit(_column(q1, 3, i))
        d = _carried(_column(law.director, 0, i), t0, t1)
        d = axpy(-dot(d, t1), t1, d)
        d, _ = _unit(d)
        _set_column(law.director, i, d)
    for e in range(n):
        carried += _element_energy(tether, q1, e, law)
    turned = carried
    if roll0 != 0.0 or roll1 != 0.0:
        turn_director(law, q1, 0, roll0)
        turn_director(law, q1, n, roll1)
        turned = 0.0
        for e in range(n):
            turned += _element_energy(tether, q1, e, law)
    relaxed = relax_twist(tether, q1, True, law)
    return turned - carried, turned - relaxed


@inner
def turn_director(law: NaturalCurvature, q: Array, i: int, angle: float) -> None:
    """Turn the frame of node i about the tether."""
    t, _ = _unit(_column(q, 3, i))
    d = _column(law.director, 0, i)
    _set_column(law.director, i, axpy(math.cos(angle), d, scale(math.sin(angle), cross(t, d))))


@inner
def relax_twist(tether: Tether, q: Array, is_tip_held: bool, law: NaturalCurvature) -> float:
    """Turn the inner frames towards the least energy; return the energy of all elements [J].

    The root's frame stays, the tip's if it is held. A frame that is bent against its natural
    curvature would be turned to a maximum by Newton's step: there the curvature of the bending
    energy is left out.
    """
    n = tether.elements
    last = n - 1 if is_tip_held else n
    rigidity = law.torsion / tether.element_length
    for _ in range(_RELAXATIONS):
        # forward elimination of the tridiagonal equations for the turns of nodes 1 to `last`
        before, before_value = 0.0, 0.0
        for i in range(1, last + 1):
            t, _ = _unit(_column(q, 3, i))
            k = natural_vector(law, q, i)
            turn = cross(t, k)
            t_before, _ = _unit(_column(q, 3, i - 1))
            ahead = (0.0, 0.0, 0.0)
            diagonal, gradient = rigidity, rigidity * law.twist[i - 1]
            if i < n:
                ahead, _ = _unit(_column(q, 3, i + 1))
                factor = (4.0 - dot(t, ahead)) / 3.0
                ahead = scale(factor, ahead)
                diagonal += rigidity
                gradient -= rigidity * law.twist[i]
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
        for s in range(last):
            i = last - s
            angle = law.sweep[1, i] - law.sweep[0, i] * angle
            law.sweep[2, i] = min(max(angle, -_LARGEST_TURN), _LARGEST_TURN)
        for i in range(1, last + 1):
            turn_director(law, q, i, law.sweep[2, i])
        total = 0.0
        for e in range(n):
            total += _element_energy(tether, q, e, law)
    return total
