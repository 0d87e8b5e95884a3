"""Rare events: estimates against closed forms, their intervals, and what they report otherwise."""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import gammaincc, ndtr
from scipy.stats import chi2, multivariate_normal

from rover_studies.sweep.rare_event import (
    Floats,
    Method,
    Mixture,
    RareEvent,
    RareEventEstimate,
    RareEventOutcome,
    Round,
    advance,
    fit_mixture,
    points_of,
)

Quantity = Callable[[Floats], Floats]
BETA = 3.090232306167813  # exceeded by a standard normal value with probability 1e-3


def event(limit: float, **changes: Any) -> RareEvent:
    values = {
        "quantity": "q",
        "limit": limit,
        "above": True,
        "relative_error": 0.2,
        "max_runs": 10_000,
        "method": Method.IMPORTANCE_SAMPLING,
    }
    return RareEvent(**{**values, **changes})


def estimate(of: RareEvent, quantity: Quantity, dimension: int, seed: int) -> RareEventEstimate:
    rounds = [Round.first(of, dimension)]
    quantities = np.empty(0)
    while True:
        fresh = points_of(rounds, seed)[len(quantities) :]
        quantities = np.concatenate([quantities, quantity(fresh)])
        step = advance(of, rounds, quantities, seed)
        if isinstance(step, RareEventEstimate):
            return step
        rounds.append(step)


def linear(points: Floats) -> Floats:
    """Standard normal in any dimension."""
    return np.asarray(points.sum(axis=1) / math.sqrt(points.shape[1]))


def both_sides(points: Floats) -> Floats:
    """Fails in two regions of which one is met by lower levels first."""
    return np.maximum(points[:, 0], -points[:, 0] - 0.3)


def exponentials(points: Floats) -> Floats:
    """Sum of exponentially distributed values."""
    return np.asarray(-np.log(ndtr(-points)).sum(axis=1))


def corner(points: Floats) -> Floats:
    """The smaller one of two uniform values, with more values of no influence."""
    return np.asarray(ndtr(points[:, :2]).min(axis=1))


def cliff(points: Floats) -> Floats:
    """Jumps by ten where the first value exceeds two."""
    return np.where(points[:, 0] > 2.0, 10.0 + points[:, 1], points[:, 0])


def radius(points: Floats) -> Floats:
    """Fails in all directions."""
    return np.asarray(np.sum(points**2, axis=1))


CLOSED_FORMS: list[tuple[Quantity, int, float, float]] = [
    (linear, 1, BETA, 1e-3),
    (linear, 4, BETA, 1e-3),
    (linear, 10, BETA, 1e-3),
    (linear, 3, 4.753424308822899, 1e-6),
    (both_sides, 2, BETA, 1e-3 + float(ndtr(-BETA - 0.3))),
    (both_sides, 5, BETA, 1e-3 + float(ndtr(-BETA - 0.3))),
    (exponentials, 5, 14.0, float(gammaincc(5, 14.0))),
    (corner, 4, 0.97, 0.03**2),
    (cliff, 3, 11.7, float(ndtr(-2.0) * ndtr(-1.7))),
    (radius, 3, 16.0, float(chi2.sf(16.0, 3))),
]


@pytest.mark.parametrize(("quantity", "dimension", "limit", "exact"), CLOSED_FORMS)
def test_intervals_hold_the_closed_form_as_often_as_they_state(
    quantity: Quantity, dimension: int, limit: float, exact: float
):
    found = [estimate(event(limit), quantity, dimension, seed) for seed in range(40)]
    assert {one.outcome for one in found} == {RareEventOutcome.ESTIMATED}
    held = sum(one.low <= exact <= one.high for one in found)
    # 34 of 40: less happens to an interval of 95 % with a probability of 0.3 %.
    assert held >= 34, [one.probability for one in found]
    mean = float(np.mean([one.probability for one in found if one.probability is not None]))
    assert mean == pytest.approx(exact, rel=0.05)
    # Monte Carlo needs (1.96 / log(1.2))^2 (1 - p) / p runs.
    monte_carlo = (1.96 / math.log(1.2)) ** 2 / exact
    assert np.median([one.runs for one in found]) <= 0.1 * monte_carlo
    for one in found:
        assert one.probability is not None
        assert one.high <= 1.2 * one.probability


