"""Errors of the sensors, and readings made white by them.

A reading is what is true plus a bias plus white noise. The bias begins anywhere and wanders as a
random walk, so differences between readings and a simulation are correlated, and their plain sum of
squares would promise intervals that are too narrow. The steady Kalman filter for the bias turns the
differences into innovations, which are white with variance 1 if the model is right: the prediction
errors that are squared and summed (Ljung 1999, System Identification, ch. 7). Being linear, it
treats derivatives of the differences in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Floats = NDArray[np.float64]

_ANYWHERE: Final = 1e4
"""Variance of a bias that may be anywhere, over the noise's and the stated bias' own."""
LAGS: Final = 20
"""Of the correlations that the whiteness test looks at."""
_NOT_WHITE: Final = 1e-4
"""Probability below which correlations count as no accident, over all signals."""


@dataclass(frozen=True)
class Errors:
    """Errors of one signal, as variances.

    Attributes:
        white: of the noise in one reading.
        walk: of the bias' walk, per second.
        bias: of the bias at the start.
    """

    white: float
    walk: float
    bias: float


class Whitening:
    """Makes differences white.

    Args:
        times: of the readings [s], (n,).
        errors: of the signals, (m,).
        known: which readings count, (n, m).
    """

    def __init__(self, times: Floats, errors: list[Errors], known: NDArray[np.bool_]) -> None:
        self.known = known
        white = np.array([one.white for one in errors])
        walk = np.array([one.walk for one in errors])
        variance = _ANYWHERE * (white + np.array([one.bias for one in errors]))
        steps = np.diff(times, prepend=times[0])
        self._gain = np.zeros(known.shape)
        self._scale = np.zeros(known.shape)
        first = np.ones(len(errors), dtype=bool)
        for k, step in enumerate(steps):
            variance = variance + walk * step
            here = known[k]
            total = variance + white
            gain = np.where(here, variance / total, 0.0)
            # The first reading only tells the bias.
            self._scale[k] = np.where(here & ~first, 1.0 / np.sqrt(total), 0.0)
            self._gain[k] = gain
            variance = variance * (1.0 - gain)
            first &= ~here

    def __call__(self, differences: Floats) -> Floats:
        """Innovations (n, m) or (n, m, k) of differences of the same shape; 0 where none counts."""
        more = differences.ndim - 2
        known = self.known.reshape(*self.known.shape, *(1,) * more)
        clean = np.where(known, differences, 0.0)
        gain = self._gain.reshape(*self._gain.shape, *(1,) * more)
        scale = self._scale.reshape(*self._scale.shape, *(1,) * more)
        bias = np.zeros(clean.shape[1:])
        out = np.empty_like(clean)
        for k in range(len(clean)):
            error = clean[k] - bias
            out[k] = error * scale[k]
            bias = bias + gain[k] * error
        return out

    @property
    def counts(self) -> NDArray[np.int_]:
        """Innovations of each signal, (m,)."""
        return np.asarray(np.count_nonzero(self._scale, axis=0), dtype=np.int_)

    def scales(self, innovations: Floats) -> Floats:
        """Root mean square of each signal's innovations, 1 if they are as stated, (m,)."""
        counts = np.maximum(self.counts, 1)
        return np.asarray(np.sqrt(np.sum(innovations**2, axis=0) / counts))

    def coloured(self, innovations: Floats) -> list[int]:
        """Signals whose innovations are correlated in time, by Ljung's and Box's test."""
        found = []
        counts = self.counts
        for place, count in enumerate(counts):
            if count < 4 * LAGS:
                continue
            own = innovations[self._scale[:, place] > 0.0, place]
            own = own - own.mean()
            power = float(own @ own)
            if power == 0.0:
                continue
            lags = np.arange(1, LAGS + 1)
            tied = np.array([float(own[lag:] @ own[:-lag]) / power for lag in lags])
            statistic = count * (count + 2.0) * float(np.sum(tied**2 / (count - lags)))
            if float(chi2.sf(statistic, LAGS)) < _NOT_WHITE / len(counts):
                found.append(place)
        return found
