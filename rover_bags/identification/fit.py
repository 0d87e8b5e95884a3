"""Least squares on the plant: parameters of the machine and initial states of the runs.

The sum of squares contains the innovations (`noise`) of all runs and signals, and the initial
unknowns over their prior spread. The derivatives at the minimum give the covariance and show which
parameters are identifiable:

- A parameter is identifiable if its standard error, with all other unknowns free, bounds its 95 %
  interval by a factor of two either way. Any other parameter stays as configured, with an unbounded
  interval.
- Correlated innovations show that the model does not explain all readings. The covariance is then
  the sandwich estimate with gradients summed over blocks of time, wherever that is the larger one.
- A reading at which the plant's response is not smooth at the first guess (a drum that chatters on
  a slack tether, chaotic motion) is excluded, as its derivatives are meaningless. This is decided
  from the simulation alone, never from the recorded values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from rover_bags.identification.noise import Floats, Whitening
from rover_bags.identification.parameters import IdentifyError
from rover_bags.identification.profile import Profile
from rover_bags.identification.runs import IdentificationRun, Task
from rover_estimation import (
    STANDARD_ERRORS,
    UNOBSERVABLE,
    grouped_gradients,
    inverse_curvature,
    minimise,
    sandwich,
)

WIDE: Final = math.log(2.0) / STANDARD_ERRORS
"""Standard error of a logarithm beyond which a parameter is not identifiable."""
CORRELATED: Final = 0.9
"""Correlation of two estimates that is reported."""
_PROBE: Final = 0.01
"""Step of the logarithms for the smoothness test."""
_STEP: Final = 0.02
"""Largest step of the logarithms for derivatives."""
_START_STEP: Final = 0.02
"""Largest step of the initial unknowns for derivatives, over their spread."""
_STEP_ERRORS: Final = 5.0
"""Step for derivatives in standard errors."""
_MIN_SENSITIVITY: Final = 0.05
"""Norm of a derivative, over the noise, below which a parameter does not affect a run."""
_SMOOTH: Final = 0.5
"""Second difference over noise or first difference beyond which a response is not smooth."""
_AROUND: Final = 0.1
"""Margin around a reading that is not smooth, excluded with it [s]."""
_LAST_GAIN: Final = 1.0
"""Decrease of the sum of squares, over the mean square, below which the search has converged."""
_MOST_POINTS: Final = 40
_MOST_SEARCHES: Final = 4
_NEAR: Final = 0.5
"""Change of a logarithm that the first steps may make."""
_NEAR_START: Final = 1.0
"""Change of an initial unknown, over its spread, that they may make."""
_BLOCK: Final = 0.5
"""Duration of the blocks over which correlated gradients are summed [s]."""
_MISFIT: Final = 0.15
"""Excess of a signal's RMS above 1 from which its weight is reduced."""
_LOST: Final = 1e3
"""Residual of a reading whose simulation failed, over the noise."""
_ROUGHLY: Final = 0.01
"""Standard error of a logarithm from which a profile is computed."""
_PROFILE: Final = math.log(2.0) / 7.0 * np.arange(-7.0, 8.0)
"""Offsets of the logarithm in a profile."""
_LOWER: Final = 1.0
"""Decrease of the sum of squares from which the search restarts from another value."""
_MOST_MINIMA: Final = 3


Predictor = Callable[[Sequence[Task]], list[Floats]]
"""Simulates many runs and returns the readings of each task; see `runs.predict`."""


