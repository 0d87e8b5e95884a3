"""Thin ANCF cable element: shape functions, quadrature and constant terms.

An element of undeformed length l carries e = (r1, r1', r2, r2'), positions [m] and slopes
r' = dr/dx [-] of its two nodes in the plane or in space, and interpolates r(x) = S(x) e with
cubic Hermite polynomials (Gerstmayr and Shabana 2006, Nonlinear Dynamics 45, thin beam element;
in the plane Berzeri and Shabana 2000, J. Sound and Vibration 235(4)). Its energies are

- bending, model T1 of Berzeri and Shabana: U = 1/2 int EI |r''|^2 dx, so K_t is constant;
- axial, model L2: U = 1/2 int EA eps^2 dx with Green's strain eps = (r'.r' - 1)/2.

Arrays of element coordinates have the shape (..., 4, dim), those of nodes (n + 1, 2, dim).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Gauss-Legendre rule with five points on [0, 1]; exact to degree 9, the L2 forces have degree 8.
_points, _weights = np.polynomial.legendre.leggauss(5)
GAUSS_POINTS: Array = (1.0 + _points) / 2.0
GAUSS_WEIGHTS: Array = _weights / 2.0


def shape_functions(xi: ArrayLike, length: float) -> Array:
    """S(xi), so that r = S e; xi = x/l in [0, 1]. Shape xi.shape + (4,), units (1, m, 1, m)."""
    t = np.asarray(xi, dtype=np.float64)
    return np.stack(
        [
            1.0 - 3.0 * t**2 + 2.0 * t**3,
            length * (t - 2.0 * t**2 + t**3),
            3.0 * t**2 - 2.0 * t**3,
            length * (t**3 - t**2),
        ],
        axis=-1,
    )


def slope_functions(xi: ArrayLike, length: float) -> Array:
    """S'(xi) = dS/dx, so that r' = S' e. Shape xi.shape + (4,), units (1/m, 1, 1/m, 1)."""
    t = np.asarray(xi, dtype=np.float64)
    chord = 6.0 * (t - t**2) / length
    return np.stack([-chord, 1.0 - 4.0 * t + 3.0 * t**2, chord, 3.0 * t**2 - 2.0 * t], axis=-1)


def curvature_functions(xi: ArrayLike, length: float) -> Array:
    """S''(xi) = d2S/dx2, so that r'' = S'' e. Shape xi.shape + (4,), units (1/m2, 1/m, ...)."""
    t = np.asarray(xi, dtype=np.float64)
    chord = (6.0 - 12.0 * t) / length**2
    return np.stack([-chord, (6.0 * t - 4.0) / length, chord, (6.0 * t - 2.0) / length], axis=-1)


def bending_matrix(bending_stiffness: float, length: float) -> Array:
    """K_t = int EI S''^T S'' dx, (4, 4); the bending force on the nodes' coordinates is K_t e."""
    l1, l2 = length, length**2
    return (bending_stiffness / length**3) * np.array(
        [
            [12.0, 6.0 * l1, -12.0, 6.0 * l1],
            [6.0 * l1, 4.0 * l2, -6.0 * l1, 2.0 * l2],
            [-12.0, -6.0 * l1, 12.0, -6.0 * l1],
            [6.0 * l1, 2.0 * l2, -6.0 * l1, 4.0 * l2],
        ]
    )


def load_vector(line_density: float, length: float) -> Array:
    """Load vector int rhoA S dx, (4,) [kg, kg m, ...]; times gravity it is the nodal force."""
    return line_density * length * np.array([0.5, length / 12.0, 0.5, -length / 12.0])


def element_coordinates(nodes: Array) -> Array:
    """Element coordinates e (n, 4, dim) of nodes (n + 1, 2, dim)."""
    return np.concatenate([nodes[:-1], nodes[1:]], axis=1)
