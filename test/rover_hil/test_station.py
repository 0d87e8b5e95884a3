"""A device's answers: its sample times go on, whatever the time between them."""

import pytest

from rover_hil.bridge.station import Station
from rover_hil.canopen.devices import WINCH

_MINUTE_NS = 60 * 10**9


def answer(station: Station, sampled_us: int, now_ns: int) -> bool:
    """Give the first answer of a cycle, whose sample time counts microseconds in 32 bits."""
    station.end_cycle(now_ns)
    pdo = next(
        pdo for pdo in station.device.tpdos if "sample_time" in {each.key for each in pdo.entries}
    )
    counts = {"sync_counter": 1, "sample_time": sampled_us % (1 << 32), "reply_delay": 0}
    return station.on_tpdo(pdo, counts, 1, now_ns, now_ns)


@pytest.mark.parametrize("pause_min", [0.01, 1, 36, 50, 71, 72, 110, 600])
def test_sample_times_go_on_after_a_pause(pause_min: float):
    station = Station(WINCH)
    assert answer(station, 1_000_000, 0)
    pause_ns = round(pause_min * _MINUTE_NS)
    # Clocks of device and bridge differ by 100 ppm.
    assert answer(station, 1_000_000 + round(pause_ns * 1.0001) // 1000, pause_ns)
    assert station.sampled_ns == pytest.approx(10**9 + pause_ns * 1.0001, abs=2000)
    assert station.sampled_ns is not None
    assert answer(station, station.sampled_ns // 1000 + 5000, pause_ns + 5_000_000)


@pytest.mark.parametrize("begun_us", [1_000_000, (1 << 32) - 2000])
def test_repeated_and_older_answers_are_stale(begun_us: int):
    station = Station(WINCH)
    assert answer(station, begun_us, 0)
    assert answer(station, begun_us + 5000, 5_000_000)
    assert not answer(station, begun_us + 5000, 10_000_000)
    assert not answer(station, begun_us, 10_000_000)
    assert station.stale == 2
    assert answer(station, begun_us + 10_000, 10_000_000)
