"""Gaps in the winch's commands: the shipped winch and plant on the loop host."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.events import SimulationEvent, WinchEvent
from msg_schemas.machine import WINCH_TO_LENGTH
from msg_schemas.phases import WinchMode
from msg_schemas.samples import Sample
from rover_verify.checks import CheckBatch, Measured
from rover_verify.harness.flight import WINCH, Flight

_LENGTH, _DISTANCE, _RATE = 10.0, 30.0, 0.3  # [m], [m], [m/s]
_RUN_UP = 3.0  # [s]
_TICK = 0.01  # [s]
_GAPS = (5, 25)  # ticks between two commands
_PAUSE = (0.05, 0.5)  # with commands, between two gaps [s]
_MOST = 50  # gaps in one payout


def stops(batch: CheckBatch) -> Measured:
    """Random gaps of up to 0.25 s after which the drive or the controller stopped the drum."""
    flight = Flight(WINCH, "free_hang", {"tether.length": _LENGTH}, seed=batch.seed, defaults={})
    sent: list[float] = []

    def on_command(_topic: str, _sample: Sample, _sender: str, now_ns: int) -> None:
        sent.append(now_ns * 1e-9)

    flight.host.listen(on_command, topics.WINCH_COMMAND)
    flight.run(0.5)
    if not flight.call(topics.WINCH_REARM).success:
        raise RuntimeError("the winch cannot be armed")
    flight.request(topics.WINCH_REQUEST, WINCH_TO_LENGTH, _LENGTH + _DISTANCE, _RATE)
    flight.run(_RUN_UP)
    stopped, longest = 0, 0.0
    runs = min(batch.runs, _MOST)
    for generator in batch.generators(runs):
        reported, commands = len(flight.events), len(sent)
        ticks = int(generator.integers(*_GAPS, endpoint=True))
        flight.host.freeze("winch_node")
        flight.run(sent[-1] + ticks * _TICK - flight.time)
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
