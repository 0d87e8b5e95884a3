"""Swing damping by the winch: strokes, and decay of a simulated pendulum."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise

import pytest
from rope_pendulum import HANGING, H, swinging

from rover_control.hanging.swing_damping import DampingParameters, WinchTrim

DAMPING = DampingParameters()


@pytest.mark.parametrize(
    ("length", "bound"), [(45.0, "rate"), (7.5, "acceleration"), (0.5, "acceleration")]
)
def test_the_stroke_keeps_the_tightest_bound(length: float, bound: str):
    frequency = HANGING.swing_frequency(length)
    stroke = WinchTrim(DAMPING).stroke(length, frequency)
    spent = {
        "rate": 2.0 * frequency * stroke / DAMPING.trim_rate,
        "acceleration": 4.0 * frequency**2 * stroke / (0.8 * DAMPING.trim_acceleration),
        "fraction": stroke / (DAMPING.trim_length_fraction * length),
    }
    assert spent.pop(bound) == pytest.approx(1.0)
    assert max(spent.values()) < 1.0


def test_a_fraction_of_the_length_bounds_a_fast_winch():
    quick = WinchTrim(
        DampingParameters(trim_rate=0.3, trim_acceleration=5.0, trim_length_fraction=0.01)
    )
    assert quick.stroke(2.0, HANGING.swing_frequency(2.0)) == pytest.approx(0.01 * 2.0)


@pytest.mark.parametrize("length", [2.5, 7.5, 45.0])
def test_a_plane_swing_decays_as_predicted(length: float):
    trim = WinchTrim(DAMPING)
    rover = swinging(length, 3.0)
    decay = trim.decay(length, HANGING.swing_frequency(length))
    for _ in range(round(1.0 / (decay * H))):
        rover.step(trim.step(rover.estimate(), length, rover.trimmed, H))
    fallen = math.log(math.radians(3.0) / rover.amplitude)
    assert fallen == pytest.approx(1.0, rel=0.15)
    assert abs(rover.trimmed) < 1.1 * trim.stroke(length, 0.2)


@pytest.mark.parametrize("length", [2.0, 7.5])
def test_a_raised_swing_grows_as_a_damped_one_decays(length: float):
    trim = WinchTrim(DAMPING)
    rover = swinging(length, 0.02)  # below the amplitude at which damping fades out
    decay = trim.decay(length, HANGING.swing_frequency(length))
    for _ in range(round(2.0 / (decay * H))):
        rover.step(trim.step(rover.estimate(), length, rover.trimmed, H, -1.0))
    assert math.log(rover.amplitude / math.radians(0.02)) == pytest.approx(2.0, rel=0.15)


def test_the_winch_turns_an_ellipse_into_a_circle_and_leaves_circles():
    trim = WinchTrim(DAMPING)
    circle = swinging(10.0, 1.0, 1.0)
    assert abs(trim.step(circle.estimate(), 10.0, 0.0, H)) < 1e-3 * DAMPING.trim_rate
    ellipse = swinging(10.0, 2.0, 0.5)
    before = ellipse.momentum
    for _ in range(round(200.0 / H)):
        ellipse.step(trim.step(ellipse.estimate(), 10.0, ellipse.trimmed, H))
    end = ellipse.estimate().ellipse
    assert math.degrees(end.major) == pytest.approx(1.0, abs=0.12)
    assert math.degrees(end.minor) == pytest.approx(1.0, abs=0.12)
    assert ellipse.momentum == pytest.approx(before, rel=0.03)


def test_a_late_winch_with_limited_acceleration_still_damps_a_short_tether():
    trim, rover, length = WinchTrim(DAMPING), swinging(2.0, 3.0), 2.0
    late = round(0.08 / H)  # steps from the command to the winch, and back
    sent = deque([0.0] * late, maxlen=late)
    read = deque([0.0] * late, maxlen=late)
    rate = fastest = 0.0
    decay = trim.decay(length, HANGING.swing_frequency(length))
    for _ in range(round(1.0 / (decay * H))):
        change = DAMPING.trim_acceleration * H
        rate = min(max(sent[0], rate - change), rate + change)
        sent.append(trim.step(rover.estimate(), length, read[0], H))
        rover.step(rate)
        read.append(rover.trimmed)
        fastest = max(fastest, abs(rate))
    assert math.log(math.radians(3.0) / rover.amplitude) > 0.75
    assert fastest < 0.2


def test_on_a_long_tether_the_trim_starts_gently():
    trim, rover, length = WinchTrim(DAMPING), swinging(45.0, 0.3), 45.0
    frequency = HANGING.swing_frequency(length)
    taken = 4.0 * frequency**2 * trim.stroke(length, frequency)
    rates = [0.0]
    for _ in range(round(30.0 / H)):
        rates.append(trim.step(rover.estimate(), length, rover.trimmed, H))
        rover.step(rates[-1])
    fastest = max(abs(after - before) for before, after in pairwise(rates)) / H
    assert taken < fastest < 1.3 * taken
    assert fastest < 0.5 * DAMPING.trim_acceleration
