"""The estimated clock offset is correct within its uncertainty."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msg_schemas.parameters import ParameterError, from_mapping
from rover_hil.bridge.clock_offset import LARGEST_DRIFT, ClockOffset
from rover_hil.bridge.statistics import WINDOW_SIZE, SlidingWindow, percentiles

NANO = 1_000_000_000
DELAYS = st.integers(1_000, 5_000_000)


@given(
    offset=st.integers(-(10**12), 10**12),
    drift=st.floats(-90e-6, 90e-6),
    delays=st.lists(st.tuples(DELAYS, DELAYS, DELAYS), min_size=1, max_size=80),
)
def test_the_true_offset_lies_within_the_uncertainty_for_any_delays(
    offset: int, drift: float, delays: list[tuple[int, int, int]]
):
    clock, now = ClockOffset(), 0
    for there, at_device, back in delays:
        now += 5_000_000
        arrived, answered = now + there, now + there + at_device

        def by_device(true_ns: int) -> int:
            return true_ns + offset + round(drift * true_ns)

        assert clock.add(now, by_device(arrived), by_device(answered), answered + back)
        now = answered + back
    found = clock.now(now)
    assert found is not None
    truth = (offset + drift * now) / NANO
    assert abs(found.value - truth) <= found.uncertainty + 2e-9


def test_the_narrowest_exchange_counts_until_drift_makes_it_wider_than_a_later_one():
    clock = ClockOffset()
    clock.add(0, 1_000_050, 1_000_050, 100)  # good to 50 ns
    clock.add(1000, 1_500_000, 1_500_000, 1_001_000)  # good to 0.5 ms
    early = clock.now(2000)
    assert early is not None
    assert early.uncertainty < 1e-6
    # After 10 s a drift of 100 ppm is 1 ms: an exchange good to 0.5 ms is better.
    later = 10 * NANO
    clock.add(later, later + 1_400_000, later + 1_400_000, later + 1_000_000)
    late = clock.now(later + 1_000_000)
    assert late is not None
    assert late.value != early.value
    assert late.uncertainty < 0.6e-3


def test_an_inconsistent_exchange_is_rejected():
    clock = ClockOffset()
    assert not clock.add(100, 50, 200, 150)  # answered later than it was received
    assert not clock.add(100, 200, 150, 400)  # answered before it arrived
    assert clock.now(0) is None
    clock.add(0, 10, 20, 30)
    clock.reset()
    assert clock.now(0) is None


@pytest.mark.ros
def test_no_clock_is_emulated_that_drifts_faster_than_the_estimate_assumes():
    from rover_hil.emulator.emulator_node import EmulatorParameters

    from_mapping(EmulatorParameters, {"rover_clock_drift": LARGEST_DRIFT})
    with pytest.raises(ParameterError, match="rover_clock_drift"):
        from_mapping(EmulatorParameters, {"rover_clock_drift": 1.1 * LARGEST_DRIFT})


def test_percentiles_are_values_that_were_measured():
    window = SlidingWindow()
    assert percentiles(window.copied_values()) is None
    window.add(3.0)
    assert percentiles(window.copied_values()) == (1, 3.0, 3.0, 3.0)
    for value in range(2 * WINDOW_SIZE):
        window.add(float(value))
    values = window.copied_values()
    window.add(1e9)
    found = percentiles(values)
    assert found is not None
    assert found.number == WINDOW_SIZE
    assert found.p50 == 1.5 * WINDOW_SIZE
    assert found.p99 == 1.99 * WINDOW_SIZE
    assert found.largest == 2 * WINDOW_SIZE - 1
