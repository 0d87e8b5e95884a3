"""Exchange of messages and services between the components of a loop host, tick by tick.

A message that is sent in tick k is received in tick k + d, with d >= 1 drawn by ``Delays``. A
component receives in the order of the contract's table, not in that of sending.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from operator import itemgetter
from typing import Any, Protocol

from msg_schemas import qos
from msg_schemas.access import Act
from msg_schemas.cdr import check
from msg_schemas.refusal import Refusal
from msg_schemas.samples import Sample
from msg_schemas.specifications import Topic
from msg_schemas.table import SERVICES, TOPICS, find_topic
from rover_runtime.admission import read_message
from rover_runtime.delays import Delays
from rover_runtime.loop_port import LoopPort
from rover_runtime.port import Cancel, Message
from rover_runtime.remote import OPERATOR, Call, Kept, Response, Sent, restarted

_ORDER = {name: k for k, name in enumerate((*TOPICS, *SERVICES))}

Listener = Callable[[str, Sample, str, int], None]
"""Called with topic, sample, sender's text and time of sending [ns]."""

Impairment = Callable[[Any], Any]
"""Called with each sample of a topic; returns what the components receive, None = nothing."""


class OtherProcesses(Protocol):
    """The processes that share the simulated time of this host; see ``LockstepProcess``."""

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Show a topic or service of a component to the others."""

    def is_received(self, topic: str) -> bool:
        """Whether anybody outside this process receives a topic."""

    def is_served(self, service: str) -> bool:
        """Whether a component of another process serves a service."""

    def send(self, sent: Sent, data: bytes) -> None:
        """Send a message."""

    def call(self, call: Call) -> None:
        """Send a request to a service."""

    def respond(self, response: Response) -> None:
        """Send the response to a request."""


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


class MessageExchange:
    """Messages and services of the components of a host, and of the other processes.

    Args:
        delays: of the messages.
        order: names of all components that share simulated time; a component receives from others
            in this order.
        now_ns: simulated time [ns].

    Attributes:
        ticks: number of past ticks.
        ports: of the components, by name.
        remote: the other processes; None: all components are in this host.
    """

    def __init__(self, delays: Delays, order: Sequence[str], now_ns: Callable[[], int]) -> None:
        self.delays = delays
        self.ticks = 0
        self.ports: dict[str, LoopPort] = {}
        self.remote: OtherProcesses | None = None
        self._now_ns = now_ns
        self._numbers = {name: number for number, name in enumerate(order)}
        self._due: dict[int, list[_Delivery]] = {}
        self._subscriptions: dict[str, list[_LoopSubscription]] = {}
        self._subscription_count = 0
        self._servers: dict[str, tuple[LoopPort, Callable[..., tuple[bool, str]]]] = {}
        self._listeners: dict[str, list[Listener]] = {}
        self._kept: dict[tuple[str, str], deque[Kept]] = {}  # of others, by topic and sender
        self._impairments: dict[str, Impairment] = {}

    def number(self, name: str) -> int:
        """Place of a component in the order; a restarted one keeps it."""
        return self._numbers.setdefault(name, len(self._numbers))

    def remove(self, name: str) -> LoopPort:
        """Remove the port of a component with all that it has opened, and return it."""
        port = self.ports.pop(name)
        for subscribed in self._subscriptions.values():
            subscribed[:] = [each for each in subscribed if each.port is not port]
        self._servers = {s: (p, a) for s, (p, a) in self._servers.items() if p is not port}
        return port

    def deliver_backlog(self, port: LoopPort) -> None:
        """Deliver what has arrived at a component while it was frozen."""
        for subscribed in self._subscriptions.values():
            for each in subscribed:
                if each.port is port:
                    kept = tuple(each.backlog)
                    each.backlog.clear()
                    for message in kept:
                        each.receive(message)

    def deliver(self) -> None:
        """Deliver what is due in this tick."""
        for *_, deliver in sorted(self._due.pop(self.ticks, ()), key=_delivery_order):
            deliver()

    def restart_at(self, tick: int) -> None:
        """Go on with another tick; what was due before it is due in it.

        What an earlier start has left is lost, but for what is kept for late joiners.
        """
        if tick < self.ticks:
            self._due.clear()
            for port in self.ports.values():
                for channel in port.channels:
                    channel.restart()
            for key, kept in self._kept.items():
                self._kept[key] = restarted(kept)
        self.ticks = tick
        for due in sorted(each for each in self._due if each < tick):
            self._due.setdefault(tick, []).extend(self._due.pop(due))

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Let the other processes know of a topic or service that a component has opened."""
        if self.remote is not None:
            self.remote.open(act, port, name)

    # --- messages --------------------------------------------------------------------------------

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
            listener(sent.topic, message.content, message.sender, self._now_ns())
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

    def receive_bytes(self, sent: Sent, data: bytes) -> None:
        """Receive a message of another process, or from outside.

        The last ones of a latched topic are kept for components that subscribe later.
        """
        row = find_topic(sent.topic)
        if not (row.is_latched or self.is_subscribed(row.name)):
            return
        message = read_message(row, data)
        if row.is_latched:
            depth = qos.LATCHED_NODES if sent.sender == OPERATOR else qos.kept(row.intent)
            kept = self._kept.setdefault((row.name, sent.sender), deque(maxlen=depth))
            kept.append(Kept(sent, message))
        self.receive(sent, message)

    def _schedule(self, sent: Sent, to: Iterable[_LoopSubscription], message: Message) -> None:
        key = _ORDER[sent.topic], self.number(sent.sender), sent.sequence
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
        here = (
            each.kept
            for sender in self.ports.values()
            for each in sender.channels
            if each.topic == topic.name
        )
        others = (kept for (name, _), kept in self._kept.items() if name == topic.name)
        for sent, message in chain.from_iterable((*here, *others)):
            due = max(sent.due, self.ticks + 1)
            self._schedule(sent._replace(due=due), (made,), message)
        return lambda: subscribed.remove(made)

    # --- services --------------------------------------------------------------------------------

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

    def answer(self, service: str, arguments: Iterable[bool]) -> tuple[bool, str]:
        """Answer a request from outside at once, between two ticks."""
        if service not in self._servers:
            return False, f"{service} has no server in this process"
        _, reply = self._servers[service]
        return reply(*arguments)

    def receive_call(self, call: Call) -> None:
        """Receive a request of another process."""
        if self.remote is not None:
            self._schedule_call(call, self.remote.respond)

    def receive_response(self, response: Response) -> None:
        """Receive the response to a request of a component of this host."""
        port = self.ports.get(response.caller)
        if port is None:
            return
        answered = port.answers.pop((response.service, response.number), None)
        if answered is None:
            return  # the caller was restarted meanwhile
        key = _ORDER[response.service], self.number(response.server), response.number
        act = partial(answered, response.success, response.message)
        self._schedule_act(port, response.due, key, act)

    def _hop(self, service: str, sender: LoopPort, number: int) -> int:
        return self.ticks + self.delays.draw(service, sender.full_name, number)

    def _schedule_call(self, call: Call, respond: Callable[[Response], None]) -> None:
        if call.service not in self._servers:
            return  # the server was killed meanwhile
        server, answer = self._servers[call.service]

        def act() -> None:
            success, message = answer(*call.arguments)
            due = self._hop(call.service, server, call.number)
            which = call.service, call.caller, call.number
            respond(Response(*which, server.name, success, message, due))

        key = _ORDER[call.service], self.number(call.caller), call.number
        self._schedule_act(server, call.due, key, act)

    def _schedule_act(
        self, port: LoopPort, due: int, key: tuple[int, int, int], act: Callable[[], None]
    ) -> None:
        """Schedule what a component does with a request or a response; a frozen one does it later.

        Args:
            port: of the component.
            due: tick.
            key: numbers of service, other component and request.
            act: what it does.
        """

        def deliver() -> None:
            if port.is_frozen:
                self._schedule_act(port, self.ticks + 1, key, act)
            elif port.is_alive:
                act()

        self._due.setdefault(due, []).append((port.number, *key, 0, deliver))


def _as_received(topic: str, sample: Sample) -> Sample | Refusal:
    """Return a sample as a receiver decodes it: a refusal where it violates the contract."""
    try:
        check(topic, sample)
    except Refusal as refusal:
        return refusal
    return sample


def _forget(servers: dict[str, Any], service: str) -> None:
    servers.pop(service, None)
