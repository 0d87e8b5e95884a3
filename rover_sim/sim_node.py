"""The ``sim_node`` executable: the plant, running behind the contract's topics and services."""

from __future__ import annotations

import dataclasses
import sys
import time
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from msg_schemas import topics
from msg_schemas.node import ContractNode, ExitCode, run
from msg_schemas.parameters import ParameterError, parameter
from msg_schemas.samples import Level, Status, StatusSample, TextSample
from msg_schemas.table import TOPICS
from msg_schemas.yaml_reader import read_yaml
from rover_sim.actuators import COMMANDS, stopped
from rover_sim.ahead_of_time import compile_ahead
from rover_sim.happenings import Happening
from rover_sim.interfaces import build_interface
from rover_sim.plant import Phase
from rover_sim.plants import build_plant
from rover_sim.scenario import AnyScenario, ScenarioError, load_scenario
from rover_sim.sim_loop import NANO, Schedule, Simulation, Tick
from rover_sim.sim_runner import SimRunner


def _table_rate(name: str) -> float:
    rate = TOPICS[name].rate
    if rate is None:
        raise AssertionError(f"{name} has no rate")
    return rate


AS_SCENARIO = "scenario"
MODELS = ("planar", "spatial")


@dataclass(frozen=True)
class SimParameters:
    """What is simulated, and how fast."""

    scenario: str = parameter(
        "paper_table1_high",
        "-",
        "name of a scenario of the package, or path of a .yaml file",
        read_only=True,
    )
    overrides: str = parameter(
        "",
        "-",
        "changes to the scenario as YAML or JSON, by dotted path: "
        '{"start.slack": 2.0, "tether.elements": 20}',
        read_only=True,
    )
    model: str = parameter(
        AS_SCENARIO,
        "-",
        "the plant that integrates it: that of the scenario, or refuse if it is not this one",
        choices=(AS_SCENARIO, *MODELS),
        read_only=True,
    )
    tick: float = parameter(
        0.01, "s", "control tick: commands take effect at ticks", 1e-4, 0.05, read_only=True
    )
    real_time_factor: float = parameter(
        1.0, "-", "simulated seconds per second; 0 = as fast as possible", 0.0, 1000.0
    )
    seed: int = parameter(
        1, "-", "seed of the sensors' errors; the ground's is in the scenario", 0, 2**31 - 1,
        read_only=True,
    )  # fmt: skip
    start_paused: bool = parameter(
        False, "-", "simulated time stands still until it is stepped or resumed", read_only=True
    )
    duration: float = parameter(
        0.0, "s", "end after this much simulated time; 0 = never", 0.0, 1e9, read_only=True
    )


def _rate(about: str, name: str) -> Any:
    return parameter(
        _table_rate(name), "Hz", f"{about}, in simulated time", 0.1, 1e4, read_only=True
    )


@dataclass(frozen=True)
class RateParameters:
    """How often is published; at most once a tick."""

    clock_rate: float = _rate("rate of the clock", topics.CLOCK)
    sensor_rate: float = _rate("rate of sensors and drives", topics.IMU)
    truth_rate: float = _rate("rate of the bodies' true motion and the energy", topics.TRUTH_BODY1)
    tether_rate: float = _rate("rate of the tether's true shape", topics.TRUTH_TETHER)
    camera_rate: float = _rate("rate of the wall camera's figures", topics.CAMERA)
    marker_rate: float = _rate("rate of markers to look at", topics.MARKERS)

    def check(self, tick: float) -> None:
        """Refuse rates that the tick does not allow."""
        for field in dataclasses.fields(self):
            rate = getattr(self, field.name)
            if rate * tick > 1.0 + 1e-9:
                msg = (
                    f"{field.name} is {rate:g} Hz, it must be at most {1.0 / tick:g} Hz, "
                    f"once per tick of {tick:g} s"
                )
                raise ParameterError(msg)

    def of_topics(self, wanted: Iterable[str]) -> dict[str, float]:
        """Rate [Hz] of each of the wanted topics."""
        rates = {
            topics.CLOCK: self.clock_rate,
            topics.TRUTH_BODY1: self.truth_rate,
            topics.TRUTH_BODY2: self.truth_rate,
            topics.TRUTH_ENERGY: self.truth_rate,
            topics.TRUTH_TETHER: self.tether_rate,
            topics.CAMERA: self.camera_rate,
            topics.MARKERS: self.marker_rate,
        }
        return {name: rates.get(name, self.sensor_rate) for name in wanted}


