"""A descent and a jump by the suite's nodes, with the simulator and over the link.

The same processes control both: their machine is `sim_node`, or `hil_bridge` with `drive_emulator`.
The metrics of each run are computed from its bag. All run in lockstep.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, JumpEvent
from msg_schemas.samples import StatusSample
from rover_bags.analysis.activities import hanging_swing
from rover_bags.analysis.entries import TimelineEntry, entries_of
from rover_bags.analysis.metrics import measure
from rover_bags.reading.read import Bag, read_bag
from rover_launch.plan import HIL, LOCKSTEP, SIM, TRUE
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.floor import Stand
from rover_verify.harness import open_harness
from rover_verify.harness.flight import DESCENT
from rover_verify.harness.launching import Launched, arm_winch

_TIMEOUT = 3600.0  # by the wall clock [s]
_TOP, _STOP = 3.0, 5.0  # [m]
_HEIGHT = 0.2  # of the jump [m]
_REST_NS = 2_000_000_000  # after the end, for the last pictures
_LAST = 10.0  # of a descent [s]
Metrics = Mapping[str, float]


BOUNDS: Mapping[str, tuple[float, float]] = {
    "pictures": (0.0, 0.0),
    "depth of the pictures [m]": (2e-3, 0.0),
    "steady pictures": (0.0, 0.0),
    "time to the end of the stop [s]": (10.0, 0.25),
    "swing at the end [rad]": (2e-3, 0.0),
    "jump height [m]": (0.0, 0.03),
    "jump height by the IMU [m]": (0.0, 0.05),
    "flight time [s]": (0.0, 0.03),
    "stroke [m]": (1e-3, 0.0),
}
"""Tolerance over the link, absolute and relative to the direct run.

The runs differ: over the link sensors are sampled at 200 Hz and quantised.
"""


_STOP_ENDS = (DescentEvent.STOP_COMPLETED, DescentEvent.STOP_FAILED)


def _has_event(*names: str) -> Callable[[StatusSample], bool]:
    return lambda sample: any(s.name in names for s in sample.statuses)


def descend(plant: str, folder: Path, seed: int) -> Bag:
    """Lower a swinging rover to one stop, where it takes pictures; returns the bag."""
    generator = random.Random(seed)
    overrides = {
        "tether.length": _TOP,
        "tether.element_length": 0.9,
        "winch.min_length": 1.4,
        "start.swing_angle": generator.uniform(1.0, 2.0),
        "start.swing_heading": generator.uniform(0.0, 360.0),
        "sensors.error_model": "full",
    }
    given = {"scenario": "free_hang", "overrides": json.dumps(overrides), "seed": str(seed)}
    with _launched(plant, folder, given, DESCENT) as launched:
        launched.observer.send_joint(
            topics.DESCENT_REQUEST, machine.OBSERVATION_STOP, _STOP, 0.0, stamp_ns=0
        )
        return _ended(launched, _has_event(*_STOP_ENDS))


def jump(plant: str, folder: Path, seed: int) -> Bag:
    """Let a standing rover jump on a slack tether; returns the bag."""
    overrides = {**Stand(spring=random.Random(seed).uniform(0.97, 1.03)).overrides(),
                 "sensors.error_model": "full"}  # fmt: skip
    given = {"scenario": "floor_rubble", "overrides": json.dumps(overrides), "seed": str(seed)}
    with _launched(plant, folder, given, ("winch_node", "jump_node")) as launched:
        launched.observer.send_joint(
            topics.JUMP_REQUEST, machine.JUMP_HEIGHT, _HEIGHT, 0.0, stamp_ns=0
        )
        return _ended(launched, _has_event(JumpEvent.STANDBY, JumpEvent.FAULT))


@contextmanager
def _launched(
    plant: str, folder: Path, given: Mapping[str, str], controllers: Sequence[str]
) -> Iterator[Launched]:
    """Plant and controllers in lockstep, with armed drives and winch, recorded."""
    folder.mkdir(parents=True, exist_ok=True)
    with open_harness(folder) as harness:
        arguments = {**given, "plant": plant, LOCKSTEP: TRUE}
        if plant == SIM:
            arguments["real_time_factor"] = "0"
        launched = Launched(harness, controllers, arguments, bag=folder / "bag")
        observer = launched.observer
        for name in (topics.CLOCK, topics.WINCH_MODE):
            observer.listen(name)
        launched.wait_until_ready(topics.WINCH_STATE, topics.CLOCK.strip("/"))
        if plant == HIL:
            answer = observer.call(topics.DRIVES_ARM, True)
            if not answer.success:
                raise RuntimeError(f"the drives cannot be armed: {answer.message}")
        arm_winch(observer)
        yield launched


def _ended(launched: Launched, is_end: Callable[[Any], bool]) -> Bag:
    """Wait for the end, and for the last pictures."""
    observer = launched.observer
    observer.listen(topics.EVENTS).wait(is_end, 0, _TIMEOUT)
    end_ns = observer.time_ns() + _REST_NS
    observer.listen(topics.CLOCK).wait(lambda sample: sample.stamp_ns >= end_ns, 0, _TIMEOUT)
    return read_bag(launched.end_recording())


# --- metrics of a bag ----------------------------------------------------------------------------


def _end(events: Mapping[str, TimelineEntry]) -> TimelineEntry:
    """Return the event that ended the stop."""
    return next(events[name] for name in _STOP_ENDS if name in events)


def descent_metrics(bag: Bag) -> Metrics:
    """Metrics of a descent to one stop."""
    metrics = measure(bag)
    events = {entry.name: entry for entry in entries_of(bag.series(topics.EVENTS))}
    pictures = bag.series(topics.DESCENT_OBSERVATION)
    if pictures is None:
        raise RuntimeError(f"no pictures: {_end(events).message}")
    rates = pictures.columns[f"{machine.CAMERA_RATE}.velocity"]
    swing = hanging_swing(bag, metrics.timeline)
    assert swing is not None
    time, angle = swing
    return {
        "pictures": len(pictures),
        "depth of the pictures [m]": float(np.mean(pictures.columns[f"{machine.DEPTH}.position"])),
        "steady pictures": int(np.sum(rates <= machine.STEADY_CAMERA_RATE)),
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
        "jump height by the IMU [m]": float(own.columns[f"{machine.JUMP_HEIGHT}.position"][-1]),
        "flight time [s]": flight.flight_time_s,
        "stroke [m]": float(own.columns[f"{machine.JUMP_STROKE}.position"][-1]),
    }


def through_the_emulator(batch: CheckBatch) -> Measured:
    """Metrics of a descent and a jump over the link out of tolerance of the direct run."""
    found: dict[str, dict[str, float]] = {SIM: {}, HIL: {}}
    lost = 0
    for plant, metrics in found.items():
        for fly, read in ((descend, descent_metrics), (jump, jump_metrics)):
            bag = fly(plant, batch.folder / f"{fly.__name__}_{plant}", batch.seed)
            metrics.update(read(bag))
            lost += sum(bag.dropped.values()) + sum(bag.lost_in_transport.values())
    direct, linked = found[SIM], found[HIL]
    outside = [
        name
        for name, (absolute, relative) in BOUNDS.items()
        if not np.isclose(linked[name], direct[name], rtol=relative, atol=absolute)
    ]
    details: dict[str, float | str] = {
        name: f"{direct[name]:.5g} directly, {linked[name]:.5g} over the link" for name in BOUNDS
    }
    return Measured(
        len(outside),
        f"outside: {', '.join(outside) or 'none'}; four bags, {lost} messages lost",
        details,
    )
