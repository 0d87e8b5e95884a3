"""Endurance: missions one after another for hours of simulated time, by the launched processes.

Recorder and operators' page run beside them. A thread of its own samples memory, file handles, log
and bag. After the first mission the clock is paused for a twelfth of the time, the recorder is
killed, another one finds the disk full, and during the second mission 50 pages are open. Growth is
that of the last three fifths of the time.
"""

from __future__ import annotations

import asyncio
import math
import shutil
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from tornado import websocket

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from rover_bags.recording.record import DISK_FAILED
from rover_launch.loop import Parameters
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.flights import fly_kept
from rover_verify.demo.mission_show import PLAN, arguments
from rover_verify.harness import NodeHarness, open_harness
from rover_verify.harness.flight import MISSION
from rover_verify.harness.launching import RECORDER, Launched

_PAGE = "operator_console"
_PAGES = 50
_RECEIVED = 200  # messages that each page receives
_SAMPLES = 60  # over the whole time
_SHORTEST_PERIOD = 5.0  # between two samples, wall time [s]
_PATIENCE = 3600.0  # wall time without progress [s]
_LEFT = 10  # space that is left to the recorder that finds the disk full [MiB]
_FULL_TIMEOUT = 600.0  # until then it is full, wall time [s]
_ENDS = (MissionEvent.COMPLETED, MissionEvent.BLOCKED, MissionEvent.INTERRUPTED)
_SETTLED = 0.4  # share of the time after which growth is measured
_HOUR = 3600.0  # [s]
_MIB = 2.0**20


class UsageSample(NamedTuple):
    """What the processes use at one time."""

    time: float  # simulated [s]
    memory: dict[str, float]  # resident, by process [MiB]
    handles: dict[str, int]  # open file handles, by process
    log: float  # text of all processes so far [MiB]
    bag: float  # [MiB]


@dataclass
class Endured:
    """What became of the missions.

    Attributes:
        samples: in the order of time.
        missions: number of missions that ended at the stow.
        complaints: what went wrong; empty = nothing.
    """

    samples: list[UsageSample] = field(default_factory=list)
    missions: int = 0
    complaints: list[str] = field(default_factory=list)

    @property
    def settled(self) -> list[UsageSample]:
        """The samples after the faults."""
        first, last = self.samples[0].time, self.samples[-1].time
        return [each for each in self.samples if each.time >= first + _SETTLED * (last - first)]

    def growth(self, value_of: Callable[[UsageSample], float]) -> float:
        """Slope of a value over the time after the faults [1/h], by least squares."""
        times, values = zip(*((s.time / _HOUR, value_of(s)) for s in self.settled), strict=True)
        return float(np.polynomial.polynomial.polyfit(times, values, 1)[1])

    def largest(self, value_of: Callable[[UsageSample], dict[str, Any]]) -> tuple[str, float]:
        """Process of the fastest growth, and its slope [1/h]."""
        slopes = {
            name: self.growth(lambda sample, name=name: float(value_of(sample)[name]))  # type: ignore[misc]
            for name in value_of(self.samples[-1])
            if all(name in value_of(sample) for sample in self.settled)
        }
        name = max(slopes, key=lambda each: slopes[each])
        return name, slopes[name]


