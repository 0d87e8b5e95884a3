"""Whitening of sensor errors."""

import math

import numpy as np
import pytest

from rover_bags.identification.noise import Errors, Floats, Whitening


def sensed(
    generator: np.random.Generator, errors: Errors, count: int, step: float
) -> tuple[Floats, Floats]:
    """Times, and readings of a sensor whose true value is 0."""
    times = step * np.arange(count)
    walk = np.cumsum(generator.normal(0.0, math.sqrt(errors.walk * step), count))
    bias = generator.normal(0.0, math.sqrt(errors.bias)) + walk
    read = bias + generator.normal(0.0, math.sqrt(errors.white), count)
    return np.asarray(times, dtype=np.float64), read


@pytest.mark.parametrize("walk", [0.0, 2.0])
def test_innovations_of_a_specified_sensor_are_white_with_unit_variance(walk: float):
    errors = Errors(white=0.04, walk=walk, bias=9.0)
    times, read = sensed(np.random.default_rng(3), errors, 4000, 0.02)
    known = np.ones((4000, 1), dtype=bool)
    known[1000:1500] = False
    whitening = Whitening(times, [errors], known)
    innovations = whitening(read[:, None])
    assert whitening.counts.tolist() == [3499]
    assert whitening.scales(innovations)[0] == pytest.approx(1.0, abs=0.05)
    assert whitening.coloured(innovations) == []
    assert np.all(innovations[1000:1500] == 0.0)


def test_an_unspecified_random_walk_is_detected():
    times, read = sensed(np.random.default_rng(4), Errors(0.04, 2.0, 9.0), 4000, 0.02)
    whitening = Whitening(times, [Errors(0.04, 0.0, 9.0)], np.ones((4000, 1), dtype=bool))
    innovations = whitening(read[:, None])
    assert whitening.coloured(innovations) == [0]
    assert whitening.scales(innovations)[0] > 2.0


def test_a_constant_bias_has_no_effect():
    known = np.ones((500, 1), dtype=bool)
    whitening = Whitening(0.02 * np.arange(500.0), [Errors(1.0, 0.0, 0.0)], known)
    innovations = whitening(np.full((500, 1), 7.0))
    assert float(np.linalg.norm(innovations)) < 0.2
