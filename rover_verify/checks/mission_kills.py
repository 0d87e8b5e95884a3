"""Nodes killed in the middle of a mission: real processes over DDS, on the mock plant.

In each mission every controller and the supervisor is killed once, at a random moment, left dead
for a while, and started again. What it had moved must come to rest by the watchdogs of others,
the winch must not move before it is armed again, and the mission must go on by itself.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.machine import JUMP_SCREW, WHEEL_LEFT, WINCH_DRUM
from msg_schemas.phases import MissionPhase, WinchMode
from msg_schemas.samples import JointSample
from rover_verify.checks import Batch, Measured
from rover_verify.checks.flights import fly_kept
from rover_verify.harness import NodeHarness, Observer, Process, open_harness

_PLANT = "rover_sim.mock_plant_node"
# As `config/winch_descent.yaml` sets it up.
_WINCH = {"trim_rate": 0.3, "shortest_length": 1.4, "end_zone": 0.3}
_MODULES = {
    "winch_node": "tether_winch.winch_node",
    "descent_node": "rover_control.descent_node",
    "drive_node": "rover_control.drive_node",
    "jump_node": "rover_control.jump_node",
    "mission_node": "rover_control.mission_node",
}
_OVERRIDES = {
    "environment.floor": {"height": -5.0},
    "tether.length": 2.0,
    "winch.min_length": 1.4,
    "start": {"kind": "hanging"},
}
# Many short legs, so that there is much to be killed in.
_PLAN = """
stow: 2.0
landing: {approach_depth: 3.0, max_depth: 6.5, rate: 0.05}
survey:
  - {x: 0.6, y: 0.0, jump_height: 0.1}
  - {x: 0.6, y: 0.6}
lift: {height: 0.5, rate: 0.05, radius: 0.6}
"""
# What each moves, the winch by requests that it renews, and in which phases of the mission; others
# may go on with what is theirs. An empty set: in any.
_MOVED: dict[str, tuple[tuple[str, ...], frozenset[str]]] = {
    "winch_node": ((topics.WINCH_STATE,), frozenset()),
    "descent_node": (
        (topics.WINCH_STATE, topics.WHEEL_STATE),
        frozenset({"looking", "turning", "approaching", "ascending"}),
    ),
    "drive_node": (
        (topics.WINCH_STATE, topics.WHEEL_STATE),
        frozenset({"driving", "returning"}),
    ),
    # The screw turns with the flywheel, by which the descent holds the rover's attitude.
    "jump_node": ((topics.JUMP_MOTOR_STATE,), frozenset({"driving", "jumping", "returning"})),
    "mission_node": ((topics.WINCH_STATE,), frozenset({"landing", "lifting"})),
}
_JOINTS = {
    topics.WINCH_STATE: (WINCH_DRUM, 2e-3),
    topics.WHEEL_STATE: (WHEEL_LEFT, 0.05),
    topics.JUMP_MOTOR_STATE: (JUMP_SCREW, 2e-3),
}
_WATCHDOGS = 3.0  # in which all that was moved must rest [s]
_DEAD = 5.0  # before it is started again [s]
_RESUMES = 240.0  # in which a leg must be done again [s]
_SOONEST, _LATEST = 2.0, 12.0  # of a kill after the last one is mended [s]
_LATE = 20  # samples of the drum that may have come after its winch was armed
_FACTOR = 0.5  # so slow that no node is late on a busy machine
_NANO = 1_000_000_000


class Kill(NamedTuple):
    """A kill, and what came of it."""

    node: str
    when: float  # [s]
    during: str  # phase of the mission
    unsafe: str  # what was not safe; empty = all was
    stayed: str  # why the mission did not go on; empty = it did


@dataclass
class _Cast:
    """The nodes of a mission, and who watches them."""

    harness: NodeHarness
    folder: Path

    def __post_init__(self) -> None:
        plan = self.folder / "plan.yaml"
        plan.write_text(_PLAN, encoding="utf-8")
        parameters = {"scenario": "floor_rubble", "overrides": json.dumps(_OVERRIDES)}
        self.harness.processes.start(_PLANT, {**parameters, "real_time_factor": _FACTOR})
        self.given: dict[str, dict[str, object]] = {
            name: {"use_sim_time": True} for name in _MODULES
        }
        self.given["winch_node"] |= _WINCH
        kept = self.folder / "checkpoint.json"
        self.given["mission_node"] |= {"plan": str(plan), "checkpoint": str(kept)}
        self.nodes: dict[str, Process] = {}
        self.observer: Observer = self.harness.observer()
        for name in (
            topics.CLOCK,
            topics.EVENTS,
            topics.MISSION_PHASE,
            topics.WINCH_MODE,
            *_JOINTS,
        ):
            self.observer.listen(name)
        for name in _MODULES:
            self.start(name)
        for name in ("mock_plant", *_MODULES):
            self.observer.wait_until_ready(name)

    def start(self, name: str) -> None:
        """Start a node, or start it again."""
        self.nodes[name] = self.harness.processes.start(_MODULES[name], self.given[name])

    @property
    def time(self) -> float:
        """Simulated [s]."""
        return self.observer.time_ns() / _NANO

    @property
    def phase(self) -> str:
        """Of the mission."""
        last = self.observer.listen(topics.MISSION_PHASE).last
        return "" if last is None else str(last.text)

    def wait(self, duration: float) -> None:
        """For so long [s], simulated."""
        self.observer.wait_for_time(self.observer.time_ns() + round(duration * _NANO))

    def told(self, name: str, since: int) -> bool:
        """Whether an event was told since so many samples."""
        samples = self.observer.listen(topics.EVENTS).samples[since:]
        return any(status.name == name for sample in samples for status in sample.statuses)

    def moves(self, topic: str) -> str:
        """What of a topic's moves now, in words; empty = it rests."""
        sample: JointSample = self.observer.listen(topic).last
        joint, still = _JOINTS[topic]
        rate = sample.joints[joint].velocity
        return f"{joint} moves with {rate:.3g}" if abs(rate) > still else ""