class SimNode(ContractNode):
    """Simulates tether and rover: publishes clock, sensors and truth, obeys actuator commands."""

    NAME = "sim_node"
    PARAMETERS = (SimParameters, RateParameters)

    _runner: SimRunner | None = None
    _scenario: AnyScenario | None = None
    _told_phase: Phase | None = None

    # --- life ------------------------------------------------------------------------------------

    def setup(self) -> None:
        """Load the scenario, compile and build the plant, open everything."""
        wanted = self.parameters_of(SimParameters)
        rates = self.parameters_of(RateParameters)
        rates.check(wanted.tick)
        scenario = load(wanted)
        self.get_logger().info(
            f"scenario {scenario.name}: compiling (tens of seconds the first time on a machine, "
            "a second or two from then on)"
        )
        begin = time.monotonic()
        if not compile_ahead(scenario):
            self.get_logger().warning(
                "the compiled code cannot be kept: results may differ from other runs in their "
                "last bits"
            )
        plant = build_plant(scenario)
        plant.warm_up()
        outside = build_interface(plant, wanted.seed)
        simulation = Simulation(outside, wanted.tick)
        self.get_logger().info(f"compiled and at rest after {time.monotonic() - begin:.1f} s")
        self._schedule = Schedule(rates.of_topics(outside.topics))
        self._outlets = {name: self.publisher(name) for name in outside.topics}
        self._phase_outlet = self.publisher(topics.TRUTH_PHASE)
        self._status_outlet = self.publisher(topics.SIM_STATUS)
        self._place_outlet = self.publisher(topics.PLACE)
        runner = SimRunner(
            simulation,
            wanted.real_time_factor,
            self,
            paused=wanted.start_paused,
            duration=wanted.duration,
        )
        for name in COMMANDS:
            self.subscribe(name, partial(runner.command, name))
        self.serve(topics.SIM_PAUSE, lambda pause: (True, runner.pause(pause)))
        self.serve(topics.SIM_STEP, lambda: (True, runner.step()))
        self.serve(topics.SIM_RESET, lambda: (True, self._reset(runner, clock=True)))
        self.serve(topics.SIM_RESET_PLANT, lambda: (True, self._reset(runner, clock=False)))
        self._scenario, self._runner = scenario, runner

    def start(self) -> None:
        """Let simulated time run."""
        if self._runner is not None:
            self._place_outlet.send(self._simulation.interface.place(self.now_ns()))
            self._runner.start()
        period = 1.0 / _table_rate(topics.SIM_STATUS)
        self.every(period, self._publish_status, by_wall_clock=True)

    def stop(self) -> None:
        """Stop simulated time where it is."""
        if self._runner is not None:
            self._runner.stop()

    def release(self) -> None:
        """Let go of the plant."""
        self._runner = self._scenario = self._told_phase = None

    def configuration(self) -> Mapping[str, Any]:
        """Scenario with all values, and the seed."""
        scenario = {} if self._scenario is None else self._scenario.to_mapping()
        return {"scenario": scenario, "seed": self.parameters_of(SimParameters).seed}

    def now_ns(self) -> int:
        """Simulated time [ns]: this node is the clock."""
        return 0 if self._runner is None else self._runner.stamp_ns

    def parameters_changed(self) -> None:
        """Take the new real-time factor."""
        if self._runner is not None and self.active:
            self._runner.set_factor(self.parameters_of(SimParameters).real_time_factor)

    def _reset(self, runner: SimRunner, *, clock: bool) -> str:
        message = runner.reset(clock=clock)
        if clock:
            self.accept_earlier_stamps()
        return message

    # --- told by the plant's thread ---------------------------------------------------------------

    def ticked(self, tick: Tick[Any], before_ns: int) -> None:
        """Publish what is due."""
        self._tell(self._schedule.due(before_ns, tick.stamp_ns))
        self._tell_phase(tick.after.phase)
        for happening in tick.happenings:
            self.happened(happening)

    def restarted(self) -> None:
        """Publish everything once that can be told without a tick before it."""
        outside = self._simulation.interface
        self._tell(name for name in outside.topics if name not in outside.measured_over_a_tick)
        self._tell_phase(self._simulation.phase)

    def _tell(self, due: Iterable[str]) -> None:
        heard = [name for name in due if self._outlets[name].is_heard]
        for name, sample in self._simulation.interface.samples(heard):
            self._outlets[name].send(sample)

    def happened(self, happening: Happening) -> None:
        """Publish an event; what is not well goes to the diagnostics too."""
        self.event(
            happening.name,
            happening.message,
            happening.level,
            happening.values,
            happening.stamp_ns,
        )
        if happening.level is not Level.OK:
            name = f"{self.NAME}: {happening.name}"
            self.report(Status(name, happening.message, happening.level, self.NAME))

    def finished(self) -> None:
        """End the process: the wanted duration is over."""
        simulation = self._simulation
        phase, seconds = simulation.phase, simulation.stamp_ns / NANO
        self.event("finished", f"simulated {seconds:g} s, the phase is {phase.value}")
        self.exit_code = ExitCode.DIVERGED if phase is Phase.DIVERGED else ExitCode.OK

    def crashed(self, error: Exception) -> None:
        """End the process: the plant's thread is gone."""
        self.get_logger().fatal("".join(traceback.format_exception(error)))
        self.exit_code = ExitCode.CRASH

    @property
    def _simulation(self) -> Simulation[Any]:
        if self._runner is None:
            raise AssertionError("told by a thread that does not run")
        return self._runner.simulation

    def _tell_phase(self, phase: Phase) -> None:
        if phase is not self._told_phase:
            self._told_phase = phase
            self._phase_outlet.send(TextSample(phase.value))

    # --- status ----------------------------------------------------------------------------------

    def _publish_status(self) -> None:
        status = self._status()
        self._status_outlet.send(StatusSample(self.now_ns(), (status,)))

    def health(self) -> tuple[Status, ...]:
        """Whether the plant is well and keeps its pace."""
        return () if self._runner is None else (self._status(),)

    def _status(self) -> Status:
        runner = self._runner
        if runner is None:
            return Status(f"{self.NAME}: plant", "not configured")
        simulation, pacer = runner.simulation, runner.pacer
        phase, result, measured = simulation.phase, simulation.last, pacer.measured
        values: dict[str, str] = {
            "phase": phase.value,
            "paused": str(runner.paused).lower(),
            "simulated_time": repr(simulation.stamp_ns / NANO),
            "real_time_factor": repr(pacer.factor),
            "measured_real_time_factor": "" if measured is None else f"{measured:.4g}",
            "wall_time_given_up": f"{pacer.given_up:.4g}",
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
        level, message = Level.OK, "running"
        if phase.final:
            level, message = Level.ERROR, stopped(phase)
        elif runner.paused:
            message = "paused"
        elif not pacer.keeps_up(time.monotonic()):
            level = Level.WARN
            reached = "" if measured is None else f", it reaches {measured:.3g}"
            message = f"too slow for a real-time factor of {pacer.factor:g}{reached}"
        return Status(f"{self.NAME}: plant", message, level, self.NAME, values)


def load(wanted: SimParameters) -> AnyScenario:
    """Load the scenario that the parameters ask for.

    Raises:
        ScenarioError: it does not exist or holds bad values; the overrides are no mapping; or it is
            of another model than asked for.
    """
    overrides = read_yaml(wanted.overrides, name="overrides") if wanted.overrides.strip() else {}
    if not isinstance(overrides, Mapping):
        raise ScenarioError(
            "overrides", overrides, 'should be a mapping, such as {"start.slack": 2.0}'
        )
    scenario = load_scenario(wanted.scenario, overrides)
    if wanted.model not in (AS_SCENARIO, scenario.model):
        raise ScenarioError(
            "model",
            wanted.model,
            f"the scenario {scenario.name} is {scenario.model}: should be {scenario.model}, or "
            f"{AS_SCENARIO} to take what the scenario says",
        )
    return scenario


def main() -> int:
    """Run the node."""
    return run(SimNode)


if __name__ == "__main__":
    sys.exit(main())
