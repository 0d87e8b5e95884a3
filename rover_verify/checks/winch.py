"""The winch on the spatial plant: descent, touchdown, load monitoring, safety, modes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.commands import CommandState
from msg_schemas.events import WinchEvent
from msg_schemas.faults import WinchFault
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.samples import JointSample, JointValue, TextSample
from rover_runtime.message_exchange import Impairment
from rover_runtime.pacing import NANO
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.winch_flights import fly_winch, on_floor, request, slack
from rover_verify.checks.winch_trials import TrialResult, draw_plan, fly_trial
from rover_verify.harness.flight import Flight

_RATE = 0.3  # [m/s]
_NODE, _NAN = "winch_node", math.nan
_EFFECT = 0.1  # time after a change of mode within which the torque follows it [s]

# --- load monitoring ---------------------------------------------------------------------------


def trial(seed: int, index: int) -> TrialResult:
    """One descent of a batch."""
    rng = np.random.default_rng([seed, index])
    return fly_trial(draw_plan(rng), int(rng.integers(2**31)))


def descents_with(batch: CheckBatch, error: str, unit: Literal["number", "share"]) -> Measured:
    """Descents with an error of the load monitor, such as ``snag_missed`` of `TrialResult`."""
    flown = fly_batch(batch, batch.runs, trial)
    wrong = [index for index, one in enumerate(flown) if getattr(one, error)]
    note = f"of {batch.runs} descents: {', '.join(map(str, wrong)) or 'none'}"
    return Measured(len(wrong) / (1 if unit == "number" else batch.runs), note, per_run(flown))


def touchdown_slack(batch: CheckBatch) -> Measured:
    """Most slack after touchdowns at 0.1 m/s, high, in the middle and at 46 m."""
    left = {}
    for depth in (6.0, 16.0, 46.0):
        flight = fly_winch({"tether.length": depth - 1.0, **on_floor(depth)}, batch.seed)
        request(flight, machine.WINCH_TO_LENGTH, depth + 4.0, 0.1)
        flight.run(20.0)
        found = flight.winch.sensing.load.is_supported and flight.winch.servo.is_at_rest
        left[f"{depth:g} m"] = slack(flight) if found else math.inf
    return Measured(max(left.values()), details=left)


# --- safety -------------------------------------------------------------------------------------


class _Case(NamedTuple):
    """One case of an unsafe motion.

    Attributes:
        fault: what must be latched; None = the winch must be stopped.
        act: causes the case.
    """

    fault: WinchFault | None
    act: Callable[[Flight], None] = lambda _flight: None


def _impaired(topic: str, impairment: Impairment) -> Callable[[Flight], None]:
    return lambda flight: flight.host.exchange.impair(topic, impairment)


def _drum(change: Callable[[JointValue], JointValue]) -> Callable[[Flight], None]:
    """Change the readings of the drum."""

    def impairment(sample: JointSample) -> JointSample:
        drum = change(sample.joints[machine.WINCH_DRUM])
        return replace(sample, joints={**sample.joints, machine.WINCH_DRUM: drum})

    return _impaired(topics.WINCH_STATE, impairment)


def _load_cell(tension: float) -> Callable[[Flight], None]:
    """Let the load cell read this tension [N]."""
    force = (0.0, 0.0, -tension)
    return _impaired(topics.LOAD_CELL, lambda sample: replace(sample, force=force))


def _run_away(flight: Flight) -> None:
    begun: list[float] = []

    def change(drum: JointValue) -> JointValue:
        begun.append(drum.position)
        return JointValue(begun[0] + 0.01 * len(begun), 1.0, 0.0)

    _drum(change)(flight)


def _end_here(flight: Flight) -> None:
    ended = {"longest_length": flight.winch.sensing.payout.length, "soft_margin": 0.0}
    flight.host[_NODE].change_parameters(ended)


_CASES: Mapping[str, _Case] = {
    "drum silent": _Case(WinchFault.DRUM_LOST, _impaired(topics.WINCH_STATE, lambda _: None)),
    "length NaN": _Case(WinchFault.BAD_READING, _drum(lambda drum: drum._replace(position=_NAN))),
    "clock jump": _Case(WinchFault.CLOCK_JUMP, lambda flight: flight.host[_NODE].clock_went_back()),
    "overspeed": _Case(WinchFault.OVERSPEED, _run_away),
    "over-tension": _Case(WinchFault.OVER_TENSION, _load_cell(80.0)),
    "tension NaN": _Case(WinchFault.BAD_READING, _load_cell(_NAN)),
    "load cell silent": _Case(WinchFault.TENSION_LOST, _impaired(topics.LOAD_CELL, lambda _: None)),
    "tether end": _Case(WinchFault.TETHER_END, _end_here),
    "node stop": _Case(None, lambda flight: flight.host[_NODE].deactivate()),
    "command timeout": _Case(WinchFault.COMMAND_TIMEOUT),
}


class _Outcome(NamedTuple):
    """Result of a case.

    Attributes:
        complaint: what was not safe; empty = all was.
        motions: requests that were accepted, or moved the drum, before the winch was armed again.
    """

    complaint: str
    motions: int


@cache
def _outcome(name: str, seed: int) -> _Outcome:
    """Pay out at 0.3 m/s, apply a case, wait for some seconds; then request motions."""
    case = _CASES[name]
    flight = fly_winch({"tether.length": 10.0}, seed)
    winch = flight.winch
    joint, value = machine.WINCH_TO_LENGTH, (40.0, _RATE)
    if case.fault is WinchFault.COMMAND_TIMEOUT:
        joint, value = machine.WINCH_AT_RATE, (0.0, _RATE)
    for _ in range(2):
        request(flight, joint, *value)
        flight.run(0.9)
    case.act(flight)
    flight.run(3.0)
    drum = flight.state.drives.drum
    mode, event = WinchMode.FAULT, WinchEvent.FAULT
    if case.fault is None:
        mode, event = WinchMode.STOP, WinchEvent.STOP
    reported = flight.events_named(event, _NODE)
    safe = (
        flight.phases[topics.WINCH_MODE] == mode
        and winch.fault is case.fault
        and len(reported) == 1
        and bool(reported[0].status.message)
        and drum.braked
        and drum.rate == 0.0
        and flight.result.forces.winch_current == 0.0
    )
    complaint = "" if safe else f"{name}: {winch.mode} {winch.fault} {winch.fault_reason}"
    for topic in (topics.WINCH_STATE, topics.LOAD_CELL):
        flight.host.exchange.impair(topic, None)
    length = flight.state.length
    recorded = len(flight.commands)
    for motion in (
        (machine.WINCH_TO_LENGTH, 5.0, 0.2, 0.0),
        (machine.WINCH_AT_RATE, 0.0, -0.1, 0.0),
        (machine.WINCH_AT_TENSION, 0.0, 0.1, 20.0),
        (machine.WINCH_SLACK, 0.0, 0.1, 0.0),
    ):
        request(flight, *motion)
        flight.run(0.2)
    moved = sum(each.state is CommandState.ACCEPTED for each in flight.commands[recorded:])
    return _Outcome(complaint, moved + (flight.state.length != length))


def unsafe_cases(batch: CheckBatch) -> Measured:
    """Cases that do not end braked, without torque, in a latched fault with its reason."""
    complaints = [_outcome(name, batch.seed).complaint for name in _CASES]
    wrong = [complaint for complaint in complaints if complaint]
    return Measured(float(len(wrong)), "; ".join(wrong) or f"{len(_CASES)} cases")


def motions_after_fault(batch: CheckBatch) -> Measured:
    """Requests after a fault that move the drum before it is armed again."""
    return Measured(float(sum(_outcome(name, batch.seed).motions for name in _CASES)))


def refusals_without_reason(batch: CheckBatch) -> Measured:
    """Refused requests whose reason does not name the cause."""
    flight = fly_winch({"tether.length": 10.0}, batch.seed)
    lacking: list[str] = []

    def refuses(
        joint: str, value: tuple[float, float, float], words: str, age: float = 0.0
    ) -> None:
        """Send a request; it should be refused with these words."""
        before = len(flight.refusals)
        sample = JointSample(flight.now_ns - round(age * NANO), {joint: JointValue(*value)})
        flight.host.request(topics.WINCH_REQUEST, sample)
        flight.run(0.1)
        if not any(words in refusal.reason for _, refusal in flight.refusals[before:]):
            lacking.append(f"{joint} {value}: {words}")

    refuses(machine.WINCH_TO_LENGTH, (59.0, 0.2, 0.0), "59.0")
    refuses(machine.WINCH_TO_LENGTH, (20.0, 0.45, 0.0), "0.45")
    refuses(machine.WINCH_AT_RATE, (0.0, -0.45, 0.0), "-0.45")
    refuses(machine.WINCH_AT_RATE, (0.0, 0.1, 900.0), "900.0")
    refuses(machine.WINCH_AT_TENSION, (0.0, 0.1, 0.05), "without end")
    refuses(machine.WINCH_AT_TENSION, (0.0, 0.1, 2.0), "hangs")
    refuses(machine.WINCH_SLACK, (1.0, 0.1, 0.0), "set it down first")
    flight.run(9.0)
    refuses(machine.WINCH_AT_RATE, (0.0, 0.1, 0.0), "old", age=9.0)
    flight.host.request(topics.JUMP_PHASE, TextSample(JumpPhase.FLIGHT))
    flight.run(0.1)
    refuses(machine.WINCH_TO_LENGTH, (5.0, 0.2, 0.0), "a jump is in progress")
    flight.call(topics.WINCH_STOP)
    refuses(machine.WINCH_TO_LENGTH, (20.0, 0.2, 0.0), "rearm")
    return Measured(float(len(lacking)), "; ".join(lacking))


def mode_step(batch: CheckBatch) -> Measured:
    """Largest step of the motor's torque from tick to tick at a change of mode, over its limit."""
    ideal = {"tether.length": 10.0, "sensors.error_model": "ideal"}
    flight = fly_winch(ideal, batch.seed)
    begun = len(flight.events)
    rows: list[tuple[float, float]] = []  # time [s] and motor's current [A]
    flight.host.exchange.listen(
        lambda *_: rows.append((flight.time, flight.result.forces.winch_current)),
        topics.WINCH_COMMAND,
    )
    for joint, position, velocity, effort, time in (
        (machine.WINCH_TO_LENGTH, 14.0, 0.2, 0.0, 3.0),
        (machine.WINCH_AT_RATE, 0.0, 0.1, 0.0, 0.8),
        (machine.WINCH_AT_TENSION, 0.0, 0.1, 16.0, 0.8),
        (machine.WINCH_AT_RATE, 0.0, -0.2, 0.0, 0.8),
        (machine.WINCH_TO_LENGTH, 9.0, 0.3, 0.0, 2.0),
        (machine.WINCH_AT_RATE, 0.0, 0.3, 0.0, 0.9),
    ):
        request(flight, joint, position, velocity, effort)
        flight.run(time)
    flight.call(topics.WINCH_HOLD)
    flight.run(3.0)
    times, currents = np.array(rows).T
    drum = flight.winch.parameters.drum
    steps = np.abs(np.diff(currents)) * drum.torque_constant / drum.motor_torque
    changes = [each.time for each in flight.events[begun:] if each.name.startswith("winch_")]
    near = np.zeros(steps.shape, dtype=bool)
    for at in changes:
        near |= (times[1:] >= at - 0.005) & (times[1:] <= at + _EFFECT)
    return Measured(float(steps[near].max()), f"{len(changes)} changes")
