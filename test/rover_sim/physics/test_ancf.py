import numpy as np
import pytest

from rover_sim.physics.tether import ancf

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
    assert ancf.mass_matrix(2.0, LENGTH) == pytest.approx(mass, rel=1e-12)
    assert ancf.bending_matrix(3.0, LENGTH) == pytest.approx(bending, rel=1e-12, abs=1e-12)
    assert ancf.load_vector(2.0, LENGTH) == pytest.approx(polynomial_integral(2.0 * shape, LENGTH))


@pytest.mark.parametrize("dim", [2, 3])
def test_force_is_the_gradient_of_the_energy_and_tangent_that_of_the_force(dim: int) -> None:
    e = RNG.normal(size=(4, dim))
    force = ancf.axial_force(e, 5.0, LENGTH)
    tangent = ancf.axial_tangent(e, 5.0, LENGTH)
    step = 1e-6
    for a in range(4):
        for i in range(dim):
            d = np.zeros((4, dim))
            d[a, i] = step
            energy = [ancf.axial_energy(e + s * d, 5.0, LENGTH) for s in (-1, 1)]
            forces = [ancf.axial_force(e + s * d, 5.0, LENGTH) for s in (-1, 1)]
            assert (energy[1] - energy[0]) / (2 * step) == pytest.approx(force[a, i], rel=1e-6)
            assert (forces[1] - forces[0]) / (2 * step) == pytest.approx(
                tangent[:, :, a, i], rel=1e-5, abs=1e-5 * np.abs(tangent).max()
            )


def test_five_points_integrate_the_axial_force_exactly() -> None:
    e = RNG.normal(size=(4, 2))
    functions = ancf.slope_functions(fine_points(), LENGTH)
    slopes = functions @ e
    strain = ancf.green_strain(e, LENGTH, fine_points())
    fine = polynomial_integral(
        5.0 * functions[:, :, None] * (strain[:, None] * slopes)[:, None, :], LENGTH
    )
    assert ancf.axial_force(e, 5.0, LENGTH) == pytest.approx(fine, rel=1e-12)


@pytest.mark.parametrize("angle", [0.3, 2.0, -3.0])
def test_rigid_motion_gives_no_force(angle: float) -> None:
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    e = np.array([[0.0, 0.0], [1.0, 0.0], [LENGTH, 0.0], [1.0, 0.0]]) @ rotation.T
    e[[0, 2]] += (3.0, -2.0)
    assert ancf.axial_force(e, 1e4, LENGTH) == pytest.approx(np.zeros((4, 2)), abs=1e-10)
    assert ancf.bending_matrix(1e4, LENGTH) @ e == pytest.approx(np.zeros((4, 2)), abs=1e-9)
    assert ancf.bending_energy(e, 1e4, LENGTH) == pytest.approx(0.0, abs=1e-9)


def test_elements_and_nodes_round_trip() -> None:
    nodes = RNG.normal(size=(4, 2, 3))
    e = ancf.element_coordinates(nodes)
    assert e.shape == (3, 4, 3)
    assert np.array_equal(e[1, 2:], nodes[2])
    counts = ancf.assemble_nodes(np.ones_like(e))[:, 0, 0]
    assert counts.tolist() == [1.0, 2.0, 2.0, 1.0]
