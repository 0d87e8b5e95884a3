"""Imaging windows against simulated motion, and the swing filter."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from rover_control.hanging.imaging_window import imaging_window, longest_imaging_window
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.swing_filter import SwingFilter


@pytest.mark.parametrize(("major", "minor"), [(0.01, 0.0), (0.01, 0.003), (0.02, -0.004)])
def test_the_window_matches_the_motion(major: float, minor: float):
    w, limit = 0.23, 1.2e-3
    times = np.linspace(0.0, math.pi / w, 200001)
    rates = w * np.hypot(major * np.sin(w * times), minor * np.cos(w * times))
    slow = float(np.mean(rates < limit)) * math.pi / w
    assert imaging_window(major, minor, w, limit) == pytest.approx(slow, abs=1e-3)


def test_a_slow_circle_has_no_end_and_a_fast_one_no_window():
    assert imaging_window(0.004, 0.004, 0.2, 0.001) == math.inf
    assert imaging_window(0.02, 0.01, 0.2, 0.001) == 0.0


def test_the_best_ellipse_is_no_circle_if_the_circle_is_too_fast():
    w, limit = 0.23, 1.7e-3
    circle = 1.05 * limit / w
    major = 2.5 * circle
    minor = circle**2 / major
    best = longest_imaging_window(major, minor, w, limit)
    assert 0.0 < best < math.inf
    assert best >= imaging_window(major, minor, w, limit)
    assert imaging_window(circle, circle, w, limit) == 0.0
    # A much larger momentum has no slow ellipse; a much smaller one a slow circle.
    assert longest_imaging_window(3.0 * circle, 2.0 * circle, w, limit) == 0.0
    assert longest_imaging_window(2.0 * circle, 0.2 * circle, w, limit) == math.inf


def test_the_filter_removes_the_tilt_without_delaying_the_swing():
    w, tilting, h = 0.4, 4.2, 0.02
    steady = SwingFilter()
    ahead, back = 0.02, 0.012 * cmath.exp(0.7j)
    misses = []
    for n in range(round(60.0 / h)):
        t = n * h
        heading = 0.05 * t
        turned = cmath.exp(-1j * heading)
        z = ahead * cmath.exp(1j * w * t) + back * cmath.exp(-1j * w * t)
        v = 1j * w * (ahead * cmath.exp(1j * w * t) - back * cmath.exp(-1j * w * t))
        true, rate = z * turned, v * turned
        filtered = rate + 0.2 * w * 0.02 * math.cos(tilting * t)
        zero = (0.0, 0.0)
        swing = SwingEstimate(
            (true.real, true.imag),
            (filtered.real, filtered.imag),
            zero,
            zero,
            zero,
            0.05,
            w,
            0.0,
            0.0,
        )
        lasting = steady.step(swing, heading, h)
        if t > 40.0:
            misses.append(abs(complex(*lasting.direction_rate) - rate))
    assert max(misses) < 0.15 * 0.2 * w * 0.02
