"""Missions by the processes of the launch file in lockstep, compared to the loop host.

While two busy loops hold the cores, each process is stopped for a second at a random time. Every
sample that an observer receives must equal the sample of this stamp on the loop host.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.phases import MissionPhase
from msg_schemas.samples import Sample
from rover_launch.loop import make_plan, start_plan
from rover_launch.plan import HANGING_DEFAULTS, LaunchPlan
from rover_runtime.delays import Delays
from rover_runtime.loop_host import LoopHost
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.mission_places import shallow
from rover_verify.harness import Observer, Process, open_harness
from rover_verify.harness.flight import MISSION
from rover_verify.harness.launching import start_processes

_RUNS = 5
_COMPARED = (
    topics.COMMANDS,
    topics.WINCH_COMMAND,
    topics.WINCH_ESTIMATE,
    topics.WHEEL_COMMAND,
    topics.DESCENT_STATE,
    topics.DRIVE_STATE,
    topics.ODOMETRY,
    topics.POSE,
    topics.MISSION_STATE,
)
_OVERRIDES: dict[str, object] = json.loads(HANGING_DEFAULTS["overrides"])
_ENDS = (MissionPhase.STANDBY.value, MissionPhase.HOLDING.value, MissionPhase.ABORTED.value)
_BUSY_LOOPS = 2
_STANDSTILL = 1.0  # wall time [s]
_LATEST_STOP = 200.0  # simulated time [s]
_LIMIT = 1800.0  # simulated time of a mission [s]
_PATIENCE = 3600.0  # wall time of a mission [s]
_SHARE = 0.8  # of the expected samples that the observer must have received

Expected = dict[str, dict[int, list[Sample]]]
"""Samples by topic and stamp; several nodes publish on ``commands``."""


def different(batch: CheckBatch) -> Measured:
    """Samples that differ, and missions that do not end at the stow."""
    runs = min(batch.runs, _RUNS)
    wrong, compared, details = 0, 0, dict[str, float | str]()
    for index in range(runs):
        folder = batch.folder / str(index)
        folder.mkdir()
        number, differing, ended = _fly(folder, batch.seed, index)
        compared += number
        wrong += len(differing) + (not ended)
        end = "at the stow" if ended else "NOT at the stow"
        details[f"run {index}"] = f"{number} samples, {end}; {'; '.join(differing[:3])}"
        batch.progress(index + 1, runs)
    return Measured(wrong, f"{runs} missions, {compared} samples", details)


def _fly(folder: Path, seed: int, index: int) -> tuple[int, list[str], bool]:
    """Return the number of compared samples, what differs, and whether the rover is back."""
    given = {
        "scenario": "floor_rubble",
        "overrides": json.dumps(_OVERRIDES | shallow(np.random.default_rng([seed, index]))),
        "seed": str(1000 * seed + index),
        "real_time_factor": "0",
        "lockstep": "true",
        "delay_seed": str(seed),
    }
    planned = make_plan(MISSION, HANGING_DEFAULTS, given)
    mission = {"mission_node": {"plan": "shallow", "checkpoint": "none"}}
    random = np.random.default_rng([seed, index, 2])
    with open_harness(folder) as harness, _busy_cores():
        observer = harness.observer()
        for name in (*_COMPARED, topics.EVENTS, topics.MISSION_PHASE, topics.WINCH_STATE):
            observer.listen(name)
        processes = start_processes(harness, planned, mission)
        _stop_each(observer, processes, sorted(random.uniform(5.0, _LATEST_STOP, len(processes))))
        started_ns = _start_mission(observer)
        observer.listen(topics.MISSION_PHASE).wait(lambda s: s.text in _ENDS, 1, _PATIENCE)
        received = {name: observer.listen(name).samples for name in _COMPARED}
    expected, ended = _fly_alone(planned, mission, seed, started_ns)
    return *_compare(received, expected), ended


def _start_mission(observer: Observer) -> int:
    """Start the mission; returns its simulated time [ns]."""
    observer.wait_until_ready("mission_node")
    observer.listen(topics.WINCH_STATE).wait(lambda s: s.stamp_ns > 1_000_000_000)
    answer = observer.call(topics.MISSION_GO)
    assert answer.success, answer.message
    events = observer.listen(topics.EVENTS)
    started = events.wait(lambda s: any(e.name == MissionEvent.STARTED for e in s.statuses))
    return int(started.stamp_ns)


def _stop_each(observer: Observer, processes: Sequence[Process], times: Sequence[float]) -> None:
    """Stop each process for a second of wall time at its simulated time [s]."""

    def act() -> None:
        for process, time in zip(processes, times, strict=True):

            def is_due(sample: Any, due_ns: float = time * 1e9) -> bool:
                return bool(sample.stamp_ns > due_ns)

            observer.listen(topics.WINCH_STATE).wait(is_due, 0, _PATIENCE)
            process.send(signal.SIGSTOP)
            threading.Event().wait(_STANDSTILL)
            process.send(signal.SIGCONT)

    threading.Thread(target=act, daemon=True).start()


@contextmanager
def _busy_cores() -> Iterator[None]:
    loops = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"], env=dict(os.environ))
        for _ in range(_BUSY_LOOPS)
    ]
    try:
        yield
    finally:
        for each in loops:
            each.kill()
            each.wait()


def _fly_alone(
    planned: LaunchPlan, mission: Mapping[str, Mapping[str, object]], seed: int, started_ns: int
) -> tuple[Expected, bool]:
    """Fly the mission on the loop host; returns its samples and whether it ended at the stow."""
    nodes = [name for each in planned.started for name in each.node_names]
    host = LoopHost(Delays(seed), order=nodes)
    found: Expected = {name: {} for name in _COMPARED}
    phases: list[str] = []

    def listen(name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        if name == topics.MISSION_PHASE:
            phases.append(getattr(sample, "text", ""))
        else:
            found[name].setdefault(getattr(sample, "stamp_ns", 0), []).append(sample)

    host.exchange.listen(listen, *_COMPARED, topics.MISSION_PHASE)
    start_plan(host, planned, mission)
    while host.time < _LIMIT and not any(each in _ENDS for each in phases[1:]):
        host.step()
        if host.now_ns() == started_ns:
            # As a request from outside, between two ticks.
            host.exchange.answer(topics.MISSION_GO, ())
        host.advance(host.next_ns)
    return found, phases[-1] == MissionPhase.STANDBY.value


def _compare(received: Mapping[str, Sequence[Sample]], expected: Expected) -> tuple[int, list[str]]:
    differing, number = [], 0
    last_ns = max(stamp_ns for each in expected.values() for stamp_ns in each)
    for name, samples in received.items():
        for sample in samples:
            stamp_ns = getattr(sample, "stamp_ns", 0)
            if stamp_ns > last_ns:
                continue  # after the end of the mission
            number += 1
            if sample not in expected[name].get(stamp_ns, ()):
                differing.append(f"{name} at {stamp_ns * 1e-9:.2f} s")
        sent = sum(map(len, expected[name].values()))
        if len(samples) < _SHARE * sent:
            differing.append(f"{name}: only {len(samples)} of {sent} samples")
    return number, differing
