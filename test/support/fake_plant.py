"""A plant that costs nothing, for tests of what runs around a plant."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from rover_sim.plant import Command, Energies, Event, JumpMotorCommand, Outcome, Phase, StepResult
from rover_sim.scenario import load_scenario


@dataclass(frozen=True)
class FakeState:
    time: float = 0.0
    phase: Phase = Phase.HELD
    compression: float = 0.0


class FakePlant:
    """A nut that follows its setpoint, a latch that trips there, and a flight of 0.5 s.

    Attributes:
        diverges_at: time at which it diverges [s].
        commands: every command it was given.
    """

    def __init__(self, diverges_at: float = math.inf) -> None:
        self.scenario = load_scenario("paper_table1_low")
        self.diverges_at = diverges_at
        self.commands: list[Command] = []
        self.error: Exception | None = None

    def initial_state(self) -> FakeState:
        return FakeState()

    def energies(self, state: FakeState) -> Energies:
        return Energies(0.0, 0.0, 0.0, 0.0, 0.0)

    def step(self, state: FakeState, command: Command, dt: float) -> tuple[FakeState, StepResult]:
        if self.error is not None:
            raise self.error
        self.commands.append(command)
        if state.phase.final:
            return state, self._result(Outcome.DIVERGED)
        time = state.time + dt
        if time > self.diverges_at + 1e-9:
            event = Event("diverged", state.time)
            return replace(state, phase=Phase.DIVERGED), self._result(Outcome.DIVERGED, event)
        after = replace(state, time=time)
        if state.phase is Phase.FLIGHT:
            if time >= 0.5:
                return replace(after, phase=Phase.LANDED), self._result(Outcome.CONVERGED)
            return after, self._result(Outcome.CONVERGED)
        jump = command.jump
        if not isinstance(jump, JumpMotorCommand):
            return after, self._result(Outcome.CONVERGED)
        way = jump.compression - state.compression
        moved = state.compression + math.copysign(min(abs(way), jump.rate * dt), way)
        if jump.compression > 0.0 and abs(way) <= jump.rate * dt:
            event = Event("take_off", state.time + abs(way) / jump.rate, {"speed": 1.0})
            flying = replace(after, phase=Phase.FLIGHT, compression=0.0)
            return flying, self._result(Outcome.CONVERGED, event)
        return replace(after, compression=moved), self._result(Outcome.HALVED)

    def _result(self, outcome: Outcome, *events: Event) -> StepResult:
        return StepResult(outcome, self.energies(FakeState()), 0.0, 3, 1e-3, events, 2.0)


def fake_plant(**options: Any) -> Any:
    """Return a fake plant where a planar one is expected."""
    return FakePlant(**options)
