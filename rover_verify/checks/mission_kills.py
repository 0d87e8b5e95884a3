"""Nodes killed during a mission: real processes over DDS, on the mock plant.

In each mission every controller and the supervisor is killed once, at a random time, and restarted
after a while. Watchdogs of the other nodes must stop its motions, the winch must not move before it
is armed again, and the mission must continue by itself.
"""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path
from typing import NamedTuple

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.events import MissionEvent, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import MissionPhase
from msg_schemas.samples import JointSample, StatusSample
from rover_launch.plan import FALSE, MOCK
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_kept
from rover_verify.harness import NodeHarness, open_harness
from rover_verify.harness.flight import MISSION
from rover_verify.harness.launching import Launched

_OVERRIDES = {
    "environment.floor": {"height": -5.0},
    "tether.length": 2.0,
    "winch.min_length": 1.4,
    "start": {"kind": "hanging"},
}
_LAUNCHED = {
    "plant": MOCK, "scenario": "floor_rubble", "overrides": json.dumps(_OVERRIDES),
    "lockstep": FALSE, "composed": FALSE, "frames": FALSE,
    "real_time_factor": "0.5",  # slow, so that no node is late on a busy machine
}  # fmt: skip
# Many short legs, for kills in different phases.
_PLAN = """
stow: 2.0
landing: {approach_depth: 3.0, max_depth: 6.5, rate: 0.05}
survey:
  - {x: 0.6, y: 0.0, jump_height: 0.1}
  - {x: 0.6, y: 0.6}
lift: {height: 0.5, rate: 0.05, radius: 0.6}
"""
# What each node moves, and in which phases of the mission; an empty set means any. In other phases
# other nodes may move the same.
_MOVED_TOPICS: dict[str, tuple[tuple[str, ...], frozenset[str]]] = {
    "winch_node": ((topics.WINCH_STATE,), frozenset()),
    "descent_node": (
        (topics.WINCH_STATE, topics.WHEEL_STATE),
        frozenset({"looking", "turning", "approaching", "ascending"}),
    ),
    "drive_node": (
        (topics.WINCH_STATE, topics.WHEEL_STATE),
        frozenset({"driving", "returning"}),
    ),
    # The screw turns with the flywheel, which the descent uses for attitude control.
    "jump_node": ((topics.JUMP_MOTOR_STATE,), frozenset({"driving", "jumping", "returning"})),
    "mission_node": ((topics.WINCH_STATE,), frozenset({"landing", "lifting"})),
}
_JOINTS = {
    topics.WINCH_STATE: (machine.WINCH_DRUM, 2e-3),
    topics.WHEEL_STATE: (machine.WHEEL_LEFT, 0.05),
    topics.JUMP_MOTOR_STATE: (machine.JUMP_SCREW, 2e-3),
}
_WATCHDOG_TIME = 3.0  # time in which all motions must stop [s]
_DOWNTIME = 5.0  # time before the restart [s]
_RESUME_TIME = 240.0  # time in which a leg must be completed [s]
_MIN_DELAY, _MAX_DELAY = 2.0, 12.0  # of a kill after the last recovery [s]
_NANO = 1_000_000_000


class Kill(NamedTuple):
    """A kill and its consequences."""

    node: str
    when: float  # [s]
    during: str  # phase of the mission
    unsafe: str  # what was unsafe; empty = nothing
    not_resumed: str  # why the mission did not continue; empty = it did


class _MissionNodes(Launched):
    """The nodes of a mission and their observer."""

    def __init__(self, harness: NodeHarness, folder: Path) -> None:
        plan, checkpoint = folder / "plan.yaml", folder / "checkpoint.json"
        plan.write_text(_PLAN, encoding="utf-8")
        own = {"mission_node": {"plan": str(plan), "checkpoint": str(checkpoint)}}
        super().__init__(harness, MISSION, _LAUNCHED, own)
        for name in (topics.CLOCK, topics.MISSION_PHASE, *_JOINTS):
            self.observer.listen(name)
        self.wait_until_ready()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.observer.time_ns() / _NANO

    @property
    def phase(self) -> str:
        """Phase of the mission."""
        last = self.observer.listen(topics.MISSION_PHASE).last
        return "" if last is None else str(last.text)

    def wait(self, duration: float) -> None:
        """Wait for a simulated duration [s]."""
        self.observer.wait_for_time(self.observer.time_ns() + round(duration * _NANO))

    def describe_motion(self, topic: str) -> str:
        """Describe a topic's present motion; empty = at rest."""
        sample: JointSample = self.observer.listen(topic).last
        joint, threshold = _JOINTS[topic]
        rate = sample.joints[joint].velocity
        return f"{joint} moves at {rate:.3g}" if abs(rate) > threshold else ""


