"""Spring estimate: its model and its convergence to unknown springs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rover_control.prediction.jump_spring import Height, SpringEstimate, SpringParameters

PARAMETERS = SpringParameters()


def true_height(stroke: float, gain: float, zero: float, tilt: float = 0.0) -> float:
    """Energy and momentum written out: Body 2 is accelerated and takes Body 1 along."""
    m1, m2, g = 6.0, 4.0, 1.62
    x = stroke + zero
    thrown = math.sqrt(2.0 * (0.5 * 824.0 * x**2 - m2 * g * x) / m2)
    speed = m2 * thrown / (m1 + m2) * math.cos(tilt)
    return PARAMETERS.height_gain * gain * speed**2 / (2.0 * g)


def test_the_model_matches_energy_and_momentum_balance():
    spring = SpringEstimate(PARAMETERS)
    for stroke, tilt in ((0.05, 0.0), (0.2, 0.0), (0.15, 0.3)):
        expected = true_height(stroke, 1.0, 0.0, tilt)
        assert spring.expected(stroke, tilt).mean == pytest.approx(expected, rel=1e-12)


@given(height=st.floats(1e-3, 2.0), tilt=st.floats(0.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_the_stroke_for_a_height_reaches_it(height: float, tilt: float):
    spring = SpringEstimate(PARAMETERS)
    spring.update(0.1, 0.095)
    stroke = spring.stroke_for(height, tilt)
    assert spring.expected(stroke, tilt).mean == pytest.approx(height, rel=1e-9)


@given(gain=st.floats(0.93, 1.07), zero=st.floats(-2e-3, 2e-3), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_the_estimate_converges_to_the_true_spring(gain: float, zero: float, seed: int):
    generator = np.random.default_rng(seed)
    spring = SpringEstimate(PARAMETERS)
    for _ in range(15):
        requested_height = float(generator.uniform(0.08, 0.35))
        stroke = spring.stroke_for(requested_height)
        flown = true_height(stroke + 5e-4 * generator.standard_normal(), gain, zero)
        assert spring.update(stroke, flown)
    for requested_height in (0.1, 0.2, 0.35):
        flown = true_height(spring.stroke_for(requested_height), gain, zero)
        assert flown == pytest.approx(requested_height, rel=0.03)
    assert spring.jumps == 15


def test_the_intervals_narrow_and_keep_their_coverage():
    generator = np.random.default_rng(5)
    inside, count = 0, 0
    for _ in range(400):
        spring = SpringEstimate(PARAMETERS)
        gain = math.exp(PARAMETERS.height_gain_std * generator.standard_normal())
        zero = PARAMETERS.nut_zero_std * generator.standard_normal()
        before = spring.expected(0.15).spread
        for _ in range(5):
            stroke = float(generator.uniform(0.1, 0.2))
            scatter = PARAMETERS.stroke_tolerance * generator.uniform(-1.0, 1.0)
            flown = true_height(stroke + scatter, gain, zero)
            flown *= math.exp(PARAMETERS.height_model_std * generator.standard_normal())
            height = spring.expected(stroke)
            low, high = height.interval(0.9)
            inside += low <= flown <= high
            count += 1
            spring.update(
                stroke, flown + PARAMETERS.height_measurement_std * generator.standard_normal()
            )
        assert spring.expected(0.15).spread < before
    assert 0.88 <= inside / count <= 0.92


def test_an_outlier_is_rejected():
    spring = SpringEstimate(PARAMETERS)
    assert not spring.update(0.2, 0.1)
    assert not spring.update(0.2, math.nan)
    assert not spring.update(0.01, 0.1)
    assert (spring.gain, spring.zero, spring.jumps) == (1.0, 0.0, 0)


def test_samples_match_the_expected_distribution():
    spring = SpringEstimate(PARAMETERS)
    drawn = spring.sample_errors(np.random.default_rng(1), 4000)
    heights = [true_height(0.15, float(gain), float(zero)) for gain, zero in drawn]
    expected = spring.expected(0.15)
    assert np.std(np.log(heights)) == pytest.approx(expected.deviation, rel=0.05)
    assert np.median(heights) == pytest.approx(expected.mean, rel=0.01)


def test_quantiles_are_those_of_a_normal_plus_a_uniform_error():
    assert Height(0.2, 0.0, 0.04).interval(0.9) == pytest.approx(
        (0.2 * math.exp(-0.036), 0.2 * math.exp(0.036))
    )
    assert Height(0.2, 0.02).interval(0.9) == pytest.approx(
        (0.2 * math.exp(-1.644854 * 0.02), 0.2 * math.exp(1.644854 * 0.02)), rel=1e-6
    )
    assert Height(0.2, 0.0).interval(0.9) == (0.2, 0.2)
    # Where both errors are similar, by Monte Carlo.
    generator = np.random.default_rng(2)
    drawn = 0.03 * generator.standard_normal(400_000) + 0.05 * generator.uniform(-1, 1, 400_000)
    height = Height(0.2, 0.03, 0.05)
    for probability in (0.02, 0.1, 0.5, 0.95):
        expected = 0.2 * math.exp(float(np.quantile(drawn, probability)))
        assert height.quantile(probability) == pytest.approx(expected, rel=6e-4)
    assert np.std(drawn) == pytest.approx(height.deviation, rel=5e-3)


def test_short_strokes_and_invalid_heights_are_refused():
    spring = SpringEstimate(PARAMETERS)
    with pytest.raises(ValueError, match=r"above 0\.01573 m to lift"):
        spring.expected(0.99 * spring.shortest_stroke)
    for bad in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="height"):
            spring.stroke_for(bad)
