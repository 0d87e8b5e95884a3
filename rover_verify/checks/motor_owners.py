"""Owners of the motors in missions that are aborted in flight, from recorded commands.

Each mission is aborted in a phase of its own and then leads home. Jump and descent drive one motor,
drive and descent another.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, MissionPhase
from msg_schemas.refusal import RefusalCode
from msg_schemas.table import TOPICS
from rover_bags.reading.read import read_bag
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.missions import flight_of
from rover_verify.harness.flight import Flight
from rover_verify.harness.tape import Tape

_LIMIT = 2000.0  # time limit until the abort, and of the return [s]
_REST_LIMIT = 120.0  # time limit of coming to rest [s]
_LATEST = 1.0  # time from the begin of the phase to the abort, at most [s]
_PLAN = """
looks: [{depth: 3.5}]
landing: {approach_depth: 5.5, max_depth: 8.0, rate: 0.15}
survey: [{x: 0.6, y: 0.0, jump_height: 0.2}]
"""
_COMMANDS = tuple(name for name, topic in TOPICS.items() if topic.owned)
_ABORTED_IN = (
    ("", ""),
    (topics.DESCENT_PHASE, DescentPhase.TRAVELLING),
    (topics.DESCENT_PHASE, DescentPhase.DAMPING),
    (topics.MISSION_PHASE, MissionPhase.LANDING),
    (topics.DRIVE_PHASE, DrivePhase.DRIVING),
    (topics.JUMP_PHASE, JumpPhase.COMPRESSING),
    (topics.JUMP_PHASE, JumpPhase.SETTLING),
    (topics.JUMP_PHASE, JumpPhase.FLIGHT),
    (topics.JUMP_PHASE, JumpPhase.HOOKING),
    (topics.MISSION_PHASE, MissionPhase.RETURNING),
    (topics.MISSION_PHASE, MissionPhase.LIFTING),
    (topics.MISSION_PHASE, MissionPhase.ASCENDING),
)


class AbortedMission(NamedTuple):
    """Owners of the motors in a mission that was aborted."""

    during: str  # phase of the abort; empty = not aborted
    conflicts: tuple[str, ...]
    refusals: tuple[str, ...]  # of commands of another source than the owner
    end: str  # why it was not aborted, or why the rover is not back; empty = it is


def fly_aborted(seed: int, index: int) -> AbortedMission:
    """One mission, aborted in one of its phases in turn."""
    delay = float(np.random.default_rng([seed, index, 1]).uniform(0.0, _LATEST))
    topic, phase = _ABORTED_IN[index % len(_ABORTED_IN)]
    with tempfile.TemporaryDirectory() as folder:
        plan, bag = Path(folder) / "plan.yaml", Path(folder) / "bag"
        plan.write_text(_PLAN, encoding="utf-8")
        flight = flight_of(seed, index, str(plan))
        tape = Tape(bag)
        flight.host.exchange.listen(tape.write, *_COMMANDS)
        try:
            end = _fly(flight, topic, phase, delay)
        except RuntimeError as error:
            end = str(error)
        finally:
            tape.close()
        conflicts = read_bag(bag, _COMMANDS).command_conflicts
    refusals = tuple(
        f"at {time:.2f} s: {refusal.reason}"
        for time, refusal in flight.refusals
        if refusal.code is RefusalCode.OWNED
    )
    return AbortedMission(phase, tuple(each.text for each in conflicts), refusals, end)


def _fly(flight: Flight, topic: str, phase: str, delay: float) -> str:
    flight.run(1.0)
    flight.go()
    if topic:
        if not flight.run(_LIMIT, lambda: flight.phases.get(topic) == phase):
            return f"never in {phase}"
        flight.run(delay, lambda: flight.phases[topic] != phase)
        flight.call(topics.MISSION_ABORT)
        if not flight.run(_REST_LIMIT, lambda: bool(flight.events_named(MissionEvent.AT_REST))):
            return "not at rest after the abort"
        flight.go()
    flight.run(_LIMIT, lambda: not flight.mission.is_active)
    stow = flight.mission.plan.stow
    is_back = flight.mission.phase is MissionPhase.STANDBY and abs(flight.state.length - stow) < 0.2
    return "" if is_back else f"{flight.mission.phase}: {flight.mission.reason}"


def conflicting(batch: CheckBatch) -> Measured:
    """Missions with two sources of one motor at a time, or that do not abort and come back."""
    runs = max(batch.runs, len(_ABORTED_IN))
    missions = fly_batch(batch, runs, fly_aborted)
    wrong = sum(bool(each.conflicts or each.refusals or each.end) for each in missions)
    note = f"{runs} missions, {len(_ABORTED_IN) - 1} phases of an abort"
    return Measured(wrong, note, per_run(missions))
