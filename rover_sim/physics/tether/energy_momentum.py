"""Energy-momentum integration of an ANCF tether, in the plane and in space from one source.

One step of length h takes nodal coordinates q0 and rates v0 to q1 = q0 + D and v1 = 2 D/h - v0,
where the increment D solves

    M (2/h) (D/h - v0) + K_t (q0 + D/2) + Q_b + int N S'^T r'_m dx - Q_g = 0,
    N = EA (eps_0 + c r'_m . dr'),     c = (1 + x)/2 + tau_a/h.

r'_m is the slope at mid-step and dr' its increment: forces act at the midpoint, and because Green's
strain is quadratic eps_1 - eps_0 = r'_m . dr', so N holds the strain averaged over the step
(Simo and Tarnow 1992, ZAMP 43; for L2 cables the average makes the work of N equal to the change
of the axial energy exactly). With x = 0 and zero damping times the tether's energy is conserved to
the tolerance of the Newton iteration; `end_step` returns the energy that x, tau_a and tau_b
dissipate.

The mean force of an element in compression is bounded by the law of `buckling`: N gets the same
relief R at all points of the element, which depends on its mean strain only.

Q_b is the bending damping, EI tau_b/h int (dk . delta k) dx. With the slope a, its direction t and
b = r'', the curvature vector is k = P b/|a|, P = I - t t^T, of size |a x b|/|a|^2, and its change
seen from a frame that turns with the tether

    dk = P (db - (t.b/|a|) da)/|a| - k (t.da)/|a|,

all at mid-step. A rigid turn of a bent tether in its plane gives dk = 0 exactly and is not damped,
which would not hold for damping proportional to K_t. In space the frame does not rotate about t:
the cable has no torsion, and a bending direction that rotates in the cross-section is damped too.

The slope at a quadrature point depends on three vectors only, the element's chord (r2 - r1)/l and
its end slopes r1', r2' (the reduced basis). Forces and tangents are formed in these and then
distributed to the nodes, for 4 (plane) or 8 (space) elements at once by SIMD (module `simd`). The
modules of a support, a point mass or a rover add their own blocks at the tether's end nodes before
the elimination. The length of the gravity vector sets the number of directions `dim`; arrays are
laid out as in `tether`.
"""

from typing import Any, NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import checked_inner, inner
from rover_sim.physics.numerics.simd import (
    fill,
    lane,
    lane_count,
    larger,
    load,
    magnitude,
    root,
    stack,
    store,
    transpose,
)
from rover_sim.physics.tether.ancf import GAUSS_WEIGHTS, Array
from rover_sim.physics.tether.block_elimination import make_factor, solve_blocks
from rover_sim.physics.tether.buckling import NO_BUCKLING, mean_relief, released_in_step
from rover_sim.physics.tether.tether import (
    CURVATURES,
    GAUSS,
    SLOPES,
    Tether,
    bending_coefficients,
    element_product,
    linear_combination,
    mass_coefficients,
    nodal_values,
    row_width,
)


def _pair_products(functions: Array) -> Array:
    """Products of the functions k and l for kl = 00, 01, 02, 11, 12, 22, (6, 5)."""
    return np.stack([functions[:, k] * functions[:, m] for k in range(3) for m in range(k, 3)])


_PAIRS = _pair_products(SLOPES)
_CURVATURE_PAIRS = _pair_products(CURVATURES)
_MEAN_PAIRS = _PAIRS @ GAUSS_WEIGHTS  # int of the products over an element of unit length
_MEAN_PRODUCTS = np.ascontiguousarray((SLOPES.T * GAUSS_WEIGHTS) @ SLOPES)  # the same, (3, 3)


