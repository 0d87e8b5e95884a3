"""The loop host: carries components in one thread, by simulated time, without ROS.

A tick: every component receives the messages that are due, then makes the periodic calls that are
due, then the source of time advances. A message that is sent in tick k is received in tick k + d,
with d >= 1 drawn by ``Delays``: what a component does in a tick does not depend on the others. It
receives in the order of the contract's table. So the same components, requests and seed give the
same messages, on any machine, also spread over hosts that ``rover_runtime.lockstep`` joins.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from operator import itemgetter
from typing import Any, TypeVar

from msg_schemas import qos
from msg_schemas.access import Act, nodes_that
from msg_schemas.cdr import check
from msg_schemas.parameters import ParameterError, from_mapping
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Sample
from msg_schemas.table import SERVICES, TOPICS, Topic, find_topic
from rover_runtime.component import Component, Groups
from rover_runtime.delays import Delays
from rover_runtime.loop_port import LoopChannel, LoopPort, LoopStepper
from rover_runtime.pacing import NANO, TimeSource
from rover_runtime.port import Cancel, Message
from rover_runtime.remote import Call, Remote, Response, Sent
from rover_runtime.worker_process import InlineWorker, Worker

T = TypeVar("T")
C = TypeVar("C", bound=Component)

OPERATOR = "operator"
"""Name of the sender of requests from outside the host."""

_ORDER = {name: k for k, name in enumerate((*TOPICS, *SERVICES))}

Listener = Callable[[str, Sample, str, int], None]
"""Called with topic, sample, sender's text and time of sending [ns]."""

Impairment = Callable[[Any], Any]
"""Called with each sample of a topic; returns what the components receive, None = nothing."""


@dataclass
class ServiceResponse:
    """Response to a request from outside; ``success`` is None until it is there."""

    success: bool | None = None
    message: str = ""


@dataclass(eq=False)
class _LoopSubscription:
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


_Delivery = tuple[int, int, int, int, int, Callable[[], None]]
"""What is due in a tick: receiver, topic, sender, sequence, subscription and what is done."""

_delivery_order = itemgetter(0, 1, 2, 3, 4)