def test_an_event_below_a_limit_is_the_mirrored_one():
    def mirrored(points: Floats) -> Floats:
        return -linear(points)

    above = estimate(event(BETA), linear, 3, 1)
    below = estimate(event(-BETA, above=False), mirrored, 3, 1)
    assert below.probability == above.probability
    assert below.levels == tuple(-level for level in above.levels)
    assert below.design_run == above.design_run


def test_monte_carlo_gives_its_interval_and_stops_when_it_is_narrow_enough():
    limit, exact = 1.6448536269514722, 0.05
    of = event(limit, method=Method.MONTE_CARLO, max_runs=100_000)
    found = [estimate(of, linear, 2, seed) for seed in range(60)]
    assert {one.outcome for one in found} == {RareEventOutcome.ESTIMATED}
    assert sum(one.low <= exact <= one.high for one in found) >= 52
    needed = (1.96 / math.log(1.2)) ** 2 * (1.0 - exact) / exact
    assert np.median([one.runs for one in found]) == pytest.approx(needed, rel=0.15)
    assert all(one.runs == one.counted_runs for one in found)


def test_a_probability_that_is_not_small_needs_no_levels():
    found = estimate(event(0.0), linear, 2, 1)
    assert found.outcome is RareEventOutcome.ESTIMATED
    assert found.low <= 0.5 <= found.high
    assert found.levels == (0.0,)


def test_the_design_run_is_near_the_most_probable_failing_point():
    of = event(BETA)
    rounds, quantities = [Round.first(of, 2)], np.empty(0)
    while True:
        points = points_of(rounds, 1)
        quantities = linear(points)
        step = advance(of, rounds, quantities, 1)
        if isinstance(step, RareEventEstimate):
            break
        rounds.append(step)
    assert step.design_run is not None
    assert points[step.design_run] == pytest.approx(np.full(2, BETA / math.sqrt(2.0)), abs=0.3)


@pytest.mark.parametrize("method", list(Method))
def test_a_limit_that_the_quantity_never_reaches_is_reported(method: Method):
    def saturated(points: Floats) -> Floats:
        return np.minimum(linear(points), 2.0)

    found = estimate(event(3.0, method=method), saturated, 2, 1)
    assert found.outcome is RareEventOutcome.NOT_REACHED
    assert found.probability is None
    assert found.nearest == 2.0
    assert found.design_run is None
    nominal = 10_000 if method is Method.MONTE_CARLO else 2500
    assert found.high == pytest.approx(3.0 / nominal, rel=0.01)


def test_too_few_runs_for_the_levels_are_reported():
    found = estimate(event(12.0, max_runs=1000), linear, 2, 1)
    assert found.outcome is RareEventOutcome.NOT_REACHED
    assert 800 < found.runs <= 1000
    assert found.nearest == pytest.approx(found.levels[-1], abs=3.0)


def test_too_few_runs_for_the_error_are_reported_with_their_interval():
    found = [
        estimate(event(16.0, max_runs=2000, relative_error=0.05), radius, 3, seed)
        for seed in range(40)
    ]
    assert {one.outcome for one in found} == {RareEventOutcome.RUNS_EXHAUSTED}
    assert {one.runs for one in found} == {2000}
    exact = float(chi2.sf(16.0, 3))
    assert sum(one.low <= exact <= one.high for one in found) >= 34


def test_runs_without_a_result_are_no_events_but_reported():
    def broken(points: Floats) -> Floats:
        return np.where(points[:, 1] > 2.0, np.nan, points[:, 0])

    found = estimate(event(BETA), broken, 2, 1)
    assert found.outcome is RareEventOutcome.RUNS_FAILED
    assert found.failed_probability == pytest.approx(float(ndtr(-2.0)), rel=0.5)
    assert found.probability == pytest.approx(1e-3 * float(ndtr(2.0)), rel=0.2)


