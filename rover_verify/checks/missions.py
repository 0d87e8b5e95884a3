"""Whole missions on the spatial plant: how many complete, what becomes of the others, and restarts.

Each has rubble, a swing, sensor errors and a machine of its own: mass, friction and spring are off
from what the controllers take them for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from msg_schemas.phases import MissionPhase
from rover_control.mission import LegRecord
from rover_control.mission_legs import LegResult
from rover_control.mission_plan import load_plan
from rover_verify.checks import Batch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.mission_places import shallow
from rover_verify.checks.mission_rig import NODES, MissionFlight

_LIMIT = 4000.0  # for a mission [s]
_RUNS = 20
_TOPPLED = math.radians(60.0)


class Flown(NamedTuple):
    """A mission as it went."""

    phase: str  # at the end
    reason: str
    missed: tuple[LegRecord, ...]  # legs that were left out
    stowed: bool  # the rover truly hangs at the stow
    broken: str  # why the plant could not go on; empty = it could
    toppled: bool
    jumps: int
    pictures: int
    duration: float  # [s]
    peak_tension: float  # [N]

    @property
    def is_complete(self) -> bool:
        """Whether all of it was done, and the rover is back."""
        return self.stowed and not self.missed and not self.broken

    @property
    def is_unreported(self) -> bool:
        """Whether it went wrong without a word: it stands by, and is not back."""
        if self.broken:
            return True
        stands_by = self.phase == MissionPhase.STANDBY.value
        return stands_by and not self.stowed

    @property
    def told(self) -> str:
        """One line."""
        end = "complete" if self.is_complete else self.broken or f"{self.phase}: {self.reason}"
        missed = "".join(f"; missed {each.leg}: {each.reason}" for each in self.missed)
        return (
            f"{end}{missed}; {self.duration:.0f} s, {self.pictures} pictures, {self.jumps} jumps, "
            f"at most {self.peak_tension:.0f} N"
        )


def flight_of(seed: int, index: int) -> MissionFlight:
    """A mission in a shallow pit, before it begins."""
    rng = np.random.default_rng([seed, index])
    overrides = shallow(rng)
    return MissionFlight("floor_rubble", overrides, load_plan("shallow"), seed=1000 * seed + index)


def fly_mission(seed: int, index: int) -> Flown:
    """One mission, from the stow to the stow."""
    flight = flight_of(seed, index)
    return _flown(flight, _conduct(flight))


def _conduct(flight: MissionFlight) -> str:
    """Fly until nothing is under way; returns why the plant could not go on."""
    try:
        flight.run(1.0)
        flight.mission.go(flight.now_ns)
        flight.run(_LIMIT, lambda: not flight.mission.is_active)
    except RuntimeError as error:
        return str(error)
    return ""


def _flown(flight: MissionFlight, broken: str) -> Flown:
    mission, state = flight.mission, flight.state
    missed = tuple(done for done in mission.record if done.result is not LegResult.DONE)
    near = abs(state.length - flight.plan.stow) < 0.2
    hangs = float(state.G1[2]) > -flight.plan.stow - 1.0
    return Flown(
        mission.phase.value,
        mission.reason,
        missed,
        near and hangs and not mission.is_active,
        broken,
        flight.tilt > _TOPPLED,
        mission.blackboard.jumps,
        mission.blackboard.pictures,
        flight.time,
        flight.peak_tension,
    )


# --- restarts ------------------------------------------------------------------------------------


class Restarted(NamedTuple):
    """A mission in which a node was killed and started again."""

    node: str
    when: float  # [s]
    during: str  # phase of the mission
    flown: Flown


def fly_restarted(seed: int, index: int) -> Restarted:
    """One mission with one node, by turns, killed at a random moment."""
    rng = np.random.default_rng([seed, index, 1])
    node = NODES[index % len(NODES)]
    flight = flight_of(seed, index)
    when, during = float(rng.uniform(5.0, 400.0)), ""
    try:
        flight.run(1.0)
        flight.mission.go(flight.now_ns)
        if not flight.run(when, lambda: not flight.mission.is_active):
            during = flight.mission.phase.value
            flight.restart(node)
        flight.run(_LIMIT, lambda: not flight.mission.is_active)
        broken = ""
    except RuntimeError as error:
        broken = str(error)
    return Restarted(node, when, during, _flown(flight, broken))


# --- batches -------------------------------------------------------------------------------------


def _missions(batch: Batch) -> list[Flown]:
    runs = batch.runs if batch.runs > 0 else _RUNS
    return list(fly_batch(batch, runs, fly_mission))


def _details(flown: list[Flown]) -> dict[str, float | str]:
    return {f"run {index}": each.told for index, each in enumerate(flown)}


def completed(batch: Batch) -> Measured:
    """Share of missions that complete without help."""
    flown = _missions(batch)
    share = float(np.mean([each.is_complete for each in flown]))
    jumps = sum(each.jumps for each in flown)
    times = [each.duration for each in flown]
    note = f"{len(flown)} missions, {jumps} jumps, median {np.median(times):.0f} s"
    return Measured(share, note, _details(flown))


def unreported(batch: Batch) -> Measured:
    """Missions that end with a broken tether, a plant that cannot go on, or a silent failure."""
    flown = _missions(batch)
    return Measured(
        sum(each.is_unreported for each in flown), f"{len(flown)} missions", _details(flown)
    )


def not_resumed(batch: Batch) -> Measured:
    """Nodes after whose restart a mission did not come home by itself."""
    runs = max(batch.runs, len(NODES))
    flown = list(fly_batch(batch, runs, fly_restarted))
    failed = {each.node for each in flown if not each.flown.stowed}
    details: dict[str, float | str] = {
        f"run {index}": f"{each.node} after {each.when:.0f} s, {each.during}: {each.flown.told}"
        for index, each in enumerate(flown)
    }
    return Measured(len(failed), f"{runs} missions with a restart each", details)
