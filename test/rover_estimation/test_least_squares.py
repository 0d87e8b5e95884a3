"""The search and the covariances, against closed forms."""

from collections.abc import Callable

import numpy as np
import pytest

from rover_estimation import (
    UNOBSERVABLE,
    Floats,
    grouped_gradients,
    inverse_curvature,
    minimise,
    sandwich,
)

TIMES = np.linspace(0.0, 4.0, 60)
DESIGN = np.stack([np.ones(60), TIMES, TIMES**2], axis=1)


def decay(x: Floats) -> Floats:
    """Residuals of an exponential decay that x = (2, 0.5) explains."""
    return np.asarray(x[0] * np.exp(-x[1] * TIMES) - 2.0 * np.exp(-0.5 * TIMES))


def decay_slopes(x: Floats) -> Floats:
    curve = np.exp(-x[1] * TIMES)
    return np.stack([curve, -x[0] * TIMES * curve], axis=1)


def test_a_linear_problem_ends_at_the_normal_equations():
    read = np.random.default_rng(1).normal(0.0, 1.0, 60)
    found = minimise(
        lambda x: DESIGN @ x - read, np.zeros(3), np.ones(3), evaluations=20, tolerance=1e-12
    )
    exact = np.linalg.solve(DESIGN.T @ DESIGN, DESIGN.T @ read)
    assert found.converged
    np.testing.assert_allclose(found.x, exact, atol=1e-9)
    np.testing.assert_allclose(
        inverse_curvature(found.jacobian), np.linalg.inv(DESIGN.T @ DESIGN), rtol=1e-6
    )


@pytest.mark.parametrize("derivatives", [None, decay_slopes])
def test_the_search_finds_the_decay_with_given_or_with_differenced_derivatives(
    derivatives: Callable[[Floats], Floats] | None,
):
    found = minimise(
        decay, np.array([1.0, 1.5]), np.ones(2), derivatives=derivatives, evaluations=30
    )
    assert found.converged
    assert found.x == pytest.approx([2.0, 0.5], abs=1e-4)
    assert found.gain < 1e-6


def test_a_search_that_runs_out_of_points_has_not_converged_and_promises_a_gain():
    found = minimise(decay, np.array([1.0, 1.5]), np.ones(2), evaluations=2)
    assert not found.converged
    assert found.gain > 1e-3


def test_a_bound_is_kept_also_by_the_points_of_the_differences():
    tried = []

    def residuals(x: Floats) -> Floats:
        tried.append(x.copy())
        return decay(x)

    found = minimise(
        residuals,
        np.array([1.0, 0.3]),
        np.ones(2),
        bounds=(-np.inf, np.array([1.5, 9.0])),
        evaluations=30,
    )
    assert found.x[0] == pytest.approx(1.5, abs=1e-3)
    assert max(x[0] for x in tried) <= 1.5


def test_an_outlier_counts_less_with_the_robust_loss():
    read = DESIGN @ [1.0, -0.5, 0.1]
    read[10] += 100.0
    near, far = (
        minimise(lambda x: DESIGN @ x - read, np.zeros(3), np.ones(3), loss=loss, evaluations=60)
        for loss in ("soft_l1", "linear")
    )
    assert abs(near.x[0] - 1.0) < 0.2 < abs(far.x[0] - 1.0)


def test_a_direction_without_effect_has_a_large_variance():
    jacobian = np.stack([TIMES, 2.0 * TIMES], axis=1)
    variance = inverse_curvature(jacobian)
    along, across = np.array([1.0, 2.0]), np.array([2.0, -1.0])
    assert across @ variance @ across == pytest.approx(5.0 / UNOBSERVABLE**2, rel=1e-6)
    assert along @ variance @ along == pytest.approx(5.0 / (5.0 * TIMES @ TIMES), rel=1e-4)


def test_gradients_are_summed_over_groups():
    residuals = np.array([1.0, 2.0, 3.0])
    jacobian = np.array([[1.0, 0.0], [0.0, 1.0], [2.0, 2.0]])
    sums = grouped_gradients(jacobian, residuals, np.array([0, 0, 1]))
    assert sums.tolist() == [[1.0, 2.0], [6.0, 6.0]]


def test_the_sandwich_holds_the_scatter_of_means_of_correlated_readings():
    generator = np.random.default_rng(3)
    groups = np.repeat(np.arange(200), 10)
    ones = np.ones((2000, 1))
    bread = inverse_curvature(ones)
    means, errors = [], []
    for _ in range(200):
        read = np.repeat(generator.normal(0.0, 1.0, 200), 10)
        means.append(read.mean())
        gradients = grouped_gradients(ones, read.mean() - read, groups)
        errors.append(np.sqrt(sandwich(bread, gradients)[0, 0]))
    # The standard error of 200 independent values; without groups it would be 0.022.
    assert np.mean(errors) == pytest.approx(1.0 / np.sqrt(200), rel=0.05)
    assert np.std(means) == pytest.approx(np.mean(errors), rel=0.2)


def test_costly_derivatives_are_seldom_computed():
    computed = []

    def slopes(x: Floats) -> Floats:
        computed.append(x)
        return decay_slopes(x)

    def found(*, costly: bool) -> tuple[Floats, int]:
        computed.clear()
        start = np.array([1.5, 0.9])
        end = minimise(decay, start, np.ones(2), derivatives=slopes, costly=costly, evaluations=40)
        assert end.converged
        return end.x, len(computed)

    (exact, every), (corrected, few) = found(costly=False), found(costly=True)
    assert corrected == pytest.approx(exact, abs=1e-4)
    assert few < every
