"""Packets against numpy, with 4 lanes (plane) and 8 (space)."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from rover_sim.physics.numerics import simd

TAGS = [((0.0, 0.0), 4), ((0.0, 0.0, 0.0), 8)]


@njit
def _arithmetic(tag: Any, a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    x, y = simd.load(tag, a, (1, 2)), simd.load(tag, b, (0,))
    simd.store(out, (0, 0), 2.0 * x + y / (x * x + 1.0) - simd.root(y))
    y += 1.5 - x
    simd.store(out, (1, 0), y)
    simd.store(out, (2, 0), simd.fill(tag, simd.lane(x, 3)))
    simd.store(out, (3, 0), simd.with_lane(x, 2, -7.0))
    simd.store(out, (4, 0), simd.larger(simd.magnitude(x), y))


@njit
def _transposed(tag: Any, square: np.ndarray) -> None:
    rows = simd.stack(tag, 9)
    n = square.shape[0]
    for i in range(n):
        rows[i + 1] = simd.load(tag, square, (i, 0))
    simd.transpose(rows, 1)
    for i in range(n):
        simd.store(square, (i, 0), rows[i + 1])


@pytest.mark.parametrize(("tag", "lanes"), TAGS)
def test_arithmetic_acts_lane_by_lane(tag: tuple[float, ...], lanes: int) -> None:
    generator = np.random.default_rng(0)
    a, b = generator.normal(size=(3, lanes + 3)), generator.uniform(1, 2, size=lanes)
    out = np.zeros((5, lanes))
    _arithmetic(tag, a, b, out)
    x = a[1, 2 : 2 + lanes]
    assert out[0] == pytest.approx(2 * x + b / (x * x + 1) - np.sqrt(b))
    assert out[1] == pytest.approx(b + 1.5 - x)
    assert out[2] == pytest.approx(np.full(lanes, x[3]))
    assert out[3].tolist() == [*x[:2], -7.0, *x[3:]]
    assert out[4] == pytest.approx(np.maximum(np.abs(x), b + 1.5 - x))


@pytest.mark.parametrize(("tag", "lanes"), TAGS)
def test_transpose(tag: tuple[float, ...], lanes: int) -> None:
    square = np.random.default_rng(0).normal(size=(lanes, lanes))
    given = square.copy()
    _transposed(tag, square)
    assert np.array_equal(square, given.T)
