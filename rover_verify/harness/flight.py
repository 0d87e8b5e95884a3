"""A flight: the shipped plant and controllers, as a launch file starts them, on the loop host.

Only the checks use the ground truth.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from msg_schemas import topics
from msg_schemas.commands import CommandRecord, read_command
from msg_schemas.refusal import RefusalReport, read_refusal
from msg_schemas.samples import JointSample, JointValue, Sample, Status, StatusSample, TextSample
from rover_control.mission.mission_node import MissionNode
from rover_control.mission.mission_supervisor import Mission
from rover_launch.loop import Parameters, component_class, make_plan, start_plan
from rover_launch.plan import HANGING_DEFAULTS
from rover_runtime.delays import Delays
from rover_runtime.loop_host import LoopHost, ServiceResponse
from rover_runtime.message_exchange import Listener
from rover_sim import SpatialPlant, SpatialState
from rover_sim.interface.spatial_interface import SpatialInterface
from rover_sim.node.sim_loop import Simulation, Tick
from rover_sim.node.sim_node import SimNode
from rover_sim.plants.plant import Outcome, StepResult
from tether_winch.winch import WinchController
from tether_winch.winch_node import WinchNode

MISSION = ("winch_node", "descent_node", "drive_node", "jump_node", "mission_node")
"""Controllers of the launch file ``mission``."""
DESCENT = ("winch_node", "descent_node")
"""Controllers of the launch file ``descent``."""
JUMP = ("winch_node", "drive_node", "jump_node")
"""Controllers of the launch file ``jump``, and ``drive_node``."""
WINCH = ("winch_node",)

_ANSWER_LIMIT = 1.0  # simulated time [s]


class ReceivedEvent(NamedTuple):
    """An event with the time and the node that published it."""

    time: float  # [s]
    node: str
    status: Status

    @property
    def name(self) -> str:
        """Name of the event."""
        return self.status.name

    @property
    def values(self) -> Mapping[str, str]:
        """Declared values."""
        return self.status.values


class Flight:
    """A plant, controllers and their messages.

    Args:
        controllers: executables, such as ``MISSION``.
        scenario: name.
        overrides: of the scenario by dotted path.
        seed: of the sensors' errors.
        parameters: of the nodes, where they differ from the shipped ones.
        delays: of the messages.
        defaults: arguments of the launch file.
        listener: receives each sample that is sent, from the start.

    Attributes:
        events: of all nodes.
        refusals: of all nodes, with their times [s].
        commands: all records of all nodes, as they were published.
        phases: last text of each latched topic.
        last: last sample of each topic that was asked for by ``keep``.
        peak_tension: largest tension in the tether [N].
        energy_residual: largest error of the plant's energy balance [J].
    """

    def __init__(
        self,
        controllers: Sequence[str],
        scenario: str,
        overrides: Mapping[str, object] | None = None,
        *,
        seed: int = 1,
        parameters: Parameters | None = None,
        delays: Delays | None = None,
        defaults: Mapping[str, str] = HANGING_DEFAULTS,
        listener: Listener | None = None,
    ) -> None:
        self.host = LoopHost(delays)
        self.events: list[ReceivedEvent] = []
        self.refusals: list[tuple[float, RefusalReport]] = []
        self.commands: list[CommandRecord] = []
        self.phases: dict[str, str] = {}
        self.last: dict[str, Sample] = {}
        self.peak_tension = 0.0
        self.energy_residual = 0.0
        listen = self.host.exchange.listen
        listen(self._on_statuses, topics.COMMANDS, topics.EVENTS, topics.DIAGNOSTICS)
        listen(
            self._on_phase,
            topics.WINCH_MODE,
            topics.DESCENT_PHASE,
            topics.DRIVE_PHASE,
            topics.JUMP_PHASE,
            topics.MISSION_PHASE,
        )
        if listener is not None:
            listen(listener)
        merged = json.loads(defaults.get("overrides", "{}")) | dict(overrides or {})
        given = {"scenario": scenario, "overrides": json.dumps(merged), "seed": str(seed)}
        planned = make_plan(controllers, defaults, given)
        changed = {"mission_node": {"checkpoint": "none"}, **(parameters or {})}
        self.parameters = start_plan(self.host, planned, changed)
        sim = self.host["sim_node"]
        assert isinstance(sim, SimNode)
        self.sim = sim
        self.simulation: Simulation[SpatialState] = sim.simulation
        sim.observers.append(self._on_tick)
        self._scenario = self.plant.scenario

    # --- state -----------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.host.time

    @property
    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self.host.now_ns()

    @property
    def plant(self) -> SpatialPlant:
        """The true machine."""
        plant = self.simulation.plant
        assert isinstance(plant, SpatialPlant)
        return plant

    @property
    def state(self) -> SpatialState:
        """The true state."""
        return self.simulation.state

    @property
    def result(self) -> StepResult:
        """Result of the last tick."""
        result = self.simulation.last
        assert result is not None, "no tick was simulated"
        return result

    @property
    def mission(self) -> Mission:
        """The mission's supervisor, which only checks may read."""
        node = self.host["mission_node"]
        assert isinstance(node, MissionNode)
        return node.mission

    @property
    def winch(self) -> WinchController:
        """The winch's controller, which only checks may read."""
        node = self.host["winch_node"]
        assert isinstance(node, WinchNode)
        return node.winch

    @property
    def tilt(self) -> float:
        """True inclination of the rover [rad]."""
        return math.acos(min(max(float(self.state.rotation[2, 2]), -1.0), 1.0))

    def events_named(self, name: str, node: str = "") -> list[ReceivedEvent]:
        """Events of this name, of one node or of all."""
        return [each for each in self.events if each.name == name and node in ("", each.node)]

    # --- simulation ------------------------------------------------------------------------------

    def run(self, limit: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Run until a condition holds, for a simulated time [s] at most; whether it holds.

        Raises:
            RuntimeError: the plant cannot continue.
        """
        return self.host.run(limit, until)

    def call(self, service: str, *arguments: bool) -> ServiceResponse:
        """Call a service and run until it has answered."""
        response = self.host.call(service, *arguments)
        self.run(_ANSWER_LIMIT, lambda: response.success is not None)
        return response

    def go(self) -> None:
        """Start the mission.

        Raises:
            RuntimeError: it refuses.
        """
        response = self.call(topics.MISSION_GO)
        if not response.success:
            raise RuntimeError(f"the mission does not start: {response.message}")

    def request(
        self, topic: str, joint: str, position: float, velocity: float = 0.0, effort: float = 0.0
    ) -> None:
        """Send a request of one joint, as an operator does."""
        value = JointValue(position, velocity, effort)
        self.host.request(topic, JointSample(self.now_ns, {joint: value}))

    def keep(self, *names: str) -> None:
        """Keep the last sample of these topics in ``last``."""
        self.host.exchange.listen(self._on_sample, *names)

    def exchange_plant(self, overrides: Mapping[str, object]) -> None:
        """Exchange the machine and its surroundings at once; state and sensors stay.

        Args:
            overrides: of the flight's scenario; none = as at the start.
        """
        interface = self.simulation.interface
        assert isinstance(interface, SpatialInterface)
        plant = SpatialPlant(self._scenario.with_overrides(overrides))
        self.simulation.plant = interface.plant = plant

    def kill(self, node: str) -> None:
        """Kill a node."""
        self.host.kill(node)

    def restart(self, node: str) -> None:
        """Start a killed node with its parameters."""
        self.host.start(component_class(node), self.parameters[node])

    # --- messages --------------------------------------------------------------------------------

    def _on_tick(self, tick: Tick[Any]) -> None:
        if tick.result.outcome in (Outcome.DIVERGED, Outcome.TETHER_BROKEN):
            raise RuntimeError(f"{tick.result.outcome.value} after {self.time:.3g} s")
        self.peak_tension = max(self.peak_tension, tick.result.peak_tension)
        self.energy_residual = max(self.energy_residual, abs(tick.result.energies.drift))

    def _on_statuses(self, name: str, sample: Sample, _sender: str, now_ns: int) -> None:
        assert isinstance(sample, StatusSample)
        for status in sample.statuses:
            if name == topics.EVENTS:
                self.events.append(ReceivedEvent(now_ns * 1e-9, status.hardware_id, status))
            elif name == topics.COMMANDS:
                record = read_command(status)
                assert record is not None
                self.commands.append(record)
            elif (refusal := read_refusal(status)) is not None:
                self.refusals.append((now_ns * 1e-9, refusal))

    def _on_phase(self, name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, TextSample)
        self.phases[name] = sample.text

    def _on_sample(self, name: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        self.last[name] = sample
