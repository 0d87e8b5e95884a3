"""Rovers that get stuck on rubble in a mission and free themselves by jumping.

The rover starts on rubble so dense that its wheels often get stuck, and drives to a waypoint ahead.
The plan allows no detours: where the rover is stuck, it gets slack and jumps.
"""

from __future__ import annotations

import math
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas import topics
from msg_schemas.events import DriveEvent
from rover_control.mission.mission_legs import LegResult
from rover_control.mission.mission_route import LegKind
from rover_runtime.delays import Delays
from rover_sim import SettlingError
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.harness.flight import MISSION, Flight

_RUNS = 10
_DEPTH = 5.0  # of the floor below the fairlead [m]
_AHEAD = 1.2  # [m]
_LIMIT = 600.0  # [s]
_UPRIGHT = 0.35  # largest initial tilt [rad]
_MOVED = 0.2  # distance that counts as freed [m]
_PLAN = f"""
landing: {{approach_depth: 3.0, max_depth: 8.0}}
survey:
  - {{x: {_AHEAD}, y: 0.0}}
jumps: {{max_jumps: 6, max_detours: 0, stroke: 0.15, slack: 1.0}}
"""


class Freed(NamedTuple):
    """Result of one run.

    Attributes:
        stuck: times that the wheels got stuck.
        jumps: number of jumps.
        distance: from the first place where it was stuck to the end [m].
        arrived: whether the rover reached the waypoint.
        end: how the leg ended.
        duration: [s].
    """

    stuck: int
    jumps: int
    distance: float
    arrived: bool
    end: str
    duration: float

    @property
    def is_free(self) -> bool:
        """Whether the rover left the place where it was stuck, or reached its waypoint."""
        return self.arrived or self.distance >= _MOVED


def _standing(rng: np.random.Generator, number: int, plan: str) -> Flight:
    """A rover that stands upright on random rubble.

    Args:
        rng: of the rubble.
        number: of the flight.
        plan: path of its plan.
    """
    settings = {"plan": plan, "checkpoint": "none", "locomotion_rule": "slack"}
    while True:
        overrides = {
            "environment.seed": int(rng.integers(1, 2**31)),
            "environment.floor": {"height": -_DEPTH},
            "environment.boulders": {
                "density": 2.0, "smallest": 0.12, "largest": 0.6, "exponent": 2.5,
                "height_ratio": 0.5, "clear_radius": 0.3,
            },
            "start.position": [0.0, 0.0],
            "start.heading": 0.0,
            "start.settling_time": 300.0,
            "tether.length": _DEPTH + 0.2,
        }  # fmt: skip
        with suppress(SettlingError):  # it does not settle there: try another place
            flight = Flight(
                MISSION, "floor_rubble", overrides, seed=number,
                parameters={"mission_node": settings}, delays=Delays(number),
            )  # fmt: skip
            if flight.tilt < _UPRIGHT:
                return flight


def fly_stuck(seed: int, index: int) -> Freed:
    """One leg, until the rover arrives or is given up."""
    rng = np.random.default_rng([seed, index, 3])
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.yaml"
        plan.write_text(_PLAN, encoding="utf-8")
        flight = _standing(rng, 1000 * seed + index, str(plan))
    stuck_positions: list[tuple[float, float]] = []

    def is_over() -> bool:
        if len(stuck_positions) < len(flight.events_named(DriveEvent.STUCK)):
            stuck_positions.append((float(flight.state.G1[0]), float(flight.state.G1[1])))
        leg = flight.mission.leg
        return leg is None or leg.kind is not LegKind.VISIT

    flight.run(1.0)
    flight.call(topics.WINCH_REARM)
    flight.run(3.0)
    flight.go()
    end = ""
    try:
        if not flight.run(_LIMIT, is_over):
            end = f"not finished after {_LIMIT:g} s"
    except RuntimeError as error:
        end = str(error)
    done = flight.mission.record
    now = (float(flight.state.G1[0]), float(flight.state.G1[1]))
    distance = math.dist(stuck_positions[0], now) if stuck_positions else 0.0
    outcome = end or (f"{done[0].result.name}: {done[0].reason}" if done else flight.mission.reason)
    jumps = flight.mission.blackboard.jumps
    arrived = bool(done) and done[0].result is LegResult.DONE
    return Freed(
        len(flight.events_named(DriveEvent.STUCK)), jumps, distance, arrived, outcome, flight.time
    )


def not_freed(batch: CheckBatch) -> Measured:
    """Rovers that got stuck and did not free themselves; NaN if none got stuck."""
    runs = batch.runs if batch.runs > 0 else _RUNS
    flown = list(fly_batch(batch, runs, fly_stuck))
    stuck = [each for each in flown if each.stuck]
    details: dict[str, float | str] = {
        f"run {index}": (
            f"stuck {each.stuck} times, {each.jumps} jumps, {each.distance:.2f} m from the "
            f"first place where it was stuck; {each.end}; {each.duration:.0f} s"
        )
        for index, each in enumerate(flown)
    }
    note = f"{len(stuck)} of {runs} rovers got stuck, {sum(e.jumps for e in stuck)} jumps"
    not_freed_count = float(sum(not each.is_free for each in stuck)) if stuck else math.nan
    return Measured(not_freed_count, note, details)
