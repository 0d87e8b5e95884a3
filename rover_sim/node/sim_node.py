"""The ``sim_node`` executable: the simulated plant with the contract's topics and services.

The plant is imported when the node is configured: meanwhile the middleware discovers the other
nodes, among which there must be no second plant.
"""

from __future__ import annotations

import secrets
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from msg_schemas import topics
from msg_schemas.events import EventReport, SimulationEvent
from msg_schemas.parameters import parameter
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import Level, Status, StatusSample
from rover_runtime.component import Component, ExitCode, Groups
from rover_runtime.pacing import NANO
from rover_runtime.port import Port
from rover_sim.node.publishing_rates import TruthRates, rate_parameter, table_rate

if TYPE_CHECKING:
    from rover_sim.node.sim_loop import Simulation, Tick
    from rover_sim.node.sim_runner import SimRunner
    from rover_sim.scenarios.scenario import AnyScenario

AS_SCENARIO = "scenario"
MODELS = ("planar", "spatial")


@dataclass(frozen=True)
class SimParameters:
    """Scenario and timing of the simulation."""

    scenario: str = parameter(
        "paper_table1_high",
        "-",
        "name of a scenario of the package, or path of a .yaml file",
        read_only=True,
    )
    overrides: str = parameter(
        "",
        "-",
        "overrides of the scenario as YAML or JSON, by dotted path: "
        '{"start.slack": 2.0, "tether.elements": 20}',
        read_only=True,
    )
    start_state: str = parameter(
        "",
        "-",
        "file of a saved state, in which the plant starts and to which it is reset; empty: the "
        "scenario's start",
        read_only=True,
    )
    model: str = parameter(
        AS_SCENARIO,
        "-",
        "scenario: the scenario's model; otherwise refuse a scenario of another model",
        choices=(AS_SCENARIO, *MODELS),
        read_only=True,
    )
    tick: float = parameter(
        0.01, "s", "control tick; commands take effect at ticks", 1e-4, 0.05, read_only=True
    )
    real_time_factor: float = parameter(
        1.0, "-", "simulated seconds per second; 0 = as fast as possible", 0.0, 1000.0
    )
    seed: int = parameter(
        1, "-", "seed of the sensors' errors; the scenario has that of the ground", 0, 2**31 - 1,
        read_only=True,
    )  # fmt: skip
    start_paused: bool = parameter(False, "-", "start with simulated time paused", read_only=True)
    duration: float = parameter(
        0.0, "s", "simulated time after which the node ends; 0 = never", 0.0, 1e9, read_only=True
    )


@dataclass(frozen=True)
class RateParameters(TruthRates):
    """Publishing rates, at most one sample per tick."""

    clock_rate: float = rate_parameter("rate of the clock", topics.CLOCK)
    sensor_rate: float = rate_parameter("rate of sensors and drives", topics.IMU)


