"""Natural curvature of the tether, in a material frame that is carried along it, and relaxation.

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

A fairlead holds the frame of the tether's root as a constant-velocity joint does: d1 is the world's
x axis, carried from the plumb line to the slope there by the smallest rotation. Its angle is a
function of the slope, and so is a force: with the plumb line o and the moment m = dW/d(angle),

    d(angle) = -(o x t).dt/(1 + o.t).

Where a drum pays out, the element at the fairlead has the same energy with its own length, and at
the fairlead the natural curvature of the place of the tether that is there; the formula of W leaves
out the energy 1/2 EI k^2 per length, which `natural_energies` has, so that no energy of bending
passes a fairlead with r'' = k.

A part B1 of the bending stiffness may relax (a Maxwell branch beside the elastic bending, together
the standard linear solid: Flugge 1975, Viscoelasticity, ch. 1). With the stiffness B of the bending
that stays, the natural curvature k and the relaxed curvature k_v the bending moment is

    M = B (kappa - k) + B1 (kappa - k_v),    dk_v/dt = (kappa - k_v)/tau.

This is the law above with the stiffness EI = B + B1 and the natural curvature (1 - s) k + s k_v,
s = B1/EI: `curvature` is this one, which acts. k_v is constant during a step; after it, with the
shape held, k_v approaches for the length of the step the values k* of least energy,

    k_v := k* + (k_v - k*) exp(-h/tau),    C k* = b,

where b are the derivatives of the first term of W by the nodes' natural curvature, over -EI, and C
is the matrix of int k^2 dx for k linear between the nodes. The energy that this sets free is
dissipated; it is s EI/2 (1 - exp(-2h/tau)) int (k_v - k*)^2 dx, never below zero.

Forces act at mid-step and are corrected along the increment of an element's slopes so that their
work is exactly the change of W (Gonzalez 1996, J. Nonlinear Science 6).
"""

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.vectors import Vector, axpy, cross, dot, scale
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.energy_momentum import Workspace
from rover_sim.physics.tether.tether import Tether
from rover_sim.physics.tether.twist import transported

Components: TypeAlias = tuple[float, float]  # k1, k2 of the natural curvature [1/m]

_DOWN: Vector = (0.0, 0.0, -1.0)
_FORWARD: Vector = (1.0, 0.0, 0.0)


class BendingRelaxation(NamedTuple):
    """The part of the bending stiffness that relaxes; for a tether of constant length."""

    share: float  # s = B1/(B + B1) [-]; 0: none
    time: float  # tau [s]


def make_relaxation(ratio: float, time: float) -> BendingRelaxation:
    """Return the relaxation of a stiffness ratio B1/B [-] with a time tau [s]."""
    return BendingRelaxation(ratio / (1.0 + ratio), time)


NO_RELAXATION = make_relaxation(0.0, 1.0)


class NaturalCurvature(NamedTuple):
    """Constants and work arrays of the law; rows of `width` columns, one per node or element."""

    active: bool
    guided: bool  # whether a fairlead holds the frame of the chain's root; else it is carried
    torsion: float  # GJ [N m2]
    relaxation: BendingRelaxation
    curvature: Array  # natural curvature k1, k2 that acts, at the nodes counted from the tip [1/m],
    # (2, width); beyond the chain's first node lies what has not been paid out
    elastic: Array  # the same of the bending that stays; where there is relaxation
    relaxed: Array  # relaxed curvature k_v, likewise, the state
    director: Array  # d1 at the nodes, the state, (3, width)
    natural: Array  # work: K at the step's start, (3, width)
    twist: Array  # psi of the elements at the step's start [rad], the state, (width,)
    stored: Array  # work: W of the elements at the step's start [J], (width,)
    sweep: Array  # work: elimination of the twist, (3, width)
    exit: Array  # psi of the element at a fairlead with a drum [rad], the state, (1,)
    tip: Array  # work: gradient by the tip's slope of the tip's angle times its moment, (3,)


class ExitSpan(NamedTuple):
    """The element between a fairlead with a drum and the chain's first node."""

    length: float  # [m]; 0: there is none
    slope: Vector  # at the fairlead


NO_EXIT = ExitSpan(0.0, _DOWN)


class ElementForce(NamedTuple):
    """Gradient of W by the slopes of an element's nodes, their directions and curvatures K."""

    f_i: Vector
    f_j: Vector
    t_i: Vector
    t_j: Vector
    k_i: Vector
    k_j: Vector


