"""The port of a component on the loop host."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Any, Generic, Protocol, TypeVar

from msg_schemas import qos
from msg_schemas.access import Act
from msg_schemas.cdr import pack
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Sample
from msg_schemas.specifications import Topic
from rover_runtime.delays import Delays
from rover_runtime.pacing import NANO, Pacer, TimeSource
from rover_runtime.periodic_calls import PeriodicCalls
from rover_runtime.port import Cancel, Message, Work
from rover_runtime.remote import Kept, Sent, restarted
from rover_runtime.worker_process import Worker

T = TypeVar("T")

_PER_TICK = 1000  # messages of a component on a topic
_BURST = 0.05  # by which ticks run ahead: to wake up for each costs more CPU time [s]


class PortExchange(Protocol):
    """What a port asks of the exchange of messages; see ``MessageExchange``."""

    ticks: int
    delays: Delays

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Let the other processes know of an opened topic or service."""

    def is_received(self, topic: str) -> bool:
        """Whether a topic has a receiver."""

    def send(self, sent: Sent, message: Message, data: bytes) -> None:
        """Send a message, also as its bytes."""

    def subscribe(
        self, port: LoopPort, topic: Topic, receive: Callable[[Message], None], depth: int | None
    ) -> Cancel:
        """Receive a topic."""

    def serve(
        self, port: LoopPort, service: str, answer: Callable[..., tuple[bool, str]]
    ) -> Cancel:
        """Answer a service."""

    def call_from(
        self,
        port: LoopPort,
        service: str,
        arguments: Iterable[bool],
        answered: Callable[[bool, str], None],
    ) -> bool:
        """Call a service; returns whether it has a server."""


class PortHost(Protocol):
    """What a port asks of its host; see ``LoopHost``."""

    namespace: str
    worker: Worker
    log: Callable[[str, Level, str], None]

    @property
    def exchange(self) -> PortExchange:
        """Messages and services between the components."""

    def now_ns(self) -> int:
        """Return the simulated time [ns]."""

    def elapsed_ns(self) -> int:
        """Return the time that goes on while simulated time is paused [ns]."""

    def time_stepper(self, port: LoopPort, source: TimeSource, factor: float) -> LoopStepper:
        """Make a component the source of time."""


class LoopChannel:
    """A topic that a component sends to."""

    def __init__(self, port: LoopPort, topic: Topic) -> None:
        self._port = port
        self._topic = topic
        self._last_due = 0
        self.kept: deque[Kept] = deque(maxlen=qos.kept(topic.intent))  # for late joiners

    @property
    def has_subscribers(self) -> bool:
        """Whether a component, a listener or another process receives it."""
        return self._port.host.exchange.is_received(self._topic.name)

    def send(self, sample: Sample, sender: str) -> None:
        """Send a sample; raises Refusal."""
        name, port = self._topic.name, self._port
        data = pack(name, sample, sender)
        exchange = port.host.exchange
        message = Message(sender, getattr(sample, "stamp_ns", 0), sample)
        sequence = port.next_sequence(name)
        delay = exchange.delays.draw(name, port.full_name, sequence)
        # Never received before an earlier message.
        self._last_due = max(self._last_due, exchange.ticks + delay)
        sent = Sent(name, port.name, sequence, self._last_due)
        if self.kept.maxlen:
            self.kept.append(Kept(sent, message))
        exchange.send(sent, message, data)

    def restart(self) -> None:
        """Begin anew with the first tick."""
        self._last_due = 0
        self.kept = restarted(self.kept)

    def close(self) -> None:
        """Close the topic."""
        self._port.channels.remove(self)

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self._topic.name


class LoopWork(Generic[T]):
    """A computation whose result is there after its simulated duration.

    Args:
        host: of the component.
        duration: simulated time that it takes [s].
        function: computes the result.
    """

    def __init__(self, host: PortHost, duration: float, function: Callable[[], T]) -> None:
        self._host = host
        self._due_ns = host.now_ns() + round(duration * NANO)
        self._future: Future[T] = host.worker.submit(function)

    def done(self) -> bool:
        """Whether the duration is over; time waits for the computation."""
        return self._host.now_ns() >= self._due_ns

    def result(self) -> T:
        """Return the result; raises ``WorkFailed``."""
        return self._future.result()

    def is_late(self, now_ns: int) -> bool:
        """Whether the duration is over at a time [ns], and the computation is not."""
        return now_ns >= self._due_ns and not self._future.done()


