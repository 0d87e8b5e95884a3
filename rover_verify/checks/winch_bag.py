"""Descent by simulator, winch and recorder as processes in lockstep.

Requests use the contract's topics; the results come from the bag alone.
"""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import WinchEvent
from msg_schemas.machine import WINCH_TO_LENGTH
from rover_bags.reading.read import Bag
from rover_launch.plan import LOCKSTEP, TRUE
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.winch_flights import SCENARIO
from rover_verify.checks.winch_record import WinchRecord, record_of_bag
from rover_verify.harness import Observer, open_harness
from rover_verify.harness.flight import WINCH
from rover_verify.harness.launching import Launched, arm_winch
from rover_verify.harness.recording import STREAMS

TOP, BOTTOM, RATE = 2.2, 47.2, 0.3  # reeled in; 45 m below; [m], [m/s]
_REST_NS = 5_000_000_000  # simulated time after each leg
_PATIENCE = 1200.0  # wall time of a leg of 160 s [s]
_RECORDED = (topics.WINCH_ESTIMATE, topics.WINCH_COMMAND, topics.WINCH_MODE)
_ENDS = (WinchEvent.HOLD, WinchEvent.FAULT, WinchEvent.STOP)


class Recorded(NamedTuple):
    """A recorded descent.

    Attributes:
        record: of the winch.
        bag: the bag itself.
    """

    record: WinchRecord
    bag: Bag

    def __str__(self) -> str:
        """Description of the recording."""
        lost = sum(self.bag.dropped.values()) + sum(self.bag.lost_in_transport.values())
        return (
            f"three processes in lockstep, {TOP:g} to {BOTTOM:g} m and back at {RATE:g} m/s in "
            f"{self.record['time'][-1]:.0f} s, from a bag of {sum(self.bag.counts.values())} "
            f"messages, {lost} lost"
        )


def recorded_descent(folder: Path, seed: int) -> Recorded:
    """Fly down and up in one recorded run.

    Args:
        folder: for the bag.
        seed: of the sensors' errors.

    Raises:
        RuntimeError: a leg does not end at its length.
    """
    place = folder / f"descent_{seed}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    overrides = json.dumps({"tether.length": TOP, "sensors.error_model": "full"})
    given = {"scenario": SCENARIO, "overrides": overrides, "seed": str(seed)}
    given |= {LOCKSTEP: TRUE, "real_time_factor": "0"}
    with open_harness(place) as harness:
        launched = Launched(harness, WINCH, given, bag=place / "bag", defaults={})
        for name in (topics.CLOCK, topics.WINCH_MODE):
            launched.observer.listen(name)
        launched.wait_until_ready(*_RECORDED, *STREAMS)
        arm_winch(launched.observer)
        for length in (BOTTOM, TOP):
            _go(launched.observer, length)
        return Recorded(*record_of_bag(launched.end_recording()))


def _go(observer: Observer, length: float) -> None:
    """Send the winch to a length, and wait until it has come to rest there."""
    events = observer.listen(topics.EVENTS)
    since = len(events)
    observer.send_joint(topics.WINCH_REQUEST, WINCH_TO_LENGTH, length, RATE)
    end = events.wait(lambda s: any(each.name in _ENDS for each in s.statuses), since, _PATIENCE)
    if not any(each.name == WinchEvent.HOLD for each in end.statuses):
        raise RuntimeError(f"sent to {length:g} m it ended by {end}")
    observer.wait_for_time(observer.time_ns() + _REST_NS)


@cache
def _descent(folder: Path, seed: int) -> Recorded:
    recorded = recorded_descent(folder, seed)
    shutil.rmtree(recorded.bag.path)  # 70 MB; `winch report --nodes` keeps it, with plots
    return recorded


def _measured(batch: CheckBatch, value: float, **details: float) -> Measured:
    return Measured(value, str(_descent(batch.folder.parent, batch.seed)), details)


def _record(batch: CheckBatch) -> WinchRecord:
    return _descent(batch.folder.parent, batch.seed).record


def length_error(batch: CheckBatch) -> Measured:
    """Largest distance [m] of the drum's length from its reference, and from a free S-curve."""
    error, curve = _record(batch).length_error(), _record(batch).distance_from_curve()
    return _measured(batch, max(error, curve), reference=error, free_curve=curve)


def overshoot(batch: CheckBatch) -> Measured:
    """How far the drum goes beyond the lengths that were requested [m]."""
    return _measured(batch, _record(batch).overshoot())


def ripple(batch: CheckBatch) -> Measured:
    """Tension ripple in steady payout by the load cell, RMS over the mean; the worse direction."""
    ripples = _record(batch).ripple()
    return _measured(batch, max(ripples.values()), **ripples)