class _Endurance:
    """The processes, and what is done to them."""

    def __init__(self, harness: NodeHarness, folder: Path, seed: int, hours: float) -> None:
        self.found = Endured()
        self._harness, self._folder = harness, folder
        self._duration = hours * _HOUR
        settings: Parameters = {
            "mission_node": {"plan": PLAN, "checkpoint": "none"},
            _PAGE: {"port": 0},
        }
        launched = Launched(harness, MISSION, arguments(seed), settings)
        self._processes, self._observer = launched.processes, launched.observer
        self._observer.listen(topics.MISSION_STATE)
        launched.wait_until_ready()
        page = self._processes[_PAGE].wait_for_output(r"the page is at http://(\S+?)/?\s")
        self._page = f"ws://{page.group(1)}/live"

    @property
    def _time(self) -> float:
        """Simulated time [s]."""
        last = self._observer.listen(topics.MISSION_STATE).last
        return 0.0 if last is None else float(last.stamp_ns) * 1e-9

    def run(self) -> Endured:
        """Fly missions until the time is over."""
        stopped = threading.Event()
        thread = threading.Thread(target=self._sample_until, args=(stopped,))
        thread.start()
        try:
            self._fly()
            self._pause()
            self._kill_recorder()
            self._open_pages()
            while self._time < self._duration:
                self._fly()
        finally:
            stopped.set()
            thread.join()
        for name, process in self._processes.items():
            if not process.is_running:
                self.found.complaints.append(f"{name} has ended")
        return self.found

    def _fly(self) -> None:
        events = self._observer.listen(topics.EVENTS)
        since = len(events)
        answer = self._observer.call(topics.MISSION_GO)
        if not answer.success:
            raise AssertionError(f"the mission does not start: {answer.message}")
        last = events.wait(
            lambda sample: any(status.name in _ENDS for status in sample.statuses), since, _PATIENCE
        )
        ends = [status for status in last.statuses if status.name in _ENDS]
        if ends[0].name == MissionEvent.COMPLETED:
            self.found.missions += 1
        else:
            self.found.complaints.append(f"a mission at {self._time:.0f} s: {ends[0].message}")

    # --- faults ----------------------------------------------------------------------------------

    def _open_pages(self) -> None:
        """Open 50 pages during a mission, and close each when it has received enough."""
        received = [0] * _PAGES

        async def show(index: int) -> None:
            page = await websocket.websocket_connect(self._page)
            for _ in range(_RECEIVED):
                if await page.read_message() is None:
                    return
                received[index] += 1
            page.close()

        async def show_all() -> None:
            await asyncio.wait_for(asyncio.gather(*map(show, range(_PAGES))), _PATIENCE)

        thread = threading.Thread(target=lambda: asyncio.run(show_all()))
        thread.start()
        self._fly()
        thread.join(_PATIENCE)
        silent = sum(count < _RECEIVED for count in received)
        if silent:
            self.found.complaints.append(f"{silent} of {_PAGES} pages received too little")

    def _pause(self) -> None:
        """Pause the clock for a twelfth of the time."""
        answers = [self._observer.call(topics.SIM_PAUSE, True)]
        before = self._time
        threading.Event().wait(self._duration / 12.0)
        if self._time > before + 1.0:
            self.found.complaints.append("simulated time went on while it was paused")
        answers.append(self._observer.call(topics.SIM_PAUSE, False))
        self.found.complaints += [each.message for each in answers if not each.success]

    def _kill_recorder(self) -> None:
        """Kill the recorder; of the next one the disk fills up, the one after it records."""
        self._processes[RECORDER].send(signal.SIGKILL)
        self._processes[RECORDER].wait()
        module = "rover_bags.recording.record"
        free = int(shutil.disk_usage(self._folder).free / _MIB)
        full = self._harness.processes.start(
            module, {"min_free_mib": free - _LEFT}, "--output", str(self._folder / "full")
        )
        code = full.wait(_FULL_TIMEOUT)
        if code != DISK_FAILED:
            self.found.complaints.append(f"a recorder on a full disk ended with code {code}")
        self._processes[RECORDER] = self._harness.processes.start(
            module, None, "--output", str(self._folder / "bag2")
        )
        self._observer.wait_until_ready(RECORDER)

    # --- samples ---------------------------------------------------------------------------------

    def _sample_until(self, stopped: threading.Event) -> None:
        due = 0.0
        while not stopped.wait(_SHORTEST_PERIOD):
            if self._time >= due:
                due = self._time + self._duration / _SAMPLES
                self.found.samples.append(self._sample())

    def _sample(self) -> UsageSample:
        running = {name: each for name, each in self._processes.items() if each.is_running}
        return UsageSample(
            self._time,
            {name: _resident(each.pid) for name, each in running.items()},
            {name: _handles(each.pid) for name, each in running.items()},
            sum(len(each.output) for each in running.values()) / _MIB,
            sum(file.stat().st_size for file in self._folder.glob("bag*/*")) / _MIB,
        )


def _resident(pid: int) -> float:
    text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return float((text.partition("VmRSS:")[2].split() or ["nan"])[0]) / 1024.0


def _handles(pid: int) -> int:
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


def _of(batch: CheckBatch) -> Endured:
    def endure(seed: int, _index: int, hours: float) -> Endured:
        with open_harness(batch.folder) as harness:
            return _Endurance(harness, batch.folder, seed, hours).run()

    return fly_kept(batch.kept, endure, batch.seed, 0, batch.hours)


def growth(batch: CheckBatch, quantity: Literal["memory", "handles", "log", "bag"]) -> Measured:
    """Growth of log or bag [MiB/h], or fastest growth of a process's memory [MiB/h] or handles."""
    found = _of(batch)
    note = f"{found.missions} missions"
    if quantity in ("log", "bag"):
        return Measured(found.growth(attrgetter(quantity)), note)
    value_of = attrgetter(quantity)
    name, slope = found.largest(value_of)
    samples = found.samples
    details = {
        f"{process} at {each.time:.0f} s": float(value_of(each).get(process, math.nan))
        for process in value_of(samples[-1])
        for each in (samples[0], samples[len(samples) // 3], samples[-1])
    }
    return Measured(slope, f"{name}; {note}", details)


def complaints(batch: CheckBatch) -> Measured:
    """What went wrong while missions flew and faults were injected (number of cases)."""
    found = _of(batch)
    return Measured(
        len(found.complaints), "; ".join(found.complaints) or f"{found.missions} missions"
    )
