"""Missing commands of the winch in motion: death of its node, and gaps, on the loop host."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.events import SimulationEvent, WinchEvent
from msg_schemas.phases import WinchMode
from msg_schemas.samples import JointSample, Sample, WrenchSample
from rover_sim import load_spatial
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.winch_flights import SCENARIO, WEIGHT, fly_winch, request
from rover_verify.checks.winch_record import TICK

_LENGTHS = (5.0, 15.0, 45.0)  # at which it is killed [m]
_RATE = 0.3  # [m/s]
_RUN_UP = 1.5  # distance over which the rate is reached [m]
_DISTANCE = 8.0  # of the request beyond that [m]
_LONGEST = 60.0  # of the run-up, and until the brake closes [s]
_AFTER = 3.0  # time watched after the brake has closed [s]
_STANDSTILL = 0.02  # rate up to which the drum stands, above the noise of its encoder [m/s]
_NANO = 1_000_000_000
_GAPS_FROM, _GAPS_OVER = 10.0, 30.0  # payout with gaps: its start, its distance [m]
_GAPS_AFTER = 3.0  # time before the first gap [s]
_GAPS = (5, 25)  # ticks between two commands
_PAUSE = (0.05, 0.5)  # with commands, between two gaps [s]
_MOST_GAPS = 50  # in one payout


class Killed(NamedTuple):
    """How the drum stopped after the node's death.

    Attributes:
        length: at the death [m].
        time: from the death until the drum stands for good [s].
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
        elif isinstance(sample, JointSample) and machine.WINCH_LIMIT in sample.joints:
            commands.append(now_ns)
        elif isinstance(sample, JointSample):
            states.append(sample)

    flight.host.exchange.listen(listen, topics.WINCH_STATE, topics.LOAD_CELL, topics.WINCH_COMMAND)
    request(flight, machine.WINCH_TO_LENGTH, length + _DISTANCE, _RATE)
    if not flight.run(_LONGEST, lambda: _is_paying_out(states[-1], length)):
        raise RuntimeError(f"the drum does not pay out at {length:g} m")
    flight.kill("winch_node")
    death = commands[-1]  # later samples are the drive's own reaction
    flight.run(_LONGEST, lambda: states[-1].joints[machine.WINCH_BRAKE].position == 0.0)
    flight.run(_AFTER)
    moved = [s for s in states if abs(s.joints[machine.WINCH_DRUM].velocity) > _STANDSTILL][-1]
    (stop,) = flight.events_named(SimulationEvent.COMMAND_TIMEOUT)
    timeout = float(stop.values["age"])
    # It closes right after the last sample in which it was open.
    opened = [s for s in states if s.joints[machine.WINCH_BRAKE].position == 1.0][-1]
    begun = next(s for s in states if s.stamp_ns >= death)
    last = states[-1].joints[machine.WINCH_DRUM].position
    peak = max(math.hypot(*s.force) for s in loads if s.stamp_ns >= death)
    return Killed(
        begun.joints[machine.WINCH_DRUM].position,
        (moved.stamp_ns - death) / _NANO + TICK,
        last - begun.joints[machine.WINCH_DRUM].position,
        peak / hanging_load(last),
        timeout,
        timeout + opened.stamp_ns / _NANO - stop.time,
        abs(opened.joints[machine.WINCH_DRUM].velocity),
    )


def _is_paying_out(state: JointSample, length: float) -> bool:
    position, velocity, _ = state.joints[machine.WINCH_DRUM]
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


# --- gaps -----------------------------------------------------------------------------------------


def stops(batch: CheckBatch) -> Measured:
    """Random gaps of up to 0.25 s after which the drive or the controller stopped the drum."""
    flight = fly_winch({"tether.length": _GAPS_FROM}, batch.seed)
    sent: list[float] = []

    def on_command(_topic: str, _sample: Sample, _sender: str, now_ns: int) -> None:
        sent.append(now_ns * 1e-9)

    flight.host.exchange.listen(on_command, topics.WINCH_COMMAND)
    request(flight, machine.WINCH_TO_LENGTH, _GAPS_FROM + _GAPS_OVER, _RATE)
    flight.run(_GAPS_AFTER)
    stopped, longest = 0, 0.0
    runs = min(batch.runs, _MOST_GAPS)
    for generator in batch.generators(runs):
        reported, commands = len(flight.events), len(sent)
        ticks = int(generator.integers(*_GAPS, endpoint=True))
        flight.host.freeze("winch_node")
        flight.run(sent[-1] + ticks * TICK - flight.time)
        flight.host.thaw("winch_node")
        flight.run(float(generator.uniform(*_PAUSE)))
        longest = max(longest, sent[commands] - sent[commands - 1])
        names = {event.name for event in flight.events[reported:]}
        stopped += bool(names & {SimulationEvent.COMMAND_TIMEOUT, WinchEvent.FAULT})
    flight.run(0.5)
    if flight.phases[topics.WINCH_MODE] != WinchMode.LENGTH:
        stopped = runs
    note = f"{runs} gaps, the longest between two commands {longest:.3f} s"
    return Measured(float(stopped), note)