class Workspace(NamedTuple):
    """Work arrays of one integration, allocated once; their contents are valid for one step.

    A node has m = 2 dim coordinates; the end_ arrays have index 0 for the root and 1 for the tip;
    rows have `width` columns, one per element or node, padded to whole packets.
    """

    increment: Array  # D, (m, width)
    slope: Array  # r' at the step's start at the quadrature points, (5 dim, width)
    strain: Array  # eps there, (5, width)
    mean_strain: Array  # its mean over the element, (width,)
    start: Array  # reduced basis at the step's start, (3 dim, width)
    relief: Array  # R/EA in the step and its derivative, (2, width); where there is any
    curvature: Array  # r'' there, (5 dim, width); with bending damping only
    constant: Array  # part of the elements' residual independent of D, (2 m, width)
    end_fixed: Array  # nonzero where a coordinate of an end node is fixed, (2, m)
    end_mask: Array  # 0 where a coordinate of an end node is fixed, else 1, (2, lanes)
    blocks: Array  # the linear equations, see `block_elimination`
    factor: Array
    solution: Array  # Newton increment, node i at i + 1, (width + 2, lanes)
    tension: Array  # mean axial force of each element at mid-step [N], (width,)
    loss: Array  # energy dissipated by each element in the step [J], (width,)


def make_workspace(elements: int, dim: int) -> Workspace:
    """Allocate the arrays for a tether of n elements."""
    m = 2 * dim
    lanes = 4 if dim == 2 else 8
    width = row_width(elements, dim)
    return Workspace(
        np.zeros((m, width)),
        np.zeros((GAUSS * dim, width)),
        np.zeros((GAUSS, width)),
        np.zeros(width),
        np.zeros((3 * dim, width)),
        np.zeros((2, width)),
        np.zeros((GAUSS * dim, width)),
        np.zeros((2 * m, width)),
        np.zeros((2, m)),
        np.zeros((2, lanes)),
        np.zeros((width + 2, 2, 2 * m + 1, lanes)),
        make_factor(elements + 1, m + 1, lanes),
        np.zeros((width + 2, lanes)),
        np.zeros(width),
        np.zeros(width),
    )


@inner
def begin_step(tether: Tether, h: float, q0: Array, v0: Array, work: Workspace) -> None:
    """Prepare a step of length h from (q0, v0): all terms independent of the increment."""
    tag, dim, length = tether.gravity, len(tether.gravity), tether.element_length
    mass = mass_coefficients(tether)
    bending = bending_coefficients(tether)
    inverse = 1.0 / length
    rate = 2.0 / h
    basis = stack(tag, 9)
    lanes = lane_count(tag)
    for e in range(0, tether.elements, lanes):
        for d in range(dim):
            r1, s1, r2, s2 = nodal_values(tag, q0, d, e)
            elastic = element_product(bending, r1, s1, r2, s2)
            basis[3 * d] = (r2 - r1) * inverse
            basis[3 * d + 1] = s1
            basis[3 * d + 2] = s2
            r1, s1, r2, s2 = nodal_values(tag, v0, d, e)
            inertia = element_product(mass, r1, s1, r2, s2)
            load_half = 0.5 * tether.line_density * length * tether.gravity[d]
            load_slope = load_half * length / 6.0
            store(work.constant, (d, e), elastic[0] - rate * inertia[0] - load_half)
            store(work.constant, (dim + d, e), elastic[1] - rate * inertia[1] - load_slope)
            store(work.constant, (2 * dim + d, e), elastic[2] - rate * inertia[2] - load_half)
            store(work.constant, (3 * dim + d, e), elastic[3] - rate * inertia[3] + load_slope)
        for k in range(3 * dim):
            store(work.start, (k, e), basis[k])
        mean = fill(tag, 0.0)
        for g in range(GAUSS):
            square = fill(tag, -1.0)
            for d in range(dim):
                slope = (
                    SLOPES[g, 0] * basis[3 * d]
                    + SLOPES[g, 1] * basis[3 * d + 1]
                    + SLOPES[g, 2] * basis[3 * d + 2]
                )
                store(work.slope, (g * dim + d, e), slope)
                square += slope * slope
            store(work.strain, (g, e), 0.5 * square)
            mean += (0.5 * GAUSS_WEIGHTS[g]) * square
        store(work.mean_strain, (e,), mean)
        if tether.bending_damping_time > 0.0:
            for g in range(GAUSS):
                for d in range(dim):
                    curvature = (
                        CURVATURES[g, 0] * basis[3 * d]
                        + CURVATURES[g, 1] * basis[3 * d + 1]
                        + CURVATURES[g, 2] * basis[3 * d + 2]
                    )
                    store(work.curvature, (g * dim + d, e), curvature * inverse)


