"""Pointing of the hanging rover: batches of turns and holds on the spatial plant.

Each run has random sensor errors, errors of mass and friction of up to 20 %, and a swing of 1 to
1.5 deg over 200 s, from which the gyro bias is estimated. A refused turn is requested again 100 s
later, as an operator would; the third refusal is final. Lengths and senses alternate.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from msg_schemas.events import DescentEvent
from msg_schemas.faults import Reason
from msg_schemas.refusal import RefusalCode, RefusalReport
from rover_control.hanging.pointing import TurnPrediction
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.hanging import draw
from rover_verify.checks.hanging_flight import HangingFlight

LENGTHS = (15.0, 30.0, 45.0)  # [m]
TURN = 0.5 * math.pi
TOLERANCE = math.radians(5.0)
HELD_FOR = 30.0  # [s]
TOO_SHORT = 5.0  # tether length at which the twist is too strong [m]
_WATCHED = 200.0  # time before a turn, for the bias estimate [s]
_MAX_REQUESTS = 3  # after refusals; the bias estimate improves with time
_RETRY_TIME = 100.0  # before the next request [s]
_LONGEST = 1500.0  # [s]


class Turn(NamedTuple):
    """Result of one turn; NaN = not reached."""

    length: float  # [m]
    refused: str
    turning: float  # until the true heading stayed within the tolerance [s]
    strayed: float  # largest true error within `HELD_FOR` from then on [rad]
    held: float  # from then on, until it was lost or released [s]
    at_request: TurnPrediction | None  # prediction at the request
    at_arrival: TurnPrediction | None  # prediction on arrival
    ended: Reason | None  # reported cause of the release; None = lost before a release
    requests: int = 1  # number of requests


def turn(seed: int, index: int) -> Turn:
    """One turn by 90 deg."""
    length = LENGTHS[index % len(LENGTHS)]
    rng = np.random.default_rng([seed, index])
    major = float(rng.uniform(1.0, 1.5))
    flight = HangingFlight(draw(rng, length, major, float(rng.uniform(-0.4, 0.4)) * major))
    flight.begin()
    flight.run(_WATCHED)
    setpoint = TURN if index % 2 == 0 else -TURN
    requests = 1
    while (refusal := _request(flight, setpoint)) is not None:
        # More swing data would not help: the refusal is final.
        if requests == _MAX_REQUESTS or refusal.code is not RefusalCode.UNCERTAIN:
            nan = math.nan
            return Turn(length, refusal.reason, nan, nan, nan, None, None, None, requests)
        flight.run(_RETRY_TIME)
        requests += 1
    began, last = flight.time, flight.true_swing().twist
    turned, arrived, strayed = 0.0, math.nan, math.nan
    while flight.time - began < _LONGEST and flight.descent.controller.pointing.is_active:
        flight.host.tick()
        heading = flight.true_swing().twist
        turned += math.remainder(heading - last, math.tau)
        last = heading
        error = abs(setpoint - turned)
        if error <= TOLERANCE:
            if math.isnan(arrived):
                arrived, strayed = flight.time, error
        elif flight.time - arrived > HELD_FOR:
            break
        else:  # coning wobbles: the hold starts when the heading stays within the tolerance
            arrived = math.nan
        if flight.time - arrived <= HELD_FOR:
            strayed = max(strayed, error)
    held = flight.time - arrived
    flight.run(0.1)  # the event that ends it
    ends = [
        each
        for each in flight.events
        if each.name in (DescentEvent.POINTING_LOST, DescentEvent.POINTING_RELEASED)
    ]
    ended = Reason(ends[-1].values["reason"]) if ends else None
    at_request = _prediction(flight, DescentEvent.POINTING_STARTED)
    at_arrival = _prediction(flight, DescentEvent.POINTING_REACHED)
    return Turn(length, "", arrived - began, strayed, held, at_request, at_arrival, ended, requests)


def _request(flight: HangingFlight, angle: float) -> RefusalReport | None:
    """Request a turn by an angle [rad]; returns the refusal, if it is refused."""
    before = len(flight.refusals)
    flight.turn(angle)
    pointing = flight.descent.controller.pointing
    flight.run(1.0, lambda: pointing.is_active or len(flight.refusals) > before)
    return flight.refusals[-1][1] if len(flight.refusals) > before else None


def _prediction(flight: HangingFlight, name: DescentEvent) -> TurnPrediction | None:
    """Prediction of the last event of a name; None without one."""
    events = flight.events_named(name)
    if not events:
        return None
    values = events[-1].values
    holding, limit = float(values["holding"]), Reason(values["limit"])
    return TurnPrediction(float(values["turning"]), holding, limit)


def refuse(seed: int, index: int) -> str:
    """Reason why a turn on a short tether is refused; empty if it is not."""
    rng = np.random.default_rng([seed, index])
    flight = HangingFlight(draw(rng, TOO_SHORT, float(rng.uniform(0.2, 1.0)), 0.1))
    flight.run(30.0)
    refusal = _request(flight, TURN if index % 2 == 0 else -TURN)
    return "" if refusal is None else refusal.reason


def _turns(batch: CheckBatch) -> Sequence[Turn]:
    return fly_batch(batch, batch.runs, turn)


def turning_time(batch: CheckBatch) -> Measured:
    """Longest time for a turn; NaN where one was not made."""
    times = [each.turning for each in _turns(batch)]
    refused = sum(bool(each.refused) for each in _turns(batch))
    again = sum(each.requests > 1 for each in _turns(batch))
    note = (
        f"{len(times)} turns, median {np.nanmedian(times):.0f} s, {refused} refused, {again} "
        f"requested again after {_RETRY_TIME:g} s"
    )
    return Measured(float(np.max(times)), note)


def heading_error(batch: CheckBatch) -> Measured:
    """Largest true error of a heading within the time that it must be held [deg]."""
    errors = np.degrees([each.strayed for each in _turns(batch)])
    shortest = float(np.min([each.held for each in _turns(batch)]))
    note = f"median {np.nanmedian(errors):.2f} deg; held for {shortest:.0f} s at least"
    # An earlier release is no hold.
    return Measured(float(np.max(errors)) if shortest >= HELD_FOR else math.nan, note)


def prediction_error(batch: CheckBatch) -> Measured:
    """Relative error of the predicted hold, at the request or on arrival."""
    flights = _turns(batch)
    held = np.array([each.held for each in flights])
    early, off = (
        np.abs(np.array([math.nan if p is None else p.holding for p in predicted]) / held - 1.0)
        for predicted in ([f.at_request for f in flights], [f.at_arrival for f in flights])
    )
    arrived = [(each, each.at_arrival) for each in flights if each.at_arrival is not None]
    limits = Counter(prediction.limit for _, prediction in arrived)
    counts = ", ".join(f"{limit} {count} times" for limit, count in limits.items())
    surprises = sum(each.ended not in (None, prediction.limit) for each, prediction in arrived)
    note = (
        f"at the request median {np.nanmedian(early):.0%}, worst {np.max(early):.0%}; on arrival "
        f"median {np.nanmedian(off):.0%}, worst {np.max(off):.0%}; limited by {counts} "
        f"as predicted, released for another reason {surprises} times"
    )
    return Measured(float(np.max([off, early])), note, per_run(flights))


def unrefused_turns(batch: CheckBatch) -> Measured:
    """Turns on a short tether that were not refused for its twist."""
    reasons = fly_batch(batch, batch.runs, refuse)
    wrong = sum("twist" not in reason for reason in reasons)
    return Measured(wrong, f"{len(reasons)} requests; {reasons[0] or 'not refused'}")
