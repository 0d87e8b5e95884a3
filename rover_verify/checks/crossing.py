"""Crossings of rubble with different rules for choosing between wheels and jump.

A mission drives the rover to a waypoint 1.5 m ahead. Where its wheels get stuck, ``mission_node``
chooses a detour by wheels or a jump, by the rule of its parameter ``locomotion_rule``; a plan
without jumps or without detours leaves no choice.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas import topics
from msg_schemas.events import DriveEvent, MissionEvent
from rover_control.mission.locomotion import LocomotionMode
from rover_control.prediction.jump_spring import SpringEstimate, SpringParameters
from rover_sim import SettlingError
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.floor import start_on_floor
from rover_verify.harness.flight import MISSION, Flight

_RUNS = 20
_GOAL = 1.5  # distance ahead [m]
_LIMIT = 600.0  # [s]
_TOUCHDOWN_TIME = 3.0  # in which the winch reports the touchdown [s]
_CLEARANCE = 0.20  # of a jump [m]
_MANY = 20  # detours or jumps that a plan allows
_DEPTH = 5.0  # of the floor below the fairlead [m]
_SLACK = 0.3  # of the tether at the start [m]
_TOPPLED = 1.0  # tilt [rad]
_UPRIGHT = 0.35  # largest initial tilt [rad]
# Allowed jumps and detours, and the rule that chooses among them.
_RULES = {
    "wheels": (0, _MANY, "slack"),
    "jump": (_MANY, 0, "slack"),
    "slack": (_MANY, _MANY, "slack"),
    "risk": (_MANY, _MANY, "risk"),
}
_BOULDERS = {"exponent": 2.5, "height_ratio": 0.4, "clear_radius": 0.3}
_GROUNDS = {
    "sparse": {"density": 1.0, "smallest": 0.1, "largest": 0.6},
    "dense": {"density": 3.0, "smallest": 0.15, "largest": 0.7},
}
_ENDS = (MissionEvent.LEG_COMPLETED, MissionEvent.LEG_FAILED)


class Crossing(NamedTuple):
    """Result of a crossing."""

    end: str  # "across", "toppled" or another reason
    time: float  # [s]
    energy: float  # input by the motors [J]
    jumps: int
    detours: int
    stuck: int

    @property
    def has_failed(self) -> bool:
        """Whether the rover did not get across."""
        return self.end != "across"


def _standing(generator: np.random.Generator, ground: str, rule: str, number: int) -> Flight:
    """A rover that stands upright on random rubble, its mission begun."""
    max_jumps, max_detours, locomotion_rule = _RULES[rule]
    stroke = SpringEstimate(SpringParameters()).stroke_for(_CLEARANCE)
    plan = {
        "landing": {"approach_depth": 3.0, "max_depth": 8.0},
        "jumps": {
            "max_jumps": max_jumps, "max_detours": max_detours, "stroke": round(stroke, 4),
            "clearance": _CLEARANCE,
        },
        "recovery": {"max_count": 0},
    }  # fmt: skip
    while True:
        ground_seed = int(generator.integers(1, 2**31 - 1))
        x, heading = float(generator.uniform(1.0, 6.0)), float(generator.uniform(-180.0, 180.0))
        chord = math.hypot(x, _DEPTH)
        ahead = math.radians(heading)
        waypoint = {"x": x + _GOAL * math.cos(ahead), "y": _GOAL * math.sin(ahead)}
        overrides = {
            "environment.seed": ground_seed,
            "environment.boulders": {**_BOULDERS, **_GROUNDS[ground]},
            "start.position": [x, 0.0],
            "start.heading": heading,
            "start.settling_time": 300.0,
            "tether.length": chord + _SLACK,
        }
        with tempfile.TemporaryDirectory() as folder, suppress(SettlingError):
            file = Path(folder) / "plan.yaml"
            file.write_text(json.dumps({**plan, "survey": [waypoint]}), encoding="utf-8")
            own = {"plan": str(file), "checkpoint": "none", "locomotion_rule": locomotion_rule}
            flight = start_on_floor(MISSION, overrides, number, {"mission_node": own})
            if flight.tilt < _UPRIGHT:
                return flight


def cross(seed: int, index: int, rule: str, ground: str = "sparse") -> Crossing:
    """One crossing with a rule, or with wheels or jumps only."""
    generator = np.random.default_rng([seed, index, 63])
    flight = _standing(generator, ground, rule, 1000 * seed + index)
    flight.run(_TOUCHDOWN_TIME)
    start = flight.time
    response = flight.call(topics.MISSION_GO)
    assert response.success, response.message
    try:
        if not flight.run(_LIMIT, lambda: any(flight.events_named(name) for name in _ENDS)):
            end = "late"
        elif flight.events_named(MissionEvent.LEG_COMPLETED):
            end = "across"
        else:
            end = flight.events_named(MissionEvent.LEG_FAILED)[0].status.message
    except RuntimeError as error:
        end = str(error)
    if flight.tilt > _TOPPLED:
        end = "toppled"
    chosen = [e.values["mode"] for e in flight.events_named(MissionEvent.LOCOMOTION_CHOSEN)]
    return Crossing(
        end,
        flight.time - start,
        flight.result.energies.input,
        chosen.count(LocomotionMode.JUMP),
        chosen.count(LocomotionMode.WHEELS),
        len(flight.events_named(DriveEvent.STUCK)),
    )


def risk_against_slack(batch: CheckBatch) -> Measured:
    """Crossings of sparse rubble that fail with the rule `risk`, less those with the rule `slack`.

    The details also report dense rubble, which stops most rovers.
    """
    runs = batch.runs if batch.runs > 0 else _RUNS
    details: dict[str, float | str] = {}
    by_ground = {
        ground: {rule: fly_batch(batch, runs, cross, rule, ground) for rule in _RULES}
        for ground in _GROUNDS
    }
    for ground, by_rule in by_ground.items():
        details |= _table(ground, by_rule, runs)
    failed = {rule: sum(each.has_failed for each in by_ground["sparse"][rule]) for rule in _RULES}
    note = f"{runs} crossings: {failed['risk']} fail with risk, {failed['slack']} with slack"
    return Measured(float(failed["risk"] - failed["slack"]), note, details)


def _table(
    ground: str, by_rule: Mapping[str, Sequence[Crossing]], runs: int
) -> dict[str, float | str]:
    details: dict[str, float | str] = {}
    for rule, crossings in by_rule.items():
        across = [crossing for crossing in crossings if not crossing.has_failed]
        time = np.mean([crossing.time for crossing in across]) if across else math.nan
        energy = np.mean([crossing.energy for crossing in across]) if across else math.nan
        details[f"{ground}, {rule}"] = (
            f"{len(across)} of {runs} across, "
            f"{sum(crossing.end == 'toppled' for crossing in crossings)} toppled, "
            f"{sum(crossing.jumps for crossing in crossings)} jumps, "
            f"{sum(crossing.detours for crossing in crossings)} detours; mean of those across "
            f"{time:.0f} s, {energy:.0f} J"
        )
    for index in range(runs):
        ends = ", ".join(f"{rule} {by_rule[rule][index].end}" for rule in _RULES)
        details[f"{ground}, crossing {index}"] = ends
    return details
