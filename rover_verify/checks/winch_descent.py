"""Descent of the winch to 45 m and back, on the loop host and by processes in lockstep.

The processes are requested over the contract's topics; their results come from the bag alone.
"""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from typing import Literal

from msg_schemas import machine, topics
from msg_schemas.events import WinchEvent
from rover_launch.plan import LOCKSTEP, TRUE
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.winch_flights import SCENARIO, fly_winch, is_at_rest, request
from rover_verify.checks.winch_record import WinchRecord, WinchRecorder, record_of_bag
from rover_verify.harness import Observer, open_harness
from rover_verify.harness.flight import WINCH
from rover_verify.harness.launching import STREAMS, Launched, arm_winch

TOP, BOTTOM, RATE = 2.2, 47.2, 0.3  # reeled in; 45 m below; [m], [m/s]
Quantity = Literal["length_error", "overshoot", "ripple"]
_REST_NS = 5_000_000_000  # simulated time after each leg
_PATIENCE = 1200.0  # wall time of a leg of 160 s [s]
_RECORDED = (topics.WINCH_ESTIMATE, topics.WINCH_COMMAND, topics.WINCH_MODE)
_ENDS = (WinchEvent.HOLD, WinchEvent.FAULT, WinchEvent.STOP)


@cache
def _flown(seed: int) -> WinchRecord:
    """Fly down and up on the loop host."""
    flight = fly_winch({"tether.length": TOP}, seed)
    recorder = WinchRecorder(flight)
    for goal, rest in ((BOTTOM, 5.0), (TOP, 2.0)):
        request(flight, machine.WINCH_TO_LENGTH, goal, RATE)
        flight.run(200.0, lambda: is_at_rest(flight))
        flight.run(rest)
    return recorder.record()


def descent(batch: CheckBatch, quantity: Quantity) -> Measured:
    """Largest length error [m], overshoot [m] or relative ripple, against the truth."""
    record = _flown(batch.seed)
    found = getattr(record, quantity)()
    if quantity != "ripple":
        return Measured(found, f"{TOP:g} to {BOTTOM:g} m and back at {RATE:g} m/s")
    return Measured.largest(found, "the worse direction")


@cache
def _recorded(folder: Path, seed: int) -> tuple[WinchRecord, str]:
    """Fly down and up in one recorded run; returns the record, and what it was.

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
        record, bag = record_of_bag(launched.end_recording())
    shutil.rmtree(bag.path)  # 70 MB
    lost = sum(bag.dropped.values()) + sum(bag.lost_in_transport.values())
    note = (
        f"three processes in lockstep, {TOP:g} to {BOTTOM:g} m and back at {RATE:g} m/s in "
        f"{record['time'][-1]:.0f} s, from a bag of {sum(bag.counts.values())} messages, "
        f"{lost} lost"
    )
    return record, note


def _go(observer: Observer, length: float) -> None:
    """Send the winch to a length, and wait until it has come to rest there."""
    events = observer.listen(topics.EVENTS)
    since = len(events)
    observer.send_joint(topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, length, RATE)
    end = events.wait(lambda s: any(each.name in _ENDS for each in s.statuses), since, _PATIENCE)
    if not any(each.name == WinchEvent.HOLD for each in end.statuses):
        raise RuntimeError(f"sent to {length:g} m it ended by {end}")
    observer.wait_for_time(observer.time_ns() + _REST_NS)


def recorded_descent(batch: CheckBatch, quantity: Quantity) -> Measured:
    """The same by encoder and load cell of a bag; the length also against a free S-curve [m]."""
    record, note = _recorded(batch.folder.parent, batch.seed)
    if quantity == "ripple":
        return Measured.largest(record.ripple(), note)
    found: dict[str, float] = {quantity: float(getattr(record, quantity)())}
    if quantity == "length_error":
        found["distance from the free curve"] = record.distance_from_curve()
    return Measured.largest(found, note)
