"""The loop host: carries components in one thread, by simulated time, without ROS.

A tick: every component receives the messages that are due, then makes the periodic calls that are
due, then the source of time advances. A message that is sent in tick k is received in tick k + d,
with d >= 1 drawn by ``Delays``: what a component does in a tick does not depend on the others. It
receives in the order of the contract's table. So the same components, requests and seed give the
same messages, on any machine.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Generic, TypeVar

from msg_schemas import qos
from msg_schemas.access import Act, nodes_that
from msg_schemas.codecs import check_type, find_topic
from msg_schemas.parameters import ParameterError, from_mapping
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Sample
from msg_schemas.table import SERVICES, TOPICS, Topic
from rover_runtime.component import Component, Groups
from rover_runtime.delays import Delays
from rover_runtime.pacing import NANO, Pacer, TimeSource
from rover_runtime.periodic_calls import PeriodicCalls
from rover_runtime.port import Cancel, Message, Work

T = TypeVar("T")
C = TypeVar("C", bound=Component)

OPERATOR = "operator"
"""Name of the sender of requests from outside the host."""

_ORDER = {name: k for k, name in enumerate((*TOPICS, *SERVICES))}

Listener = Callable[[str, Sample, str, int], None]
"""Called with topic, sample, sender's text and time of sending [ns]."""


@dataclass
class ServiceResponse:
    """Response to a request from outside; ``success`` is None until it is there."""

    success: bool | None = None
    message: str = ""


@dataclass(eq=False)
class _Subscription:
    """A subscribed topic of a component."""

    port: LoopPort
    number: int
    topic: str
    receive: Callable[[Message], None]
    backlog: deque[Message]  # what arrived while the component was frozen

    def deliver(self, message: Message) -> None:
        if self.port.is_frozen:
            self.backlog.append(message)
        elif self.port.is_alive:
            self.receive(message)


@dataclass(order=True, slots=True)
class _Delivery:
    """What is due in a tick; sorted by receiver, topic, sender and sequence."""

    receiver: int
    topic: int
    sender: int
    sequence: int
    subscription: int
    deliver: Callable[[], None] = field(compare=False)


class _LoopChannel:
    """A topic that a component sends to."""

    def __init__(self, port: LoopPort, topic: Topic) -> None:
        self._port = port
        self._topic = topic
        self._sequence = 0
        self._last_due = 0
        self.kept: deque[Message] = deque(maxlen=qos.kept(topic.intent))  # for late joiners

    @property
    def has_subscribers(self) -> bool:
        return self._port.host.is_received(self._topic.name)

    def send(self, sample: Sample, sender: str) -> None:
        check_type(self._topic, sample)
        name, host = self._topic.name, self._port.host
        message = Message(sender, getattr(sample, "stamp_ns", 0), sample)
        self.kept.append(message)
        self._sequence += 1
        host.send(self._port, name, message, self._sequence, self._due(name))

    def _due(self, name: str) -> int:
        """Tick in which the message is received: never before an earlier message."""
        host = self._port.host
        delay = host.delays.draw(name, self._port.full_name, self._sequence)
        self._last_due = max(self._last_due, host.ticks + delay)
        return self._last_due

    def close(self) -> None:
        self._port.channels.remove(self)

    @property
    def topic(self) -> str:
        return self._topic.name


class _LoopWork(Generic[T]):
    """A computation whose result is there after its simulated duration."""

    def __init__(self, host: LoopHost, duration: float, function: Callable[[], T]) -> None:
        self._host = host
        self._due_ns = host.now_ns() + round(duration * NANO)
        self._result: T | None = None
        self._error: Exception | None = None
        try:
            self._result = function()
        except Exception as error:  # noqa: BLE001 - it is raised where the result is taken
            self._error = error

    def done(self) -> bool:
        return self._host.now_ns() >= self._due_ns

    def result(self) -> T:
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value] # the function has returned it


class _LoopStepper:
    """Starts and stops the source of time, which the host advances."""

    def __init__(self, source: TimeSource) -> None:
        self.pacer = Pacer(0.0)
        self.source = source
        self.is_running = False

    def start(self) -> None:
        self.is_running = True
        self.source.begin()

    def stop(self) -> None:
        self.is_running = False

    def call(self, act: Callable[[], T]) -> T:
        if not self.is_running:
            raise Refusal("simulation", RefusalCode.NOT_ACTIVE, "the simulation is not running")
        return act()


