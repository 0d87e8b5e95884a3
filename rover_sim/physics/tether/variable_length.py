"""The exit element at the fairlead, whose length changes as the drum pays out or reels in.

An arbitrary-Lagrangian-Eulerian element (Hong and Ren 2011, Multibody System Dynamics 26; Ding and
Ouyang 2022, Machines 10:174): its first node is fixed at the fairlead and material flows through
it; its second node belongs to the Lagrangian chain that `energy_momentum` integrates. With s the
undeformed arc length, s1(t) the material point at the fairlead and s2 that of the second node,

    l = s2 - s1,   xi = (s - s1)/l,   sigma = ds1/dt = -v_pay,   r = S(xi, l) e.

A shape function S = l^p f(xi) changes with s1 at fixed s by D = dS/ds1 and D2 = dD/ds1,

    D = l^(p-1) g,    g = f' (xi - 1) - p f,
    D2 = l^(p-2) k,   k = g' (xi - 1) - (p - 1) g,

so a material point has the velocity dr/dt = S e' + sigma D e, and the equation of the element is

    int rhoA S^T (S e'' + 2 sigma D e' + (sigma^2 D2 + sigma' D) e) ds + Q(l, e) = Q_g(l).

The first node has the position of the fairlead, which rests or is driven, and a free slope. The
slope is condensed into the second node, so the element acts on the chain like any block at its end.
A step evaluates all terms at mid-step (second order), with Green's strain averaged over start and
end. In compression the element carries as much as the others do (`buckling`).

What a drum pays out in the step depends on the tension at the fairlead, and that on what it pays
out. For each iterate of the chain the caller finds the payout at which both agree
(`tension_for`); `add_exit` takes its change with the iterate into the tangent.
"""

from typing import Any, NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.numerics.simd import fill, lane, load, stack, store
from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.buckling import mean_relief, released_energy, released_in_step, relief
from rover_sim.physics.tether.energy_momentum import Workspace, set_end
from rover_sim.physics.tether.natural_curvature import NaturalCurvature, add_exit_curvature
from rover_sim.physics.tether.tether import Tether

Coordinates = tuple[float, float, float, float]  # (r1, r1', r2, r2') in one direction

_POWER = np.array([0.0, 1.0, 0.0, 1.0])  # p of the four shape functions

# Cubic coefficients of f, rows in ascending powers of xi, columns the shape functions.
_F = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-3.0, -2.0, 3.0, -1.0], [2.0, 1.0, -2.0, 1.0]]
)


def _derivative(c: Array) -> Array:
    """Coefficients of d/dxi."""
    result = np.zeros_like(c)
    result[:-1] = c[1:] * np.arange(1, c.shape[0])[:, None]
    return result


def _moving(c: Array, q: Array) -> Array:
    """Coefficients of c' (xi - 1) - q c."""
    slope = _derivative(c)
    shifted = np.zeros_like(c)
    shifted[1:] = slope[:-1]
    return shifted - slope - q * c


_G = _moving(_F, _POWER)
_K = _moving(_G, _POWER - 1.0)


def _integrals(a: Array, b: Array) -> Array:
    """int_0^1 a_i b_j dxi for two sets of cubics."""
    powers = np.arange(a.shape[0])
    hilbert = 1.0 / (powers[:, None] + powers[None, :] + 1.0)
    return np.asarray(a.T @ hilbert @ b)


_FF = _integrals(_F, _F)
_FG = _integrals(_F, _G)
_FK = _integrals(_F, _K)
_GG = _integrals(_G, _G)
_BEND = _integrals(_derivative(_derivative(_F)), _derivative(_derivative(_F)))
_LOAD = _integrals(_F, np.eye(4)[:, :1])[:, 0]
_SLOPE = ancf.slope_functions(ancf.GAUSS_POINTS, 1.0)  # f' at the quadrature points, (5, 4)
_WEIGHTS = ancf.GAUSS_WEIGHTS


