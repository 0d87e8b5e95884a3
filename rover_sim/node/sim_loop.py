"""Simulation loop: plant, clock and drive commands. Pure: no ROS, no waiting."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic

from msg_schemas.events import EventReport
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample
from rover_runtime.pacing import NANO
from rover_sim.devices.actuators import Actuators, DriveFeedback
from rover_sim.interface.event_reports import plant_event_report, timeout_report
from rover_sim.interface.plant_interface import PlantInterface
from rover_sim.plants.plant import Outcome, S, StepResult


@dataclass(frozen=True)
class Tick(Generic[S]):
    """One tick: states before and after, times, result and events."""

    before: S
    after: S
    dt: float  # [s]
    stamp_ns: int  # simulated time of `after`
    result: StepResult
    event_reports: tuple[EventReport, ...]


class Schedule:
    """Topics that are due after a tick, each at its rate in simulated time.

    Args:
        rates: topic -> rate [Hz], above 0.
    """

    def __init__(self, rates: Mapping[str, float]) -> None:
        self._names: dict[float, list[str]] = {}  # by rate
        for name, rate in rates.items():
            self._names.setdefault(rate, []).append(name)

    def due(self, before_ns: int, after_ns: int) -> list[str]:
        """Return the topics with a publishing instant in (before, after]."""
        return [
            name
            for rate, names in self._names.items()
            if _count(after_ns, rate) > _count(before_ns, rate)
            for name in names
        ]


def _count(stamp_ns: int, rate: float) -> int:
    # The small addend absorbs rounding: 0.29 s at 100 Hz is the 29th instant.
    return math.floor(stamp_ns * rate / NANO + 1e-6)


class Simulation(Generic[S]):
    """A running plant: state, simulated time, drive commands and statistics.

    Args:
        interface: of the plant.
        tick: control tick [s].
        start: state at the start and after a reset; None: the scenario's.
    """

    def __init__(self, interface: PlantInterface[S], tick: float, start: S | None = None) -> None:
        self.interface = interface
        self.plant = interface.plant
        self.tick_ns = round(tick * NANO)
        self._actuators = Actuators(interface.equipment, self.tick_ns)
        self.saved_start = start
        self._start = self.plant.initial_state() if start is None else start
        self.state = self._start
        self._feedback: tuple[S, DriveFeedback] | None = None  # of the drives in a state
        self.stamp_ns = 0
        self.ticks = 0
        self.halved_ticks = 0
        self.commands = 0
        self.peak_tension = 0.0
        self.last: StepResult | None = None
        interface.restart(self.state, 0)

    @property
    def phase(self) -> PlantPhase:
        """The plant's phase."""
        return self.state.phase

    def reset(self) -> None:
        """Reset state, clock and statistics."""
        self.stamp_ns = 0
        self.reset_plant()

    def reset_plant(self) -> None:
        """Reset the plant to its start; simulated time continues."""
        self._actuators.clear()
        self.state = self._start
        self.ticks = 0
        self.halved_ticks = 0
        self.commands = 0
        self.peak_tension = 0.0
        self.last = None
        self.interface.restart(self.state, self.stamp_ns)

    def fork(self) -> Simulation[S]:
        """Return an independent copy of the simulation; the stateless plant is shared.

        The sensors' errors of the copy continue as those of the original.
        """
        shared = {id(self.plant): self.plant}
        twin = copy.copy(self)
        twin.interface = copy.deepcopy(self.interface, shared)
        twin._actuators = copy.deepcopy(self._actuators, shared)
        return twin

    def accept_command(self, topic: str, sample: JointSample) -> None:
        """Accept a command of a topic of ``actuators.COMMANDS``; raises Refusal."""
        self._actuators.accept_command(topic, sample, self._drives, self.stamp_ns)
        self.commands += 1

    def quick_stop(self, topic: str) -> None:
        """Stop the drive of a topic of ``actuators.COMMANDS``, as its watchdog does."""
        self._actuators.quick_stop(topic, self._drives)

    def switch_off(self, topic: str) -> None:
        """Switch the drive of a topic of ``actuators.COMMANDS`` off at once."""
        self._actuators.switch_off(topic, self._drives)

    def is_stopping(self, topic: str) -> bool:
        """Whether the drive of a topic of ``actuators.COMMANDS`` is in its quick stop."""
        return self._actuators.is_stopping(topic)

    @property
    def _drives(self) -> DriveFeedback:
        """State of the drives."""
        if self._feedback is None or self._feedback[0] is not self.state:
            self._feedback = self.state, self.interface.drive_feedback(self.state)
        return self._feedback[1]

    def tick(self) -> Tick[S]:
        """Advance by one tick."""
        before, before_ns = self.state, self.stamp_ns
        timeouts = self._actuators.step(self._drives, before_ns)
        event_reports = [timeout_report(timeout, before_ns) for timeout in timeouts]
        dt = self.tick_ns / NANO
        after, result = self.plant.step(before, self._actuators.command, dt)
        for event in result.events:
            stamp_ns = before_ns + round((event.time - before.time) * NANO)
            if event.name == self._actuators.trip_event:
                self._actuators.on_latch_trip(stamp_ns)
            event_reports.append(
                plant_event_report(event, stamp_ns, after, result, self.plant.scenario)
            )
        if after.phase.final:
            self._actuators.clear()
        self.state = after
        self.stamp_ns += self.tick_ns
        self.ticks += 1
        self.halved_ticks += result.outcome is Outcome.HALVED
        self.peak_tension = max(self.peak_tension, result.peak_tension)
        self.last = result
        self.interface.measure(after, self.stamp_ns, result)
        return Tick(before, after, dt, self.stamp_ns, result, tuple(event_reports))