def test_without_any_result_nothing_is_estimated():
    found = estimate(event(1.0), lambda points: np.full(len(points), np.nan), 2, 1)
    assert found.outcome is RareEventOutcome.NOT_REACHED
    assert found.nearest is None
    assert found.runs == 2500


def test_a_region_that_no_level_approaches_is_found_if_the_first_round_sees_it():
    """A second region, which the quantity does not announce, away from the first one."""

    def island(points: Floats) -> Floats:
        return np.where((points[:, 1] < -BETA) & (points[:, 0] < 0.0), 10.0, points[:, 0])

    of, first, exact = event(BETA), 1e-3, 1e-3 + 0.5e-3
    seen: list[RareEventEstimate] = []
    others: list[RareEventEstimate] = []
    for seed in range(60):
        hit = bool(np.any(island(points_of([Round.first(of, 2)], seed)) == 10.0))
        (seen if hit else others).append(estimate(of, island, 2, seed))
    assert len(seen) >= 30
    assert sum(one.low <= exact <= one.high for one in seen) >= 0.86 * len(seen)
    # Wide tails find it as well, if not always; missed, it is below the limit that is stated.
    missed = [one for one in others if one.high < exact]
    assert 0 < len(missed) < len(others)
    assert sum(one.low <= first <= one.high for one in missed) >= 0.8 * len(missed)
    assert missed[0].unseen_limit == pytest.approx(3.0 / 2500, rel=0.01)


def test_a_mixture_has_the_density_from_which_it_draws():
    mixture = Mixture(
        np.array([0.3, 0.7]),
        np.array([[1.0, -2.0], [0.0, 3.0]]),
        np.array([[[2.0, 0.5], [0.5, 1.0]], [[0.3, -0.1], [-0.1, 0.6]]]),
    )
    place = np.array([[0.4, 1.5], [1.0, -2.0]])
    expected = [
        np.log(
            0.3 * multivariate_normal.pdf(one, mixture.means[0], mixture.covariances[0])
            + 0.7 * multivariate_normal.pdf(one, mixture.means[1], mixture.covariances[1])
        )
        for one in place
    ]
    assert mixture.log_density(place) == pytest.approx(expected)
    points = mixture.draw(np.random.default_rng(1), 40_000)
    # The mean over draws of another density over this one is 1.
    other = multivariate_normal.pdf(points, [0.5, 1.0], np.diag([0.5, 0.5]))
    assert np.mean(other / np.exp(mixture.log_density(points))) == pytest.approx(1.0, abs=0.03)


def test_a_fit_finds_the_mixture_of_weighted_points():
    generator = np.random.default_rng(2)
    true = Mixture(
        np.array([0.2, 0.8]),
        np.array([[4.0, 0.0], [-3.0, 1.0]]),
        np.array([np.eye(2) * 0.5, np.diag([1.0, 0.2])]),
    )
    points = generator.uniform(-7.0, 7.0, (20_000, 2))
    found = fit_mixture(points, np.exp(true.log_density(points)), generator)
    # Components beyond the two share them; the density is what counts.
    fresh = true.draw(generator, 4000)
    divergence = np.mean(true.log_density(fresh) - found.log_density(fresh))
    assert abs(divergence) < 0.03


def test_a_fit_of_few_or_equal_points_is_a_density():
    generator = np.random.default_rng(3)
    for points in (np.array([[1.0, 2.0, 3.0]]), np.ones((200, 3))):
        found = fit_mixture(points, np.ones(len(points)), generator)
        assert np.all(np.isfinite(found.log_density(points)))
        assert np.all(np.linalg.eigvalsh(found.covariances) > 0.0)


def test_a_round_is_the_same_after_storage():
    generator = np.random.default_rng(4)
    proposal = fit_mixture(generator.standard_normal((100, 3)), np.ones(100), generator)
    one = Round(50, proposal.with_wide_tails(), 1.0 / 3.0, counted=True)
    again = Round.from_mapping(json.loads(json.dumps(one.to_mapping())))
    assert (again.runs, again.level, again.counted) == (50, 1.0 / 3.0, True)
    assert np.array_equal(points_of([one], 1), points_of([again], 1))
