"""Probability of a rare event by importance sampling, where each run has a vector of random values.

The random values of a run are functions of independent standard normal values, its *point*. In
rounds of runs, the proposal density of the points approaches the failing region by the
cross-entropy method (Rubinstein and Kroese, The Cross-Entropy Method, 2004) with Gaussian mixtures
(Kurtz and Song, Structural Safety 42, 2013). A round's level is the quantity that a tenth of its
runs reach; the next proposal is the mixture of greatest likelihood for all runs beyond that level,
each weighted by the balance heuristic (Veach and Guibas, SIGGRAPH 1995).

When a tenth of a round fails, the proposal is kept, mixed with those of all rounds (defensive
mixture: Hesterberg, Technometrics 37, 1995), so that no weight exceeds the number of rounds over
`_DEFENSIVE_SHARE`. Only runs from that proposal enter the estimate: it has no bias from the
adaptation. A failing region that is neither seen by the first round nor approached by a level is
missed, except for the defensive runs; `RareEventEstimate.unseen_limit` bounds its probability.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, logsumexp

Floats = NDArray[np.float64]

MOST_VALUES: Final = 10
"""Largest dimension; beyond, intervals from as few runs are too narrow."""
_FIRST_RUNS: Final = 2500  # more than a level needs, to see regions that levels do not approach
_LEVEL_RUNS: Final = 1000
_LEVEL_SHARE: Final = 0.1
_MOST_COMPONENTS: Final = 4
_RUNS_PER_UNKNOWN: Final = 10  # effective runs of a component, over the dimension plus one
_PRIOR_RUNS: Final = 2.0  # weight of the unit covariance, as a number of runs
_WIDE_SHARE: Final = 0.4
_WIDE_FACTOR: Final = 3.0  # of the covariance
_DEFENSIVE_SHARE: Final = 0.2
_EM_STEPS: Final = 100
_EM_TOLERANCE: Final = 1e-4
_Z95: Final = 1.959964


class Method(StrEnum):
    """How the points are drawn."""

    IMPORTANCE_SAMPLING = "importance_sampling"
    MONTE_CARLO = "monte_carlo"


class RareEventOutcome(StrEnum):
    """Whether the probability is known as exactly as required."""

    ESTIMATED = "estimated"
    RUNS_EXHAUSTED = "runs_exhausted"
    """The interval is wider than required after the largest number of runs."""
    RUNS_FAILED = "runs_failed"
    """Runs without a result, failed or refused, may hide more than the required error."""
    NOT_REACHED = "not_reached"
    """The levels do not reach the limit: they do not rise, or runs are too few."""


@dataclass(frozen=True)
class RareEvent:
    """An event of which the probability is estimated.

    Attributes:
        quantity: name of a numerical result.
        limit: of the quantity, in its unit.
        above: whether the event is a quantity above the limit, else below.
        relative_error: of the probability at 95 %: upper end of the interval over estimate, less 1.
        max_runs: largest number of runs.
        method: how points are drawn.
    """

    quantity: str
    limit: float
    above: bool
    relative_error: float
    max_runs: int
    method: Method

    def __str__(self) -> str:
        return f"{self.quantity} {'above' if self.above else 'below'} {self.limit:g}"

    @property
    def round_runs(self) -> int:
        """Number of runs of a round after the first."""
        return min(_LEVEL_RUNS, self.max_runs // 8)

    @property
    def first_runs(self) -> int:
        """Number of runs of the first round."""
        if self.method is Method.MONTE_CARLO:
            return self.round_runs
        return min(_FIRST_RUNS, self.max_runs // 4)

    def scores(self, quantities: Floats) -> Floats:
        """Return distances beyond the limit, with -inf for a run without a result (NaN)."""
        beyond = quantities - self.limit
        return np.nan_to_num(beyond if self.above else -beyond, nan=-math.inf)


@dataclass(frozen=True)
class Mixture:
    """A mixture of k normal densities in d dimensions.

    Attributes:
        weights: (k,), of sum 1.
        means: (k, d).
        covariances: (k, d, d).
    """

    weights: Floats
    means: Floats
    covariances: Floats

    @classmethod
    def standard(cls, dimension: int) -> Mixture:
        """Return the standard normal density."""
        return cls(np.ones(1), np.zeros((1, dimension)), np.eye(dimension)[None])

    @classmethod
    def union(cls, shares: Sequence[tuple[float, Mixture]]) -> Mixture:
        """Return the mixture of some mixtures with their shares."""
        return cls(
            np.concatenate([share * one.weights for share, one in shares]),
            np.concatenate([one.means for _, one in shares]),
            np.concatenate([one.covariances for _, one in shares]),
        )

    def with_wide_tails(self) -> Mixture:
        """Return the mixture with a share of larger covariance, for the weights at its edge."""
        wide = Mixture(self.weights, self.means, _WIDE_FACTOR * self.covariances)
        return Mixture.union([(1.0 - _WIDE_SHARE, self), (_WIDE_SHARE, wide)])

    @cached_property
    def _roots(self) -> Floats:
        return np.asarray(np.linalg.cholesky(self.covariances), dtype=np.float64)

    def log_densities(self, points: Floats) -> Floats:
        """Return log(weight * density) of each component at points (n, d), as (n, k)."""
        shifted = (points[None] - self.means[:, None]).transpose(0, 2, 1)
        squares = np.sum(np.linalg.solve(self._roots, shifted) ** 2, axis=1)
        scales = np.log(np.diagonal(self._roots, axis1=1, axis2=2)).sum(axis=1)
        scales += 0.5 * points.shape[1] * math.log(2.0 * math.pi)
        found: Floats = (np.log(self.weights) - scales)[None] - 0.5 * squares.T
        return found

    def log_density(self, points: Floats) -> Floats:
        """Return the logarithm of the density at points (n, d)."""
        return np.asarray(logsumexp(self.log_densities(points), axis=1))

    def draw(self, generator: np.random.Generator, count: int) -> Floats:
        """Draw points (count, d)."""
        kinds = generator.choice(len(self.weights), size=count, p=self.weights)
        normal = generator.standard_normal((count, self.means.shape[1]))
        # Not by BLAS: its sums depend on the number of threads, and workers draw the same points.
        drawn: Floats = self.means[kinds] + np.einsum("nij,nj->ni", self._roots[kinds], normal)
        return drawn


def fit_mixture(points: Floats, weights: Floats, generator: np.random.Generator) -> Mixture:
    """Fit a mixture to weighted points by expectation maximisation.

    Args:
        points: (n, d).
        weights: (n,), of any sum.
        generator: of the initial centres, drawn as by k-means++.
    """
    count, dimension = points.shape
    shares = weights / weights.sum()
    effective = 1.0 / np.sum(shares**2)
    most = int(effective / (_RUNS_PER_UNKNOWN * (dimension + 1)))
    centres = points[[generator.choice(count, p=shares)]]
    squares = np.sum((points - centres[0]) ** 2, axis=1)[None]
    while len(centres) < min(most, _MOST_COMPONENTS) and squares.min(axis=0) @ shares > 0.0:
        nearest = squares.min(axis=0) * shares
        centre = points[[generator.choice(count, p=nearest / nearest.sum())]]
        centres = np.concatenate([centres, centre])
        squares = np.concatenate([squares, np.sum((points - centre) ** 2, axis=1)[None]])
    belongs = np.eye(len(centres))[squares.argmin(axis=0)]
    likelihood = -math.inf
    for _ in range(_EM_STEPS):
        parts = belongs * shares[:, None]
        sums = parts.sum(axis=0) + 1e-12
        means = parts.T @ points / sums[:, None]
        apart = points[:, None] - means[None]
        scatter = effective * np.einsum("nk,nki,nkj->kij", parts, apart, apart)
        runs = (effective * sums)[:, None, None]
        covariances = (scatter + _PRIOR_RUNS * np.eye(dimension)) / (runs + _PRIOR_RUNS)
        mixture = Mixture(sums / sums.sum(), means, covariances)
        logs = mixture.log_densities(points)
        totals = np.asarray(logsumexp(logs, axis=1))
        belongs = np.exp(logs - totals[:, None])
        before, likelihood = likelihood, float(shares @ totals)
        if likelihood - before < _EM_TOLERANCE:
            break
    return mixture


@dataclass(frozen=True)
class Round:
    """Some runs with points from one density.

    Attributes:
        runs: number of runs.
        proposal: density of the points.
        level: quantity of the runs to which the proposal is fitted, None for nominal points.
        counted: whether the runs enter the estimate.
    """

    runs: int
    proposal: Mixture
    level: float | None
    counted: bool

    @classmethod
    def first(cls, event: RareEvent, dimension: int) -> Round:
        """Return the round from which an estimate begins: points from the nominal density."""
        counted = event.method is Method.MONTE_CARLO
        return cls(event.first_runs, Mixture.standard(dimension), None, counted)

    def to_mapping(self) -> dict[str, Any]:
        """Return the round as plain values."""
        proposal = {key: value.tolist() for key, value in asdict(self.proposal).items()}
        return {**self.__dict__, "proposal": proposal}

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Round:
        """Return the round of `to_mapping`."""
        proposal = {key: np.array(value) for key, value in values["proposal"].items()}
        return cls(**{**values, "proposal": Mixture(**proposal)})


def points_of(rounds: Sequence[Round], seed: int) -> Floats:
    """Return the points (n, d) of all runs of some rounds."""
    return np.concatenate(
        [
            one.proposal.draw(np.random.default_rng([seed, number]), one.runs)
            for number, one in enumerate(rounds)
        ]
    )


@dataclass(frozen=True)
class RareEventEstimate:
    """Estimate of the probability of an event.

    Attributes:
        outcome: whether the required error is met.
        probability: None if no run reached the limit.
        low: lower end of the interval at 95 %, normal in the logarithm of the probability.
        high: upper end; if no run reached the limit, from the runs with nominal points.
        runs: number of all runs.
        counted_runs: number of runs that enter the estimate.
        failed_probability: of a run without a result.
        unseen_limit: a failing region apart from those found may have a probability up to this at
            95 %, from the runs with nominal points.
        levels: of the rounds up to the limit, in the unit of the quantity.
        nearest: quantity farthest towards or beyond the limit.
        design_run: number of the most probable of the failing runs.
    """

    outcome: RareEventOutcome
    probability: float | None
    low: float
    high: float
    runs: int
    counted_runs: int
    failed_probability: float
    unseen_limit: float
    levels: tuple[float, ...]
    nearest: float | None
    design_run: int | None


def advance(
    event: RareEvent, rounds: Sequence[Round], quantities: Floats, seed: int
) -> Round | RareEventEstimate:
    """Return the round that follows complete rounds, or the estimate.

    Args:
        event: of which the probability is estimated.
        rounds: all rounds so far.
        quantities: (n,) of their runs; NaN for a run without a result.
        seed: of the draws.
    """
    last, total = rounds[-1], len(quantities)
    points, scores = points_of(rounds, seed), event.scores(quantities)
    if last.counted:
        return _estimate_or_extend(event, rounds, points, quantities)
    reached = np.sort(scores[total - last.runs :])[-math.ceil(_LEVEL_SHARE * last.runs)]
    level = min(0.0, float(reached))
    before = -math.inf if last.level is None else float(event.scores(np.array(last.level)))
    ahead = event.round_runs if level == 0.0 else 2 * event.round_runs
    if level <= before or total + ahead > event.max_runs:
        return _estimate(event, rounds, points, quantities)
    elite = scores >= level
    nominal = rounds[0].proposal
    densities = np.array([math.log(one.runs) + one.proposal.log_density(points) for one in rounds])
    weights = np.exp(nominal.log_density(points) - logsumexp(densities, axis=0))
    generator = np.random.default_rng([seed, len(rounds), 1])
    proposal = fit_mixture(points[elite], weights[elite], generator).with_wide_tails()
    quantity = event.limit + (level if event.above else -level)
    if level < 0.0:
        return Round(event.round_runs, proposal, quantity, counted=False)
    each = _DEFENSIVE_SHARE / len(rounds)
    defensive = [(each, one.proposal) for one in rounds]
    mixture = Mixture.union([*defensive, (1.0 - _DEFENSIVE_SHARE, proposal)])
    return Round(event.round_runs, mixture, quantity, counted=True)


def _estimate_or_extend(
    event: RareEvent, rounds: Sequence[Round], points: Floats, quantities: Floats
) -> Round | RareEventEstimate:
    """Return the estimate, or as many runs more as it needs, at most twice those before."""
    estimate = _estimate(event, rounds, points, quantities)
    left = event.max_runs - estimate.runs
    wide_or_none = (RareEventOutcome.RUNS_EXHAUSTED, RareEventOutcome.NOT_REACHED)
    if estimate.outcome not in wide_or_none or left < 1:
        return estimate
    needed = math.inf
    if estimate.probability is not None:
        wide = math.log(estimate.high / estimate.probability)
        needed = estimate.counted_runs * (wide / math.log1p(event.relative_error)) ** 2
    more = max(1.05 * needed - estimate.counted_runs, 0.2 * event.round_runs)
    more = min(more, 2.0 * estimate.counted_runs, left)
    return Round(math.ceil(more), rounds[-1].proposal, rounds[-1].level, counted=True)


def _upper_limit(events: int, runs: int) -> float:
    """Return the upper limit at 95 % of a probability (Clopper, Pearson, Biometrika 26, 1934)."""
    return float(betaincinv(events + 1, runs - events, 0.95)) if events < runs else 1.0


def _estimate(
    event: RareEvent, rounds: Sequence[Round], points: Floats, quantities: Floats
) -> RareEventEstimate:
    counted = np.repeat([one.counted for one in rounds], [one.runs for one in rounds])
    nominal = rounds[0].proposal
    scores = event.scores(quantities)
    fails = scores > 0.0
    count = int(counted.sum())
    weights = np.exp(
        nominal.log_density(points[counted]) - rounds[-1].proposal.log_density(points[counted])
    )
    hits = weights * fails[counted]
    probability, failed = 0.0, 0.0
    if count:
        probability = float(hits.mean())
        failed = float(np.mean(weights * np.isnan(quantities[counted])))
    first = sum(one.runs for one in rounds if one.level is None)
    low, high = 0.0, _upper_limit(int(fails[:first].sum()), first)
    outcome = RareEventOutcome.NOT_REACHED
    if probability > 0.0:
        wide = _Z95 * float(hits.std(ddof=1)) / math.sqrt(count) / probability
        low, high = probability * math.exp(-wide), min(1.0, probability * math.exp(wide))
        outcome = RareEventOutcome.ESTIMATED
        if wide > math.log1p(event.relative_error):
            outcome = RareEventOutcome.RUNS_EXHAUSTED
        elif failed > event.relative_error * probability:
            outcome = RareEventOutcome.RUNS_FAILED
    levels = [one.level for one in rounds if one.level is not None]
    best = int(scores.argmax())
    distances = np.where(fails, np.sum(points**2, axis=1), math.inf)
    return RareEventEstimate(
        outcome=outcome,
        probability=probability or None,
        low=low,
        high=high,
        runs=len(quantities),
        counted_runs=count,
        failed_probability=failed,
        unseen_limit=_upper_limit(0, first),
        levels=tuple(dict.fromkeys(levels)),
        nearest=float(quantities[best]) if np.isfinite(scores[best]) else None,
        design_run=int(distances.argmin()) if fails.any() else None,
    )