class LoopPort:
    """The port of one component."""

    def __init__(self, host: LoopHost, number: int, name: str, token: str) -> None:
        self.host = host
        self.number = number
        self.name = name
        self.calls = PeriodicCalls()
        self.channels: list[_LoopChannel] = []
        self.is_alive = True
        self.is_frozen = False
        self._token = token

    @property
    def full_name(self) -> str:
        """Name with the namespace."""
        return f"/{self.name}"

    @property
    def token(self) -> str:
        """Number of the instance."""
        return self._token

    @property
    def ros_node(self) -> None:
        """None: here is no ROS."""
        return

    def publish(self, topic: Topic) -> _LoopChannel:
        """Open a topic to send to."""
        channel = _LoopChannel(self, topic)
        self.channels.append(channel)
        return channel

    def subscribe(
        self, topic: Topic, receive: Callable[[Message], None], depth: int | None
    ) -> Cancel:
        """Receive a topic; first what is kept for late joiners."""
        return self.host.subscribe(self, topic, receive, depth)

    def serve(self, service: str, answer: Callable[..., tuple[bool, str]]) -> Cancel:
        """Answer a service."""
        return self.host.serve(self, service, answer)

    def call(self, service: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a service."""
        return self.host.call_from(self, service, (), answered)

    def every(
        self, period: float, callback: Callable[[], None], *, by_wall_clock: bool = False
    ) -> Cancel:
        """Call back by simulated time, whichever clock is asked for."""
        del by_wall_clock
        return self.calls.add(round(period * NANO), callback, self.now_ns())

    def work(self, duration: float, function: Callable[[], T]) -> Work[T]:
        """Compute at once; the result is there after the duration [s]."""
        return _LoopWork(self.host, duration, function)

    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self.host.now_ns()

    def knows_time(self) -> bool:
        """Whether a tick has passed."""
        return self.host.now_ns() > 0

    def steady_ns(self) -> int:
        """Simulated time [ns]."""
        return self.host.now_ns()

    def time_stepper(self, source: TimeSource, factor: float) -> _LoopStepper:
        """Be the host's source of time; it advances as fast as possible."""
        del factor
        return self.host.time_stepper(self, source)

    def log(self, level: Level, text: str) -> None:
        """Pass to the host's log."""
        self.host.log(self.name, level, text)


class LoopHost:
    """Carries components in one thread.

    Args:
        delays: of the messages.
        tick: duration of a tick where no component is the source of time [s].

    Attributes:
        ticks: number of past ticks.
        log: called with name, level and text of each line of the log.
    """

    def __init__(self, delays: Delays | None = None, tick: float = 0.01) -> None:
        self.delays = delays or Delays()
        self.ticks = 0
        self.log: Callable[[str, Level, str], None] = lambda _name, _level, _text: None
        self._tick_ns = round(tick * NANO)
        self._now_ns = 0
        self._components: dict[str, Component] = {}
        self._ports: dict[str, LoopPort] = {}
        self._numbers: dict[str, int] = {}
        self._instances = 0
        self._due: dict[int, list[_Delivery]] = {}
        self._subscriptions: dict[str, list[_Subscription]] = {}
        self._subscription_count = 0
        self._servers: dict[str, tuple[LoopPort, Callable[..., tuple[bool, str]]]] = {}
        self._call_count: dict[str, int] = {}
        self._listeners: dict[str, list[Listener]] = {}
        self._time: tuple[LoopPort, _LoopStepper] | None = None
        self._operator = self._new_port(OPERATOR)
        self._operator_channels: dict[str, _LoopChannel] = {}

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
        groups = _groups(component_class, parameters)
        component = component_class(self._new_port(name), groups)
        self._components[name] = component
        try:
            component.configure()
            component.activate()
        except Exception:
            self.kill(name)
            raise
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
        port = self._ports.pop(name)
        port.is_alive = False
        for subscribed in self._subscriptions.values():
            subscribed[:] = [each for each in subscribed if each.port is not port]
        self._servers = {s: (p, a) for s, (p, a) in self._servers.items() if p is not port}
        if self._time is not None and self._time[0] is port:
            self._time[1].stop()

    def stop(self, name: str) -> None:
        """Deactivate and release a component, as SIGTERM ends a process."""
        self._components[name].clean_up()
        self.kill(name)

    def freeze(self, name: str) -> None:
        """Halt a component, as SIGSTOP halts a process; its messages wait."""
        self._ports[name].is_frozen = True

    def thaw(self, name: str) -> None:
        """Let a frozen component go on with the messages that its queues have kept."""
        port = self._ports[name]
        port.is_frozen = False
        for subscribed in self._subscriptions.values():
            for each in subscribed:
                if each.port is port:
                    kept = tuple(each.backlog)
                    each.backlog.clear()
                    for message in kept:
                        each.receive(message)

    # --- time ------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """Simulated time [ns]."""
        return self._now_ns if self._time is None else self._time[1].source.stamp_ns

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.now_ns() / NANO

    def tick(self) -> None:
        """Deliver what is due, make the periodic calls, and advance time by one tick."""
        before_ns = self.now_ns()
        for each in sorted(self._due.pop(self.ticks, ())):
            each.deliver()
        if self.now_ns() < before_ns:
            self._go_back()
        now_ns = self.now_ns()
        for port in tuple(self._ports.values()):
            if not port.is_frozen:
                port.calls.advance(now_ns)
        self.ticks += 1
        if self._time is None:
            self._now_ns += self._tick_ns
        else:
            port, stepper = self._time
            if stepper.is_running and not stepper.source.paused and not port.is_frozen:
                stepper.source.advance()

    def _go_back(self) -> None:
        now_ns = self.now_ns()
        for name, component in self._components.items():
            port = self._ports[name]
            port.calls.restart(now_ns)
            if self._time is not None and port is not self._time[0]:
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

    def time_stepper(self, port: LoopPort, source: TimeSource) -> _LoopStepper:
        """Make a component the source of time."""
        stepper = _LoopStepper(source)
        self._time = port, stepper
        return stepper

    # --- messages --------------------------------------------------------------------------------

    def listen(self, listener: Listener, *names: str) -> None:
        """Call back for each sample when it is sent on these topics; without names on all."""
        for name in names or TOPICS:
            find_topic(name)
            self._listeners.setdefault(name, []).append(listener)

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

        if not self.call_from(self._operator, service, arguments, answered):
            servers = ", ".join(nodes_that(Act.SERVE, service))
            reason = f"the service has no server; {servers} should run"
            raise Refusal(service, RefusalCode.NOT_ACTIVE, reason)
        return response

    def is_received(self, topic: str) -> bool:
        """Whether a topic has a receiver."""
        return bool(self._subscriptions.get(topic) or self._listeners.get(topic))

    def send(self, port: LoopPort, topic: str, message: Message, sequence: int, due: int) -> None:
        """Send a message to all subscribers, to be received in the tick ``due``."""
        assert not isinstance(message.content, Refusal)
        for listener in self._listeners.get(topic, ()):
            listener(topic, message.content, message.sender, self.now_ns())
        for each in self._subscriptions.get(topic, ()):
            self._schedule(due, each, port, sequence, message)

    def _schedule(
        self, due: int, to: _Subscription, port: LoopPort, sequence: int, message: Message
    ) -> None:
        delivery = _Delivery(
            to.port.number, _ORDER[to.topic], port.number, sequence, to.number,
            lambda: to.deliver(message),
        )  # fmt: skip
        self._due.setdefault(due, []).append(delivery)

    def subscribe(
        self,
        port: LoopPort,
        topic: Topic,
        receive: Callable[[Message], None],
        depth: int | None,
    ) -> Cancel:
        """Subscribe a component to a topic."""
        self._subscription_count += 1
        backlog: deque[Message] = deque(maxlen=qos.depth(topic.intent, depth))
        made = _Subscription(port, self._subscription_count, topic.name, receive, backlog)
        subscribed = self._subscriptions.setdefault(topic.name, [])
        subscribed.append(made)
        for sender in self._ports.values():
            for channel in sender.channels:
                if channel.topic == topic.name:
                    for number, message in enumerate(channel.kept):
                        self._schedule(self.ticks + 1, made, sender, number, message)
        return lambda: subscribed.remove(made)

    def serve(
        self, port: LoopPort, service: str, answer: Callable[..., tuple[bool, str]]
    ) -> Cancel:
        """Make a component the server of a service."""
        self._servers[service] = port, answer
        return lambda: _forget(self._servers, service)

    def call_from(
        self,
        port: LoopPort,
        service: str,
        arguments: Iterable[bool],
        answered: Callable[[bool, str], None],
    ) -> bool:
        """Call a service; returns whether it has a server."""
        if service not in self._servers:
            return False
        server, answer = self._servers[service]
        number = self._call_count[service] = self._call_count.get(service, 0) + 1
        given = tuple(arguments)

        def respond() -> None:
            if server.is_frozen:
                after(server, respond)
            elif server.is_alive:
                response = answer(*given)
                after(port, lambda: answered(*response) if port.is_alive else None)

        def after(receiver: LoopPort, act: Callable[[], None]) -> None:
            due = self.ticks + self.delays.draw(service, port.full_name, number)
            delivery = _Delivery(receiver.number, _ORDER[service], port.number, number, 0, act)
            self._due.setdefault(due, []).append(delivery)

        after(server, respond)
        return True

    def _new_port(self, name: str) -> LoopPort:
        """Return a port; a restarted component keeps its place in the order."""
        number = self._numbers.setdefault(name, len(self._numbers))
        self._instances += 1
        port = self._ports[name] = LoopPort(self, number, name, str(self._instances))
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


def _forget(servers: dict[str, Any], service: str) -> None:
    servers.pop(service, None)