def _kill(nodes: _MissionNodes, node: str) -> Kill:
    """Kill a node, check its motions, restart it, and wait for a completed leg."""
    events = nodes.observer.listen(topics.EVENTS)
    during, when = nodes.phase, nodes.time
    process = nodes.processes[node]
    process.send(signal.SIGKILL)
    process.wait()
    nodes.wait(_WATCHDOG_TIME)
    moved_topics, phases = _MOVED_TOPICS[node]
    is_moving_phase = not phases or during in phases
    unsafe = [
        motion
        for topic in moved_topics
        if is_moving_phase and (motion := nodes.describe_motion(topic))
    ]
    since = len(events)
    if node == "winch_node":
        unsafe += _motion_while_unarmed(nodes)
    else:
        nodes.wait(_DOWNTIME - _WATCHDOG_TIME)
        nodes.start(node)
    not_resumed = _wait_for_leg(nodes, since)
    return Kill(node, when, during, "; ".join(unsafe), not_resumed)


def _motion_while_unarmed(nodes: _MissionNodes) -> list[str]:
    """Restart the winch; reports motion of its drum before it is armed."""
    drum = nodes.observer.listen(topics.WINCH_STATE)
    events = nodes.observer.listen(topics.EVENTS)
    nodes.wait(_DOWNTIME - _WATCHDOG_TIME)
    first, since = len(drum), len(events)
    nodes.start("winch_node")
    # By stamps: on a busy machine the drum of an armed winch moves before this thread runs.
    armed_ns = events.wait(_has_armed, since).stamp_ns
    drum.wait(lambda sample: sample.stamp_ns >= armed_ns, first)
    before = [sample for sample in drum.samples[first:] if sample.stamp_ns <= armed_ns]
    max_rate = max(
        (abs(sample.joints[machine.WINCH_DRUM].velocity) for sample in before), default=math.inf
    )
    threshold = _JOINTS[topics.WINCH_STATE][1]
    return [f"the drum moved at {max_rate:.3g} m/s while unarmed"] if max_rate > threshold else []


def _has_armed(sample: StatusSample) -> bool:
    armed = {"reason": Reason.ARMED.value}.items()
    return any(
        each.name == WinchEvent.HOLD and armed <= each.values.items() for each in sample.statuses
    )


def _wait_for_leg(nodes: _MissionNodes, since: int) -> str:
    """Wait for a completed leg; returns why there was none."""
    deadline = nodes.time + _RESUME_TIME
    while nodes.time < deadline:
        ends = (MissionEvent.LEG_COMPLETED, MissionEvent.COMPLETED)
        if nodes.observer.events(*ends, since=since):
            return ""
        if nodes.phase in (MissionPhase.HOLDING, MissionPhase.ABORTED):
            return f"the mission is in phase {nodes.phase}"
        nodes.wait(0.5)
    return f"no leg completed within {_RESUME_TIME:g} s, the mission is in phase {nodes.phase}"


def kill_each(folder: Path, seed: int, index: int) -> list[Kill]:
    """One mission in which each node is killed once."""
    rng = np.random.default_rng([seed, index, 2])
    kills: list[Kill] = []
    place = folder / f"kills_{index}"
    place.mkdir(parents=True, exist_ok=True)
    with open_harness(place) as harness:
        nodes = _MissionNodes(harness, place)
        nodes.observer.call(topics.MISSION_GO)
        for node in rng.permutation(list(_MOVED_TOPICS)):
            nodes.wait(float(rng.uniform(_MIN_DELAY, _MAX_DELAY)))
            if nodes.phase == MissionPhase.STANDBY:
                nodes.observer.call(topics.MISSION_GO)  # the mission is over: start another one
                nodes.wait(float(rng.uniform(_MIN_DELAY, _MAX_DELAY)))
            kills.append(_kill(nodes, str(node)))
            if kills[-1].not_resumed:
                break
    return kills


def unsafe(batch: CheckBatch) -> Measured:
    """Kills with an unsafe motion, or after which the mission did not continue."""

    def killed(seed: int, index: int) -> list[Kill]:
        return kill_each(batch.folder, seed, index)

    kills: list[Kill] = []
    for index in range(batch.runs):
        kills += fly_kept(batch.kept, killed, batch.seed, index)
        batch.progress(index + 1, batch.runs)
    bad = [kill for kill in kills if kill.unsafe or kill.not_resumed]
    by_node = {name: sum(kill.node == name for kill in kills) for name in _MOVED_TOPICS}
    counts = ", ".join(f"{count} of {name}" for name, count in by_node.items())
    return Measured(len(bad), f"{len(kills)} kills: {counts}", per_run(kills))
