"""Errors of predicted takes: their size, how they grow, and what they are made of."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from rover_validation.cable.model import Cable
from rover_validation.cable.takes import GIVEN_FRAMES, Floats, Take

_EARLY: Final = 1.0
"""Time from the start of a take in which errors count as early [s]."""


@dataclass(frozen=True)
class CableErrors:
    """Errors of the predictions of a cable's takes, means over the takes.

    Attributes:
        takes: their number.
        mean: mean distance of the free markers from the third frame on [mm].
        worst: the same of the worst take [mm].
        early: the same in the first second [mm].
        still: fraction of the squared error that is constant in a take: what a take's shape is
            off by on the average, against what its motion is off by.
        coverage: fraction of the known coordinates in the 90 % band.
        width: of the band [mm].
        speed: length of the takes over the processor time of their predictions.
    """

    takes: int
    mean: float
    worst: float
    early: float
    still: float
    coverage: float
    width: float
    speed: float


def error_of(take: Take, predicted: Floats) -> float:
    """Mean distance of the free markers from the third frame on [m]."""
    distances = np.linalg.norm(predicted - take.free, axis=-1)[GIVEN_FRAMES:]
    return float(np.nanmean(distances))


def coverage(take: Take, low: Floats, high: Floats) -> tuple[float, float]:
    """Fraction of the known coordinates within a band, from the third frame on; mean width [m]."""
    measured = take.free[GIVEN_FRAMES:]
    known = np.isfinite(measured)
    inside = (measured >= low[GIVEN_FRAMES:]) & (measured <= high[GIVEN_FRAMES:])
    width = float(np.mean((high - low)[GIVEN_FRAMES:]))
    return float(np.mean(inside[known])), width


def has_free_markers(take: Take) -> bool:
    """Whether a take has free markers after the given frames, to compare predictions with."""
    return bool(np.isfinite(take.free[GIVEN_FRAMES:]).any())


def compare(cable: Cable, takes: Sequence[Take]) -> CableErrors:
    """Predict takes that have free markers, and compare.

    Args:
        cable: identified, with its band.
        takes: at least one, each with free markers.
    """
    assert cable.band is not None
    cable.predict(takes[0])  # compiles or loads the simulation: not part of a prediction's time
    rows = []
    lasted = took = 0.0
    for take in takes:
        start = time.thread_time()
        predicted = cable.predict(take)
        took += time.thread_time() - start
        lasted += float(take.times[-1] - take.times[0])
        error = (predicted - take.free)[GIVEN_FRAMES:]
        begins = take.times[GIVEN_FRAMES:] - take.times[0] <= _EARLY
        early = float(np.nanmean(np.linalg.norm(error[begins], axis=-1)))
        still = float(
            np.nansum(np.nanmean(error, axis=0) ** 2) / np.nansum(np.nanmean(error**2, axis=0))
        )
        inside, width = coverage(take, *cable.band.bounds(predicted, take.period))
        rows.append((error_of(take, predicted), early, still, inside, width))
    mean, early, still, inside, width = np.mean(rows, axis=0).tolist()
    worst = max(row[0] for row in rows)
    return CableErrors(
        len(rows), 1e3 * mean, 1e3 * worst, 1e3 * early, still, inside, 1e3 * width, lasted / took
    )
