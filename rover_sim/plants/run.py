"""Run a plant up to an event, run plants in parallel, and compute the metrics of a jump."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Generic, TypeAlias

from msg_schemas.events import PlantEvent
from rover_sim.plants.planar_plant import PlanarPlant, PlanarState
from rover_sim.plants.plant import Event, Outcome, Plant, PlantCommand, S, StepResult
from rover_sim.scenarios.scenario import Scenario

_NO_COMMAND = PlantCommand()

Policy: TypeAlias = Callable[[S], PlantCommand]


class RunError(RuntimeError):
    """A run ended without its event; the message reports how it ended."""


@dataclass(frozen=True)
class Run(Generic[S]):
    """States at the ticks, results of the steps, and events of a run."""

    states: tuple[S, ...]  # the first is the initial state
    results: tuple[StepResult, ...]  # one fewer
    events: tuple[Event, ...]

    @property
    def final(self) -> S:
        """The final state."""
        return self.states[-1]

    @property
    def peak_tension(self) -> float:
        """Largest tension in the tether [N]."""
        return max(result.peak_tension for result in self.results)

    @property
    def energy_drift(self) -> float:
        """Largest residual of the energy balance at the ticks, signed [J]."""
        return max((result.energies.drift for result in self.results), key=abs)

    def event(self, name: str) -> Event | None:
        """Return the first event of a name, or None."""
        return next((event for event in self.events if event.name == name), None)


@dataclass(frozen=True)
class JumpMetrics:
    """Metrics of a jump."""

    height: float  # largest rise of G1 above its start, H [m]
    attitude_variation: float  # theta(landing) - theta0 [rad]
    travel: float  # of G1 from take-off to landing, dx [m]
    flight_time: float  # [s]
    peak_tension: float  # [N]
    energy_drift: float  # residual of the energy balance at the landing [J]
    slack_value: float  # dh/df at the start [-]
    outcome: Outcome

    def to_mapping(self) -> dict[str, float | str]:
        """Return the metrics by names that carry the units."""
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
    command: PlantCommand | Policy[S] = _NO_COMMAND,
) -> Run[S]:
    """Step a plant for a duration, or up to the tick in which an event occurs.

    Args:
        plant: to simulate.
        state: at the start.
        duration: [s], above 0.
        tick: [s], above 0; the last tick is shorter if the duration is not a multiple of it.
        until: name of an event that ends the run, besides divergence and a broken tether.
        command: of every tick, or a policy that computes it from the state at the tick's start.

    Raises:
        ValueError: duration or tick is not finite or not above 0.
    """
    states = [state]
    results: list[StepResult] = []
    events: list[Event] = []
    for reached, result in march(plant, state, duration, tick=tick, until=until, command=command):
        states.append(reached)
        results.append(result)
        events.extend(result.events)
    return Run(tuple(states), tuple(results), tuple(events))


def march(
    plant: Plant[S],
    state: S,
    duration: float,
    *,
    tick: float = 0.01,
    until: str | None = None,
    command: PlantCommand | Policy[S] = _NO_COMMAND,
) -> Iterator[tuple[S, StepResult]]:
    """Step a plant as `run` does, and yield each state with its result; keep none of them.

    Raises:
        ValueError: duration or tick is not finite or not above 0.
    """
    for name, value in (("duration", duration), ("tick", tick)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value}: must be finite and above 0 s")
    ticks = max(1, math.ceil(duration / tick - 1e-9))
    for index in range(ticks):
        dt = tick if index < ticks - 1 else duration - tick * (ticks - 1)
        applied = command if isinstance(command, PlantCommand) else command(state)
        state, result = plant.step(state, applied, dt)
        yield state, result
        if state.phase.final or any(event.name == until for event in result.events):
            return


def roll_out(
    plant: Plant[S],
    states: Sequence[S],
    commands: Sequence[PlantCommand | Policy[S]],
    duration: float,
    *,
    tick: float = 0.01,
    until: str | None = None,
    workers: int = 2,
) -> list[Run[S]]:
    """Run a plant in parallel from several states or with several commands.

    The runs share the plant; they use several cores, as a step releases the interpreter's lock. The
    results do not depend on the number of workers.

    Args:
        plant: to simulate.
        states: initial states; a single one is used with all commands.
        commands: as in `run`; a single one is used with all states.
        duration: of each [s], above 0.
        tick: [s], above 0.
        until: name of an event that ends a run.
        workers: threads, at least 1.

    Returns:
        One run for each pair of state and command, in their order.

    Raises:
        ValueError: the numbers of states and commands differ and neither is 1; or a value is out
            of range.
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
    plant: PlanarPlant, state: PlanarState | None = None, *, max_flight_time: float = 10.0
) -> JumpMetrics:
    """Simulate the scenario's take-off and the flight up to the landing.

    Args:
        plant: with a rover.
        state: with the rover on the ground; default: the scenario's start.
        max_flight_time: longest time of flight [s].

    Raises:
        RunError: the simulation diverged, the tether broke, or the flight exceeded the limit.
    """
    standing = plant.initial_state() if state is None else state
    landed, result = plant.advance(
        plant.take_off(standing), _NO_COMMAND, max_flight_time, stop_at_touchdown=True
    )
    touchdown = next((event for event in result.events if event.name is PlantEvent.TOUCHDOWN), None)
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
    scenarios: Sequence[Scenario], *, workers: int = 1, max_flight_time: float = 10.0
) -> list[JumpMetrics | RunError]:
    """Simulate the jump of each scenario, in `workers` threads with the lock released.

    Returns:
        In the scenarios' order, the metrics or the error.
    """

    def one(scenario: Scenario) -> JumpMetrics | RunError:
        try:
            return jump(PlanarPlant(scenario), max_flight_time=max_flight_time)
        except RunError as error:
            return error

    if workers == 1:
        return [one(scenario) for scenario in scenarios]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, scenarios))
