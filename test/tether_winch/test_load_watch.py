"""Touchdown, slack, snag and over-tension from tensions alone, and what is none of them."""

from __future__ import annotations

import math

import pytest

from msg_schemas.parameters import ParameterError
from tether_winch.load_watch import LoadParameters, LoadState, LoadWatch

TICK = 0.01
WEIGHT = 16.2


class Feed:
    """Tells a watch tensions, tick by tick."""

    def __init__(self, **parameters: float) -> None:
        self.watch = LoadWatch(LoadParameters(**parameters))
        self.now = 0.0

    def tell(
        self, tension: float, duration: float, rate: float = 0.1, period: float = 0.3
    ) -> LoadState:
        for _ in range(round(duration / TICK)):
            self.now += TICK
            self.watch.step(tension, 0.1, rate, period, self.now)
        return self.watch.state


@pytest.fixture
def feed() -> Feed:
    feed = Feed()
    assert feed.tell(WEIGHT, 20.0) is LoadState.NORMAL
    return feed


def test_a_rover_that_stands_is_told_after_the_hold_time_and_not_before(feed: Feed):
    assert feed.tell(3.0, 0.5) is LoadState.NORMAL
    assert feed.tell(3.0, 0.3) is LoadState.TOUCHDOWN
    assert feed.watch.is_supported
    assert feed.tell(0.1, 0.8) is LoadState.SLACK


def test_hysteresis_keeps_what_hovers_at_the_threshold(feed: Feed):
    feed.tell(3.0, 1.0)
    assert feed.tell(0.55 * WEIGHT, 5.0) is LoadState.TOUCHDOWN
    assert feed.tell(0.65 * WEIGHT, 1.0) is LoadState.NORMAL


@pytest.mark.parametrize("period", [0.3, 0.6])
def test_the_bounce_after_a_hard_stop_is_no_touchdown_and_no_snag(feed: Feed, period: float):
    feed.watch.note_braking(feed.now)
    for half in range(12):
        share = 1.0 + (1.0 if half % 2 else -1.0) * 0.9 * 0.9**half
        state = feed.tell(max(share, 0.0) * WEIGHT, 0.5 * period, 0.0, period)
        assert state is LoadState.NORMAL


def test_a_scrape_of_half_a_second_is_no_touchdown(feed: Feed):
    for _ in range(5):
        assert feed.tell(0.3 * WEIGHT, 0.5) is LoadState.NORMAL
        assert feed.tell(WEIGHT, 1.0) is LoadState.NORMAL


def test_what_holds_on_while_reeling_in_is_a_snag(feed: Feed):
    assert feed.tell(1.6 * WEIGHT, 0.7, -0.1) is LoadState.SNAG
    assert feed.watch.is_snagged
    assert feed.tell(WEIGHT, 0.5, 0.0) is LoadState.NORMAL


def test_no_snag_is_told_while_the_own_brake_blinds(feed: Feed):
    feed.watch.note_braking(feed.now)
    assert feed.tell(1.6 * WEIGHT, 1.9, 0.0) is LoadState.NORMAL


def test_too_much_is_told_at_once_whatever_the_reason(feed: Feed):
    feed.watch.note_braking(feed.now)
    assert feed.tell(4.0 * WEIGHT, 0.04) is LoadState.OVER_TENSION


def test_a_payload_not_told_of_is_learnt():
    feed = Feed()
    assert feed.tell(1.3 * WEIGHT, 30.0) is LoadState.NORMAL
    assert feed.watch.mean == pytest.approx(1.3 * WEIGHT - 0.1, rel=1e-3)
    assert feed.tell(0.45 * 1.3 * WEIGHT, 1.0) is LoadState.TOUCHDOWN


def test_a_load_that_goes_up_and_down_is_learnt_as_its_mean(feed: Feed):
    for _ in range(60):
        for share in (1.45, 0.55):
            assert feed.tell(share * WEIGHT, 0.5, -0.1) is LoadState.NORMAL
    assert feed.watch.mean == pytest.approx(WEIGHT, rel=0.1)


def test_a_snag_ends_where_the_drum_stands_and_carries_what_it_did_before():
    feed = Feed()
    feed.tell(WEIGHT, 20.0, 0.0)
    # A ledge carries part of it for a while.
    feed.tell(0.6 * WEIGHT, 20.0, 0.1)
    assert feed.tell(WEIGHT, 1.0, -0.1) is LoadState.SNAG
    assert feed.tell(WEIGHT, 3.0, 0.0) is LoadState.NORMAL
    assert feed.tell(WEIGHT, 10.0, -0.1) is LoadState.NORMAL
    # What is caught stays so, for as long as it is.
    assert feed.tell(1.6 * WEIGHT, 1.0, -0.1) is LoadState.SNAG
    assert feed.tell(1.6 * WEIGHT, 30.0, 0.0) is LoadState.SNAG


def test_what_stands_is_not_learnt(feed: Feed):
    mean = feed.watch.mean
    feed.tell(3.0, 60.0)
    assert feed.watch.mean == pytest.approx(mean, rel=0.01)


def test_without_a_tension_nothing_is_known(feed: Feed):
    feed.now += TICK
    assert feed.watch.step(math.nan, 0.1, 0.1, 0.3, feed.now) is LoadState.UNKNOWN


def test_thresholds_that_cross_are_refused():
    with pytest.raises(ParameterError, match="further apart"):
        LoadParameters(touchdown_threshold=0.9, snag_threshold=1.1)
    with pytest.raises(ParameterError, match="further apart"):
        LoadParameters(slack_threshold=0.45)