@dataclass(frozen=True)
class Fitted:
    """Result of the least squares, as logarithms of values over first guesses.

    Attributes:
        logs: best fit, (p,).
        covariance: covariance of all parameters with free initial unknowns, (p, p).
        identifiable: which parameters are identifiable, (p,).
        strength: norm of each parameter's derivatives over the noise, (p,).
        starts: initial unknowns of each experiment, over their spread.
        counts, excluded, scales: by experiment and signal: number of innovations, number of
            readings excluded as not smooth, and RMS of the innovations.
        coloured: (experiment, signal) with correlated innovations.
        singular_values: singular values of the parameters' derivatives, initial unknowns
            eliminated.
        profiles: profiles of poorly known parameters, by index.
        converged: whether the search converged.
    """

    logs: Floats
    covariance: Floats
    identifiable: NDArray[np.bool_]
    strength: Floats
    starts: tuple[Floats, ...]
    counts: tuple[NDArray[np.int_], ...]
    excluded: tuple[NDArray[np.int_], ...]
    scales: tuple[Floats, ...]
    coloured: tuple[tuple[int, int], ...]
    singular_values: Floats
    profiles: Mapping[int, Profile]
    converged: bool

    def interval(self, place: int, limit: float) -> tuple[float, float]:
        """Return the bounds of a parameter's logarithm for a number of standard errors.

        The interval includes what the profile admits.
        """
        error = math.sqrt(float(self.covariance[place, place]))
        low, high = -limit * error, limit * error
        if place in self.profiles:
            reach = self.profiles[place].reach(limit)
            low, high = min(low, reach[0]), max(high, reach[1])
        return float(self.logs[place]) + low, float(self.logs[place]) + high


