"""Static equilibrium of the tether: the minimum of its potential energy; see `static_minimum`."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_sim.physics.tether import ancf, static_minimum
from rover_sim.physics.tether.ancf import Array
from rover_sim.physics.tether.buckling import buckling_strain
from rover_sim.physics.tether.starting_shapes import arc_nodes, straight_nodes
from rover_sim.physics.tether.static_minimum import StaticLaw, make_work, minimise
from rover_sim.physics.tether.tether_section import TetherSection

SMALLEST_STRETCH = 0.9
LARGEST_UNEVENNESS = 0.15
"""A smaller |r'| anywhere, or a larger range of |r'| within an element, is a fold or kink that
the mesh cannot resolve and not a shape of a thin tether [-]."""

MAX_ITERATIONS = 2000

_REASONS = {
    static_minimum.UNSTABLE: "converged to an unstable equilibrium, not to a minimum",
    static_minimum.NO_DECREASE: "no step that decreases the energy was found",
    static_minimum.NO_CURVATURE: "the potential energy has no finite curvature",
}


class StaticsError(RuntimeError):
    """No valid equilibrium was found; the message states the cause."""


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
    force = np.zeros(dim) if tip_force is None else np.array(tip_force, dtype=np.float64)
    if dim == 3 and tip_moment != 0.0:
        raise ValueError("tip_moment: must be 0 in space; it is defined for the plane only")
    if force.shape != (dim,):
        raise ValueError(f"tip_force: must have {dim} components, like gravity")
    if start_nodes is None:
        nodes = _default_start(length, elements, pull, root, tip, root_slope, force)
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

    _minimise(_law(section, length / elements, pull, force, float(tip_moment)), nodes, free)
    _check_folds(nodes, length / elements)
    return nodes


def nodal_forces(nodes: Array, section: TetherSection, length: float, gravity: ArrayLike) -> Array:
    """External generalised forces on the nodes that keep the tether at rest.

    Elastic forces minus weight, (n + 1, 2, dim): [i, 0] is a force [N], [i, 1] is work
    per slope [N m]. In equilibrium it is zero at a free and unloaded node; at the root it
    is the support's reaction.
    """
    law, work = static_problem(nodes, section, length, gravity)
    static_minimum.derivatives(law, np.ascontiguousarray(nodes), work)
    return work.gradient.reshape(nodes.shape)


def static_problem(
    nodes: Array, section: TetherSection, length: float, gravity: ArrayLike
) -> tuple[StaticLaw, static_minimum.MinimumWork]:
    """Law without loads, and work arrays."""
    pull = np.asarray(gravity, dtype=np.float64)
    elements = nodes.shape[0] - 1
    law = _law(section, length / elements, pull, np.zeros(pull.size), 0.0)
    return law, make_work(elements, pull.size)


def _law(
    section: TetherSection, element: float, gravity: Array, force: Array, moment: float
) -> StaticLaw:
    functions = ancf.slope_functions(ancf.GAUSS_POINTS, element)
    return StaticLaw(
        element_length=element,
        axial_stiffness=section.axial_stiffness * element,
        buckling_limit=buckling_strain(section, element, float(np.linalg.norm(gravity))),
        functions=functions,
        gauss_weights=ancf.GAUSS_WEIGHTS,
        mean=np.ascontiguousarray((functions.T * ancf.GAUSS_WEIGHTS) @ functions),
        bending=ancf.bending_matrix(section.bending_stiffness, element),
        weight=np.outer(ancf.load_vector(section.line_density, element), gravity),
        force=force,
        moment=moment,
    )


def _minimise(law: StaticLaw, nodes: Array, free: NDArray[np.bool_]) -> None:
    """Move the free coordinates of the nodes, in place, to a minimum of the energy."""
    weights = np.ones_like(nodes)
    # slopes [-] times the element's length are comparable to positions [m]
    weights[:, 1] = law.element_length**2
    elements, dim = nodes.shape[0] - 1, nodes.shape[2]
    work = make_work(elements, dim)
    perturbations = _perturbations(nodes, free, law.element_length * elements)
    shift, left = 0.0, MAX_ITERATIONS
    while True:
        found = minimise(law, nodes, ~free.ravel(), weights.ravel(), work, shift, left)
        if found.end == static_minimum.CONVERGED:
            return
        if found.end == static_minimum.UNSTABLE:
            # stationary but not a minimum: perturb the unstable equilibrium
            perturbation = next(perturbations, None)
            if perturbation is not None:
                nodes += perturbation
                shift, left = found.shift, left - found.iterations
                continue
        raise StaticsError(
            _REASONS.get(
                found.end,
                f"not converged in {MAX_ITERATIONS} iterations; the last step was"
                f" {found.last_step:.3g} m",
            )
        )


def _perturbations(nodes: Array, free: NDArray[np.bool_], length: float) -> Iterator[Array]:
    """Small reproducible perturbations of the free positions [m] in random directions."""
    generator = np.random.default_rng(0)
    for size in (1e-6, 1e-4):
        perturbation = np.zeros_like(nodes)
        perturbation[:, 0] = size * length * generator.uniform(-1.0, 1.0, nodes[:, 0].shape)
        yield np.where(free, perturbation, 0.0)


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
