"""Safety of the drives on the link: timeouts, late and reordered commands.

Bridge and emulated machine run in one process, cycle by cycle; a cycle is 5 ms.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from contextlib import AbstractContextManager, closing
from functools import cache
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_hil.canopen.devices import SYNC_PERIOD
from rover_runtime.admission import Admission
from rover_runtime.port import Message
from rover_sim import Simulation, build_interface, build_plant, load_spatial
from rover_sim.devices.actuators import DriveFeedback
from rover_verify.checks import CheckBatch, Measured, described
from rover_verify.harness.hil_bench import PERIOD_NS, HilBench
from rover_verify.harness.hil_invalid import COMMANDS

Generator = np.random.Generator
Commands = Mapping[str, JointSample]

_SCENARIO = "free_hang"
_CARRIED = 16.2  # by the winch's motor [N]
_LARGEST_RATE = 0.3  # of the winch [m/s]
_MOST_RUNS = 10
_MAX_AGE = 0.5  # of a command that a drive may execute [s]
_TIMEOUT_NS = 3_000_000_000
_COUNT = 1e-6  # count of the winch's rate [m/s]


def simulation(seed: int = 1, **overrides: object) -> Simulation[Any]:
    """Simulation of a rover that hangs from a winch; its tick is a SYNC period."""
    scenario = load_spatial(_SCENARIO, overrides)
    return Simulation(build_interface(build_plant(scenario), seed), SYNC_PERIOD)


def open_bench() -> AbstractContextManager[HilBench]:
    """A bench with that simulation, closed at the end."""
    return closing(HilBench(simulation(), rover_offset=3.0))


def winch(rate: float) -> Commands:
    """Command to pay out, or to hold with the motor at rate 0."""
    joints = {
        machine.WINCH_DRUM: JointValue(20.0, rate, _CARRIED),
        machine.WINCH_BRAKE: JointValue(1.0),
        machine.WINCH_LIMIT: JointValue(0.0, 0.0, 100.0),
    }
    return {topics.WINCH_COMMAND: JointSample(0, joints)}


def _of(topic: str) -> Commands:
    return {topic: JointSample(0, COMMANDS[topic])}


def _drives(bench: HilBench) -> DriveFeedback:
    return bench.simulation.interface.drive_feedback(bench.simulation.state)


def payout_rate(bench: HilBench) -> float:
    """True rate [m/s], exactly 0 while the brake holds."""
    return _drives(bench).payout_rate


# ---------------------------------------------------------------------------------------- timeouts


def _cut_hop(hop: str, bench: HilBench, commands: Commands) -> Commands:
    """Cut one hop; returns the commands from then on."""
    if hop == "controller to bridge":
        return {}
    if hop == "bridge to drive":
        bench.bridge_is_on = False
    elif hop == "drive to bridge":
        bench.impair("{kind: cut, direction: to_bridge}")
    else:
        bench.impair("{kind: cut}")
    return commands


_HOPS = ("controller to bridge", "bridge to drive", "drive to bridge", "both directions")


class _Stopped(NamedTuple):
    """How the drives stopped after the cut of a hop."""

    until_stop: float  # until the last setpoint is dropped and the quick stop begins [s]
    standstill: float  # until the winch stands, its brake closed [s]
    distance: float  # paid out by then [m]
    case: str


@cache
def _stops(seed: int, runs: int) -> tuple[_Stopped, ...]:
    found = []
    for index in range(runs):
        generator = np.random.default_rng([seed, index])
        drawn = float(generator.uniform(0.05, _LARGEST_RATE))
        cases: dict[str, Commands] = {
            "winch paying out": winch(drawn if index else _LARGEST_RATE),
            "winch held by its motor": winch(0.0),
            "wheels": _of(topics.WHEEL_COMMAND),
            "wheels by torque": _of(topics.WHEEL_TORQUE_COMMAND),
            "flywheel": _of(topics.FLYWHEEL_COMMAND),
            "nut": _of(topics.JUMP_MOTOR_COMMAND),
        }
        before = round(float(generator.uniform(0.3, 0.6)) / SYNC_PERIOD) * SYNC_PERIOD
        for hop in _HOPS:
            for name, commands in cases.items():
                found.append(_stop(f"{name}, {hop}", hop, commands, before))
    return tuple(found)


def command_timeout(batch: CheckBatch, quantity: Literal["until_stop", "distance"]) -> Measured:
    """Largest value after the cut of a hop of a field of `_Stopped`."""
    runs = min(batch.runs, _MOST_RUNS)
    worst = max(_stops(batch.seed, runs), key=attrgetter(quantity))
    note = f"{runs} times {len(_HOPS)} hops, six commands each"
    return Measured(float(getattr(worst, quantity)), note, {"worst": described(worst)})


def _stop(case: str, hop: str, commands: Commands, before: float) -> _Stopped:
    with open_bench() as bench:
        bench.arm()
        bench.cycles(before, commands)
        if not bench.driven:
            raise RuntimeError(f"no drive is active: {', '.join(commands)}")
        # The last command was executed at the start of the last cycle.
        begun_ns, length = bench.simulation.stamp_ns - PERIOD_NS, _drives(bench).length
        commands = _cut_hop(hop, bench, commands)
        drives = _drives(bench)
        off_ns: int | None = None
        while off_ns is None or not drives.brake_closed or drives.payout_rate != 0.0:
            bench.cycles(SYNC_PERIOD, commands, [])
            now_ns, drives = bench.simulation.stamp_ns - begun_ns, _drives(bench)
            if off_ns is None and not bench.driven:
                off_ns = now_ns - PERIOD_NS  # start of the first cycle without a setpoint
            if now_ns > _TIMEOUT_NS:
                return _Stopped(math.inf, math.inf, math.inf, case)
        return _Stopped(off_ns * 1e-9, now_ns * 1e-9, _drives(bench).length - length, case)


# ------------------------------------------------------------------------------- late and reordered


def stale(batch: CheckBatch) -> Measured:
    """Commands that a drive executed late, twice, or after a newer one; and such messages admitted.

    Each command of a run has a different rate, which identifies it when it is executed. A run
    without an executed command or an admitted message raises RuntimeError.
    """
    executed = admitted = wrong = 0
    for generator in batch.generators(min(batch.runs, _MOST_RUNS)):
        counts = _executed_through_disorder(generator), _admitted_through_disorder(generator)
        if not all(done for done, _ in counts):
            raise RuntimeError("no command passed the disordered link")
        (done, late), (let_in, old) = counts
        executed, admitted, wrong = executed + done, admitted + let_in, wrong + late + old
    note = f"{executed} commands executed through disordered links, {admitted} messages admitted"
    return Measured(float(wrong), note)


def _executed_through_disorder(generator: Generator) -> tuple[int, int]:
    """Executed commands, and those of them that were late, or not newer than one before."""
    seed = int(generator.integers(1, 2**31))
    delay, jitter = float(generator.uniform(0.005, 0.6)), float(generator.uniform(0.005, 0.6))
    direction = "to_devices"  # so that only the commands are late
    disorder = (
        f"[{{kind: reorder, direction: {direction}, magnitude: 0.3, seed: {seed}}}, "
        f"{{kind: duplication, direction: {direction}, magnitude: 0.3, seed: {seed}}}, "
        f"{{kind: loss, direction: {direction}, magnitude: 0.1, seed: {seed}}}, "
        f"{{kind: jitter, target: winch, direction: {direction}, "
        f"magnitude: {jitter!r}, seed: {seed}, start: 1.0}}, "
        f"{{kind: delay, target: winch, direction: {direction}, "
        f"magnitude: {delay!r}, start: 1.5, duration: 1.0}}]"
    )
    with open_bench() as bench:
        bench.arm()
        bench.impair(disorder)
        drive = bench.machine.drives["winch"]
        sent: dict[int, float] = {}
        found: list[tuple[int, float]] = []
        execute = drive._execute

        def record_execution(counts: dict[str, int]) -> None:
            before = drive.setpoint
            execute(counts)
            if drive.setpoint is not None and drive.setpoint is not before:
                found.append((counts["target_velocity"], bench.time))

        drive._execute = record_execution  # type: ignore[method-assign]
        for k in range(round(4.0 / SYNC_PERIOD)):
            number = 1000 + k
            sent[number] = bench.time
            bench.cycles(SYNC_PERIOD, winch(number * _COUNT), [])
            if not bench.bridge.channels["winch"].armed and not bench.bridge.missing_devices(
                bench.simulation.stamp_ns
            ):
                bench.bridge.arm(bench.simulation.stamp_ns)
    late = sum(time - sent[number] > _MAX_AGE + 2e-3 for number, time in found)
    numbers = [number for number, _ in found]
    again = sum(after <= before for before, after in itertools.pairwise(numbers))
    return len(found), late + again


def _admitted_through_disorder(generator: Generator) -> tuple[int, int]:
    """Admitted messages, and those of them that are too old, or older than one admitted before."""
    row = TOPICS[topics.WINCH_COMMAND]
    sent = [k * 20_000_000 + 1_000_000_000 for k in range(500)]
    delays = generator.uniform(0.0, 1.0, len(sent)) ** 3
    arrivals = sorted(
        (stamp + round(delay * 1e9), stamp) for stamp, delay in zip(sent, delays, strict=True)
    )
    admission, admitted, wrong, last = Admission(), 0, 0, 0
    for now_ns, stamp in arrivals:
        message = Message("", stamp, JointSample(stamp, COMMANDS[row.name]))
        try:
            admission.admit(row, message, now_ns)
        except Refusal:
            continue
        admission.accepted(row, message, now_ns)
        admitted += 1
        wrong += stamp < last or now_ns - stamp > row.stale.max_age * 1e9
        last = stamp
    return admitted, wrong