@inner
def _load_basis(tag: Any, inverse: float, e: int, work: Workspace, basis: Any) -> None:
    """Increments of (chord, r1', r2') of the elements from e on; direction d from 3 d on."""
    for d in range(len(tag)):
        r1, s1, r2, s2 = nodal_values(tag, work.increment, d, e)
        basis[3 * d] = (r2 - r1) * inverse
        basis[3 * d + 1] = s1
        basis[3 * d + 2] = s2


@inner
def _axial_points(
    tether: Tether, average: float, e: int, work: Workspace, basis: Any, force: Any, tensor: Any
) -> Any:
    """Axial force and tangent at the quadrature points of the elements from e on, without relief.

    force[g dim + d] = w l N r'_m and tensor[(g dim + d) dim + c] = w l (N/2 I + EA c r'_m r'_1^T),
    where `average` is the factor c of the module's docstring.

    Returns:
        Increment of the elements' mean strain.
    """
    tag = tether.gravity
    dim = len(tag)
    middles = stack(tag, 3)
    ends = stack(tag, 3)
    mean = fill(tag, 0.0)
    for g in range(GAUSS):
        stretch = fill(tag, 0.0)
        for d in range(dim):
            change = (
                SLOPES[g, 0] * basis[3 * d]
                + SLOPES[g, 1] * basis[3 * d + 1]
                + SLOPES[g, 2] * basis[3 * d + 2]
            )
            middle = load(tag, work.slope, (g * dim + d, e)) + 0.5 * change
            middles[d] = middle
            ends[d] = middle + 0.5 * change
            stretch += middle * change
        rigidity = GAUSS_WEIGHTS[g] * tether.element_length * tether.axial_stiffness
        tension = rigidity * (load(tag, work.strain, (g, e)) + average * stretch)
        mean += GAUSS_WEIGHTS[g] * stretch
        geometric = 0.5 * tension
        for d in range(dim):
            force[g * dim + d] = tension * middles[d]
            weighted = (rigidity * average) * middles[d]
            for c in range(dim):
                entry = weighted * ends[c]
                if c == d:
                    entry += geometric
                tensor[(g * dim + d) * dim + c] = entry
    return mean


@inner
def _is_compressed(tether: Tether, average: float, increment: Any, e: int, work: Workspace) -> bool:
    """Whether an element from e on is in compression in a part of the step; see `mean_relief`.

    `increment` is that of the mean strain.
    """
    if tether.buckling_strain >= NO_BUCKLING:
        return False
    for w in range(min(lane_count(tether.gravity), tether.elements - e)):
        change, strain = lane(increment, w), work.mean_strain[e + w]
        if min(strain, strain + change, strain + (average + 0.5) * change) < 0.0:
            return True
    return False


@inner
def _add_relief(
    tether: Tether, e: int, work: Workspace, basis: Any, force: Any, tangent: Any, rows: Any
) -> None:
    """Add the relief of the elements from e on to force and tangent in the reduced basis.

    Without the derivative of the relief, which `_store_columns` adds. For it rows[3 d + k] is
    the derivative of the mean strain at mid-step, rows[3 dim + 3 d + k] at the end.
    """
    tag = tether.gravity
    dim = len(tag)
    total = (tether.axial_stiffness * tether.element_length) * load(tag, work.relief, (0, e))
    for d in range(dim):
        for k in range(3):
            middle = fill(tag, 0.0)
            change = fill(tag, 0.0)
            for m in range(3):
                half = (0.5 * _MEAN_PRODUCTS[k, m]) * basis[3 * d + m]
                middle += _MEAN_PRODUCTS[k, m] * load(tag, work.start, (3 * d + m, e)) + half
                change += half
            rows[3 * d + k] = middle
            rows[3 * dim + 3 * d + k] = middle + change
            force[3 * d + k] = force[3 * d + k] + total * middle
        for pair in range(6):
            index = (pair * dim + d) * dim + d
            tangent[index] = tangent[index] + (0.5 * _MEAN_PAIRS[pair]) * total


