"""Descent by simulator, winch and recorder as processes, over DDS.

Requests use the contract's topics; the results come from the bag alone.
"""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import SimulationEvent, WinchEvent
from msg_schemas.faults import WinchFault
from msg_schemas.machine import WINCH_TO_LENGTH
from msg_schemas.samples import JointSample, JointValue, Status, StatusSample
from rover_bags.reading.read import Bag
from rover_verify.checks import Batch, Measured
from rover_verify.checks.winch_nodes import arm, start_winch_and_sim
from rover_verify.checks.winch_record import WinchRecord, record_of_bag
from rover_verify.harness import NodeHarness, Observer, Process, open_harness
from rover_verify.harness.lockstep import Lockstep
from rover_verify.harness.recording import recorded_topics, wait_until_recording

TOP, BOTTOM, RATE = 2.2, 47.2, 0.3  # reeled in; 45 m below; [m], [m/s]
_RECORD = "rover_bags.recording.record"
_REST = 5.0  # simulated time after each leg [s]
_PATIENCE = 1200.0  # wall clock, for one leg of 160 s [s]
_ATTEMPTS = 2  # in real time; then in lockstep
_LONGEST = 300.0  # of the way there, in simulated time [s]
_NANO = 1_000_000_000
_OF_WINCH = {topics.WINCH_ESTIMATE, topics.WINCH_COMMAND, topics.WINCH_MODE}


class Stalled(RuntimeError):
    """The computer was too slow, so that the drive or the winch braked."""


class Recorded(NamedTuple):
    """A recorded descent.

    Attributes:
        record: of the winch.
        bag: the bag itself.
        in_real_time: a machine too busy for that flies in lockstep: its drive brakes at each stall.
    """

    record: WinchRecord
    bag: Bag
    in_real_time: bool

    def __str__(self) -> str:
        """Description of the recording."""
        lost = sum(self.bag.dropped.values()) + sum(self.bag.lost_in_transport.values())
        how = "in real time" if self.in_real_time else "in lockstep"
        return (
            f"three processes over DDS, {TOP:g} to {BOTTOM:g} m and back at {RATE:g} m/s in "
            f"{self.record['time'][-1]:.0f} s {how}, from a bag of "
            f"{sum(self.bag.counts.values())} messages, {lost} lost"
        )


def fly(folder: Path, seed: int, *, in_real_time: bool = True) -> Path:
    """Fly down and up in one recorded run; returns the bag.

    Args:
        folder: for the bag.
        seed: of the sensors' errors.
        in_real_time: otherwise a tick is made when the winch has answered the last one.

    Raises:
        Stalled: the drive or the winch braked because the machine stood still.
    """
    with open_harness(folder) as harness:
        observer, recorder, bag = _begin(harness, folder, seed)
        arm(observer)
        lockstep = None if in_real_time else Lockstep(observer, topics.WINCH_COMMAND)
        for length in (BOTTOM, TOP):
            _go(observer, length, lockstep)
        if recorder.stop() != 0:
            raise RuntimeError(f"the recorder failed:\n{recorder.output}")
    return bag


def _begin(harness: NodeHarness, folder: Path, seed: int) -> tuple[Observer, Process, Path]:
    bag = folder / "bag"
    recorder = harness.processes.start(_RECORD, {"output": str(bag)})
    listened = (topics.WINCH_MODE, topics.WINCH_COMMAND)
    _, observer = start_winch_and_sim(harness, listened, TOP, seed)
    wait_until_recording(bag)
    observer.wait_until(
        lambda: recorded_topics(bag) >= _OF_WINCH, "the recorder does not receive the winch"
    )
    return observer, recorder, bag


def _go(observer: Observer, length: float, lockstep: Lockstep | None) -> None:
    """Send the winch to a length, and wait until it has come to rest there."""
    events = observer.listen(topics.EVENTS)
    listened = len(events)
    value = JointValue(length, RATE, 0.0)
    request = JointSample(observer.time_ns(), {WINCH_TO_LENGTH: value})
    observer.send(topics.WINCH_REQUEST, request)

    def reported() -> list[Status]:
        statuses = [s for sample in events.samples[listened:] for s in sample.statuses]
        return [s for s in statuses if s.name.startswith("winch_")]

    def ends(_: StatusSample | None = None) -> bool:
        return any(s.name != WinchEvent.LENGTH for s in reported())

    if lockstep is None:
        events.wait(ends, listened, _PATIENCE)
    else:
        lockstep.run_until(ends, _LONGEST)
    last = reported()[-1]
    if _is_stall(last):
        raise Stalled(last.message)
    if last.name != WinchEvent.HOLD:
        raise RuntimeError(f"sent to {length:g} m it ended by {last}")
    rested = observer.time_ns() + round(_REST * _NANO)
    if lockstep is None:
        observer.wait_for_time(rested)
    else:
        lockstep.run_until(lambda: observer.time_ns() >= rested, 2.0 * _REST)


def _is_stall(status: Status) -> bool:
    late = status.values.get("fault") in {
        WinchFault.NODE_LATE,
        WinchFault.DRUM_LOST,
        WinchFault.TENSION_LOST,
    }
    return status.name == SimulationEvent.COMMAND_TIMEOUT or late


def recorded_descent(folder: Path, seed: int) -> Recorded:
    """Fly, and read the bag; once more where the machine stalled."""
    for attempt in range(_ATTEMPTS + 1):
        in_real_time = attempt < _ATTEMPTS
        place = folder / f"descent_{seed}_{attempt}"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        try:
            record, bag = record_of_bag(fly(place, seed, in_real_time=in_real_time))
        except Stalled:
            if in_real_time:
                continue
            raise
        return Recorded(record, bag, in_real_time)
    raise AssertionError


def _measured(value: float, recorded: Recorded, **details: float) -> Measured:
    return Measured(value, str(recorded), details)


@cache
def _descent(folder: Path, seed: int) -> Recorded:
    recorded = recorded_descent(folder, seed)
    shutil.rmtree(recorded.bag.path)  # 70 MB; `winch report --nodes` keeps it, with plots
    return recorded


def _recorded(batch: Batch) -> Recorded:
    return _descent(batch.folder.parent, batch.seed)


def length_error(batch: Batch) -> Measured:
    """Largest distance [m] of the drum's length from its reference, and from a free S-curve."""
    recorded = _recorded(batch)
    error, curve = recorded.record.length_error(), recorded.record.distance_from_curve()
    return _measured(max(error, curve), recorded, reference=error, free_curve=curve)


def overshoot(batch: Batch) -> Measured:
    """How far the drum goes beyond the lengths that were requested [m]."""
    recorded = _recorded(batch)
    return _measured(recorded.record.overshoot(), recorded)


def ripple(batch: Batch) -> Measured:
    """Tension ripple in steady payout by the load cell, RMS over the mean; the worse direction."""
    recorded = _recorded(batch)
    ripples = recorded.record.ripple()
    return _measured(max(ripples.values()), recorded, **ripples)
