"""Death of the winch node in motion: what drive and drum then do, on the loop host."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import SimulationEvent
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT, WINCH_TO_LENGTH
from msg_schemas.samples import JointSample, Sample, WrenchSample
from rover_sim import load_spatial
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.winch_flights import SCENARIO, WEIGHT, fly_winch, request

_LENGTHS = (5.0, 15.0, 45.0)  # at which it is killed [m]
_RATE = 0.3  # [m/s]
_RUN_UP = 1.5  # distance over which the rate is reached [m]
_DISTANCE = 8.0  # of the request beyond that [m]
_LONGEST = 60.0  # of the run-up, and until the drum stands [s]
_AFTER = 3.0  # time watched after it stands [s]
_NANO = 1_000_000_000


class Killed(NamedTuple):
    """How the drum stopped after the node's death.

    Attributes:
        length: at the death [m].
        time: from the death to a standing drum [s].
        distance: from the death to where it stands [m].
        peak_tension: largest tension from the death on, over the hanging load.
        timeout: from the last command that the drive received to its quick stop [s].
        braked_after: from that command to the closed brake [s].
        braked_at: rate of the drum in the last sample with the brake open [m/s].
    """

    length: float
    time: float
    distance: float
    peak_tension: float
    timeout: float
    braked_after: float
    braked_at: float


@cache
def _killed(length: float, seed: int) -> Killed:
    """Pay out, kill the node, watch the drum."""
    overrides = {"tether.length": length - _RUN_UP, "sensors.error_model": "full"}
    flight = fly_winch(overrides, seed)
    states: list[JointSample] = []
    loads: list[WrenchSample] = []
    commands: list[int] = []  # stamps [ns]

    def listen(_topic: str, sample: Sample, _sender: str, now_ns: int) -> None:
        if isinstance(sample, WrenchSample):
            loads.append(sample)
        elif isinstance(sample, JointSample) and WINCH_LIMIT in sample.joints:
            commands.append(now_ns)
        elif isinstance(sample, JointSample):
            states.append(sample)

    flight.host.listen(listen, topics.WINCH_STATE, topics.LOAD_CELL, topics.WINCH_COMMAND)
    request(flight, WINCH_TO_LENGTH, length + _DISTANCE, _RATE)
    if not flight.run(_LONGEST, lambda: _is_paying_out(states[-1], length)):
        raise RuntimeError(f"the drum does not pay out at {length:g} m")
    flight.kill("winch_node")
    death = commands[-1]  # later samples are the drive's own reaction
    flight.run(_LONGEST, lambda: states[-1].joints[WINCH_DRUM].velocity == 0.0)
    stood = states[-1]
    flight.run(_AFTER)
    (stop,) = flight.events_named(SimulationEvent.COMMAND_TIMEOUT)
    timeout = float(stop.values["age"])
    # It closes right after the last sample in which it was open.
    opened = [s for s in states if s.joints[WINCH_BRAKE].position == 1.0][-1]
    begun = next(s for s in states if s.stamp_ns >= death)
    last = states[-1].joints[WINCH_DRUM].position
    peak = max(math.hypot(*s.force) for s in loads if s.stamp_ns >= death)
    return Killed(
        begun.joints[WINCH_DRUM].position,
        (stood.stamp_ns - death) / _NANO,
        last - begun.joints[WINCH_DRUM].position,
        peak / hanging_load(last),
        timeout,
        timeout + opened.stamp_ns / _NANO - stop.time,
        abs(opened.joints[WINCH_DRUM].velocity),
    )


def _is_paying_out(state: JointSample, length: float) -> bool:
    position, velocity, _ = state.joints[WINCH_DRUM]
    return position >= length and velocity > 0.98 * _RATE


def hanging_load(length: float) -> float:
    """Tension at the fairlead of the rover at rest on so much tether [m], in newtons."""
    scenario = load_spatial(SCENARIO)
    return WEIGHT + scenario.tether.section.line_density * scenario.gravity * length


def worst(batch: CheckBatch, metric: str) -> Measured:
    """Largest value of a field of `Killed`, such as ``distance``."""
    killed = []
    for index, length in enumerate(_LENGTHS):
        killed.append(_killed(length, batch.seed))
        batch.progress(index + 1, len(_LENGTHS))
    value = max(float(getattr(each, metric)) for each in killed)
    note = "worst of 5, 15 and 45 m, counted from the last command"
    return Measured(value, note, per_run(killed))
