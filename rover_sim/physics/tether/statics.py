"""Static equilibrium of the tether: the minimum of its potential energy.

The energy is that of the ANCF cable (axial L2, with the law of `buckling` in compression; bending
T1; weight) and of the loads at the tip. Newton's method with an adaptive Levenberg shift on the
banded Hessian minimises it: the energy decreases from any starting shape, and the result is a
minimum or an error.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from rover_sim.physics.tether import ancf, buckling
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.starting_shapes import arc_nodes, straight_nodes
from rover_sim.physics.tether.tether_section import TetherSection

SMALLEST_STRETCH = 0.9
LARGEST_UNEVENNESS = 0.15
"""A smaller |r'| anywhere, or a larger range of |r'| within an element, is a fold or kink that
the mesh cannot resolve and not a shape of a thin tether [-]."""

STEP_TOLERANCE = 1e-11
"""A Newton step below this, relative to the length [-] and in the slopes [-], is converged."""

ENERGY_NOISE = 1e-12
"""Relative differences of energy below this are rounding [-]."""

MAX_ITERATIONS = 2000


class StaticsError(RuntimeError):
    """No valid equilibrium was found; the message states the cause."""


@dataclass(frozen=True)
class TipLoad:
    """Load on a tether's tip, besides a support.

    Attributes:
        force: dead force [N], (dim,); a hanging weight is mass times gravity.
        moment: about z, counter-clockwise, following the section [N m]; plane only.
    """

    force: Array
    moment: float


def static_equilibrium(
    section: TetherSection,
    length: float,
    elements: int,
    gravity: ArrayLike,
    root: ArrayLike,
    tip: ArrayLike | None = None,
    *,
    root_slope: ArrayLike | None = None,
    tip_force: ArrayLike | None = None,
    tip_moment: float = 0.0,
    start_nodes: Array | None = None,
) -> Array:
    """Nodes (n + 1, 2, dim) of the tether at rest; gravity has dim = 2 or 3 components.

    Args:
        section: stiffness and mass of the tether.
        length: unstretched length [m].
        elements: number n of elements.
        gravity: acceleration vector [m/s^2], e.g. (0, -9.81).
        root: fixed position of the first node [m].
        tip: fixed position of the last node [m]; None leaves it free.
        root_slope: slope r' [-] that clamps the root; None pins it.
        tip_force: dead force on the last node [N].
        tip_moment: moment about z on the last section [N m], in the plane.
        start_nodes: starting shape; by default the circular arc to the fixed tip
            (straight if the tip is out of the arc's reach), or straight along the
            clamped slope or the load.

    Raises:
        ValueError: inconsistent arguments.
        StaticsError: not converged, or converged to a shape with folded elements.
    """
    pull = np.asarray(gravity, dtype=np.float64)
    dim = pull.size
    load = TipLoad(
        force=np.zeros(dim) if tip_force is None else np.array(tip_force, dtype=np.float64),
        moment=float(tip_moment),
    )
    if dim == 3 and load.moment != 0.0:
        raise ValueError("tip_moment: must be 0 in space; it is defined for the plane only")
    if load.force.shape != (dim,):
        raise ValueError(f"tip_force: must have {dim} components, like gravity")
    if start_nodes is None:
        nodes = _default_start(length, elements, pull, root, tip, root_slope, load.force)
    else:
        nodes = np.array(start_nodes, dtype=np.float64)
        if nodes.shape != (elements + 1, 2, dim):
            raise ValueError(f"start_nodes: shape {nodes.shape}, must be {(elements + 1, 2, dim)}")
    free = np.ones_like(nodes, dtype=bool)
    nodes[0, 0], free[0, 0] = root, False
    if root_slope is not None:
        nodes[0, 1], free[0, 1] = root_slope, False
    if tip is not None:
        nodes[-1, 0], free[-1, 0] = tip, False

    energy = _TetherEnergy(section, length, elements, pull, load)
    nodes = _minimise(energy, nodes, free)
    _check_folds(nodes, length / elements)
    return nodes


def nodal_forces(nodes: Array, section: TetherSection, length: float, gravity: ArrayLike) -> Array:
    """External generalised forces on the nodes that keep the tether at rest.

    Elastic forces minus weight, (n + 1, 2, dim): [i, 0] is a force [N], [i, 1] is work
    per slope [N m]. In equilibrium it is zero at a free and unloaded node; at the root it
    is the support's reaction.
    """
    pull = np.asarray(gravity, dtype=np.float64)
    load = TipLoad(force=np.zeros(pull.size), moment=0.0)
    return _TetherEnergy(section, length, nodes.shape[0] - 1, pull, load).gradient(nodes)


def potential_energy(
    nodes: Array, section: TetherSection, length: float, gravity: ArrayLike
) -> tuple[float, float, float]:
    """Axial, bending and gravitational energy [J]; the last is zero at the origin."""
    pull = np.asarray(gravity, dtype=np.float64)
    element = length / (nodes.shape[0] - 1)
    e = ancf.element_coordinates(nodes)
    weight = ancf.load_vector(section.line_density, element)
    buckled = _Buckling(section, element, pull)
    return (
        float(np.sum(ancf.axial_energy(e, section.axial_stiffness, element)) + buckled.energy(e)),
        float(np.sum(ancf.bending_energy(e, section.bending_stiffness, element))),
        -float(np.einsum("a,nai,i->", weight, e, pull)),
    )


class _Buckling:
    """What elements in compression carry less than the linear law; see `buckling`."""

    def __init__(self, section: TetherSection, element: float, gravity: Array) -> None:
        self._weight = section.axial_stiffness * element
        self._limit = buckling.buckling_strain(section, element, float(np.linalg.norm(gravity)))
        functions = ancf.slope_functions(ancf.GAUSS_POINTS, element)
        self._mean: Array = (functions.T * ancf.GAUSS_WEIGHTS) @ functions

    def _strains(self, e: Array) -> Array:
        """Mean strains of elements (n, 4, dim), (n,)."""
        return 0.5 * (np.einsum("nai,ab,nbi->n", e, self._mean, e) - 1.0)

    def energy(self, e: Array) -> float:
        """Energy of the elements [J], at most 0."""
        return self._weight * sum(
            buckling.released_energy(strain, self._limit) for strain in self._strains(e)
        )

    def force(self, e: Array) -> Array:
        """Derivative of the energy by e, (n, 4, dim)."""
        reliefs = np.array([buckling.relief(strain, self._limit) for strain in self._strains(e)])
        return np.asarray((self._weight * reliefs)[:, None, None] * (self._mean @ e))

    def tangent(self, e: Array) -> Array:
        """Derivative of the force by e, (n, 4, dim, 4, dim)."""
        strains = self._strains(e)
        reliefs = np.array([buckling.relief(strain, self._limit) for strain in strains])
        slopes = np.array([buckling.relief_slope(strain, self._limit) for strain in strains])
        row = self._mean @ e
        unit = np.eye(e.shape[-1])
        total = np.einsum("n,ab,ij->naibj", reliefs, self._mean, unit)
        total += np.einsum("n,nai,nbj->naibj", slopes, row, row)
        return np.asarray(self._weight * total)


class _TetherEnergy:
    """Potential energy of tether and tip load, its gradient and banded Hessian."""

    def __init__(
        self, section: TetherSection, length: float, elements: int, gravity: Array, load: TipLoad
    ) -> None:
        self.section = section
        self.length = length
        self.element = length / elements
        self.load = load
        self.dim = gravity.size
        self._bending = ancf.bending_matrix(section.bending_stiffness, self.element)
        self._buckling = _Buckling(section, self.element, gravity)
        self._weight = np.outer(ancf.load_vector(section.line_density, self.element), gravity)
        size = 4 * self.dim
        row, column = np.tril_indices(size)
        self._lower = (row, column)
        first = np.arange(elements)[:, None] * (2 * self.dim)
        unknowns = (elements + 1) * 2 * self.dim
        # scipy's lower banded form: entry (i, j) stands at [i - j, j]
        self._banded_index = (row - column) * unknowns + first + column
        self._banded_shape = (size, unknowns)

    def value(self, nodes: Array, before: Array) -> float:
        """Energy [J]; the work of the moment is relative to the tip's slope in `before`."""
        e = ancf.element_coordinates(nodes)
        energy = (
            np.sum(ancf.axial_energy(e, self.section.axial_stiffness, self.element))
            + self._buckling.energy(e)
            + 0.5 * np.einsum("nai,ab,nbi->", e, self._bending, e)
            - np.einsum("ai,nai->", self._weight, e)
            - self.load.force @ nodes[-1, 0]
        )
        if self.load.moment != 0.0:
            energy -= self.load.moment * _angle_between(before[-1, 1], nodes[-1, 1])
        return float(energy)

    def gradient(self, nodes: Array) -> Array:
        """dU/dnodes, (n + 1, 2, dim)."""
        e = ancf.element_coordinates(nodes)
        forces = ancf.axial_force(e, self.section.axial_stiffness, self.element)
        forces += self._buckling.force(e)
        total = ancf.assemble_nodes(forces + self._bending @ e - self._weight)
        total[-1, 0] -= self.load.force
        if self.load.moment != 0.0:
            x, y = nodes[-1, 1]
            total[-1, 1] -= self.load.moment * np.array([-y, x]) / (x * x + y * y)
        return total

    def hessian(self, nodes: Array) -> Array:
        """d2U/dnodes2 in scipy's lower banded form, (4 dim, unknowns)."""
        e = ancf.element_coordinates(nodes)
        size = 4 * self.dim
        tangent = ancf.axial_tangent(e, self.section.axial_stiffness, self.element)
        tangent += self._buckling.tangent(e)
        for axis in range(self.dim):
            tangent[:, :, axis, :, axis] += self._bending
        entries = tangent.reshape(-1, size, size)[:, self._lower[0], self._lower[1]]
        banded: Array = np.zeros(self._banded_shape)
        np.add.at(banded.ravel(), self._banded_index.ravel(), entries.ravel())
        if self.load.moment != 0.0:
            x, y = nodes[-1, 1]
            factor = self.load.moment / (x * x + y * y) ** 2
            banded[0, -2] -= factor * 2.0 * x * y
            banded[0, -1] += factor * 2.0 * x * y
            banded[1, -2] -= factor * (y * y - x * x)
        return banded


def _minimise(energy: _TetherEnergy, nodes: Array, free: NDArray[np.bool_]) -> Array:
    """Minimise by Levenberg-shifted Newton steps from `nodes`; only `free` coordinates change."""
    fixed = ~free.ravel()
    # slopes [-] times the element's length are comparable to positions [m]
    scale = np.ones_like(nodes)
    scale[:, 1] = energy.element
    weights = np.square(scale).ravel()
    shift = 0.0
    perturbations = _perturbations(nodes, free, energy.length)
    for _ in range(MAX_ITERATIONS):
        gradient = np.where(fixed, 0.0, energy.gradient(nodes).ravel())
        banded = energy.hessian(nodes)
        _decouple_fixed(banded, fixed)
        unit = float(np.max(banded[0] / weights))
        before = energy.value(nodes, nodes)
        while True:
            step, shift = _levenberg_step(banded, gradient, weights, shift, unit)
            largest = float(np.max(np.abs(step) * scale.ravel())) / energy.length
            trial = nodes + step.reshape(nodes.shape)
            if largest < STEP_TOLERANCE:
                if shift == 0.0:
                    return trial
                # stationary but not a minimum: perturb the unstable equilibrium
                perturbation = next(perturbations, None)
                if perturbation is None:
                    raise StaticsError("converged to an unstable equilibrium, not to a minimum")
                trial = nodes + perturbation
                break
            # 0.5 step.H.step = -0.5 gradient.step - 0.5 shift step.W.step, from the step's equation
            predicted = 0.5 * float(shift * (weights @ step**2) - gradient @ step)
            actual = before - energy.value(trial, nodes)
            if predicted <= ENERGY_NOISE * abs(before):
                # energy differences are rounding here; pure Newton steps converge
                shift = 0.0
                break
            ratio = actual / predicted if predicted > 0.0 else -1.0
            if ratio > 0.75:
                shift = shift / 8.0 if shift > 1e-12 * unit else 0.0
            elif ratio < 0.25:
                shift = max(4.0 * shift, 1e-12 * unit)
            if ratio > 0.05:
                break
            if shift > 1e6 * unit:
                raise StaticsError("no step that decreases the energy was found")
        nodes = trial
    raise StaticsError(
        f"not converged in {MAX_ITERATIONS} iterations; the last step was"
        f" {largest * energy.length:.3g} m"
    )


def _perturbations(nodes: Array, free: NDArray[np.bool_], length: float) -> Iterator[Array]:
    """Small reproducible perturbations of the free positions [m] in random directions."""
    generator = np.random.default_rng(0)
    for size in (1e-6, 1e-4):
        perturbation = np.zeros_like(nodes)
        perturbation[:, 0] = size * length * generator.uniform(-1.0, 1.0, nodes[:, 0].shape)
        yield np.where(free, perturbation, 0.0)


def _levenberg_step(
    banded: Array, gradient: Array, weights: Array, shift: float, unit: float
) -> tuple[Array, float]:
    """Solve (H + shift W) step = -gradient; raises the shift until the matrix is definite."""
    while True:
        shifted = banded.copy()
        shifted[0] += shift * weights
        try:
            factor = cholesky_banded(shifted, overwrite_ab=True, lower=True)
        except LinAlgError:
            shift = max(10.0 * shift, 1e-12 * unit)
            if shift > 1e6 * unit:
                raise StaticsError("the potential energy has no finite curvature") from None
            continue
        return np.asarray(cho_solve_banded((factor, True), -gradient)), shift


def _decouple_fixed(banded: Array, fixed: NDArray[np.bool_]) -> None:
    """Decouple the fixed unknowns from the others and give them a unit diagonal."""
    (indices,) = np.nonzero(fixed)
    width = banded.shape[0]
    for index in indices:
        banded[:, index] = 0.0
        for offset in range(1, min(width, index + 1)):
            banded[offset, index - offset] = 0.0
        banded[0, index] = 1.0


def _check_folds(nodes: Array, element: float) -> None:
    functions = ancf.slope_functions(np.linspace(0.0, 1.0, 9), element)
    stretch = np.linalg.norm(functions @ ancf.element_coordinates(nodes), axis=-1)
    smallest = float(np.min(stretch))
    unevenness = float(np.max(np.ptp(stretch, axis=-1)))
    if not (smallest >= SMALLEST_STRETCH and unevenness <= LARGEST_UNEVENNESS):
        raise StaticsError(
            f"the mesh folded: smallest |r'| {smallest:.3g} (limit {SMALLEST_STRETCH}), range"
            f" {unevenness:.3g} within an element (limit {LARGEST_UNEVENNESS}), and |r'| should be"
            " close to 1; start from an arc, or use more elements"
        )


def _default_start(
    length: float,
    elements: int,
    gravity: Array,
    root: ArrayLike,
    tip: ArrayLike | None,
    root_slope: ArrayLike | None,
    tip_force: Array,
) -> Array:
    start = np.asarray(root, dtype=np.float64)
    if tip is not None:
        distance = float(np.linalg.norm(np.asarray(tip, dtype=np.float64) - start))
        if distance < length:
            return arc_nodes(root, tip, elements, length, gravity)
        return straight_nodes(root, tip, elements, length)
    for direction in (root_slope, tip_force, gravity):
        if direction is not None and np.any(direction):
            along = np.asarray(direction, dtype=np.float64)
            end = start + length * along / np.linalg.norm(along)
            return straight_nodes(start, end, elements, length)
    raise ValueError("a tether with a free tip needs a clamp, a load or gravity for equilibrium")


def _angle_between(before: Array, after: Array) -> float:
    """Angle from one vector of the plane to another, in (-pi, pi]."""
    cross = before[0] * after[1] - before[1] * after[0]
    return float(np.arctan2(cross, before @ after))
