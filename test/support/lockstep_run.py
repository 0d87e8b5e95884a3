"""A simulation stepped tick by tick and recorded like a run of nodes in lockstep."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from contract_bag import MadeUp

from msg_schemas import machine, topics
from msg_schemas.samples import ClockSample, JointSample, JointValue, Sample, TextSample
from rover_sim import (
    Simulation,
    build_interface,
    build_plant,
    compile_ahead,
    load_scenario,
    start_of,
)

TICK = 0.01
PLANAR, SPATIAL = "paper_table1_high", "free_hang"
NUT = {machine.JUMP_SCREW: JointValue(0.1, 0.4, 400.0)}

CommandSource = Callable[[int], Iterable[tuple[str, Mapping[str, JointValue]]]]
Change = Callable[[str, int, Sample], Sample]


def nut_until_trip(tick: int) -> Iterable[tuple[str, Mapping[str, JointValue]]]:
    if 5 <= tick < 40 and tick % 4 == 0:
        yield topics.JUMP_MOTOR_COMMAND, NUT


def all_drives(tick: int) -> Iterable[tuple[str, Mapping[str, JointValue]]]:
    rate = 0.2 * math.sin(0.3 * tick)
    winch = JointValue(20.0, rate, 16.2)
    yield (
        topics.WINCH_COMMAND,
        {
            machine.WINCH_DRUM: winch,
            machine.WINCH_BRAKE: JointValue(1.0),
            machine.WINCH_LIMIT: JointValue(effort=60.0),
        },
    )
    yield topics.WHEEL_TORQUE_COMMAND, {machine.WHEEL_DRIVE: JointValue(effort=0.1 + 0.01 * tick)}
    if tick % 3 == 0:
        yield topics.FLYWHEEL_COMMAND, {machine.FLYWHEEL: JointValue(effort=0.05)}


def same(_name: str, _stamp: int, sample: Sample) -> Sample:
    return sample


class Recorder:
    """Steps a simulation tick by tick and records it like a run of nodes in lockstep."""

    def __init__(
        self, scenario: str, seed: int = 7, *, start: Any = None, **overrides: object
    ) -> None:
        given = {name.replace("__", "."): value for name, value in overrides.items()}
        self.scenario = load_scenario(scenario, given)
        compile_ahead(self.scenario)
        plant = build_plant(self.scenario)
        self.simulation = Simulation(build_interface(plant, seed), TICK, start)
        self.made = MadeUp()
        self.wall = 0.0
        content = {
            "node": "/sim_node",
            "parameters": {"tick": TICK},
            "scenario": self.scenario.to_mapping(),
            "seed": seed,
            **start_of(self.simulation),
        }
        self.made.add(0.0, topics.CONFIG, TextSample(json.dumps(content)))

    def run(
        self, ticks: int, commands: CommandSource, *, late: int = 0, change: Change = same
    ) -> None:
        """Record some ticks; each command arrives `late` ticks after it was sent."""
        in_transit: list[tuple[int, str, JointSample]] = []
        for tick in range(ticks):
            now = self.simulation.stamp_ns
            # At time 0 a command would count as unstamped.
            for name, joints in commands(tick) if now else ():
                sample = JointSample(now, dict(joints))
                self.made.add(self.wall + 0.002, name, sample)
                in_transit.append((tick + late, name, sample))
            for due, name, sample in list(in_transit):
                if due <= tick:
                    self.simulation.accept_command(name, sample)
                    in_transit.remove((due, name, sample))
            self.simulation.tick()
            self.wall += TICK
            self.record(change)

    def record(self, change: Change = same) -> None:
        stamp = self.simulation.stamp_ns
        self.made.add(self.wall, topics.CLOCK, ClockSample(stamp))
        recorded = set(self.simulation.interface.topics) - {topics.CLOCK, topics.MARKERS}
        for name, sample in self.simulation.interface.samples(recorded):
            self.made.add(self.wall, name, change(name, stamp, sample))