class LoopStepper:
    """Starts and stops the source of time, which the host advances."""

    def __init__(self, source: TimeSource, factor: float) -> None:
        self.pacer = Pacer(factor, _BURST)
        self.source = source
        self.is_running = False
        self._has_begun = False

    def start(self) -> None:
        """Let time run."""
        self.is_running = True
        self._has_begun = False

    def begin(self) -> None:
        """Let the source begin, once all components of the first tick are there."""
        if self.is_running and not self._has_begun:
            self._has_begun = True
            self.source.begin()

    def stop(self) -> None:
        """Let time stand."""
        self.is_running = False

    def call(self, act: Callable[[], T]) -> T:
        """Call a function; raises Refusal where time does not run."""
        if not self.is_running:
            raise Refusal("simulation", RefusalCode.NOT_ACTIVE, "the simulation is not running")
        return act()


class LoopPort:
    """The port of one component."""

    is_simulated = True

    def __init__(self, host: PortHost, number: int, name: str, token: str) -> None:
        self.host = host
        self.answers: dict[tuple[str, int], Callable[[bool, str], None]] = {}  # by service, number
        self.number = number
        self.name = name
        self.calls = PeriodicCalls()
        self.wall_calls = PeriodicCalls()
        self.channels: list[LoopChannel] = []
        self.works: list[LoopWork[Any]] = []
        self.is_alive = True
        self.is_frozen = False
        self._sequences: dict[str, tuple[int, int]] = {}  # tick and index by topic or service
        self.ros_node: Any = None
        self.now_ns: Callable[[], int] = host.now_ns  # simulated time
        self.full_name = f"{host.namespace}/{name}"
        self.token = token  # number of the instance

    def next_sequence(self, name: str) -> int:
        """Return the number of the next message on a topic or service.

        It depends on the tick alone, not on what was sent before: a sample that nobody receives is
        not sent.
        """
        ticks = self.host.exchange.ticks
        tick, index = self._sequences.get(name, (0, 0))
        index = index + 1 if tick == ticks else 0
        self._sequences[name] = ticks, index
        return ticks * _PER_TICK + index

    def publish(self, topic: Topic) -> LoopChannel:
        """Open a topic to send to."""
        channel = LoopChannel(self, topic)
        self.host.exchange.open(Act.PUBLISH, self, topic.name)
        self.channels.append(channel)
        return channel

    def subscribe(
        self, topic: Topic, receive: Callable[[Message], None], depth: int | None
    ) -> Cancel:
        """Receive a topic; first what is kept for late joiners."""
        self.host.exchange.open(Act.SUBSCRIBE, self, topic.name)
        return self.host.exchange.subscribe(self, topic, receive, depth)

    def serve(self, service: str, answer: Callable[..., tuple[bool, str]]) -> Cancel:
        """Answer a service."""
        self.host.exchange.open(Act.SERVE, self, service)
        return self.host.exchange.serve(self, service, answer)

    def call(self, service: str, answered: Callable[[bool, str], None]) -> bool:
        """Call a service."""
        return self.host.exchange.call_from(self, service, (), answered)

    def every(
        self, period: float, callback: Callable[[], None], *, by_wall_clock: bool = False
    ) -> Cancel:
        """Call back by simulated time; by the wall clock: also while it is paused."""
        if by_wall_clock:
            return self.wall_calls.add(round(period * NANO), callback, self.host.elapsed_ns())
        return self.calls.add(round(period * NANO), callback, self.now_ns())

    def work(self, duration: float, function: Callable[[], T]) -> Work[T]:
        """Compute; the result is there after the duration [s]."""
        work = LoopWork(self.host, duration, function)
        self.works = [each for each in self.works if not each.done()] + [work]
        return work

    def knows_time(self) -> bool:
        """Whether a tick has passed."""
        return self.host.exchange.ticks > 0

    def steady_ns(self) -> int:
        """Simulated time [ns]."""
        return self.host.now_ns()

    def time_stepper(self, source: TimeSource, factor: float) -> LoopStepper:
        """Be the host's source of time."""
        return self.host.time_stepper(self, source, factor)

    def log(self, level: Level, text: str) -> None:
        """Pass to the host's log."""
        self.host.log(self.name, level, text)