@inner
def _nodal_columns(tag: Any, inverse: float, rows: Any, start: int, target: Any) -> None:
    """Derivatives by the reduced basis, from `start` on, as those by first and second node."""
    dim = len(tag)
    for d in range(dim):
        chord = inverse * rows[start + 3 * d]
        target[d] = fill(tag, 0.0) - chord
        target[dim + d] = rows[start + 3 * d + 1]
        target[8 + d] = chord
        target[8 + dim + d] = rows[start + 3 * d + 2]


@inner
def _relief_slope(
    tether: Tether, e: int, work: Workspace, rows: Any, middle: Any, end: Any
) -> None:
    """Factors of the derivative of the relief in the blocks of the elements from e on.

    It is EA l R' times the product of the mean strain's derivatives at mid-step, `middle`, which
    here contains the factor, and at the step's end, `end`: by the first node's coordinates from 0
    on and by the second's from 8 on.
    """
    tag = tether.gravity
    dim = len(tag)
    inverse = 1.0 / tether.element_length
    _nodal_columns(tag, inverse, rows, 0, middle)
    _nodal_columns(tag, inverse, rows, 3 * dim, end)
    slope = (tether.axial_stiffness * tether.element_length) * load(tag, work.relief, (1, e))
    for k in range(2 * dim):
        middle[k] = slope * middle[k]
        middle[8 + k] = slope * middle[8 + k]


@inner
def _curvature_change(
    tether: Tether, e: int, g: int, work: Workspace, basis: Any, bend: Any
) -> tuple[Any, Any, Any, Any]:
    """Bending at quadrature point g of the elements from e on during the step, for the damping.

    Writes to `bend` the direction t, from index dim on the curvature vector k and from 2 dim on
    its change dk. Returns 1/|a|, t . b / |a|, k . dk and dk . dk at mid-step.
    """
    tag = tether.gravity
    dim = len(tag)
    inverse = 1.0 / tether.element_length
    square = fill(tag, 0.0)
    along = fill(tag, 0.0)
    stretch = fill(tag, 0.0)
    for d in range(dim):
        first, second, third = basis[3 * d], basis[3 * d + 1], basis[3 * d + 2]
        da = SLOPES[g, 0] * first + SLOPES[g, 1] * second + SLOPES[g, 2] * third
        db = CURVATURES[g, 0] * first + CURVATURES[g, 1] * second + CURVATURES[g, 2] * third
        db *= inverse
        a = load(tag, work.slope, (g * dim + d, e)) + 0.5 * da
        b = load(tag, work.curvature, (g * dim + d, e)) + 0.5 * db
        bend[d] = a
        bend[dim + d] = b
        bend[2 * dim + d] = da
        bend[3 * dim + d] = db
        square += a * a
        along += a * b
        stretch += a * da
    shrink = 1.0 / root(square)
    along *= shrink * shrink
    stretch *= shrink
    drift = fill(tag, 0.0)
    for d in range(dim):
        t = bend[d] * shrink
        db = bend[3 * dim + d] - along * bend[2 * dim + d]
        bend[dim + d] = (bend[dim + d] * shrink) - along * t
        bend[2 * dim + d] = db
        bend[d] = t
        drift += t * db
    cross = fill(tag, 0.0)
    change = fill(tag, 0.0)
    for d in range(dim):
        dk = (bend[2 * dim + d] - drift * bend[d] - bend[dim + d] * stretch) * shrink
        bend[2 * dim + d] = dk
        cross += bend[dim + d] * dk
        change += dk * dk
    return shrink, along, cross, change


