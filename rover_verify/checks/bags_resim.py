"""Re-simulation of recorded runs of the simulator's node."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from msg_schemas import topics
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue, StatusSample
from msg_schemas.table import JUMP_SCREW, WHEEL_DRIVE, WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT
from rover_bags.resimulation.resim import resimulate
from rover_sim import compile_ahead, load_scenario
from rover_verify.checks import Batch, Measured
from rover_verify.harness import Observer, open_harness
from rover_verify.harness.recording import missing_streams

_RUNS = 2  # of each scenario
_NANO = 1_000_000_000
_TICKS, _EVERY = 60, 6
_LISTENERS = 2
_SCENARIOS = ("paper_table1_high", "free_hang")

Orders = dict[str, dict[str, JointValue]]


def lockstep(batch: Batch) -> Measured:
    """Number of samples of lockstep runs that are not bit-identical."""
    differing, compared, details = 0, 0, {}
    for index, generator in enumerate(batch.generators(_RUNS * len(_SCENARIOS))):
        scenario = _SCENARIOS[index % len(_SCENARIOS)]
        folder = batch.folder / f"run_{index}"
        folder.mkdir()
        found = resimulate(_recorded(Batch(1, batch.seed, folder), scenario, generator))
        differing += found.differing
        compared += found.compared
        words = f"{found.compared} samples, {found.commands} commands, {found.resets} resets"
        if found.first is not None:
            words += f"; first difference {found.first.text()}"
        if not found.compared or not found.commands:
            differing += 1
        details[f"run {index}, {scenario}"] = words
    return Measured(differing, f"of {compared} samples", details)


def _recorded(batch: Batch, scenario: str, generator: np.random.Generator) -> Any:
    """Record a run that is stepped tick by tick, with commands received before each step."""
    bag = batch.folder / "bag"
    compile_ahead(load_scenario(scenario))
    seed = int(generator.integers(1, 2**31 - 1))
    with open_harness(batch.folder) as harness:
        parameters = {"scenario": scenario, "start_paused": True, "seed": seed}
        harness.processes.start("rover_sim.node.sim_node", {**parameters, "tether_rate": 100.0})
        observer = harness.observer()
        clock, status = observer.listen(topics.CLOCK), observer.listen(topics.SIM_STATUS)
        observer.wait_until_ready("sim_node")
        recorder = harness.processes.start("rover_bags.recording.record", None, "-o", str(bag))
        observer.wait_until(
            lambda: observer.call(topics.SIM_STEP).success and not missing_streams(bag),
            "a topic is not recorded",
        )
        # Simulator and recorder must discover a publisher before its first command.
        publishers = [observer.publisher(name) for name in _orders(scenario, generator)]
        observer.wait_until(
            lambda: all(each.get_subscription_count() >= _LISTENERS for each in publishers),
            "simulator and recorder do not receive the commands",
        )
        if not observer.call(topics.SIM_RESET_PLANT).success:
            raise RuntimeError("the plant was not reset")
        commands = 0
        for tick in range(_TICKS):
            if tick % _EVERY == 0 and _obeys(observer, status):
                for name, joints in _orders(scenario, generator).items():
                    observer.send(name, JointSample(observer.time_ns(), joints))
                    commands += 1
                status.wait(partial(_has_taken, commands), max(0, len(status) - 1))
            _step(observer, clock)
        if recorder.stop() != 0:
            raise RuntimeError(f"the recorder failed:\n{recorder.output}")
    return bag


def _step(observer: Observer, clock: Any) -> None:
    received = len(clock)
    if not observer.call(topics.SIM_STEP).success:
        raise RuntimeError("the simulator made no step")
    clock.wait(lambda _: True, received)


def _obeys(observer: Observer, status: Any) -> bool:
    """Whether the drives accept commands: those of the planar rover do not in flight."""
    now = repr(observer.time_ns() / _NANO)
    latest = status.wait(
        lambda sample: sample.statuses[0].values.get("simulated_time") == now,
        max(0, len(status) - 1),
    )
    return bool(latest.statuses[0].values["phase"] != PlantPhase.FLIGHT.value)


def _has_taken(commands: int, sample: StatusSample) -> bool:
    return sample.statuses[0].values.get("commands") == str(commands)


def _orders(scenario: str, generator: np.random.Generator) -> Orders:
    nut = {JUMP_SCREW: JointValue(0.05, float(generator.uniform(0.2, 0.4)), 400.0)}
    if scenario == _SCENARIOS[0]:
        return {topics.JUMP_MOTOR_COMMAND: nut}
    rate = float(generator.uniform(-0.3, 0.3))
    return {
        topics.WINCH_COMMAND: {
            WINCH_DRUM: JointValue(20.0, rate, 16.2),
            WINCH_BRAKE: JointValue(1.0),
            WINCH_LIMIT: JointValue(effort=60.0),
        },
        topics.WHEEL_TORQUE_COMMAND: {
            WHEEL_DRIVE: JointValue(effort=float(generator.uniform(-0.3, 0.3)))
        },
    }