class SimNode(Component):
    """Simulates tether and rover: publishes clock, sensors and truth, accepts drive commands."""

    NAME = "sim_node"
    SIM_PARAMETERS: type[SimParameters] = SimParameters
    PARAMETERS = (SIM_PARAMETERS, RateParameters)

    _runner: SimRunner | None = None
    _scenario: AnyScenario | None = None

    def __init__(self, port: Port, groups: Groups) -> None:
        super().__init__(port, groups)
        self.observers: list[Callable[[Tick[Any]], None]] = []  # called after each tick
        self._run = secrets.token_hex(8)  # a node that is restarted in it may go on

    # --- life ------------------------------------------------------------------------------------

    def setup(self) -> None:
        """Load the scenario, compile and build the plant, open topics and services."""
        from rover_sim.devices.actuators import COMMANDS  # noqa: PLC0415 - see above
        from rover_sim.node.sim_runner import SimRunner  # noqa: PLC0415
        from rover_sim.node.state_publisher import StatePublisher, start_of  # noqa: PLC0415

        parameters = self.parameters_of(self.SIM_PARAMETERS)
        rates = self.parameters_of(RateParameters)
        rates.check(parameters.tick)
        scenario = load(parameters)
        simulation = self.make_simulation(scenario, parameters)
        topic_rates = rates.of_topics(simulation.interface.topics, rates.sensor_rate)
        topic_rates[topics.CLOCK] = rates.clock_rate
        self._publisher = StatePublisher(self, simulation, topic_rates)
        self._status_publisher = self.publisher(topics.SIM_STATUS)
        runner = SimRunner(
            simulation,
            parameters.real_time_factor,
            self,
            self.time_stepper,
            paused=parameters.start_paused,
            duration=parameters.duration,
        )
        for name in COMMANDS:
            self.subscribe(name, partial(runner.command, name))
        self.serve(topics.SIM_PAUSE, lambda pause: (True, runner.pause(pause)))
        self.serve(topics.SIM_STEP, lambda: (True, runner.step()))
        self.serve(topics.SIM_RESET, lambda: (True, self._reset(runner, clock=True)))
        self.serve(topics.SIM_RESET_PLANT, lambda: (True, self._reset(runner, clock=False)))
        self._scenario, self._runner = scenario, runner
        self._start = start_of(simulation)

    def make_simulation(self, scenario: AnyScenario, parameters: SimParameters) -> Simulation[Any]:
        """Build the plant and its simulation."""
        from rover_sim.node.state_publisher import build_simulation  # noqa: PLC0415 - see above

        return build_simulation(
            scenario, parameters.seed, parameters.tick, self, parameters.start_state
        )

    def start(self) -> None:
        """Start simulated time."""
        if self._runner is not None:
            self._publisher.publish_static()
            self._runner.start()
        period = 1.0 / table_rate(topics.SIM_STATUS)
        self.every(period, self._publish_status, by_wall_clock=True)
        period = 1.0 / table_rate(topics.TRUTH_STATE)
        self.every(period, self._publish_paused_state, by_wall_clock=True)

    def stop(self) -> None:
        """Stop simulated time."""
        if self._runner is not None:
            self._runner.stop()

    def release(self) -> None:
        """Release the plant."""
        self._runner = self._scenario = None

    def configuration(self) -> Mapping[str, Any]:
        """Return the scenario with all values, the seed, and which run of the simulation it is.

        With a saved state, also that: a record can then be simulated again.
        """
        scenario = {} if self._scenario is None else self._scenario.to_mapping()
        seed = self.parameters_of(self.SIM_PARAMETERS).seed
        content = {"scenario": scenario, "seed": seed, "run": self._run}
        return content if self._runner is None else content | self._start

    def now_ns(self) -> int:
        """Return simulated time [ns]; this node is its source."""
        return 0 if self._runner is None else self._runner.stamp_ns

    def knows_time(self) -> bool:
        """Return True: this node is the source of simulated time."""
        return True

    def parameters_changed(self) -> None:
        """Apply the new real-time factor."""
        if self._runner is not None:
            self._runner.set_factor(self.parameters_of(self.SIM_PARAMETERS).real_time_factor)

    def _reset(self, runner: SimRunner, *, clock: bool) -> str:
        message = runner.reset(clock=clock)
        if clock:
            self.reception.forget_stamps()
        return message

    # --- called by the plant's thread ------------------------------------------------------------

    def on_tick(self, tick: Tick[Any], before_ns: int) -> None:
        """Publish the topics that are due."""
        self._publisher.on_tick(tick, before_ns)
        for observe in self.observers:
            observe(tick)

    def on_restart(self) -> None:
        """Publish the topics that need no preceding tick."""
        self._publisher.on_restart()

    def on_event(self, report: EventReport) -> None:
        """Publish an event."""
        self._publisher.on_event(report)

    def on_finish(self) -> None:
        """End the process at the end of the duration."""
        simulation = self.simulation
        phase, seconds = simulation.phase, simulation.stamp_ns / NANO
        text = f"simulated {seconds:g} s, the phase is {phase.value}"
        self.event(EventReport(SimulationEvent.FINISHED, text))
        self.exit_code = ExitCode.DIVERGED if phase is PlantPhase.DIVERGED else ExitCode.OK

    def on_crash(self, error: Exception) -> None:
        """End the process after an error of the plant's thread."""
        self.port.log(Level.ERROR, "".join(traceback.format_exception(error)))
        self.exit_code = ExitCode.CRASH

    @property
    def simulation(self) -> Simulation[Any]:
        """The running simulation; nothing may change it within a tick."""
        if self._runner is None:
            raise AssertionError("called without a running simulation")
        return self._runner.simulation

    # --- status ----------------------------------------------------------------------------------

    def _publish_status(self) -> None:
        status = self._status()
        self._status_publisher.send(StatusSample(self.now_ns(), (status,)))

    def _publish_paused_state(self) -> None:
        if self._runner is not None and self._runner.paused:
            self._publisher.publish_state()

    def health(self) -> tuple[Status, ...]:
        """Return the status of the plant and its pacing."""
        return () if self._runner is None else (self._status(),)

    def _status(self) -> Status:
        from rover_sim.devices.actuators import stopped  # noqa: PLC0415 - see above
        from rover_sim.node.state_publisher import run_statistics  # noqa: PLC0415

        runner = self._runner
        if runner is None:
            return Status(f"{self.NAME}: plant", "not configured")
        simulation, pacer = runner.simulation, runner.pacer
        phase, measured = simulation.phase, pacer.measured
        values = run_statistics(simulation) | {
            "paused": str(runner.paused).lower(),
            "real_time_factor": repr(pacer.factor),
            "measured_real_time_factor": "" if measured is None else f"{measured:.4g}",
            "wall_time_dropped": f"{pacer.dropped:.4g}",
        }
        level, message = Level.OK, "running"
        if phase.final:
            level, message = Level.ERROR, stopped(phase)
        elif runner.paused:
            message = "paused"
        elif not pacer.keeps_up(time.monotonic()):
            level = Level.WARN
            reached = "" if measured is None else f"; reached {measured:.3g}"
            message = f"too slow for a real-time factor of {pacer.factor:g}{reached}"
        return Status(f"{self.NAME}: plant", message, level, self.NAME, values)


def load(parameters: SimParameters) -> AnyScenario:
    """Load the scenario named by the parameters.

    Raises:
        ScenarioError: it does not exist or has invalid values; the overrides are not a mapping; or
            its model is not the one of the parameters.
    """
    from rover_sim.scenarios.scenario import ScenarioError, load_overridden  # noqa: PLC0415

    scenario = load_overridden(parameters.scenario, parameters.overrides)
    if parameters.model not in (AS_SCENARIO, scenario.model):
        raise ScenarioError(
            "model",
            parameters.model,
            f"the scenario {scenario.name} is {scenario.model}: should be {scenario.model}, or "
            f"{AS_SCENARIO} to use the scenario's model",
        )
    return scenario


def main() -> int:
    """Run the node."""
    from rover_runtime.ros.process import run  # noqa: PLC0415 - the loop host needs no ROS

    return run(SimNode)


if __name__ == "__main__":
    sys.exit(main())
