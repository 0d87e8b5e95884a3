"""Errors of predicted runs by wheel and angle, and runs that are predicted from the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rover_validation.wheel.fitting import Array, bands, identify, within_validity
from rover_validation.wheel.sets import Indentation, Runs

UNITS: Final = np.array([1.0, 1.0, 1e3])
"""Factors from forward force [N], sideways force [N], sinkage [m] to N, N, mm."""
BEYOND: Final = ", beyond the law"
"""End of the label of runs at angles at which the law does not hold."""
PARTS: Final = 6
"""Parts of a set, each of which is predicted from the others."""
_ANGLED: Final = np.radians(1.0)


@dataclass(frozen=True)
class GroupErrors:
    """Errors of a group of runs.

    Attributes:
        label: wheel, and whether it runs straight ahead or at angles.
        runs: their number.
        rms: of forward force [N], sideways force [N] and sinkage [mm], predicted less measured.
        coverage: fraction of the measured values in the 90 % bands.
    """

    label: str
    runs: int
    rms: tuple[float, float, float]
    coverage: float


def groups(runs: Runs) -> list[tuple[str, NDArray[np.bool_]]]:
    """Return label and mask of the runs of each wheel, straight ahead and at angles."""
    found = []
    for name in sorted(set(runs.wheel)):
        own = np.array([wheel == name for wheel in runs.wheel])
        for label, mask in (
            ("straight ahead", own & (runs.angle < _ANGLED)),
            ("at angles", own & (runs.angle >= _ANGLED)),
        ):
            if mask.any():
                found.append((f"{name}, {label}", mask))
    return found


def compare(runs: Runs, centre: Array, half: Array) -> list[GroupErrors]:
    """Errors of each group; runs beyond the law's limit of validity are groups of their own.

    Args:
        runs: measured.
        centre: predictions, (k, 3), as `fitting.bands` returns them.
        half: half widths of their bands.
    """
    error = centre - runs.measured
    valid = within_validity(runs)
    found = []
    for label, group in groups(runs):
        for part, name in ((group & valid, label), (group & ~valid, label + BEYOND)):
            if part.any():
                rms = (np.sqrt(np.mean(error[part] ** 2, axis=0)) * UNITS).tolist()
                inside = float(np.mean(np.abs(error[part]) <= half[part]))
                found.append(GroupErrors(name, int(part.sum()), (rms[0], rms[1], rms[2]), inside))
    return found


def largest_errors(runs: Runs, error: Array, scatter: tuple[float, float, float]) -> list[str]:
    """Describe the five runs whose errors are the largest, over the scatter of the fit.

    Args:
        runs: measured.
        error: predicted less measured, forward, sideways [N] and sinkage [m], (k, 3).
        scatter: RMS of the residuals of the identification, in the same units.
    """
    worst = np.argsort(-np.abs(error / scatter).max(axis=1), kind="stable")[:5]
    return [
        f"{runs.wheel[i]}, {np.degrees(runs.angle[i]):.0f} deg, rim {runs.rim[i] * 1e3:.0f} mm/s "
        f"at {runs.travel[i] * 1e3:.0f} mm/s: forward force {error[i, 0]:+.1f} N, "
        f"sideways force {error[i, 1]:+.1f} N, sinkage {error[i, 2] * 1e3:+.1f} mm"
        for i in worst
    ]


def parts(runs: Runs) -> NDArray[np.int64]:
    """Divide the settings, in the order of wheel, angle and rim speed, into `PARTS` parts by turns.

    Returns:
        Part of each run, (k,). Repeats of a setting are in the same part.
    """
    settings = runs.settings()
    degrees = np.round(np.degrees(runs.angle)).tolist()
    order = sorted(range(len(settings)), key=lambda i: (runs.wheel[i], degrees[i], runs.rim[i]))
    places = {
        setting: place for place, setting in enumerate(dict.fromkeys(settings[i] for i in order))
    }
    return np.array([places[setting] % PARTS for setting in settings])


def predicted_by_others(runs: Runs, indentation: Indentation) -> tuple[Array, Array]:
    """Predict each part of the runs by a soil that is identified from the other parts.

    Returns:
        Predictions and half widths of their bands, (k, 3) each, as `fitting.bands`.

    Raises:
        SetError: a wheel is not described, or the runs are too few.
    """
    own = parts(runs)
    valid = within_validity(runs)
    centre, half = np.empty((2, len(own), 3))
    for part in set(own.tolist()):
        found = identify(subset(runs, valid & (own != part)), indentation).found
        centre[own == part], half[own == part] = bands(found, subset(runs, own == part))
    return centre, half


def subset(runs: Runs, mask: NDArray[np.bool_]) -> Runs:
    """The runs that a mask selects."""
    rows = np.flatnonzero(mask).tolist()
    return replace(
        runs,
        rows=tuple(runs.rows[i] for i in rows),
        wheel=tuple(runs.wheel[i] for i in rows),
        angle=runs.angle[mask],
        travel=runs.travel[mask],
        rim=runs.rim[mask],
        load=runs.load[mask],
        measured=runs.measured[mask],
    )
