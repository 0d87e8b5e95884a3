"""Least squares on the plant: parameters of the machine and how each run began.

Minimised are the squares of the innovations (`noise`) over all runs and signals, together
with those of each start's unknowns over what they may be. From the derivatives at the minimum
follow the covariance and, from their singular values, what the runs do not show:

- A parameter counts as shown if its own standard error, the others being free, leaves it within a
  factor of two either way. What is not shown is not estimated: it stays as configured, and its
  interval has no bounds.
- Where the innovations turn out to be correlated, the model does not explain all that was read;
  the covariance is then the sandwich with the gradients summed over blocks of time, which holds for
  correlated errors too, wherever it is the larger one.
- A reading on which the plant's answer is not smooth at the first guess (a drum that chatters on a
  slack tether, what comes after chaos) says nothing by derivatives and is left out; which ones
  these are is found on the simulation alone, never on what was read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.ndimage import maximum_filter1d

from rover_bags.identification.noise import Floats, Whitening
from rover_bags.identification.parameters import IdentifyError
from rover_bags.identification.profile import Profile
from rover_bags.identification.runs import Experiment, Task

_OWN: Final = 1.959964
"""Standard errors of a parameter's own 95 % interval."""
WIDE: Final = math.log(2.0) / _OWN
"""Standard error of a logarithm beyond which a parameter counts as not shown."""
TIED: Final = 0.9
"""Correlation of two estimates that is told."""
_PROBE: Final = 0.01
"""Of the logarithms, for judging whether answers are smooth."""
_STEP: Final = 0.02
"""Of the logarithms, for derivatives, at most."""
_START_STEP: Final = 0.02
"""Of the starts' unknowns, over their spread, at most."""
_REACH: Final = 5.0
"""Of the same, in standard errors."""
_SILENT: Final = 0.05
"""Norm of a derivative (over the noise) below which a parameter does not move a run's readings."""
_SMOOTH: Final = 0.5
"""Share of noise and first difference beyond which a second difference is not smooth."""
_AROUND: Final = 0.1
"""Readings so near to one that is not smooth are left out with it [s]."""
_SMALL_STEP: Final = 0.1
"""Standard errors over all unknowns below which no step is worth a simulation."""
_LAST_STEP: Final = 1.0
"""The same, of a step by derivatives that were simulated: if it leads down, it is the last one."""
_KEPT: Final = 0.6
"""Share of the promised gain from which on derivatives need not be simulated again."""
_MOST_STEPS: Final = 40
_MOST_HALVINGS: Final = 6
_NOISE_ONLY: Final = 1.5
"""Root mean square of the innovations up to which steps are not damped."""
_NEAR: Final = 0.5
"""How far a damped step of a logarithm may easily go."""
_NEAR_START: Final = 1.0
"""The same of a start's unknowns, over their spread."""
_BLOCK: Final = 0.5
"""Of time, over which correlated gradients are summed [s]."""
_MISFIT: Final = 0.15
"""Above 1, of a signal's root mean square: beyond, it is given less weight."""
_NOTHING: Final = 1e-3
"""Singular value of the derivatives (over the noise) of a direction that nothing shows."""
_LOST: Final = 1e3
"""Of the noise: what a reading counts as off where nothing can be simulated."""
_ROUGHLY: Final = 0.01
"""Standard error of a logarithm from which on other values are looked at."""
_PROFILE: Final = math.log(2.0) / 7.0 * np.arange(-7.0, 8.0)
"""At these offsets of the logarithm."""
_LOWER: Final = 1.0
"""Squares by which another value has to fit better for the search to go on from it."""
_MOST_MINIMA: Final = 3


class Predictor(Protocol):
    """Simulates many runs."""

    def __call__(self, tasks: Sequence[Task]) -> list[Floats]:
        """Readings for each (number of experiment, values, start); see `runs.predict`."""


