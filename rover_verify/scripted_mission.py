"""A scripted mission of the default rover with its energy balance, for the energy audit.

The winch lowers the rover from 2 m of tether to a floor of rubble; it drives straight, turns,
jumps, lands, and is reeled in again. Commands are simple functions of the state at each tick. To
run it: python -m rover_verify.scripted_mission --seed 3
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

_FAST, _SLOW = 0.3, 0.1  # winch rates [m/s]
_RAMP = 0.5  # change of the winch rate [m/s^2]
_SLOWDOWN_HEIGHT = 1.0  # height above the floor below which it slows down [m]
_WHEEL_RATE = 2.0  # [rad/s]
_COMPRESSION, _NUT_RATE = 0.15, 0.06  # [m], [m/s]

CommandLaw = Callable[[SpatialState], Command]
StopCondition = Callable[[SpatialState, StepResult], bool]


@dataclass(frozen=True)
class Leg:
    """A finished part of the mission."""

    name: str
    begin: float  # [s]
    end: float
    energies: Energies  # at the end
    events: tuple[str, ...]  # names, in order
    splits: int  # change of the number of tether elements


@dataclass
class Mission:
    """A plant that executes legs.

    Attributes:
        plant: of a spatial scenario with winch and rover.
        state: the present one.
        legs: finished legs.
        watch: called with state and result of each tick.
    """

    plant: SpatialPlant
    watch: Callable[[SpatialState, StepResult], None] = lambda _state, _result: None
    state: SpatialState = field(init=False)
    legs: list[Leg] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = self.plant.initial_state()

    def go(self, name: str, command_law: CommandLaw, until: StopCondition, limit: float) -> None:
        """Command tick by tick until a condition holds.

        Raises:
            RuntimeError: it does not hold within `limit` [s], or the plant cannot continue.
        """
        begin, chain, events = self.state.time, self.state.elements, []
        while True:
            self.state, result = self.plant.step(self.state, command_law(self.state), TICK)
            events += [event.name for event in result.events]
            self.watch(self.state, result)
            if self.state.phase.final:
                raise RuntimeError(f"{name}: {result.outcome.value} at {self.state.time:.3f} s")
            if until(self.state, result):
                break
            if self.state.time - begin > limit:
                raise RuntimeError(f"{name}: not finished after {limit:g} s")
        energies = self.plant.energies(self.state)
        gained = self.state.elements - chain
        self.legs.append(Leg(name, begin, self.state.time, energies, tuple(events), gained))

    def wait(self, name: str, duration: float, command: Command | None = None) -> None:
        """Hold a command, none by default, for a duration [s]."""
        command_held, end = command or Command(), self.state.time + duration
        self.go(
            name, lambda _: command_held, lambda state, _: state.time > end - 0.5 * TICK, duration
        )


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
    """Execute the mission leg by leg."""
    scenario = mission.plant.scenario
    weight = scenario.tip_mass * scenario.gravity

    def pay(rate: float) -> Command:
        present = mission.plant.payout_rate(mission.state)
        ramp = 10.0 * TICK * _RAMP
        commanded = min(max(rate, present - ramp), present + ramp)
        return Command(winch=WinchCommand(mission.state.length, commanded, weight))

    def lower(state: SpatialState) -> Command:
        height = float(state.G1[2]) + DEPTH
        return pay(_SLOW if height < _SLOWDOWN_HEIGHT else _FAST)

    def is_on_floor(_state: SpatialState, result: StepResult) -> bool:
        forces = result.forces
        return forces.left_wheel + forces.right_wheel + forces.body > 0.9 * weight

    mission.go("lower", lower, is_on_floor, 60.0)
    slack = mission.state.length + 2.5
    mission.go("give slack", lambda _: pay(_FAST), lambda state, _: state.length > slack, 20.0)
    mission.wait("rest", 3.0)
    mission.wait("drive straight", 3.0, Command(wheel=WheelRateCommand(_WHEEL_RATE)))
    mission.wait("stop", 1.0, Command(wheel=WheelRateCommand(0.0)))
    mission.wait("turn", 3.0, Command(wheel=WheelRateCommand(-_WHEEL_RATE)))
    mission.wait("stop", 2.0, Command(wheel=WheelRateCommand(0.0)))
    press = Command(jump=JumpMotorCommand(_COMPRESSION, _NUT_RATE))
    mission.go("compress", lambda _: press, _has_event(PlantEvent.LATCH_RELEASED), 20.0)
    mission.go("take off and land", lambda _: Command(), _has_event(PlantEvent.TOUCHDOWN), 5.0)
    mission.wait("settle", 4.0)
    mission.go("reel in", lambda _: pay(-_SLOW), lambda state, _: state.length < 3.0, 200.0)
    mission.wait("hang", 5.0)


def _has_event(name: str) -> StopCondition:
    return lambda _state, result: any(event.name == name for event in result.events)


def table(mission: Mission) -> str:
    """Legs and energy balance as text."""
    heads = f"{'leg':20}{'from s':>8}{'to s':>8}{'chain':>7}{'input J':>11}{'heat J':>10}"
    lines = [heads + f"{'stored J':>11}{'error J':>11}  events"]
    for leg in mission.legs:
        e = leg.energies
        lines.append(
            f"{leg.name:20}{leg.begin:8.2f}{leg.end:8.2f}{leg.splits:+7d}{e.input:11.4f}"
            f"{e.dissipated:10.4f}{e.stored - e.initial:+11.4f}{e.drift:+11.2e}"
            f"  {', '.join(leg.events)}"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the mission and print its energy balance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1, help="seed of relief and boulders")
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