class LoopHost:
    """Carries components in one thread.

    Args:
        delays: of the messages.
        tick: duration of a tick where no component is the source of time [s].
        order: names of all components of all hosts that share simulated time; a component receives
            from others in this order.
        namespace: of the components; empty or with a leading slash.

    Attributes:
        ticks: number of past ticks.
        remote: the other processes, None: all components are in this host.
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
        self.delays = delays or Delays()
        self.namespace = namespace
        self.ticks = 0
        self.remote: Remote | None = None
        self.worker: Worker = InlineWorker()
        self.log: Callable[[str, Level, str], None] = lambda _name, _level, _text: None
        self._tick_ns = round(tick * NANO)
        self._now_ns = 0
        self._components: dict[str, Component] = {}
        self._ports: dict[str, LoopPort] = {}
        self._numbers = {name: number for number, name in enumerate((OPERATOR, *order))}
        self._instances: dict[str, int] = {}
        self._due: dict[int, list[_Delivery]] = {}
        self._subscriptions: dict[str, list[_LoopSubscription]] = {}
        self._subscription_count = 0
        self._servers: dict[str, tuple[LoopPort, Callable[..., tuple[bool, str]]]] = {}
        self._listeners: dict[str, list[Listener]] = {}
        self._impairments: dict[str, Impairment] = {}
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
            for name, port in self._ports.items()
            if any(work.is_late(now_ns) for work in port.works)
        )

    def restart_at(self, tick: int) -> None:
        """Go on with another tick; what was due before it, or after an earlier start, is lost."""
        if tick < self.ticks:
            self._due.clear()
            for port in self._ports.values():
                for channel in port.channels:
                    channel.restart()
        self.ticks = tick
        self._due = {due: each for due, each in self._due.items() if due >= tick}

    def step(self) -> None:
        """Deliver what is due, and make the periodic calls."""
        if self._time is not None:
            self._time[1].begin()
        for *_, deliver in sorted(self._due.pop(self.ticks, ()), key=_delivery_order):
            deliver()
        now_ns = self.now_ns()
        for port in tuple(self._ports.values()):
            if not port.is_frozen:
                port.calls.advance(now_ns)
        self.ticks += 1

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
        if self._now_ns < before_ns:
            self._go_back()

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

    # --- messages --------------------------------------------------------------------------------

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Let the other processes know of a topic or service that a component has opened."""
        if self.remote is not None:
            self.remote.open(act, port, name)

    def listen(self, listener: Listener, *names: str) -> None:
        """Call back for each sample when it is sent on these topics; without names on all."""
        for name in names or TOPICS:
            find_topic(name)
            self._listeners.setdefault(name, []).append(listener)

    def impair(self, topic: str, impairment: Impairment | None) -> None:
        """Change or drop what the components receive on a topic, as a faulty sensor does.

        Args:
            topic: of the contract.
            impairment: None = none any more.
        """
        find_topic(topic)
        if impairment is None:
            self._impairments.pop(topic, None)
        else:
            self._impairments[topic] = impairment

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

    def answer(self, service: str, arguments: Iterable[bool]) -> tuple[bool, str]:
        """Answer a request from outside at once, between two ticks."""
        if service not in self._servers:
            return False, f"{service} has no server in this process"
        _, reply = self._servers[service]
        return reply(*arguments)

    def is_received(self, topic: str) -> bool:
        """Whether a topic has a receiver."""
        here = self._subscriptions.get(topic) or self._listeners.get(topic)
        return bool(here) or (self.remote is not None and self.remote.is_received(topic))

    def is_subscribed(self, topic: str) -> bool:
        """Whether a component of this host receives a topic."""
        return bool(self._subscriptions.get(topic))

    def send(self, sent: Sent, message: Message, data: bytes) -> None:
        """Send a message, also as its bytes, to all subscribers."""
        assert not isinstance(message.content, Refusal)
        for listener in self._listeners.get(sent.topic, ()):
            listener(sent.topic, message.content, message.sender, self.now_ns())
        self.receive(sent, message)
        if self.remote is not None:
            self.remote.send(sent, data)

    def receive(self, sent: Sent, message: Message) -> None:
        """Receive a message in the tick in which it is due."""
        if sent.topic in self._impairments:
            content = self._impairments[sent.topic](message.content)
            if content is None:
                return
            message = message._replace(content=_as_received(sent.topic, content))
        subscribed = self._subscriptions.get(sent.topic)
        if subscribed:
            self._schedule(sent, subscribed, message)

    def _schedule(self, sent: Sent, to: Iterable[_LoopSubscription], message: Message) -> None:
        key = _ORDER[sent.topic], self._number(sent.sender), sent.sequence
        self._due.setdefault(sent.due, []).extend(
            [(each.port.number, *key, each.number, partial(each.deliver, message)) for each in to]
        )

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
        made = _LoopSubscription(port, self._subscription_count, topic.name, receive, backlog)
        subscribed = self._subscriptions.setdefault(topic.name, [])
        subscribed.append(made)
        for sender in self._ports.values():
            for channel in sender.channels:
                if channel.topic == topic.name:
                    for kept in channel.kept:
                        due = max(kept.sent.due, self.ticks + 1)
                        self._schedule(kept.sent._replace(due=due), (made,), kept.message)
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
        number = port.next_sequence(service)
        call = Call(service, port.name, number, tuple(arguments), self._hop(service, port, number))
        if service in self._servers:
            self._schedule_call(call, self.receive_response)
        elif self.remote is not None and self.remote.is_served(service):
            self.remote.call(call)
        else:
            return False
        port.answers[service, number] = answered
        return True

    def receive_call(self, call: Call) -> None:
        """Receive a request of another process."""
        if self.remote is not None:
            self._schedule_call(call, self.remote.respond)

    def receive_response(self, response: Response) -> None:
        """Receive the response to a request of a component of this host."""
        port = self._ports.get(response.caller)
        if port is None:
            return
        answered = port.answers.pop((response.service, response.number), None)
        if answered is None:
            return  # the caller was restarted meanwhile
        server = self._number(response.server)
        self._due.setdefault(response.due, []).append((
            port.number, _ORDER[response.service], server, response.number, 0,
            partial(answered, response.success, response.message),
        ))  # fmt: skip

    def _hop(self, service: str, sender: LoopPort, number: int) -> int:
        return self.ticks + self.delays.draw(service, sender.full_name, number)

    def _schedule_call(self, call: Call, respond: Callable[[Response], None]) -> None:
        if call.service not in self._servers:
            return  # the server was killed meanwhile
        server, answer = self._servers[call.service]

        def act() -> None:
            if server.is_frozen:
                schedule(self.ticks + 1)
            elif server.is_alive:
                success, message = answer(*call.arguments)
                due = self._hop(call.service, server, call.number)
                key = call.service, call.caller, call.number
                respond(Response(*key, server.name, success, message, due))

        def schedule(due: int) -> None:
            caller = self._number(call.caller)
            delivery = server.number, _ORDER[call.service], caller, call.number, 0, act
            self._due.setdefault(due, []).append(delivery)

        schedule(call.due)

    def _number(self, name: str) -> int:
        """Place of a component in the order; a restarted one keeps it."""
        return self._numbers.setdefault(name, len(self._numbers))

    def _new_port(self, name: str) -> LoopPort:
        """Return a port for a new instance of a component."""
        instance = self._instances[name] = self._instances.get(name, 0) + 1
        port = self._ports[name] = LoopPort(self, self._number(name), name, str(instance))
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


def _as_received(topic: str, sample: Sample) -> Sample | Refusal:
    """Return a sample as a receiver decodes it: a refusal where it violates the contract."""
    try:
        check(topic, sample)
    except Refusal as refusal:
        return refusal
    return sample


def _forget(servers: dict[str, Any], service: str) -> None:
    servers.pop(service, None)
