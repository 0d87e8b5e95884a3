"""Imaging window of a swinging rover. Pure.

An elliptical swing with the amplitudes a and b turns the rover at the rate
w sqrt(a^2 sin^2 wt + b^2 cos^2 wt), slowest, at w b, at its turning points. On a long tether the
rate stays low there for seconds, long enough for pictures. The winch's trim reduces a, keeps the
momentum, proportional to a b, and so increases b.
"""

from __future__ import annotations

import math

_CANDIDATES = 24  # ellipses between the present one and its circle


def imaging_window(major: float, minor: float, frequency: float, rate: float) -> float:
    """Time [s] per half period in which a swing turns the rover slower than a rate.

    Args:
        major: major amplitude [rad].
        minor: minor amplitude [rad].
        frequency: of the swing [rad/s].
        rate: limit [rad/s].
    """
    slowest, fastest = frequency * abs(minor), frequency * major
    if fastest <= rate:
        return math.inf
    if slowest >= rate:
        return 0.0
    share = (rate**2 - slowest**2) / (fastest**2 - slowest**2)
    return 2.0 / frequency * math.asin(math.sqrt(share))


def longest_imaging_window(major: float, minor: float, frequency: float, rate: float) -> float:
    """Longest imaging window [s] of all ellipses that the winch can reach from this one."""
    product = major * abs(minor)
    circle = math.sqrt(product)
    if frequency * circle <= rate:
        return math.inf
    windows = []
    for n in range(_CANDIDATES + 1):
        axis = circle + (major - circle) * n / _CANDIDATES
        windows.append(imaging_window(axis, product / axis, frequency, rate))
    return max(windows)
