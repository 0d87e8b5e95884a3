"""How long the loop over the link takes: emulator, bridge and a controller as processes."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from functools import cache
from pathlib import Path
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.samples import Status
from rover_hil.devices import SYNC_PERIOD
from rover_verify.checks import Batch, Measured
from rover_verify.harness import NodeHarness, Observer, Process, open_harness

_CLOCK_OFFSET = 12.5  # of the rover's clock, set wrong on purpose [s]
_LOOPS = 2000  # of which the percentiles are made
_WARM_UP = 500
_ATTEMPTS = 100
_STOPS = 12
_STOPPED = (0.02, 0.3)  # a bridge, for so long [s]
_RUNNING = (0.1, 0.5)  # and between [s]
_PRIORITY = 20  # of the loop's processes, where it is permitted
_READING = 3  # cycles by which a count and the time at which it is heard may be apart


def _start(harness: NodeHarness, **emulated: object) -> tuple[Process, Observer]:
    """Start emulator and bridge in real time; the bridge, and an observer when both are ready."""
    of_both = {"link": harness.link, "realtime_priority": _PRIORITY}
    harness.processes.start("rover_hil.emulator.emulator_node", {**of_both, **emulated})
    bridge = harness.processes.start("rover_hil.bridge_node", {**of_both, "use_sim_time": True})
    observer = harness.observer()
    for name in (topics.DIAGNOSTICS, topics.LINK_STATUS, topics.CLOCK):
        observer.listen(name)
    for node in ("drive_emulator", "hil_bridge"):
        observer.wait_until_ready(node)
    return bridge, observer


class _Loop(NamedTuple):
    """What is told after enough loops in real time."""

    link: Status
    devices: dict[str, Status]
    has_priority: bool  # whether the kernel permits it


@cache
def _measured(folder: Path) -> _Loop:
    with open_harness(folder) as harness:
        bridge, observer = _start(harness, rover_clock_offset=_CLOCK_OFFSET)
        reports = observer.listen(topics.LINK_STATUS)
        for _ in range(_ATTEMPTS):
            if observer.call(topics.DRIVES_ARM, True).success:
                break
            reports.wait(lambda _: True, len(reports))
        answering = {"use_sim_time": True, "realtime_priority": _PRIORITY}
        harness.processes.start("rover_verify.harness.answerer", answering)
        told = observer.wait_for_status(
            topics.LINK_STATUS,
            lambda s: int(s.values.get("round_trip_count", "0")) >= _LOOPS + _WARM_UP,
        )
        devices = {s.name.rpartition(" ")[2]: s for s in reports.last.statuses}
        has_priority = os.sched_getparam(bridge.pid).sched_priority == _PRIORITY
        return _Loop(told, devices, has_priority)


def round_trip(batch: Batch) -> Measured:
    """99th percentile of the time from a state's sampling to the execution of its command."""
    told, _, has_priority = _measured(batch.folder)
    names = (
        "round_trip_p50", "round_trip_max", "round_trip_count", "command_time_p99",
        "answer_time_p99", "cycles", "late_cycles", "incomplete_cycles", "overdue_round_trips",
        "frames_lost",
    )  # fmt: skip
    details: dict[str, float | str] = {name: float(told.values[name]) for name in names}
    scheduled = f"at real-time priority {_PRIORITY}" if has_priority else "at no priority: refused"
    return Measured(
        float(told.values["round_trip_p99"]), f"200 Hz on this machine, {scheduled}", details
    )


def clock_offset(batch: Batch) -> Measured:
    """Error of the rover's clock against the mother's, over the uncertainty that is told."""
    devices = _measured(batch.folder).devices
    rover, mother = devices["imu"].values, devices["winch"].values
    found = float(rover["clock_offset"]) - float(mother["clock_offset"])
    uncertainty = float(rover["clock_uncertainty"]) + float(mother["clock_uncertainty"])
    error = abs(found - _CLOCK_OFFSET)
    details: dict[str, float | str] = {"error [s]": error, "uncertainty [s]": uncertainty}
    return Measured(error / uncertainty, "rover against mother", details)


def uncounted_deadlines(batch: Batch) -> Measured:
    """SYNCs that were due of a bridge that is stopped now and then, neither sent nor counted."""
    generator = random.Random(batch.seed)
    with open_harness(batch.folder) as harness:
        bridge, observer = _start(harness)
        reports = observer.listen(topics.LINK_STATUS)

        def counts() -> tuple[float, int, int]:
            """When a report came [s], and its cycles and late ones."""
            found = reports.wait(lambda _: True, len(reports))
            at = time.monotonic()
            (told,) = [s for s in found.statuses if s.name == "hil_bridge: link"]
            return at, int(told.values["cycles"]), int(told.values["late_cycles"])

        began, first, first_late = counts()
        stopped, asleep = 0.0, threading.Event()
        for _ in range(_STOPS):
            bridge.send(signal.SIGSTOP)
            pause = generator.uniform(*_STOPPED)
            asleep.wait(pause)
            bridge.send(signal.SIGCONT)
            stopped += pause
            asleep.wait(generator.uniform(*_RUNNING))
        ended, last, last_late = counts()
    due = (ended - began) / SYNC_PERIOD
    missed = due - (last - first)
    uncounted = missed - (last_late - first_late)
    return Measured(
        max(0.0, round(uncounted) - _READING),
        f"stopped {_STOPS} times for {stopped:.1f} s in all: of {due:.0f} cycles {missed:.0f} were "
        f"not begun, {last_late - first_late} are counted as not begun, or late; up to {_READING} "
        "may be the reading's",
    )
