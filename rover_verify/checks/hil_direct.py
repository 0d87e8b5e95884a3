"""A descent and a jump by the suite's nodes, with the simulator and over the link.

The same processes control both: their machine is `sim_node`, or `hil_bridge` with `drive_emulator`.
The metrics of each run are computed from its bag. Simulated time waits for the controllers, so that
a busy computer does not change the result.
"""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from msg_schemas import topics
from msg_schemas.events import DescentEvent, JumpEvent
from msg_schemas.machine import (
    CAMERA_RATE,
    DEPTH,
    JUMP_HEIGHT,
    JUMP_STROKE,
    OBSERVATION_STOP,
)
from msg_schemas.samples import StatusSample
from msg_schemas.yaml_reader import read_yaml
from rover_bags.analysis.activities import hanging_swing
from rover_bags.analysis.entries import Entry, entries_of
from rover_bags.analysis.metrics import measure
from rover_bags.reading.read import Bag, read_bag
from rover_hil.canopen.devices import SYNC_PERIOD
from rover_verify.checks import Batch, Measured, NotPossible
from rover_verify.checks.floor import Stand
from rover_verify.checks.winch_nodes import arm
from rover_verify.harness import NodeHarness, Observer, open_harness
from rover_verify.harness.lockstep import Lockstep
from rover_verify.harness.recording import recorded_topics

_CONFIG = Path(__file__).resolve().parents[2] / "config"
_TIMEOUT = 3600.0  # by the wall clock [s]
_LONGEST = 600.0  # of a descent or a jump, in simulated time [s]
_TOP, _STOP = 3.0, 5.0  # [m]
_HEIGHT = 0.2  # of the jump [m]
_OBSERVED = (
    topics.CLOCK, topics.DIAGNOSTICS, topics.EVENTS, topics.WINCH_MODE, topics.WINCH_STATE,
    topics.WINCH_COMMAND, topics.DESCENT_OBSERVATION, topics.JUMP_PHASE, topics.JUMP_FLOWN,
)  # fmt: skip
_AWAITED = (topics.WINCH_COMMAND, topics.WHEEL_COMMAND, topics.FLYWHEEL_COMMAND)
_REST_NS = 2_000_000_000  # after the end, for the last pictures
_ATTEMPTS = 50
_WITHIN = 5  # cycles of SYNC: the rover's controller acts every fourth
_LAST = 10.0  # of a descent [s]
_STEADY = math.radians(0.14)  # largest camera rate of a steady picture [rad/s]
Metrics = Mapping[str, float]


@dataclass(frozen=True)
class Bound:
    """Tolerance of a metric over the link against the direct run."""

    absolute: float = 0.0
    relative: float = 0.0

    def holds(self, direct: float, linked: float) -> bool:
        """Whether the difference is within the tolerance."""
        return abs(linked - direct) <= self.absolute + self.relative * abs(direct)


BOUNDS: Mapping[str, Bound] = {
    "pictures": Bound(),
    "depth of the pictures [m]": Bound(absolute=2e-3),
    "steady pictures": Bound(),
    "time to the end of the stop [s]": Bound(absolute=10.0, relative=0.25),
    "swing at the end [rad]": Bound(absolute=2e-3),
    "jump height [m]": Bound(relative=0.03),
    "jump height by the IMU [m]": Bound(relative=0.05),
    "flight time [s]": Bound(relative=0.03),
    "stroke [m]": Bound(absolute=1e-3),
}
"""The runs differ: over the link sensors are sampled at 200 Hz and quantised."""


class _Run:
    """Processes of one run, and the observer."""

    def __init__(self, harness: NodeHarness, folder: Path, controllers: tuple[str, ...]) -> None:
        self.bag = folder / "bag"
        self._harness = harness
        self._recorder = harness.processes.start(
            "rover_bags.recording.record", {"output": str(self.bag)}
        )
        self.observer: Observer = harness.observer()
        for name in _OBSERVED:
            self.observer.listen(name)
        for name in controllers:
            harness.processes.start(_MODULES[name], _parameters(name) | {"use_sim_time": True})
        self._controllers = controllers

    def wait_until_ready(self, machine: tuple[str, ...]) -> None:
        for name in (*machine, *self._controllers):
            self.observer.wait_until_ready(name)
        self.observer.wait_until(
            lambda: {topics.WINCH_STATE, topics.CLOCK.strip("/")} <= recorded_topics(self.bag),
            "the recorder receives nothing from the machine",
        )

    def end(self) -> Bag:
        if self._recorder.stop() != 0:
            raise RuntimeError(f"the recorder failed:\n{self._recorder.output}")
        return read_bag(self.bag)