def make_natural_curvature(
    width: int,
    torsion: float,
    curvature: Array,
    guided: bool,
    relaxation: BendingRelaxation = NO_RELAXATION,
) -> NaturalCurvature:
    """Allocate for rows of `width` columns; the law acts if there is curvature or relaxation.

    Args:
        width: of the rows.
        torsion: GJ [N m2].
        curvature: natural curvature at the nodes, counted from the tip [1/m], (2, 1 .. width); the
            last one continues.
        guided: whether a fairlead holds the frame of the chain's root.
        relaxation: of the bending.
    """
    places = np.minimum(np.arange(width), curvature.shape[1] - 1)
    along = np.ascontiguousarray(curvature[:, places])
    return NaturalCurvature(
        bool(np.any(curvature)) or relaxation.share > 0.0,
        guided,
        torsion,
        relaxation,
        along,
        along.copy(),
        np.zeros((2, width)),
        np.zeros((3, width)),
        np.zeros((3, width)),
        np.zeros(width),
        np.zeros(width),
        np.zeros((3, width)),
        np.zeros(1),
        np.zeros(3),
    )


@inner
def column(rows: Array, first: int, i: int) -> Vector:
    """Vector in three rows of column i."""
    return (rows[first, i], rows[first + 1, i], rows[first + 2, i])


@inner
def set_column(rows: Array, i: int, value: Vector) -> None:
    """Set column i of three rows."""
    rows[0, i], rows[1, i], rows[2, i] = value


@inner
def unit(a: Vector) -> tuple[Vector, float]:
    """Direction and 1/size of a vector."""
    shrink = 1.0 / math.sqrt(dot(a, a) + 1.0e-30)
    return scale(shrink, a), shrink


@inner
def slope_at(q: Array, increment: Array, part: float, i: int) -> Vector:
    """Slope of node i after this part of an increment."""
    return (
        q[3, i] + part * increment[3, i],
        q[4, i] + part * increment[4, i],
        q[5, i] + part * increment[5, i],
    )


@inner
def element_twist(d_i: Vector, d_j: Vector, t_i: Vector, t_j: Vector, before: float) -> float:
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
def carry_vector(k: Vector, t0: Vector, t1: Vector) -> Vector:
    """Carry a vector from the direction t0 of the tether to t1, without a turn about it."""
    moved, _ = transported(k, t0, t1)
    return moved


@inner
def guided_director(t: Vector) -> Vector:
    """Direction d1 of a frame that a fairlead holds, where the tether has the direction t."""
    d, defined = transported(_FORWARD, _DOWN, t)
    if not defined:
        d, _ = unit(axpy(-t[0], t, _FORWARD))
    return d


@inner
def _components(tether: Tether, law: NaturalCurvature, i: int) -> Components:
    """Natural curvature of node i."""
    place = tether.elements - i
    return law.curvature[0, place], law.curvature[1, place]


@inner
def fairlead_curvature(tether: Tether, length: float, law: NaturalCurvature) -> Components:
    """Natural curvature at a fairlead in front of an exit element of this length [m]."""
    place = tether.elements + length / tether.element_length
    before = min(int(place), law.curvature.shape[1] - 2)
    part = min(place - before, 1.0)
    k1 = law.curvature[0, before] + part * (law.curvature[0, before + 1] - law.curvature[0, before])
    k2 = law.curvature[1, before] + part * (law.curvature[1, before + 1] - law.curvature[1, before])
    return k1, k2


@inner
def _natural_of(k: Components, d: Vector, t: Vector) -> Vector:
    """Natural curvature K with the frame (d, t) [1/m]."""
    return axpy(k[0], d, scale(k[1], cross(t, d)))


@inner
def natural_vector(tether: Tether, law: NaturalCurvature, q: Array, i: int) -> Vector:
    """Natural curvature K of node i in the world [1/m]."""
    t, _ = unit(column(q, 3, i))
    return _natural_of(_components(tether, law, i), column(law.director, 0, i), t)


@inner
def mean_square(a: Components, b: Components) -> float:
    """Mean of k^2 along an element [1/m2]."""
    total = 0.0
    for k in range(2):
        total += (a[k] * a[k] + a[k] * b[k] + b[k] * b[k]) / 3.0
    return total


