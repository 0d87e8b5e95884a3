"""Turning the hanging rover to a heading and holding it: batches on the spatial plant.

Each run has its own sensor errors, a swing of 1 to 1.5 deg that is watched for 200 s, by which the
gyro's bias is learnt, and a mass and friction that are off by up to 20 %. A turn that is refused is
asked for again 100 s later, as an operator would; for the third time it stays refused. The lengths
take turns, and so do the senses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from msg_schemas.events import DescentEvent
from msg_schemas.refusal import Refusal
from rover_control.pointing import Prediction
from rover_verify.checks import Batch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.hanging import draw
from rover_verify.checks.hanging_rig import HangingFlight

LENGTHS = (15.0, 30.0, 45.0)  # [m]
TURN = 0.5 * math.pi
TOLERANCE = math.radians(5.0)
HELD_FOR = 30.0  # [s]
TOO_SHORT = 5.0  # tether on which the twist is too strong [m]
_WATCHED = 200.0  # swing and bias, before a turn [s]
_ASKS = 3  # at most, where a turn is refused: the bias is known better later
_PATIENCE = 100.0  # until it is asked again [s]
_LONGEST = 1500.0  # [s]
_CAUSES = {"twist": "twist", "gyro bias": "bias"}  # predicted, and the word by which it is told


class Turn(NamedTuple):
    """How one turn went; NaN = it did not come to that."""

    length: float  # [m]
    refused: str
    turning: float  # until the true heading was within the tolerance, and stayed so [s]
    strayed: float  # largest true error within `HELD_FOR` from then on [rad]
    held: float  # from then on, until it was lost or let go [s]
    asked: Prediction | None  # predicted when it was asked
    told: Prediction | None  # predicted when it was reached
    ended: str  # what ended the holding, as it was told; empty: it was lost before it was let go
    asks: int = 1  # times that it was asked for


def turn(seed: int, index: int) -> Turn:
    """One turn by 90 deg."""
    length = LENGTHS[index % len(LENGTHS)]
    rng = np.random.default_rng([seed, index])
    major = float(rng.uniform(1.0, 1.5))
    flight = HangingFlight(draw(rng, length, major, float(rng.uniform(-0.4, 0.4)) * major))
    flight.begin()
    flight.run(_WATCHED)
    wanted = TURN if index % 2 == 0 else -TURN
    asked, asks = None, 0
    while asked is None:
        asks += 1
        try:
            asked = flight.rover.point(wanted, flight.now_ns)
        except Refusal as refusal:
            # What a longer look at the swing cannot mend is refused for good.
            if asks == _ASKS or "gyro bias" not in refusal.reason:
                nan = math.nan
                return Turn(length, refusal.reason, nan, nan, nan, None, None, "", asks)
            flight.run(_PATIENCE)
    began, last = flight.time, flight.true_swing().twist
    turned, arrived, strayed, told = 0.0, math.nan, math.nan, None
    while flight.time - began < _LONGEST and flight.rover.pointing.is_active:
        flight.tick()
        heading = flight.true_swing().twist
        turned += math.remainder(heading - last, math.tau)
        last = heading
        error = abs(wanted - turned)
        if error <= TOLERANCE:
            if math.isnan(arrived):
                arrived, strayed = flight.time, error
        elif flight.time - arrived > HELD_FOR:
            break
        else:  # coning wobbles: it is held from when on it stays
            arrived = math.nan
        if flight.time - arrived <= HELD_FOR:
            strayed = max(strayed, error)
    ended = ""
    for _, change in flight.changes:
        if change.name == DescentEvent.POINTING_REACHED:
            told = Prediction(**change.values)  # type: ignore[arg-type]
        if change.name in (DescentEvent.POINTING_LOST, DescentEvent.POINTING_RELEASED):
            ended = change.message
    held = flight.time - arrived
    return Turn(length, "", arrived - began, strayed, held, asked, told, ended, asks)


def refuse(seed: int, index: int) -> str:
    """Reason why a turn on a short tether is refused; empty if it is not."""
    rng = np.random.default_rng([seed, index])
    flight = HangingFlight(draw(rng, TOO_SHORT, float(rng.uniform(0.2, 1.0)), 0.1))
    flight.begin()
    flight.run(30.0)
    try:
        flight.rover.point(TURN if index % 2 == 0 else -TURN, flight.now_ns)
    except Refusal as refusal:
        return refusal.reason
    return ""


def _turns(batch: Batch) -> Sequence[Turn]:
    return fly_batch(batch, batch.runs, turn)


def turning_time(batch: Batch) -> Measured:
    """Longest time for a turn; NaN where one was not made."""
    times = [each.turning for each in _turns(batch)]
    refused = sum(bool(each.refused) for each in _turns(batch))
    again = sum(each.asks > 1 for each in _turns(batch))
    note = (
        f"{len(times)} turns, median {np.nanmedian(times):.0f} s, {refused} refused, {again} asked "
        f"for again after {_PATIENCE:g} s"
    )
    return Measured(float(np.max(times)), note)


def heading_error(batch: Batch) -> Measured:
    """Largest true error of a heading within the time that it must be held [deg]."""
    errors = np.degrees([each.strayed for each in _turns(batch)])
    shortest = float(np.min([each.held for each in _turns(batch)]))
    note = f"median {np.nanmedian(errors):.2f} deg; held for {shortest:.0f} s at least"
    # What was let go sooner was not held.
    return Measured(float(np.max(errors)) if shortest >= HELD_FOR else math.nan, note)


def prediction_error(batch: Batch) -> Measured:
    """By how much the holding is off what was predicted, on request or on arrival, relative."""
    flights = _turns(batch)
    off = [
        math.nan if each.told is None else abs(each.told.holding - each.held) / each.held
        for each in flights
    ]
    early = [
        math.nan if each.asked is None else abs(each.asked.holding - each.held) / each.held
        for each in flights
    ]
    limits = [each.told.limit for each in flights if each.told is not None]
    surprises = sum(
        each.told is not None and bool(each.ended) and _CAUSES[each.told.limit] not in each.ended
        for each in flights
    )
    details: dict[str, float | str] = {
        f"{length:g} m": ", ".join(
            f"{each.told.holding:.0f} s predicted, {each.held:.0f} s held"
            for each in flights
            if each.length == length and each.told is not None
        )
        for length in LENGTHS
    }
    note = (
        f"on request median {np.nanmedian(early):.0%}, worst {np.max(early):.0%}; on arrival "
        f"median {np.nanmedian(off):.0%}, worst {np.max(off):.0%}; limited by {_counted(limits)} "
        f"as predicted, let go for another reason {surprises} times"
    )
    return Measured(float(np.max([off, early])), note, details)


def unrefused_turns(batch: Batch) -> Measured:
    """Turns on a short tether that were not refused for its twist."""
    reasons = fly_batch(batch, batch.runs, refuse)
    wrong = sum("twist" not in reason for reason in reasons)
    return Measured(wrong, f"{len(reasons)} asked; {reasons[0] or 'not refused'}")


def _counted(words: Sequence[str]) -> str:
    return ", ".join(f"{word} {words.count(word)} times" for word in sorted(set(words)))
