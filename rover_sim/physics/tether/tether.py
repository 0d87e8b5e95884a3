"""Tether data for compiled functions: constants, coordinates, energies and tensions.

The number of directions `dim` is the length of the gravity vector, a tuple, so the compiler knows
it. Coordinates and rates are arrays (2 dim, width): row k holds coordinate k of (r, r') of all
nodes, padded so that the last elements fill a packet. `to_rows` and `to_nodes` convert.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from rover_sim.physics.numerics.compiled import inner, kernel
from rover_sim.physics.numerics.simd import fill, lane, lane_count, load, stack
from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.ancf import GAUSS_WEIGHTS, Array
from rover_sim.physics.tether.buckling import buckling_strain, released_energy, relief
from rover_sim.physics.tether.tether_section import TetherSection

GAUSS = len(GAUSS_WEIGHTS)

# Slope at a quadrature point from the reduced basis: r' = sum_k SLOPES[g, k] (chord, r1', r2')_k,
# and r'' = sum_k CURVATURES[g, k] (chord, r1', r2')_k / l.
SLOPES = np.ascontiguousarray(ancf.slope_functions(ancf.GAUSS_POINTS, 1.0)[:, [2, 1, 3]])
CURVATURES = np.ascontiguousarray(ancf.curvature_functions(ancf.GAUSS_POINTS, 1.0)[:, [2, 1, 3]])


class Tether(NamedTuple):
    """A uniform tether; the length of `gravity` is the number of directions."""

    elements: int  # n
    element_length: float  # l [m]
    axial_stiffness: float  # EA [N]
    bending_stiffness: float  # EI [N m^2]
    line_density: float  # rho A [kg/m]
    axial_damping_time: float  # tau_a [s]
    bending_damping_time: float  # tau_b [s]
    numerical_damping: float  # x [-]
    buckling_strain: float  # c, see `buckling` [-]
    gravity: tuple[float, ...]  # [m/s^2]


@inner
def with_elements(tether: Tether, elements: int) -> Tether:
    """Copy of the tether with another number of elements of the same length."""
    return Tether(
        elements,
        tether.element_length,
        tether.axial_stiffness,
        tether.bending_stiffness,
        tether.line_density,
        tether.axial_damping_time,
        tether.bending_damping_time,
        tether.numerical_damping,
        tether.buckling_strain,
        tether.gravity,
    )


def make_tether(
    section: TetherSection,
    length: float,
    elements: int,
    gravity: tuple[float, ...],
    numerical_damping: float = 0.0,
) -> Tether:
    """Convert a tether's parameters to plain numbers for compiled functions.

    Args:
        section: cross-section.
        length: undeformed length of the tether [m].
        elements: their number.
        gravity: gravity vector [m/s^2]; two or three components choose the dimension.
        numerical_damping: x in [0, 1]; 0 conserves energy.
    """
    return Tether(
        int(elements),
        float(length / elements),
        float(section.axial_stiffness),
        float(section.bending_stiffness),
        float(section.line_density),
        float(section.axial_damping_time),
        float(section.bending_damping_time),
        float(numerical_damping),
        buckling_strain(section, length / elements, math.hypot(*gravity)),
        tuple(float(component) for component in gravity),
    )


def to_rows(nodes: Array) -> Array:
    """Coordinates or rates (n + 1, 2, dim) of nodes as rows (2 dim, width)."""
    count, _, dim = nodes.shape
    rows = np.zeros((2 * dim, row_width(count - 1, dim)))
    rows[:, :count] = nodes.reshape(count, 2 * dim).T
    return rows


def to_nodes(rows: Array, elements: int) -> Array:
    """Rows (2 dim, width) as coordinates or rates (n + 1, 2, dim) of nodes."""
    return np.ascontiguousarray(rows[:, : elements + 1].T).reshape(elements + 1, 2, -1)


@kernel
def row_width(elements: int, dim: int) -> int:
    """Number of columns of a row: whole packets of elements and one packet for the last nodes."""
    lanes = 4 if dim == 2 else 8
    return (elements + lanes - 1) // lanes * lanes + lanes


@inner
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


@inner
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


@inner
def linear_combination(
    a: float, x: tuple[float, ...], b: float, y: tuple[float, ...]
) -> tuple[float, ...]:
    """Linear combination a x + b y of two sets of six coefficients."""
    return (
        a * x[0] + b * y[0],
        a * x[1] + b * y[1],
        a * x[2] + b * y[2],
        a * x[3] + b * y[3],
        a * x[4] + b * y[4],
        a * x[5] + b * y[5],
    )


@inner
def element_product(
    c: tuple[float, ...], r1: Any, s1: Any, r2: Any, s2: Any
) -> tuple[Any, Any, Any, Any]:
    """Product of the element matrix with coefficients c and (r1, r1', r2, r2') of a direction."""
    return (
        c[0] * r1 + c[1] * s1 + c[3] * r2 + c[4] * s2,
        c[1] * r1 + c[2] * s1 - c[4] * r2 + c[5] * s2,
        c[3] * r1 - c[4] * s1 + c[0] * r2 - c[1] * s2,
        c[4] * r1 + c[5] * s1 - c[1] * r2 + c[2] * s2,
    )


@inner
def nodal_values(tag: Any, rows: Array, d: int, e: int) -> tuple[Any, Any, Any, Any]:
    """Direction d of (r1, r1', r2, r2') of the elements from e on, as packets."""
    dim = len(tag)
    return (
        load(tag, rows, (d, e)),
        load(tag, rows, (dim + d, e)),
        load(tag, rows, (d, e + 1)),
        load(tag, rows, (dim + d, e + 1)),
    )


@inner
def tether_energies(tether: Tether, q: Array, v: Array) -> tuple[float, float, float, float]:
    """Kinetic, gravity (zero at the origin's level), axial and bending energy [J]."""
    tag, dim, length = tether.gravity, len(tether.gravity), tether.element_length
    mass = mass_coefficients(tether)
    bending_matrix = bending_coefficients(tether)
    weight = tether.line_density * length
    lanes = lane_count(tag)
    kinetic, gravity, axial, bending = 0.0, 0.0, 0.0, 0.0
    for e in range(0, tether.elements, lanes):
        moving, falling, bent, stretched, mean = (
            fill(tag, 0.0),
            fill(tag, 0.0),
            fill(tag, 0.0),
            fill(tag, 0.0),
            fill(tag, 0.0),
        )
        basis = stack(tag, 9)
        for d in range(dim):
            r1, s1, r2, s2 = nodal_values(tag, v, d, e)
            p = element_product(mass, r1, s1, r2, s2)
            moving += r1 * p[0] + s1 * p[1] + r2 * p[2] + s2 * p[3]
            r1, s1, r2, s2 = nodal_values(tag, q, d, e)
            p = element_product(bending_matrix, r1, s1, r2, s2)
            bent += r1 * p[0] + s1 * p[1] + r2 * p[2] + s2 * p[3]
            falling += tag[d] * (0.5 * (r1 + r2) + (length / 12.0) * (s1 - s2))
            basis[3 * d] = (r2 - r1) * (1.0 / length)
            basis[3 * d + 1] = s1
            basis[3 * d + 2] = s2
        for g in range(GAUSS):
            square = fill(tag, -1.0)
            for d in range(dim):
                slope = (
                    SLOPES[g, 0] * basis[3 * d]
                    + SLOPES[g, 1] * basis[3 * d + 1]
                    + SLOPES[g, 2] * basis[3 * d + 2]
                )
                square += slope * slope
            stretched += (0.25 * GAUSS_WEIGHTS[g]) * square * square
            mean += (0.5 * GAUSS_WEIGHTS[g]) * square
        for w in range(lanes):
            if e + w < tether.elements:
                kinetic += 0.5 * lane(moving, w)
                bending += 0.5 * lane(bent, w)
                gravity -= weight * lane(falling, w)
                axial += lane(stretched, w)
                axial += 2.0 * released_energy(lane(mean, w), tether.buckling_strain)
    return kinetic, gravity, 0.5 * tether.axial_stiffness * length * axial, bending


@kernel
def element_tensions(tether: Tether, q: Array, v: Array, tensions: Array) -> None:
    """Write each element's tension [N] at a state: the mean of N |r'|.

    N = EA (eps + tau_a deps/dt) in tension; the law in compression is in `buckling`.
    """
    dim = len(tether.gravity)
    length = tether.element_length
    for e in range(tether.elements):
        mean, total, stretch = 0.0, 0.0, 0.0
        for g in range(GAUSS):
            square = 0.0
            rate = 0.0
            for d in range(dim):
                slope = (
                    SLOPES[g, 0] * (q[d, e + 1] - q[d, e]) / length
                    + SLOPES[g, 1] * q[dim + d, e]
                    + SLOPES[g, 2] * q[dim + d, e + 1]
                )
                slope_rate = (
                    SLOPES[g, 0] * (v[d, e + 1] - v[d, e]) / length
                    + SLOPES[g, 1] * v[dim + d, e]
                    + SLOPES[g, 2] * v[dim + d, e + 1]
                )
                square += slope * slope
                rate += slope * slope_rate
            strain = 0.5 * (square - 1.0) + tether.axial_damping_time * rate
            mean += GAUSS_WEIGHTS[g] * strain * np.sqrt(square)
            total += GAUSS_WEIGHTS[g] * strain
            stretch += GAUSS_WEIGHTS[g] * np.sqrt(square)
        mean += relief(total, tether.buckling_strain) * stretch
        tensions[e] = tether.axial_stiffness * mean


def nodal_tensions(tensions: Array) -> Array:
    """Tensions of the elements (n,) as tensions at the nodes (n + 1,) [N].

    An element's tension belongs to its midpoint: a node between two elements gets their mean, the
    end nodes are extrapolated.
    """
    if tensions.size == 1:
        return np.repeat(tensions, 2)
    inner = 0.5 * (tensions[:-1] + tensions[1:])
    first = 1.5 * tensions[0] - 0.5 * tensions[1]
    last = 1.5 * tensions[-1] - 0.5 * tensions[-2]
    return np.concatenate([[first], inner, [last]])