@dataclass(frozen=True)
class Fitted:
    """What least squares found, as logarithms over the first guesses.

    Attributes:
        logs: best fit, (p,).
        covariance: (p, p), of all parameters, the starts' unknowns being free.
        shown: which parameters the runs show, (p,).
        strength: norm of each parameter's derivatives over the noise, (p,).
        starts: unknowns of each experiment's start, over their spread.
        counts, left_out, scales: by experiment and signal: innovations, readings left out as not
            smooth, and root mean square of the innovations.
        coloured: (experiment, signal) whose innovations are correlated.
        singular: singular values of the derivatives by the parameters, starts eliminated.
        profiles: of those parameters that come out only roughly, by place.
        converged: whether the search came to its end.
    """

    logs: Floats
    covariance: Floats
    shown: NDArray[np.bool_]
    strength: Floats
    starts: tuple[Floats, ...]
    counts: tuple[NDArray[np.int_], ...]
    left_out: tuple[NDArray[np.int_], ...]
    scales: tuple[Floats, ...]
    coloured: tuple[tuple[int, int], ...]
    singular: Floats
    profiles: Mapping[int, Profile]
    converged: bool

    def interval(self, place: int, limit: float) -> tuple[float, float]:
        """Within so many standard errors of a parameter: bounds of its logarithm.

        What its profile lets in as well is part of it.
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
        guesses: of the parameters that are sought, above 0.
        predictor: simulates them.
    """

    def __init__(
        self, experiments: Sequence[Experiment], guesses: Mapping[str, float], predictor: Predictor
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
        self._left_out: list[NDArray[np.int_]] = []
        # Which parameters move which experiment's readings.
        self._moves = np.ones((len(self._experiments), self._count), dtype=bool)
        self._largest = np.where(np.arange(self._size) < self._count, _STEP, _START_STEP)
        self._steps = self._largest.copy()
        # Derivatives that are known, by experiment and column, and where.
        self._slopes: dict[tuple[int, int], Floats] = {}
        self._slopes_at = np.full(self._size, np.nan)
        self._last: tuple[Floats, list[Floats]] | None = None

    def solve(self) -> Fitted:
        """Find what fits best."""
        x = np.zeros(self._size)
        jacobian = self._probe(x)
        shown = self._shown(self._covariance(jacobian))
        converged = True
        for _ in range(2):
            free = np.concatenate([shown, np.ones(self._size - self._count, dtype=bool)])
            x, converged = self._search(x, free)
            if not self._reweigh(self._innovations(x)):
                break
        jacobian = self._jacobian(x, np.ones(self._size, dtype=bool))
        profiles = self._profiles(x, jacobian, free)
        for _ in range(_MOST_MINIMA):
            there, ended = self._elsewhere(x, free, profiles)
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
        covariance = self._covariance(jacobian)
        if coloured:
            covariance = _larger(covariance, self._sandwich(jacobian, innovations))
        shown &= self._shown(covariance)
        for place, profile in profiles.items():
            shown[place] &= np.ptp(profile.reach(_OWN)) <= 2.0 * _OWN * WIDE
        return Fitted(
            logs=np.where(shown, x[: self._count], 0.0),
            covariance=covariance[: self._count, : self._count],
            shown=shown,
            strength=np.linalg.norm(jacobian[:, : self._count], axis=0),
            starts=tuple(x[place] for place in self._places),
            counts=tuple(whitening.counts for whitening in self._whitening),
            left_out=tuple(self._left_out),
            scales=tuple(
                whitening.scales(own) * weights
                for whitening, own, weights in zip(
                    self._whitening, innovations, self._weights, strict=True
                )
            ),
            coloured=coloured,
            singular=_singular(jacobian, self._count),
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
        """Predictions of all experiments, remembered for the last x."""
        if self._last is None or not np.array_equal(self._last[0], x):
            tasks = [self._task(number, x) for number in range(len(self._experiments))]
            self._last = (x.copy(), self._predictor(tasks))
        return self._last[1]

    def _probe(self, x: Floats) -> Floats:
        """Find which readings are smooth and what moves them; derivatives at the first guess."""
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
            self._left_out.append(np.count_nonzero(read & rough[number], axis=0))
        self._moves[:] = False
        for number, place in strong:
            slope = np.nan_to_num(ahead[number, place] - behind[number, place]) / (2.0 * _PROBE)
            moved = float(np.linalg.norm(self._whitening[number](slope)))
            self._moves[number, place] = moved > _SILENT
            self._slopes[number, place] = slope
        self._slopes_at = x.copy()
        return self._jacobian(x, np.ones(self._size, dtype=bool))

    def _pairs(self) -> list[tuple[int, int]]:
        """Numbers of experiments and of parameters."""
        return [
            (number, place)
            for number in range(len(self._experiments))
            for place in range(self._count)
        ]

    def _shifted(
        self, x: Floats, pairs: Sequence[tuple[int, int]], step: float
    ) -> dict[tuple[int, int], Floats]:
        """Predictions of experiments with one parameter changed."""
        tasks = [self._task(number, _moved(x, place, step)) for number, place in pairs]
        return dict(zip(pairs, self._predictor(tasks), strict=True))

    def _strength(self, number: int, moved: Floats) -> bool:
        """Whether predictions that moved by a probe show it at all."""
        noise = np.sqrt([each.white for each in self._experiments[number].errors])
        read = np.isfinite(self._experiments[number].readings)
        shown = np.where(read, moved, 0.0) / noise
        return not float(np.linalg.norm(shown)) <= _SILENT * _PROBE

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
        """Innovations of all experiments and the starts' unknowns, one long vector."""
        return self._stacked(self._at(x), x)

    def _stacked(self, predictions: Sequence[Floats], x: Floats) -> Floats:
        """Residuals of unknowns whose predictions are known."""
        innovations = self._innovations_of(predictions)
        return np.concatenate([*(own.ravel() for own in innovations), x[self._count :]])

    def _jacobian(self, x: Floats, free: NDArray[np.bool_]) -> Floats:
        """Derivatives of the residuals by those unknowns that are free, the others' being 0."""
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
        # Next time as far as matters: the plant has kinks that nothing finer than noise shows.
        errors = np.sqrt(np.diag(self._covariance(jacobian)))
        self._steps = np.clip(_REACH * errors, self._largest / 100.0, self._largest)
        return jacobian

    # --------------------------------------------------------------------------------- search

    def _search(self, x: Floats, free: NDArray[np.bool_]) -> tuple[Floats, bool]:
        """Search over the unknowns that are free; returns where it ended, and whether there.

        Gauss and Newton's steps, damped: as long as much more than noise remains, each residual
        counts as uncertain by what remains on the average, and the unknowns as near where they
        were. So what is shown well comes first, and what is shown little does not run away.
        Derivatives are simulated again only where a step did not bring what they promised; else
        they follow by Broyden's update from the step itself. The search ends with a step that is
        small against the standard errors, by derivatives that were simulated.
        """
        near = np.where(np.arange(self._size) < self._count, _NEAR, _NEAR_START)[free]
        residuals = self._residuals(x)
        jacobian, simulated = self._jacobian(x, free)[:, free], True
        for _ in range(_MOST_STEPS):
            rest = math.sqrt(float(residuals @ residuals) / max(self._known, 1))
            step = _step(jacobian, residuals, near, rest)
            length = float(np.linalg.norm(jacobian @ step)) / rest
            if simulated and length < _LAST_STEP:
                x, _, _ = self._downhill(x, residuals, free, step)
                self._slopes_at = x.copy()  # those of so near will do
                return x, True
            if length < _SMALL_STEP:
                there, after = x, residuals
            else:
                there, after, step = self._downhill(x, residuals, free, step)
            moved = there is not x
            if simulated and not moved:
                return x, False
            predicted = residuals + jacobian @ step
            promised = float(residuals @ residuals - predicted @ predicted)
            kept = moved and float(residuals @ residuals - after @ after) > _KEPT * promised
            x, residuals = there, after
            if kept:
                jacobian, simulated = _updated(jacobian, step, after - predicted), False
            else:
                jacobian, simulated = self._jacobian(x, free)[:, free], True
        return x, False

    def _downhill(
        self, x: Floats, residuals: Floats, free: NDArray[np.bool_], step: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """The first of ever shorter steps that brings the sum of squares down; x itself if none."""
        for _ in range(_MOST_HALVINGS):
            there = x.copy()
            there[free] += step
            after = self._residuals(there)
            if float(after @ after) < float(residuals @ residuals):
                return there, after, step
            step = 0.3 * step
        return x, residuals, step

    def _profiles(self, x: Floats, jacobian: Floats, free: NDArray[np.bool_]) -> dict[int, Profile]:
        """What other values of those parameters do that are known only roughly, by place."""
        here = self._at(x)
        residuals = self._residuals(x)
        errors = np.sqrt(np.diag(self._covariance(jacobian)))
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
                # The others follow as their derivatives say.
                follow = others.T @ there
                rises.append(float(there @ there - follow @ follow - residuals @ residuals))
            middle = len(rises) // 2
            found[place] = Profile(_PROFILE, np.insert(rises, middle, 0.0))
        return found

    def _elsewhere(
        self, x: Floats, free: NDArray[np.bool_], profiles: Mapping[int, Profile]
    ) -> tuple[Floats | None, bool]:
        """A lower minimum, and whether the search for it came to its end; None if there is none."""
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
        """Innovations in all."""
        return sum(int(np.sum(whitening.counts)) for whitening in self._whitening)

    def _reweigh(self, innovations: list[Floats]) -> bool:
        """Give signals less weight that fit worse than their noise; whether any changed."""
        changed = False
        for number, own in enumerate(innovations):
            scales = self._whitening[number].scales(own)
            # Of few innovations the mean square is uncertain itself.
            chance = 4.0 / np.sqrt(2.0 * np.maximum(self._whitening[number].counts, 1))
            off = scales > 1.0 + np.maximum(_MISFIT, chance)
            self._weights[number][off] *= scales[off]
            changed |= bool(off.any())
        return changed

    # ------------------------------------------------------------------------------ intervals

    def _covariance(self, jacobian: Floats) -> Floats:
        """Inverse of the curvature; directions that nothing shows get a huge variance."""
        _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
        inverse = 1.0 / np.maximum(values, _NOTHING) ** 2
        return np.asarray((directions.T * inverse) @ directions)

    def _sandwich(self, jacobian: Floats, innovations: list[Floats]) -> Floats:
        """Covariance for errors that are correlated within blocks of time."""
        bread = self._covariance(jacobian)
        meat = np.zeros((self._size, self._size))
        first = 0
        for one, own in zip(self._experiments, innovations, strict=True):
            rows = jacobian[first : first + own.size].reshape(*own.shape, self._size)
            first += own.size
            gradients = np.einsum("tm,tmk->tk", own, rows)
            blocks = np.floor((one.times - one.times[0]) / _BLOCK).astype(int)
            sums = np.zeros((blocks[-1] + 1, self._size))
            np.add.at(sums, blocks, gradients)
            meat += sums.T @ sums
        prior = jacobian[first:]
        return np.asarray(bread @ (meat + prior.T @ prior) @ bread)

    def _shown(self, covariance: Floats) -> NDArray[np.bool_]:
        return np.asarray(np.sqrt(np.diag(covariance)[: self._count]) <= WIDE)


def _places(experiments: Sequence[Experiment], first: int) -> list[slice]:
    places = []
    for one in experiments:
        places.append(slice(first, first + len(one.unknowns)))
        first += len(one.unknowns)
    return places


def _step(jacobian: Floats, residuals: Floats, near: Floats, rest: float) -> Floats:
    """Gauss and Newton's step, damped as long as more than noise remains."""
    damping = np.diag(1.0 / near) if rest > _NOISE_ONLY else np.zeros((0, near.size))
    columns = np.concatenate([jacobian / rest, damping])
    target = np.concatenate([-residuals / rest, np.zeros(len(damping))])
    return np.asarray(lstsq(columns, target)[0])


def _updated(jacobian: Floats, step: Floats, missed: Floats) -> Floats:
    """Broyden's update: derivatives that would have predicted what a step missed.

    Unknowns are weighed by how much they move the residuals.
    """
    weights = np.sum(jacobian**2, axis=0)
    return jacobian + np.outer(missed, weights * step) / float(step @ (weights * step))


def _moved(x: Floats, place: int, step: float) -> Floats:
    moved = x.copy()
    moved[place] += step
    return moved


def _larger(one: Floats, other: Floats) -> Floats:
    """A covariance with the larger standard errors of two and the first one's correlations."""
    factor = np.sqrt(np.maximum(np.diag(other) / np.diag(one), 1.0))
    return np.asarray(one * np.outer(factor, factor))


def _basis(columns: Floats) -> Floats:
    """Orthonormal columns of all that some columns reach; what moves nothing is none of it."""
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, values > _NOTHING])


def _singular(jacobian: Floats, count: int) -> Floats:
    """Singular values of the parameters' derivatives less what the starts' unknowns explain."""
    own, starts = jacobian[:, :count], jacobian[:, count:]
    if starts.shape[1]:
        basis, _ = np.linalg.qr(starts)
        own = own - basis @ (basis.T @ own)
    return np.asarray(np.linalg.svd(own, compute_uv=False))