_MODULES = {
    "winch_node": "tether_winch.winch_node",
    "descent_node": "rover_control.hanging.descent_node",
    "jump_node": "rover_control.jump.jump_node",
}


def _parameters(node: str) -> dict[str, object]:
    """Shipped parameters of a node; the winch's are those for a descent."""
    found: dict[str, object] = {}
    for name in (node, "winch_descent") if node == "winch_node" else (node,):
        path = _CONFIG / f"{name}.yaml"
        if not path.exists():
            raise NotPossible(f"the parameter files are only in a checkout: {path}")
        found |= read_yaml(path)[f"/**/{node}"]["ros__parameters"]
    return found


class _Direct:
    """`sim_node`, stepped when the winch has answered."""

    def __init__(self, harness: NodeHarness, scenario: Mapping[str, object], seed: int) -> None:
        parameters = {"overrides": json.dumps(scenario["overrides"]), "seed": seed}
        harness.processes.start(
            "rover_sim.node.sim_node", {"scenario": scenario["name"], **parameters}
        )
        self._lockstep: Lockstep | None = None
        self.nodes: tuple[str, ...] = ("sim_node",)

    def begin(self, observer: Observer) -> None:
        del observer

    def wait(self, observer: Observer, is_end: Callable[[Any], bool], since: int) -> None:
        events = observer.listen(topics.EVENTS)
        if self._lockstep is None:
            self._lockstep = Lockstep(
                observer, topics.WINCH_COMMAND, _AWAITED[1:], _WITHIN * SYNC_PERIOD
            )
        self._lockstep.run_until(lambda: any(map(is_end, events.samples[since:])), _LONGEST)
        rested = observer.time_ns() + _REST_NS
        self._lockstep.run_until(lambda: observer.time_ns() >= rested, _LONGEST)


class _Linked:
    """`hil_bridge` and `drive_emulator`, in lockstep."""

    def __init__(self, harness: NodeHarness, scenario: Mapping[str, object], seed: int) -> None:
        lockstep = {"link": harness.link, "sync_lockstep": True, "lockstep_timeout": 30.0}
        parameters = {"overrides": json.dumps(scenario["overrides"]), "seed": seed}
        harness.processes.start(
            "rover_hil.emulator.emulator_node",
            {"scenario": scenario["name"], **parameters, **lockstep},
        )
        waits = {"lockstep_commands": ",".join(_AWAITED), "lockstep_within": _WITHIN}
        harness.processes.start(
            "rover_hil.bridge.bridge_node", {"use_sim_time": True, **waits, **lockstep}
        )
        self.nodes: tuple[str, ...] = ("drive_emulator", "hil_bridge")

    def begin(self, observer: Observer) -> None:
        answer = observer.call(topics.DRIVES_ARM, True)
        if not answer.success:
            raise RuntimeError(f"the drives cannot be armed: {answer.message}")

    def wait(self, observer: Observer, is_end: Callable[[Any], bool], since: int) -> None:
        observer.listen(topics.EVENTS).wait(is_end, since, _TIMEOUT)
        observer.wait_for_time(observer.time_ns() + _REST_NS)


@contextmanager
def _machine(
    kind: type[_Direct | _Linked],
    folder: Path,
    scenario: Mapping[str, object],
    seed: int,
    controllers: tuple[str, ...],
) -> Iterator[tuple[_Run, _Direct | _Linked]]:
    folder.mkdir(parents=True, exist_ok=True)
    with open_harness(folder) as harness:
        run = _Run(harness, folder, controllers)
        machine = kind(harness, scenario, seed)
        run.wait_until_ready(machine.nodes)
        machine.begin(run.observer)
        _arm(run.observer)
        yield run, machine


def _arm(observer: Observer) -> None:
    """Arm the winch; retry while its sensors time out on a busy computer."""
    states = observer.listen(topics.WINCH_STATE)
    for attempt in range(_ATTEMPTS):
        try:
            arm(observer)
        except RuntimeError:
            if attempt == _ATTEMPTS - 1:
                raise
            states.wait(lambda _: True, len(states))
        else:
            return


_STOP_ENDS = (DescentEvent.STOP_COMPLETED, DescentEvent.STOP_FAILED)


def _has_event(*names: str) -> Callable[[StatusSample], bool]:
    return lambda sample: any(s.name in names for s in sample.statuses)