@contextmanager
def _cast(folder: Path) -> Iterator[_Cast]:
    folder.mkdir(parents=True, exist_ok=True)
    with open_harness(folder) as harness:
        yield _Cast(harness, folder)


def _kill(cast: _Cast, node: str) -> Kill:
    """Kill a node, look at what it has left, start it again, and wait for a leg to be done."""
    events = cast.observer.listen(topics.EVENTS)
    during, when = cast.phase, cast.time
    dead = cast.nodes[node]
    dead.send(signal.SIGKILL)
    dead.wait()
    cast.wait(_WATCHDOGS)
    watched, phases = _MOVED[node]
    is_its_own = not phases or during in phases
    unsafe = [moves for topic in watched if is_its_own and (moves := cast.moves(topic))]
    since = len(events)
    if node == "winch_node":
        unsafe += _moves_unarmed(cast)
    else:
        cast.wait(_DEAD - _WATCHDOGS)
        cast.start(node)
    stayed = _stayed(cast, since)
    return Kill(node, when, during, "; ".join(unsafe), stayed)


def _moves_unarmed(cast: _Cast) -> list[str]:
    """Start the winch again; whether its drum moves before it is armed."""
    drum, modes = cast.observer.listen(topics.WINCH_STATE), cast.observer.listen(topics.WINCH_MODE)
    cast.wait(_DEAD - _WATCHDOGS)
    first, told = len(drum), len(modes)
    cast.start("winch_node")
    modes.wait(lambda sample: sample.text not in (WinchMode.DISARMED, WinchMode.FAULT), told)
    # The last samples may already be those of the armed winch.
    before = drum.samples[first : len(drum) - _LATE]
    if not before:
        return ["the drum was not heard before it was armed"]
    moved = max(abs(sample.joints[WINCH_DRUM].velocity) for sample in before)
    still = _JOINTS[topics.WINCH_STATE][1]
    return [f"the drum moved with {moved:.3g} m/s unarmed"] if moved > still else []


def _stayed(cast: _Cast, since: int) -> str:
    """Wait for a leg to be done; why none was."""
    ends = cast.time + _RESUMES
    while cast.time < ends:
        if cast.told(MissionEvent.LEG_COMPLETED, since) or cast.told(MissionEvent.COMPLETED, since):
            return ""
        if cast.phase in (MissionPhase.HOLDING, MissionPhase.ABORTED):
            return f"the mission is {cast.phase}"
        cast.wait(0.5)
    return f"no leg was done within {_RESUMES:g} s, the mission is {cast.phase}"


def kill_each(folder: Path, seed: int, index: int) -> list[Kill]:
    """One mission in which each node is killed once."""
    rng = np.random.default_rng([seed, index, 2])
    kills: list[Kill] = []
    with _cast(folder / f"kills_{index}") as cast:
        cast.observer.call(topics.MISSION_GO)
        for node in rng.permutation(list(_MODULES)):
            cast.wait(float(rng.uniform(_SOONEST, _LATEST)))
            if cast.phase == MissionPhase.STANDBY:
                cast.observer.call(topics.MISSION_GO)  # it is over: another one
                cast.wait(float(rng.uniform(_SOONEST, _LATEST)))
            kills.append(_kill(cast, str(node)))
            if kills[-1].stayed:
                break
    return kills


def _kills(batch: Batch) -> list[Kill]:
    def killed(seed: int, index: int) -> list[Kill]:
        return kill_each(batch.folder, seed, index)

    runs = max(batch.runs, 1)
    found: list[Kill] = []
    for index in range(runs):
        found += fly_kept(batch.kept, killed, batch.seed, index)
        batch.progress(index + 1, runs)
    return found


def unsafe(batch: Batch) -> Measured:
    """Kills after which something moved that should not, or the mission did not go on."""
    kills = _kills(batch)
    bad = [kill for kill in kills if kill.unsafe or kill.stayed]
    details: dict[str, float | str] = {
        f"kill {number}": f"{kill.node} at {kill.when:.1f} s, {kill.during}: "
        + (kill.unsafe or "safe")
        + ", "
        + (kill.stayed or "went on")
        for number, kill in enumerate(kills, 1)
    }
    by_node = {name: sum(kill.node == name for kill in kills) for name in _MODULES}
    counts = ", ".join(f"{count} of {name}" for name, count in by_node.items())
    return Measured(float(len(bad)), f"{len(kills)} kills: {counts}", details)
