"""Curves of long records, thinned for plotting."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np

from rover_bags.reading.read import Floats

_BUCKETS: Final = 1600
"""Number of bins across a plot; the extremes of each bin are drawn."""
_BREAK: Final = 1.0
"""A curve breaks at a pause longer than this [s] or than five typical periods."""


def envelope(time: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return a curve through the extremes of a long record, so that no peak is lost.

    Args:
        time: Time of each value [s], shape (N,).
        low: Smallest value at each time, shape (N,).
        high: Largest value at each time; the same array if all values are held.

    Returns:
        Times and values of the curve, with NaN where time jumps back or the record pauses.
    """
    if not len(time):
        return time, low
    step = max(1, math.ceil(len(time) / _BUCKETS))
    edges = [0, *_breaks(time).tolist(), len(time)]
    stretches = [np.arange(a, b, step) for a, b in pairwise(edges)]
    starts = np.concatenate(stretches)
    ends = np.cumsum([len(each) for each in stretches])[:-1]
    at = time[starts]
    if step == 1 and low is high:
        values = low
    else:
        at, ends = np.repeat(at, 2), 2 * ends
        pairs = (np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts))
        values = np.stack(pairs, axis=1).ravel()
    return np.insert(at, ends, np.nan), np.insert(values, ends, np.nan)


def _breaks(time: Floats) -> np.ndarray[tuple[int], np.dtype[np.int_]]:
    """Index of the first value after each break."""
    steps = np.diff(time)
    ahead = steps[steps > 0.0]
    typical = float(np.median(ahead)) if len(ahead) else 0.0
    return np.flatnonzero((steps < 0.0) | (steps > max(_BREAK, 5.0 * typical))) + 1
