"""Roots and splines by scipy, which is imported when they are first used.

Importing `scipy.optimize` is a sixth of a node's start, and most nodes call nothing of it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_SMALLEST_RTOL: Final = 4.0 * sys.float_info.epsilon  # that scipy accepts


def bracketed_root(
    function: Callable[[float], float],
    low: float,
    high: float,
    *,
    xtol: float,
    rtol: float = _SMALLEST_RTOL,
) -> float:
    """Return a root of a function between two places where it has different signs, by Brent.

    Args:
        function: continuous.
        low: one place.
        high: the other one.
        xtol: absolute tolerance of the root.
        rtol: relative tolerance of the root.

    Raises:
        ValueError: the function has the same sign at both places.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 - see above

    return float(brentq(function, low, high, xtol=xtol, rtol=rtol))


def cubic_spline(
    places: NDArray[np.float64], values: NDArray[np.float64], ends: Any = "not-a-knot"
) -> CubicSpline:
    """Return the cubic spline through values.

    Args:
        places: increasing, (n,).
        values: at the places, (n, ...).
        ends: conditions at the ends, as `bc_type` of `scipy.interpolate.CubicSpline`.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - see above

    return CubicSpline(places, values, bc_type=ends)
