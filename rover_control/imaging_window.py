"""How long a swinging rover is still enough for pictures. Pure.

A swing that is an ellipse with the amplitudes a and b turns the rover at the rate
w sqrt(a^2 sin^2 wt + b^2 cos^2 wt): slowest, at w b, where it turns back. On a long tether it stays
there for seconds, long enough for pictures, with more swing than could be borne all the time. The
winch's trim takes from a and keeps the momentum, a b, and so adds to b.
"""

from __future__ import annotations

import math

_CANDIDATES = 24  # ellipses between what there is and its circle


def imaging_window(major: float, minor: float, frequency: float, rate: float) -> float:
    """Time [s] that an ellipse turns the rover slower than a rate in each half of its period.

    Args:
        major: amplitude [rad].
        minor: the other one [rad].
        frequency: of the swing [rad/s].
        rate: [rad/s].
    """
    slowest, fastest = frequency * abs(minor), frequency * major
    if fastest <= rate:
        return math.inf
    if slowest >= rate:
        return 0.0
    share = (rate**2 - slowest**2) / (fastest**2 - slowest**2)
    return 2.0 / frequency * math.asin(math.sqrt(share))


def longest_imaging_window(major: float, minor: float, frequency: float, rate: float) -> float:
    """The longest such time [s] of all ellipses that the winch can make of this one."""
    product = major * abs(minor)
    circle = math.sqrt(product)
    if frequency * circle <= rate:
        return math.inf
    spans = []
    for n in range(_CANDIDATES + 1):
        wide = circle + (major - circle) * n / _CANDIDATES
        spans.append(imaging_window(wide, product / wide, frequency, rate))
    return max(spans)