@inner
def _natural_square(tether: Tether, law: NaturalCurvature, e: int) -> float:
    """Mean of k^2 along element e, of both parts of the stiffness by their shares [1/m2]."""
    i, j = tether.elements - e, tether.elements - e - 1
    share = law.relaxation.share
    if share == 0.0:
        return mean_square(_components(tether, law, e), _components(tether, law, e + 1))
    elastic = mean_square(
        (law.elastic[0, i], law.elastic[1, i]), (law.elastic[0, j], law.elastic[1, j])
    )
    relaxed = mean_square(
        (law.relaxed[0, i], law.relaxed[1, i]), (law.relaxed[0, j], law.relaxed[1, j])
    )
    return (1.0 - share) * elastic + share * relaxed


@inner
def begin_natural_curvature(tether: Tether, q0: Array, law: NaturalCurvature) -> None:
    """Prepare a step from q0."""
    n = tether.elements
    for i in range(n + 1):
        set_column(law.natural, i, natural_vector(tether, law, q0, i))
    for e in range(n):
        bent, twisted = _element_energy(tether, q0, e, law)
        law.stored[e] = bent + twisted


@inner
def _element_energy(tether: Tether, q: Array, e: int, law: NaturalCurvature) -> tuple[float, float]:
    """Both terms of W of an element."""
    t_i, _ = unit(column(q, 3, e))
    t_j, _ = unit(column(q, 3, e + 1))
    law.twist[e] = element_twist(
        column(law.director, 0, e), column(law.director, 0, e + 1), t_i, t_j, law.twist[e]
    )
    stored = _bending_part(
        tether.bending_stiffness,
        t_i,
        t_j,
        natural_vector(tether, law, q, e),
        natural_vector(tether, law, q, e + 1),
    )
    return stored, 0.5 * law.torsion / tether.element_length * law.twist[e] ** 2


@inner
def _exit_energy(
    tether: Tether, q: Array, span: ExitSpan, law: NaturalCurvature
) -> tuple[float, float]:
    """Both terms of W of the exit element."""
    t_i, _ = unit(span.slope)
    t_j, _ = unit(column(q, 3, 0))
    d_i = guided_director(t_i)
    law.exit[0] = element_twist(d_i, column(law.director, 0, 0), t_i, t_j, law.exit[0])
    k_i = _natural_of(fairlead_curvature(tether, span.length, law), d_i, t_i)
    k_j = natural_vector(tether, law, q, 0)
    stored = _bending_part(tether.bending_stiffness, t_i, t_j, k_i, k_j)
    return stored, 0.5 * law.torsion / span.length * law.exit[0] ** 2


@inner
def twisting_energy(tether: Tether, q: Array, span: ExitSpan, law: NaturalCurvature) -> float:
    """W of all elements [J]."""
    total = 0.0
    for e in range(tether.elements):
        bent, twisted = _element_energy(tether, q, e, law)
        total += bent + twisted
    if span.length > 0.0:
        bent, twisted = _exit_energy(tether, q, span, law)
        total += bent + twisted
    return total


@inner
def natural_energies(
    tether: Tether, q: Array, span: ExitSpan, law: NaturalCurvature
) -> tuple[float, float]:
    """Energies of bending, beyond that of a straight tether, and of torsion [J].

    The natural state has the energy zero, where the relaxed curvature is the natural one.
    """
    bending, torsion = 0.0, 0.0
    for e in range(tether.elements):
        bent, twisted = _element_energy(tether, q, e, law)
        bending += bent
        torsion += twisted
        square = _natural_square(tether, law, e)
        bending += 0.5 * tether.bending_stiffness * tether.element_length * square
    if span.length > 0.0:
        bent, twisted = _exit_energy(tether, q, span, law)
        held = fairlead_curvature(tether, span.length, law)
        square = mean_square(held, _components(tether, law, 0))
        bending += bent + 0.5 * tether.bending_stiffness * span.length * square
        torsion += twisted
    return bending, torsion


@inner
def _perpendicular(f: Vector, t: Vector, shrink: float) -> Vector:
    """Gradient by a slope from the gradient f by its direction t."""
    return scale(shrink, axpy(-dot(f, t), t, f))