@inner
def _add_bending_damping(
    tether: Tether, h: float, e: int, work: Workspace, basis: Any, force: Any, tangent: Any
) -> None:
    """Add the bending damping of the elements from e on to force and tangent.

    Both in the reduced basis: force[3 d + k] and tangent[(pair dim + d) dim + c]. The tangent keeps
    only the contribution of the second derivatives, P/|a|^2; the other terms are smaller by the
    bending angle of an element and act along the tether, where the axial stiffness dominates.
    """
    tag = tether.gravity
    dim = len(tag)
    length = tether.element_length
    bend = stack(tag, 12)
    points = stack(tag, 45)
    for g in range(GAUSS):
        shrink, along, cross, _ = _curvature_change(tether, e, g, work, basis, bend)
        viscosity = (
            GAUSS_WEIGHTS[g] * length * tether.bending_stiffness * tether.bending_damping_time
        )
        weight = (viscosity / h) * shrink
        squared = weight * shrink * (1.0 / length**2)
        for d in range(dim):
            dk = bend[2 * dim + d]
            on_slope = fill(tag, 0.0) - weight * (dk * along + bend[d] * cross)
            on_curvature = weight * dk * (1.0 / length)
            for k in range(3):
                force[3 * d + k] = (
                    force[3 * d + k] + SLOPES[g, k] * on_slope + CURVATURES[g, k] * on_curvature
                )
            for c in range(d + 1):  # P is symmetric
                projector = fill(tag, 1.0 if c == d else 0.0) - bend[d] * bend[c]
                points[(g * dim + d) * dim + c] = squared * projector
    for d in range(dim):
        for c in range(d + 1):
            for pair in range(6):
                total = fill(tag, 0.0)
                for g in range(GAUSS):
                    total += _CURVATURE_PAIRS[pair, g] * points[(g * dim + d) * dim + c]
                index = (pair * dim + d) * dim + c
                tangent[index] = tangent[index] + total
                if c < d:
                    index = (pair * dim + c) * dim + d
                    tangent[index] = tangent[index] + total


@inner
def assemble(tether: Tether, h: float, work: Workspace) -> None:
    """Write tangent and residual of all elements to work.blocks; ends and contact add later."""
    tag = tether.gravity
    dim = len(tag)
    inverse = 1.0 / tether.element_length
    average = 0.5 * (1.0 + tether.numerical_damping) + tether.axial_damping_time / h
    linear = linear_combination(
        2.0 / h**2, mass_coefficients(tether), 0.5, bending_coefficients(tether)
    )
    basis = stack(tag, 9)
    points_force = stack(tag, 15)
    points_tensor = stack(tag, 45)
    force = stack(tag, 9)
    tangent = stack(tag, 54)
    rows = stack(tag, 18)
    middle = stack(tag, 16)
    end = stack(tag, 16)
    lanes = lane_count(tag)
    for e in range(0, tether.elements, lanes):
        _load_basis(tag, inverse, e, work, basis)
        increment = _axial_points(tether, average, e, work, basis, points_force, points_tensor)
        for d in range(dim):
            for k in range(3):
                total = fill(tag, 0.0)
                for g in range(GAUSS):
                    total += SLOPES[g, k] * points_force[g * dim + d]
                force[3 * d + k] = total
            for c in range(dim):
                for pair in range(6):
                    total = fill(tag, 0.0)
                    for g in range(GAUSS):
                        total += _PAIRS[pair, g] * points_tensor[(g * dim + d) * dim + c]
                    tangent[(pair * dim + d) * dim + c] = total
        if tether.bending_damping_time > 0.0:
            _add_bending_damping(tether, h, e, work, basis, force, tangent)
        relieved = _is_compressed(tether, average, increment, e, work)
        if relieved:
            relief, relief_slope = mean_relief(
                tag, load(tag, work.mean_strain, (e,)), increment, average - 0.5,
                tether.buckling_strain,
            )  # fmt: skip
            store(work.relief, (0, e), relief)
            store(work.relief, (1, e), relief_slope)
            _add_relief(tether, e, work, basis, force, tangent, rows)
            _relief_slope(tether, e, work, rows, middle, end)
        # chord = (r2 - r1) / l
        for entry in range(dim * dim):
            tangent[entry] = tangent[entry] * (inverse * inverse)
        for entry in range(dim * dim, 3 * dim * dim):
            tangent[entry] = tangent[entry] * inverse
        _store_tangent(tag, linear, e, tangent, relieved, middle, end, work.blocks)
        _store_residual(tag, linear, inverse, e, force, work)


