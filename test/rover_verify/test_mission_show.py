"""Verdict of the mission's demonstration."""

import math

import pytest

from msg_schemas.events import MissionEvent
from rover_verify.demo.mission_show import judge, outcome

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
    "stone_height_m": 0.04,
    "stone_clearance_m": 0.1,
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
        {"stone_clearance_m": -1e-4},
        {"stone_clearance_m": math.nan},
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
        {"warnings": ["/clock: 3 gaps"]},
    ],
)
def test_an_incomplete_bag_is_reported(change: dict[str, object]):
    assert failed_checks({}, change) == 1


def event(name: MissionEvent, message: str = "", **values: str) -> dict[str, object]:
    return {"name": str(name), "message": message, "values": values}


def descent(depth: float, length: float) -> dict[str, float]:
    return {"depth_to_m": depth, "to_m": length}


def test_the_outcome_is_read_from_the_report_of_the_bag():
    events = [
        event(MissionEvent.LEG_COMPLETED, leg="land"),
        event(MissionEvent.LEG_FAILED, "too steep", leg="waypoint 1"),
        event(MissionEvent.COMPLETED, "2 legs", pictures="9", jumps="1", missed="1"),
        event(MissionEvent.PHASE_CHANGED, phase="standby"),
    ]
    descents = [descent(50.9, 50.6), descent(2.3, 2.0)]
    shown = {"coverage": {"images": 9}, "jumps": [{}], "simulated_s": 800.0}
    found = outcome({"events": events, "descents": descents, **shown})
    assert (found["legs_done"], found["legs_missed"]) == (["land"], {"waypoint 1": "too steep"})
    assert (found["pictures"], found["jumps"], found["jumps_planned"]) == (9, 1, 1)
    assert (found["deepest_m"], found["home"]) == (50.9, True)
    assert found["energy_J"] == pytest.approx(10.0 * 1.62 * 50.9)
    unfinished = outcome({"events": events[:1], "descents": descents[:1], **shown})
    assert not unfinished["home"]
    assert (unfinished["pictures"], unfinished["jumps"]) == (9, 1)
    unseen = outcome({"events": events[:1], "descents": [], **shown, "coverage": None})
    assert unseen["pictures"] == 0
    assert unfinished["reason"] == "the mission has not ended"
