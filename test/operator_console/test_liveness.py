"""Dead sources are found by machine time; a stopped clock and one of two plants by itself."""

from __future__ import annotations

import pytest

from msg_schemas import topics
from operator_console.liveness import DEAD_AFTER, Liveness

PERIOD = 0.02  # of the winch's estimate by simulated time [s]


def run(known: Liveness, until: float, speed: float, begin: float = 0.0) -> None:
    """Let estimates and the clock arrive at a speed of simulated time."""
    for tick in range(round(until * speed / PERIOD) + 1):
        now = begin + tick * PERIOD / speed
        known.on_clock(round((begin + tick * PERIOD) * 1e9), now)
        known.on_sample(topics.WINCH_ESTIMATE, now)


@pytest.mark.parametrize("speed", [0.01, 0.04, 1.0, 20.0])
def test_a_slow_simulation_is_no_fault_and_a_dead_winch_in_it_is_found(speed: float):
    known = Liveness()
    run(known, 2.0, speed)
    assert (
        known.dead_for(topics.WINCH_ESTIMATE, 2.0 + 0.9 * max(DEAD_AFTER, PERIOD / speed)) is None
    )
    later = 2.0
    for tick in range(1, 1 + round(max(6.0 * PERIOD, speed) / PERIOD)):
        later = 2.0 + tick * PERIOD / speed
        known.on_clock(round((2.0 * speed + tick * PERIOD) * 1e9), later)
    assert known.dead_for(topics.WINCH_ESTIMATE, later) == pytest.approx(later - 2.0)
    assert known.fault_of_time(later) == ""


def test_time_that_stands_still_is_a_fault_unless_it_is_paused():
    known = Liveness()
    run(known, 1.0, 1.0)
    assert known.fault_of_time(1.0 + 0.9 * DEAD_AFTER) == ""
    assert "stands still" in known.fault_of_time(1.1 + DEAD_AFTER)
    assert known.dead_for(topics.WINCH_ESTIMATE, 1.1 + DEAD_AFTER) is not None
    known.on_pause(True, 3.0)
    assert known.fault_of_time(3.1) == ""
    assert known.dead_for(topics.WINCH_ESTIMATE, 3.1) is None
    known.on_pause(False, 3.2)
    assert known.fault_of_time(3.3) == "", "the first tick after a pause may take its time"


def test_what_lived_before_a_pause_lives_and_what_was_dead_is_dead():
    known = Liveness()
    known.on_clock(0, 0.0)
    known.on_sample(topics.DESCENT_STATE, 0.0)
    run(known, 2.0, 1.0)
    known.on_clock(2_100_000_000, 2.1)  # the newest of a batch, after the batch's samples
    for tick in range(50):
        known.on_pause(True, 2.1 + 0.1 * tick)
    assert known.dead_for(topics.WINCH_ESTIMATE, 7.0) is None
    assert known.dead_for(topics.DESCENT_STATE, 7.0) == 7.0


def test_a_clock_that_is_set_back_is_no_fault_and_one_that_alternates_has_two_sources():
    known = Liveness()
    run(known, 1.0, 1.0, begin=100.0)
    known.on_clock(0, 101.1)
    assert known.fault_of_time(101.1) == ""
    assert known.dead_for(topics.WINCH_ESTIMATE, 101.1 + 2 * DEAD_AFTER) is not None
    for stamp, now in ((50.0, 101.2), (0.1, 101.3)):
        known.on_clock(round(stamp * 1e9), now)
    assert known.fault_of_time(101.3) == "", "an operator may reset it twice"
    for stamp, now in ((50.0, 101.4), (0.2, 101.5)):
        known.on_clock(round(stamp * 1e9), now)
    assert "two plants" in known.fault_of_time(101.5)


def test_one_long_step_on_a_busy_machine_does_not_hide_that_the_clock_stands():
    known = Liveness()
    run(known, 1.0, 1.0, begin=100.0)
    known.on_clock(1_900_000_000, 101.9)
    assert known.fault_of_time(101.9 + 0.9 * DEAD_AFTER) == ""
    assert "stands still" in known.fault_of_time(101.9 + 1.1 * DEAD_AFTER)


def test_what_was_never_received_is_not_dead():
    known = Liveness()
    assert not known.has_plant
    assert known.dead_for(topics.WINCH_ESTIMATE, 100.0) is None
    known.on_sample(topics.SIM_STATUS, 100.0)
    assert known.has_plant
    assert known.dead_for(topics.SIM_STATUS, 101.0) == 1.0