@inner
def _element_force(
    law: NaturalCurvature,
    stiffness: float,
    length: float,
    guided: bool,
    held: Components,
    slopes: tuple[Vector, Vector],
    increments: tuple[Vector, Vector],
    natural: tuple[Vector, Vector],
    directors: tuple[Vector, Vector],
    before: tuple[float, float],
) -> ElementForce:
    """Force of an element.

    Args:
        law: of the tether.
        stiffness: EI [N m2].
        length: [m].
        guided: whether a fairlead holds the first node's frame.
        held: natural curvature of the first node, used where a fairlead holds its frame.
        slopes: of the nodes at the step's start.
        increments: of the slopes.
        natural: K of the nodes at the step's start [1/m].
        directors: d1 there.
        before: psi [rad] and W [J] there.
    """
    a_i, a_j = slopes
    da_i, da_j = increments
    s_i, _ = unit(a_i)
    s_j, _ = unit(a_j)
    t_i, shrink_i = unit(axpy(0.5, da_i, a_i))
    t_j, shrink_j = unit(axpy(0.5, da_j, a_j))
    u_i, _ = unit(axpy(1.0, da_i, a_i))
    u_j, _ = unit(axpy(1.0, da_j, a_j))
    if guided:
        k_i = _natural_of(held, guided_director(t_i), t_i)
        m_i = _natural_of(held, guided_director(u_i), u_i)
        d_i = guided_director(u_i)
    else:
        k_i = carry_vector(natural[0], s_i, t_i)
        m_i = carry_vector(natural[0], s_i, u_i)
        d_i = carry_vector(directors[0], s_i, u_i)
    k_j = carry_vector(natural[1], s_j, t_j)
    c = dot(t_i, t_j)
    factor = (4.0 - c) / 3.0
    half = 0.5 * stiffness
    pull = half * (dot(t_j, k_i) - dot(t_i, k_j)) / 3.0
    f_i = axpy(half * factor, axpy(c, k_i, k_j), scale(pull, t_j))
    f_j = axpy(-half * factor, axpy(c, k_j, k_i), scale(pull, t_i))
    psi0, psi1 = before[0], before[0]
    moment = 0.0
    if law.torsion > 0.0:
        psi1 = element_twist(d_i, carry_vector(directors[1], s_j, u_j), u_i, u_j, psi0)
        b = scale(1.0 / (1.0 + max(c, -0.99)), cross(t_i, t_j))
        moment = law.torsion / length * 0.5 * (psi0 + psi1)
        f_i = axpy(moment, b, f_i)
        f_j = axpy(moment, b, f_j)
    if guided:
        hold = -half * factor * dot(t_j, cross(t_i, k_i)) - moment
        f_i = axpy(-hold / max(1.0 + dot(_DOWN, t_i), 0.01), cross(_DOWN, t_i), f_i)
    f_i = _perpendicular(f_i, t_i, shrink_i)
    f_j = _perpendicular(f_j, t_j, shrink_j)
    # the correction along the increment
    square = dot(da_i, da_i) + dot(da_j, da_j)
    if square > 1.0e-14:
        after = _bending_part(stiffness, u_i, u_j, m_i, carry_vector(natural[1], s_j, u_j))
        after += 0.5 * law.torsion / length * psi1**2
        missing = after - before[1] - dot(f_i, da_i) - dot(f_j, da_j)
        f_i = axpy(missing / square, da_i, f_i)
        f_j = axpy(missing / square, da_j, f_j)
    return ElementForce(f_i, f_j, t_i, t_j, k_i, k_j)


@inner
def natural_curvature_force(
    tether: Tether, q0: Array, e: int, work: Workspace, law: NaturalCurvature
) -> ElementForce:
    """Force of element e of the chain at the increment in `work`."""
    return _element_force(
        law,
        tether.bending_stiffness,
        tether.element_length,
        law.guided and e == 0,
        _components(tether, law, e),
        (column(q0, 3, e), column(q0, 3, e + 1)),
        (column(work.increment, 3, e), column(work.increment, 3, e + 1)),
        (column(law.natural, 0, e), column(law.natural, 0, e + 1)),
        (column(law.director, 0, e), column(law.director, 0, e + 1)),
        (law.twist[e], law.stored[e]),
    )


@inner
def add_natural_curvature(
    tether: Tether, q0: Array, work: Workspace, law: NaturalCurvature
) -> None:
    """Add the forces at the increment in `work` to the elements' residual and tangent.

    The tangent leaves out the derivatives of g, of the twist, of the guided frame and of the
    correction.
    """
    half = 0.25 * tether.bending_stiffness  # half of the increment is at mid-step
    blocks = work.blocks
    n = tether.elements
    for e in range(n):
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
    for r in range(3):
        blocks[n, 1, 6, 3 + r] += law.tip[r]


