"""Lockstep over DDS: carries the components of a process on a loop host that waits for the others.

The processes exchange reports and releases (``rover_runtime.lockstep``), which hold the messages
between them, and signs of life, on topics of their own. Every message is also published on its
topic, so that recorders, pages and operators see it. A process subscribes to requests and to what
is kept for late joiners, and to any other topic while somebody outside publishes it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from std_msgs.msg import String, UInt8MultiArray

from msg_schemas import qos
from msg_schemas.access import LOCKSTEP, Act
from msg_schemas.events import EventReport, NodeEvent
from msg_schemas.layouts import LAYOUTS
from msg_schemas.message_types import message_class
from msg_schemas.parameters import ParameterError
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level
from msg_schemas.table import SERVICES, TOPICS
from rover_runtime.batches import STREAMS
from rover_runtime.byte_array import from_array, to_array
from rover_runtime.component import Component, ExitCode, Groups
from rover_runtime.delays import Delays
from rover_runtime.lockstep import LockstepProcess
from rover_runtime.loop_host import LoopHost
from rover_runtime.loop_port import LoopPort
from rover_runtime.ros.batches import BatchPublisher, BatchPublishers
from rover_runtime.ros.delivery import wait_until_acknowledged
from rover_runtime.ros.endpoint_matching import matched_subscribers
from rover_runtime.ros.timers import steady_timer
from rover_runtime.ros.waiting_messages import taken
from rover_runtime.worker_process import WorkerProcess

REPORTS, RELEASES, ALIVE = LOCKSTEP

_QUEUE_DEPTH = 1000  # messages
_LATCHED_DEPTH = 10  # a phase may change more than once before it is taken
_ALIVE_PERIOD = 0.2  # [s]
_LOOK_PERIOD = 0.5  # at those who publish outside [s]
_LOG_PERIOD = 5.0  # of the log of what time waits for [s]
_ALIVE_TIMEOUT = 2.0  # without a sign of life time waits no longer [s]
_NAMESAKE_SIGNS = 5  # of life of another process of the same name, until this one ends
_IN_USE_TIMEOUT = 0.6  # without a sign of life another process may take a name [s]
_ABSENCE = 1.0  # after which the signs of life of the others are awaited anew [s]
_REPEAT_AFTER = 0.1  # wall time without a report until a release is sent again [s]
_SPIN_SLICE = 0.1  # [s]
_SERVE_PERIOD = 0.002  # between two callbacks from the graph while ticks run [s]
_MAX_MESSAGES_AT_ONCE = 100
_LAST_TICK_TIMEOUT = 0.5  # for the messages of nodes that end [s]


def read_processes(text: str) -> dict[str, tuple[str, ...]]:
    """Return the nodes of each process.

    Args:
        text: ``sim_node,winch_node`` or ``plant=sim_node,mother_nodes=winch_node+descent_node``.

    Raises:
        ParameterError: a name is missing or repeated.
    """
    found: dict[str, tuple[str, ...]] = {}
    for part in text.split(","):
        name, _, nodes = part.strip().partition("=")
        found[name] = tuple((nodes or name).split("+"))
    names = [node for nodes in found.values() for node in nodes]
    if not all(names) or len(set(names)) < len(names) or len(found) < text.count(",") + 1:
        msg = f"lockstep is {text!r}: should be PROCESS=NODE+NODE,..., each name once"
        raise ParameterError(msg)
    return found


@dataclass
class _Peer:
    """Another process, as its last sign of life shows it."""

    token: str
    node: str
    has_source: bool
    is_ready: bool
    is_member: bool
    leaves: bool
    publishes: Mapping[str, int]  # number of publishers by topic
    subscribes: tuple[str, ...]
    serves: tuple[str, ...]
    data: bytes  # of the sign of life
    at: float  # wall time [s]

    def is_in_use(self, now: float) -> bool:
        """Whether the process runs at a wall time [s]: no other one may take its name."""
        return not self.leaves and now - self.at < _IN_USE_TIMEOUT


class _Link(NamedTuple):
    """Subscription to reports or releases."""

    topic: str
    subscription: Any
    receive: Callable[[bytes], None]


class LockstepCarrier:
    """Carries the components of this process; the ``Network`` of its ``LockstepProcess``.

    Args:
        processes: nodes of each process, in the order in which they receive.
        name: of this process.
        seed: of the delays.
        namespace: of the nodes.
        token: text that no other instance of the process has.
    """

    def __init__(
        self,
        processes: Mapping[str, tuple[str, ...]],
        name: str,
        seed: int,
        namespace: str,
        token: str,
    ) -> None:
        order = [node for nodes in processes.values() for node in nodes]
        self.host = LoopHost(Delays(seed), order=order, namespace=namespace.rstrip("/"))
        self.host.worker = WorkerProcess()
        self.host.log = self._log
        self.process = LockstepProcess(name, self.host, self)
        self._processes = processes
        self._name = name
        self._token = token
        self._nodes: dict[str, Node] = {}
        self._logs: dict[str, Callable[[Level, str], None]] = {}
        self._publishers: dict[str, dict[str, Any]] = {}  # by topic and component
        self._batches = BatchPublishers()
        self._batch_of: dict[str, BatchPublisher] = {}  # by stream
        self._subscribers: dict[str, Node] = {}  # by topic
        self._watched: dict[str, Any] = {}  # subscriptions to messages from outside
        self._full_names: dict[str, str] = {}  # of the published topics
        self._listened: set[str] = set()  # topics that somebody outside receives
        self._subscribed: set[str] = set()  # those of them that are published by themselves
        self._needed: set[str] = set()  # topics that components of other processes receive
        self._served: dict[str, Any] = {}
        self._peers: dict[str, _Peer] = {}
        self._shared: dict[str, Any] = {}  # publishers of the lockstep's own topics
        self._link: _Link | None = None
        self._is_ready = False
        self._namesakes = 0  # signs of life of another process of this name
        self._next_at = 0.0  # wall time of the next tick [s]
        self._released_at = 0.0  # wall time of the last release [s]
        self._looked_at = self._back_at = 0.0  # last look at the graph, end of the last absence [s]
        self._waiting_since = self._logged_at = time.monotonic()  # for others, its log [s]

    # --- components ------------------------------------------------------------------------------

    def add(
        self,
        node: Node,
        component_class: type[Component],
        groups: Groups,
        log: Callable[[Level, str], None],
    ) -> Component:
        """Carry a component that a node shows in the graph."""
        self._nodes[component_class.NAME] = node
        self._logs[component_class.NAME] = log
        if not self._shared:
            self._open_shared(node)
        return self.host.add(component_class, groups, node)

    def _open_shared(self, node: Node) -> None:
        kinds = {REPORTS: UInt8MultiArray, RELEASES: UInt8MultiArray, ALIVE: String}
        self._shared = {
            name: node.create_publisher(kind, name, _profile(name)) for name, kind in kinds.items()
        }
        self._open_subscription(node, String, ALIVE, self._on_alive)
        steady_timer(node, _ALIVE_PERIOD, self._watch)
        steady_timer(node, _LOOK_PERIOD, self._look_outside)

    def _open_subscription(
        self, node: Node, kind: type[Any], topic: str, receive: Callable[[bytes], None]
    ) -> _Link:
        """Subscribe to one of the lockstep's own topics; what is no such message is refused."""

        def on_message(data: bytes) -> None:
            try:
                receive(data)
            except ValueError as error:
                refusal = Refusal(topic, RefusalCode.MALFORMED, str(error))
                self.host[next(iter(self._nodes))].refuse(refusal)

        made = node.create_subscription(kind, topic, on_message, _profile(topic), raw=True)
        return _Link(topic, made, on_message)

    def _log(self, name: str, level: Level, text: str) -> None:
        if name in self._logs:
            self._logs[name](level, text)

    # --- Network ---------------------------------------------------------------------------------

    def open(self, act: Act, port: LoopPort, name: str) -> None:
        """Create the publisher, subscription or service of a component."""
        node = self._nodes[port.name]
        if act is Act.PUBLISH and port.name not in self._publishers.setdefault(name, {}):
            row = TOPICS[name]
            kept = _LATCHED_DEPTH if row.is_latched else None
            if name in STREAMS:
                self._batch_of[name] = self._batches.join(node, name)
            self._publishers[name][port.name] = node.create_publisher(
                message_class(row.message), name, qos.publisher_profile(row.intent, kept)
            )
            self._full_names[name] = self._publishers[name][port.name].topic_name
            if _is_always_shared(name):
                self._listened.add(name)
                self._subscribed.add(name)
        elif act is Act.SUBSCRIBE and name not in self._subscribers:
            self._subscribers[name] = node
            if _is_always_shared(name):
                self._watched[name] = self._subscribe(node, name)
        elif act is Act.SERVE and name not in self._served:
            kind = message_class(SERVICES[name].service)
            self._served[name] = node.create_service(kind, name, partial(self._on_request, name))

    def _subscribe(self, node: Node, name: str) -> Any:
        """Subscribe to the messages from outside."""
        row, kind = TOPICS[name], message_class(TOPICS[name].message)

        def on_message(data: bytes) -> None:
            self.process.on_message(name, data)
            for more, _ in taken(subscription, kind, _MAX_MESSAGES_AT_ONCE):
                self.process.on_message(name, more)

        subscription = node.create_subscription(
            kind, name, on_message, qos.profile(row.intent, _QUEUE_DEPTH), raw=True
        )
        return subscription

    def _on_request(self, service: str, request: Any, response: Any) -> Any:
        """Answer a request from outside, between two ticks."""
        arguments = (bool(request.data),) if hasattr(request, "data") else ()
        response.success, response.message = self.host.exchange.answer(service, arguments)
        return response

    def publish(self, component: str, topic: str, data: bytes) -> None:
        """Publish a message on its topic, and in a batch, if somebody listens."""
        if topic not in self._listened:
            return
        if topic in STREAMS:
            self._batch_of[topic].add(self._full_names[topic], data)
        if topic in self._subscribed:
            self._publishers[topic][component].publish(data)

    def report(self, data: bytes) -> None:
        """Publish a report."""
        self._shared[REPORTS].publish(to_array(data))

    def release(self, data: bytes) -> None:
        """Publish a release."""
        self._shared[RELEASES].publish(to_array(data))

    def is_received(self, topic: str) -> bool:
        """Whether somebody outside this process receives a topic."""
        return topic in self._needed or topic in self._listened

    def is_listened(self, topic: str) -> bool:
        """Whether somebody outside the lockstep receives a topic, such as a recorder."""
        return topic in self._listened

    def is_needed(self, topic: str) -> bool:
        """Whether a component of another process receives a topic."""
        return topic in self._needed

    def is_watched(self, topic: str) -> bool:
        """Whether this process receives the messages of a topic that come from outside."""
        return topic in self._watched

    def is_served(self, service: str) -> bool:
        """Whether a member serves a service."""
        return any(
            service in peer.serves for name, peer in self._peers.items()
            if name in self.process.members
        )  # fmt: skip

    # --- what the others send --------------------------------------------------------------------

    def _on_alive(self, data: bytes) -> None:
        for name, peer in self._peers.items():
            if peer.data == data and name in self.process.members:
                peer.at = time.monotonic()
                return
        name, peer = _read_alive(data)
        if name == self._name:
            self._on_namesake(peer)
        if name == self._name or name not in self._processes:
            return
        before = self._peers.get(name)
        if before is not None and before.is_in_use(peer.at) and before.token != peer.token:
            return  # a second process of this name
        self._peers[name] = peer
        self._needed = {topic for each in self._peers.values() for topic in each.subscribes}
        if before is None or before.token != peer.token:
            self._is_ready = False
        if not self.host.has_source or not self.process.is_member:
            return
        if name in self.process.members:
            if peer.leaves:
                self._exclude(name, "it has ended")
            elif before is not None and before.token != peer.token:
                self._exclude(name, "its process was started again")
        elif peer.is_ready and not peer.is_member and not peer.leaves:
            self.process.invite(name)
            text = f"simulated time waits for {name} again"
            self._event(NodeEvent.PARTICIPANT_JOINED, text, {"process": name})

    def _on_namesake(self, peer: _Peer) -> None:
        """End this process if another one of its name takes part, and goes on to do so."""
        if peer.token == self._token or not peer.is_member or self.process.is_member:
            return
        self._namesakes += 1
        if self._namesakes != _NAMESAKE_SIGNS:
            return
        for name in self._nodes:
            text = f"another process {self._name} runs in lockstep already: end it, or this one"
            self._log(name, Level.ERROR, text)
            self.host[name].exit_code = ExitCode.BAD_CONFIGURATION

    def _watch(self) -> None:
        """Give a sign of life, see who listens outside, and log what time waits for."""
        self._log_waiting()
        self._open_link()
        if not self._is_ready:
            self._is_ready = self._is_matched()
        self._send_alive()
        self._subscribed = {
            topic
            for topic, publishers in self._publishers.items()
            if _is_always_shared(topic)
            or any(each.get_subscription_count() for each in publishers.values())
        }
        self._listened = self._subscribed | {
            topic for topic, batch in self._batch_of.items() if batch.has_subscribers
        }

    def _log_waiting(self) -> None:
        """Log the processes and the computations that time has waited for, every five seconds."""
        now, names, absent = time.monotonic(), self.process.computing(), self._absent()
        if not (names or absent):
            self._waiting_since = self._logged_at = now
        elif now - self._logged_at > _LOG_PERIOD:
            self._logged_at = now
            begin = f"simulated time has waited for {now - self._waiting_since:.0f} s for"
            if absent:
                self._log(next(iter(self._nodes)), Level.OK, f"{begin} {', '.join(absent)} to join")
            for name in names:
                text = f"{begin} a computation; the first one on a machine compiles the plant"
                self._log(name, Level.OK, text)

    def _look_outside(self) -> None:
        """Subscribe to the topics that somebody outside publishes, and to no others."""
        if not self.process.is_member:
            return
        for topic, node in self._subscribers.items():
            if _is_always_shared(topic):
                continue
            inside = len(self._publishers.get(topic, ())) + sum(
                peer.publishes.get(topic, 0) for name, peer in self._peers.items()
                if name in self.process.members  # the graph may still show an ended one
            )  # fmt: skip
            is_outside = node.count_publishers(topic) > inside
            if is_outside and topic not in self._watched:
                self._watched[topic] = self._subscribe(node, topic)
            elif not is_outside and topic in self._watched:
                node.destroy_subscription(self._watched.pop(topic))

    def _open_link(self) -> None:
        """Receive reports as the process with the source of time, otherwise releases."""
        topic, receive = (
            (REPORTS, self.process.on_report)
            if self.host.has_source
            else (RELEASES, self.process.on_release)
        )
        node = self._first_node
        if self._link is not None:
            if self._link.topic == topic:
                return
            node.destroy_subscription(self._link.subscription)
        self._link = self._open_subscription(
            node, UInt8MultiArray, topic, lambda data: receive(from_array(data))
        )
        self._is_ready = False

    def _send_alive(self, *, leaves: bool = False) -> None:
        content = {
            "process": self._name,
            "token": self._token,
            "node": self._first_node.get_name(),
            "has_source": self.host.has_source,
            "is_ready": self._is_ready,
            "is_member": self.process.is_member,
            "leaves": leaves,
            "publishes": {topic: len(each) for topic, each in self._publishers.items()},
            "subscribes": tuple(self._subscribers),
            "serves": tuple(self._served),
        }
        self._shared[ALIVE].publish(String(data=json.dumps(content)))

    def _is_matched(self) -> bool:
        """Whether the processes that this one exchanges ticks with receive what it sends them."""
        if self._processes.keys() - {self._name} - self._peers.keys():
            return False
        topic = RELEASES if self.host.has_source else REPORTS
        receivers = {
            peer.node for peer in self._peers.values() if self.host.has_source or peer.has_source
        }
        if not receivers:
            return self.host.has_source
        matched = matched_subscribers(self._first_node, self._shared[topic])
        return receivers <= {name for name, _ in matched}

    @property
    def _first_node(self) -> Node:
        return next(iter(self._nodes.values()))

    # --- ticks -----------------------------------------------------------------------------------

    def spin(self, executor: Executor, is_over: Callable[[], bool]) -> None:
        """Run ticks and serve the graph until a condition holds."""
        served = 0.0
        while not is_over():
            now = time.monotonic()
            if now - self._looked_at > _ABSENCE:
                self._back_at = now
            self._looked_at = now
            early = self._next_at - now
            if early > 0.0:
                # Many callbacks at once: none of them lets the next tick run earlier.
                executor.spin_until_future_complete(Future(), timeout_sec=min(early, _SPIN_SLICE))
            elif not self._advance():
                executor.spin_once(timeout_sec=_SPIN_SLICE)
            elif time.monotonic() - served > _SERVE_PERIOD:
                executor.spin_once(timeout_sec=0.0)
            else:
                continue
            served = time.monotonic()

    def _advance(self) -> bool:
        """Run the next tick if it may run; returns whether it ran."""
        if not self.process.is_member:
            if self.host.has_source and self._is_ready and not self._absent():
                self.process.begin(self._processes)
            return False
        is_run = self.process.run_tick()
        if not is_run:
            self._take_link()
            is_run = self.process.run_tick()
        if self.host.has_source:
            now = time.monotonic()
            if is_run:
                self._next_at = now + self.host.pace(now)
                self._released_at = now
            else:
                self._exclude_silent(now)
                if now - self._released_at > _REPEAT_AFTER:
                    self.process.repeat_release()
                    self._released_at = now
        return is_run

    def _take_link(self) -> None:
        """Take reports or releases; the executor takes several times as long per message."""
        if self._link is not None:
            for data, _ in taken(self._link.subscription, UInt8MultiArray, _MAX_MESSAGES_AT_ONCE):
                self._link.receive(data)

    def _absent(self) -> tuple[str, ...]:
        """Processes without which time, of which this one is the source, does not begin."""
        if self.process.is_member or not self.host.has_source:
            return ()
        return tuple(
            name
            for name in self._processes
            if name != self._name and not (name in self._peers and self._peers[name].is_ready)
        )

    def _exclude_silent(self, now: float) -> None:
        for name in self.process.missing():
            peer = self._peers.get(name)
            if peer is not None and now - max(peer.at, self._back_at) > _ALIVE_TIMEOUT:
                reason = f"no sign of life for {now - peer.at:.1f} s"
                self._exclude(name, reason)

    def _exclude(self, name: str, reason: str) -> None:
        self._take_link()  # its last report
        self.process.exclude(name)
        text = f"simulated time waits for {name} no longer: {reason}"
        self._event(NodeEvent.PARTICIPANT_EXCLUDED, text, {"process": name})

    def _event(self, name: NodeEvent, text: str, values: Mapping[str, str]) -> None:
        component = self.host[next(iter(self._nodes))]
        component.event(EventReport(name, text, dict(values)), diagnoses=True)

    def _report_last_tick(self, executor: Executor) -> None:
        """Report what the components have sent when they were deactivated."""
        context, deadline = self._first_node.context, time.monotonic() + _LAST_TICK_TIMEOUT
        is_run = False
        while self.process.is_member and not self.host.has_source:
            self._take_link()
            # The next release shows that the report has arrived.
            is_over = is_run and not self.process.missing()
            if is_over or time.monotonic() > deadline or not context.ok():
                return
            is_run = is_run or self.process.run_tick()
            executor.spin_once(timeout_sec=_LAST_TICK_TIMEOUT)

    def leave(self, executor: Executor) -> None:
        """Announce the end of this process after its last report, so that nobody waits for it."""
        self._report_last_tick(executor)
        self.flush()
        wait_until_acknowledged(self.publishers)
        self._send_alive(leaves=True)
        wait_until_acknowledged([self._shared[ALIVE]])
        self.process.members.clear()
        self.host.worker.close()

    def flush(self) -> None:
        """Send the batches."""
        self._batches.flush()

    @property
    def publishers(self) -> list[Any]:
        """All publishers."""
        return [
            *self._batches.publishers,
            *(each for publishers in self._publishers.values() for each in publishers.values()),
            *self._shared.values(),
        ]


