"""Crossings of rubble by wheels, detours and jumps, with different rules for choosing among them.

A mission drives the rover to a waypoint ahead. Where its wheels get stuck, ``mission_node`` chooses
a detour by wheels or a jump, by the rule of its parameter ``locomotion_rule``; a plan without jumps
or without detours leaves no choice.
"""

from __future__ import annotations

import itertools
import json
import math
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas.events import DriveEvent, JumpEvent, MissionEvent
from rover_control.mission.locomotion import LocomotionMode
from rover_control.prediction.jump_spring import SpringEstimate, SpringParameters
from rover_sim import SettlingError
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.floor import start_on_floor
from rover_verify.harness.flight import MISSION, Flight, ReceivedEvent

_LIMIT = 600.0  # [s]
_TOUCHDOWN_TIME = 3.0  # in which the winch reports the touchdown [s]
_CLEARANCE = 0.20  # of a jump [m]
_MANY = 20  # detours or jumps that a plan allows
_DEPTH = 5.0  # of the floor below the fairlead [m]
_TOPPLED = 1.0  # tilt [rad]
_TOPPLED_END = "toppled"
_UPRIGHT = 0.35  # largest initial tilt [rad]
_FEWEST_STUCK = 3
_MOST_FLOWN = 64  # rovers, to see that many stuck
_FREED = 0.2  # distance from the place where it was stuck [m]
_ENDS = (MissionEvent.LEG_COMPLETED, MissionEvent.LEG_FAILED)
_WAYPOINT = "waypoint 1"  # as the name of its leg begins; legs of a recovery end before it


def _plan(max_jumps: int, max_detours: int) -> dict[str, object]:
    stroke = SpringEstimate(SpringParameters()).stroke_for(_CLEARANCE)
    return {
        "jumps": {
            "max_jumps": max_jumps, "max_detours": max_detours, "stroke": round(stroke, 4),
            "clearance": _CLEARANCE,
        },
        "recovery": {"max_count": 0},
    }  # fmt: skip


# Rule that chooses among what a plan allows, and that part of the plan.
_COMPARED = {
    "wheels": ("slack", _plan(0, _MANY)),
    "jump": ("slack", _plan(_MANY, 0)),
    "slack": ("slack", _plan(_MANY, _MANY)),
    "risk": ("risk", _plan(_MANY, _MANY)),
}
_FREE = "free"
_RULES: Mapping[str, tuple[str, Mapping[str, object]]] = {
    **_COMPARED,
    _FREE: ("slack", {"jumps": {"max_jumps": 6, "max_detours": 0, "stroke": 0.15, "slack": 1.0}}),
}


class _Ground(NamedTuple):
    """Boulders, and where the rover stands on them."""

    boulders: Mapping[str, float]
    x: tuple[float, float] = (1.0, 6.0)  # at random between these [m]
    heading: tuple[float, float] = (-180.0, 180.0)  # as well [deg]
    ahead: float = 1.5  # distance of the waypoint [m]
    slack: float = 0.3  # of the tether at the start [m]


_GROUNDS = {
    "sparse": _Ground({"density": 1.0, "smallest": 0.1, "largest": 0.6, "height_ratio": 0.4}),
    "dense": _Ground({"density": 3.0, "smallest": 0.15, "largest": 0.7, "height_ratio": 0.4}),
}
_ROUGH = "rough"  # where most rovers get stuck
_PLACES = {
    **_GROUNDS,
    _ROUGH: _Ground(
        {"density": 2.0, "smallest": 0.12, "largest": 0.6, "height_ratio": 0.5},
        (0.0, 0.0), (0.0, 0.0), 1.2, 0.2,
    ),
}  # fmt: skip


class Crossing(NamedTuple):
    """Result of a crossing."""

    end: str  # "across", "toppled" or another reason
    time: float  # [s]
    energy: float  # input by the motors [J]
    jumps: int  # flown
    detours: int
    stuck: int  # times that the wheels got stuck
    moved: float  # distance from the first place where they did to the end [m]

    @property
    def has_failed(self) -> bool:
        """Whether the rover did not get across."""
        return self.end != "across"

    @property
    def is_stuck(self) -> bool:
        """Whether the wheels got stuck, other than by toppling before any jump."""
        return self.stuck > 0 and (self.jumps > 0 or self.end != _TOPPLED_END)

    @property
    def is_free(self) -> bool:
        """Whether the rover left the place where it was stuck, or got across."""
        return not self.has_failed or self.moved >= _FREED


