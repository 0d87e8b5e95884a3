"""What the winch's descent is measured by, on motions that are known."""

from __future__ import annotations

import numpy as np
import pytest

from rover_verify.checks.winch_record import WinchRecord, ideal_curve


def record(lead: float = 0.0, beyond: float = 0.0, ripple: float = 0.0) -> WinchRecord:
    """Down by 30 m and up again on the ideal curve; the drum leads, overshoots, and bounces."""
    times, down = ideal_curve(5.0, 35.0, 0.3)
    length = np.concatenate([down + beyond * (down == down.max()), down[::-1]])
    time = np.concatenate([times, times[-1] + 0.01 + times])
    rate = np.gradient(length, time)
    columns = {
        "time": time,
        "length": length + lead,
        "reference": length,
        "rate": rate,
        "reference_rate": rate,
        "tension": 16.0 + 0.005 * time + ripple * np.sin(2.0 * np.pi * time),
    }
    turned = float(times[-1]) + 0.005
    return WinchRecord(columns, ((0.0, 35.0, 0.3), (turned, 5.0, 0.3)))


def test_the_ideal_curve_is_the_s_curve_of_the_winch_s_limits():
    times, length = ideal_curve(5.0, 35.0, 0.3)
    assert length[-1] == pytest.approx(35.0, abs=2e-3)
    assert np.diff(length).max() == pytest.approx(0.3 * 0.01, rel=1e-6)
    # 30 m at 0.3 m/s, and once the ramp: 0.3 m/s at 0.3 m/s^2, which comes and goes at 1 m/s^3.
    moving = times[np.argmax(length > 35.0 - 2e-3)] - times[np.argmax(length > 5.0 + 1e-6)]
    assert moving == pytest.approx(100.0 + 1.0 + 0.3, abs=0.3)


def test_a_drum_that_leads_its_reference_is_found():
    assert record().length_error() == 0.0
    assert record(lead=0.013).length_error() == pytest.approx(0.013)


def test_an_overshoot_counts_beyond_the_length_that_was_requested():
    assert record().overshoot() < 1e-3
    assert record(beyond=0.03).overshoot() == pytest.approx(0.03, abs=2e-3)


def test_the_ripple_is_about_the_slow_rise_alone():
    assert max(record().ripple().values()) < 1e-9
    rippled = record(ripple=1.0).ripple()
    assert len(rippled) == 2
    for value in rippled.values():
        assert value == pytest.approx(0.5**0.5 / 16.5, rel=0.05)


def test_a_reference_that_waits_for_its_drum_is_found_by_the_free_curve():
    late = record()
    time, length = late["time"], late["length"]
    waiting = np.interp(time - np.clip(time - 20.0, 0.0, 1.0), time, length)
    columns = {**late.columns, "length": waiting, "reference": waiting}
    stopped = WinchRecord(columns, late.requests[:1])
    assert stopped.length_error() == 0.0
    assert stopped.distance_from_curve() > 0.25