def _profile(topic: str) -> QoSProfile:
    """Return the profile of one of the lockstep's own topics.

    The acknowledgements of reliable reports and releases would cost several messages per tick.
    """
    is_repeated = topic in (REPORTS, RELEASES)
    reliability = ReliabilityPolicy.BEST_EFFORT if is_repeated else ReliabilityPolicy.RELIABLE
    return QoSProfile(depth=_QUEUE_DEPTH, reliability=reliability)


def _is_always_shared(topic: str) -> bool:
    """Whether processes subscribe to a topic, and publish it, also if nobody outside shares it."""
    row = TOPICS[topic]
    return bool(qos.kept(row.intent)) or (row.is_command and not row.owned)


def _read_alive(data: bytes) -> tuple[str, _Peer]:
    """Read a sign of life: the name of the process, and its state.

    Raises:
        ValueError: the bytes are none.
    """
    (text,) = LAYOUTS["std_msgs/msg/String"].parse(data)
    try:
        given = json.loads(text)
        peer = _Peer(
            token=str(given["token"]),
            node=str(given["node"]),
            has_source=bool(given["has_source"]),
            is_ready=bool(given["is_ready"]),
            is_member=bool(given["is_member"]),
            leaves=bool(given["leaves"]),
            publishes={str(topic): int(count) for topic, count in given["publishes"].items()},
            subscribes=tuple(map(str, given["subscribes"])),
            serves=tuple(map(str, given["serves"])),
            data=data,
            at=time.monotonic(),
        )
        return str(given["process"]), peer
    except (TypeError, KeyError, AttributeError, RecursionError, OverflowError) as error:
        msg = f"{text[:200]!r} is no sign of life: {error}"
        raise ValueError(msg) from error
