"""S-curve within limits of rate, acceleration and jerk. Pure.

Each step takes the largest next acceleration from which a stop before the goal remains possible
within the limits. The stopping distance has a closed form, so goal and limits may change at any
time; a motion beyond new limits is slowed down as fast as they allow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

_BISECTIONS = 24
_CRUISE_TOLERANCE = 1e-6  # of a rate [m/s]
_ARRIVAL_TOLERANCE = 1e-5  # of a length [m]


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a motion; all above zero."""

    rate: float  # [m/s]
    acceleration: float  # [m/s^2]
    jerk: float  # [m/s^3]


class ProfilePoint(NamedTuple):
    """A point of the profile."""

    length: float  # [m]
    rate: float  # [m/s]
    acceleration: float  # [m/s^2]


def stopping_distance(rate: float, acceleration: float, limits: MotionLimits) -> float:
    """Signed stopping distance [m] at the limits."""
    jerk = limits.jerk
    if rate + acceleration * abs(acceleration) / (2.0 * jerk) < 0.0:
        return -_stop_forward(-rate, -acceleration, limits)
    return _stop_forward(rate, acceleration, limits)


def _stop_forward(rate: float, acceleration: float, limits: MotionLimits) -> float:
    """Stopping distance of a forward motion: ramp to -peak, hold, ramp to zero."""
    jerk, most = limits.jerk, limits.acceleration
    # Both ramps together take rate: (peak^2 - a^2/2)/jerk = rate for a triangle.
    peak = math.sqrt(max(0.0, rate * jerk + 0.5 * acceleration * acceleration))
    hold = 0.0
    if peak > most:
        hold = (rate + (0.5 * acceleration * acceleration - most * most) / jerk) / most
        peak = most
    distance = 0.0
    v, a = rate, acceleration
    for jerk_step, time in (
        (-jerk, (a + peak) / jerk),
        (0.0, max(hold, 0.0)),
        (jerk, peak / jerk),
    ):
        distance += time * (v + time * (0.5 * a + jerk_step * time / 6.0))
        v += time * (a + 0.5 * jerk_step * time)
        a += jerk_step * time
    return distance


def advanced(motion: ProfilePoint, acceleration: float, h: float) -> ProfilePoint:
    """The motion h [s] later; the acceleration changes linearly to the given one."""
    start = motion.acceleration
    return ProfilePoint(
        motion.length + h * (motion.rate + h * (2.0 * start + acceleration) / 6.0),
        motion.rate + 0.5 * h * (start + acceleration),
        acceleration,
    )


def toward_length(
    motion: ProfilePoint, goal: float, limits: MotionLimits, h: float
) -> ProfilePoint:
    """Advance by h [s] toward a length [m]; stops there without overshoot."""
    if _has_arrived(motion, goal, limits, h):
        return ProfilePoint(goal, 0.0, 0.0)
    rest = motion.length + stopping_distance(motion.rate, motion.acceleration, limits)
    side = 1.0 if goal >= rest else -1.0

    def stops_in_time(after: ProfilePoint) -> bool:
        distance = stopping_distance(after.rate, after.acceleration, limits)
        return side * (goal - after.length - distance) >= 0.0

    cruising = _cruised(motion, side * limits.rate, h)
    if cruising is not None and stops_in_time(cruising):
        return cruising
    return _furthest(motion, side, stops_in_time, limits, h)


def toward_rate(
    motion: ProfilePoint,
    rate: float,
    limits: MotionLimits,
    h: float,
    ends: tuple[float, float] = (-math.inf, math.inf),
) -> ProfilePoint:
    """Advance by h [s] toward a rate [m/s]; stops before the ends [m]."""
    rate = min(max(rate, -limits.rate), limits.rate)
    end = ends[1] if rate > 0.0 else ends[0]
    if rate != 0.0 and _has_arrived(motion, end, limits, h):
        return ProfilePoint(end, 0.0, 0.0)
    settled = motion.rate + motion.acceleration * abs(motion.acceleration) / (2.0 * limits.jerk)
    side = 1.0 if rate >= settled else -1.0

    def stays_below(after: ProfilePoint) -> bool:
        ramped = after.acceleration * abs(after.acceleration) / (2.0 * limits.jerk)
        if side * (rate - after.rate - ramped) < 0.0:
            return False
        rest = after.length + stopping_distance(after.rate, after.acceleration, limits)
        return rest <= ends[1] if side > 0.0 else rest >= ends[0]

    cruising = _cruised(motion, rate, h)
    if cruising is not None and rate != 0.0:
        rest = cruising.length + stopping_distance(rate, 0.0, limits)
        if ends[0] <= rest <= ends[1]:
            return cruising
    after = _furthest(motion, side, stays_below, limits, h)
    distance = stopping_distance(after.rate, after.acceleration, limits)
    leads_out = (distance > 0.0 and after.length + distance > ends[1]) or (
        distance < 0.0 and after.length + distance < ends[0]
    )
    if leads_out:
        return toward_length(motion, ends[1] if distance > 0.0 else ends[0], limits, h)
    if abs(after.rate - rate) <= _CRUISE_TOLERANCE and abs(after.acceleration) <= limits.jerk * h:
        return after._replace(rate=rate, acceleration=0.0)
    return after


def _has_arrived(motion: ProfilePoint, goal: float, limits: MotionLimits, h: float) -> bool:
    return (
        abs(goal - motion.length) <= _ARRIVAL_TOLERANCE
        and abs(motion.rate) * h <= _ARRIVAL_TOLERANCE
        and abs(motion.acceleration) <= limits.jerk * h
    )


def _cruised(motion: ProfilePoint, rate: float, h: float) -> ProfilePoint | None:
    """The motion h [s] later at a constant rate; None if it does not have this rate yet."""
    if abs(motion.acceleration) > _CRUISE_TOLERANCE or abs(motion.rate - rate) > _CRUISE_TOLERANCE:
        return None
    return ProfilePoint(motion.length + h * rate, rate, 0.0)


def _furthest(
    motion: ProfilePoint,
    side: float,
    allowed: Callable[[ProfilePoint], bool],
    limits: MotionLimits,
    h: float,
) -> ProfilePoint:
    """Step with the largest allowed acceleration toward a side; the smallest if none is allowed."""
    reach = limits.jerk * h
    high = min(side * motion.acceleration + reach, limits.acceleration)
    low = max(side * motion.acceleration - reach, -limits.acceleration)
    high, low = max(high, low), min(high, low)
    # The rate must stay within its limit while the acceleration ramps down to zero.
    ramp = limits.jerk * h

    def within(acceleration: float) -> bool:
        after = advanced(motion, side * acceleration, h)
        peak = side * after.rate + max(acceleration, 0.0) * (max(acceleration, 0.0) + ramp) / (
            2.0 * limits.jerk
        )
        return peak <= limits.rate and allowed(after)

    if within(high):
        return advanced(motion, side * high, h)
    if not within(low):
        return advanced(motion, side * low, h)
    good, bad = low, high
    for _ in range(_BISECTIONS):
        middle = 0.5 * (good + bad)
        if within(middle):
            good = middle
        else:
            bad = middle
    return advanced(motion, side * good, h)