@inner
def _store_tangent(
    tag: Any,
    linear: tuple[float, ...],
    e: int,
    tangent: Any,
    relieved: bool,
    middle: Any,
    end: Any,
    blocks: Array,
) -> None:
    """Distribute the tangents of the elements from e on to their nodes' blocks.

    A node's rows and columns are its position and its slope. Of the pairs 00, 01, 02, 11, 12, 22 of
    (chord, r1', r2'), where chord means r2 - r1, each column takes one pair for its position rows
    and one for its slope rows, with a sign, and adds the part linear in D. If elements are
    relieved, the product of `middle` and `end` is added (`_relief_slope`).
    """
    dim = len(tag)
    couple = 2 * dim + 1
    c = linear
    relief = (relieved, middle, end)
    # first node: D, then U towards the second
    _store_columns(tag, e, 0, 0, 0, 1.0, c[0], 1, -1.0, c[1], tangent, relief, blocks)
    _store_columns(tag, e, 0, dim, 1, -1.0, c[1], 3, 1.0, c[2], tangent, relief, blocks)
    _store_columns(tag, e, 0, couple, 0, -1.0, c[3], 1, 1.0, -c[4], tangent, relief, blocks)
    _store_columns(tag, e, 0, couple + dim, 2, -1.0, c[4], 4, 1.0, c[5], tangent, relief, blocks)
    # second node: D, then L towards the first
    _store_columns(tag, e, 1, 0, 0, 1.0, c[0], 2, 1.0, -c[1], tangent, relief, blocks)
    _store_columns(tag, e, 1, dim, 2, 1.0, -c[1], 5, 1.0, c[2], tangent, relief, blocks)
    _store_columns(tag, e, 1, couple, 0, -1.0, c[3], 2, -1.0, c[4], tangent, relief, blocks)
    _store_columns(tag, e, 1, couple + dim, 1, 1.0, -c[4], 4, 1.0, c[5], tangent, relief, blocks)


@inner
def _store_columns(
    tag: Any,
    e: int,
    side: int,
    column: int,
    position_pair: int,
    position_sign: float,
    position_linear: float,
    slope_pair: int,
    slope_sign: float,
    slope_linear: float,
    tangent: Any,
    relief: tuple[bool, Any, Any],
    blocks: Array,
) -> None:
    """Write dim columns of a side; pair, sign and linear part for position and slope rows."""
    dim = len(tag)
    lanes = lane_count(tag)
    relieved, middle, end = relief
    couple = 2 * dim + 1
    other = 8 * side + column if column < couple else 8 * (1 - side) + column - couple
    rows = stack(tag, 8)
    for c in range(dim):
        for d in range(dim):
            position = position_sign * tangent[(position_pair * dim + d) * dim + c]
            slope = slope_sign * tangent[(slope_pair * dim + d) * dim + c]
            if c == d:
                position += position_linear
                slope += slope_linear
            rows[d] = position
            rows[dim + d] = slope
        if relieved:
            for r in range(2 * dim):
                rows[r] = rows[r] + middle[8 * side + r] * end[other + c]
        for surplus in range(2 * dim, lanes):
            rows[surplus] = fill(tag, 0.0)
        transpose(rows, 0)
        for w in range(lanes):
            store(blocks, (e + 1 + w, side, column + c, 0), rows[w])


