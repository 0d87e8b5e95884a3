"""Delay margin of the hanging rover's loops: trim of the winch, attitude, and a descent to a stop.

Each loop is flown at each length with the default delays of the messages, and with longer ones. Its
figure grows as the loop gets worse; the margin is the longest hop with which it stays within the
limit of the row.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from msg_schemas import machine
from rover_control.hanging.hanging_rover import HangingParameters
from rover_runtime.delays import Delays
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.hanging_flight import HangingFlight, HangingStart, tilt_of

LENGTHS = (2.0, 7.5, 45.0)  # [m]
REQUIRED = 5  # ticks a hop takes in the mean
_SPREAD = 2  # of a hop, each way [ticks]
_LONGER = (7, 9)  # further hops, until the margin is found
_LIMIT = 1.5  # of a figure, over the one with the default delays
_SETTLED = 9.0  # time until the swing estimate has settled [s]
_HALF_PERIODS = {2.0: 6, 7.5: 4, 45.0: 3}  # of the swing, in which the trim is watched
_SPIN = math.radians(2.3)  # of a disturbance about x and y [rad/s]
_WATCHED = 10.0  # time of the attitude after it [s]
_MOVED = 0.3  # travel to a stop [m]
_LONGEST = 120.0  # of a stop [s]


def trim_time(length: float, delays: Delays | None) -> float:
    """Time constant [s] with which the winch damps a plane swing of 2 deg."""
    flight = HangingFlight(HangingStart(length, 2.0, 0.1, 30.0, 50.0, seed=3), delays=delays)
    flight.begin()
    flight.stop_at(length)
    flight.run(_SETTLED + 3.0)
    duration = _HALF_PERIODS[length] * math.pi / HangingParameters().swing_frequency(length)
    before = flight.true_swing().major
    flight.run(duration)
    decay = math.log(before / flight.true_swing().major)
    return duration / decay if decay > 0.0 else math.inf


def attitude_error(length: float, delays: Delays | None) -> float:
    """RMS tilt [deg] after a disturbance, of the worse axis."""
    flight = HangingFlight(HangingStart(length, 0.1, 0.02, 30.0, 50.0, seed=3), delays=delays)
    flight.begin()
    flight.stop_at(length, observes=False)
    flight.run(5.0)
    flight.spin((_SPIN, _SPIN, 0.0))
    tilts = []
    for _ in range(round(_WATCHED / 0.05)):
        flight.run(0.05)
        tilts.append(tilt_of(flight.state))
    return float(np.degrees(np.sqrt(np.mean(np.square(tilts), axis=0))).max())


def stop_time(length: float, delays: Delays | None) -> float:
    """Time [s] of a travel to a stop and its pictures; infinite with a smeared one or none."""
    flight = HangingFlight(HangingStart(length, 0.15, 0.02, 30.0, 50.0, seed=3), delays=delays)
    flight.begin()
    began = flight.time
    flight.stop_at(length + _MOVED)
    flight.run_until_idle(_LONGEST)
    smears = [picture.smear for picture in flight.pictures]
    return flight.time - began if smears and max(smears) <= machine.SHARP_SMEAR else math.inf


LOOPS: Mapping[str, tuple[Callable[[float, Delays | None], float], str]] = {
    "trim": (trim_time, "s"),
    "attitude": (attitude_error, "deg"),
    "descent": (stop_time, "s"),
}
"""Figure of each loop, and its unit."""
_CASES = list(itertools.product(LOOPS, LENGTHS))


class Margin(NamedTuple):
    """Figures of a loop at a length."""

    default: float  # with the default delays
    late: float  # with the required ones
    hop: int  # longest mean hop within the limit [ticks]; 0 = less than required


def find_margin(seed: int, index: int) -> Margin:
    """Find the delay margin of a loop at a length."""
    loop, length = _CASES[index]
    figure, _ = LOOPS[loop]
    default, reached, late = figure(length, None), 0, math.nan
    for hop in (REQUIRED, *_LONGER):
        ticks = tuple(range(hop - _SPREAD, hop + _SPREAD + 1))
        found = figure(length, Delays(seed, ticks))
        late = found if hop == REQUIRED else late
        if not found <= _LIMIT * default:
            break
        reached = hop
    return Margin(default, late, reached)


def delay_margin(batch: CheckBatch) -> Measured:
    """Largest figure with the required delays, over the one with the default delays."""
    found = fly_batch(batch, len(_CASES), find_margin)
    details: dict[str, float | str] = {
        f"{loop} at {length:g} m": (
            f"{each.default:.3g} {LOOPS[loop][1]}, {each.late:.3g} {LOOPS[loop][1]} with hops of "
            f"{REQUIRED} +- {_SPREAD} ticks; within {_LIMIT:g} times up to {each.hop} ticks"
        )
        for (loop, length), each in zip(_CASES, found, strict=True)
    }
    worst = max(each.late / each.default for each in found)
    shortest = min(each.hop for each in found)
    note = f"every loop within the limit up to hops of {shortest} ticks, of {_LONGER[-1]} at most"
    return Measured(worst, note, details)
