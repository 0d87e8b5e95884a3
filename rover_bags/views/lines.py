"""Lines of long records, as plots draw them."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np

from rover_bags.read import Floats

_BUCKETS: Final = 1600
"""So many places a line has across a plot; within each its extremes are drawn."""
_SILENT: Final = 1.0
"""A line does not go on over longer than so [s], or five of its usual periods, without values."""


def envelope(time: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """A line through the extremes of a long record: no peak is lost, however far it is zoomed out.

    Args:
        time: Of each value [s], shape (N,).
        low: Smallest value at each time, shape (N,).
        high: Largest value at each time; the same array where all values are held.

    Returns:
        Times and values of the line; it breaks where time jumps back and where nothing was
        recorded.
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
    """First value of each stretch but the first."""
    steps = np.diff(time)
    ahead = steps[steps > 0.0]
    usual = float(np.median(ahead)) if len(ahead) else 0.0
    return np.flatnonzero((steps < 0.0) | (steps > max(_SILENT, 5.0 * usual))) + 1