@inner
def _store_residual(
    tag: Any, linear: tuple[float, ...], inverse: float, e: int, force: Any, work: Workspace
) -> None:
    """Distribute the residuals of the elements from e on to their nodes' blocks."""
    dim = len(tag)
    m = 2 * dim
    lanes = lane_count(tag)
    first = stack(tag, 8)
    second = stack(tag, 8)
    for d in range(dim):
        r1, s1, r2, s2 = nodal_values(tag, work.increment, d, e)
        parts = element_product(linear, r1, s1, r2, s2)
        chord = force[3 * d] * inverse
        constant = work.constant
        first[d] = load(tag, constant, (d, e)) + parts[0] - chord
        first[dim + d] = load(tag, constant, (dim + d, e)) + parts[1] + force[3 * d + 1]
        second[d] = load(tag, constant, (m + d, e)) + parts[2] + chord
        second[dim + d] = load(tag, constant, (m + dim + d, e)) + parts[3] + force[3 * d + 2]
    for surplus in range(m, lanes):
        first[surplus] = fill(tag, 0.0)
        second[surplus] = fill(tag, 0.0)
    transpose(first, 0)
    transpose(second, 0)
    for w in range(lanes):
        store(work.blocks, (e + 1 + w, 0, m, 0), first[w])
        store(work.blocks, (e + 1 + w, 1, m, 0), second[w])


@inner
def begin_ends(tether: Tether, work: Workspace) -> None:
    """Clear the blocks of the end nodes and fix the coordinates marked in work.end_fixed.

    The equation of a fixed coordinate becomes "increment = 0": the end's own block gets the 1, and
    `_mask_ends` removes the element's contribution. Entries beyond the tip that a longer tether
    left in the work arrays are cleared too.
    """
    m = 2 * len(tether.gravity)
    after = tether.elements + 2
    work.factor[after] = 0.0
    work.solution[after : min(after + work.solution.shape[1], work.solution.shape[0])] = 0.0
    for end in range(2):
        for c in range(2 * m + 1):
            for r in range(m):
                set_end(work, end, c, r, 0.0)
        for r in range(m):
            fixed = work.end_fixed[end, r] != 0.0
            work.end_mask[end, r] = 0.0 if fixed else 1.0
            if fixed:
                set_end(work, end, r, r, 1.0)


@inner
def set_end(work: Workspace, end: int, column: int, row: int, value: float) -> None:
    """Set an entry that the root (end 0) or tip (end 1) adds to its node's equations.

    Columns 0 to m - 1 are the tangent, column m is the residual.
    """
    if end == 0:
        work.blocks[0, 1, column, row] = value
    else:
        work.blocks[work.blocks.shape[0] - 1, 0, column, row] = value


@inner
def _mask_ends(tether: Tether, work: Workspace) -> None:
    """Clear the rows of fixed coordinates in the blocks of the first and the last element."""
    tag = tether.gravity
    for end in range(2):
        mask = load(tag, work.end_mask, (end, 0))
        element = 1 if end == 0 else tether.elements
        for c in range(4 * len(tag) + 1):
            column = load(tag, work.blocks, (element, end, c, 0))
            store(work.blocks, (element, end, c, 0), column * mask)


@inner
def _apply_solution(tether: Tether, work: Workspace) -> tuple[float, float]:
    """Subtract the solution from the increment.

    Returns:
        Largest magnitude of the solution's entries, and the sum of all magnitudes [m]; slopes are
        multiplied by the element's length. The maximum may drop a NaN, the sum never does.
    """
    tag = tether.gravity
    dim = len(tag)
    lanes = lane_count(tag)
    changes = stack(tag, 8)
    largest = fill(tag, 0.0)
    total = fill(tag, 0.0)
    for i in range(0, tether.elements + 1, lanes):
        for w in range(lanes):
            changes[w] = load(tag, work.solution, (i + 1 + w, 0))
        transpose(changes, 0)
        for k in range(2 * dim):
            change = changes[k]
            store(work.increment, (k, i), load(tag, work.increment, (k, i)) - change)
            size = (1.0 if k < dim else tether.element_length) * magnitude(change)
            largest = larger(largest, size)
            total += size
    greatest = 0.0
    magnitudes = 0.0
    for w in range(lanes):
        greatest = max(greatest, lane(largest, w))
        magnitudes += lane(total, w)
    return greatest, magnitudes


@checked_inner
def solve_increment(tether: Tether, work: Workspace) -> float:
    """Solve the equations in work.blocks and apply the Newton increment to work.increment.

    work.solution holds the increment. Returns its largest magnitude [m], slopes multiplied by the
    element's length; NaN if any entry is not finite.
    """
    _mask_ends(tether, work)
    solve_blocks(tether.gravity, tether.elements, work.blocks, work.factor, work.solution)
    largest, total = _apply_solution(tether, work)
    return largest if np.isfinite(total) else np.nan


