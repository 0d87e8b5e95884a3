"""Write the bag of a scripted mission of the default rover, with its true activities.

Simulator, drives and sensors run in this process, tick by tick. The true activities come from the
script's commands and the plant's events, never from the bag. To write such a bag:

    mother_rover bag example --seed 3 BAG
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from msg_schemas import topics
from msg_schemas.events import PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue, Sample, Status, StatusSample, TextSample
from msg_schemas.table import (
    JUMP_SCREW,
    TOPICS,
    WHEEL_DRIVE,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_LIMIT,
)
from rover_sim import (
    Simulation,
    SpatialState,
    build_interface,
    build_plant,
    compile_ahead,
    load_spatial,
)
from rover_verify.harness.tape import Tape

TICK = 0.01  # [s]
DEPTH = 8.0  # of the floor below the fairlead [m]
_NANO = 1_000_000_000
_RAMP = 0.5  # acceleration of the winch [m/s^2]
_SLOW, _NEAR = 0.1, 1.0  # payout rate [m/s] within this height above the floor [m]
_AT_REST = 0.05  # rate of the wheels [rad/s]
_RATES: Mapping[str, float] = {
    name: row.rate for name, row in TOPICS.items() if row.rate is not None
}

Commands = dict[str, dict[str, JointValue]]


@dataclass(frozen=True)
class TrueActivity:
    """A true activity.

    Attributes:
        activity: Name of the activity, as in the report, or "fault".
        begin, end: Simulated times [s].
        detail: True values by name.
    """

    activity: str
    begin: float
    end: float
    detail: Mapping[str, float] = field(default_factory=dict)


class ScriptedRecording:
    """A simulation that writes every sample, command and event into a bag.

    Args:
        path: The bag's folder.
        scenario: Name of a spatial scenario.
        overrides: Overridden values of the scenario.
        seed: Seed of the sensor errors.
    """

    def __init__(
        self, path: Path, scenario: str, overrides: Mapping[str, object], seed: int
    ) -> None:
        self.scenario = load_spatial(scenario, dict(overrides))
        compile_ahead(self.scenario)  # so that it runs the compiled code
        plant = build_plant(self.scenario)
        plant.warm_up()
        self.simulation = Simulation(build_interface(plant, seed), TICK)
        self.events: list[tuple[str, float]] = []
        self._tape = Tape(path)
        self._phase: PlantPhase | None = None
        content = {
            "node": "/sim_node",
            "scenario": self.scenario.to_mapping(),
            "seed": seed,
            "parameters": {"tick": TICK},
        }
        self.write(topics.CONFIG, TextSample(json.dumps(content)))
        outside = self.simulation.interface
        self._due([name for name in outside.topics if name not in outside.available_after_tick])

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.simulation.stamp_ns / _NANO

    @property
    def state(self) -> SpatialState:
        """State of the plant."""
        state: SpatialState = self.simulation.state
        return state

    def write(self, name: str, sample: Sample) -> None:
        """Write one sample."""
        self._tape.write(name, sample, "", self.simulation.stamp_ns)

    def step(self, commands: Commands) -> None:
        """Apply commands, advance one tick, and write the samples that are due."""
        simulation = self.simulation
        for name, joints in commands.items():
            sample = JointSample(max(simulation.stamp_ns, 1), joints)
            simulation.accept_command(name, sample)
            self.write(name, sample)
        before_ns = simulation.stamp_ns
        tick = simulation.tick()
        if tick.after.phase.final:
            raise RuntimeError(f"the plant ended: {tick.after.phase.value} at {self.time:.2f} s")
        self._due(
            name
            for name in simulation.interface.topics
            if _count(tick.stamp_ns, name) > _count(before_ns, name)
        )
        for item in tick.event_reports:
            assert item.stamp_ns is not None
            self.events.append((item.name, item.stamp_ns / _NANO))
            status = Status(item.name, item.message, item.level, "sim_node", item.texts())
            self.write(topics.EVENTS, StatusSample(item.stamp_ns, (status,)))

    def when(self, name: str, after: float) -> float:
        """Return the time of the first event of a name after a time [s]."""
        return next(time for event, time in self.events if event == name and time >= after)

    def close(self) -> None:
        """Close the bag."""
        self._tape.close()

    def _due(self, names: Iterable[str]) -> None:
        for name, sample in self.simulation.interface.samples(names):
            self.write(name, sample)
        if self.simulation.phase is not self._phase:
            self._phase = self.simulation.phase
            self.write(topics.TRUTH_PHASE, TextSample(self._phase.value))


def _count(stamp_ns: int, name: str) -> int:
    return math.floor(stamp_ns * _RATES[name] / _NANO + 1e-6)


class Script:
    """Flies a mission and notes its activities.

    Args:
        recording: Simulation of a rover that hangs above a floor.
        generator: Draws depths, rates and times.
    """

    def __init__(self, recording: ScriptedRecording, generator: np.random.Generator) -> None:
        self.run = recording
        self.activities: list[TrueActivity] = []
        self._draw = generator
        scenario = recording.scenario
        self._weight = scenario.tip_mass * scenario.gravity
        self._rate = 0.0

    def fly(self) -> list[TrueActivity]:
        """Fly the mission: descents, an ascent, a fault, touchdown, drives, a jump, an ascent."""
        deeper = self.run.state.length + self._between(1.5, 2.2)
        self._wait("hanging", self._between(2.0, 4.0))
        self._pay_out("descending", self._between(0.15, 0.3), lambda: self._length >= deeper)
        self._wait("hanging", self._between(2.0, 4.0))
        higher = self._length - self._between(0.6, 1.0)
        self._pay_out("ascending", -self._between(0.1, 0.25), lambda: self._length <= higher)
        self._wait("hanging", self._between(2.0, 4.0))
        lost = self._length + self._between(0.8, 1.2)
        rate = self._between(0.15, 0.3)
        self._pay_out("descending", rate, lambda: self._length >= lost, ends=False)
        self._wait("hanging", self._between(2.0, 4.0))
        at = self.run.when(SimulationEvent.COMMAND_TIMEOUT, self.activities[-1].begin - TICK)
        self.activities.append(TrueActivity("fault", at, at))
        self._pay_out("descending", self._between(0.2, 0.3), self._stands, slow=True)
        slack = self._length + self._between(2.0, 2.5)
        self._pay_out("slack", 0.25, lambda: self._length >= slack)
        self._wait("standing", self._between(3.0, 4.0))
        self._drive(self._between(1.5, 2.5), self._between(3.0, 5.0))
        self._drive(-self._between(1.5, 2.5), self._between(3.0, 5.0))
        self._drive(self._between(1.5, 2.5), self._between(2.0, 3.0))
        self._jump(self._between(0.12, 0.16))
        self._wait("standing", self._between(3.0, 4.0))
        self._reel_in(3.0)
        self._wait("hanging", self._between(2.0, 4.0))
        return self.activities

    # --- legs ------------------------------------------------------------------------------------

    def _wait(self, activity: str, duration: float) -> None:
        self._go(activity, dict, lambda: False, duration)

    def _pay_out(
        self, activity: str, rate: float, until: Callable[[], bool], *, slow: bool = False,
        ends: bool = True,
    ) -> None:  # fmt: skip
        """Move the drum until a condition holds; without `ends` the commands cease abruptly."""

        def commands() -> Commands:
            height = float(self.run.state.G1[2]) + DEPTH
            return self._winch(math.copysign(_SLOW, rate) if slow and height < _NEAR else rate)

        begun = self._length
        first = self.run.time
        self._go(activity, commands, until, 120.0, noted=False)
        if ends:
            self._go(
                activity, lambda: self._winch(0.0), lambda: self._rate == 0.0, 5.0, noted=False
            )
            self.run.step(self._winch(0.0, brake=0.0))
        self._rate = 0.0
        detail = {"from": begun, "to": self._length}
        landed = [at for name, at in self.run.events if name == PlantEvent.TOUCHDOWN and at > first]
        if landed and activity == "descending":
            # The drum runs on briefly while the floor carries the rover.
            self.activities.append(TrueActivity(activity, first, landed[0], detail))
            self.activities.append(TrueActivity("slack", landed[0], self.run.time))
        else:
            self.activities.append(TrueActivity(activity, first, self.run.time, detail))

    def _reel_in(self, length: float) -> None:
        """Take up the slack, lift off and ascend."""
        begun, first, lifted = self._length, self.run.time, self.run.time
        while self._length > length or self._rate != 0.0:
            self.run.step(self._winch(-0.2 if self._length > length else 0.0))
            if self.run.state.phase is PlantPhase.GROUNDED:
                lifted = self.run.time
        self.run.step(self._winch(0.0, brake=0.0))
        self.activities.append(TrueActivity("slack", first, lifted, {"from": begun}))
        self.activities.append(
            TrueActivity("ascending", lifted, self.run.time, {"to": self._length})
        )

    def _drive(self, rate: float, duration: float) -> None:
        """Drive: forward goes straight, backward turns on the spot; then rest."""
        command = {topics.WHEEL_COMMAND: {WHEEL_DRIVE: JointValue(0.0, rate, 20.0)}}
        halt = {topics.WHEEL_COMMAND: {WHEEL_DRIVE: JointValue(0.0, 0.0, 20.0)}}
        start = self.run.state
        activity = "driving" if rate > 0.0 else "turning"
        begin = self.run.time
        self._go(activity, lambda: self._at(20.0, command), lambda: False, duration, noted=False)
        # The wheels may overrun the motor: wait until they are at rest.
        self._go(activity, lambda: self._at(20.0, halt), self._wheels_rest, 5.0, noted=False)
        displacement = np.linalg.norm(self.run.state.G1[:2] - start.G1[:2])
        self.activities.append(
            TrueActivity(activity, begin, self.run.time, {"displacement": float(displacement)})
        )
        self._go("standing", lambda: self._at(20.0, halt), lambda: False, self._between(2.0, 3.0))

    def _wheels_rest(self) -> bool:
        return max(abs(rate) for rate in self.run.state.wheel_rates) < _AT_REST

    def _jump(self, compression: float) -> None:
        nut = {topics.JUMP_MOTOR_COMMAND: {JUMP_SCREW: JointValue(compression, 0.06, 400.0)}}
        first = self.run.time
        before = len(self.run.events)

        def seen(name: str) -> bool:
            return any(event == name for event, _ in self.run.events[before:])

        def commands() -> Commands:
            return {} if seen(PlantEvent.LATCH_RELEASED) else self._at(20.0, nut)

        self._go("jumping", commands, lambda: seen(PlantEvent.TOUCHDOWN), 30.0, noted=False)
        released = self.run.when(PlantEvent.LATCH_COMPRESSING, first)
        take_off, landing = (self.run.when(name, first) for name in ("take_off", "touchdown"))
        self.activities.append(
            TrueActivity("compressing", released, self.run.when(PlantEvent.LATCH_RELEASED, first))
        )
        self.activities.append(TrueActivity("flight", take_off, landing))

    # --- parts of the legs -----------------------------------------------------------------------

    def _go(
        self, activity: str, commands: Callable[[], Commands], until: Callable[[], bool], longest:
            float,
        *, noted: bool = True,
    ) -> None:  # fmt: skip
        begin = self.run.time
        while not until() and self.run.time - begin < longest - 0.5 * TICK:
            self.run.step(commands())
        if noted:
            self.activities.append(TrueActivity(activity, begin, self.run.time))

    @property
    def _length(self) -> float:
        return self.run.state.length

    def _stands(self) -> bool:
        result = self.run.simulation.last
        if result is None:
            return False
        forces = result.forces
        return forces.left_wheel + forces.right_wheel + forces.body > 0.9 * self._weight

    def _winch(self, rate: float, brake: float = 1.0) -> Commands:
        ramp = TICK * _RAMP
        self._rate = min(max(rate, self._rate - ramp), self._rate + ramp)
        drum = JointValue(self._length, self._rate, self._weight)
        joints = {
            WINCH_DRUM: drum,
            WINCH_BRAKE: JointValue(brake),
            WINCH_LIMIT: JointValue(effort=60.0),
        }
        return {topics.WINCH_COMMAND: joints}

    def _at(self, rate: float, commands: Commands) -> Commands:
        """The commands, at the ticks of a slower rate [Hz]."""
        every = round(1.0 / (rate * TICK))
        return commands if round(self.run.time / TICK) % every == 0 else {}

    def _between(self, low: float, high: float) -> float:
        return float(self._draw.uniform(low, high))


def record_mission(path: Path, generator: np.random.Generator) -> list[TrueActivity]:
    """Fly a mission above a floor of rubble and record it.

    Args:
        path: The bag's folder.
        generator: Draws the ground, the sensor errors and the script.
    """
    seed = int(generator.integers(1, 1000))
    overrides = {
        "environment.seed": seed,
        "environment.floor": {"height": -DEPTH},
        "environment.patch": {"centre": [0.0, 0.0], "half_width": 8.0},
        "environment.boulders.density": 0.3,
        "environment.boulders.clear_radius": 2.5,
        "tether.length": 2.0,
        "tether.max_length": 30.0,
        "winch.min_length": 1.0,
        "start": {"kind": "hanging", "heading": 0.0},
    }
    recording = ScriptedRecording(path, "floor_rubble", overrides, seed)
    try:
        return Script(recording, generator).fly()
    finally:
        recording.close()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Simulate a scripted mission of the default rover, write its bag, and print the true "
        "activities with their times."
    )
    parser.add_argument("bag", type=Path, help="folder of the new bag")
    parser.add_argument(
        "--seed",
        type=int,
        default=1,
        help="seed of ground, sensors and script (default: %(default)d)",
    )


def run(options: argparse.Namespace) -> int:
    """Write the bag of a mission and print its activities."""
    for true in record_mission(options.bag, np.random.default_rng(options.seed)):
        detail = ", ".join(f"{name} {value:.3f}" for name, value in true.detail.items())
        print(f"{true.begin:8.2f}{true.end:8.2f}  {true.activity:12} {detail}")
    return 0
