"""The mission's demonstration: judged by its figures."""

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


def missed(mission: dict[str, object], metrics: dict[str, object]) -> int:
    lines = judge({**MISSION, **mission}, {**METRICS, **metrics})
    return sum(not holds for _, holds in lines)


def test_a_mission_that_went_well_keeps_every_promise():
    assert missed({}, {}) == 0


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
def test_what_went_wrong_is_told(change: dict[str, object]):
    assert missed(change, {}) == 1


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
def test_a_bag_that_is_not_whole_is_told(change: dict[str, object]):
    assert missed({}, change) == 1