@inner
def _exit_slopes(rows: Array) -> tuple[Vector, Vector]:
    """Slopes at fairlead and first node in coordinates of the exit element, or their increments."""
    return (rows[1, 0], rows[1, 1], rows[1, 2]), (rows[3, 0], rows[3, 1], rows[3, 2])


@inner
def exit_energy_by_length(
    tether: Tether,
    lengths: tuple[float, float],
    start: Array,
    change: Array,
    twists: tuple[float, float],
    law: NaturalCurvature,
) -> float:
    """Change of the exit element's energy in a step by its length alone [J].

    What is paid out without twist shares that of the element. The forces of the step work with the
    mean length.

    Args:
        tether: constants.
        lengths: at the step's start and end [m].
        start: the element's coordinates at the step's start, slopes in rows 1 and 3.
        change: their increments.
        twists: psi at start and end [rad].
        law: of the tether.
    """
    middle = 0.5 * (lengths[0] + lengths[1])
    first = _components(tether, law, 0)
    before = fairlead_curvature(tether, lengths[0], law)
    held = fairlead_curvature(tether, middle, law)
    after = fairlead_curvature(tether, lengths[1], law)
    square = lengths[1] * mean_square(after, first) - lengths[0] * mean_square(before, first)
    energy = 0.5 * tether.bending_stiffness * square
    (s_i, s_j), (d_i, d_j) = _exit_slopes(start), _exit_slopes(change)
    ends = ((s_i, s_j), (axpy(1.0, d_i, s_i), axpy(1.0, d_j, s_j)))
    grown = (
        (held[0] - before[0], held[1] - before[1]),
        (after[0] - held[0], after[1] - held[1]),
    )
    for side in range(2):
        t_i, _ = unit(ends[side][0])
        t_j, _ = unit(ends[side][1])
        k_i = _natural_of(grown[side], guided_director(t_i), t_i)
        energy += _bending_part(tether.bending_stiffness, t_i, t_j, k_i, (0.0, 0.0, 0.0))
    torsion = twists[0] * twists[0] * (1.0 / middle - 1.0 / lengths[0])
    torsion += twists[1] * twists[1] * (1.0 / lengths[1] - 1.0 / middle)
    return energy + 0.5 * law.torsion * torsion


@inner
def add_exit_curvature(
    tether: Tether,
    length: float,
    start: Array,
    change: Array,
    law: NaturalCurvature,
    residual: Array,
    tangent: Array,
) -> None:
    """Add the force of the exit element, as `add_natural_curvature` those of the chain.

    Args:
        tether: constants.
        length: mean of the step [m].
        start: the element's coordinates at the step's start, slopes in rows 1 and 3.
        change: their increments.
        law: of the tether.
        residual: of the coordinates, added to.
        tangent: [i, j, c, d]: of residual[i, d] by change[j, c], added to.
    """
    natural, director = column(law.natural, 0, 0), column(law.director, 0, 0)
    held = fairlead_curvature(tether, length, law)
    slopes = _exit_slopes(start)
    s_i, _ = unit(slopes[0])
    s_j, _ = unit(slopes[1])
    stored = _bending_part(
        tether.bending_stiffness, s_i, s_j, _natural_of(held, guided_director(s_i), s_i), natural
    )
    f_i, f_j, t_i, t_j, k_i, k_j = _element_force(
        law,
        tether.bending_stiffness,
        length,
        True,
        held,
        slopes,
        _exit_slopes(change),
        (natural, natural),
        (director, director),
        (law.exit[0], stored + 0.5 * law.torsion / length * law.exit[0] ** 2),
    )
    factor = 0.25 * tether.bending_stiffness * (4.0 - dot(t_i, t_j)) / 3.0
    own_i, own_j = factor * dot(t_i, k_j), factor * dot(t_j, k_i)
    for r in range(3):
        residual[1, r] += f_i[r]
        residual[3, r] += f_j[r]
        tangent[1, 1, r, r] -= own_i
        tangent[3, 3, r, r] += own_j
        for c in range(3):
            tangent[1, 1, c, r] += factor * k_i[r] * t_j[c]
            tangent[3, 3, c, r] -= factor * k_j[r] * t_i[c]
            mixed = factor * (k_i[r] * t_i[c] - t_j[r] * k_j[c])
            tangent[1, 3, c, r] += mixed
            tangent[3, 1, r, c] += mixed