class ExitElement(NamedTuple):
    """Work arrays of the exit element; a node has m = 2 dim coordinates.

    The last index of the arrays with `lanes` is a direction; surplus lanes are zero.
    """

    increment: Array  # of the exit slope, (dim,)
    start: Array  # e at the step's start, (4, lanes)
    rate: Array  # de/dt at the step's start, (4, lanes)
    change: Array  # D, increment of e, (4, lanes)
    residual: Array  # (4, lanes)
    isotropic: Array  # part of the tangent that is a multiple of the unit matrix, (4, 4)
    tangent: Array  # [i, j, c, d]: of residual[i, d] by D[j, c], (4, 4, dim, lanes)
    strain: Array  # mean strain at the step's start [-], and its increment, (2,)
    condensed: Array  # (dim, dim + m + 1): rows of the exit slope | second node | residual
    by_tension: Array  # change of the residual per tension, by what the drum pays out, (4, lanes)
    reaction: Array  # force of the fairlead on the tether in the last step [N], (dim,)
    tension: Array  # tension at the fairlead at mid-step [N], (1,)


class Payout(NamedTuple):
    """Length and payout rate at the start and the end of a step: l1 = l0 + h (v0 + v1)/2."""

    length0: float  # undeformed length of the exit element [m]
    length1: float
    rate0: float  # v_pay [m/s]
    rate1: float


class PayoutChange(NamedTuple):
    """Payout at a tension at the fairlead that is larger by `step`."""

    pay: Payout
    step: float  # [N]; 0: the payout does not depend on the tension


def make_exit(dim: int) -> ExitElement:
    """Allocate the arrays."""
    lanes = 4 if dim == 2 else 8
    return ExitElement(
        np.zeros(dim),
        np.zeros((4, lanes)),
        np.zeros((4, lanes)),
        np.zeros((4, lanes)),
        np.zeros((4, lanes)),
        np.zeros((4, 4)),
        np.zeros((4, 4, dim, lanes)),
        np.zeros(2),
        np.zeros((dim, 3 * dim + 1)),
        np.zeros((4, lanes)),
        np.zeros(dim),
        np.zeros(1),
    )


@inner
def _scale(i: int, length: float) -> float:
    """l^p of shape function i."""
    return length if i % 2 == 1 else 1.0


@inner
def begin_exit(
    fairlead: Array, slope: Array, slope_rate: Array, q: Array, v: Array, exit_element: ExitElement
) -> None:
    """Copy the state at the start of a step to the work arrays.

    Args:
        fairlead: position [m] and velocity [m/s] of the first node, and its travel in the step [m],
            (3, dim).
        slope: its slope, (dim,).
        slope_rate: rate of that slope as seen at the fairlead [1/s], (dim,).
        q: chain's rows (2 dim, width), its first column being the second node (r, r').
        v: its rates.
        exit_element: filled.
    """
    dim = fairlead.shape[1]
    for d in range(dim):
        exit_element.start[0, d], exit_element.rate[0, d] = fairlead[0, d], fairlead[1, d]
        exit_element.change[0, d] = fairlead[2, d]
        exit_element.start[1, d], exit_element.rate[1, d] = slope[d], slope_rate[d]
        exit_element.start[2, d], exit_element.rate[2, d] = q[d, 0], v[d, 0]
        exit_element.start[3, d], exit_element.rate[3, d] = q[dim + d, 0], v[dim + d, 0]


