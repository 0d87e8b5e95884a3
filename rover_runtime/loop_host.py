"""The loop host: carries components in one thread, by simulated time, without ROS.

A tick: every component receives the messages that are due, then makes the periodic calls that are
due, then the source of time advances. A message that is sent in tick k is received in tick k + d,
with d >= 1 drawn by ``Delays``: what a component does in a tick does not depend on the others. It
receives in the order of the contract's table. So the same components, requests and seed give the
same messages, on any machine, also spread over hosts that ``rover_runtime.lockstep`` joins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

from msg_schemas.access import Act, nodes_that
from msg_schemas.parameters import ParameterError, from_mapping
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Sample
from msg_schemas.table import find_topic
from rover_runtime.component import Component, Groups
from rover_runtime.delays import Delays
from rover_runtime.loop_port import LoopChannel, LoopPort, LoopStepper
from rover_runtime.message_exchange import MessageExchange
from rover_runtime.pacing import NANO, TimeSource
from rover_runtime.remote import OPERATOR
from rover_runtime.worker_process import InlineWorker, Worker

T = TypeVar("T")
C = TypeVar("C", bound=Component)


@dataclass
class ServiceResponse:
    """Response to a request from outside; ``success`` is None until it is there."""

    success: bool | None = None
    message: str = ""


class LoopHost:
    """Carries components in one thread.

    Args:
        delays: of the messages.
        tick: duration of a tick where no component is the source of time [s].
        order: names of all components of all hosts that share simulated time; a component receives
            from others in this order.
        namespace: of the components; empty or with a leading slash.

    Attributes:
        exchange: messages and services between the components.
        worker: computes what takes longer than a tick.
        log: called with name, level and text of each line of the log.
    """

    def __init__(
        self,
        delays: Delays | None = None,
        tick: float = 0.01,
        order: Sequence[str] = (),
        namespace: str = "",
    ) -> None:
        self.namespace = namespace
        self.exchange = MessageExchange(delays or Delays(), (OPERATOR, *order), self.now_ns)
        self.worker: Worker = InlineWorker()
        self.log: Callable[[str, Level, str], None] = lambda _name, _level, _text: None
        self._tick_ns = round(tick * NANO)
        self._now_ns = 0
        self._elapsed_ns = 0  # goes on while simulated time is paused
        self._components: dict[str, Component] = {}
        self._instances: dict[str, int] = {}
        self._time: tuple[LoopPort, LoopStepper] | None = None
        self._operator = self._new_port(OPERATOR)
        self._operator_channels: dict[str, LoopChannel] = {}

    # --- components ------------------------------------------------------------------------------

    def start(self, component_class: type[C], parameters: Mapping[str, object] | None = None) -> C:
        """Create, configure and activate a component.

        Args:
            component_class: what it does.
            parameters: values by name; absent ones keep their defaults.

        Raises:
            ParameterError: a parameter is unknown or wrong.
            ValueError: a component of this name runs.
        """
        name = component_class.NAME
        if name in self._components:
            msg = f"{name} runs already"
            raise ValueError(msg)
        component = self.add(component_class, _groups(component_class, parameters))
        try:
            component.configure()
            component.activate()
        except Exception:
            self.kill(name)
            raise
        return component

    def add(self, component_class: type[C], groups: Groups, ros_node: Any = None) -> C:
        """Create a component, which somebody else configures and activates.

        Args:
            component_class: what it does.
            groups: values of its parameter classes.
            ros_node: the rclpy node that shows it in the graph, if there is one.
        """
        name = component_class.NAME
        port = self._new_port(name)
        port.ros_node = ros_node
        component = self._components[name] = component_class(port, groups)
        return component

    def __getitem__(self, name: str) -> Component:
        """Return the component of this name."""
        return self._components[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components that run."""
        return tuple(self._components)

    def kill(self, name: str) -> None:
        """End a component at once, as SIGKILL ends a process."""
        del self._components[name]
        port = self.exchange.remove(name)
        port.is_alive = False
        if self._time is not None and self._time[0] is port:
            self._time[1].stop()

    def stop(self, name: str) -> None:
        """Deactivate and release a component, as SIGTERM ends a process."""
        self._components[name].clean_up()
        self.kill(name)

    def freeze(self, name: str) -> None:
        """Halt a component, as SIGSTOP halts a process; its messages wait."""
        self.exchange.ports[name].is_frozen = True

    def thaw(self, name: str) -> None:
        """Let a frozen component go on with the messages that its queues have kept."""
        port = self.exchange.ports[name]
        port.is_frozen = False
        self.exchange.deliver_backlog(port)

    # --- time ------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self._now_ns if self._time is None else self._time[1].source.stamp_ns

    def elapsed_ns(self) -> int:
        """Time of all ticks [ns], those included in which simulated time was paused."""
        return self._elapsed_ns

    @property
    def has_source(self) -> bool:
        """Whether a component of this host is the source of time."""
        return self._time is not None

    @property
    def next_ns(self) -> int:
        """Simulated time of the next tick [ns]."""
        if self._time is None:
            return self._now_ns + self._tick_ns
        source = self._time[1].source
        return source.next_ns if self._is_advancing else source.stamp_ns

    @property
    def _is_advancing(self) -> bool:
        if self._time is None:
            return False
        port, stepper = self._time
        return stepper.is_running and not stepper.source.paused and not port.is_frozen

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.now_ns() / NANO

    def tick(self) -> None:
        """Deliver what is due, make the periodic calls, and advance time by one tick."""
        self.step()
        self.advance(self.next_ns)

    def computing(self, now_ns: int) -> tuple[str, ...]:
        """Components whose computations are late at a time [ns], so that time should wait."""
        return tuple(
            name
            for name, port in self.exchange.ports.items()
            if any(work.is_late(now_ns) for work in port.works)
        )

    def step(self) -> None:
        """Deliver what is due, and make the periodic calls."""
        if self._time is not None:
            self._time[1].begin()
        self.exchange.deliver()
        now_ns = self.now_ns()
        for port in tuple(self.exchange.ports.values()):
            if not port.is_frozen:
                port.calls.advance(now_ns)
                port.wall_calls.advance(self._elapsed_ns)
        self.exchange.ticks += 1

    def advance(self, next_ns: int) -> None:
        """Advance simulated time to the next tick.

        Args:
            next_ns: simulated time of the next tick [ns], where this host is not its source.
        """
        before_ns = self._now_ns
        if self._time is None:
            self._now_ns = next_ns
        else:
            if self._is_advancing:
                self._time[1].source.advance()
            self._now_ns = self._time[1].source.stamp_ns
        passed_ns = self._now_ns - before_ns
        self._elapsed_ns += passed_ns if passed_ns > 0 else self._tick_ns
        if passed_ns < 0:
            self._go_back()

    def _go_back(self) -> None:
        now_ns = self.now_ns()
        for name, component in self._components.items():
            port = self.exchange.ports[name]
            port.calls.restart(now_ns)
            if self._time is None or port is not self._time[0]:
                component.clock_went_back()

    def run(self, duration: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Run until a condition holds, for a simulated time [s] at most; whether it holds.

        It returns after as many ticks without progress where time stands still.
        """
        end_ns = self.now_ns() + round(duration * NANO)
        standing = 0
        while not until():
            before_ns = self.now_ns()
            if before_ns >= end_ns or standing * self._tick_ns >= duration * NANO:
                return False
            self.tick()
            standing = standing + 1 if self.now_ns() == before_ns else 0
        return True

    def time_stepper(self, port: LoopPort, source: TimeSource, factor: float) -> LoopStepper:
        """Make a component the source of time, at a real-time factor that ``pace`` keeps."""
        stepper = LoopStepper(source, factor)
        self._time = port, stepper
        return stepper

    def pace(self, wall: float) -> float:
        """Return the wall time to wait before the next tick [s], at a wall time [s]."""
        if self._time is None:
            return 0.0
        _, stepper = self._time
        if not self._is_advancing:
            return self._tick_ns / NANO
        return stepper.pacer.wait(wall, stepper.source.stamp_ns)

    # --- requests from outside -------------------------------------------------------------------

    def request(self, topic: str, sample: Sample, requester: str = OPERATOR) -> None:
        """Send a request from outside."""
        if topic not in self._operator_channels:
            self._operator_channels[topic] = self._operator.publish(find_topic(topic))
        row = find_topic(topic)
        self._operator_channels[topic].send(sample, "" if row.frame else requester)

    def call(self, service: str, *arguments: bool) -> ServiceResponse:
        """Call a service from outside.

        Raises:
            Refusal: the service has no server.
        """
        response = ServiceResponse()

        def answered(success: bool, message: str) -> None:
            response.success, response.message = success, message

        if not self.exchange.call_from(self._operator, service, arguments, answered):
            servers = ", ".join(nodes_that(Act.SERVE, service))
            reason = f"the service has no server; {servers} should run"
            raise Refusal(service, RefusalCode.NOT_ACTIVE, reason)
        return response

    def _new_port(self, name: str) -> LoopPort:
        """Return a port for a new instance of a component."""
        instance = self._instances[name] = self._instances.get(name, 0) + 1
        port = LoopPort(self, self.exchange.number(name), name, str(instance))
        self.exchange.ports[name] = port
        return port


def _groups(component_class: type[Component], parameters: Mapping[str, object] | None) -> Groups:
    left = dict(parameters or {})
    groups: Groups = {}
    for cls in component_class.PARAMETERS:
        mine = {each.name: left.pop(each.name) for each in fields(cls) if each.name in left}
        groups[cls] = from_mapping(cls, mine)
    if left:
        names = [each.name for cls in component_class.PARAMETERS for each in fields(cls)]
        msg = (
            f"{component_class.NAME} has no parameter {', '.join(left)}; it has {', '.join(names)}"
        )
        raise ParameterError(msg)
    return groups
