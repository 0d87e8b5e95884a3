"""Curves of plots: extremes are kept, and curves break where nothing was recorded."""

import numpy as np
import pytest

from rover_bags.views.lines import envelope

RATES = pytest.mark.parametrize("count", [500, 20_000])


@RATES
def test_a_curve_breaks_at_pauses_and_resets(count: int):
    first = np.linspace(0.0, 10.0, count)
    time = np.concatenate([first, first + 23.0, first + 1.0])
    values = np.concatenate([np.full(count, level) for level in (1.0, 2.0, 3.0)])
    at, line = envelope(time, values, values)
    assert np.array_equal(np.isnan(at), np.isnan(line))
    gaps = np.flatnonzero(np.isnan(at))
    assert len(gaps) == 2
    stretches = [line[: gaps[0]], line[gaps[0] + 1 : gaps[1]], line[gaps[1] + 1 :]]
    assert [set(each.tolist()) for each in stretches] == [{1.0}, {2.0}, {3.0}]
    # Each part starts at its first value and ends within one bin of its last.
    assert at[[0, gaps[0] + 1, gaps[1] + 1]] == pytest.approx([0.0, 23.0, 1.0])
    assert at[[gaps[0] - 1, gaps[1] - 1, -1]] == pytest.approx([10.0, 33.0, 11.0], abs=0.05)


@RATES
def test_a_single_peak_is_kept(count: int):
    time = np.linspace(0.0, 10.0, count)
    values = np.zeros(count)
    values[count // 3] = 7.0
    assert np.max(envelope(time, values, values)[1]) == 7.0


def test_a_slow_topic_has_no_breaks():
    time = np.arange(0.0, 60.0, 2.0)
    assert not np.isnan(envelope(time, time, time)[0]).any()
    assert [len(each) for each in envelope(time[:0], time[:0], time[:0])] == [0, 0]