@inner
def _linear_parts(
    tether: Tether, h: float, pay: Payout, rows: int, exit_element: ExitElement
) -> None:
    """Write inertia, weight and bending to the first `rows` rows, as `_set_equations`."""
    tag = tether.gravity
    length = 0.5 * (pay.length0 + pay.length1)
    sigma = -(pay.length1 - pay.length0) / h
    sigma_rate = -(pay.rate1 - pay.rate0) / h
    rho = tether.line_density
    for i in range(rows):
        residual = fill(tag, 0.0)
        for j in range(4):
            powers = _scale(i, length) * _scale(j, length)
            inertia = rho * length * powers * _FF[i, j]
            flow = rho * powers * _FG[i, j]
            stiffness = rho * sigma * sigma * powers / length * _FK[i, j] + sigma_rate * flow
            stiffness += tether.bending_stiffness * powers / length**3 * _BEND[i, j]
            isotropic = 2.0 / h**2 * inertia + 2.0 * sigma / h * flow + 0.5 * stiffness
            exit_element.isotropic[i, j] = isotropic
            residual += isotropic * load(tag, exit_element.change, (j, 0))
            residual += stiffness * load(tag, exit_element.start, (j, 0))
            residual -= (2.0 / h * inertia) * load(tag, exit_element.rate, (j, 0))
        store(exit_element.residual, (i, 0), residual)
        weight = rho * length * _scale(i, length) * _LOAD[i]
        for d in range(len(tag)):
            exit_element.residual[i, d] -= weight * tag[d]


@inner
def _slopes_at(
    tether: Tether, pay: Payout, g: int, exit_element: ExitElement
) -> tuple[Any, Any, Any]:
    """Slope r' at a quadrature point at the step's start, middle and end, as packets."""
    tag = tether.gravity
    length = 0.5 * (pay.length0 + pay.length1)
    slope0, middle, slope1 = fill(tag, 0.0), fill(tag, 0.0), fill(tag, 0.0)
    for i in range(4):
        start = load(tag, exit_element.start, (i, 0))
        change = load(tag, exit_element.change, (i, 0))
        slope0 += _factor(g, i, pay.length0) * start
        middle += _factor(g, i, length) * (start + 0.5 * change)
        slope1 += _factor(g, i, pay.length1) * (start + change)
    return slope0, middle, slope1


@inner
def _factor(g: int, i: int, length: float) -> float:
    """Derivative of shape function i by s at a quadrature point."""
    return _SLOPE[g, i] * _scale(i, length) / length


@inner
def _square(tag: Any, vector: Any) -> float:
    """Squared length of a vector in the lanes of a packet."""
    squares = vector * vector
    total = 0.0
    for d in range(len(tag)):
        total += lane(squares, d)
    return total


@inner
def _axial_parts(
    tether: Tether, h: float, pay: Payout, rows: int, first: int, exit_element: ExitElement
) -> float:
    """Add the axial force to the equations, as `_set_equations`."""
    tag = tether.gravity
    dim = len(tag)
    length = 0.5 * (pay.length0 + pay.length1)
    damping = 0.5 * tether.numerical_damping + tether.axial_damping_time / h
    residuals = stack(tag, 4)
    for i in range(rows):
        residuals[i] = load(tag, exit_element.residual, (i, 0))
    loss, mean, change = 0.0, 0.0, 0.0
    for g in range(len(_WEIGHTS)):
        slope0, middle, slope1 = _slopes_at(tether, pay, g, exit_element)
        square0, square1 = _square(tag, slope0), _square(tag, slope1)
        stretch = 0.5 * (square1 - square0)
        loss += _WEIGHTS[g] * stretch * stretch
        mean += _WEIGHTS[g] * (0.5 * square0 - 0.5)
        change += _WEIGHTS[g] * stretch
        weight = _WEIGHTS[g] * length * tether.axial_stiffness
        strain = 0.25 * (square0 + square1) - 0.5 + damping * stretch
        for i in range(rows):
            shape = _factor(g, i, length)
            residuals[i] = residuals[i] + weight * strain * shape * middle
            if i < first:
                continue
            along = (weight * (0.5 + damping) * shape) * middle
            for j in range(1, 4):
                exit_element.isotropic[i, j] += (
                    0.5 * weight * strain * shape * _factor(g, j, length)
                )
                other = _factor(g, j, pay.length1)
                for c in range(dim):
                    column = (other * lane(slope1, c)) * along
                    if g > 0:
                        column += load(tag, exit_element.tangent, (i, j, c, 0))
                    store(exit_element.tangent, (i, j, c, 0), column)
    for i in range(rows):
        store(exit_element.residual, (i, 0), residuals[i])
    exit_element.strain[0], exit_element.strain[1] = mean, change
    loss *= damping
    if min(mean, mean + change, mean + (1.0 + damping) * change) < 0.0:
        loss += _add_relief(tether, damping, pay, rows, first, exit_element)
    return tether.axial_stiffness * length * loss


