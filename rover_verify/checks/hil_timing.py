"""Timing of the loop over the link, with emulator, bridge and a controller as processes."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from functools import cache
from pathlib import Path

from msg_schemas import topics
from msg_schemas.samples import Status
from rover_hil.canopen.devices import SYNC_PERIOD
from rover_verify.checks import CheckBatch, Measured
from rover_verify.harness import NodeHarness, Observer, Process, open_harness

_CLOCK_OFFSET = 12.5  # of the rover's clock [s]
_LOOPS = 2000  # for the percentiles
_WARM_UP = 500
_ATTEMPTS = 100
_STOPS = 12
_STOPPED = (0.02, 0.3)  # duration of a stop of the bridge [s]
_RUNNING = (0.1, 0.5)  # time between stops [s]
_PRIORITY = 20  # of the loop's processes, if permitted
_READING_CYCLES = 3  # uncertainty between a count and its time of reception


def _start(harness: NodeHarness, **emulated: object) -> tuple[Process, Observer]:
    """Start emulator and bridge in real time; returns the bridge and an observer."""
    of_both = {"link": harness.link, "realtime_priority": _PRIORITY}
    harness.processes.start("rover_hil.emulator.emulator_node", {**of_both, **emulated})
    bridge = harness.processes.start(
        "rover_hil.bridge.bridge_node", {**of_both, "use_sim_time": True}
    )
    observer = harness.observer()
    for name in (topics.DIAGNOSTICS, topics.LINK_STATUS, topics.CLOCK):
        observer.listen(name)
    for node in ("drive_emulator", "hil_bridge"):
        observer.wait_until_ready(node)
    return bridge, observer


@cache
def _measured(folder: Path) -> tuple[Status, dict[str, Status], bool]:
    """Status of link and devices after enough loops, and whether the kernel permits priority."""
    with open_harness(folder) as harness:
        bridge, observer = _start(harness, rover_clock_offset=_CLOCK_OFFSET)
        reports = observer.listen(topics.LINK_STATUS)
        for _ in range(_ATTEMPTS):
            if observer.call(topics.DRIVES_ARM, True).success:
                break
            reports.wait(lambda _: True, len(reports))
        answering = {"use_sim_time": True, "realtime_priority": _PRIORITY}
        harness.processes.start("rover_verify.harness.answerer", answering)
        status = observer.wait_for_status(
            topics.LINK_STATUS,
            lambda s: int(s.values.get("round_trip_count", "0")) >= _LOOPS + _WARM_UP,
        )
        devices = {s.name.rpartition(" ")[2]: s for s in reports.last.statuses}
        has_priority = os.sched_getparam(bridge.pid).sched_priority == _PRIORITY
        return status, devices, has_priority


def round_trip(batch: CheckBatch) -> Measured:
    """99th percentile of the time from a state's sampling to the execution of its command [s]."""
    status, _, has_priority = _measured(batch.folder)
    names = (
        "round_trip_p50", "round_trip_max", "round_trip_count", "command_time_p99",
        "answer_time_p99", "cycles", "late_cycles", "incomplete_cycles", "overdue_round_trips",
        "frames_lost",
    )  # fmt: skip
    details: dict[str, float | str] = {name: float(status.values[name]) for name in names}
    scheduled = f"at real-time priority {_PRIORITY}" if has_priority else "at no priority: refused"
    return Measured(
        float(status.values["round_trip_p99"]), f"200 Hz on this computer, {scheduled}", details
    )


def clock_offset(batch: CheckBatch) -> Measured:
    """Error of the estimated clock offset of the rover, divided by its reported uncertainty."""
    _, devices, _ = _measured(batch.folder)
    rover, mother = devices["imu"].values, devices["winch"].values
    found = float(rover["clock_offset"]) - float(mother["clock_offset"])
    uncertainty = float(rover["clock_uncertainty"]) + float(mother["clock_uncertainty"])
    error = abs(found - _CLOCK_OFFSET)
    details: dict[str, float | str] = {"error [s]": error, "uncertainty [s]": uncertainty}
    return Measured(error / uncertainty, "rover against mother", details)


def uncounted_deadlines(batch: CheckBatch) -> Measured:
    """SYNCs of a repeatedly stopped bridge that were neither sent nor counted as late."""
    generator = random.Random(batch.seed)
    with open_harness(batch.folder) as harness:
        bridge, observer = _start(harness)
        reports = observer.listen(topics.LINK_STATUS)

        def counts() -> tuple[float, int, int]:
            """Time of a report [s], and its counts of cycles and late cycles."""
            found = reports.wait(lambda _: True, len(reports))
            at = time.monotonic()
            (status,) = [s for s in found.statuses if s.name == "hil_bridge: link"]
            return at, int(status.values["cycles"]), int(status.values["late_cycles"])

        began, first, first_late = counts()
        stopped, pause_event = 0.0, threading.Event()
        for _ in range(_STOPS):
            bridge.send(signal.SIGSTOP)
            pause = generator.uniform(*_STOPPED)
            pause_event.wait(pause)
            bridge.send(signal.SIGCONT)
            stopped += pause
            pause_event.wait(generator.uniform(*_RUNNING))
        ended, last, last_late = counts()
    due = (ended - began) / SYNC_PERIOD
    missed = due - (last - first)
    uncounted = missed - (last_late - first_late)
    return Measured(
        max(0.0, round(uncounted) - _READING_CYCLES),
        f"stopped {_STOPS} times for {stopped:.1f} s in all: of {due:.0f} cycles {missed:.0f} were "
        f"not started, {last_late - first_late} were counted as late; reading uncertainty "
        f"{_READING_CYCLES} cycles",
    )
