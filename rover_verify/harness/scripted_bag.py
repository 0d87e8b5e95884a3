"""Write the bag of a scripted mission of the default rover, with its true activities.

The simulator's node runs on the loop host; the script sends it the commands of all drives. The true
activities come from these commands and the plant's events, never from the bag. To write such a bag:

    mother_rover bag example --seed 3 BAG
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from msg_schemas import machine, topics
from msg_schemas.events import PlantEvent, SimulationEvent
from msg_schemas.number_arguments import seed as seed_argument
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue
from rover_bags.files.store import BagError
from rover_verify.harness.flight import Flight
from rover_verify.harness.tape import Tape

NOT_WRITTEN = 3
"""Exit code where the bag exists or cannot be written."""
TICK = 0.01  # [s]
DEPTH = 8.0  # of the floor below the fairlead [m]
_RAMP = 0.5  # acceleration of the winch [m/s^2]
_SLOW, _NEAR = 0.1, 1.0  # payout rate [m/s] within this height above the floor [m]
_AT_REST = 0.05  # rate of the wheels [rad/s]

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


class Script:
    """Flies a mission and notes its activities.

    Args:
        flight: of a plant without controllers, whose rover hangs above a floor.
        generator: draws depths, rates and times.
    """

    def __init__(self, flight: Flight, generator: np.random.Generator) -> None:
        self.flight = flight
        self.activities: list[TrueActivity] = []
        self._draw = generator
        scenario = flight.plant.scenario
        self._weight = scenario.tip_mass * scenario.gravity
        self._rate = 0.0

    def fly(self) -> list[TrueActivity]:
        """Fly the mission: descents, an ascent, a fault, touchdown, drives, a jump, an ascent."""
        deeper = self.flight.state.length + self._between(1.5, 2.2)
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
        at = self._when(SimulationEvent.COMMAND_TIMEOUT, self.activities[-2].begin)
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
            height = float(self.flight.state.G1[2]) + DEPTH
            return self._winch(math.copysign(_SLOW, rate) if slow and height < _NEAR else rate)

        begun = self._length
        first = self.flight.time
        self._step(self._winch(0.0))  # which a drive needs that has stopped by itself
        self._go(activity, commands, until, 120.0, noted=False)
        if ends:
            self._go(
                activity, lambda: self._winch(0.0), lambda: self._rate == 0.0, 5.0, noted=False
            )
            self._step(self._winch(0.0, brake=0.0))
        else:  # the drive stops by itself
            self._go(activity, dict, self._drum_rests, 5.0, noted=False)
        self._rate = 0.0
        detail = {"from": begun, "to": self._length}
        landed = [
            each.time
            for each in self.flight.events_named(PlantEvent.TOUCHDOWN)
            if each.time > first
        ]
        if landed and activity == "descending":
            # The drum runs on briefly while the floor carries the rover.
            self.activities.append(TrueActivity(activity, first, landed[0], detail))
            self.activities.append(TrueActivity("slack", landed[0], self.flight.time))
        else:
            self.activities.append(TrueActivity(activity, first, self.flight.time, detail))

    def _reel_in(self, length: float) -> None:
        """Take up the slack, lift off and ascend."""
        begun, first, lifted = self._length, self.flight.time, self.flight.time
        while self._length > length or self._rate != 0.0:
            self._step(self._winch(-0.2 if self._length > length else 0.0))
            if self.flight.state.phase is PlantPhase.GROUNDED:
                lifted = self.flight.time
        self._step(self._winch(0.0, brake=0.0))
        self.activities.append(TrueActivity("slack", first, lifted, {"from": begun}))
        self.activities.append(
            TrueActivity("ascending", lifted, self.flight.time, {"to": self._length})
        )

    def _drive(self, rate: float, duration: float) -> None:
        """Drive: forward goes straight, backward turns on the spot; then rest."""
        command = {topics.WHEEL_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, rate, 20.0)}}
        halt = {topics.WHEEL_COMMAND: {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, 20.0)}}
        start = self.flight.state
        activity = "driving" if rate > 0.0 else "turning"
        begin = self.flight.time
        self._go(activity, lambda: self._at(20.0, command), lambda: False, duration, noted=False)
        # The wheels may overrun the motor: wait until they are at rest.
        self._go(activity, lambda: self._at(20.0, halt), self._wheels_rest, 5.0, noted=False)
        displacement = np.linalg.norm(self.flight.state.G1[:2] - start.G1[:2])
        self.activities.append(
            TrueActivity(activity, begin, self.flight.time, {"displacement": float(displacement)})
        )
        self._go("standing", lambda: self._at(20.0, halt), lambda: False, self._between(2.0, 3.0))

    def _drum_rests(self) -> bool:
        return self.flight.plant.payout_rate(self.flight.state) == 0.0

    def _wheels_rest(self) -> bool:
        return max(abs(rate) for rate in self.flight.state.wheel_rates) < _AT_REST

    def _jump(self, compression: float) -> None:
        nut = {
            topics.JUMP_MOTOR_COMMAND: {machine.JUMP_SCREW: JointValue(compression, 0.06, 400.0)}
        }
        first = self.flight.time

        def seen(name: str) -> bool:
            return any(each.time > first for each in self.flight.events_named(name))

        def commands() -> Commands:
            return {} if seen(PlantEvent.LATCH_RELEASED) else self._at(20.0, nut)

        self._go("jumping", commands, lambda: seen(PlantEvent.TOUCHDOWN), 30.0, noted=False)
        released = self._when(PlantEvent.LATCH_COMPRESSING, first)
        take_off, landing = (self._when(name, first) for name in ("take_off", "touchdown"))
        self.activities.append(
            TrueActivity("compressing", released, self._when(PlantEvent.LATCH_RELEASED, first))
        )
        self.activities.append(TrueActivity("flight", take_off, landing))

    # --- parts of the legs -----------------------------------------------------------------------

    def _step(self, commands: Commands) -> None:
        """Send commands and advance by one tick."""
        for name, joints in commands.items():
            self.flight.host.request(name, JointSample(max(self.flight.now_ns, 1), joints))
        self.flight.host.tick()

    def _when(self, name: str, after: float) -> float:
        """Time of the first event of a name after a time [s]."""
        return next(each.time for each in self.flight.events_named(name) if each.time >= after)

    def _go(
        self, activity: str, commands: Callable[[], Commands], until: Callable[[], bool], longest:
            float,
        *, noted: bool = True,
    ) -> None:  # fmt: skip
        begin = self.flight.time
        while not until() and self.flight.time - begin < longest - 0.5 * TICK:
            self._step(commands())
        if noted:
            self.activities.append(TrueActivity(activity, begin, self.flight.time))

    @property
    def _length(self) -> float:
        return self.flight.state.length

    def _stands(self) -> bool:
        forces = self.flight.result.forces
        return forces.left_wheel + forces.right_wheel + forces.body > 0.9 * self._weight

    def _winch(self, rate: float, brake: float = 1.0) -> Commands:
        ramp = TICK * _RAMP
        self._rate = min(max(rate, self._rate - ramp), self._rate + ramp)
        drum = JointValue(self._length, self._rate, self._weight)
        joints = {
            machine.WINCH_DRUM: drum,
            machine.WINCH_BRAKE: JointValue(brake),
            machine.WINCH_LIMIT: JointValue(effort=60.0),
        }
        return {topics.WINCH_COMMAND: joints}

    def _at(self, rate: float, commands: Commands) -> Commands:
        """The commands, at the ticks of a slower rate [Hz]."""
        every = round(1.0 / (rate * TICK))
        return commands if round(self.flight.time / TICK) % every == 0 else {}

    def _between(self, low: float, high: float) -> float:
        return float(self._draw.uniform(low, high))


def record_mission(path: Path, generator: np.random.Generator) -> list[TrueActivity]:
    """Fly a mission above a floor of rubble and record it.

    Args:
        path: The bag's folder.
        generator: Draws the ground, the sensor errors and the script.

    Raises:
        BagError: The bag cannot be written; nothing of it is left.
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
    tape = Tape(path)
    try:
        flight = Flight((), "floor_rubble", overrides, seed=seed, defaults={}, listener=tape.write)
        activities = Script(flight, generator).fly()
        tape.close()
    except BaseException:
        tape.discard()
        raise
    return activities


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Simulate a scripted mission of the default rover, write its bag, and print the true "
        "activities with their times."
    )
    parser.epilog = "Exit codes: 0 written, 3 the bag exists or cannot be written."
    parser.add_argument("bag", type=Path, help="folder of the new bag")
    parser.add_argument(
        "--seed",
        type=seed_argument,
        default=1,
        help="seed of ground, sensors and script (default: %(default)d)",
    )


def run(options: argparse.Namespace) -> int:
    """Write the bag of a mission and print its activities."""
    try:
        activities = record_mission(options.bag, np.random.default_rng(options.seed))
    except BagError as error:
        print(f"mother_rover bag example: {error}", file=sys.stderr)
        return NOT_WRITTEN
    for true in activities:
        detail = ", ".join(f"{name} {value:.3f}" for name, value in true.detail.items())
        print(f"{true.begin:8.2f}{true.end:8.2f}  {true.activity:12} {detail}")
    return 0
