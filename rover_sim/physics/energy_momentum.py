"""Energy-momentum integration of an ANCF tether, in the plane and in space from one source.

One step of length h takes nodal coordinates q0 and rates v0 to q1 = q0 + D and v1 = 2 D/h - v0,
where the increment D solves

    M (2/h) (D/h - v0) + K_t (q0 + D/2) + Q_b + int N S'^T r'_m dx - Q_g = 0,
    N = EA (eps_0 + c r'_m . dr'),     c = (1 + x)/2 + tau_a/h.

r'_m is the slope at mid-step and dr' its increment: forces act at the midpoint, and because Green's
strain is quadratic eps_1 - eps_0 = r'_m . dr', so N holds the strain averaged over the step
(Simo and Tarnow 1992, ZAMP 43; for L2 cables the average makes the work of N equal to the change
of the axial energy exactly). With x = 0 and no damping times the tether's energy is conserved to
the tolerance of the Newton iteration; what x, tau_a and tau_b take away is returned by each step.

Q_b is the bending damping, EI tau_b/h int (dk . delta k) dx. With the slope a, its direction t and
b = r'', the curvature vector is k = P b/|a|, P = I - t t^T, of size |a x b|/|a|^2, and its change
seen from a frame that turns with the tether

    dk = P (db - (t.b/|a|) da)/|a| - k (t.da)/|a|,

all at mid-step. A rigid turn of a bent tether in its plane gives dk = 0 exactly and is not damped,
which would not hold for damping proportional to K_t. In space the frame does not spin about t: the
cable has no torsion, and bending that wanders round its cross-section is damped like any other.

The slope at a quadrature point depends on three vectors only, the element's chord (r2 - r1)/l and
its end slopes r1', r2', so forces and tangents are formed in these and then spread to the nodes.
The Newton increments come from a block-tridiagonal elimination, one block a node, fused with the
assembly. What sits at the tether's two ends (a support, a mass, a rover) adds its own block there
before the elimination; this module knows nothing more of it.

The number of directions is that of the gravity vector, a tuple, and hence known to the compiler.
Arrays: coordinates and rates (n + 1, 2 dim), a row being (r, r') of a node.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rover_sim.physics import ancf
from rover_sim.physics.section import TetherSection

Array = NDArray[np.float64]

# Without nnan and ninf: a diverging iteration must show its NaN to the tests that look for it.
FAST_MATH = frozenset({"contract", "reassoc", "nsz", "arcp", "afn"})

kernel: Any = njit(cache=True, nogil=True, error_model="numpy", fastmath=set(FAST_MATH))
checked: Any = njit(cache=True, nogil=True, error_model="numpy")

_WEIGHTS = ancf.GAUSS_WEIGHTS
_GAUSS = len(_WEIGHTS)

# Slope at a quadrature point from the reduced basis: r' = sum_k BASIS[g, k] (chord, r1', r2')_k,
# and the products BASIS[g, k] BASIS[g, l] of the pairs kl = 00, 01, 02, 11, 12, 22.
_BASIS = np.ascontiguousarray(ancf.slope_functions(ancf.GAUSS_POINTS, 1.0)[:, [2, 1, 3]])
# r'' from the same basis is sum_k CURVING[g, k] (chord, r1', r2')_k / l.
_CURVING = np.ascontiguousarray(ancf.curvature_functions(ancf.GAUSS_POINTS, 1.0)[:, [2, 1, 3]])
_CURVING_PAIRS = np.stack(
    [_CURVING[:, k] * _CURVING[:, m] for k in range(3) for m in range(k, 3)], axis=1
)
_PAIRS = np.stack([_BASIS[:, k] * _BASIS[:, m] for k in range(3) for m in range(k, 3)], axis=1)


class Tether(NamedTuple):
    """A uniform tether as the compiled functions see it; `gravity` gives the dimension."""

    element_length: float  # l [m]
    axial_stiffness: float  # EA [N]
    bending_stiffness: float  # EI [N m^2]
    line_density: float  # rho A [kg/m]
    axial_damping_time: float  # tau_a [s]
    bending_damping_time: float  # tau_b [s]
    numerical_damping: float  # x [-]
    gravity: tuple[float, ...]  # [m/s^2]


class Workspace(NamedTuple):
    """Arrays of one integration, allocated once; what they hold is valid for one step.

    With m = 2 dim coordinates a node and index 0 / 1 for root / tip in the end_ arrays.
    """

    increment: Array  # D, (n + 1, m)
    slope: Array  # r' at the step's start at the quadrature points, (n, 5, dim)
    strain: Array  # eps there, (n, 5)
    curving: Array  # r'' there, (n, 5, dim); with bending damping only
    constant: Array  # the part of the residual that does not change with D, (n + 1, m)
    end_fixed: NDArray[np.bool_]  # which coordinates of an end are held, (2, m)
    end_matrix: Array  # what an end adds to the tangent, (2, m, m)
    end_residual: Array  # and to the residual, (2, m)
    factor: Array  # of the elimination: D_i^-1 U_i, (n + 1, m, m)
    solution: Array  # D_i^-1 R_i, then the Newton increment, (n + 1, m)
    force: Array  # axial force of an element in the reduced basis, (3, dim)
    tangent: Array  # its tangent for the pairs kl, (6, dim, dim)
    tensor: Array  # the same at the quadrature points, (5, dim, dim)
    bend: Array  # t, k, dk and one more of a quadrature point, see _curvature_change, (4, dim)
    element: Array  # tangent and residual of an element, (2 m, 2 m + 1)
    pivot: Array  # rows (D_i | U_i | R_i) of the node being eliminated, (m, 2 m + 1)
    tension: Array  # mean axial force of each element at mid-step [N], (n,)


def make_tether(
    section: TetherSection,
    element_length: float,
    gravity: tuple[float, ...],
    numerical_damping: float = 0.0,
) -> Tether:
    """Collect what the compiled functions need, as plain floats.

    Args:
        section: cross-section.
        element_length: undeformed length of each element [m].
        gravity: gravity vector [m/s^2]; two or three components choose the dimension.
        numerical_damping: x in [0, 1]; 0 conserves energy.
    """
    return Tether(
        float(element_length),
        float(section.axial_stiffness),
        float(section.bending_stiffness),
        float(section.line_density),
        float(section.axial_damping_time),
        float(section.bending_damping_time),
        float(numerical_damping),
        tuple(float(component) for component in gravity),
    )


@checked
def make_workspace(elements: int, dim: int) -> Workspace:
    """Allocate the arrays for a tether of n elements."""
    m = 2 * dim
    return Workspace(
        np.zeros((elements + 1, m)),
        np.zeros((elements, _GAUSS, dim)),
        np.zeros((elements, _GAUSS)),
        np.zeros((elements, _GAUSS, dim)),
        np.zeros((elements + 1, m)),
        np.zeros((2, m), dtype=np.bool_),
        np.zeros((2, m, m)),
        np.zeros((2, m)),
        np.zeros((elements + 1, m, m)),
        np.zeros((elements + 1, m)),
        np.zeros((3, dim)),
        np.zeros((6, dim, dim)),
        np.zeros((_GAUSS, dim, dim)),
        np.zeros((4, dim)),
        np.zeros((2 * m, 2 * m + 1)),
        np.zeros((m, 2 * m + 1)),
        np.zeros(elements),
    )


@kernel
def mass_coefficients(tether: Tether) -> tuple[float, ...]:
    """Entries (0,0), (0,1), (1,1), (0,2), (0,3), (1,3) of the element's mass matrix.

    The rest follows from symmetry: (2,2) = (0,0), (3,3) = (1,1), (2,3) = -(0,1), (1,2) = -(0,3).
    """
    length = tether.element_length
    unit = tether.line_density * length / 420.0
    return (
        156.0 * unit,
        22.0 * unit * length,
        4.0 * unit * length**2,
        54.0 * unit,
        -13.0 * unit * length,
        -3.0 * unit * length**2,
    )


@kernel
def bending_coefficients(tether: Tether) -> tuple[float, ...]:
    """The same entries of the bending matrix K_t, which has the same symmetries."""
    length = tether.element_length
    unit = tether.bending_stiffness / length**3
    return (
        12.0 * unit,
        6.0 * unit * length,
        4.0 * unit * length**2,
        -12.0 * unit,
        6.0 * unit * length,
        2.0 * unit * length**2,
    )


@kernel
def _combine(a: float, x: tuple[float, ...], b: float, y: tuple[float, ...]) -> tuple[float, ...]:
    """A x + b y for two sets of six coefficients."""
    return (
        a * x[0] + b * y[0],
        a * x[1] + b * y[1],
        a * x[2] + b * y[2],
        a * x[3] + b * y[3],
        a * x[4] + b * y[4],
        a * x[5] + b * y[5],
    )


@kernel
def _apply(
    c: tuple[float, ...], r1: float, s1: float, r2: float, s2: float
) -> tuple[float, float, float, float]:
    """Product of the element matrix with coefficients c and (r1, r1', r2, r2') of a direction."""
    return (
        c[0] * r1 + c[1] * s1 + c[3] * r2 + c[4] * s2,
        c[1] * r1 + c[2] * s1 - c[4] * r2 + c[5] * s2,
        c[3] * r1 - c[4] * s1 + c[0] * r2 - c[1] * s2,
        c[4] * r1 + c[5] * s1 - c[1] * r2 + c[2] * s2,
    )


@kernel
def begin_step(tether: Tether, h: float, q0: Array, v0: Array, work: Workspace) -> None:
    """Prepare a step of length h from (q0, v0): everything that the increment does not change."""
    dim = len(tether.gravity)
    n = q0.shape[0] - 1
    length = tether.element_length
    mass = mass_coefficients(tether)
    bending = bending_coefficients(tether)
    weight = tether.line_density * length
    constant = work.constant
    constant[:] = 0.0
    for e in range(n):
        for d in range(dim):
            inertia = _apply(mass, v0[e, d], v0[e, dim + d], v0[e + 1, d], v0[e + 1, dim + d])
            elastic = _apply(bending, q0[e, d], q0[e, dim + d], q0[e + 1, d], q0[e + 1, dim + d])
            load = weight * tether.gravity[d]
            constant[e, d] += elastic[0] - 2.0 / h * inertia[0] - 0.5 * load
            constant[e, dim + d] += elastic[1] - 2.0 / h * inertia[1] - load * length / 12.0
            constant[e + 1, d] += elastic[2] - 2.0 / h * inertia[2] - 0.5 * load
            constant[e + 1, dim + d] += elastic[3] - 2.0 / h * inertia[3] + load * length / 12.0
        for g in range(_GAUSS):
            square = 0.0
            for d in range(dim):
                slope = (
                    _BASIS[g, 0] * (q0[e + 1, d] - q0[e, d]) / length
                    + _BASIS[g, 1] * q0[e, dim + d]
                    + _BASIS[g, 2] * q0[e + 1, dim + d]
                )
                work.slope[e, g, d] = slope
                square += slope * slope
            work.strain[e, g] = 0.5 * (square - 1.0)
            if tether.bending_damping_time > 0.0:
                for d in range(dim):
                    work.curving[e, g, d] = (
                        _CURVING[g, 0] * (q0[e + 1, d] - q0[e, d]) / length
                        + _CURVING[g, 1] * q0[e, dim + d]
                        + _CURVING[g, 2] * q0[e + 1, dim + d]
                    ) / length


@kernel
def _axial_element(tether: Tether, average: float, e: int, work: Workspace) -> None:
    """Axial force and tangent of element e in the reduced basis (chord, r1', r2').

    force_k = sum_g w l N BASIS_k r'_m,
    tangent_kl = sum_g w l BASIS_k BASIS_l (N/2 I + EA c r'_m r'_1^T), with c = `average`.
    """
    dim = len(tether.gravity)
    length = tether.element_length
    increment = work.increment
    work.force[:] = 0.0
    work.tangent[:] = 0.0
    for g in range(_GAUSS):
        stretch = 0.0
        for d in range(dim):
            change = (
                _BASIS[g, 0] * (increment[e + 1, d] - increment[e, d]) / length
                + _BASIS[g, 1] * increment[e, dim + d]
                + _BASIS[g, 2] * increment[e + 1, dim + d]
            )
            middle = work.slope[e, g, d] + 0.5 * change
            work.tensor[g, 0, d] = middle
            work.tensor[g, 1, d] = middle + 0.5 * change
            stretch += middle * change
        weight = _WEIGHTS[g] * length
        rigidity = weight * tether.axial_stiffness
        tension = rigidity * (work.strain[e, g] + average * stretch)
        for d in range(dim):
            middle = work.tensor[g, 0, d]
            for k in range(3):
                work.force[k, d] += _BASIS[g, k] * tension * middle
            for c in range(dim):
                entry = rigidity * average * middle * work.tensor[g, 1, c]
                if c == d:
                    entry += 0.5 * tension
                for k in range(6):
                    work.tangent[k, d, c] += _PAIRS[g, k] * entry


@kernel
def _curvature_change(
    tether: Tether, e: int, g: int, work: Workspace
) -> tuple[float, float, float, float]:
    """Bending at quadrature point g of element e during the step, for the damping.

    Writes to work.bend the direction t, the curvature vector k and its change dk. Returns |a|,
    t . b, k . dk and dk . dk at mid-step.
    """
    dim = len(tether.gravity)
    inverse = 1.0 / tether.element_length
    increment, bend = work.increment, work.bend
    square, along, drift, stretch = 0.0, 0.0, 0.0, 0.0
    for d in range(dim):
        chord = (increment[e + 1, d] - increment[e, d]) * inverse
        first, second = increment[e, dim + d], increment[e + 1, dim + d]
        da = _BASIS[g, 0] * chord + _BASIS[g, 1] * first + _BASIS[g, 2] * second
        db = _CURVING[g, 0] * chord + _CURVING[g, 1] * first + _CURVING[g, 2] * second
        db *= inverse
        bend[0, d] = work.slope[e, g, d] + 0.5 * da
        bend[1, d] = work.curving[e, g, d] + 0.5 * db
        bend[2, d] = da
        bend[3, d] = db
        square += bend[0, d] ** 2
        along += bend[0, d] * bend[1, d]
        stretch += bend[0, d] * da
    size = np.sqrt(square)
    along /= size
    stretch /= size
    for d in range(dim):
        bend[0, d] /= size
        bend[1, d] = (bend[1, d] - along * bend[0, d]) / size
        bend[2, d] = bend[3, d] - along / size * bend[2, d]
        drift += bend[0, d] * bend[2, d]
    cross, change = 0.0, 0.0
    for d in range(dim):
        dk = (bend[2, d] - drift * bend[0, d] - bend[1, d] * stretch) / size
        bend[2, d] = dk
        cross += bend[1, d] * dk
        change += dk * dk
    return size, along, cross, change


@kernel
def _bending_damping_element(tether: Tether, h: float, e: int, work: Workspace) -> None:
    """Add the bending damping of element e to the force and tangent in the reduced basis.

    The tangent keeps what the second derivatives contribute, P/|a|^2; the rest is smaller by the
    angle that an element bends and acts along the tether, where the axial stiffness rules.
    """
    dim = len(tether.gravity)
    length = tether.element_length
    bend = work.bend
    for g in range(_GAUSS):
        size, along, cross, _ = _curvature_change(tether, e, g, work)
        viscosity = _WEIGHTS[g] * length * tether.bending_stiffness
        viscosity *= tether.bending_damping_time / (h * size)
        for d in range(dim):
            on_slope = -viscosity * (bend[2, d] * along / size + bend[0, d] * cross)
            on_curving = viscosity * bend[2, d] / length
            for k in range(3):
                work.force[k, d] += _BASIS[g, k] * on_slope + _CURVING[g, k] * on_curving
            for c in range(dim):
                unit = 1.0 if c == d else 0.0
                entry = viscosity / (size * length**2) * (unit - bend[0, d] * bend[0, c])
                for k in range(6):
                    work.tangent[k, d, c] += _CURVING_PAIRS[g, k] * entry


@kernel
def _assemble_element(
    tether: Tether, h: float, linear: tuple[float, ...], average: float, e: int, work: Workspace
) -> None:
    """Tangent and residual (last column) of element e on its (r1, r1', r2, r2').

    `linear` holds the coefficients of the part of the residual that is linear in D.
    """
    dim = len(tether.gravity)
    inverse = 1.0 / tether.element_length
    _axial_element(tether, average, e, work)
    if tether.bending_damping_time > 0.0:
        _bending_damping_element(tether, h, e, work)
    increment, force, tangent, block = work.increment, work.force, work.tangent, work.element
    last = 4 * dim
    for d in range(dim):
        parts = _apply(
            linear,
            increment[e, d],
            increment[e, dim + d],
            increment[e + 1, d],
            increment[e + 1, dim + d],
        )
        block[d, last] = parts[0] - force[0, d] * inverse
        block[dim + d, last] = parts[1] + force[1, d]
        block[2 * dim + d, last] = parts[2] + force[0, d] * inverse
        block[3 * dim + d, last] = parts[3] + force[2, d]
        for c in range(dim):
            unit = 1.0 if c == d else 0.0
            chord = tangent[0, d, c] * inverse * inverse
            first = tangent[1, d, c] * inverse
            second = tangent[2, d, c] * inverse
            between = tangent[4, d, c]
            block[d, c] = linear[0] * unit + chord
            block[d, dim + c] = linear[1] * unit - first
            block[d, 2 * dim + c] = linear[3] * unit - chord
            block[d, 3 * dim + c] = linear[4] * unit - second
            block[dim + d, c] = linear[1] * unit - first
            block[dim + d, dim + c] = linear[2] * unit + tangent[3, d, c]
            block[dim + d, 2 * dim + c] = -linear[4] * unit + first
            block[dim + d, 3 * dim + c] = linear[5] * unit + between
            block[2 * dim + d, c] = linear[3] * unit - chord
            block[2 * dim + d, dim + c] = -linear[4] * unit + first
            block[2 * dim + d, 2 * dim + c] = linear[0] * unit + chord
            block[2 * dim + d, 3 * dim + c] = -linear[1] * unit + second
            block[3 * dim + d, c] = linear[4] * unit - second
            block[3 * dim + d, dim + c] = linear[5] * unit + between
            block[3 * dim + d, 2 * dim + c] = -linear[1] * unit + second
            block[3 * dim + d, 3 * dim + c] = linear[2] * unit + tangent[5, d, c]


@kernel
def _eliminate_node(i: int, columns: int, work: Workspace) -> None:
    """Gauss-Jordan on the pivot rows (D | U | R); stores D^-1 U and D^-1 R of node i.

    No pivoting: inertia dominates D, and a step for which it does not is halved by the caller.
    """
    pivot = work.pivot
    m = pivot.shape[0]
    for k in range(m):
        scale = 1.0 / pivot[k, k]
        for c in range(columns):
            pivot[k, c] *= scale
        for r in range(m):
            if r != k:
                multiplier = pivot[r, k]
                for c in range(columns):
                    pivot[r, c] -= multiplier * pivot[k, c]
    for r in range(m):
        work.solution[i, r] = pivot[r, columns - 1]
        for c in range(m, columns - 1):
            work.factor[i, r, c - m] = pivot[r, c]


@kernel
def _hold(end: int, columns: int, work: Workspace) -> None:
    """Replace the pivot rows of held coordinates by "increment = 0"."""
    pivot = work.pivot
    for r in range(pivot.shape[0]):
        if work.end_fixed[end, r]:
            for c in range(columns):
                pivot[r, c] = 0.0
            pivot[r, r] = 1.0


@kernel
def newton_increment(tether: Tether, h: float, work: Workspace) -> float:
    """Assemble, eliminate and apply one Newton increment to work.increment.

    The increment itself stays in work.solution. Returns its largest entry [m], slopes times the
    element's length; NaN if an entry is.
    """
    dim = len(tether.gravity)
    m = 2 * dim
    n = work.slope.shape[0]
    average = 0.5 * (1.0 + tether.numerical_damping) + tether.axial_damping_time / h
    linear = _combine(
        2.0 / h**2,
        mass_coefficients(tether),
        0.5,
        bending_coefficients(tether),
    )
    pivot, block = work.pivot, work.element
    for r in range(m):
        for c in range(m):
            pivot[r, c] = work.end_matrix[0, r, c]
        pivot[r, 2 * m] = work.end_residual[0, r] + work.constant[0, r]
    for e in range(n):
        _assemble_element(tether, h, linear, average, e, work)
        for r in range(m):
            for c in range(m):
                pivot[r, c] += block[r, c]
                pivot[r, m + c] = block[r, m + c]
            pivot[r, 2 * m] += block[r, 2 * m]
        if e == 0:
            _hold(0, 2 * m + 1, work)
        _eliminate_node(e, 2 * m + 1, work)
        for r in range(m):
            for c in range(m):
                entry = block[m + r, m + c]
                for k in range(m):
                    entry -= block[m + r, k] * work.factor[e, k, c]
                pivot[r, c] = entry
            entry = block[m + r, 2 * m] + work.constant[e + 1, r]
            for k in range(m):
                entry -= block[m + r, k] * work.solution[e, k]
            pivot[r, 2 * m] = entry
    for r in range(m):
        for c in range(m):
            pivot[r, c] += work.end_matrix[1, r, c]
        pivot[r, m] = pivot[r, 2 * m] + work.end_residual[1, r]
    _hold(1, m + 1, work)
    _eliminate_node(n, m + 1, work)
    return _substitute(tether.element_length, dim, work)


@kernel
def _substitute(length: float, dim: int, work: Workspace) -> float:
    """Back substitution from the tip; subtracts the solution from the increment."""
    m = 2 * dim
    n = work.slope.shape[0]
    largest = 0.0
    total = 0.0
    for i in range(n, -1, -1):
        for r in range(m):
            entry = work.solution[i, r]
            if i < n:
                for c in range(m):
                    entry -= work.factor[i, r, c] * work.solution[i + 1, c]
            work.solution[i, r] = entry
            work.increment[i, r] -= entry
            size = abs(entry) if r < dim else length * abs(entry)
            largest = max(largest, size)
            total += size
    return largest if np.isfinite(total) else np.nan


@kernel
def end_step(
    tether: Tether, h: float, q0: Array, v0: Array, work: Workspace, q1: Array, v1: Array
) -> tuple[float, float, float]:
    """Write the state after the step from the converged increment; element tensions to `work`.

    Returns:
        What the tether dissipated during the step [J]; its largest tension [N], the mean of
        N |r'| over an element at mid-step, damping included; and the largest change of a node's
        slope, the turn during the step [rad] where the tether is not strained much.
    """
    dim = len(tether.gravity)
    n = q0.shape[0] - 1
    length = tether.element_length
    increment = work.increment
    turn = 0.0
    for i in range(n + 1):
        for k in range(2 * dim):
            q1[i, k] = q0[i, k] + increment[i, k]
            v1[i, k] = 2.0 / h * increment[i, k] - v0[i, k]
        square = 0.0
        for d in range(dim):
            square += increment[i, dim + d] ** 2
        turn = max(turn, square)
    damping = 0.5 * tether.numerical_damping + tether.axial_damping_time / h
    axial_loss = 0.0
    peak = -np.inf
    for e in range(n):
        mean = 0.0
        for g in range(_GAUSS):
            stretch = 0.0
            square = 0.0
            for d in range(dim):
                change = (
                    _BASIS[g, 0] * (increment[e + 1, d] - increment[e, d]) / length
                    + _BASIS[g, 1] * increment[e, dim + d]
                    + _BASIS[g, 2] * increment[e + 1, dim + d]
                )
                middle = work.slope[e, g, d] + 0.5 * change
                stretch += middle * change
                square += middle * middle
            axial_loss += _WEIGHTS[g] * stretch * stretch
            mean += _WEIGHTS[g] * (work.strain[e, g] + (0.5 + damping) * stretch) * np.sqrt(square)
        tension = tether.axial_stiffness * mean
        work.tension[e] = tension
        peak = max(peak, tension)
    loss = damping * tether.axial_stiffness * length * axial_loss
    if tether.bending_damping_time > 0.0:
        viscosity = tether.bending_stiffness * tether.bending_damping_time / h * length
        for e in range(n):
            for g in range(_GAUSS):
                _, _, _, change = _curvature_change(tether, e, g, work)
                loss += viscosity * _WEIGHTS[g] * change
    return loss, peak, np.sqrt(turn)


@kernel
def tether_energies(tether: Tether, q: Array, v: Array) -> tuple[float, float, float, float]:
    """Kinetic, gravity (zero at the origin's level), axial and bending energy [J]."""
    dim = len(tether.gravity)
    length = tether.element_length
    mass = mass_coefficients(tether)
    bending_matrix = bending_coefficients(tether)
    weight = tether.line_density * length
    kinetic = 0.0
    gravity = 0.0
    axial = 0.0
    bending = 0.0
    for e in range(q.shape[0] - 1):
        for d in range(dim):
            r1, s1, r2, s2 = v[e, d], v[e, dim + d], v[e + 1, d], v[e + 1, dim + d]
            p = _apply(mass, r1, s1, r2, s2)
            kinetic += 0.5 * (r1 * p[0] + s1 * p[1] + r2 * p[2] + s2 * p[3])
            r1, s1, r2, s2 = q[e, d], q[e, dim + d], q[e + 1, d], q[e + 1, dim + d]
            p = _apply(bending_matrix, r1, s1, r2, s2)
            bending += 0.5 * (r1 * p[0] + s1 * p[1] + r2 * p[2] + s2 * p[3])
            gravity -= weight * tether.gravity[d] * (0.5 * (r1 + r2) + length * (s1 - s2) / 12.0)
        for g in range(_GAUSS):
            square = 0.0
            for d in range(dim):
                slope = (
                    _BASIS[g, 0] * (q[e + 1, d] - q[e, d]) / length
                    + _BASIS[g, 1] * q[e, dim + d]
                    + _BASIS[g, 2] * q[e + 1, dim + d]
                )
                square += slope * slope
            axial += _WEIGHTS[g] * (0.5 * (square - 1.0)) ** 2
    return kinetic, gravity, 0.5 * tether.axial_stiffness * length * axial, bending


@kernel
def element_tensions(tether: Tether, q: Array, v: Array, tensions: Array) -> None:
    """Write each element's tension [N] at a state: the mean of EA (eps + tau_a deps/dt) |r'|."""
    dim = len(tether.gravity)
    length = tether.element_length
    for e in range(q.shape[0] - 1):
        mean = 0.0
        for g in range(_GAUSS):
            square = 0.0
            rate = 0.0
            for d in range(dim):
                slope = (
                    _BASIS[g, 0] * (q[e + 1, d] - q[e, d]) / length
                    + _BASIS[g, 1] * q[e, dim + d]
                    + _BASIS[g, 2] * q[e + 1, dim + d]
                )
                slope_rate = (
                    _BASIS[g, 0] * (v[e + 1, d] - v[e, d]) / length
                    + _BASIS[g, 1] * v[e, dim + d]
                    + _BASIS[g, 2] * v[e + 1, dim + d]
                )
                square += slope * slope
                rate += slope * slope_rate
            strain = 0.5 * (square - 1.0) + tether.axial_damping_time * rate
            mean += _WEIGHTS[g] * strain * np.sqrt(square)
        tensions[e] = tether.axial_stiffness * mean


def nodal_tensions(tensions: Array) -> Array:
    """Tensions of the elements (n,) as tensions at the nodes (n + 1,) [N].

    An element's mean belongs to its middle: nodes between two elements get the mean of both, the
    ends are extrapolated.
    """
    if tensions.size == 1:
        return np.repeat(tensions, 2)
    inner = 0.5 * (tensions[:-1] + tensions[1:])
    first = 1.5 * tensions[0] - 0.5 * tensions[1]
    last = 1.5 * tensions[-1] - 0.5 * tensions[-2]
    return np.concatenate([[first], inner, [last]])
