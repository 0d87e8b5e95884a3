"""Motion of a driven end of the tether, smoothed from a table of measurements.

A Butterworth filter of second order runs over the table forwards and backwards, which leaves no
phase lag; a cubic spline through its output gives position and rate at any time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from rover_sim.physics.numerics.roots_and_splines import cubic_spline
from rover_sim.physics.tether.ancf import Array

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_ORDER: Final = 2
_HIGHEST: Final = 0.9
"""Cutoff, over half of the table's frequency, from which nothing is filtered."""
X_AXIS: Final = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class EndMotion:
    """Smooth motion of one end, as splines over time.

    Attributes:
        position: of the end [m].
        axis: unit vector of the holder, along the tether from root to tip.
        across: the holder's two other axes, which turn with it but do not spin about its axis; the
            first lies nearest to a reference direction at the start.
    """

    position: CubicSpline
    axis: CubicSpline
    across: tuple[CubicSpline, CubicSpline]

    @classmethod
    def from_table(
        cls, times: Array, position: Array, axis: Array, cutoff: float, reference: Array = X_AXIS
    ) -> EndMotion:
        """Smooth a table.

        Args:
            times: evenly spaced [s], (frames,).
            position: of the end [m], (frames, 3).
            axis: vector along the tether there, of any length, (frames, 3).
            cutoff: frequency from which motion is taken as noise [Hz].
            reference: unit vector to which the first of the other axes lies nearest at the start.
        """
        along = smoothed(times, axis / np.linalg.norm(axis, axis=1, keepdims=True), cutoff)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        first = carried_directors(along, reference)
        return cls(
            cubic_spline(times, smoothed(times, position, cutoff)),
            cubic_spline(times, along),
            (cubic_spline(times, first), cubic_spline(times, np.cross(along, first))),
        )

    def state(self, times: Array, tilt: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Position [m] and unit slope of the end, (times, 6).

        Args:
            times: [s].
            tilt: of the tether against the holder's axis, along its two other axes [-].
        """
        return self._at(times, tilt, 0)

    def rates(self, times: Array, tilt: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Rates of `state`, (times, 6)."""
        return self._at(times, tilt, 1)

    def _at(self, times: Array, tilt: tuple[float, float], derivative: int) -> Array:
        slope = self.axis(times, derivative)
        for part, spline in zip(tilt, self.across, strict=True):
            slope = slope + part * spline(times, derivative)
        slope /= math.sqrt(1.0 + tilt[0] ** 2 + tilt[1] ** 2)
        return np.concatenate([self.position(times, derivative), slope], axis=-1)


def carried_directors(slopes: Array, reference: Array = X_AXIS) -> Array:
    """Unit vectors normal to unit slopes (n, 3), carried along by the smallest rotations.

    The first lies nearest to the reference (3,); see `rover_sim.physics.tether.twist`.
    """
    directors = np.zeros_like(slopes)
    director = reference
    for i, slope in enumerate(slopes):
        before = slopes[max(i - 1, 0)]
        across = 1.0 + float(before @ slope)
        if i > 0 and across > 1.0e-3:
            director = director - float(director @ slope) / across * (before + slope)
        director = director - float(director @ slope) * slope
        director = director / np.linalg.norm(director)
        directors[i] = director
    return directors


def smoothed(times: Array, values: Array, cutoff: float) -> Array:
    """Values (frames, k) at evenly spaced times without what is faster than the cutoff [Hz]."""
    relative = cutoff * 2.0 * (times[-1] - times[0]) / (len(times) - 1)
    if relative >= _HIGHEST:
        return values
    from scipy.signal import butter, filtfilt  # noqa: PLC0415 - a third of a node's start

    ahead, back = butter(_ORDER, relative)
    padding = min(len(times) - 1, int(8.0 / relative))
    return np.asarray(filtfilt(ahead, back, values, axis=0, padlen=padding))