@inner
def _add_relief(
    tether: Tether, delay: float, pay: Payout, rows: int, first: int, exit_element: ExitElement
) -> float:
    """Add the relief of the compressed element to the equations, as `_set_equations`.

    Returns:
        Energy that it dissipates in the step beyond that of the linear law, by EA l [-].
    """
    tag = tether.gravity
    length = 0.5 * (pay.length0 + pay.length1)
    limit = tether.buckling_strain
    strain, change = exit_element.strain[0], exit_element.strain[1]
    start, increment = fill(tag, strain), fill(tag, change)
    values, derivatives = mean_relief(tag, start, increment, delay, limit)
    value, derivative = lane(values, 0), lane(derivatives, 0)
    weight = tether.axial_stiffness * length
    for i in range(rows):
        middle_row = fill(tag, 0.0)
        for g in range(len(_WEIGHTS)):
            _, middle, _ = _slopes_at(tether, pay, g, exit_element)
            middle_row += (_WEIGHTS[g] * _factor(g, i, length)) * middle
        residual = load(tag, exit_element.residual, (i, 0)) + (weight * value) * middle_row
        store(exit_element.residual, (i, 0), residual)
        if i < first:
            continue
        for j in range(1, 4):
            product = 0.0
            end_row = fill(tag, 0.0)
            for g in range(len(_WEIGHTS)):
                _, _, slope1 = _slopes_at(tether, pay, g, exit_element)
                end_row += (_WEIGHTS[g] * _factor(g, j, pay.length1)) * slope1
                product += _WEIGHTS[g] * _factor(g, i, length) * _factor(g, j, length)
            exit_element.isotropic[i, j] += 0.5 * weight * value * product
            for c in range(len(tag)):
                column = load(tag, exit_element.tangent, (i, j, c, 0))
                column += (weight * derivative * lane(end_row, c)) * middle_row
                store(exit_element.tangent, (i, j, c, 0), column)
    return value * change - lane(released_in_step(tag, start, increment, limit), 0)


@inner
def _set_equations(
    tether: Tether, h: float, pay: Payout, rows: int, first: int, exit_element: ExitElement
) -> float:
    """Write residual and tangent of the element; returns the energy dissipated in the step [J].

    The axial force N belongs to the strain averaged over start and end, with strain-rate damping.
    The residual has its first `rows` rows, the tangent its rows from `first` up to `rows`. The row
    of the first node's given position is the reaction; that node has no column.
    """
    _linear_parts(tether, h, pay, rows, exit_element)
    loss = _axial_parts(tether, h, pay, rows, first, exit_element)
    for i in range(first, rows):
        for j in range(1, 4):
            for d in range(len(tether.gravity)):
                exit_element.tangent[i, j, d, d] += exit_element.isotropic[i, j]
    return loss


@inner
def _set_change(work: Workspace, exit_element: ExitElement) -> None:
    """Collect the increments of the element's coordinates."""
    dim = exit_element.increment.shape[0]
    for d in range(dim):
        exit_element.change[1, d] = exit_element.increment[d]
        exit_element.change[2, d] = work.increment[d, 0]
        exit_element.change[3, d] = work.increment[dim + d, 0]


