"""A plant without mechanics, and its interface, for tests of the code around a plant."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from msg_schemas import machine, topics
from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import ClockSample, DrawingSample, JointSample, JointValue, Sample
from rover_sim.devices.actuators import DriveFeedback
from rover_sim.devices.equipment import Equipment, Nut, QuickStopDecelerations
from rover_sim.plants.plant import (
    Energies,
    Event,
    FlywheelCommand,
    FlywheelRateCommand,
    JumpMotorCommand,
    Outcome,
    PlantCommand,
    StepResult,
    WheelRateCommand,
    WheelTorqueCommand,
)
from rover_sim.scenarios.scenario import load_planar

SPRING_RATE = 824.0
FREE_TRAVEL = 0.06
STROKE = 0.35
LENGTH = 5.0
FLYWHEEL_INERTIA = 1e-3


@dataclass(frozen=True)
class FakeState:
    time: float = 0.0
    phase: PlantPhase = PlantPhase.HELD
    compression: float = 0.0
    length: float = LENGTH
    payout_rate: float = 0.0
    brake_released: bool = False
    wheel_rate: float = 0.0
    flywheel_rate: float = 0.0
    nut_rate: float = 0.0


class FakePlant:
    """A nut that follows its setpoint, a latch that trips there, and a flight of 0.5 s.

    The drum pays out at the commanded rate while its brake is released; wheels and flywheel follow
    their commands.

    Attributes:
        diverges_at: time at which it diverges [s].
        commands: every command that it received.
    """

    def __init__(self, diverges_at: float = math.inf) -> None:
        self.scenario = load_planar("paper_table1_low")
        self.diverges_at = diverges_at
        self.commands: list[PlantCommand] = []
        self.error: Exception | None = None

    def initial_state(self) -> FakeState:
        return FakeState()

    def energies(self, state: FakeState) -> Energies:
        return Energies(0.0, 0.0, 0.0, 0.0, 0.0)

    def step(
        self, state: FakeState, command: PlantCommand, dt: float
    ) -> tuple[FakeState, StepResult]:
        if self.error is not None:
            raise self.error
        self.commands.append(command)
        if state.phase.final:
            return state, self._result(Outcome.DIVERGED)
        time = state.time + dt
        if time > self.diverges_at + 1e-9:
            event = Event(PlantEvent.DIVERGED, state.time)
            return replace(state, phase=PlantPhase.DIVERGED), self._result(Outcome.DIVERGED, event)
        after = self._moved(replace(state, time=time), command, dt)
        if state.phase is PlantPhase.FLIGHT:
            if time >= 0.5:
                return replace(after, phase=PlantPhase.LANDED), self._result(Outcome.CONVERGED)
            return after, self._result(Outcome.CONVERGED)
        jump = command.jump
        if not isinstance(jump, JumpMotorCommand):
            return after, self._result(Outcome.CONVERGED)
        travel = jump.compression - state.compression
        moved = state.compression + math.copysign(min(abs(travel), jump.rate * dt), travel)
        if jump.trips and jump.compression > 0.0 and abs(travel) <= jump.rate * dt:
            event = Event(PlantEvent.TAKE_OFF, state.time + abs(travel) / jump.rate, {"speed": 1.0})
            flying = replace(after, phase=PlantPhase.FLIGHT, compression=0.0)
            return flying, self._result(Outcome.CONVERGED, event)
        rate = (moved - state.compression) / dt
        return replace(after, compression=moved, nut_rate=rate), self._result(Outcome.HALVED)

    def _moved(self, state: FakeState, command: PlantCommand, dt: float) -> FakeState:
        """Winch, wheels and flywheel after a tick."""
        winch, wheel, jump = command.winch, command.wheel, command.jump
        released = winch is not None and winch.brake_released
        rate = winch.rate if winch is not None and released else 0.0
        turning = 0.0
        if isinstance(wheel, WheelRateCommand):
            turning = wheel.rate
        elif isinstance(wheel, WheelTorqueCommand):
            turning = state.wheel_rate + wheel.torque * dt
        return replace(
            state,
            length=state.length + rate * dt,
            payout_rate=rate,
            brake_released=released,
            wheel_rate=turning,
            flywheel_rate=_flywheel_rate(state, jump, dt),
            nut_rate=0.0,
        )

    def _result(self, outcome: Outcome, *events: Event) -> StepResult:
        return StepResult(outcome, self.energies(FakeState()), 0.0, 3, 1e-3, events, 2.0)


def _flywheel_rate(state: FakeState, command: object, dt: float) -> float:
    if isinstance(command, FlywheelRateCommand):
        return command.rate
    if isinstance(command, FlywheelCommand):
        return state.flywheel_rate + command.torque / FLYWHEEL_INERTIA * dt
    return state.flywheel_rate


DECELERATIONS = QuickStopDecelerations(winch=0.4, wheels=2.0, flywheel=50.0, nut=0.25)
EVERYTHING = Equipment(
    "fake",
    nut=Nut(SPRING_RATE, STROKE, FREE_TRAVEL, holds=True),
    flywheel=True,
    wheels=True,
    quick_stop=DECELERATIONS,
)
"""Drives as the spatial plant has them."""

HELD_BY_THE_GROUND = Equipment("fake", nut=Nut(SPRING_RATE, needs_ground=True), fixed_length=LENGTH)
"""Drives as the planar plant has them."""


class FakeInterface:
    """The outside of a fake plant: a clock and a drum.

    Attributes:
        measured: time of each measured state [s].
    """

    topics = (topics.CLOCK, topics.WINCH_STATE)
    available_after_tick: frozenset[str] = frozenset()

    def __init__(self, plant: FakePlant, equipment: Equipment = HELD_BY_THE_GROUND) -> None:
        self.plant = plant
        self.equipment = equipment
        self.measured: list[float] = []
        self._last = (FakeState(), 0)

    def drive_feedback(self, state: FakeState) -> DriveFeedback:
        held = state.compression > 0.0
        return DriveFeedback(
            state.phase,
            state.compression,
            not held,
            held,
            state.length,
            state.payout_rate,
            not state.brake_released,
            state.nut_rate,
            state.flywheel_rate,
            state.wheel_rate,
        )

    def restart(self, state: FakeState, stamp_ns: int) -> None:
        self.measured = [state.time]
        self._last = (state, stamp_ns)

    def measure(self, state: FakeState, stamp_ns: int, result: StepResult) -> None:
        self.measured.append(state.time)
        self._last = (state, stamp_ns)

    def samples(self, due: Iterable[str]) -> Iterator[tuple[str, Sample]]:
        state, stamp_ns = self._last
        drum = JointValue(state.length, state.payout_rate)
        brake = JointValue(float(state.brake_released))
        made: dict[str, Sample] = {
            topics.CLOCK: ClockSample(stamp_ns),
            topics.WINCH_STATE: JointSample(
                stamp_ns, {machine.WINCH_DRUM: drum, machine.WINCH_BRAKE: brake}
            ),
        }
        return ((name, made[name]) for name in due)

    def environment_markers(self, stamp_ns: int) -> DrawingSample:
        return DrawingSample(stamp_ns, ())


def fake_interface(equipment: Equipment = HELD_BY_THE_GROUND, **options: Any) -> FakeInterface:
    """Return a fake plant in its interface."""
    return FakeInterface(FakePlant(**options), equipment)
