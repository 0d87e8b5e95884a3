"""Rovers that get stuck on rubble in a mission, and free themselves by jumping.

The rover begins standing on rubble so dense that wheels often get no farther, and is to drive to a
waypoint ahead. The plan leaves it no detours: where it is stuck, it gets slack and jumps.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from msg_schemas.events import DriveEvent
from rover_control.locomotion import LocomotionParameters
from rover_control.mission_legs import LegResult
from rover_control.mission_parameters import MissionSettings
from rover_control.mission_plan import Jumps, Landing, MissionPlan, Waypoint
from rover_control.mission_route import LegKind
from rover_sim import SettlingError
from rover_verify.checks import Batch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.mission_rig import MissionFlight

_RUNS = 10
_DEPTH = 5.0  # of the floor below the fairlead [m]
_AHEAD = 1.2  # [m]
_LIMIT = 600.0  # [s]
_UPRIGHT = 0.35  # tilt with which it may begin [rad]
_MOVED = 0.2  # from where it was stuck, that counts as freed [m]
_PLAN = MissionPlan(
    landing=Landing(approach_depth=3.0, max_depth=8.0),
    survey=(Waypoint(x=_AHEAD, y=0.0),),
    jumps=Jumps(max_jumps=6, max_detours=0, stroke=0.15, slack=1.0),
)
_SETTINGS = MissionSettings(locomotion=LocomotionParameters(locomotion_rule="slack"))


class Freed(NamedTuple):
    """How it went.

    Attributes:
        stuck: times that the wheels got no farther.
        jumps: that were flown.
        way: from where it was stuck first to where the way has ended [m].
        arrived: whether that is where it was to go.
        end: of the way, in words.
        duration: [s].
    """

    stuck: int
    jumps: int
    way: float
    arrived: bool
    end: str
    duration: float

    @property
    def is_free(self) -> bool:
        """Whether it got away from where it was stuck, or, close to its goal, there."""
        return self.arrived or self.way >= _MOVED


def _standing(rng: np.random.Generator, seed: int) -> MissionFlight:
    """A rover that stands upright on rubble of its own."""
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
            "tether.element_length": 0.9,
            "winch.min_length": 1.4,
            "integration.h": 2.0e-3,
        }  # fmt: skip
        with suppress(SettlingError):  # it finds no rest there: another place
            flight = MissionFlight("floor_rubble", overrides, _PLAN, _SETTINGS, seed)
            if flight.tilt < _UPRIGHT:
                return flight


def fly_stuck(seed: int, index: int) -> Freed:
    """One way, until the rover is there or nothing helps any more."""
    rng = np.random.default_rng([seed, index, 3])
    flight = _standing(rng, 1000 * seed + index)
    stuck_at: list[tuple[float, float]] = []

    def is_over() -> bool:
        if len(stuck_at) < len(flight.told(DriveEvent.STUCK)):
            stuck_at.append((float(flight.state.G1[0]), float(flight.state.G1[1])))
        leg = flight.mission.leg
        return leg is None or leg.kind is not LegKind.VISIT

    flight.run(1.0)
    flight.winch.rearm(flight.now_ns)
    flight.run(3.0)
    flight.mission.go(flight.now_ns)
    end = ""
    try:
        if not flight.run(_LIMIT, is_over):
            end = f"not over after {_LIMIT:g} s"
    except RuntimeError as error:
        end = str(error)
    done = flight.mission.record
    now = (float(flight.state.G1[0]), float(flight.state.G1[1]))
    way = math.dist(stuck_at[0], now) if stuck_at else 0.0
    told = end or (f"{done[0].result.name}: {done[0].reason}" if done else flight.mission.reason)
    jumps = flight.mission.blackboard.jumps
    arrived = bool(done) and done[0].result is LegResult.DONE
    return Freed(len(flight.told(DriveEvent.STUCK)), jumps, way, arrived, told, flight.time)


def not_freed(batch: Batch) -> Measured:
    """Rovers that got stuck and did not free themselves; NaN if none got stuck."""
    runs = batch.runs if batch.runs > 0 else _RUNS
    flown = list(fly_batch(batch, runs, fly_stuck))
    stuck = [each for each in flown if each.stuck]
    details: dict[str, float | str] = {
        f"run {index}": (
            f"stuck {each.stuck} times, {each.jumps} jumps, {each.way:.2f} m away from where it "
            f"was stuck first; {each.end}; {each.duration:.0f} s"
        )
        for index, each in enumerate(flown)
    }
    note = f"{len(stuck)} of {runs} rovers got stuck, {sum(e.jumps for e in stuck)} jumps"
    kept = float(sum(not each.is_free for each in stuck)) if stuck else math.nan
    return Measured(kept, note, details)