@inner
def _tension(exit_element: ExitElement) -> tuple[float, float]:
    """Tension at the fairlead [N], the reaction's component along the tether; and |r'| there."""
    square = 0.0
    along = 0.0
    for d in range(exit_element.increment.shape[0]):
        middle = exit_element.start[1, d] + 0.5 * exit_element.increment[d]
        square += middle * middle
        along -= middle * exit_element.residual[0, d]
    stretch = np.sqrt(square)
    return along / stretch, stretch


@inner
def tension_for(
    tether: Tether, h: float, pay: Payout, work: Workspace, exit_element: ExitElement
) -> float:
    """Tension at the fairlead [N], at mid-step, of the current increments and a payout."""
    _set_change(work, exit_element)
    _set_equations(tether, h, pay, 1, 1, exit_element)
    return _tension(exit_element)[0]


@inner
def _add_drum(
    dim: int, change: PayoutChange, tension_beyond: float, exit_element: ExitElement
) -> float:
    """Add to the tangent what the drum pays out as the iterate changes the tension.

    With the tension t(D, p) of the element and the payout p(T) of the drum, T = t(D, p(T)) changes
    by dT = t_D dD/(1 - t_p p_T), and the residual by its derivative with respect to p times p_T dT.

    Args:
        dim: of space.
        change: of the payout.
        tension_beyond: t at that payout [N].
        exit_element: its `by_tension` holds the residual at that payout.

    Returns:
        t_p p_T [-], at most 0 for a tether that slackens as it is paid out.
    """
    tension, stretch = _tension(exit_element)
    slope = min((tension_beyond - tension) / change.step, 0.0)
    factor = 1.0 / (1.0 - slope)
    for i in range(1, 4):
        for d in range(dim):
            rest = exit_element.by_tension[i, d] - exit_element.residual[i, d]
            exit_element.by_tension[i, d] = rest / change.step
    for j in range(1, 4):
        for c in range(dim):
            by_increment = 0.0
            for d in range(dim):
                middle = exit_element.start[1, d] + 0.5 * exit_element.increment[d]
                by_increment -= middle / stretch * exit_element.tangent[0, j, c, d]
            if j == 1:
                middle = exit_element.start[1, c] + 0.5 * exit_element.increment[c]
                turned = exit_element.residual[0, c] + tension * middle / stretch
                by_increment -= 0.5 * turned / stretch
            by_increment *= factor
            for i in range(1, 4):
                for d in range(dim):
                    exit_element.tangent[i, j, c, d] += by_increment * exit_element.by_tension[i, d]
    return slope


@inner
def add_exit(
    tether: Tether,
    h: float,
    pay: Payout,
    change: PayoutChange,
    natural: NaturalCurvature,
    work: Workspace,
    exit_element: ExitElement,
) -> float:
    """Add the exit element to the chain's root, its exit slope condensed into the second node.

    Args:
        tether: of the chain.
        h: [s].
        pay: payout at the iterate's tension.
        change: of the payout with the tension.
        natural: law of the natural curvature.
        work: of the chain.
        exit_element: changed.

    Returns:
        Change of the tension at the fairlead by what the drum pays out, per change of the drum's
        tension [-].
    """
    dim = len(tether.gravity)
    _set_change(work, exit_element)
    slope = 0.0
    if change.step == 0.0:
        _set_equations(tether, h, pay, 4, 1, exit_element)
    else:
        _set_equations(tether, h, change.pay, 4, 4, exit_element)
        beyond = _tension(exit_element)[0]
        for i in range(1, 4):
            for d in range(dim):
                exit_element.by_tension[i, d] = exit_element.residual[i, d]
        _set_equations(tether, h, pay, 4, 0, exit_element)
        slope = _add_drum(dim, change, beyond, exit_element)
    if natural.active:
        add_exit_curvature(
            tether,
            0.5 * (pay.length0 + pay.length1),
            exit_element.start,
            exit_element.change,
            natural,
            exit_element.residual,
            exit_element.tangent,
        )
    _condense(dim, work, exit_element)
    return slope


