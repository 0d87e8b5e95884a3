"""One whole mission of the default rover by a script, with its energy book: what the audit audits.

Lowered by the winch from 2 m of tether to a floor of rubble, driven straight and turned, a jump
with flight and landing, reeled in again. Commands follow from what is seen at each tick, without a
controller's subtlety. To watch it: python -m rover_verify.scripted_mission --seed 3
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from msg_schemas.events import PlantEvent
from rover_sim import (
    Command,
    Energies,
    JumpMotorCommand,
    SpatialPlant,
    SpatialState,
    StepResult,
    WheelRateCommand,
    WinchCommand,
    load_spatial,
)

DEPTH = 8.0  # of the floor below the fairlead [m]
TICK = 0.01  # [s]

_FAST, _SLOW = 0.3, 0.1  # of the winch [m/s]
_RAMP = 0.5  # at which its rate changes [m/s^2]
_NEAR = 1.0  # above the floor it slows down [m]
_WHEEL_RATE = 2.0  # [rad/s]
_COMPRESSION, _NUT_RATE = 0.15, 0.06  # [m], [m/s]

Order = Callable[[SpatialState], Command]
Seen = Callable[[SpatialState, StepResult], bool]


@dataclass(frozen=True)
class Leg:
    """A part of the mission that is over."""

    name: str
    begin: float  # [s]
    end: float
    energies: Energies  # at the end
    events: tuple[str, ...]  # names, in order
    splits: int  # elements that the tether's chain gained; below 0: lost


@dataclass
class Mission:
    """A plant that is taken from leg to leg.

    Attributes:
        plant: of a spatial scenario with winch and rover.
        state: the present one.
        legs: what has been done.
        watch: told each tick's state and result.
    """

    plant: SpatialPlant
    watch: Callable[[SpatialState, StepResult], None] = lambda _state, _result: None
    state: SpatialState = field(init=False)
    legs: list[Leg] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = self.plant.initial_state()

    def go(self, name: str, order: Order, until: Seen, longest: float) -> None:
        """Command tick by tick until something is seen.

        Raises:
            RuntimeError: it is not seen for so long [s], or the plant can go no further.
        """
        begin, chain, events = self.state.time, self.state.elements, []
        while True:
            self.state, result = self.plant.step(self.state, order(self.state), TICK)
            events += [event.name for event in result.events]
            self.watch(self.state, result)
            if self.state.phase.final:
                raise RuntimeError(f"{name}: {result.outcome.value} at {self.state.time:.3f} s")
            if until(self.state, result):
                break
            if self.state.time - begin > longest:
                raise RuntimeError(f"{name}: not over after {longest:g} s")
        energies = self.plant.energies(self.state)
        gained = self.state.elements - chain
        self.legs.append(Leg(name, begin, self.state.time, energies, tuple(events), gained))

    def wait(self, name: str, duration: float, command: Command | None = None) -> None:
        """Hold a command, by default none, for so long [s]."""
        held, end = command or Command(), self.state.time + duration
        self.go(name, lambda _: held, lambda state, _: state.time > end - 0.5 * TICK, duration)


def make_plant(seed: int, overrides: dict[str, object] | None = None) -> SpatialPlant:
    """The default rover on 2 m of tether above a floor of rubble."""
    return SpatialPlant(
        load_spatial(
            "floor_rubble",
            {
                "environment.seed": seed,
                "environment.floor": {"height": -DEPTH},
                "environment.patch": {"centre": [0.0, 0.0], "half_width": 8.0},
                "tether.length": 2.0,
                "tether.max_length": 30.0,
                "winch.min_length": 1.0,
                "start": {"kind": "hanging", "heading": 0.0},
                **(overrides or {}),
            },
        )
    )


def fly(mission: Mission) -> None:
    """The mission, leg by leg."""
    scenario = mission.plant.scenario
    weight = scenario.tip_mass * scenario.gravity

    def pay(rate: float) -> Command:
        present = mission.plant.payout_rate(mission.state)
        ramp = 10.0 * TICK * _RAMP
        asked = min(max(rate, present - ramp), present + ramp)
        return Command(winch=WinchCommand(mission.state.length, asked, weight))

    def lower(state: SpatialState) -> Command:
        height = float(state.G1[2]) + DEPTH
        return pay(_SLOW if height < _NEAR else _FAST)

    def stands(_state: SpatialState, result: StepResult) -> bool:
        forces = result.forces
        return forces.left_wheel + forces.right_wheel + forces.body > 0.9 * weight

    mission.go("lower", lower, stands, 60.0)
    slack = mission.state.length + 2.5
    mission.go("give slack", lambda _: pay(_FAST), lambda state, _: state.length > slack, 20.0)
    mission.wait("rest", 3.0)
    mission.wait("drive straight", 3.0, Command(wheel=WheelRateCommand(_WHEEL_RATE)))
    mission.wait("stop", 1.0, Command(wheel=WheelRateCommand(0.0)))
    mission.wait("turn", 3.0, Command(wheel=WheelRateCommand(-_WHEEL_RATE)))
    mission.wait("stop", 2.0, Command(wheel=WheelRateCommand(0.0)))
    press = Command(jump=JumpMotorCommand(_COMPRESSION, _NUT_RATE))
    mission.go("compress", lambda _: press, _happened(PlantEvent.LATCH_RELEASED), 20.0)
    mission.go("take off and land", lambda _: Command(), _happened(PlantEvent.TOUCHDOWN), 5.0)
    mission.wait("settle", 4.0)
    mission.go("reel in", lambda _: pay(-_SLOW), lambda state, _: state.length < 3.0, 200.0)
    mission.wait("hang", 5.0)


def _happened(name: str) -> Seen:
    return lambda _state, result: any(event.name == name for event in result.events)


def table(mission: Mission) -> str:
    """The legs and the energy book as text."""
    heads = f"{'leg':20}{'from s':>8}{'to s':>8}{'chain':>7}{'input J':>11}{'heat J':>10}"
    lines = [heads + f"{'stored J':>11}{'missed J':>11}  events"]
    for leg in mission.legs:
        e = leg.energies
        lines.append(
            f"{leg.name:20}{leg.begin:8.2f}{leg.end:8.2f}{leg.splits:+7d}{e.input:11.4f}"
            f"{e.dissipated:10.4f}{e.stored - e.initial:+11.4f}{e.drift:+11.2e}"
            f"  {', '.join(leg.events)}"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mission and print its energy book."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="of relief and boulders")
    options = parser.parse_args(arguments)
    mission = Mission(make_plant(options.seed))
    try:
        fly(mission)
    except RuntimeError as reason:
        print(table(mission))
        print(reason, file=sys.stderr)
        return 1
    print(table(mission))
    return 0


if __name__ == "__main__":
    sys.exit(main())