def _standing(generator: np.random.Generator, place: str, rule: str, number: int) -> Flight:
    """A rover that stands upright on random rubble, with its mission."""
    locomotion_rule, allowed = _RULES[rule]
    ground = _PLACES[place]
    while True:
        ground_seed = int(generator.integers(1, 2**31 - 1))
        x, heading = float(generator.uniform(*ground.x)), float(generator.uniform(*ground.heading))
        ahead = math.radians(heading)
        plan: dict[str, object] = {
            "landing": {"approach_depth": 3.0, "max_depth": 8.0},
            "survey": [
                {"x": x + ground.ahead * math.cos(ahead), "y": ground.ahead * math.sin(ahead)}
            ],
            **allowed,
        }
        overrides = {
            "environment.seed": ground_seed,
            "environment.floor": {"height": -_DEPTH},
            "environment.boulders": {"exponent": 2.5, "clear_radius": 0.3, **ground.boulders},
            "start.position": [x, 0.0],
            "start.heading": heading,
            "start.settling_time": 300.0,
            "tether.length": math.hypot(x, _DEPTH) + ground.slack,
        }
        with tempfile.TemporaryDirectory() as folder, suppress(SettlingError):
            file = Path(folder) / "plan.yaml"
            file.write_text(json.dumps(plan), encoding="utf-8")
            own = {"plan": str(file), "checkpoint": "none", "locomotion_rule": locomotion_rule}
            flight = start_on_floor(MISSION, overrides, number, {"mission_node": own})
            if flight.tilt < _UPRIGHT:
                return flight


def cross(seed: int, index: int, rule: str, place: str = "sparse") -> Crossing:
    """One crossing with a rule, or with wheels or jumps only."""
    generator = np.random.default_rng([seed, index, 63])
    flight = _standing(generator, place, rule, 1000 * seed + index)
    flight.run(_TOUCHDOWN_TIME)
    start = flight.time
    flight.go()
    stuck_at: list[np.ndarray] = []

    def ended(name: MissionEvent) -> list[ReceivedEvent]:
        """Ends of the leg to the waypoint."""
        return [
            each for each in flight.events_named(name) if each.values["leg"].startswith(_WAYPOINT)
        ]

    def is_over() -> bool:
        if len(stuck_at) < len(flight.events_named(DriveEvent.STUCK)):
            stuck_at.append(flight.state.G1[:2].copy())
        return not flight.mission.is_active or any(map(ended, _ENDS))

    try:
        if not flight.run(_LIMIT, is_over):
            end = "late"
        elif ended(MissionEvent.LEG_COMPLETED):
            end = "across"
        else:
            failed = ended(MissionEvent.LEG_FAILED)
            end = failed[0].status.message if failed else flight.mission.reason
    except RuntimeError as error:
        end = str(error)
    if flight.tilt > _TOPPLED:
        end = _TOPPLED_END
    chosen = [e.values["mode"] for e in flight.events_named(MissionEvent.LOCOMOTION_CHOSEN)]
    return Crossing(
        end,
        flight.time - start,
        flight.result.energies.input,
        len(flight.events_named(JumpEvent.FLIGHT)),
        chosen.count(LocomotionMode.WHEELS),
        len(flight.events_named(DriveEvent.STUCK)),
        float(np.linalg.norm(flight.state.G1[:2] - stuck_at[0])) if stuck_at else 0.0,
    )


def risk_against_slack(batch: CheckBatch) -> Measured:
    """Crossings of sparse rubble that fail with the rule `risk`, less those with the rule `slack`.

    The details also report dense rubble, which stops most rovers.
    """
    details: dict[str, float | str] = {}
    failed: dict[str, int] = {}
    for ground, rule in itertools.product(_GROUNDS, _COMPARED):
        crossings = fly_batch(batch, batch.runs, cross, rule, ground)
        lost = sum(each.has_failed for each in crossings)
        if ground == "sparse":
            failed[rule] = lost
        details[f"{ground}, {rule}"] = f"{batch.runs - lost} of {batch.runs} across"
        details |= {f"{ground}, {rule}, {run}": text for run, text in per_run(crossings).items()}
    note = f"{batch.runs} crossings: {failed['risk']} fail with risk, {failed['slack']} with slack"
    return Measured(float(failed["risk"] - failed["slack"]), note, details)


def not_freed(batch: CheckBatch) -> Measured:
    """Rovers that got stuck and did not free themselves by jumping; NaN if none got stuck.

    About a third of the rovers get stuck; more are flown until some have. Rovers that toppled on
    their wheels, before any jump, do not count: the note names them.
    """
    runs = batch.runs
    flown = fly_batch(batch, runs, cross, _FREE, _ROUGH)
    while sum(each.is_stuck for each in flown) < _FEWEST_STUCK and runs < _MOST_FLOWN:
        runs = min(2 * runs, _MOST_FLOWN)
        flown = fly_batch(batch, runs, cross, _FREE, _ROUGH)
    stuck = [each for each in flown if each.is_stuck]
    toppled = sum(each.stuck > 0 and not each.is_stuck for each in flown)
    note = (
        f"{len(stuck)} of {len(flown)} rovers got stuck, {sum(e.jumps for e in stuck)} jumps; "
        f"{toppled} toppled before"
    )
    count = float(sum(not each.is_free for each in stuck)) if stuck else math.nan
    return Measured(count, note, per_run(flown))