@checked_inner
def newton_increment(tether: Tether, h: float, work: Workspace) -> float:
    """Assemble, solve and apply one Newton increment; see `solve_increment`."""
    assemble(tether, h, work)
    return float(solve_increment(tether, work))


@inner
def largest_turn(tether: Tether, work: Workspace) -> float:
    """Largest change of a node's slope in the increment [-]; NaN becomes infinite.

    It is about the node's rotation in the step [rad] at small strain.
    """
    dim = len(tether.gravity)
    turn = 0.0
    for i in range(tether.elements + 1):
        square = 0.0
        for d in range(dim):
            square += work.increment[dim + d, i] ** 2
        if not square <= turn:
            turn = square if square < np.inf else np.inf
    return np.sqrt(turn)


@inner
def end_step(
    tether: Tether, h: float, q0: Array, v0: Array, work: Workspace, q1: Array, v1: Array
) -> tuple[float, float]:
    """Write the state after the step from the converged increment; element tensions to `work`.

    The state after the step may replace that before it.

    Returns:
        Energy that the tether dissipated in the step [J]; and its largest tension [N], the mean of
        N |r'| over an element at mid-step, damping included.
    """
    tag, dim, n = tether.gravity, len(tether.gravity), tether.elements
    length, increment = tether.element_length, work.increment
    lanes = lane_count(tag)
    for k in range(2 * dim):
        for i in range(0, n + 1, lanes):
            change = load(tag, increment, (k, i))
            store(q1, (k, i), load(tag, q0, (k, i)) + change)
            store(v1, (k, i), (2.0 / h) * change - load(tag, v0, (k, i)))
    damping = 0.5 * tether.numerical_damping + tether.axial_damping_time / h
    basis = stack(tag, 9)
    bend = stack(tag, 12)
    for e in range(0, n, lanes):
        _load_basis(tag, 1.0 / length, e, work, basis)
        mean = fill(tag, 0.0)
        loss = fill(tag, 0.0)
        total = fill(tag, 0.0)
        arc = fill(tag, 0.0)
        for g in range(GAUSS):
            stretch = fill(tag, 0.0)
            square = fill(tag, 0.0)
            for d in range(dim):
                change = (
                    SLOPES[g, 0] * basis[3 * d]
                    + SLOPES[g, 1] * basis[3 * d + 1]
                    + SLOPES[g, 2] * basis[3 * d + 2]
                )
                middle = load(tag, work.slope, (g * dim + d, e)) + 0.5 * change
                stretch += middle * change
                square += middle * middle
            strain = load(tag, work.strain, (g, e)) + (0.5 + damping) * stretch
            slope = root(square)
            mean += GAUSS_WEIGHTS[g] * strain * slope
            loss += GAUSS_WEIGHTS[g] * stretch * stretch
            total += GAUSS_WEIGHTS[g] * stretch
            arc += GAUSS_WEIGHTS[g] * slope
        loss *= damping * tether.axial_stiffness * length
        if tether.bending_damping_time > 0.0:
            viscosity = tether.bending_stiffness * tether.bending_damping_time / h * length
            for g in range(GAUSS):
                _, _, _, change = _curvature_change(tether, e, g, work, basis, bend)
                loss += (viscosity * GAUSS_WEIGHTS[g]) * change
        if _is_compressed(tether, 0.5 + damping, total, e, work):
            before, limit = load(tag, work.mean_strain, (e,)), tether.buckling_strain
            relief, _ = mean_relief(tag, before, total, damping, limit)
            mean += relief * arc
            rest = relief * total - released_in_step(tag, before, total, limit)
            loss += (tether.axial_stiffness * length) * rest
        store(work.tension, (e,), tether.axial_stiffness * mean)
        store(work.loss, (e,), loss)
    peak = -np.inf
    dissipated = 0.0
    for e in range(n):
        dissipated += work.loss[e]
        peak = max(peak, work.tension[e])
    return dissipated, peak
