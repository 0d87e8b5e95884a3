"""S-curves keep their limits and reach their goals from any state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tether_winch.profile import (
    MotionLimits,
    ProfilePoint,
    stopping_distance,
    toward_length,
    toward_rate,
)

H = 0.01
LIMITS = MotionLimits(0.3, 0.3, 1.0)
SLACK = 1e-9

limits = st.builds(
    MotionLimits,
    rate=st.floats(0.02, 0.5),
    acceleration=st.floats(0.05, 2.0),
    jerk=st.floats(0.3, 20.0),
)


def run(
    motion: ProfilePoint, goal: float, limits: MotionLimits, duration: float
) -> list[ProfilePoint]:
    path = [motion]
    for _ in range(round(duration / H)):
        path.append(toward_length(path[-1], goal, limits, H))
    return path


def assert_within(path: list[ProfilePoint], limits: MotionLimits) -> None:
    rates = np.array([m.rate for m in path])
    accelerations = np.array([m.acceleration for m in path])
    assert np.abs(rates).max() <= limits.rate + 1e-6
    assert np.abs(accelerations).max() <= limits.acceleration + SLACK
    # Twice in the one step that ends a ramp on its rate, or a motion on its goal.
    assert np.abs(np.diff(accelerations)).max() <= 2.0 * limits.jerk * H * (1.0 + 1e-6)


@settings(deadline=None, max_examples=15)
@given(limits, st.floats(-5.0, 5.0))
def test_a_length_is_reached_within_all_limits_and_without_overshoot(
    limits: MotionLimits, goal: float
):
    path = run(ProfilePoint(0.0, 0.0, 0.0), goal, limits, 5.0 / limits.rate + 20.0)
    assert_within(path, limits)
    assert path[-1] == ProfilePoint(goal, 0.0, 0.0)
    lengths = np.array([m.length for m in path])
    # Less than a millimetre even where the acceleration comes and goes within one step.
    assert (np.sign(goal) * (lengths - goal)).max() <= 1e-3


@settings(deadline=None, max_examples=15)
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.1, 6.0))
def test_the_motion_stays_smooth_when_the_goal_changes(first: float, second: float, after: float):
    path = run(ProfilePoint(0.0, 0.0, 0.0), first, LIMITS, after)
    path += run(path[-1], second, LIMITS, 45.0)[1:]
    assert_within(path, LIMITS)
    assert path[-1] == ProfilePoint(second, 0.0, 0.0)


def test_the_duration_of_a_long_motion_matches_the_closed_form():
    path = run(ProfilePoint(0.0, 0.0, 0.0), 3.0, LIMITS, 20.0)
    arrived = next(i for i, m in enumerate(path) if m.length == 3.0) * H
    # Trapezoid with ramps of the acceleration: distance/v + v/a + a/j.
    assert arrived == pytest.approx(3.0 / 0.3 + 0.3 / 0.3 + 0.3 / 1.0, abs=0.05)


@settings(deadline=None, max_examples=20)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_the_stopping_distance_matches_braking_at_the_limits(rate: float, acc: float):
    limits = MotionLimits(1.0, 0.3, 1.0)
    distance = stopping_distance(rate, acc, limits)
    h = 1e-3
    motion = ProfilePoint(0.0, rate, acc)
    for _ in range(4000):
        motion = toward_rate(motion, 0.0, limits, h)
        if motion.rate == 0.0 and motion.acceleration == 0.0:
            break
    assert motion.length == pytest.approx(distance, abs=1e-3)


@settings(deadline=None, max_examples=15)
@given(st.floats(-0.4, 0.4), st.floats(0.0, 4.0))
def test_a_rate_is_reached_and_stops_before_the_ends(rate: float, at: float):
    motion = ProfilePoint(at, 0.0, 0.0)
    path = [motion]
    for _ in range(3500):
        path.append(toward_rate(path[-1], rate, LIMITS, H, (0.0, 4.0)))
    assert_within(path, LIMITS)
    lengths = [m.length for m in path]
    assert min(lengths) >= -1e-5
    assert max(lengths) <= 4.0 + 1e-5
    if abs(rate) > 0.15:
        assert path[-1].rate == 0.0
        assert path[-1].length == pytest.approx(4.0 if rate > 0.0 else 0.0, abs=1e-4)


def test_a_zero_rate_goal_stands_still():
    assert toward_rate(ProfilePoint(1.0, 0.0, 0.0), 0.0, LIMITS, H) == ProfilePoint(1.0, 0.0, 0.0)
    assert math.isclose(stopping_distance(0.0, 0.0, LIMITS), 0.0)
