"""Verdict of the mission's demonstration."""

import math

import pytest

from rover_verify.mission_show import judge

MISSION = {
    "legs_done": ["landing", "jump"],
    "legs_missed": {},
    "phase": "standby",
    "reason": "",
    "home": True,
    "depth_m": 2.4,
    "pictures": 9,
    "jumps": 1,
    "jumps_planned": 1,
    "peak_tension_N": 60.0,
    "breaking_load_N": 1000.0,
    "energy_J": 800.0,
    "simulated_s": 732.0,
    "real_time_factor": 5.0,
}
METRICS = {"energy_drift_J": -5e-5, "closed": True, "topics": {"clock": {"rejected": 0}}}


def failed_checks(mission: dict[str, object], metrics: dict[str, object]) -> int:
    lines = judge({**MISSION, **mission}, {**METRICS, **metrics})
    return sum(not holds for _, holds in lines)


def test_a_successful_mission_passes_every_check():
    assert failed_checks({}, {}) == 0


@pytest.mark.parametrize(
    "change",
    [
        {"home": False},
        {"legs_missed": {"jump": "too steep"}},
        {"pictures": 0},
        {"jumps": 0},
        {"peak_tension_N": 1000.0},
        {"real_time_factor": 0.9},
    ],
)
def test_each_failure_is_reported(change: dict[str, object]):
    assert failed_checks(change, {}) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"energy_drift_J": 0.1},
        {"energy_drift_J": math.nan},
        {"energy_drift_J": None},
        {"closed": False},
        {"topics": {"clock": {"rejected": 1}}},
    ],
)
def test_an_incomplete_bag_is_reported(change: dict[str, object]):
    assert failed_checks({}, change) == 1
