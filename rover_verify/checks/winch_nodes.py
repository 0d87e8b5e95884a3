"""Kill of the winch node in motion: sim_node and winch_node as processes, over DDS."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.events import SimulationEvent
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM, WINCH_TO_LENGTH
from msg_schemas.phases import WinchMode
from msg_schemas.samples import JointSample, JointValue, Status, StatusSample
from rover_sim import compile_ahead, load_scenario, load_spatial
from rover_verify.checks import Batch, Measured
from rover_verify.checks.winch_flights import SCENARIO, WEIGHT
from rover_verify.harness import NodeHarness, Observer, Process, open_harness
from rover_verify.harness.lockstep import Lockstep

_SIM, _WINCH = "rover_sim.node.sim_node", "tether_winch.winch_node"
_TOPICS = (
    topics.WINCH_MODE,
    topics.WINCH_STATE,
    topics.WINCH_COMMAND,
    topics.WINCH_ESTIMATE,
    topics.LOAD_CELL,
)
_LENGTHS = (5.0, 15.0, 45.0)  # at which it is killed [m]
_RATE = 0.3  # [m/s]
_RUN_UP = 1.5  # distance over which the rate is reached [m]
_ATTEMPTS = 2  # in real time
_LONGEST = 60.0  # run-up in lockstep, in simulated time [s]
_AFTER = 3.0  # time watched after it stands [s]
_NANO = 1_000_000_000


class Killed(NamedTuple):
    """How the drum stopped after the node's death.

    Attributes:
        length: at the death [m].
        time: from the death to a standing drum [s].
        distance: from the death to where it stands [m].
        peak_tension: from the death on, over the hanging load.
        timeout: from the last command that the drive received to its quick stop [s].
        braked_after: from that command to the closed brake [s].
        braked_at: rate of the drum in the last sample with the brake open [m/s].
        in_real_time: until its death; a machine too busy for that pays out in lockstep.
    """

    length: float
    time: float
    distance: float
    peak_tension: float
    timeout: float
    braked_after: float
    braked_at: float
    in_real_time: bool


def start_winch_and_sim(
    harness: NodeHarness, names: Iterable[str], length: float, seed: int, **parameters: object
) -> tuple[Process, Observer]:
    """Start a sim_node with the rover hanging and a winch_node.

    Args:
        harness: to start them on.
        names: topics to listen to, beside the clock, events and diagnostics.
        length: of the tether [m].
        seed: of the sensors' errors.
        parameters: of the simulator.

    Returns:
        The winch's process, and an observer, once both nodes are ready.
    """
    compile_ahead(load_scenario(SCENARIO))  # the node finds it in the cache
    overrides = {"tether.length": length, "sensors.error_model": "full"}
    given = {
        "scenario": SCENARIO,
        "overrides": json.dumps(overrides),
        "seed": seed,
        "real_time_factor": 1.0,
        **parameters,
    }
    harness.processes.start(_SIM, given)
    winch = harness.processes.start(_WINCH, {"use_sim_time": True})
    observer = harness.observer()
    for name in (topics.CLOCK, topics.EVENTS, topics.DIAGNOSTICS, *names):
        observer.listen(name)
    for node in ("sim_node", "winch_node"):
        observer.wait_until_ready(node)
    return winch, observer


def arm(observer: Observer) -> None:
    """Arm the winch, and wait until it holds."""
    answer = observer.call(topics.WINCH_REARM)
    if not answer.success:
        raise RuntimeError(f"the winch cannot be armed: {answer.message}")
    observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD)


@contextmanager
def winch_and_sim(
    folder: Path, length: float, seed: int = 1, **parameters: object
) -> Iterator[tuple[Process, Observer]]:
    """An armed winch_node and a sim_node with the rover hanging, as processes."""
    with open_harness(folder) as harness:
        winch, observer = start_winch_and_sim(harness, _TOPICS, length, seed, **parameters)
        arm(observer)
        yield winch, observer


def request(
    observer: Observer, joint: str, position: float, velocity: float = 0.0, effort: float = 0.0
) -> None:
    """Send a request to the winch."""
    value = JointValue(position, velocity, effort)
    observer.send(topics.WINCH_REQUEST, JointSample(observer.time_ns(), {joint: value}))


def _pays_out(observer: Observer, length: float, lockstep: Lockstep | None) -> bool:
    """Arm, request, and wait; False = a fault, as on a stalled computer."""
    states, modes = observer.listen(topics.WINCH_STATE), observer.listen(topics.WINCH_MODE)
    since, before = len(states), len(modes)
    observer.call(topics.WINCH_REARM)
    request(observer, WINCH_TO_LENGTH, length + 8.0, _RATE)

    def at_rate(sample: JointSample) -> bool:
        position, velocity, _ = sample.joints[WINCH_DRUM]
        return position >= length and velocity > 0.98 * _RATE

    def ended(_: JointSample) -> bool:
        return any(
            mode.text in {WinchMode.FAULT, WinchMode.DISARMED} for mode in modes.samples[before:]
        )

    if lockstep is not None:
        lockstep.run_until(lambda: at_rate(states.last), _LONGEST)
        return True
    return at_rate(states.wait(lambda s: at_rate(s) or ended(s), since))


def _run_up(observer: Observer, length: float) -> Lockstep | None:
    """Pay out at the rate; on a machine too busy for real time in lockstep, which is returned."""
    for _ in range(_ATTEMPTS):
        if _pays_out(observer, length, None):
            return None
    lockstep = Lockstep(observer, topics.WINCH_COMMAND)
    _pays_out(observer, length, lockstep)
    return lockstep


@cache
def _killed(folder: Path, length: float, seed: int) -> Killed:
    """Pay out, kill the node, watch the drum."""
    with winch_and_sim(folder, length - _RUN_UP, seed) as (winch, observer):
        states, loads = observer.listen(topics.WINCH_STATE), observer.listen(topics.LOAD_CELL)
        commands = observer.listen(topics.WINCH_COMMAND)
        lockstep = _run_up(observer, length)
        winch.send(signal.SIGKILL)
        winch.wait()
        if lockstep is not None:
            lockstep.release()
        death = commands.last.stamp_ns  # later samples are the drive's own reaction
        slowed, timeout = _quick_stop(observer, death)
        states.wait(lambda s: s.stamp_ns > slowed and s.joints[WINCH_BRAKE].position == 0.0)
        # It closes right after the last sample in which it was open.
        opened = [s for s in states.samples if s.joints[WINCH_BRAKE].position == 1.0]
        stood = states.wait(lambda s: s.stamp_ns > death and s.joints[WINCH_DRUM].velocity == 0.0)
        end = stood.stamp_ns + round(_AFTER * _NANO)
        states.wait(lambda s: s.stamp_ns >= end)
        begun = next(s for s in states.samples if s.stamp_ns >= death)
        last = states.last
        peak = max(math.hypot(*s.force) for s in loads.samples if s.stamp_ns >= death)
        return Killed(
            begun.joints[WINCH_DRUM].position,
            (stood.stamp_ns - death) / _NANO,
            last.joints[WINCH_DRUM].position - begun.joints[WINCH_DRUM].position,
            peak / hanging_load(last.joints[WINCH_DRUM].position),
            timeout,
            timeout + (opened[-1].stamp_ns - slowed) / _NANO,
            abs(opened[-1].joints[WINCH_DRUM].velocity),
            lockstep is None,
        )


def hanging_load(length: float) -> float:
    """Tension at the fairlead of the rover at rest on so much tether [m], in newtons."""
    scenario = load_spatial(SCENARIO)
    return WEIGHT + scenario.tether.section.line_density * scenario.gravity * length


def _quick_stop(observer: Observer, death: int) -> tuple[int, float]:
    """Time at which the drive's quick stop began [ns], and the age of its last command [s]."""

    def timeouts(sample: StatusSample) -> list[Status]:
        return [
            status for status in sample.statuses if status.name == SimulationEvent.COMMAND_TIMEOUT
        ]

    feed = observer.listen(topics.EVENTS)
    sample = feed.wait(lambda s: s.stamp_ns >= death and bool(timeouts(s)))
    return sample.stamp_ns, float(timeouts(sample)[0].values["age"])


