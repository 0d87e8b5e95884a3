"""Minimum of the tether's potential energy by Newton's method, compiled.

The energy is that of the ANCF cable (axial L2, with the law of `buckling` in compression; bending
T1; weight) and of the loads at the tip. A Levenberg shift of the banded Hessian adapts to how well
the quadratic model predicts the energy: the energy decreases from any starting shape, and the
result is a minimum or an error.

Unknowns are the coordinates of the nodes in the order of the array (n + 1, 2, dim). Banded matrices
have their entry (i, j), i >= j, at [i - j, j], (4 dim, unknowns).
"""

from typing import NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import checked, checked_inner, inner, kernel
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.buckling import NO_BUCKLING, released_energy, relief, relief_slope

CONVERGED, UNSTABLE, NO_DECREASE, NO_CURVATURE, UNFINISHED = range(5)
"""Ends of `minimise`: a minimum; another stationary shape; why none was found."""

STEP_TOLERANCE = 1e-11
"""A Newton step below this, relative to the length [-] and in the slopes [-], is converged."""

ENERGY_NOISE = 1e-12
"""Relative differences of energy below this are rounding [-]."""

_SMALLEST_SHIFT = 1e-12  # over the largest diagonal entry [-]
_LARGEST_SHIFT = 1e6


class StaticLaw(NamedTuple):
    """Energy of an element, and the loads."""

    element_length: float  # l [m]
    axial_stiffness: float  # EA l [N m]
    buckling_limit: float  # see `buckling`
    functions: Array  # S' at the Gauss points, (5, 4)
    gauss_weights: Array  # (5,)
    mean: Array  # integral of S'^T S' over l, (4, 4)
    bending: Array  # K_t, (4, 4)
    weight: Array  # nodal forces of the weight, (4, dim)
    force: Array  # dead force on the last node [N], (dim,)
    moment: float  # about z on the last section, following it [N m]; plane only


class MinimumWork(NamedTuple):
    """Work arrays of `minimise`."""

    slopes: Array  # r' of an element at the Gauss points, (5, dim)
    row: Array  # mean @ e of an element, (4, dim)
    trial: Array  # (n + 1, 2, dim)
    gradient: Array  # (unknowns,)
    step: Array  # (unknowns,)
    banded: Array  # (4 dim, unknowns)
    factor: Array  # (4 dim, unknowns)


class Search(NamedTuple):
    """State of `minimise` at its end."""

    end: int
    iterations: int
    shift: float
    last_step: float  # [m]


def make_work(elements: int, dim: int) -> MinimumWork:
    """Allocate the work arrays."""
    unknowns = (elements + 1) * 2 * dim
    vector, matrix = np.zeros(unknowns), np.zeros((4 * dim, unknowns))
    return MinimumWork(
        np.zeros((5, dim)), np.zeros((4, dim)), np.zeros((elements + 1, 2, dim)),
        vector, vector.copy(), matrix, matrix.copy(),
    )  # fmt: skip


# Coordinate a of element k is coordinate a % 2 of node k + a // 2.