@inner
def _condense(dim: int, work: Workspace, exit_element: ExitElement) -> None:
    """Eliminate the exit slope; add the rest to the chain's root."""
    m = 2 * dim
    rows = exit_element.condensed
    for d in range(dim):
        for c in range(dim):
            rows[d, c] = exit_element.tangent[1, 1, c, d]
            rows[d, dim + c] = exit_element.tangent[1, 2, c, d]
            rows[d, m + c] = exit_element.tangent[1, 3, c, d]
        rows[d, m + dim] = exit_element.residual[1, d]
    for k in range(dim):
        inverse = 1.0 / rows[k, k]
        for c in range(k, m + dim + 1):
            rows[k, c] *= inverse
        for r in range(dim):
            if r != k:
                multiplier = rows[r, k]
                for c in range(k, m + dim + 1):
                    rows[r, c] -= multiplier * rows[k, c]
    for a in range(2):
        for d in range(dim):
            r = a * dim + d
            residual = exit_element.residual[2 + a, d]
            for k in range(dim):
                residual -= exit_element.tangent[2 + a, 1, k, d] * rows[k, m + dim]
            set_end(work, 0, m, r, residual)
            for b in range(2):
                for c in range(dim):
                    entry = exit_element.tangent[2 + a, 2 + b, c, d]
                    for k in range(dim):
                        entry -= exit_element.tangent[2 + a, 1, k, d] * rows[k, dim + b * dim + c]
                    set_end(work, 0, b * dim + c, r, entry)


@inner
def apply_exit_increment(length: float, work: Workspace, exit_element: ExitElement) -> float:
    """Apply the Newton increment of the exit slope; returns the sum of magnitudes [m]."""
    dim = exit_element.increment.shape[0]
    m = 2 * dim
    total = 0.0
    for d in range(dim):
        change = exit_element.condensed[d, m + dim]
        for c in range(m):
            change -= exit_element.condensed[d, dim + c] * work.solution[1, c]
        exit_element.increment[d] -= change
        total += length * abs(change)
    return total


@inner
def end_exit_step(
    tether: Tether,
    h: float,
    pay: Payout,
    work: Workspace,
    exit_element: ExitElement,
    slope1: Array,
    slope_rate1: Array,
) -> float:
    """Write exit slope, its rate and the reaction after a converged step; returns dissipation [J].

    The reaction of the fairlead on the tether is the residual of the fixed position; the tension at
    the fairlead is its component along the tether at mid-step.
    """
    _set_change(work, exit_element)
    loss = _set_equations(tether, h, pay, 1, 1, exit_element)
    for d in range(exit_element.increment.shape[0]):
        slope1[d] = exit_element.start[1, d] + exit_element.increment[d]
        slope_rate1[d] = 2.0 / h * exit_element.increment[d] - exit_element.rate[1, d]
        exit_element.reaction[d] = exit_element.residual[0, d]
    exit_element.tension[0] = _tension(exit_element)[0]
    return loss


@inner
def bending_at_length(tether: Tether, length: float, exit_element: ExitElement) -> float:
    """Bending energy of the element's coordinates at mid-step with another length [J]."""
    total = 0.0
    for d in range(len(tether.gravity)):
        for i in range(4):
            e_i = exit_element.start[i, d] + 0.5 * exit_element.change[i, d]
            for j in range(4):
                e_j = exit_element.start[j, d] + 0.5 * exit_element.change[j, d]
                total += _scale(i, length) * _scale(j, length) * _BEND[i, j] * e_i * e_j
    return 0.5 * tether.bending_stiffness / length**3 * total


