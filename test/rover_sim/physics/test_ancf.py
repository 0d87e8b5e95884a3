import numpy as np
import pytest
from mass_matrix import mass_matrix

from rover_sim.physics.tether import ancf
from rover_sim.physics.tether.statics import nodal_forces
from rover_sim.physics.tether.tether_section import TetherSection

LENGTH = 0.7
RNG = np.random.default_rng(1)


def polynomial_integral(values: np.ndarray, length: float) -> np.ndarray:
    """Integral over the element of samples at 20 Gauss points (an independent, finer rule)."""
    _, weights = np.polynomial.legendre.leggauss(20)
    return np.tensordot(length * weights / 2.0, values, axes=1)


def fine_points() -> np.ndarray:
    return (1.0 + np.polynomial.legendre.leggauss(20)[0]) / 2.0


def test_shape_functions_interpolate_a_cubic_exactly() -> None:
    poly = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7])
    e = np.array([[poly(x), poly.deriv()(x)] for x in (0.0, LENGTH)]).reshape(4)
    xi = np.linspace(0.0, 1.0, 7)
    assert ancf.shape_functions(xi, LENGTH) @ e == pytest.approx(poly(xi * LENGTH))
    assert ancf.slope_functions(xi, LENGTH) @ e == pytest.approx(poly.deriv()(xi * LENGTH))
    assert ancf.curvature_functions(xi, LENGTH) @ e == pytest.approx(poly.deriv(2)(xi * LENGTH))


def test_constant_matrices_are_the_integrals_of_the_shape_functions() -> None:
    xi = fine_points()
    shape = ancf.shape_functions(xi, LENGTH)
    curvature = ancf.curvature_functions(xi, LENGTH)
    mass = polynomial_integral(2.0 * shape[:, :, None] * shape[:, None, :], LENGTH)
    bending = polynomial_integral(3.0 * curvature[:, :, None] * curvature[:, None, :], LENGTH)
    assert mass_matrix(2.0, LENGTH) == pytest.approx(mass, rel=1e-12)
    assert ancf.bending_matrix(3.0, LENGTH) == pytest.approx(bending, rel=1e-12, abs=1e-12)
    assert ancf.load_vector(2.0, LENGTH) == pytest.approx(polynomial_integral(2.0 * shape, LENGTH))


def test_five_points_integrate_the_axial_force_exactly() -> None:
    nodes = RNG.normal(size=(2, 2, 2))
    functions = ancf.slope_functions(fine_points(), LENGTH)
    slopes = functions @ ancf.element_coordinates(nodes)[0]
    strain = 0.5 * (np.sum(slopes**2, axis=-1) - 1.0)
    fine = polynomial_integral(
        5.0 * functions[:, :, None] * (strain[:, None] * slopes)[:, None, :], LENGTH
    )
    section = TetherSection(axial_stiffness=5.0, bending_stiffness=0.0, line_density=1.0)
    force = nodal_forces(nodes, section, LENGTH, (0.0, 0.0))
    assert force.reshape(4, 2) == pytest.approx(fine, rel=1e-12)


def test_elements_have_the_coordinates_of_their_nodes() -> None:
    nodes = RNG.normal(size=(4, 2, 3))
    e = ancf.element_coordinates(nodes)
    assert e.shape == (3, 4, 3)
    assert np.array_equal(e[1, 2:], nodes[2])
