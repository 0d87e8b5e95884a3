"""Build a simulation for a node, and publish its state and events."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from msg_schemas import topics
from msg_schemas.events import EventReport
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import Level, TextSample
from rover_runtime.pacing import NANO
from rover_sim.interface.interface_factory import build_interface
from rover_sim.interface.robot_description import robot_description
from rover_sim.node.sim_loop import Schedule, Simulation, Tick
from rover_sim.plants.ahead_of_time import compile_ahead
from rover_sim.plants.plant_factory import build_plant
from rover_sim.plants.saved_state import START, plain_state, read_state
from rover_sim.plants.settled_states import settle_or_load
from rover_sim.plants.spatial_plant import SpatialPlant
from rover_sim.scenarios.scenario import AnyScenario, SpatialScenario

if TYPE_CHECKING:
    from rover_runtime.component import Component


def build_simulation(
    scenario: AnyScenario, seed: int, tick: float, node: Component, start_state: str = ""
) -> Simulation[Any]:
    """Compile and build a scenario's plant, and log the progress.

    Args:
        scenario: to simulate.
        seed: of the sensors' errors.
        tick: [s].
        node: logs the progress; its shutdown cancels the compilation.
        start_state: file of the state at the start; empty: the scenario's start.

    Raises:
        ScenarioError: the state is invalid or belongs to another scenario.
        ShutdownRequested: the node was shut down meanwhile.
    """
    values = read_state(start_state, scenario) if start_state else None
    node.port.log(
        Level.OK,
        f"scenario {scenario.name}: compiling (a minute or more on the first run of a machine, "
        "one or two seconds later)",
    )
    begin = time.monotonic()
    is_kept = compile_ahead(
        scenario,
        node.shutdown_requested,
        lambda duration, count: node.port.log(
            Level.OK, f"compiling for {duration:.0f} s, {count} functions done"
        ),
    )
    node.check_shutdown()
    if not is_kept:
        node.port.log(
            Level.WARN,
            "the compiled code cannot be cached: results may differ from other runs in the "
            "last bits",
        )
    plant = build_plant(scenario)
    plant.warm_up()
    if isinstance(plant, SpatialPlant) and is_kept and values is None:
        settle_or_load(plant)
    simulation = simulation_from(build_interface(plant, seed), tick, values)
    node.port.log(Level.OK, f"compiled and at rest after {time.monotonic() - begin:.1f} s")
    return simulation


def simulation_from(
    interface: Any, tick: float, values: Mapping[str, Any] | None
) -> Simulation[Any]:
    """Return a simulation that starts from a saved state; None: from the scenario's start.

    Raises:
        ScenarioError: the plant refuses the state.
    """
    start = None if values is None else interface.plant.restored_state(values)
    return Simulation(interface, tick, start)


def start_of(simulation: Simulation[Any]) -> dict[str, Any]:
    """Return the saved state from which a simulation starts, for the node's configuration."""
    start = simulation.saved_start
    return {} if start is None else {START: plain_state(start)}


class StatePublisher:
    """Publishes a simulation's topics, phase and events; called in the plant's thread.

    Args:
        node: that publishes.
        simulation: whose state is published.
        rates: topic -> rate in simulated time [Hz].
    """

    def __init__(
        self, node: Component, simulation: Simulation[Any], rates: Mapping[str, float]
    ) -> None:
        self._node = node
        self._simulation = simulation
        self._schedule = Schedule(rates)
        self._publishers = {name: node.publisher(name) for name in rates}
        self._phase_publisher = node.publisher(topics.TRUTH_PHASE)
        self._place_publisher = node.publisher(topics.PLACE)
        self._published_phase: PlantPhase | None = None
        scenario = simulation.plant.scenario
        self._description = ""
        if isinstance(scenario, SpatialScenario) and scenario.rover is not None:
            self._description = robot_description(scenario)
            self._description_publisher = node.publisher(topics.ROBOT_DESCRIPTION)

    def publish_static(self) -> None:
        """Publish the drawing of the environment and the robot description."""
        stamp_ns = self._simulation.stamp_ns
        self._place_publisher.send(self._simulation.interface.environment_markers(stamp_ns))
        if self._description:
            self._description_publisher.send(TextSample(self._description))

    def on_tick(self, tick: Tick[Any], before_ns: int) -> None:
        """Publish the topics that are due after a tick that began at `before_ns`."""
        self._publish_due(self._schedule.due(before_ns, tick.stamp_ns))
        self._publish_phase(tick.after.phase)
        for report in tick.event_reports:
            self.on_event(report)

    def on_restart(self) -> None:
        """Publish the topics that need no preceding tick."""
        interface = self._simulation.interface
        self._publish_due(
            name for name in self._publishers if name not in interface.available_after_tick
        )
        self._publish_phase(self._simulation.phase)

    def publish_state(self) -> None:
        """Publish the whole state, for those who save it while time is paused."""
        self._publish_due((topics.TRUTH_STATE,))

    def on_event(self, report: EventReport) -> None:
        """Publish an event, and on the diagnostics too if its level is not OK."""
        self._node.event(report, diagnoses=True)

    def _publish_due(self, due: Iterable[str]) -> None:
        # The clock last: on its arrival the controllers receive the other samples.
        ordered = sorted(due, key=lambda name: name == topics.CLOCK)
        subscribed = [name for name in ordered if self._publishers[name].has_subscribers]
        for name, sample in self._simulation.interface.samples(subscribed):
            self._publishers[name].send(sample)

    def _publish_phase(self, phase: PlantPhase) -> None:
        if phase is not self._published_phase:
            self._published_phase = phase
            self._phase_publisher.send(TextSample(phase.value))


def run_statistics(simulation: Simulation[Any]) -> dict[str, str]:
    """Return a simulation's statistics as values of a status."""
    result = simulation.last
    values = {
        "phase": simulation.phase.value,
        "simulated_time": repr(simulation.stamp_ns / NANO),
        "ticks": str(simulation.ticks),
        "commands": str(simulation.commands),
        "halved_ticks": str(simulation.halved_ticks),
        "peak_tension": repr(simulation.peak_tension),
    }
    if result is not None:
        values |= {
            "outcome": result.outcome.value,
            "newton_iterations": str(result.newton_iterations),
            "smallest_step": repr(result.smallest_step),
            "constraint_drift": repr(result.constraint_drift),
            "energy_drift": repr(result.energies.drift),
        }
    return values
