"""Whole missions on the spatial plant: completion, failures and restarts.

Each mission has random rubble, swing, sensor errors and machine: mass, friction and spring deviate
from the controllers' parameters.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas.phases import MissionPhase
from rover_control.mission.mission_legs import LegResult
from rover_runtime.delays import Delays
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.mission_places import shallow
from rover_verify.harness.flight import MISSION, Flight

_LIMIT = 4000.0  # time limit of a mission [s]
_DOWNTIME = 2.0  # from the kill of a node to its restart [s]
_TOPPLED = math.radians(60.0)


class MissionOutcome(NamedTuple):
    """Outcome of a mission."""

    phase: str  # at the end
    reason: str
    incomplete: tuple[str, ...]  # legs that were not completed, and why
    stowed: bool  # whether the rover truly hangs at the stow
    broken: str  # why the plant could not continue; empty = no failure
    toppled: bool
    jumps: int
    pictures: int
    duration: float  # [s]
    peak_tension: float  # [N]
    energy_residual: float  # largest error of the energy balance over the heat [-]

    @property
    def is_complete(self) -> bool:
        """Whether all legs were completed and the rover is back."""
        return self.stowed and not self.incomplete and not self.broken

    @property
    def is_unreported(self) -> bool:
        """Whether the mission failed without a report: in standby, but the rover is not back."""
        if self.broken:
            return True
        stands_by = self.phase == MissionPhase.STANDBY.value
        return stands_by and not self.stowed


def flight_of(seed: int, index: int, plan: str = "shallow", checkpoint: str = "none") -> Flight:
    """A mission in a shallow pit before its start."""
    number = 1000 * seed + index
    return Flight(
        MISSION,
        "floor_rubble",
        shallow(np.random.default_rng([seed, index])),
        seed=number,
        parameters={"mission_node": {"plan": plan, "checkpoint": checkpoint}},
        delays=Delays(number),
    )


def fly_mission(seed: int, index: int) -> MissionOutcome:
    """One mission, from the stow back to the stow."""
    flight = flight_of(seed, index)
    broken = ""
    try:
        _start(flight)
        _run_to_end(flight)
    except RuntimeError as error:
        broken = str(error)
    return _outcome(flight, broken)


def _start(flight: Flight) -> None:
    flight.run(1.0)
    flight.go()


def _run_to_end(flight: Flight) -> None:
    flight.run(_LIMIT, lambda: not flight.mission.is_active)


def _outcome(flight: Flight, broken: str) -> MissionOutcome:
    mission, state = flight.mission, flight.state
    incomplete = tuple(
        f"{done.leg}: {done.reason}" for done in mission.record if done.result is not LegResult.DONE
    )
    is_at_stow = abs(state.length - mission.plan.stow) < 0.2
    hangs = float(state.G1[2]) > -mission.plan.stow - 1.0
    return MissionOutcome(
        mission.phase.value,
        mission.reason,
        incomplete,
        is_at_stow and hangs and not mission.is_active,
        broken,
        flight.tilt > _TOPPLED,
        mission.blackboard.jumps,
        mission.blackboard.pictures,
        flight.time,
        flight.peak_tension,
        flight.energy_residual / max(flight.result.energies.dissipated, 1e-9),
    )


# --- restarts ------------------------------------------------------------------------------------


class RestartedMission(NamedTuple):
    """A mission with the kill and restart of one node."""

    node: str
    when: float  # [s]
    during: str  # phase of the mission
    outcome: MissionOutcome


def fly_restarted(seed: int, index: int) -> RestartedMission:
    """One mission in which one node, in turn, is killed at a random time."""
    rng = np.random.default_rng([seed, index, 1])
    node = MISSION[index % len(MISSION)]
    when, during, broken = float(rng.uniform(5.0, 400.0)), "", ""
    with tempfile.TemporaryDirectory() as folder:
        flight = flight_of(seed, index, checkpoint=str(Path(folder) / "checkpoint.json"))
        try:
            _start(flight)
            if not flight.run(when, lambda: not flight.mission.is_active):
                during = flight.mission.phase.value
                flight.kill(node)
                flight.run(_DOWNTIME)
                flight.restart(node)
                flight.run(_DOWNTIME)
            _run_to_end(flight)
        except RuntimeError as error:
            broken = str(error)
        return RestartedMission(node, when, during, _outcome(flight, broken))


# --- batches -------------------------------------------------------------------------------------


def _missions(batch: CheckBatch) -> Sequence[MissionOutcome]:
    return fly_batch(batch, batch.runs, fly_mission)


def completed(batch: CheckBatch) -> Measured:
    """Share of missions that complete without help."""
    outcomes = _missions(batch)
    share = float(np.mean([each.is_complete for each in outcomes]))
    jumps = sum(each.jumps for each in outcomes)
    times = [each.duration for each in outcomes]
    note = f"{len(outcomes)} missions, {jumps} jumps, median {np.median(times):.0f} s"
    return Measured(share, note, per_run(outcomes))


def unreported(batch: CheckBatch) -> Measured:
    """Missions that end with a broken tether, a diverged plant, or an unreported failure."""
    outcomes = _missions(batch)
    count = sum(each.is_unreported for each in outcomes)
    return Measured(count, f"{len(outcomes)} missions", per_run(outcomes))


def energy_residual(batch: CheckBatch) -> Measured:
    """Largest error of the energy balance of a mission over its heat."""
    residuals = {
        f"run {index}": each.energy_residual for index, each in enumerate(_missions(batch))
    }
    return Measured.largest(residuals, f"{len(residuals)} missions on random rubble")


def not_resumed(batch: CheckBatch) -> Measured:
    """Number of nodes after whose restart a mission did not return by itself."""
    runs = max(batch.runs, len(MISSION))
    outcomes = fly_batch(batch, runs, fly_restarted)
    failed = {each.node for each in outcomes if not each.outcome.stowed}
    return Measured(len(failed), f"{runs} missions with a restart each", per_run(outcomes))