def _worst(batch: Batch, figure: str) -> Measured:
    details: dict[str, float | str] = {}
    values = []
    for index, length in enumerate(_LENGTHS):
        killed = _killed(batch.folder.parent, length, batch.seed)
        values.append(float(getattr(killed, figure)))
        how = "in real time" if killed.in_real_time else "in lockstep"
        details[f"{length:g} m, {how}"] = (
            f"stood after {killed.time:.3f} s and {killed.distance:.4f} m, peak tension "
            f"{killed.peak_tension:.3f} loads; quick stop after {killed.timeout:.3f} s, brake "
            f"closed after {killed.braked_after:.3f} s at {killed.braked_at:.4f} m/s"
        )
        batch.progress(index + 1, len(_LENGTHS))
    return Measured(max(values), "worst of 5, 15 and 45 m, counted from the last command", details)


def time_to_stop(batch: Batch) -> Measured:
    """Longest time [s] from the node's last command until the drum stands."""
    return _worst(batch, "time")


def stopping_distance(batch: Batch) -> Measured:
    """Longest distance [m] of the tether from the node's last command on."""
    return _worst(batch, "distance")


def peak_tension(batch: Batch) -> Measured:
    """Largest tension from the node's last command on, over the hanging load."""
    return _worst(batch, "peak_tension")


def time_to_brake(batch: Batch) -> Measured:
    """Longest time [s] from the last command that the drive received until its brake is closed."""
    return _worst(batch, "braked_after")


def braked_rate(batch: Batch) -> Measured:
    """Largest rate [m/s] of the drum when the drive's brake closes."""
    return _worst(batch, "braked_at")