class Fit:
    """Least squares over some experiments.

    Args:
        experiments: the runs.
        guesses: first guesses of the parameters, above 0.
        predictor: simulates the runs.
    """

    def __init__(
        self,
        experiments: Sequence[IdentificationRun],
        guesses: Mapping[str, float],
        predictor: Predictor,
    ) -> None:
        self._experiments = list(experiments)
        self._guesses = dict(guesses)
        self._names = list(guesses)
        self._predictor = predictor
        self._count = len(self._names)
        self._places = _places(self._experiments, self._count)
        self._size = self._count + sum(len(one.unknowns) for one in self._experiments)
        self._whitening: list[Whitening] = []
        self._weights = [np.ones(len(one.signals)) for one in self._experiments]
        self._excluded: list[NDArray[np.int_]] = []
        # Which parameters affect which experiment.
        self._moves = np.ones((len(self._experiments), self._count), dtype=bool)
        self._largest = np.where(np.arange(self._size) < self._count, _STEP, _START_STEP)
        self._steps = self._largest.copy()
        # Known derivatives by experiment and column, and the point where they hold.
        self._slopes: dict[tuple[int, int], Floats] = {}
        self._slopes_at = np.full(self._size, np.nan)
        self._last: tuple[Floats, list[Floats]] | None = None

    def solve(self) -> Fitted:
        """Find the best fit."""
        x = np.zeros(self._size)
        jacobian = self._probe(x)
        identifiable = self._identifiable(inverse_curvature(jacobian))
        converged = True
        for _ in range(2):
            free = np.concatenate([identifiable, np.ones(self._size - self._count, dtype=bool)])
            x, converged = self._search(x, free)
            if not self._reweigh(self._innovations(x)):
                break
        jacobian = self._jacobian(x, np.ones(self._size, dtype=bool))
        profiles = self._profiles(x, jacobian, free)
        for _ in range(_MOST_MINIMA):
            there, ended = self._lower_minimum(x, free, profiles)
            if there is None:
                break
            x, converged = there, ended
            jacobian = self._jacobian(x, np.ones(self._size, dtype=bool))
            profiles = self._profiles(x, jacobian, free)
        innovations = self._innovations(x)
        coloured = tuple(
            (number, place)
            for number, whitening in enumerate(self._whitening)
            for place in whitening.coloured(innovations[number])
        )
        covariance = inverse_curvature(jacobian)
        if coloured:
            covariance = _larger(covariance, self._sandwich(jacobian, innovations))
        identifiable &= self._identifiable(covariance)
        for place, profile in profiles.items():
            reach = np.ptp(profile.reach(STANDARD_ERRORS))
            identifiable[place] &= reach <= 2.0 * STANDARD_ERRORS * WIDE
        return Fitted(
            logs=np.where(identifiable, x[: self._count], 0.0),
            covariance=covariance[: self._count, : self._count],
            identifiable=identifiable,
            strength=np.linalg.norm(jacobian[:, : self._count], axis=0),
            starts=tuple(x[place] for place in self._places),
            counts=tuple(whitening.counts for whitening in self._whitening),
            excluded=tuple(self._excluded),
            scales=tuple(
                whitening.scales(own) * weights
                for whitening, own, weights in zip(
                    self._whitening, innovations, self._weights, strict=True
                )
            ),
            coloured=coloured,
            singular_values=_singular(jacobian, self._count),
            profiles=profiles,
            converged=converged,
        )

    # ---------------------------------------------------------------------------- simulations

    def _task(self, number: int, x: Floats) -> Task:
        values = {
            name: guess * math.exp(float(log))
            for (name, guess), log in zip(self._guesses.items(), x[: self._count], strict=True)
        }
        spread = np.array([one.spread for one in self._experiments[number].unknowns])
        return number, values, (x[self._places[number]] * spread).tolist()

    def _at(self, x: Floats) -> list[Floats]:
        """Predictions of all experiments, cached for the last x."""
        if self._last is None or not np.array_equal(self._last[0], x):
            tasks = [self._task(number, x) for number in range(len(self._experiments))]
            self._last = (x.copy(), self._predictor(tasks))
        return self._last[1]

    def _probe(self, x: Floats) -> Floats:
        """Find the smooth readings and their sensitivities; derivatives at the first guess."""
        here = self._at(x)
        for number, predicted in enumerate(here):
            if np.isnan(predicted).all():
                raise IdentifyError(
                    f"{self._experiments[number].name} cannot be simulated as configured"
                )
        ahead = self._shifted(x, self._pairs(), _PROBE)
        strong = [
            pair
            for pair, predicted in ahead.items()
            if self._strength(pair[0], predicted - here[pair[0]])
        ]
        behind = self._shifted(x, strong, -_PROBE)
        rough = [np.isnan(each) for each in here]
        for pair in strong:
            number = pair[0]
            rough[number] |= self._roughness(number, ahead[pair], here[number], behind[pair])
        for number, one in enumerate(self._experiments):
            read = np.isfinite(one.readings)
            self._whitening.append(Whitening(one.times, list(one.errors), read & ~rough[number]))
            self._excluded.append(np.count_nonzero(read & rough[number], axis=0))
        self._moves[:] = False
        for number, place in strong:
            slope = np.nan_to_num(ahead[number, place] - behind[number, place]) / (2.0 * _PROBE)
            moved = float(np.linalg.norm(self._whitening[number](slope)))
            self._moves[number, place] = moved > _MIN_SENSITIVITY
            self._slopes[number, place] = slope
        self._slopes_at = x.copy()
        return self._jacobian(x, np.ones(self._size, dtype=bool))

    def _pairs(self) -> list[tuple[int, int]]:
        """All pairs of experiment and parameter indices."""
        return [
            (number, place)
            for number in range(len(self._experiments))
            for place in range(self._count)
        ]

    def _shifted(
        self, x: Floats, pairs: Sequence[tuple[int, int]], step: float
    ) -> dict[tuple[int, int], Floats]:
        """Predictions of experiments with one parameter shifted."""
        tasks = [self._task(number, _moved(x, place, step)) for number, place in pairs]
        return dict(zip(pairs, self._predictor(tasks), strict=True))

    def _strength(self, number: int, moved: Floats) -> bool:
        """Whether the change of predictions by a probe is significant."""
        noise = np.sqrt([each.white for each in self._experiments[number].errors])
        read = np.isfinite(self._experiments[number].readings)
        shown = np.where(read, moved, 0.0) / noise
        return not float(np.linalg.norm(shown)) <= _MIN_SENSITIVITY * _PROBE

    def _roughness(
        self, number: int, ahead: Floats, here: Floats, behind: Floats
    ) -> NDArray[np.bool_]:
        one = self._experiments[number]
        around = 2 * max(1, round(_AROUND / float(np.median(np.diff(one.times))))) + 1
        slope = maximum_filter1d(np.nan_to_num(np.abs(ahead - behind)) / 2.0, around, axis=0)
        bend = np.abs(ahead - 2.0 * here + behind)
        noise = np.sqrt([each.white for each in one.errors])
        rough = np.isnan(bend) | (bend > _SMOOTH * np.maximum(noise, slope))
        return np.asarray(maximum_filter1d(rough, around, axis=0), dtype=bool)

    def _innovations(self, x: Floats) -> list[Floats]:
        return self._innovations_of(self._at(x))

    def _innovations_of(self, predictions: Sequence[Floats]) -> list[Floats]:
        return [
            self._white(number, one.readings - predicted)
            for number, (one, predicted) in enumerate(
                zip(self._experiments, predictions, strict=True)
            )
        ]

    def _white(self, number: int, differences: Floats) -> Floats:
        noise = np.sqrt([each.white for each in self._experiments[number].errors])
        shape = (1, -1, *(1,) * (differences.ndim - 2))
        weights = self._weights[number].reshape(shape)
        lost = np.isnan(differences) & np.isfinite(self._experiments[number].readings).reshape(
            *self._experiments[number].readings.shape, *(1,) * (differences.ndim - 2)
        )
        filled = np.where(lost, _LOST * noise.reshape(shape), differences)
        return np.asarray(self._whitening[number](filled) / weights)

    def _residuals(self, x: Floats) -> Floats:
        """Innovations of all experiments and initial unknowns as one vector."""
        return self._stacked(self._at(x), x)

    def _stacked(self, predictions: Sequence[Floats], x: Floats) -> Floats:
        """Residual vector of unknowns with given predictions."""
        innovations = self._innovations_of(predictions)
        return np.concatenate([*(own.ravel() for own in innovations), x[self._count :]])

    def _jacobian(self, x: Floats, free: NDArray[np.bool_]) -> Floats:
        """Derivatives of the residuals by the free unknowns; 0 for others."""
        here = self._at(x)
        if not np.array_equal(self._slopes_at, x):
            self._slopes_at, self._slopes = x.copy(), {}
        columns = [
            (number, column)
            for number, place in enumerate(self._places)
            for column in (
                *(p for p in range(self._count) if self._moves[number, p]),
                *range(place.start, place.stop),
            )
            if free[column]
        ]
        new = [each for each in columns if each not in self._slopes]
        steps = self._steps
        predicted = self._predictor([self._task(n, _moved(x, c, float(steps[c]))) for n, c in new])
        for ahead, (number, column) in zip(predicted, new, strict=True):
            slope = (ahead - here[number]) / steps[column]
            self._slopes[number, column] = np.nan_to_num(slope)
        blocks = [np.zeros((*one.readings.shape, self._size)) for one in self._experiments]
        for number, column in columns:
            blocks[number][:, :, column] = -self._slopes[number, column]
        rows = [
            self._white(number, block).reshape(-1, self._size)
            for number, block in enumerate(blocks)
        ]
        jacobian = np.concatenate([*rows, np.eye(self._size)[self._count :]])
        # Scale the next steps by the standard errors: smaller steps resolve kinks below the noise.
        errors = np.sqrt(np.diag(inverse_curvature(jacobian)))
        self._steps = np.clip(_STEP_ERRORS * errors, self._largest / 100.0, self._largest)
        return jacobian

    # --------------------------------------------------------------------------------- search

    def _search(self, x: Floats, free: NDArray[np.bool_]) -> tuple[Floats, bool]:
        """Search over the free unknowns; return the final point and whether it converged.

        A search that ends where simulated derivatives promise more is begun again from there.
        """
        if not free.any():
            return x, True

        def at(values: Floats) -> Floats:
            there = x.copy()
            there[free] = values
            return there

        def slopes(values: Floats) -> Floats:
            return self._jacobian(at(values), free)[:, free]

        near = np.where(np.arange(self._size) < self._count, _NEAR, _NEAR_START)
        values = x[free]
        for _ in range(_MOST_SEARCHES):
            found = minimise(
                lambda values: self._residuals(at(values)),
                values,
                near[free],
                derivatives=slopes,
                costly=True,
                evaluations=_MOST_POINTS,
                tolerance=_LAST_GAIN / max(self._known, 1),
            )
            values = found.x
            mean_square = float(found.residuals @ found.residuals) / max(self._known, 1)
            if replace(found, jacobian=slopes(values)).gain < _LAST_GAIN * mean_square:
                return at(values), True
        return at(values), False

    def _profiles(self, x: Floats, jacobian: Floats, free: NDArray[np.bool_]) -> dict[int, Profile]:
        """Profiles of the poorly known parameters, by index."""
        here = self._at(x)
        residuals = self._residuals(x)
        errors = np.sqrt(np.diag(inverse_curvature(jacobian)))
        rough = np.flatnonzero(free & (errors > _ROUGHLY))
        found = {}
        for place in rough[rough < self._count].tolist():
            moved = np.flatnonzero(self._moves[:, place]).tolist()
            others = _basis(jacobian[:, free & (np.arange(self._size) != place)])
            values = [_moved(x, place, offset) for offset in _PROFILE.tolist() if offset != 0.0]
            predicted = iter(
                self._predictor([self._task(n, value) for value in values for n in moved])
            )
            rises = []
            for value in values:
                after = list(here)
                for number in moved:
                    after[number] = next(predicted)
                there = self._stacked(after, value)
                # Re-estimate the other unknowns linearly.
                follow = others.T @ there
                rises.append(float(there @ there - follow @ follow - residuals @ residuals))
            middle = len(rises) // 2
            found[place] = Profile(_PROFILE, np.insert(rises, middle, 0.0))
        return found

    def _lower_minimum(
        self, x: Floats, free: NDArray[np.bool_], profiles: Mapping[int, Profile]
    ) -> tuple[Floats | None, bool]:
        """Search from the lowest profile point; return a lower minimum or None, and convergence."""
        best = {place: profile.best for place, profile in profiles.items()}
        if not best:
            return None, True
        place = max(best, key=lambda each: best[each][1])
        if best[place][1] < _LOWER:
            return None, True
        residuals = self._residuals(x)
        there, ended = self._search(_moved(x, place, best[place][0]), free)
        after = self._residuals(there)
        lower = float(after @ after) < float(residuals @ residuals)
        return (there, ended) if lower else (None, True)

    @property
    def _known(self) -> int:
        """Total number of innovations."""
        return sum(int(np.sum(whitening.counts)) for whitening in self._whitening)

    def _reweigh(self, innovations: list[Floats]) -> bool:
        """Reduce the weights of signals that fit worse than their noise; return if any changed."""
        changed = False
        for number, own in enumerate(innovations):
            scales = self._whitening[number].scales(own)
            # With few innovations the mean square itself is uncertain.
            chance = 4.0 / np.sqrt(2.0 * np.maximum(self._whitening[number].counts, 1))
            off = scales > 1.0 + np.maximum(_MISFIT, chance)
            self._weights[number][off] *= scales[off]
            changed |= bool(off.any())
        return changed

    # ------------------------------------------------------------------------------ intervals

    def _sandwich(self, jacobian: Floats, innovations: list[Floats]) -> Floats:
        """Sandwich covariance for errors that are correlated within blocks of time."""
        gradients = []
        first = 0
        for one, own in zip(self._experiments, innovations, strict=True):
            rows = jacobian[first : first + own.size]
            first += own.size
            blocks = np.floor((one.times - one.times[0]) / _BLOCK).astype(int)
            gradients.append(
                grouped_gradients(rows, own.ravel(), np.repeat(blocks, len(one.signals)))
            )
        gradients.append(jacobian[first:])  # of the initial unknowns
        return sandwich(inverse_curvature(jacobian), np.concatenate(gradients))

    def _identifiable(self, covariance: Floats) -> NDArray[np.bool_]:
        return np.asarray(np.sqrt(np.diag(covariance)[: self._count]) <= WIDE)


def _places(experiments: Sequence[IdentificationRun], first: int) -> list[slice]:
    places = []
    for one in experiments:
        places.append(slice(first, first + len(one.unknowns)))
        first += len(one.unknowns)
    return places


def _moved(x: Floats, place: int, step: float) -> Floats:
    moved = x.copy()
    moved[place] += step
    return moved


def _larger(one: Floats, other: Floats) -> Floats:
    """Covariance with the larger standard errors of two and the correlations of the first."""
    factor = np.sqrt(np.maximum(np.diag(other) / np.diag(one), 1.0))
    return np.asarray(one * np.outer(factor, factor))


def _basis(columns: Floats) -> Floats:
    """Orthonormal basis of the column space, without unobservable directions."""
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, values > UNOBSERVABLE])


def _singular(jacobian: Floats, count: int) -> Floats:
    """Singular values of the parameters' derivatives, initial unknowns projected out."""
    own, starts = jacobian[:, :count], jacobian[:, count:]
    if starts.shape[1]:
        basis, _ = np.linalg.qr(starts)
        own = own - basis @ (basis.T @ own)
    return np.asarray(np.linalg.svd(own, compute_uv=False))
