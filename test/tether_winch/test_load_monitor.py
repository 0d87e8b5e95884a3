"""Detection of touchdown, slack, snag and over-tension, without false alarms."""

from __future__ import annotations

import math

import pytest

from msg_schemas.parameters import ParameterError
from msg_schemas.phases import LoadState
from tether_winch.load_monitor import LoadMonitor, LoadParameters

TICK = 0.01
WEIGHT = 16.2


class Feed:
    """Feeds tensions to a monitor, tick by tick."""

    def __init__(self, **parameters: float) -> None:
        self.watch = LoadMonitor(LoadParameters(**parameters))
        self.now = 0.0

    def step(
        self, tension: float, duration: float, rate: float = 0.1, period: float = 0.3
    ) -> LoadState:
        for _ in range(round(duration / TICK)):
            self.now += TICK
            self.watch.step(tension, 0.1, rate, period, self.now)
        return self.watch.state


@pytest.fixture
def feed() -> Feed:
    feed = Feed()
    assert feed.step(WEIGHT, 20.0) is LoadState.NORMAL
    return feed


def test_touchdown_is_reported_after_the_debounce_time(feed: Feed):
    assert feed.step(3.0, 0.5) is LoadState.NORMAL
    assert feed.step(3.0, 0.3) is LoadState.TOUCHDOWN
    assert feed.watch.is_supported
    assert feed.step(0.1, 0.8) is LoadState.SLACK


def test_a_rover_that_leaned_on_the_ground_is_lifted_without_a_snag(feed: Feed):
    feed.step(3.0, 2.0)
    assert feed.step(0.65 * WEIGHT, 60.0, 0.0) is LoadState.NORMAL
    assert feed.watch.mean == pytest.approx(WEIGHT, rel=0.01)
    assert feed.step(WEIGHT, 5.0, -0.1) is LoadState.NORMAL


def test_a_lighter_rover_that_stood_is_weighed_once_it_is_lifted(feed: Feed):
    feed.step(3.0, 2.0)
    assert feed.step(0.7 * WEIGHT, 15.0, -0.1) is LoadState.NORMAL
    assert feed.watch.mean == pytest.approx(0.7 * WEIGHT, rel=0.2)


def test_a_clock_that_goes_back_leaves_the_mean():
    feed = Feed()
    feed.step(1.1 * WEIGHT, 1.0)
    mean = feed.watch.mean
    feed.now -= 1.95
    feed.step(1.1 * WEIGHT, 2 * TICK)
    assert WEIGHT < mean <= feed.watch.mean < 1.1 * WEIGHT


def test_hysteresis_keeps_the_state_near_a_threshold(feed: Feed):
    feed.step(3.0, 1.0)
    assert feed.step(0.55 * WEIGHT, 5.0) is LoadState.TOUCHDOWN
    assert feed.step(0.65 * WEIGHT, 1.0) is LoadState.NORMAL


@pytest.mark.parametrize("period", [0.3, 0.6])
def test_the_bounce_after_a_hard_stop_is_no_touchdown_and_no_snag(feed: Feed, period: float):
    feed.watch.on_braking(feed.now)
    for half in range(12):
        share = 1.0 + (1.0 if half % 2 else -1.0) * 0.9 * 0.9**half
        state = feed.step(max(share, 0.0) * WEIGHT, 0.5 * period, 0.0, period)
        assert state is LoadState.NORMAL


def test_a_scrape_of_half_a_second_is_no_touchdown(feed: Feed):
    for _ in range(5):
        assert feed.step(0.3 * WEIGHT, 0.5) is LoadState.NORMAL
        assert feed.step(WEIGHT, 1.0) is LoadState.NORMAL


def test_a_high_load_while_reeling_in_is_a_snag(feed: Feed):
    assert feed.step(1.6 * WEIGHT, 0.7, -0.1) is LoadState.SNAG
    assert feed.watch.is_snagged
    assert feed.step(WEIGHT, 0.5, 0.0) is LoadState.NORMAL


def test_no_snag_is_reported_during_brake_blanking(feed: Feed):
    feed.watch.on_braking(feed.now)
    assert feed.step(1.6 * WEIGHT, 1.9, 0.0) is LoadState.NORMAL


def test_over_tension_is_reported_at_once(feed: Feed):
    feed.watch.on_braking(feed.now)
    assert feed.step(4.0 * WEIGHT, 0.04) is LoadState.OVER_TENSION


def test_the_mean_adapts_to_an_unknown_payload():
    feed = Feed()
    assert feed.step(1.3 * WEIGHT, 30.0) is LoadState.NORMAL
    assert feed.watch.mean == pytest.approx(1.3 * WEIGHT - 0.1, rel=1e-3)
    assert feed.step(0.45 * 1.3 * WEIGHT, 1.0) is LoadState.TOUCHDOWN


def test_an_oscillating_load_gives_its_mean(feed: Feed):
    for _ in range(60):
        for share in (1.45, 0.55):
            assert feed.step(share * WEIGHT, 0.5, -0.1) is LoadState.NORMAL
    assert feed.watch.mean == pytest.approx(WEIGHT, rel=0.1)


def test_a_snag_clears_when_the_drum_stands_with_its_earlier_load():
    feed = Feed()
    feed.step(WEIGHT, 20.0, 0.0)
    # A ledge carries part of it for a while.
    feed.step(0.6 * WEIGHT, 20.0, 0.1)
    assert feed.step(WEIGHT, 1.0, -0.1) is LoadState.SNAG
    assert feed.step(WEIGHT, 3.0, 0.0) is LoadState.NORMAL
    assert feed.step(WEIGHT, 10.0, -0.1) is LoadState.NORMAL
    # A persistent snag is not cleared.
    assert feed.step(1.6 * WEIGHT, 1.0, -0.1) is LoadState.SNAG
    assert feed.step(1.6 * WEIGHT, 30.0, 0.0) is LoadState.SNAG


def test_a_supported_load_does_not_change_the_mean(feed: Feed):
    mean = feed.watch.mean
    feed.step(3.0, 60.0)
    assert feed.watch.mean == pytest.approx(mean, rel=0.01)


def test_without_a_tension_the_state_is_unknown(feed: Feed):
    feed.now += TICK
    assert feed.watch.step(math.nan, 0.1, 0.1, 0.3, feed.now) is LoadState.UNKNOWN


def test_crossing_thresholds_are_refused():
    with pytest.raises(ParameterError, match="further apart"):
        LoadParameters(touchdown_threshold=0.9, snag_threshold=1.1)
    with pytest.raises(ParameterError, match="further apart"):
        LoadParameters(slack_threshold=0.45)