def descend(kind: type[_Direct | _Linked], folder: Path, seed: int) -> Bag:
    """Lower a swinging rover to one stop, where it takes pictures; returns the bag."""
    generator = random.Random(seed)
    scenario = {
        "name": "free_hang",
        "overrides": {
            "tether.length": _TOP,
            "tether.element_length": 0.9,
            "winch.min_length": 1.4,
            "start.swing_angle": generator.uniform(1.0, 2.0),
            "start.swing_heading": generator.uniform(0.0, 360.0),
            "sensors.error_model": "full",
        },
    }
    with _machine(kind, folder, scenario, seed, ("winch_node", "descent_node")) as (run, machine):
        since = len(run.observer.listen(topics.EVENTS))
        run.observer.send_joint(topics.DESCENT_REQUEST, OBSERVATION_STOP, _STOP, 0.0, stamp_ns=0)
        machine.wait(run.observer, _has_event(*_STOP_ENDS), since)
        return run.end()


def jump(kind: type[_Direct | _Linked], folder: Path, seed: int) -> Bag:
    """Let a standing rover jump on a slack tether; returns the bag."""
    overrides = {**Stand(spring=random.Random(seed).uniform(0.97, 1.03)).overrides(),
                 "sensors.error_model": "full"}  # fmt: skip
    scenario = {"name": "floor_rubble", "overrides": overrides}
    with _machine(kind, folder, scenario, seed, ("winch_node", "jump_node")) as (run, machine):
        since = len(run.observer.listen(topics.EVENTS))
        run.observer.send_joint(topics.JUMP_REQUEST, JUMP_HEIGHT, _HEIGHT, 0.0, stamp_ns=0)
        machine.wait(run.observer, _has_event(JumpEvent.STANDBY, JumpEvent.FAULT), since)
        return run.end()


# --- metrics of a bag ----------------------------------------------------------------------------


def _end(events: Mapping[str, Entry]) -> Entry:
    """Return the event that ended the stop."""
    return next(events[name] for name in _STOP_ENDS if name in events)


def descent_metrics(bag: Bag) -> Metrics:
    """Metrics of a descent to one stop."""
    metrics = measure(bag)
    events = {entry.name: entry for entry in entries_of(bag.series(topics.EVENTS))}
    pictures = bag.series(topics.DESCENT_OBSERVATION)
    if pictures is None:
        raise RuntimeError(f"no pictures: {_end(events).message}")
    swing = hanging_swing(bag, metrics.timeline)
    assert swing is not None
    time, angle = swing
    return {
        "pictures": len(pictures),
        "depth of the pictures [m]": float(np.mean(pictures.columns[f"{DEPTH}.position"])),
        "steady pictures": int(np.sum(pictures.columns[f"{CAMERA_RATE}.velocity"] <= _STEADY)),
        "time to the end of the stop [s]": _end(events).time_s
        - events[DescentEvent.STOP_ACCEPTED].time_s,
        "swing at the end [rad]": float(np.nanmax(angle[time > time[-1] - _LAST])),
    }


def jump_metrics(bag: Bag) -> Metrics:
    """Metrics of a jump."""
    (flight,) = measure(bag).jumps
    own = bag.series(topics.JUMP_FLOWN)
    if own is None:
        raise RuntimeError("the jump controller reported no jump")
    return {
        "jump height [m]": flight.jump_height_m,
        "jump height by the IMU [m]": float(own.columns[f"{JUMP_HEIGHT}.position"][-1]),
        "flight time [s]": flight.flight_time_s,
        "stroke [m]": float(own.columns[f"{JUMP_STROKE}.position"][-1]),
    }


def through_the_emulator(batch: Batch) -> Measured:
    """Metrics of a descent and a jump over the link out of tolerance of the direct run."""
    found: dict[type[_Direct | _Linked], dict[str, float]] = {_Direct: {}, _Linked: {}}
    lost = 0
    for kind, metrics_of_kind in found.items():
        for fly, read in ((descend, descent_metrics), (jump, jump_metrics)):
            folder = batch.folder / f"{fly.__name__}{kind.__name__}"
            bag = fly(kind, folder, batch.seed)
            metrics_of_kind.update(read(bag))
            lost += sum(bag.dropped.values()) + sum(bag.lost_in_transport.values())
    direct, linked = found[_Direct], found[_Linked]
    outside = [
        name for name, bound in BOUNDS.items() if not bound.holds(direct[name], linked[name])
    ]
    details: dict[str, float | str] = {
        name: f"{direct[name]:.5g} directly, {linked[name]:.5g} over the link" for name in BOUNDS
    }
    return Measured(
        len(outside),
        f"outside: {', '.join(outside) or 'none'}; four bags, {lost} messages lost",
        details,
    )
