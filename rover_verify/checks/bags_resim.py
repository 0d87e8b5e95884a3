"""Re-simulation of recorded runs of the simulator's node."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.samples import JointValue
from rover_bags.resimulation.resim import resimulate
from rover_launch.plan import LOCKSTEP
from rover_sim import compile_ahead, load_scenario
from rover_verify.checks import CheckBatch, Measured
from rover_verify.harness import open_harness
from rover_verify.harness.command_source import Commands, CommandSource
from rover_verify.harness.launching import missing_streams

_SIM = "sim_node"
_RUNS = 2  # of each scenario
_NANO = 1_000_000_000
_TICKS, _EVERY = 60, 6
_TICK = 0.01  # [s]
_SCENARIOS = ("paper_table1_high", "free_hang")


def lockstep(batch: CheckBatch) -> Measured:
    """Number of samples of lockstep runs that are not bit-identical."""
    differing, compared, details = 0, 0, {}
    for index, generator in enumerate(batch.generators(_RUNS * len(_SCENARIOS))):
        scenario = _SCENARIOS[index % len(_SCENARIOS)]
        folder = batch.folder / f"run_{index}"
        folder.mkdir()
        found = resimulate(_recorded(folder, scenario, generator))
        differing += found.differing
        compared += found.compared
        words = f"{found.compared} samples, {found.commands} commands, {found.resets} resets"
        if found.first is not None:
            words += f"; first difference {found.first.text()}"
        if not found.compared or not found.commands:
            differing += 1
        details[f"run {index}, {scenario}"] = words
    return Measured(differing, f"of {compared} samples", details)


def _recorded(folder: Path, scenario: str, generator: np.random.Generator) -> Path:
    """Record a run of the simulator and a command source in lockstep."""
    bag = folder / "bag"
    compile_ahead(load_scenario(scenario))
    parameters = {
        "scenario": scenario,
        "seed": int(generator.integers(1, 2**31 - 1)),
        "tether_rate": 100.0,
        LOCKSTEP: f"{_SIM},{CommandSource.NAME}",
    }
    with open_harness(folder) as harness:
        harness.processes.start("rover_sim.node.sim_node", parameters)
        recorder = harness.processes.start("rover_bags.recording.record", None, "-o", str(bag))
        observer = harness.observer()
        observer.listen(topics.CLOCK)
        commands = [_commands(scenario, generator) for _ in range(_TICKS // _EVERY)]
        is_recorded = threading.Event()

        def next_commands() -> Commands:
            return commands.pop() if is_recorded.is_set() and commands else {}

        names = tuple(commands[0])
        source = CommandSource(harness.domain, _SIM, _EVERY * _TICK, next_commands, names)
        try:
            observer.wait_until(lambda: not missing_streams(bag), "a topic is not recorded")
            observer.wait_until(source.is_listened.is_set, "the commands are not recorded")
            observer.wait_for_time(observer.time_ns() + _NANO)
            if not observer.call(topics.SIM_RESET_PLANT).success:
                raise RuntimeError("the plant was not reset")
            is_recorded.set()
            observer.wait_until(lambda: not commands, "the commands are not sent")
            observer.wait_for_time(observer.time_ns() + _NANO)
        finally:
            source.close()
        if recorder.stop() != 0:
            raise RuntimeError(f"the recorder failed:\n{recorder.output}")
    return bag


def _commands(scenario: str, generator: np.random.Generator) -> Commands:
    nut = {machine.JUMP_SCREW: JointValue(0.05, float(generator.uniform(0.2, 0.4)), 400.0)}
    if scenario == _SCENARIOS[0]:
        return {topics.JUMP_MOTOR_COMMAND: nut}
    rate = float(generator.uniform(-0.3, 0.3))
    return {
        topics.WINCH_COMMAND: {
            machine.WINCH_DRUM: JointValue(20.0, rate, 16.2),
            machine.WINCH_BRAKE: JointValue(1.0),
            machine.WINCH_LIMIT: JointValue(effort=60.0),
        },
        topics.WHEEL_TORQUE_COMMAND: {
            machine.WHEEL_DRIVE: JointValue(effort=float(generator.uniform(-0.3, 0.3)))
        },
    }
