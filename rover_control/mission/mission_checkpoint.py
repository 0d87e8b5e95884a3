"""Checkpoint of a mission: state from which it resumes after a restart. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import MissionPhase
from rover_control.mission.mission_legs import Blackboard, LegResult
from rover_control.mission.mission_supervisor import LegRecord, Mission
from rover_control.mission.observed_state import Place

_NANO = 1e9


def checkpoint_of(mission: Mission, now_ns: int) -> dict[str, Any]:
    """State as JSON values, from which `restore` resumes."""
    blackboard = {name: _to_json(value) for name, value in asdict(mission.blackboard).items()}
    place = mission.observed.place
    return {
        "plan": mission.plan.digest,
        "stamp_ns": now_ns,
        "phase": mission.phase.value,
        "is_active": mission.is_active,
        "route": mission.route.checkpoint(),
        "failed_trials": mission.failed_trials,
        "blackboard": blackboard,
        "place": None if place is None else [place.x, place.y, place.heading],
        "record": [[done.leg, done.result.name, done.reason] for done in mission.record],
    }


def restore(
    mission: Mission, saved: Mapping[str, Any], now_ns: int, *, resumes: bool = True
) -> None:
    """Restore from a checkpoint of the same plan and of an earlier time.

    Args:
        mission: a new one.
        saved: the checkpoint.
        now_ns: present time [ns].
        resumes: whether an active mission goes on by itself after a short downtime.
    """
    age = (now_ns - int(saved["stamp_ns"])) / _NANO
    if saved["plan"] != mission.plan.digest or age < 0.0:
        origin = "another plan" if age >= 0.0 else "another run: it lies ahead of the clock"
        mission.emit(MissionEvent.CHECKPOINT_DISCARDED, f"the checkpoint is of {origin}")
        return
    phase = MissionPhase(saved["phase"])
    if phase is MissionPhase.STANDBY:
        return
    mission.route.restore(saved["route"])
    mission.failed_trials = int(saved["failed_trials"])
    mission.blackboard = Blackboard(
        **{name: _from_json(value) for name, value in saved["blackboard"].items()}
    )
    mission.record = [
        LegRecord(leg, LegResult[name], reason) for leg, name, reason in saved["record"]
    ]
    if saved["place"] is not None:
        mission.observed.place = Place(*saved["place"])
    now = now_ns / _NANO
    if not saved["is_active"]:
        aborted = phase is MissionPhase.ABORTED
        name = MissionEvent.ABORTED if aborted else MissionEvent.HOLDING
        mission.stop(name, Reason.RESTARTED, "restarted")
    elif resumes and age <= mission.settings.mission.resume_window:
        mission.begin_trial(now, f"restarted after {age:.1f} s in the same run of the simulation")
    else:
        window = f", more than {mission.settings.mission.resume_window:g} s" if resumes else ""
        text = f"restarted after {age:.0f} s{window}; call {topics.MISSION_RESUME} to resume"
        mission.stop(MissionEvent.INTERRUPTED, Reason.RESTARTED, text)


def _to_json(value: float) -> float | None:
    return None if math.isnan(value) else value


def _from_json(value: Any) -> Any:
    return math.nan if value is None else value