@inner
def strain_energy_inflow(tether: Tether, slope_square: float, exit_element: ExitElement) -> float:
    """Strain energy that paid-out tether carries into the element, per length [J/m].

    EA eps^2/2 with the strain eps at the fairlead; in compression the energy of the element's mean
    strain m changes with its length by w(m) + w'(m) (eps - m) in place of m^2/2 (`buckling`).
    """
    strain = 0.5 * (slope_square - 1.0)
    mean = exit_element.strain[0] + 0.5 * exit_element.strain[1]
    limit = tether.buckling_strain
    released = released_energy(mean, limit) + relief(mean, limit) * (strain - mean)
    return tether.axial_stiffness * (0.5 * strain * strain + released)


@inner
def exit_energies(
    tether: Tether, length: float, payout_rate: float, e: Array, rate: Array
) -> tuple[float, float, float, float]:
    """Kinetic, gravity, axial and bending energy [J] of the exit element; e, rate (4, dim)."""
    dim = len(tether.gravity)
    sigma = -payout_rate
    rho = tether.line_density
    kinetic, gravity, axial, bending = 0.0, 0.0, 0.0, 0.0
    for d in range(dim):
        for i in range(4):
            load = rho * length * _scale(i, length) * _LOAD[i]
            gravity -= load * tether.gravity[d] * e[i, d]
            for j in range(4):
                powers = _scale(i, length) * _scale(j, length)
                kinetic += (
                    0.5
                    * rho
                    * powers
                    * (
                        length * _FF[i, j] * rate[i, d] * rate[j, d]
                        + 2.0 * sigma * _FG[i, j] * rate[i, d] * e[j, d]
                        + sigma * sigma / length * _GG[i, j] * e[i, d] * e[j, d]
                    )
                )
                bending += (
                    0.5
                    * tether.bending_stiffness
                    * powers
                    / length**3
                    * _BEND[i, j]
                    * e[i, d]
                    * e[j, d]
                )
    mean = 0.0
    for g in range(len(_WEIGHTS)):
        square = 0.0
        for d in range(dim):
            slope = 0.0
            for i in range(4):
                slope += _SLOPE[g, i] * _scale(i, length) / length * e[i, d]
            square += slope * slope
        axial += _WEIGHTS[g] * (0.5 * (square - 1.0)) ** 2
        mean += _WEIGHTS[g] * 0.5 * (square - 1.0)
    axial += 2.0 * released_energy(mean, tether.buckling_strain)
    return kinetic, gravity, 0.5 * tether.axial_stiffness * length * axial, bending


@inner
def _cubic(coefficients: Array, xi: float, i: int) -> float:
    """Value of cubic i at xi."""
    c = coefficients
    return c[0, i] + xi * (c[1, i] + xi * (c[2, i] + xi * c[3, i]))


@inner
def _cubic_slope(coefficients: Array, xi: float, i: int) -> float:
    """Derivative by xi of cubic i."""
    c = coefficients
    return c[1, i] + xi * (2.0 * c[2, i] + 3.0 * xi * c[3, i])


@inner
def field_at(
    length: float, s: float, payout_rate: float, e: Coordinates, rate: Coordinates
) -> tuple[float, float, float, float]:
    """Position, slope, material velocity and its slope in one direction inside an element.

    Args:
        length: undeformed length of the element [m].
        s: undeformed distance from its first node [m].
        payout_rate: v_pay [m/s]; 0 for a Lagrangian element.
        e: its coordinates in that direction.
        rate: their rates.
    """
    sigma = -payout_rate
    xi = s / length
    position, slope, speed, slope_speed = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        power = _scale(i, length)
        position += power * _cubic(_F, xi, i) * e[i]
        slope += power / length * _cubic_slope(_F, xi, i) * e[i]
        speed += power * _cubic(_F, xi, i) * rate[i]
        speed += sigma * power / length * _cubic(_G, xi, i) * e[i]
        slope_speed += power / length * _cubic_slope(_F, xi, i) * rate[i]
        slope_speed += sigma * power / length**2 * _cubic_slope(_G, xi, i) * e[i]
    return position, slope, speed, slope_speed