@inner
def _interpolate(law: StaticLaw, nodes: Array, k: int, work: MinimumWork) -> float:
    """Store slopes and row of element k; returns its mean strain if it may buckle, else 0."""
    dim = nodes.shape[2]
    for g in range(5):
        for i in range(dim):
            total = 0.0
            for a in range(4):
                total += law.functions[g, a] * nodes[k + a // 2, a % 2, i]
            work.slopes[g, i] = total
    if law.buckling_limit >= NO_BUCKLING:
        return 0.0
    square = 0.0
    for a in range(4):
        for i in range(dim):
            total = 0.0
            for b in range(4):
                total += law.mean[a, b] * nodes[k + b // 2, b % 2, i]
            work.row[a, i] = total
            square += total * nodes[k + a // 2, a % 2, i]
    return 0.5 * (square - 1.0)


@inner
def _strain(work: MinimumWork, g: int) -> float:
    """Green's strain at a Gauss point of the interpolated element [-]."""
    square = 0.0
    for i in range(work.slopes.shape[1]):
        square += work.slopes[g, i] * work.slopes[g, i]
    return 0.5 * (square - 1.0)


@kernel
def elastic_energy(law: StaticLaw, nodes: Array, work: MinimumWork) -> tuple[float, float, float]:
    """Return axial, bending and gravitational energy [J]; the last is zero at the origin."""
    axial = bending = weight = 0.0
    for k in range(nodes.shape[0] - 1):
        strain = _interpolate(law, nodes, k, work)
        for g in range(5):
            axial += 0.5 * law.gauss_weights[g] * _strain(work, g) ** 2
        if law.buckling_limit < NO_BUCKLING:
            axial += released_energy(strain, law.buckling_limit)
        for a in range(4):
            for i in range(nodes.shape[2]):
                value = nodes[k + a // 2, a % 2, i]
                weight -= law.weight[a, i] * value
                for b in range(4):
                    bending += 0.5 * law.bending[a, b] * value * nodes[k + b // 2, b % 2, i]
    return law.axial_stiffness * axial, bending, weight


@inner
def _energy(law: StaticLaw, nodes: Array, before: Array, work: MinimumWork) -> float:
    """Energy [J]; the work of the moment is relative to the tip's slope in `before`."""
    axial, bending, weight = elastic_energy(law, nodes, work)
    total = axial + bending + weight
    for i in range(nodes.shape[2]):
        total -= law.force[i] * nodes[-1, 0, i]
    if law.moment != 0.0:
        x, y = nodes[-1, 1, 0], nodes[-1, 1, 1]
        x0, y0 = before[-1, 1, 0], before[-1, 1, 1]
        total -= law.moment * np.arctan2(x0 * y - y0 * x, x0 * x + y0 * y)
    return total


@kernel
def derivatives(law: StaticLaw, nodes: Array, work: MinimumWork) -> None:
    """Store the gradient of the energy by the nodes, and its Hessian in `banded`."""
    dim = nodes.shape[2]
    work.gradient[:] = 0.0
    work.banded[:] = 0.0
    for k in range(nodes.shape[0] - 1):
        strain = _interpolate(law, nodes, k, work)
        released = slope = 0.0
        if law.buckling_limit < NO_BUCKLING:
            released = law.axial_stiffness * relief(strain, law.buckling_limit)
            slope = law.axial_stiffness * relief_slope(strain, law.buckling_limit)
        first = k * 2 * dim
        for a in range(4):
            for i in range(dim):
                force = -law.weight[a, i]
                for b in range(4):
                    value = nodes[k + b // 2, b % 2, i]
                    force += (law.bending[a, b] + released * law.mean[a, b]) * value
                for g in range(5):
                    factor = law.axial_stiffness * law.gauss_weights[g] * law.functions[g, a]
                    force += factor * _strain(work, g) * work.slopes[g, i]
                work.gradient[first + a * dim + i] += force
        for a in range(4):
            for b in range(a + 1):
                _add_block(law, work, first, a, b, released, slope)
    for i in range(dim):
        work.gradient[(nodes.shape[0] - 1) * 2 * dim + i] -= law.force[i]
    if law.moment != 0.0:
        x, y = nodes[-1, 1, 0], nodes[-1, 1, 1]
        square = x * x + y * y
        work.gradient[-2] += law.moment * y / square
        work.gradient[-1] -= law.moment * x / square
        factor = law.moment / (square * square)
        work.banded[0, -2] -= factor * 2.0 * x * y
        work.banded[0, -1] += factor * 2.0 * x * y
        work.banded[1, -2] -= factor * (y * y - x * x)


@inner
def _add_block(
    law: StaticLaw, work: MinimumWork, first: int, a: int, b: int, released: float, slope: float
) -> None:
    """Add an element's Hessian of its coordinates a >= b, lower half."""
    dim = work.slopes.shape[1]
    alike = law.bending[a, b] + released * law.mean[a, b]
    for g in range(5):
        factor = law.axial_stiffness * law.gauss_weights[g]
        alike += factor * law.functions[g, a] * law.functions[g, b] * _strain(work, g)
    for i in range(dim):
        for j in range(i + 1 if a == b else dim):
            entry = alike if i == j else 0.0
            for g in range(5):
                factor = law.axial_stiffness * law.gauss_weights[g]
                factor *= law.functions[g, a] * law.functions[g, b]
                entry += factor * work.slopes[g, i] * work.slopes[g, j]
            if slope != 0.0:
                entry += slope * work.row[a, i] * work.row[b, j]
            row, column = a * dim + i, b * dim + j
            work.banded[row - column, first + column] += entry


@checked_inner
def _decouple(work: MinimumWork, fixed: Array) -> None:
    """Decouple the fixed unknowns from the others and give them a unit diagonal."""
    width, unknowns = work.banded.shape
    for index in range(unknowns):
        if fixed[index]:
            work.gradient[index] = 0.0
            work.banded[0, index] = 1.0
            for offset in range(1, width):
                work.banded[offset, index] = 0.0
                if offset <= index:
                    work.banded[offset, index - offset] = 0.0


@checked_inner
def _factorise(work: MinimumWork, weights: Array, shift: float) -> bool:
    """Cholesky factor of H + shift W; returns whether it is positive definite."""
    banded, factor = work.banded, work.factor
    width, unknowns = banded.shape
    for j in range(unknowns):
        square = banded[0, j] + shift * weights[j]
        for k in range(max(0, j - width + 1), j):
            square -= factor[j - k, k] * factor[j - k, k]
        if not square > 0.0:
            return False
        diagonal = np.sqrt(square)
        factor[0, j] = diagonal
        for i in range(j + 1, min(unknowns, j + width)):
            total = banded[i - j, j]
            for k in range(max(0, i - width + 1), j):
                total -= factor[i - k, k] * factor[j - k, k]
            factor[i - j, j] = total / diagonal
    return True


@checked_inner
def _solve(work: MinimumWork) -> None:
    """Solve for the step against the gradient with the factor."""
    factor, step = work.factor, work.step
    width, unknowns = factor.shape
    for j in range(unknowns):
        total = -work.gradient[j]
        for k in range(max(0, j - width + 1), j):
            total -= factor[j - k, k] * step[k]
        step[j] = total / factor[0, j]
    for j in range(unknowns - 1, -1, -1):
        total = step[j]
        for i in range(j + 1, min(unknowns, j + width)):
            total -= factor[i - j, j] * step[i]
        step[j] = total / factor[0, j]


@checked_inner
def _try_step(nodes: Array, work: MinimumWork, weights: Array) -> float:
    """Store the nodes after the step; returns its largest entry, of a slope times l [m]."""
    largest = 0.0
    count, dim = nodes.shape[0], nodes.shape[2]
    for index in range(work.step.size):
        largest = max(largest, abs(work.step[index]) * np.sqrt(weights[index]))
    for node in range(count):
        for side in range(2):
            for i in range(dim):
                step = work.step[(node * 2 + side) * dim + i]
                work.trial[node, side, i] = nodes[node, side, i] + step
    return largest


@checked_inner
def _accept(nodes: Array, work: MinimumWork) -> None:
    for node in range(nodes.shape[0]):
        for side in range(2):
            for i in range(nodes.shape[2]):
                nodes[node, side, i] = work.trial[node, side, i]


@checked
def minimise(
    law: StaticLaw,
    nodes: Array,
    fixed: Array,
    weights: Array,
    work: MinimumWork,
    shift: float,
    iterations: int,
) -> Search:
    """Move the nodes to a minimum of the energy.

    Args:
        law: of the energy.
        nodes: starting shape, changed in place.
        fixed: which unknowns stay, (unknowns,).
        weights: W, the square of what makes a slope comparable to a position, (unknowns,).
        work: of the same size.
        shift: of the Hessian to begin with.
        iterations: at most.

    Returns:
        `UNSTABLE` at a stationary shape that is no minimum: go on from a perturbed one.
    """
    length = law.element_length * (nodes.shape[0] - 1)
    largest = np.inf
    for iteration in range(iterations):
        derivatives(law, nodes, work)
        _decouple(work, fixed)
        unit = 0.0
        for index in range(weights.size):
            unit = max(unit, work.banded[0, index] / weights[index])
        before = _energy(law, nodes, nodes, work)
        while True:
            while not _factorise(work, weights, shift):
                shift = max(10.0 * shift, _SMALLEST_SHIFT * unit)
                if not shift <= _LARGEST_SHIFT * unit:
                    return Search(NO_CURVATURE, iteration, shift, largest)
            _solve(work)
            largest = _try_step(nodes, work, weights)
            if largest < STEP_TOLERANCE * length:
                if shift == 0.0:
                    _accept(nodes, work)
                    return Search(CONVERGED, iteration, shift, largest)
                return Search(UNSTABLE, iteration, shift, largest)
            # 0.5 step.H.step = -0.5 gradient.step - 0.5 shift step.W.step, by the step's equation
            predicted = 0.0
            for index in range(weights.size):
                step = work.step[index]
                predicted += 0.5 * (shift * weights[index] * step - work.gradient[index]) * step
            if predicted <= ENERGY_NOISE * abs(before):
                # energy differences are rounding here; pure Newton steps converge
                shift = 0.0
                break
            ratio = (before - _energy(law, work.trial, nodes, work)) / predicted
            if ratio > 0.75:
                shift = shift / 8.0 if shift > _SMALLEST_SHIFT * unit else 0.0
            elif not ratio >= 0.25:
                shift = max(4.0 * shift, _SMALLEST_SHIFT * unit)
            if ratio > 0.05:
                break
            if not shift <= _LARGEST_SHIFT * unit:
                return Search(NO_DECREASE, iteration, shift, largest)
        _accept(nodes, work)
    return Search(UNFINISHED, iterations, shift, largest)
