"""Run a plant until something happens, and what a jump amounts to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Generic, TypeAlias

from rover_sim.planar_plant import PlanarPlant, PlanarState
from rover_sim.plant import Command, Event, Outcome, Plant, S, StepResult
from rover_sim.scenario import Scenario

_NO_COMMAND = Command()

Policy: TypeAlias = Callable[[S], Command]


class RunError(RuntimeError):
    """A run did not come to the event it was to run to; says how it ended instead."""


@dataclass(frozen=True)
class Run(Generic[S]):
    """States at each tick, what happened on the way and how it ended."""

    states: tuple[S, ...]  # the first is the one the run started from
    results: tuple[StepResult, ...]  # one less
    events: tuple[Event, ...]

    @property
    def final(self) -> S:
        """The last state."""
        return self.states[-1]

    @property
    def peak_tension(self) -> float:
        """Largest tension in the tether [N]."""
        return max(result.peak_tension for result in self.results)

    @property
    def energy_drift(self) -> float:
        """Largest miss of the energy balance at the ticks, with its sign [J]."""
        return max((result.energies.drift for result in self.results), key=abs)

    def event(self, name: str) -> Event | None:
        """The first event of that name."""
        return next((event for event in self.events if event.name == name), None)


@dataclass(frozen=True)
class JumpMetrics:
    """What a jump amounts to."""

    height: float  # largest rise of G1 over its start, H [m]
    attitude_variation: float  # theta(landing) - theta0 [rad]
    travel: float  # of G1 from take-off to landing, dx [m]
    flight_time: float  # [s]
    peak_tension: float  # [N]
    energy_drift: float  # miss of the energy balance at the landing [J]
    slack_value: float  # dh/df at the start [-]
    outcome: Outcome

    def to_mapping(self) -> dict[str, float | str]:
        """Plain values by names that carry their units."""
        return {
            "jump_height_m": self.height,
            "attitude_variation_rad": self.attitude_variation,
            "travel_m": self.travel,
            "flight_time_s": self.flight_time,
            "peak_tension_N": self.peak_tension,
            "energy_drift_J": self.energy_drift,
            "slack_value": self.slack_value,
            "outcome": self.outcome.value,
        }


def run(
    plant: Plant[S],
    state: S,
    duration: float,
    *,
    tick: float = 0.01,
    until: str | None = None,
    command: Command | Policy[S] = _NO_COMMAND,
) -> Run[S]:
    """Step a plant for a duration, or up to the tick in which an event happens.

    Args:
        plant: the plant.
        state: where to start.
        duration: [s], above 0.
        tick: [s], above 0; the last tick is shorter if the duration is no multiple of it.
        until: name of an event that ends the run, besides divergence and a broken tether.
        command: given in every tick, or what makes one of the state at its start.

    Raises:
        ValueError: duration or tick is not finite or not above 0.
    """
    for name, value in (("duration", duration), ("tick", tick)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value}: must be finite and above 0 s")
    states = [state]
    results: list[StepResult] = []
    events: list[Event] = []
    ticks = max(1, math.ceil(duration / tick - 1e-9))
    for index in range(ticks):
        dt = tick if index < ticks - 1 else duration - tick * (ticks - 1)
        told = command if isinstance(command, Command) else command(state)
        state, result = plant.step(state, told, dt)
        states.append(state)
        results.append(result)
        events.extend(result.events)
        if state.phase.final or any(event.name == until for event in result.events):
            break
    return Run(tuple(states), tuple(results), tuple(events))


def roll_out(
    plant: Plant[S],
    states: Sequence[S],
    commands: Sequence[Command | Policy[S]],
    duration: float,
    *,
    tick: float = 0.01,
    until: str | None = None,
    workers: int = 2,
) -> list[Run[S]]:
    """Run a plant from each state with each command, side by side.

    The runs share the plant and, as a step releases the interpreter's lock, the processor's cores.
    What they give does not depend on the number of workers.

    Args:
        plant: the plant.
        states: where to start; one state serves all commands.
        commands: as in `run`; one command serves all states.
        duration: of each [s], above 0.
        tick: [s], above 0.
        until: name of an event that ends a run.
        workers: threads, at least 1.

    Returns:
        One run for each pair, in their order.

    Raises:
        ValueError: there are several states and several commands, but not as many of both; or a
            number is out of its range.
    """
    if workers < 1:
        raise ValueError(f"workers = {workers}: must be at least 1")
    count = max(len(states), len(commands))
    for name, given in (("states", len(states)), ("commands", len(commands))):
        if given not in (1, count):
            raise ValueError(f"{name}: there are {given}, must be 1 or {count}")

    def one(index: int) -> Run[S]:
        return run(
            plant,
            states[index % len(states)],
            duration,
            tick=tick,
            until=until,
            command=commands[index % len(commands)],
        )

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, range(count)))


def jump(
    plant: PlanarPlant, state: PlanarState | None = None, *, limit: float = 10.0
) -> JumpMetrics:
    """Take off as the scenario says and fly to the landing.

    Args:
        plant: a plant with a rover.
        state: the rover standing; by default the scenario's start.
        limit: give up after this time of flight [s].

    Raises:
        RunError: the flight diverged, broke the tether, or had not landed in time.
    """
    standing = plant.initial_state() if state is None else state
    landed, result = plant.advance(
        plant.take_off(standing), _NO_COMMAND, limit, stop_at_touchdown=True
    )
    touchdown = next((event for event in result.events if event.name == "touchdown"), None)
    if touchdown is None:
        raise RunError(f"no landing: {result.outcome.value} at t = {landed.time:.6g} s")
    values = touchdown.values
    return JumpMetrics(
        height=values["height"],
        attitude_variation=values["attitude_variation"],
        travel=values["travel"],
        flight_time=values["flight_time"],
        peak_tension=result.peak_tension,
        energy_drift=result.energies.drift,
        slack_value=plant.scenario.slack_value,
        outcome=result.outcome,
    )


def jump_many(
    scenarios: Sequence[Scenario], *, workers: int = 1, limit: float = 10.0
) -> list[JumpMetrics | RunError]:
    """Jump each scenario; the flights run in `workers` threads with the lock released.

    Returns:
        In the scenarios' order, the metrics or the reason why there are none.
    """

    def one(scenario: Scenario) -> JumpMetrics | RunError:
        try:
            return jump(PlanarPlant(scenario), limit=limit)
        except RunError as error:
            return error

    if workers == 1:
        return [one(scenario) for scenario in scenarios]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, scenarios))
