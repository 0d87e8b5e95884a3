"""Sensor errors, and whitening of the residuals.

A reading is the true value plus a bias plus white noise. The bias has an unknown start and a random
walk, so the residuals are correlated, and their sum of squares would give intervals that are too
narrow. A Kalman filter of the bias turns the residuals into innovations, which are white with
variance 1 if the model is right (prediction-error method: Ljung 1999, System Identification, ch.
7). The filter is linear and applies to derivatives of the residuals as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Floats = NDArray[np.float64]

_INITIAL_VARIANCE: Final = 1e4
"""Initial variance of the bias, over the variances of the noise and of the specified bias."""
LAGS: Final = 20
"""Number of lags of the whiteness test."""
_NOT_WHITE: Final = 1e-4
"""Significance level of the whiteness test, over all signals."""


@dataclass(frozen=True)
class Errors:
    """Error variances of one signal.

    Attributes:
        white: variance of the noise in one reading.
        walk: variance of the bias random walk, per second.
        bias: variance of the bias at the start.
    """

    white: float
    walk: float
    bias: float


class Whitening:
    """Whitens residuals.

    Args:
        times: times of the readings [s], (n,).
        errors: error variances of the signals, (m,).
        known: which readings are valid, (n, m).
    """

    def __init__(self, times: Floats, errors: list[Errors], known: NDArray[np.bool_]) -> None:
        self.known = known
        white = np.array([one.white for one in errors])
        walk = np.array([one.walk for one in errors])
        variance = _INITIAL_VARIANCE * (white + np.array([one.bias for one in errors]))
        steps = np.diff(times, prepend=times[0])
        self._gain = np.zeros(known.shape)
        self._scale = np.zeros(known.shape)
        first = np.ones(len(errors), dtype=bool)
        for k, step in enumerate(steps):
            variance = variance + walk * step
            here = known[k]
            total = variance + white
            gain = np.where(here, variance / total, 0.0)
            # The first reading determines the bias only.
            self._scale[k] = np.where(here & ~first, 1.0 / np.sqrt(total), 0.0)
            self._gain[k] = gain
            variance = variance * (1.0 - gain)
            first &= ~here

    def __call__(self, differences: Floats) -> Floats:
        """Return the innovations (n, m) or (n, m, k) of residuals; 0 for invalid readings."""
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
        """Number of innovations of each signal, (m,)."""
        return np.asarray(np.count_nonzero(self._scale, axis=0), dtype=np.int_)

    def scales(self, innovations: Floats) -> Floats:
        """Return the RMS of each signal's innovations, 1 if the errors are as specified, (m,)."""
        counts = np.maximum(self.counts, 1)
        return np.asarray(np.sqrt(np.sum(innovations**2, axis=0) / counts))

    def coloured(self, innovations: Floats) -> list[int]:
        """Return the signals with autocorrelated innovations, by the Ljung-Box test."""
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
